//! Whether depths and poses fit together, and which other convention would.
//!
//! Depth of a keyframe, carried to the next one by their poses, must meet that one's depth and
//! colour. Poses read by a wrong convention miss both, and those read by the right one do not.

use super::keyframe::Keyframe;
use super::{Files, Kind};
use i2slam_geometry::{Camera, Pose, Rotation, Tap, Vec3};

/// Pairs of neighbours that are looked at.
const PAIRS: usize = 6;

/// Pixels of a picture that are carried over, about.
const SAMPLES: usize = 1500;

/// Pixels that must be seen again before colours are compared.
const LEAST_SEEN: usize = 30;

/// Share of pixels that may leave the picture from one keyframe to the next.
const USUALLY_OUTSIDE: f64 = 0.3;

/// Relative difference of depths that counts as a full miss.
const MISS: f64 = 0.1;

/// Another convention must miss by less than this share of what the given one misses by.
const BETTER: f64 = 0.6;

/// Factors of positions that are tried: powers of 2 up to this one, and their inverses.
const LARGEST_SCALE: i32 = 10;

/// Mean miss above which depths and poses do not fit at all.
const UNFIT: f64 = 0.8;

/// How poses may have been written in another way than their kind says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    /// The other way round: `world_from_camera` for `camera_from_world`.
    inverse: bool,
    /// Camera axes of OpenGL for those of OpenCV, or the other way round.
    axes: bool,
    /// Quaternions w x y z for x y z w.
    order: bool,
}

impl Reading {
    /// The given one first, the simplest before others.
    const ALL: [Self; 8] = [
        Self::new(false, false, false),
        Self::new(true, false, false),
        Self::new(false, true, false),
        Self::new(false, false, true),
        Self::new(true, true, false),
        Self::new(true, false, true),
        Self::new(false, true, true),
        Self::new(true, true, true),
    ];

    const fn new(inverse: bool, axes: bool, order: bool) -> Self {
        Self { inverse, axes, order }
    }

    /// The pose that the files hold by this reading, from the pose as it was read.
    fn of(self, world_from_camera: Pose<f64>, kind: Kind) -> Pose<f64> {
        let is_inverse = matches!(kind, Kind::Colmap | Kind::Droid);
        let mut pose = if is_inverse { world_from_camera.inverse() } else { world_from_camera };
        if self.order {
            let Rotation { w, v } = pose.rotation;
            let reordered = Rotation::from_wxyz(v.x, v.y, v.z, w);
            pose.rotation = reordered.unwrap_or(pose.rotation);
        }
        if is_inverse != self.inverse {
            pose = pose.inverse();
        }
        if self.axes {
            let half_turn = Rotation { w: 0.0, v: Vec3::new(1.0, 0.0, 0.0) };
            pose.rotation = pose.rotation * half_turn;
        }
        pose
    }

    fn words(self, kind: Kind) -> String {
        let inverse = match kind {
            Kind::Colmap | Kind::Droid => "world_from_camera",
            Kind::Nerfstudio | Kind::Trajectory => "camera_from_world",
        };
        let axes = match kind {
            Kind::Nerfstudio => "camera axes of OpenCV (y down, z forwards)",
            _ => "camera axes of OpenGL (y up, z backwards)",
        };
        let parts = [
            (self.inverse, inverse),
            (self.axes, axes),
            (self.order, "quaternions in the order w x y z"),
        ];
        let parts: Vec<&str> = parts.into_iter().filter(|part| part.0).map(|part| part.1).collect();
        parts.join(" with ")
    }
}

/// A warning if depths and poses disagree, with the convention that fits better if there is one.
pub(super) fn warning(files: &Files) -> Option<String> {
    if !files.has_depth {
        return None;
    }
    let pairs = pairs(files);
    let with =
        |reading: Reading| misses(files, &pairs, &|pose: Pose<f64>| reading.of(pose, files.kind));
    let given = with(Reading::ALL[0]);
    let percent = |miss: f64| format!("{:.0} %", 100.0 * miss);
    let mean = mean(&given)?;
    let carried = "carried to the next keyframe by the poses, depth misses it by";
    let others = Reading::ALL.into_iter().skip(1);
    let others = others.filter(|reading| !reading.order || is_quaternion(files.kind));
    if let Some((reading, better)) = best(others.map(|reading| (reading, with(reading))), &given) {
        return Some(format!(
            "wrong convention? {carried} {}, and by {} if the poses are {}: {} is expected to hold \
             {}",
            percent(mean),
            percent(better),
            reading.words(files.kind),
            files.path.display(),
            files.kind.convention()
        ));
    }
    let scales =
        (-LARGEST_SCALE..=LARGEST_SCALE).filter(|&power| power != 0).map(|p| 2_f64.powi(p));
    let scaled = |scale: f64| {
        let pose = |pose: Pose<f64>| Pose { translation: pose.translation * scale, ..pose };
        (scale, misses(files, &pairs, &pose))
    };
    if let Some((scale, better)) = best(scales.map(scaled), &given) {
        let (given, better) = (percent(mean), percent(better));
        return Some(format!(
            "depths and poses in different units? {carried} {given}, and by {better} if positions \
             are multiplied by about {scale}"
        ));
    }
    (mean > UNFIT).then(|| {
        format!(
            "depths and poses disagree: {carried} {}, and no other convention fits better; are they \
             of these pictures?",
            percent(mean)
        )
    })
}

/// The candidate that misses least and its mean miss, if that is clearly less than what is given.
fn best<T>(candidates: impl Iterator<Item = (T, Vec<f64>)>, given: &[f64]) -> Option<(T, f64)> {
    let means = candidates.filter_map(|(what, misses)| Some((what, mean(&misses)?, misses)));
    let (what, mean_miss, misses) = means.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let often = misses.iter().zip(given).filter(|(other, given)| other < given).count();
    let clearly = mean_miss < BETTER * mean(given)? && 3 * often > 2 * given.len();
    clearly.then_some((what, mean_miss))
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn is_quaternion(kind: Kind) -> bool {
    matches!(kind, Kind::Droid | Kind::Trajectory)
}

/// Neighbours, spread over all keyframes.
fn pairs(files: &Files) -> Vec<(Keyframe, Keyframe)> {
    let last = files.len().saturating_sub(1);
    let mut places: Vec<usize> = (0..PAIRS).map(|k| k * last / PAIRS).collect();
    places.dedup();
    let load = |place: usize| files.load(place).ok();
    places.into_iter().filter_map(|place| load(place).zip(load(place + 1))).collect()
}

/// How far depth and colour of every pair miss each other with other poses.
fn misses(
    files: &Files,
    pairs: &[(Keyframe, Keyframe)],
    pose: &dyn Fn(Pose<f64>) -> Pose<f64>,
) -> Vec<f64> {
    let of_pair = |(a, b): &(Keyframe, Keyframe)| {
        let b_from_a = pose(b.world_from_camera).inverse() * pose(a.world_from_camera);
        miss(&files.camera, a, b, b_from_a)
    };
    pairs.iter().filter_map(of_pair).collect()
}

/// How far depth and colour of `a` miss those of `b`, 0 to 1; `None` without depth.
fn miss(camera: &Camera<f64>, a: &Keyframe, b: &Keyframe, b_from_a: Pose<f64>) -> Option<f64> {
    let landed = land(camera, a, b_from_a)?;
    let colour = colour_miss(&landed, a, b);
    let depth = depth_miss(&landed, b);
    let miss = depth.map_or(colour, |depth| 0.5 * (colour + depth));
    Some(with_outside(miss, &landed))
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
    (landed.len() >= LEAST_SEEN).then_some(landed)
}

/// What pixels that are seen again miss by, and 1 for those out of sight beyond the usual share.
fn with_outside(miss: f64, landed: &[Landed]) -> f64 {
    let outside = landed.iter().filter(|pixel| pixel.to.is_none()).count() as f64;
    let unusual = (outside / landed.len() as f64 - USUALLY_OUTSIDE) / (1.0 - USUALLY_OUTSIDE);
    let unusual = unusual.max(0.0);
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
    if seen.len() < LEAST_SEEN { 1.0 } else { 0.5 * (1.0 - correlation(&seen)) }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_undo_what_was_written_otherwise() {
        let pose = Pose::new(Rotation::exp(Vec3::new(0.4, -0.2, 0.9)), Vec3::new(1.0, -2.0, 0.5));
        let near = |a: Pose<f64>, b: Pose<f64>| {
            let apart = a.local(b);
            assert!(apart.translation.norm() + apart.rotation.norm() < 1e-12, "{a:?} {b:?}");
        };
        for kind in Kind::ALL {
            near(Reading::ALL[0].of(pose, kind), pose);
            near(Reading::new(true, false, false).of(pose.inverse(), kind), pose);
        }
        // A file with w x y z, read as x y z w.
        let Rotation { w, v } = pose.rotation;
        let misread = Rotation::from_wxyz(v.z, w, v.x, v.y).expect("a rotation");
        let misread = Pose::new(misread, pose.translation);
        near(Reading::new(false, false, true).of(misread, Kind::Trajectory), pose);
    }
}
