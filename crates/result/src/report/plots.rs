//! The plots of the report.

use super::Report;
use crate::UnitOfLength;
use crate::numbers::thousands;
use crate::plot::{Horizontal, Plot, Point, Series, Style};
use i2slam::Config;
use i2slam::FrameEstimate;
use i2slam::config::TrackingMethod;
use i2slam::geometry::{Pose, StampedPose};

type Points = Vec<(f64, f64)>;

/// A plot over the frames of the sequence.
fn over_frames(title: &str, explanation: &str, y_label: &str) -> Plot {
    Plot {
        title: title.to_owned(),
        explanation: explanation.to_owned(),
        x_label: "frame".to_owned(),
        y_label: y_label.to_owned(),
        horizontal: Horizontal::Tight,
        from_zero: true,
        series: Vec::new(),
        marks: Vec::new(),
    }
}

fn points(frames: &[FrameEstimate], value: impl Fn(&FrameEstimate) -> f64) -> Points {
    frames.iter().map(|f| (f.index as f64, value(f))).collect()
}

/// A value that frames have after refinement.
fn refined(frame: &FrameEstimate, value: f64) -> f64 {
    if frame.refined { value } else { f64::NAN }
}

/// The path from above and from the side, and its error.
pub(super) fn trajectory(report: &Report<'_>) -> String {
    let frames = &report.reconstruction.frames;
    let Some(first) = frames.first() else {
        return "<p class=\"none\">No frame was processed.</p>".to_owned();
    };
    // Seen from the first camera, whose axes are right, down and forward.
    let first_from_world = first.middle().inverse();
    let path: Vec<[f64; 3]> =
        frames.iter().map(|f| centre_in_first_camera(first_from_world, f.middle())).collect();
    let truth = report
        .ground_truth
        .iter()
        .map(|p| centre_in_first_camera(first_from_world, p.world_from_camera));
    let truth: Vec<[f64; 3]> = truth.collect();
    let [right, forward, up] = match report.metrics.unit_of_length {
        UnitOfLength::Metre => ["to the right [m]", "forward [m]", "up [m]"],
        UnitOfLength::Keyframes => {
            ["to the right", "forward", "up (unit of length of the keyframes given)"]
        }
        UnitOfLength::Unknown => ["to the right", "forward", "up (unit of length unknown)"],
    };
    // Without measured depth it has another unit of length.
    let is_metric = report.metrics.unit_of_length == UnitOfLength::Metre;
    let online = report.reconstruction.online_trajectory.iter().filter(|_| is_metric);
    let online: Vec<[f64; 3]> =
        online.map(|p| centre_in_first_camera(Pose::identity(), p.world_from_camera)).collect();
    let names = report.metrics.unordered.then(|| picture_names(report));
    let paths = Paths { path, truth, online, names };
    let mut out = paths.view("From above", [right, forward], [0, 2]);
    out += &paths.view("From the side", [forward, up], [2, 1]);
    if let Some(error) = position_error(frames, (report.ground_truth, report.metres_per_unit)) {
        out += &error.html();
    }
    out
}

/// A camera centre in the frame of the first camera: right, up, forward.
fn centre_in_first_camera(first_from_world: Pose<f64>, world_from_camera: Pose<f64>) -> [f64; 3] {
    let centre = first_from_world * world_from_camera.translation;
    [centre.x, -centre.y, centre.z]
}

/// Camera centres as [`centre_in_first_camera`] gives them.
struct Paths {
    path: Vec<[f64; 3]>,
    truth: Vec<[f64; 3]>,
    online: Vec<[f64; 3]>,
    /// Of photographs the names of `path`: they are no path, and nothing joins them.
    names: Option<Vec<String>>,
}

impl Paths {
    /// The plot of two of the directions.
    fn view(&self, title: &str, [x_label, y_label]: [&str; 2], directions: [usize; 2]) -> String {
        let explanation =
            "Where the camera was, in the directions of its first frame; one scale on both axes.";
        Plot {
            x_label: x_label.to_owned(),
            horizontal: Horizontal::EqualScales,
            from_zero: false,
            series: match &self.names {
                None => self.lines(directions),
                Some(names) => self.points(names, directions),
            },
            marks: self.ends(directions),
            ..over_frames(title, explanation, y_label)
        }
        .html()
    }

    fn lines(&self, [across, up]: [usize; 2]) -> Vec<Series> {
        let flat =
            |path: &[[f64; 3]]| -> Points { path.iter().map(|p| (p[across], p[up])).collect() };
        let mut series = Vec::new();
        if !self.truth.is_empty() {
            let truth = Series::line("ground truth", "c2", flat(&self.truth));
            series.push(truth.styled(Style::Under));
        }
        if !self.online.is_empty() {
            let online = Series::line("known when frames came", "c3", flat(&self.online));
            series.push(online.styled(Style::Under));
        }
        series.push(Series::line("estimate", "c1", flat(&self.path)));
        series
    }

    fn points(&self, names: &[String], [across, up]: [usize; 2]) -> Vec<Series> {
        let named =
            |name: String, p: &[f64; 3]| Point { x: p[across], y: p[up], name, ..Point::default() };
        let mut series = Vec::new();
        if !self.truth.is_empty() {
            let truth = self.truth.iter().map(|p| named("ground truth".to_owned(), p));
            series.push(Series::scattered("ground truth", 1, truth.collect()));
        }
        // On top: its markers have the names of files.
        let path = names.iter().cloned().zip(&self.path).map(|(name, p)| named(name, p));
        series.push(Series::scattered("estimate", 0, path.collect()));
        series
    }

    /// Start and end of a path.
    fn ends(&self, [across, up]: [usize; 2]) -> Vec<(&'static str, f64, f64)> {
        if self.names.is_some() {
            return Vec::new();
        }
        let ends = [("start", self.path.first()), ("end", self.path.last())];
        ends.into_iter().filter_map(|(name, p)| p.map(|p| (name, p[across], p[up]))).collect()
    }
}

/// The files of the frames, or their numbers.
fn picture_names(report: &Report<'_>) -> Vec<String> {
    let name = |frame: &FrameEstimate| {
        report.files.get(frame.index).map_or_else(|| frame.index.to_string(), str::to_owned)
    };
    report.reconstruction.frames.iter().map(name).collect()
}

/// Distance of each estimate from the ground truth of its timestamp, in metres of the latter.
fn position_error(
    frames: &[FrameEstimate],
    (truth, metres_per_unit): (&[StampedPose], f64),
) -> Option<Plot> {
    let stamps: Vec<f64> = truth.iter().map(|p| p.timestamp).collect();
    let error = |frame: &FrameEstimate| {
        let nearest = i2slam::geometry::nearest_stamp(&stamps, frame.timestamp, 0.02);
        let of = |i: usize| truth[i].world_from_camera.translation - frame.middle().translation;
        nearest.map_or(f64::NAN, |i| of(i).norm() * 100.0 * metres_per_unit)
    };
    let explanation = "Distance from the true camera position after alignment.";
    let mut plot = over_frames("Position error", explanation, "error [cm]");
    plot.series = vec![Series::line("error", "c1", points(frames, error)).styled(Style::Area)];
    (!truth.is_empty()).then_some(plot)
}

/// Exposure, white balance and camera response.
pub(super) fn tone(report: &Report<'_>) -> String {
    let reconstruction = report.reconstruction;
    if !reconstruction.config.formation.tone {
        return "<p class=\"none\">Switched off in this run: pictures were taken as they are.</p>"
            .to_owned();
    }
    exposure(report).html()
        + &white_balance(&reconstruction.frames).html()
        + &response(report).html()
        + &vignetting(report).map_or_else(String::new, |plot| plot.html())
}

fn exposure(report: &Report<'_>) -> Plot {
    let frames = &report.reconstruction.frames;
    let stops =
        |f: &FrameEstimate| found(f, f64::from(f.tone.log_exposure) / std::f64::consts::LN_2);
    let explanation = "Brightness the camera chose, in stops (1 EV is a factor of two) relative to \
                       the first frame.";
    let mut plot = over_frames("Exposure", explanation, "exposure [EV]");
    plot.from_zero = false;
    let estimate = points(frames, stops);
    if !report.true_exposure.is_empty() {
        let truth = align_exposure(&estimate, report.true_exposure);
        plot.series.push(Series::line("truth", "c2", truth).styled(Style::Under));
    }
    plot.series.push(Series::line("recovered", "c1", estimate));
    plot
}

/// A value of a frame that was found and refined; others have the tone of the frame before, which says
/// nothing.
fn found(frame: &FrameEstimate, value: f64) -> f64 {
    if has_tone(frame) { value } else { f64::NAN }
}

fn has_tone(frame: &FrameEstimate) -> bool {
    frame.tracked && frame.refined
}

/// True exposures [stops], with the mean offset to the estimate removed: one gain is free.
fn align_exposure(estimate: &[(f64, f64)], truth: &[(usize, f64)]) -> Points {
    let stops = |e: f64| if e > 0.0 { e.log2() } else { f64::NAN };
    let truth: Points = truth.iter().map(|&(i, e)| (i as f64, stops(e))).collect();
    let differences: Vec<f64> = truth
        .iter()
        .filter_map(|t| estimate.iter().find(|e| e.0 == t.0).map(|e| e.1 - t.1))
        .filter(|d| d.is_finite())
        .collect();
    let offset = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
    let (first, last) = match (estimate.first(), estimate.last()) {
        (Some(first), Some(last)) => (first.0, last.0),
        _ => return Vec::new(),
    };
    truth.into_iter().filter(|t| t.0 >= first && t.0 <= last).map(|t| (t.0, t.1 + offset)).collect()
}

fn white_balance(frames: &[FrameEstimate]) -> Plot {
    let found_frames = || frames.iter().filter(|frame| has_tone(frame));
    let balance = |frame: &FrameEstimate| frame.tone.log_white_balance;
    let is_constant =
        found_frames().zip(found_frames().skip(1)).all(|(a, b)| balance(a) == balance(b));
    let explanation = match is_constant {
        true => "Gain of each colour; it is the same in all frames.",
        false => "Gain of each colour; green is 1 where red and blue are free.",
    };
    let mut plot = over_frames("White balance", explanation, "gain");
    plot.from_zero = false;
    plot.series = [("red", 0), ("green", 1), ("blue", 2)]
        .into_iter()
        .map(|(name, channel)| {
            let gain =
                |f: &FrameEstimate| found(f, f64::from(f.tone.log_white_balance[channel]).exp());
            Series::line(name, name, points(frames, gain))
        })
        .collect();
    plot
}

/// Stops below saturation that the plot of the response shows.
const RESPONSE_STOPS: f64 = 14.0;

fn response(report: &Report<'_>) -> Plot {
    let mut plot = over_frames(
        "Camera response",
        "How the camera turns light into picture values; 0 stops just saturate. Dashed: the sRGB \
         standard.",
        "picture value",
    );
    plot.x_label = "light reaching the sensor [stops]".to_owned();
    let responses = &report.reconstruction.responses;
    let srgb = i2slam::formation::StartCurve::Srgb;
    let Some(response) = responses.get(responses.len() / 2) else { return plot };
    let curve = response.curve();
    let stops = |&x: &f32| Some(f64::from(x).log2()).filter(|stops| *stops >= -RESPONSE_STOPS);
    let positions = curve.positions();
    let standard = positions.iter().filter_map(stops).map(|s| (s, srgb.evaluate(s.exp2())));
    plot.series.push(Series::line("sRGB", "grey", standard).styled(Style::Dashed));
    let names: &[&str] =
        if curve.curves() == 1 { &["all colours"] } else { &["red", "green", "blue"] };
    for (channel, name) in names.iter().enumerate() {
        let colour = if curve.curves() == 1 { "c1" } else { ["red", "green", "blue"][channel] };
        let values = positions.iter().zip(curve.values(channel));
        let values = values.filter_map(|(x, &y)| Some((stops(x)?, f64::from(y))));
        plot.series.push(Series::line(name, colour, values));
    }
    plot
}

/// Steps of the curve of vignetting.
const VIGNETTING_STEPS: usize = 50;

/// Vignetting from the centre of the picture to its corners; none where none was found.
fn vignetting(report: &Report<'_>) -> Option<Plot> {
    let lens = &report.reconstruction.vignetting;
    let explanation = "Share of the light that the lens passes, from the centre of the picture to its \
                       corners.";
    let mut plot = over_frames("Vignetting", explanation, "share of light");
    plot.x_label = "distance from the centre [half diagonals]".to_owned();
    let radii = (0..=VIGNETTING_STEPS).map(|i| i as f64 / VIGNETTING_STEPS as f64);
    let values = radii.map(|r| (r, f64::from(lens.at((r * r) as f32))));
    plot.series.push(Series::line("share of light", "c1", values));
    (!lens.is_none()).then_some(plot)
}

/// Blur length of the frames.
pub(super) fn blur(report: &Report<'_>) -> String {
    let frames = &report.reconstruction.frames;
    let explanation = "Length of the streak that a point of the scene draws while the shutter is \
                       open (median over the picture).";
    let mut plot = over_frames("Blur", explanation, "blur [px]");
    plot.series = vec![
        Series::line("blur", "c1", points(frames, |f| refined(f, f.blur_length)))
            .styled(Style::Area),
    ];
    plot.html()
}

/// Explanation and axis label of the depth loss.
fn depth_loss(config: &Config) -> (&'static str, &'static str) {
    let second_order = config.tracking.method == TrackingMethod::SecondOrder;
    match second_order && config.tracking.iterations == 0 {
        true => (
            "Mean distance between predicted and measured depth along the surface's normal when the \
             pose was found, divided by depth times the larger of 1 and depth in metres, as a \
             sensor's noise grows.",
            "difference [cm at 1 m]",
        ),
        false => (
            "Mean difference between predicted and measured depth when the pose was found.",
            "difference [cm]",
        ),
    }
}

/// Time, losses and map size over the frames.
pub(super) fn statistics(report: &Report<'_>) -> String {
    let frames = &report.reconstruction.frames;
    let mut time = over_frames(
        "Time",
        "Seconds of tracking and mapping when a frame came. Refinement of all frames together is not in it.",
        "time [s]",
    );
    let total = |f: &FrameEstimate| f.tracking_seconds + f.mapping_seconds;
    time.series = vec![
        Series::line("tracking and mapping", "c2", points(frames, total)).styled(Style::Area),
        Series::line("tracking alone", "c1", points(frames, |f| f.tracking_seconds)),
    ];
    let explanation = "Mean difference between predicted and taken picture when the pose was found \
                       (1 is black against white).";
    let mut image = over_frames("Picture loss", explanation, "difference");
    image.series =
        vec![Series::line("picture", "c1", points(frames, |f| refined(f, f.losses.image)))];
    let mut plots = vec![time, image];
    let config = &report.reconstruction.config;
    // Of colour alone there is no measured depth.
    if !config.is_rgb() {
        let (explanation, unit) = depth_loss(config);
        let mut depth = over_frames("Depth loss", explanation, unit);
        let centimetres = |f: &FrameEstimate| refined(f, 100.0 * f.losses.depth);
        depth.series = vec![Series::line("depth", "c3", points(frames, centimetres))];
        plots.push(depth);
    }
    if frames.iter().all(|f| f.gaussians == 0) {
        return plots.iter().map(Plot::html).collect();
    }
    let explanation = format!(
        "Gaussians in the map when each frame was mapped, in thousands. The last steps split and remove some: {} \
         in the end.",
        thousands(report.metrics.gaussians)
    );
    let mut size = over_frames("Map", &explanation, "thousands");
    let in_thousands = |f: &FrameEstimate| f.gaussians as f64 / 1000.0;
    size.series =
        vec![Series::line("Gaussians", "c4", points(frames, in_thousands)).styled(Style::Area)];
    plots.push(size);
    plots.iter().map(Plot::html).collect()
}
