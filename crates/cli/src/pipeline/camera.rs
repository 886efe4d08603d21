//! What is said of a camera that nobody gave, or that pictures alone must bear out.

use crate::failure::Failure;
use i2slam::dataset::{EstimatedCamera, Layout, Sequence};
use i2slam::keyframes::{Intrinsics, OdometryReconstruction};
use i2slam_result::Metrics;

/// What the pictures alone told of the camera.
#[derive(Clone, Debug)]
pub(crate) struct FoundCamera {
    /// Where it came from at first, in words.
    source: String,
    /// Focal length at first [px].
    assumed: f64,
    /// Focal length in the end [px].
    found: f64,
    /// Whether it was looked for.
    searched: bool,
    /// Its relative standard deviation.
    deviation: Option<f64>,
    /// Horizontal field of view in the end [degrees].
    field_of_view: f64,
    /// Time from the first to the last row [s].
    readout: f64,
    /// Whether the lens was looked for.
    lens_searched: bool,
    /// The lens that was found, and the camera of the recorded pictures with it.
    lens: Option<EstimatedCamera>,
}

/// The camera of a sequence as a front end takes it.
pub(crate) fn intrinsics(sequence: &Sequence, estimate_distortion: bool) -> Intrinsics {
    let camera = sequence.camera;
    match (sequence.camera_is_guess, estimate_distortion) {
        (true, true) => Intrinsics::GuessWithDistortion(camera),
        (true, false) => Intrinsics::Guess(camera),
        (false, _) => Intrinsics::Known(camera),
    }
}

/// Refuses to look for the lens of a camera that is known.
pub(crate) fn refuse_known(sequence: &Sequence) -> Result<(), Failure> {
    if sequence.camera_is_guess {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--distortion estimate is for pictures of an unknown camera; this one is given by {}",
        sequence.camera_source
    )))
}

/// What is known before a run by colour alone begins.
/// `large` is the same as the front end sees it.
pub(crate) fn before(sequence: &Sequence, large: &Sequence) -> Vec<String> {
    let camera = &sequence.camera;
    let mut lines = Vec::new();
    let (width, height) = sequence.recorded_size;
    let seconds = match sequence.entries.as_slice() {
        [first, .., last] => last.timestamp - first.timestamp,
        _ => 0.0,
    };
    let reduced = if (camera.width, camera.height) == (width, height) {
        String::new()
    } else {
        let path = match (large.camera.width, large.camera.height) {
            size if size == (camera.width, camera.height) => String::new(),
            size if size == (width, height) => ", the path found as recorded".to_owned(),
            (width, height) => format!(", the path found at {width}x{height}"),
        };
        format!(", worked on at {}x{} (--max-side, --scale){path}", camera.width, camera.height)
    };
    if sequence.layout == Layout::Video || !reduced.is_empty() {
        lines.push(format!(
            "{}: {} frames of {width}x{height} px, {seconds:.1} s{reduced}",
            sequence.name,
            sequence.len()
        ));
    }
    let view = camera.horizontal_field_of_view().to_degrees();
    let source = &sequence.camera_source;
    lines.push(if sequence.camera_is_guess {
        format!(
            "camera not given: its focal length is looked for in the pictures, beginning with \
             {:.0} px ({source}); --fov or --intrinsics would give it",
            camera.fx
        )
    } else {
        format!("camera: focal length {:.1} px, {view:.1} degrees across, from {source}", camera.fx)
    });
    lines
}

/// A focal length that was found in the pictures [px] with the horizontal field of view that it
/// gives [degrees], its standard deviation as a share, and the focal length at first [px], in
/// words.
pub(super) fn focal_length_line(
    (found, view): (f64, f64),
    deviation: Option<f64>,
    assumed: f64,
) -> String {
    let tangent = (0.5 * view).to_radians().tan() * found / assumed;
    let assumed_view = 2.0 * tangent.atan().to_degrees();
    let deviation = deviation.map(|share| format!(" ± {:.1} %", 100.0 * share));
    format!(
        "camera: focal length {found:.1} px{}, {view:.1} degrees across, found in the pictures \
         (assumed {assumed:.1} px, {assumed_view:.1} degrees)",
        deviation.unwrap_or_default(),
    )
}

impl FoundCamera {
    /// What a front end made of the camera of a sequence.
    pub(crate) fn of(sequence: &Sequence, found: &OdometryReconstruction) -> Self {
        Self {
            source: sequence.camera_source.clone(),
            assumed: sequence.camera.fx,
            found: found.camera.fx,
            searched: sequence.camera_is_guess,
            deviation: found.focal_deviation,
            field_of_view: found.camera.horizontal_field_of_view().to_degrees(),
            readout: found.rolling_shutter_readout,
            lens_searched: found.distortion.is_some(),
            lens: found
                .distortion
                .filter(|lens| *lens != [0.0; 2])
                .map(|lens| sequence.estimated_camera(&found.camera, lens)),
        }
    }

    /// Camera and lens that the pictures are to be freed of.
    pub(crate) fn lens(&self) -> Option<&EstimatedCamera> {
        self.lens.as_ref()
    }

    /// What was found, in words.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.searched {
            let found = (self.found, self.field_of_view);
            lines.push(focal_length_line(found, self.deviation, self.assumed));
        }
        lines.extend(self.lens_line());
        if self.readout != 0.0 {
            let milliseconds = 1e3 * self.readout;
            lines.push(format!("rolling shutter: rows read in {milliseconds:.1} ms"));
        }
        lines
    }

    /// What was found of the lens, if it was looked for.
    fn lens_line(&self) -> Option<String> {
        match self.lens {
            Some(EstimatedCamera { distortion: [k1, k2], .. }) => {
                Some(format!("lens distortion: k1 {k1:.4}, k2 {k2:.4} found in the pictures"))
            }
            None => self
                .lens_searched
                .then(|| "lens distortion: not found in the pictures, none is assumed".to_owned()),
        }
    }

    /// The same as figures.
    pub(crate) fn fill(&self, metrics: &mut Metrics) {
        metrics.camera_source = Some(self.source.clone());
        metrics.focal_length_assumed_px = self.searched.then_some(self.assumed);
        metrics.focal_length_deviation = self.deviation;
        metrics.lens_distortion = self.lens.map(|lens| lens.distortion);
        if metrics.rolling_shutter_readout_s == 0.0 {
            metrics.rolling_shutter_readout_s = self.readout;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focal_lengths_are_told_with_the_views_that_they_give() {
        let line = focal_length_line((320.0, 90.0), Some(0.004), 640.0);
        assert!(line.contains("320.0 px ± 0.4 %, 90.0 degrees across"), "{line}");
        assert!(line.contains("(assumed 640.0 px, 53.1 degrees)"), "{line}");
        assert!(!focal_length_line((320.0, 90.0), None, 320.0).contains('±'));
    }
}
