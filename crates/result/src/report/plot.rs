//! Line plots as inline SVG. Colours are classes of the page's style sheet, so that one plot
//! serves the light and the dark page.

use super::axis::Axis;
use std::fmt::Write;

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 250.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 40.0;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mark {
    Line,
    Dashed,
    /// A broad pale line, to lie under another curve.
    Under,
    /// A line with the area to the axis filled.
    Area,
}

impl Mark {
    /// The style's class, with a leading space.
    fn class(self) -> &'static str {
        match self {
            Self::Line | Self::Area => "",
            Self::Dashed => " dashed",
            Self::Under => " under",
        }
    }
}

/// One curve. Points that are not finite interrupt it.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    pub(crate) label: String,
    /// Colour class: `c1` to `c4`, `red`, `green`, `blue`.
    pub(crate) colour: &'static str,
    pub(crate) mark: Mark,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Series {
    pub(crate) fn line(label: &str, colour: &'static str, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.to_owned(), colour, mark: Mark::Line, points }
    }

    pub(crate) fn marked(self, mark: Mark) -> Self {
        Self { mark, ..self }
    }
}

/// A plot: title, one line of explanation, axes, curves.
#[derive(Clone, Debug)]
pub(crate) struct Plot {
    pub(crate) title: &'static str,
    pub(crate) explanation: String,
    pub(crate) x_label: &'static str,
    pub(crate) y_label: &'static str,
    /// Whether the vertical axis begins at zero.
    pub(crate) from_zero: bool,
    /// Whether both axes have one scale (maps seen from above).
    pub(crate) equal_scales: bool,
    pub(crate) series: Vec<Series>,
    /// Points to mark: text, x, y.
    pub(crate) marks: Vec<(&'static str, f64, f64)>,
}

/// The two axes, and where values land in the drawing.
struct Frame {
    x: Axis,
    y: Axis,
}

impl Frame {
    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let across = LEFT + self.x.share(x) * (WIDTH - LEFT - RIGHT);
        let down = HEIGHT - BOTTOM - self.y.share(y) * (HEIGHT - TOP - BOTTOM);
        (across, down)
    }
}

impl Plot {
    /// The plot as an HTML figure.
    pub(crate) fn html(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        self.write(&mut out).ok();
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let frame = self.frame();
        write!(
            out,
            "<figure class=\"plot\"><figcaption><h3>{}</h3><p>{}</p>",
            self.title, self.explanation
        )?;
        self.write_legend(out)?;
        write!(
            out,
            "</figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\" \
             data-x=\"{},{}\" data-y=\"{},{}\" data-box=\"{LEFT},{TOP},{},{}\">",
            self.title,
            frame.x.low,
            frame.x.high,
            frame.y.low,
            frame.y.high,
            WIDTH - RIGHT,
            HEIGHT - BOTTOM,
        )?;
        self.write_axes(out, &frame)?;
        for series in &self.series {
            write_series(out, &frame, series)?;
        }
        for &(text, x, y) in &self.marks {
            let (x, y) = frame.place((x, y));
            write!(out, "<circle class=\"mark\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/>")?;
            write!(
                out,
                "<text class=\"name\" x=\"{:.1}\" y=\"{:.1}\">{text}</text>",
                x + 7.0,
                y - 6.0
            )?;
        }
        write!(out, "</svg></figure>")
    }

    fn frame(&self) -> Frame {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let zero = self.from_zero.then_some(0.0);
        if self.equal_scales {
            return equal_frame(points().copied());
        }
        Frame {
            x: Axis::over(points().map(|p| p.0), 5, true),
            y: Axis::over(points().map(|p| p.1).chain(zero), 4, false),
        }
    }

    fn write_legend(&self, out: &mut String) -> std::fmt::Result {
        if self.series.len() < 2 {
            return Ok(());
        }
        write!(out, "<p class=\"legend\">")?;
        for s in &self.series {
            let (colour, style) = (s.colour, s.mark.class());
            write!(out, "<span><i class=\"{colour}{style}\"></i>{}</span>", s.label)?;
        }
        write!(out, "</p>")
    }

    fn write_axes(&self, out: &mut String, frame: &Frame) -> std::fmt::Result {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for &tick in &frame.y.ticks {
            let (_, y) = frame.place((frame.x.low, tick));
            write!(out, "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right}\"/>")?;
            let label = frame.y.label(tick);
            write!(
                out,
                "<text class=\"end\" x=\"{}\" y=\"{:.1}\">{label}</text>",
                LEFT - 7.0,
                y + 4.0
            )?;
        }
        for &tick in &frame.x.ticks {
            let (x, _) = frame.place((tick, frame.y.low));
            write!(out, "<path class=\"grid\" d=\"M{x:.1} {TOP}V{bottom}\"/>")?;
            let label = frame.x.label(tick);
            write!(out, "<text class=\"mid\" x=\"{x:.1}\" y=\"{}\">{label}</text>", bottom + 16.0)?;
        }
        let centre = f64::midpoint(LEFT, right);
        let middle = f64::midpoint(TOP, bottom);
        write!(
            out,
            "<text class=\"mid name\" x=\"{centre}\" y=\"{}\">{}</text>",
            HEIGHT - 6.0,
            self.x_label
        )?;
        write!(
            out,
            "<text class=\"mid name\" transform=\"translate(12 {middle}) rotate(-90)\">{}</text>",
            self.y_label
        )
    }
}

/// Axes of one scale around all points, centred.
fn equal_frame(points: impl Iterator<Item = (f64, f64)> + Clone) -> Frame {
    let x = Axis::over(points.clone().map(|p| p.0), 4, true);
    let y = Axis::over(points.map(|p| p.1), 4, true);
    let (across, down) = (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
    let unit = 1.1 * ((x.high - x.low) / across).max((y.high - y.low) / down).max(1e-4);
    let around = |axis: &Axis, size: f64, count: usize| {
        let centre = f64::midpoint(axis.low, axis.high);
        Axis::between(centre - 0.5 * unit * size, centre + 0.5 * unit * size, count, true)
    };
    Frame { x: around(&x, across, 6), y: around(&y, down, 4) }
}

fn write_series(out: &mut String, frame: &Frame, series: &Series) -> std::fmt::Result {
    let finite = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
    for run in series.points.split(|p| !finite(p)).filter(|run| !run.is_empty()) {
        let placed: Vec<_> = run.iter().map(|&p| frame.place(p)).collect();
        let list: Vec<String> = placed.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let list = list.join(" ");
        if series.mark == Mark::Area {
            let base = HEIGHT - BOTTOM;
            let (first, last) = (placed[0].0, placed[placed.len() - 1].0);
            write!(
                out,
                "<polygon class=\"area {}\" points=\"{first:.1},{base} {list} {last:.1},{base}\"/>",
                series.colour
            )?;
        }
        let style = series.mark.class();
        write!(
            out,
            "<polyline class=\"line {}{style}\" data-name=\"{}\" points=\"{list}\"/>",
            series.colour, series.label
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<(f64, f64)>, equal_scales: bool) -> Plot {
        Plot {
            title: "Blur",
            explanation: String::new(),
            x_label: "frame",
            y_label: "px",
            from_zero: true,
            equal_scales,
            series: vec![Series::line("blur", "c1", points)],
            marks: vec![],
        }
    }

    #[test]
    fn a_gap_splits_the_line() {
        let svg = plot(vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0)], false).html();
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn equal_scales_keep_shapes() {
        let square = vec![(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let frame = plot(square, true).frame();
        let (a, b, c) = (frame.place((0.0, 0.0)), frame.place((1.0, 0.0)), frame.place((0.0, 1.0)));
        assert!(((b.0 - a.0) - (a.1 - c.1)).abs() < 1e-9);
        assert!(c.1 >= TOP && a.1 <= HEIGHT - BOTTOM);
    }

    #[test]
    fn no_points_at_all_still_draw_axes() {
        let svg = plot(vec![], false).html();
        assert!(svg.contains("</svg>") && !svg.contains("NaN") && !svg.contains("inf"));
    }
}
