//! Black bars at the edges of pictures, as of a letterbox or a screen that was recorded: they would become
//! part of a map.

use super::frames::FrameLoader;
use crate::formats::FrameEntry;
use i2slam_geometry::Image;

/// Pictures that are looked at, and every how many frames.
const PROBES: usize = 3;
const APART: usize = 10;
/// Picture value up to which a pixel counts as black: limited range and coding leave some.
const BLACK: f32 = 12.0 / 255.0;
/// Picture value that the middle of a picture reaches, if it is lit.
const LIT: f32 = 0.2;
/// Least width of a bar over the side of the picture.
const MIN_SHARE: f64 = 0.02;
/// Picture value that so large a share of the pixels exceeds within a few lines behind a bar, whose edge is
/// straight: shadows begin by and by. Coding blurs the edge.
const BESIDE: f32 = 0.1;
const EDGE_SHARE: f64 = 0.5;
const EDGE_LINES: usize = 3;

/// A warning if all of some pictures have black bars; one that is dark altogether tells nothing.
pub(super) fn black_bars_warning(
    entries: &[FrameEntry],
    loader: &FrameLoader,
    (width, height): (usize, usize),
) -> Option<String> {
    let probes: Vec<&FrameEntry> = entries.iter().step_by(APART).take(PROBES).collect();
    // The first frame of a stream alone is looked at before others have come.
    if probes.len() < PROBES {
        return None;
    }
    let pictures = probes.into_iter().filter_map(|entry| loader.load(entry).ok());
    let lit: Vec<_> = pictures.map(|frame| frame.colour).filter(|colour| is_lit(colour)).collect();
    let colours: Vec<&Image<f32>> = lit.iter().map(AsRef::as_ref).collect();
    let bars = Bars::of(&colours)?;
    let first = colours.first()?;
    // With the line over which coding blurs the edge.
    let recorded = |bar: usize, (side, of): (usize, usize)| match bar {
        0 => 0,
        bar => ((bar + 1) * side).div_ceil(of),
    };
    let [left, right] = [bars.left, bars.right].map(|bar| recorded(bar, (width, first.width)));
    let [top, bottom] = [bars.top, bars.bottom].map(|bar| recorded(bar, (height, first.height)));
    // Most videos have even sides.
    let kept = |side: usize, bars: usize| side.saturating_sub(bars) & !1;
    let (kept_width, kept_height) = (kept(width, left + right), kept(height, top + bottom));
    Some(format!(
        "black bars become part of the map: {left}, {right}, {top} and {bottom} px at the left, right, top and \
         bottom; cut them off first, a video with ffmpeg -i IN -vf \
         crop={kept_width}:{kept_height}:{left}:{top} OUT.mp4"
    ))
}

fn is_lit(colour: &Image<f32>) -> bool {
    let lit = colour.data.iter().filter(|value| **value > LIT).count();
    lit * 4 > colour.data.len()
}

/// Widths of bars \[px\].
#[derive(Debug, PartialEq)]
struct Bars {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
}

impl Bars {
    /// Bars that all pictures have; `None` without any, or without pictures.
    fn of(colours: &[&Image<f32>]) -> Option<Self> {
        let first = colours.first()?;
        let (width, height) = (first.width, first.height);
        let bar = |length: usize, is_row: bool, is_end: bool| {
            let line = |i: usize| if is_end { length - 1 - i } else { i };
            let share = |i: usize, value: f32| share_above(value, colours, (line(i), is_row));
            let count = (0..length / 2).take_while(|i| share(*i, BLACK) == 0.0).count();
            let is_wide = count as f64 >= MIN_SHARE * length as f64;
            let behind = count..(count + EDGE_LINES).min(length);
            let has_edge = behind.into_iter().any(|i| share(i, BESIDE) > EDGE_SHARE);
            if is_wide && has_edge { count } else { 0 }
        };
        let bars = Self {
            left: bar(width, false, false),
            right: bar(width, false, true),
            top: bar(height, true, false),
            bottom: bar(height, true, true),
        };
        (bars.left + bars.right + bars.top + bars.bottom > 0).then_some(bars)
    }
}

/// Largest share of the pixels of a row or column that exceed a value, of any picture, outside of the corners.
fn share_above(value: f32, colours: &[&Image<f32>], (line, is_row): (usize, bool)) -> f64 {
    let of_picture = |colour: &&Image<f32>| {
        let length = if is_row { colour.width } else { colour.height };
        let is_lit = |i: &usize| {
            let (column, row) = if is_row { (*i, line) } else { (line, *i) };
            (0..colour.channels).any(|channel| colour.at(channel, column, row) > value)
        };
        // A quarter at either end may be bars across.
        let middle = length / 4..length - length / 4;
        let count = middle.len().max(1) as f64;
        middle.filter(is_lit).count() as f64 / count
    };
    colours.iter().map(of_picture).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (80, 60);

    /// A lit picture with black bars of such widths, darker towards the bottom by `shade`.
    fn picture([left, right, top, bottom]: [usize; 4], shade: f32) -> Image<f32> {
        let mut picture = Image::new(SIZE.0, SIZE.1, 3);
        for (i, value) in picture.data.iter_mut().enumerate() {
            let (column, row) = (i % SIZE.0, i / SIZE.0 % SIZE.1);
            let is_inside =
                (left..SIZE.0 - right).contains(&column) && (top..SIZE.1 - bottom).contains(&row);
            let noise = ((i * 7919) % 13) as f32 / 2550.0;
            *value = if is_inside { 0.5 - shade * row as f32 / SIZE.1 as f32 } else { noise };
        }
        picture
    }

    fn bars(pictures: &[Image<f32>]) -> Option<[usize; 4]> {
        let bars = Bars::of(&pictures.iter().collect::<Vec<_>>())?;
        Some([bars.left, bars.right, bars.top, bars.bottom])
    }

    #[test]
    fn bars_are_found_on_each_side() {
        for widths in [[0, 0, 7, 7], [12, 10, 0, 0], [4, 0, 0, 9]] {
            assert_eq!(bars(&[picture(widths, 0.0), picture(widths, 0.1)]), Some(widths));
        }
        // One of the pictures shows something there.
        assert_eq!(
            bars(&[picture([0, 0, 7, 7], 0.0), picture([0, 0, 0, 7], 0.0)]),
            Some([0, 0, 0, 7])
        );
    }

    #[test]
    fn pictures_without_straight_black_edges_have_none() {
        assert_eq!(bars(&[picture([0; 4], 0.0)]), None);
        assert_eq!(bars(&[]), None);
        // The floor becomes dark by and by.
        assert_eq!(bars(&[picture([0; 4], 0.499)]), None);
        // A corner in shadow.
        let mut shadow = picture([0; 4], 0.0);
        for channel in 0..3 {
            for row in 0..30 {
                let start = row * SIZE.0;
                shadow.plane_mut(channel)[start..start + 30 - row].fill(0.0);
            }
        }
        assert_eq!(bars(&[shadow]), None);
    }
}
