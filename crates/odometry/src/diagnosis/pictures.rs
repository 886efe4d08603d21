//! Checks of the pictures themselves: one colour, and repetitions of the picture before.

use crate::warning::Warning;
use i2slam_compute::median;
use i2slam_geometry::Image;

/// Mean value below which a picture is black, about a step of eight bits.
const MIN_MEAN_VALUE: f32 = 0.004;
/// Spread of every channel below which a picture is of one colour: a step of eight bits.
const MIN_SPREAD: f32 = 1.5 / 255.0;
/// Difference from which a value has changed, half a step of eight bits, and the share of changed
/// values up to which a picture repeats another. The noise of a sensor changes half of them.
const CHANGE: f32 = 0.5 / 255.0;
const MAX_CHANGED_SHARE: f64 = 1e-3;

/// Facts about the pictures of a sequence.
#[derive(Clone, Debug, Default)]
pub(crate) struct PictureChecks {
    last: Image<f32>,
    /// Whether a frame's picture repeats that of the frame before.
    pub(crate) is_repeat: Vec<bool>,
    /// Whether a frame's picture is black or of one colour.
    pub(crate) is_blank: Vec<bool>,
    /// Number of depth pictures in time with their colour pictures, and times to the others [s].
    depth_in_time: usize,
    late_depth: Vec<f64>,
}

impl PictureChecks {
    /// Looks at the next picture.
    pub(crate) fn add(&mut self, picture: &Image<f32>) {
        let is_blank = blank_reason(picture).is_some();
        self.is_repeat.push(!is_blank && is_repetition(&self.last, picture));
        self.is_blank.push(is_blank);
        self.last.clone_from(picture);
    }

    /// Counts a depth picture taken so far from its colour picture [s].
    pub(crate) fn add_depth(&mut self, delay: f64, is_in_time: bool) {
        match is_in_time {
            true => self.depth_in_time += 1,
            false => self.late_depth.push(delay),
        }
    }

    /// Warnings of depth that came too late, or on which no length rests.
    pub(crate) fn depth_warnings(&self, is_metric: bool) -> impl Iterator<Item = Warning> {
        let late = median(&mut self.late_depth.clone())
            .map(|seconds| Warning::DepthNotInTime { count: self.late_depth.len(), seconds });
        let is_unused = self.depth_in_time > 0 && !is_metric;
        let unused = is_unused.then_some(Warning::DepthNotUsed { count: self.depth_in_time });
        late.into_iter().chain(unused)
    }
}

/// Reason why a picture shows nothing that could be mapped, if so: it is black or not a number, or of
/// one colour within a step of eight bits, as a camera without signal gives it.
pub fn blank_reason(picture: &Image<f32>) -> Option<&'static str> {
    let mean = picture.data.iter().sum::<f32>() / picture.data.len().max(1) as f32;
    if mean.is_nan() || mean < MIN_MEAN_VALUE {
        return Some("its picture is black");
    }
    let is_uniform = |channel: usize| {
        let bounds = (f32::INFINITY, f32::NEG_INFINITY);
        let widened = |(low, high): (f32, f32), v: &f32| (low.min(*v), high.max(*v));
        let (low, high) = picture.plane(channel).iter().fold(bounds, widened);
        high - low < MIN_SPREAD
    };
    (0..picture.channels).all(is_uniform).then_some("its picture is of one colour")
}

/// Whether two pictures are the same up to rounding and a few values.
fn is_repetition(first: &Image<f32>, second: &Image<f32>) -> bool {
    let size = |image: &Image<f32>| (image.width, image.height, image.channels);
    let most = (MAX_CHANGED_SHARE * second.data.len() as f64) as usize;
    let pairs = first.data.iter().zip(&second.data);
    size(first) == size(second)
        && pairs.filter(|(a, b)| (*a - *b).abs() > CHANGE).take(most + 1).count() <= most
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(noise: f32, seed: u32) -> Image<f32> {
        Image::from_fn(40, 30, 3, |channel, column, row| {
            let i = (channel * 1200 + row * 40 + column) as u32 + 7919 * seed;
            let random = (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
            0.5 + 0.3 * (0.4 * column as f32 + 0.1 * row as f32).sin() + noise * (random - 0.5)
        })
    }

    #[test]
    fn repetitions_are_told_from_a_still_camera_with_noise() {
        let mut checks = PictureChecks::default();
        let quiet = |level: f32, seed: u32| picture(level / 255.0, seed);
        let grey = Image { data: vec![0.4; 3600], ..picture(0.0, 0) };
        for next in [
            quiet(3.0, 1),
            quiet(3.0, 2),
            quiet(3.0, 2),
            quiet(0.5, 3),
            quiet(0.5, 4),
            grey.clone(),
            grey,
            picture(0.0, 5).resized_by_area(20, 15),
        ] {
            checks.add(&next);
        }
        assert_eq!(checks.is_repeat, [false, false, true, false, true, false, false, false]);
        assert_eq!(checks.is_blank, [false, false, false, false, false, true, true, false]);
    }

    #[test]
    fn pictures_without_content_have_a_reason() {
        let of = |value: f32| blank_reason(&Image { data: vec![value; 3600], ..picture(0.0, 0) });
        assert_eq!(of(0.001), Some("its picture is black"));
        assert_eq!(of(f32::NAN), Some("its picture is black"));
        assert_eq!(of(0.7), Some("its picture is of one colour"));
        assert_eq!(blank_reason(&picture(0.0, 0)), None);
    }
}
