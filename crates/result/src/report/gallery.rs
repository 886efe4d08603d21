//! Pictures of the report: before and after, and one frame at several exposures.

use super::Report;
use crate::html::{data_address, escape};
use crate::numbers::significant;
use crate::{UnitOfLength, VIEWER_FILE};
use i2slam::FrameEstimate;
use i2slam::geometry::Image;
use std::fmt::Write;

/// The pictures of one frame. Planes R, G, B in `[0, 1]`.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The frame's position in the associated stream.
    pub index: usize,
    /// The input picture.
    pub input: Image<f32>,
    /// The map at mid-exposure, formed without blur.
    pub sharp: Image<f32>,
    /// The picture predicted by image formation, blur included.
    pub blurred: Image<f32>,
    /// Depth at mid-exposure [m]; 0 where there is none.
    pub depth: Image<f32>,
    /// The sharp picture at other exposures, as (stops, picture); empty where it is not shown.
    pub brackets: Vec<(f64, Image<f32>)>,
}

/// Sliders with the input on the left and one of three renders on the right; the most blurred frame
/// is shown first.
pub(super) fn gallery(report: &Report<'_>) -> String {
    let frames = &report.reconstruction.frames;
    let estimate = |c: &Comparison| frames.iter().find(|f| f.index == c.index);
    let blur = |c: &Comparison| estimate(c).map_or(0.0, |f| f.blur_length);
    let first = report.comparisons.iter().max_by(|a, b| blur(a).total_cmp(&blur(b)));
    let first = first.map(|c| c.index);
    let mut out = String::new();
    for comparison in report.comparisons {
        let shown = Some(comparison.index) == first;
        // Writing to a string cannot fail.
        let unit = report.reconstruction.unit_of_length;
        let name = report.files.name(comparison.index);
        write_pair(&mut out, (comparison, estimate(comparison), &name), shown, unit).ok();
    }
    out
}

fn write_pair(
    out: &mut String,
    (comparison, estimate, name): (&Comparison, Option<&FrameEstimate>, &str),
    shown: bool,
    unit: UnitOfLength,
) -> std::fmt::Result {
    let Image { width, height, .. } = comparison.input;
    let index = comparison.index;
    let class = if shown { "pair shown" } else { "pair" };
    write!(out, "<figure class=\"{class}\" data-frame=\"{index}\">")?;
    write!(out, "<div class=\"compare\" style=\"aspect-ratio:{width}/{height}\">")?;
    let right = [
        ("sharp", "sharp render", data_address(&comparison.sharp)),
        ("blurred", "predicted blur", data_address(&comparison.blurred)),
        ("depth", "depth", data_address(&depth_colours(&comparison.depth))),
    ];
    for (kind, what, address) in right {
        write!(out, "<img class=\"{kind}\" alt=\"{what} of frame {index}\" src=\"{address}\">")?;
    }
    let input = data_address(&comparison.input);
    write!(
        out,
        "<img class=\"input\" alt=\"input frame {index}\" src=\"{input}\"><span class=\"bar\"></span>\
         <span class=\"tag left\">input</span><span class=\"tag right\"></span>\
         <input type=\"range\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" \
         aria-label=\"share of the input picture\"></div>"
    )?;
    write!(out, "<figcaption>Frame {}", escape(name))?;
    if let Some(frame) = estimate.filter(|frame| frame.refined) {
        let exposure = significant(f64::from(frame.tone.exposure()));
        let blur = frame.blur_length;
        write!(out, ": blur {blur:.1} px, exposure {exposure} times that of the first frame")?;
    }
    if let Some([near, far]) = depth_range(&comparison.depth) {
        let [near, far] = [near, far].map(|d| significant(f64::from(d)));
        let unit = match unit {
            UnitOfLength::Metre => " m",
            UnitOfLength::Keyframes | UnitOfLength::Unknown => "",
        };
        write!(out, "; depth from {near}{unit} (light) to {far}{unit} (dark)")?;
    }
    write!(out, "</figcaption></figure>")
}

/// The viewer page, opened in place by a button, or why there is none.
pub(super) fn viewer(report: &Report<'_>, exists: bool) -> String {
    match report.viewer {
        Ok(bytes) if exists => {
            let megabytes = significant(bytes as f64 * 1e-6);
            format!(
                "<div class=\"walk\"><button type=\"button\">Open here</button></div>\
                 <p>Or <a href=\"{VIEWER_FILE}\">on a page of its own</a>: {VIEWER_FILE}, {megabytes} \
                 MB, which needs nothing else.</p>"
            )
        }
        Ok(_) => format!("<p class=\"none\">{VIEWER_FILE} could not be written.</p>"),
        Err(reason) => format!("<p class=\"none\">No 3D view: {reason}.</p>"),
    }
}

/// The first frame with pictures at other exposures, darker and brighter than it was taken.
pub(super) fn brackets(comparisons: &[Comparison], is_toned: bool) -> String {
    let Some(comparison) = comparisons.iter().find(|c| !c.brackets.is_empty()) else {
        let reason = match is_toned {
            true => "no frame was rendered",
            false => "exposure, white balance and camera response were switched off",
        };
        return format!("<p class=\"none\">This run has no high dynamic range: {reason}.</p>");
    };
    let mut out = String::from("<div class=\"brackets\">");
    for (stops, picture) in &comparison.brackets {
        let name = match *stops {
            s if s < 0.0 => format!("\u{2212}{} EV", -s),
            s if s > 0.0 => format!("+{s} EV"),
            _ => "as taken".to_owned(),
        };
        let address = data_address(picture);
        let index = comparison.index;
        write!(
            out,
            "<figure><img alt=\"frame {index}, {name}\" src=\"{address}\">\
             <figcaption>{name}</figcaption></figure>"
        )
        .ok();
    }
    out + "</div>"
}

/// Colours of depth: near is warm, far is cool, dark where there is none.
fn depth_colours(depth: &Image<f32>) -> Image<f32> {
    let [near, far] = depth_range(depth).unwrap_or([1.0; 2]);
    let mut colours = Image::new(depth.width, depth.height, 3);
    for (i, &d) in depth.plane(0).iter().enumerate() {
        let share = ((d - near) / (far - near).max(1e-6)).clamp(0.0, 1.0);
        let colour = if d > 0.0 { warm_to_cool(share) } else { [0.06, 0.07, 0.09] };
        for (channel, value) in colour.into_iter().enumerate() {
            colours.plane_mut(channel)[i] = value;
        }
    }
    colours
}

/// Depth at both ends of the colours: the 2nd and 98th percentile of what there is.
fn depth_range(depth: &Image<f32>) -> Option<[f32; 2]> {
    let mut valid: Vec<f32> = depth.plane(0).iter().copied().filter(|&d| d > 0.0).collect();
    valid.sort_by(f32::total_cmp);
    let quantile = |q: f64| valid.get((q * valid.len() as f64) as usize).copied();
    Some([quantile(0.02)?, quantile(0.98)?])
}

/// Colour map from 0 (near) to 1 (far): sand, coral, violet, night blue.
fn warm_to_cool(share: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 4] =
        [[0.99, 0.91, 0.70], [0.93, 0.50, 0.42], [0.48, 0.25, 0.52], [0.10, 0.12, 0.32]];
    let at = share * 3.0;
    let i = (at as usize).min(2);
    let u = at - i as f32;
    std::array::from_fn(|c| STOPS[i][c] * (1.0 - u) + STOPS[i + 1][c] * u)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_without_readings_is_dark() {
        let colours = depth_colours(&Image::new(4, 3, 1));
        assert!(colours.data.iter().all(|&v| v < 0.1));
        assert_eq!(depth_range(&Image::new(4, 3, 1)), None);
    }

    #[test]
    fn depth_ranges_over_what_there_is() {
        let mut depth = Image::new(102, 1, 1);
        depth.data.iter_mut().enumerate().for_each(|(i, d)| *d = i.saturating_sub(1) as f32);
        assert_eq!(depth_range(&depth), Some([3.0, 99.0]));
    }
}
