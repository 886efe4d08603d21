//! Points with error bars, joined in series, as inline SVG in the style of the reports.

use i2slam_result::report::{Axis, escape};
use std::fmt::Write;

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 290.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 44.0;

/// Of a point; a shorter error bar is not drawn.
const RADIUS: f64 = 4.5;

/// Colour classes of the style sheet.
const COLOURS: [&str; 8] = ["c1", "c2", "c3", "c4", "red", "green", "blue", "grey"];

/// One configuration.
pub(crate) struct Point {
    pub(crate) name: String,
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Half the length of the error bar.
    pub(crate) spread: f64,
}

/// Points joined by a line.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) points: Vec<Point>,
}

/// A plot of one figure over another.
pub(crate) struct Plot {
    pub(crate) title: String,
    pub(crate) explanation: String,
    pub(crate) x_label: String,
    pub(crate) y_label: String,
    /// Whether the vertical axis begins at zero.
    pub(crate) from_zero: bool,
    /// Whether the horizontal axis may be logarithmic.
    pub(crate) may_be_logarithmic: bool,
    pub(crate) series: Vec<Series>,
}

/// A range with ticks, linear or logarithmic.
struct Scale {
    low: f64,
    high: f64,
    logarithmic: bool,
    ticks: Vec<(f64, String)>,
}

impl Scale {
    fn linear(values: impl Iterator<Item = f64>, count: usize) -> Self {
        let axis = Axis::over(values, count, false);
        let ticks = axis.ticks.iter().map(|&tick| (tick, axis.label(tick))).collect();
        Self { low: axis.low, high: axis.high, logarithmic: false, ticks }
    }

    /// With ticks at 1, 2 and 5 times powers of ten; needs positive values.
    fn logarithmic(low: f64, high: f64) -> Self {
        let (low, high) = (low / 1.3, high * 1.3);
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let ticks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|m| m * 10_f64.powi(decade)));
        let ticks = ticks.filter(|tick| (low..=high).contains(tick));
        let label =
            |tick: f64| (tick, format!("{tick:.*}", (-tick.log10()).ceil().max(0.0) as usize));
        Self { low, high, logarithmic: true, ticks: ticks.map(label).collect() }
    }

    /// Where a value lies, 0 at `low` and 1 at `high`.
    fn share(&self, value: f64) -> f64 {
        if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }
}

/// The two scales.
struct Frame {
    x: Scale,
    y: Scale,
}

impl Frame {
    fn across(&self, x: f64) -> f64 {
        LEFT + self.x.share(x) * (WIDTH - LEFT - RIGHT)
    }

    fn down(&self, y: f64) -> f64 {
        HEIGHT - BOTTOM - self.y.share(y) * (HEIGHT - TOP - BOTTOM)
    }
}

impl Plot {
    /// The plot as an HTML figure; nothing where there is no point.
    pub(crate) fn html(&self) -> String {
        let mut out = String::new();
        if self.series.iter().any(|series| !series.points.is_empty()) {
            // Writing to a string cannot fail.
            self.write(&mut out).ok();
        }
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let frame = self.frame();
        let (title, explanation) = (escape(&self.title), escape(&self.explanation));
        write!(out, "<figure class=\"plot\"><figcaption><h3>{title}</h3><p>{explanation}</p>")?;
        write!(out, "<p class=\"legend\">")?;
        for (place, series) in self.series.iter().enumerate() {
            write!(
                out,
                "<span><svg class=\"key\" viewBox=\"-7 -7 14 14\">{}</svg>{}</span>",
                glyph(place, 0.0, 0.0),
                escape(&series.name)
            )?;
        }
        write!(out, "</p></figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" ")?;
        write!(out, "aria-label=\"{title}\">")?;
        self.write_axes(out, &frame)?;
        for (place, series) in self.series.iter().enumerate() {
            write_series(out, &frame, place, series)?;
        }
        write!(out, "</svg></figure>")
    }

    fn frame(&self) -> Frame {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let across = || points().map(|point| point.x);
        let (low, high) = (across().fold(f64::INFINITY, f64::min), across().fold(0.0, f64::max));
        let x = if self.may_be_logarithmic && low > 0.0 && high > 8.0 * low {
            Scale::logarithmic(low, high)
        } else {
            Scale::linear(across().chain([0.0]), 5)
        };
        let ends = points().flat_map(|point| [point.y - point.spread, point.y + point.spread]);
        let ends = ends.map(|y| if self.from_zero { y.max(0.0) } else { y });
        Frame { x, y: Scale::linear(ends.chain(self.from_zero.then_some(0.0)), 4) }
    }

    fn write_axes(&self, out: &mut String, frame: &Frame) -> std::fmt::Result {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for (tick, label) in &frame.y.ticks {
            let y = frame.down(*tick);
            write!(out, "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right}\"/>")?;
            let (x, y) = (LEFT - 7.0, y + 4.0);
            write!(out, "<text class=\"end\" x=\"{x}\" y=\"{y:.1}\">{label}</text>")?;
        }
        for (tick, label) in &frame.x.ticks {
            let x = frame.across(*tick);
            write!(out, "<path class=\"grid\" d=\"M{x:.1} {TOP}V{bottom}\"/>")?;
            let y = bottom + 16.0;
            write!(out, "<text class=\"mid\" x=\"{x:.1}\" y=\"{y}\">{label}</text>")?;
        }
        let (centre, middle) = (f64::midpoint(LEFT, right), f64::midpoint(TOP, bottom));
        let (x_label, y_label) = (escape(&self.x_label), escape(&self.y_label));
        let low = HEIGHT - 8.0;
        write!(out, "<text class=\"mid name\" x=\"{centre}\" y=\"{low}\">{x_label}</text>")?;
        write!(
            out,
            "<text class=\"mid name\" transform=\"translate(12 {middle}) rotate(-90)\">{y_label}</text>"
        )
    }
}

fn write_series(
    out: &mut String,
    frame: &Frame,
    place: usize,
    series: &Series,
) -> std::fmt::Result {
    let colour = COLOURS[place % COLOURS.len()];
    let placed = series.points.iter().map(|p| (frame.across(p.x), frame.down(p.y)));
    let list: Vec<String> = placed.map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    if list.len() > 1 {
        write!(out, "<polyline class=\"line {colour}\" points=\"{}\"/>", list.join(" "))?;
    }
    for point in &series.points {
        let (x, y) = (frame.across(point.x), frame.down(point.y));
        let low = frame.down((point.y - point.spread).max(frame.y.low));
        let high = frame.down(point.y + point.spread);
        if low - high > 2.0 * RADIUS {
            write!(
                out,
                "<path class=\"line {colour}\" d=\"M{x:.1} {low:.1}V{high:.1}M{0:.1} {low:.1}h8M{0:.1} \
                 {high:.1}h8\"/>",
                x - 4.0
            )?;
        }
        let name = escape(&point.name);
        write!(out, "<g><title>{name}: {:.3}, {:.4}</title>", point.x, point.y)?;
        write!(out, "{}</g>", glyph(place, x, y))?;
    }
    Ok(())
}

/// Series differ in colour and, so that they can be told apart without it, in shape.
fn glyph(place: usize, x: f64, y: f64) -> String {
    let colour = COLOURS[place % COLOURS.len()];
    let shape = match (place + place / COLOURS.len()) % 4 {
        0 => "m-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0z",
        1 => "m-4 -4h8v8h-8z",
        2 => "m0 -5.5l5 9h-10z",
        _ => "m0 -5.5l5.5 5.5l-5.5 5.5l-5.5 -5.5z",
    };
    format!("<path class=\"point {colour}\" d=\"M{x:.1} {y:.1}{shape}\"/>")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: &[(f64, f64)]) -> Plot {
        let point = |&(x, y): &(f64, f64)| Point { name: "n <1>".to_owned(), x, y, spread: 0.1 };
        Plot {
            title: "ATE".to_owned(),
            explanation: String::new(),
            x_label: "s".to_owned(),
            y_label: "cm".to_owned(),
            from_zero: true,
            may_be_logarithmic: true,
            series: vec![Series {
                name: "s".to_owned(),
                points: points.iter().map(point).collect(),
            }],
        }
    }

    #[test]
    fn a_wide_range_of_times_is_logarithmic() {
        let frame = plot(&[(0.4, 1.0), (32.0, 2.0)]).frame();
        assert!(frame.x.logarithmic && !plot(&[(1.0, 1.0), (2.0, 1.0)]).frame().x.logarithmic);
        let labels: Vec<&str> = frame.x.ticks.iter().map(|(_, label)| label.as_str()).collect();
        assert_eq!(labels, ["0.5", "1", "2", "5", "10", "20"]);
        let middle = frame.x.share((0.4_f64 * 32.0).sqrt());
        assert!((middle - 0.5).abs() < 1e-12);
    }

    #[test]
    fn points_are_joined_and_lie_inside() {
        let plot = plot(&[(1.0, 1.0), (2.0, 3.0)]);
        let (html, frame) = (plot.html(), plot.frame());
        assert!(
            html.contains("<polyline") && html.contains("n &lt;1&gt;") && !html.contains("NaN")
        );
        assert!(frame.across(2.0) <= WIDTH - RIGHT && frame.down(3.1) >= TOP - 0.1);
        assert!(frame.down(1.0) > frame.down(3.0), "more is higher");
    }

    #[test]
    fn nothing_to_show_is_no_plot() {
        assert_eq!(plot(&[]).html(), "");
    }
}
