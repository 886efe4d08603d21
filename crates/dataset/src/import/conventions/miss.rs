//! How far depth and colour of two keyframes miss each other.

use crate::import::Keyframe;
use i2slam_geometry::{Camera, Pose, Tap};

/// Pixels of a picture that are carried over, about.
const SAMPLES: usize = 1500;

/// Pixels that must be seen again before colours are compared.
const MIN_SEEN: usize = 30;

/// Share of pixels that must be seen again before a miss says anything of the pictures.
const OVERLAP: f64 = 0.3;

/// Share of pixels that may leave the picture from one keyframe to the next.
const USUALLY_OUTSIDE: f64 = 0.3;

/// Relative difference of depths that counts as a full miss.
const MISS: f64 = 0.1;

/// How far depth and colour of a keyframe miss those of another, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Miss {
    /// Pixels out of sight beyond the usual share count as 1.
    pub(super) whole: f64,
    /// That of pixels seen again; `None` if these are few.
    pub(super) seen: Option<f64>,
}

impl Miss {
    /// Carries `a` to `b`; `None` if `a` has too little depth.
    pub(super) fn of(
        camera: &Camera<f64>,
        a: &Keyframe,
        b: &Keyframe,
        b_from_a: Pose<f64>,
    ) -> Option<Self> {
        let landed = land(camera, a, b_from_a)?;
        let colour = colour_miss(&landed, a, b);
        let depth = depth_miss(&landed, b);
        let miss = depth.map_or(colour, |depth| 0.5 * (colour + depth));
        let count = landed.iter().filter(|pixel| pixel.to.is_some()).count();
        let share = count as f64 / landed.len() as f64;
        let overlap = count >= MIN_SEEN && share >= OVERLAP;
        let whole = with_outside(miss, 1.0 - share);
        Some(Self { whole, seen: overlap.then_some(miss) })
    }
}

pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// A pixel of one picture in another one.
struct Landed {
    /// Place of the pixel in its own picture.
    from: usize,
    /// Where it lies in the other picture, and its depth there; `None`: outside.
    to: Option<(Tap<f32>, f64)>,
}

fn land(camera: &Camera<f64>, a: &Keyframe, b_from_a: Pose<f64>) -> Option<Vec<Landed>> {
    let depth = &a.depth.as_ref()?.data;
    let valid = depth.iter().filter(|&&z| z > 0.0).count();
    let every = (valid / SAMPLES).max(1);
    let chosen = depth.iter().enumerate().filter(|(_, z)| **z > 0.0).step_by(every);
    let landed = chosen.map(|(from, &z)| {
        let (u, v) = Camera::<f64>::pixel_centre(from % camera.width, from / camera.width);
        let p = b_from_a * camera.unproject(u, v, f64::from(z));
        let (u, v) = camera.project(p);
        let tap = Tap::new(camera.width, camera.height, u as f32, v as f32);
        let to = tap.filter(|_| p.z > 0.0).map(|tap| (tap, p.z));
        Landed { from, to }
    });
    let landed: Vec<Landed> = landed.collect();
    (landed.len() >= MIN_SEEN).then_some(landed)
}

/// What pixels that are seen again miss by, and 1 for the share `outside` the picture beyond the
/// usual one.
fn with_outside(miss: f64, outside: f64) -> f64 {
    let unusual = ((outside - USUALLY_OUTSIDE) / (1.0 - USUALLY_OUTSIDE)).max(0.0);
    miss * (1.0 - unusual) + unusual
}

/// Mean relative difference of depths, 0 to 1; `None` if the other depth is too sparse.
fn depth_miss(landed: &[Landed], b: &Keyframe) -> Option<f64> {
    let depth = &b.depth.as_ref()?.data;
    let seen: Vec<(Tap<f32>, f64)> = landed.iter().filter_map(|pixel| pixel.to).collect();
    let differ = |&(tap, z): &(Tap<f32>, f64)| {
        let around = tap.values(depth);
        // Inverse depth is linear over the picture of a plane.
        let inverse = || f64::from(tap.interpolate(around.map(f32::recip)).0);
        let known = around.iter().all(|&z| z > 0.0);
        known.then(|| ((inverse() * z - 1.0).abs() / MISS).min(1.0))
    };
    let met: Vec<f64> = seen.iter().filter_map(differ).collect();
    if seen.is_empty() {
        return Some(1.0);
    }
    (2 * met.len() >= seen.len()).then(|| mean(&met).unwrap_or(1.0))
}

/// `(1 - correlation) / 2` of the brightness of pixels that are seen again.
fn colour_miss(landed: &[Landed], a: &Keyframe, b: &Keyframe) -> f64 {
    let planes = |keyframe: &Keyframe, value: &dyn Fn(&[f32]) -> f32| -> f64 {
        (0..3).map(|channel| f64::from(value(keyframe.colour.plane(channel)))).sum()
    };
    let grey = |pixel: &Landed| {
        let (tap, _) = pixel.to?;
        let here = planes(a, &|plane| plane[pixel.from]);
        Some((here, planes(b, &|plane| tap.sample(plane).0)))
    };
    let seen: Vec<(f64, f64)> = landed.iter().filter_map(grey).collect();
    if seen.len() < MIN_SEEN { 1.0 } else { 0.5 * (1.0 - correlation(&seen)) }
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let count = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
    let mean = (mean.0 / count, mean.1 / count);
    let (mut both, mut first, mut second) = (0.0, 0.0, 0.0);
    for pair in pairs {
        let (x, y) = (pair.0 - mean.0, pair.1 - mean.1);
        both += x * y;
        first += x * x;
        second += y * y;
    }
    let scale = (first * second).sqrt();
    if scale > 0.0 { both / scale } else { 0.0 }
}
