//! Line and scatter plots as inline SVG. Colours are classes of the pages' style sheet, so that
//! one plot serves light and dark pages.

mod axis;

use crate::html::escape;
use axis::Axis;
use std::fmt::Write;

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 250.0;
/// Margins around the axes, in the units of the drawing.
const LEFT: f64 = 66.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 40.0;

/// Radius of a marker; a shorter error bar is not drawn.
const MARKER_RADIUS: f64 = 4.5;

/// Ratio of the largest to the smallest value from which [`Horizontal::AutoLogarithmic`] is
/// logarithmic.
const MIN_LOGARITHMIC_RATIO: f64 = 8.0;

/// Colour classes of successive series with markers.
const COLOURS: [&str; 8] = ["c1", "c2", "c3", "c4", "red", "green", "blue", "grey"];

/// A plot with title, one line of explanation, axes and series.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Heading.
    pub title: String,
    /// A sentence below the heading.
    pub explanation: String,
    /// Label of the horizontal axis, with unit.
    pub x_label: String,
    /// Label of the vertical axis, with unit.
    pub y_label: String,
    /// Range of the horizontal axis.
    pub horizontal: Horizontal,
    /// Whether the vertical axis begins at zero.
    pub from_zero: bool,
    /// The curves.
    pub series: Vec<Series>,
    /// Marked points: text, x, y.
    pub marks: Vec<(&'static str, f64, f64)>,
}

/// Range of the horizontal axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Horizontal {
    /// From the first value to the last.
    Tight,
    /// Like the vertical axis, both with one scale: paths seen from above.
    EqualScales,
    /// From zero.
    FromZero,
    /// Logarithmic where the values are positive and span a wide range, else from zero.
    AutoLogarithmic,
}

/// A curve or a set of measured points. Points that are not finite interrupt a curve.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// Colour class: `c1` to `c4`, `red`, `green`, `blue`, `grey`.
    pub colour: &'static str,
    /// Line or markers.
    pub style: Style,
    /// In the order in which they are joined.
    pub points: Vec<Point>,
}

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// A broad pale line, to lie under another one.
    Under,
    /// A line with the area to the axis filled.
    Area,
    /// Markers with error bars. The shape tells series apart without colour.
    Markers {
        /// 0 to 3: circle, square, triangle, diamond.
        shape: usize,
        /// True if a line joins them.
        are_joined: bool,
    },
}

/// A point of a series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point {
    /// Horizontal position.
    pub x: f64,
    /// Vertical position.
    pub y: f64,
    /// Half the length of the error bar.
    pub deviation: f64,
    /// Text shown when the pointer is on a marker.
    pub name: String,
}

impl Series {
    /// A line through points without error bars.
    pub fn line(
        label: &str,
        colour: &'static str,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        let points = points.into_iter().map(|(x, y)| Point { x, y, ..Point::default() });
        let (label, style) = (label.to_owned(), Style::Line);
        Self { label, colour, style, points: points.collect() }
    }

    /// Joined markers in the colour and shape of the series number `index` of a plot.
    pub fn markers(label: &str, index: usize, points: Vec<Point>) -> Self {
        Self::with_markers((label, index), points, true)
    }

    /// Markers as [`markers`](Self::markers) makes them, which no line joins.
    pub fn scattered(label: &str, index: usize, points: Vec<Point>) -> Self {
        Self::with_markers((label, index), points, false)
    }

    fn with_markers((label, index): (&str, usize), points: Vec<Point>, are_joined: bool) -> Self {
        let colour = COLOURS[index % COLOURS.len()];
        let shape = (index + index / COLOURS.len()) % 4;
        let style = Style::Markers { shape, are_joined };
        Self { label: label.to_owned(), colour, style, points }
    }

    /// The series in another style.
    #[must_use]
    pub fn styled(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

impl Style {
    /// Class of the line in the style sheet, with a leading space.
    fn class(self) -> &'static str {
        match self {
            Self::Line | Self::Area | Self::Markers { .. } => "",
            Self::Dashed => " dashed",
            Self::Under => " under",
        }
    }
}

impl Plot {
    /// The plot as an HTML figure.
    pub fn html(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        self.write(&mut out).ok();
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let (title, explanation) = (escape(&self.title), escape(&self.explanation));
        let mut points = self.series.iter().flat_map(|s| &s.points);
        if points.all(|p| !p.y.is_finite()) {
            let nothing = "<p>Nothing was estimated.</p>";
            return write!(
                out,
                "<figure class=\"plot\"><figcaption><h3>{title}</h3>{nothing}</figcaption></figure>"
            );
        }
        let axes = self.axes();
        write!(out, "<figure class=\"plot\"><figcaption><h3>{title}</h3><p>{explanation}</p>")?;
        self.write_legend(out)?;
        // The script of the report reads values back from the data attributes.
        write!(
            out,
            "</figcaption><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{title}\" \
             data-x=\"{},{}\" data-y=\"{},{}\" data-box=\"{LEFT},{TOP},{},{}\">",
            axes.x.low,
            axes.x.high,
            axes.y.low,
            axes.y.high,
            WIDTH - RIGHT,
            HEIGHT - BOTTOM,
        )?;
        self.write_axes(out, &axes)?;
        for series in &self.series {
            write_line(out, &axes, series)?;
            write_markers(out, &axes, series)?;
        }
        for &(text, x, y) in &self.marks {
            let (x, y) = axes.place(x, y);
            write!(out, "<circle class=\"mark\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/>")?;
            let (x, y) = (x + 7.0, y - 6.0);
            write!(out, "<text class=\"name\" x=\"{x:.1}\" y=\"{y:.1}\">{text}</text>")?;
        }
        write!(out, "</svg></figure>")
    }

    fn axes(&self) -> Axes {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let xs = || points().map(|p| p.x);
        if self.horizontal == Horizontal::EqualScales {
            return Axes::equal(points());
        }
        let (min, max) = (xs().fold(f64::INFINITY, f64::min), xs().fold(0.0, f64::max));
        let is_wide = min > 0.0 && max > MIN_LOGARITHMIC_RATIO * min;
        let x = match self.horizontal {
            Horizontal::AutoLogarithmic if is_wide => Axis::logarithmic(min, max),
            Horizontal::Tight | Horizontal::EqualScales => Axis::over(xs(), 5, true),
            Horizontal::FromZero | Horizontal::AutoLogarithmic => {
                Axis::over(xs().chain([0.0]), 5, false)
            }
        };
        let zero = self.from_zero.then_some(0.0);
        // An error bar alone does not draw the axis below zero.
        let floor = |y: f64| if self.from_zero { y.min(0.0) } else { f64::NEG_INFINITY };
        let ends = points().flat_map(|p| [(p.y - p.deviation).max(floor(p.y)), p.y + p.deviation]);
        Axes { x, y: Axis::over(ends.chain(zero), 4, false) }
    }

    fn write_legend(&self, out: &mut String) -> std::fmt::Result {
        let is_scatter = |s: &Series| matches!(s.style, Style::Markers { .. });
        if self.series.len() < 2 && !self.series.iter().any(is_scatter) {
            return Ok(());
        }
        write!(out, "<p class=\"legend\">")?;
        for s in &self.series {
            let key = match s.style {
                Style::Markers { shape, .. } => {
                    let marker = marker(s.colour, shape, 0.0, 0.0);
                    format!("<svg class=\"key\" viewBox=\"-7 -7 14 14\">{marker}</svg>")
                }
                style => format!("<i class=\"{}{}\"></i>", s.colour, style.class()),
            };
            write!(out, "<span>{key}{}</span>", escape(&s.label))?;
        }
        write!(out, "</p>")
    }

    fn write_axes(&self, out: &mut String, axes: &Axes) -> std::fmt::Result {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for &tick in &axes.y.ticks {
            let (_, y) = axes.place(axes.x.low, tick);
            write!(out, "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right}\"/>")?;
            let (label, x, y) = (axes.y.label(tick), LEFT - 7.0, y + 4.0);
            write!(out, "<text class=\"end\" x=\"{x}\" y=\"{y:.1}\">{label}</text>")?;
        }
        for &tick in &axes.x.ticks {
            let (x, _) = axes.place(tick, axes.y.low);
            write!(out, "<path class=\"grid\" d=\"M{x:.1} {TOP}V{bottom}\"/>")?;
            let (label, y) = (axes.x.label(tick), bottom + 16.0);
            write!(out, "<text class=\"mid\" x=\"{x:.1}\" y=\"{y}\">{label}</text>")?;
        }
        let (centre, middle) = (f64::midpoint(LEFT, right), f64::midpoint(TOP, bottom));
        let (x_label, y_label, y) = (escape(&self.x_label), escape(&self.y_label), HEIGHT - 6.0);
        write!(out, "<text class=\"mid name\" x=\"{centre}\" y=\"{y}\">{x_label}</text>")?;
        write!(
            out,
            "<text class=\"mid name\" transform=\"translate(12 {middle}) rotate(-90)\">{y_label}</text>"
        )
    }
}

/// The line of a series, in pieces between points that are not finite, and its area.
fn write_line(out: &mut String, axes: &Axes, series: &Series) -> std::fmt::Result {
    let is_finite = |p: &Point| p.x.is_finite() && p.y.is_finite();
    let has_markers = match series.style {
        Style::Markers { are_joined: false, .. } => return Ok(()),
        style => matches!(style, Style::Markers { .. }),
    };
    let (colour, class, label) = (series.colour, series.style.class(), escape(&series.label));
    for piece in series.points.split(|p| !is_finite(p)) {
        if piece.is_empty() || has_markers && piece.len() == 1 {
            continue;
        }
        let placed: Vec<_> = piece.iter().map(|p| axes.place(p.x, p.y)).collect();
        let list: Vec<String> = placed.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let list = list.join(" ");
        if series.style == Style::Area {
            let base = HEIGHT - BOTTOM;
            let (first, last) = (placed[0].0, placed[placed.len() - 1].0);
            write!(
                out,
                "<polygon class=\"area {colour}\" points=\"{first:.1},{base} {list} {last:.1},{base}\"/>"
            )?;
        }
        write!(
            out,
            "<polyline class=\"line {colour}{class}\" data-name=\"{label}\" points=\"{list}\"/>"
        )?;
    }
    Ok(())
}

fn write_markers(out: &mut String, axes: &Axes, series: &Series) -> std::fmt::Result {
    let Style::Markers { shape, .. } = series.style else { return Ok(()) };
    let colour = series.colour;
    for point in &series.points {
        let (x, y) = axes.place(point.x, point.y);
        let (_, low) = axes.place(point.x, (point.y - point.deviation).max(axes.y.low));
        let (_, high) = axes.place(point.x, point.y + point.deviation);
        if low - high > 2.0 * MARKER_RADIUS {
            let left = x - 4.0;
            write!(
                out,
                "<path class=\"line {colour}\" d=\"M{x:.1} {low:.1}V{high:.1}M{left:.1} {low:.1}h8\
                 M{left:.1} {high:.1}h8\"/>"
            )?;
        }
        let name = escape(&point.name);
        write!(out, "<g><title>{name}: {:.3}, {:.4}</title>", point.x, point.y)?;
        write!(out, "{}</g>", marker(colour, shape, x, y))?;
    }
    Ok(())
}

fn marker(colour: &str, shape: usize, x: f64, y: f64) -> String {
    let outline = match shape {
        0 => "m-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0z",
        1 => "m-4 -4h8v8h-8z",
        2 => "m0 -5.5l5 9h-10z",
        _ => "m0 -5.5l5.5 5.5l-5.5 5.5l-5.5 -5.5z",
    };
    format!("<path class=\"point {colour}\" d=\"M{x:.1} {y:.1}{outline}\"/>")
}

/// The two axes.
struct Axes {
    x: Axis,
    y: Axis,
}

impl Axes {
    /// Position of a value in the drawing.
    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        let across = LEFT + self.x.fraction(x) * (WIDTH - LEFT - RIGHT);
        let down = HEIGHT - BOTTOM - self.y.fraction(y) * (HEIGHT - TOP - BOTTOM);
        (across, down)
    }

    /// Axes of one scale around all points, centred.
    fn equal<'a>(points: impl Iterator<Item = &'a Point> + Clone) -> Self {
        let x = Axis::over(points.clone().map(|p| p.x), 4, true);
        let y = Axis::over(points.map(|p| p.y), 4, true);
        let (across, down) = (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
        let unit = 1.1 * ((x.high - x.low) / across).max((y.high - y.low) / down).max(1e-4);
        let around = |axis: &Axis, size: f64, count: usize| {
            let centre = f64::midpoint(axis.low, axis.high);
            Axis::between(centre - 0.5 * unit * size, centre + 0.5 * unit * size, count, true)
        };
        Self { x: around(&x, across, 6), y: around(&y, down, 4) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(series: Series, horizontal: Horizontal) -> Plot {
        Plot {
            title: "Blur".to_owned(),
            explanation: String::new(),
            x_label: "frame".to_owned(),
            y_label: "px".to_owned(),
            horizontal,
            from_zero: true,
            series: vec![series],
            marks: vec![],
        }
    }

    fn line(points: &[(f64, f64)], horizontal: Horizontal) -> Plot {
        plot(Series::line("blur", "c1", points.iter().copied()), horizontal)
    }

    fn scatter(points: &[(f64, f64)]) -> Plot {
        let name = "n <1>".to_owned();
        let point = |&(x, y): &(f64, f64)| Point { x, y, deviation: 0.1, name: name.clone() };
        let series = Series::markers("s", 0, points.iter().map(point).collect());
        plot(series, Horizontal::AutoLogarithmic)
    }

    #[test]
    fn a_plot_of_nothing_says_so() {
        for nothing in [&[][..], &[(0.0, f64::NAN), (1.0, f64::NAN)]] {
            let plot = line(nothing, Horizontal::Tight).html();
            assert!(plot.contains("Nothing was estimated") && !plot.contains("<svg"), "{plot}");
        }
        let zero = line(&[(0.0, 0.0), (1.0, 0.0)], Horizontal::Tight).html();
        assert!(zero.contains("</svg>") && !zero.contains("NaN") && !zero.contains("inf"));
    }

    #[test]
    fn a_gap_splits_the_line() {
        let points = [(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0)];
        let svg = line(&points, Horizontal::Tight).html();
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn equal_scales_keep_shapes() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let axes = line(&square, Horizontal::EqualScales).axes();
        let (a, b, c) = (axes.place(0.0, 0.0), axes.place(1.0, 0.0), axes.place(0.0, 1.0));
        assert!(((b.0 - a.0) - (a.1 - c.1)).abs() < 1e-9);
        assert!(c.1 >= TOP && a.1 <= HEIGHT - BOTTOM);
    }

    #[test]
    fn a_wide_range_is_logarithmic() {
        let wide = scatter(&[(0.4, 1.0), (32.0, 2.0)]).axes().x;
        assert!(wide.step.is_none());
        assert!(scatter(&[(1.0, 1.0), (2.0, 1.0)]).axes().x.step.is_some());
        let labels: Vec<String> = wide.ticks.iter().map(|&tick| wide.label(tick)).collect();
        assert_eq!(labels, ["0.5", "1", "2", "5", "10", "20"]);
        assert!((wide.fraction((0.4_f64 * 32.0).sqrt()) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn markers_are_joined_and_lie_inside() {
        let plot = scatter(&[(1.0, 1.0), (2.0, 3.0)]);
        let (html, axes) = (plot.html(), plot.axes());
        assert!(html.contains("<polyline") && html.contains("n &lt;1&gt;"), "{html}");
        let (right, top) = axes.place(2.0, 3.1);
        assert!(right <= WIDTH - RIGHT && top >= TOP - 0.1);
        assert!(axes.place(1.0, 1.0).1 > axes.place(2.0, 3.0).1, "more is higher");
    }
}
