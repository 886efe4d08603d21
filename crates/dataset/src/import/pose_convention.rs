//! Pose conventions: consistency of depths and poses, and the convention that explains a mismatch.
//!
//! Pixels of a keyframe, reprojected into the next one with depth and poses, must agree with its
//! depth and colour. Poses in a wrong convention agree with neither.

use super::{ImportFormat, ImportedKeyframes, Keyframe};
use i2slam_compute::correlation;
use i2slam_geometry::{Camera, Pose, Rotation, Tap, Vec3};

/// Pairs of keyframes that are compared.
const PAIRS: usize = 6;

/// Fewest comparable pairs for a warning: a single pair may disagree by occlusion alone.
const MIN_PAIRS: usize = 2;

/// Largest error of another convention, as a share of that of the given one, to be reported.
const BETTER_RATIO: f64 = 0.6;

/// Largest scale of positions that is tried, as a power of 2; also its inverse.
const MAX_SCALE_EXPONENT: i32 = 10;

/// Mean error of overlapping pixels above which depths and poses disagree whatever the convention:
/// unrelated colours have an error of 0.5, unrelated depths of nearly 1.
const MAX_OVERLAP_ERROR: f64 = 0.6;

/// Pixels reprojected per pair, approximately.
const SAMPLES: usize = 1500;

/// Fewest overlapping pixels for a comparison of colours.
const MIN_OVERLAP_PIXELS: usize = 30;

/// Smallest share of overlapping pixels for an error of the overlap alone.
const MIN_OVERLAP: f64 = 0.3;

/// Share of pixels that leave the image between neighbouring keyframes without penalty.
const USUAL_SHARE_OUTSIDE: f64 = 0.3;

/// Relative difference of depths that counts as an error of 1.
const FULL_DEPTH_ERROR: f64 = 0.1;

/// Deviation of a file's poses from the convention of its format.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PoseConvention {
    /// Inverted: `world_from_camera` for `camera_from_world` or vice versa.
    inverse: bool,
    /// Camera axes of OpenGL for those of OpenCV or vice versa.
    axes: bool,
    /// Quaternions w x y z for x y z w.
    order: bool,
}

impl PoseConvention {
    /// All conventions, that of the format first, the simplest before others.
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

    /// Reinterprets a pose that was read by the convention of the format.
    fn reinterpret(self, world_from_camera: Pose<f64>, format: ImportFormat) -> Pose<f64> {
        let is_inverse = matches!(format, ImportFormat::Colmap | ImportFormat::Droid);
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

    /// Description for messages.
    fn description(self, format: ImportFormat) -> String {
        let inverse = match format {
            ImportFormat::Colmap | ImportFormat::Droid => "world_from_camera",
            ImportFormat::Nerfstudio | ImportFormat::Trajectory => "camera_from_world",
        };
        let axes = match format {
            ImportFormat::Nerfstudio => "camera axes of OpenCV (y down, z forwards)",
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

/// A hypothesis about how the poses were written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Candidate {
    Convention(PoseConvention),
    /// Positions multiplied by this.
    Scaled(f64),
}

impl Candidate {
    /// All hypotheses: the convention of the format first, then others, then other units.
    fn all(format: ImportFormat) -> Vec<Self> {
        let has_order = matches!(format, ImportFormat::Droid | ImportFormat::Trajectory);
        let conventions = PoseConvention::ALL.into_iter().filter(|c| has_order || !c.order);
        let exponents = (-MAX_SCALE_EXPONENT..=MAX_SCALE_EXPONENT).filter(|&e| e != 0);
        let scales = exponents.map(|exponent| Self::Scaled(2_f64.powi(exponent)));
        conventions.map(Self::Convention).chain(scales).collect()
    }

    /// The pose under this hypothesis.
    fn reinterpret(self, pose: Pose<f64>, format: ImportFormat) -> Pose<f64> {
        match self {
            Self::Convention(convention) => convention.reinterpret(pose, format),
            Self::Scaled(scale) => Pose { translation: pose.translation * scale, ..pose },
        }
    }
}

/// A warning if depths and poses disagree, with the convention that fits better if there is one.
pub(super) fn convention_warning(keyframes: &ImportedKeyframes) -> Option<String> {
    if !keyframes.has_depth {
        return None;
    }
    let candidates = Candidate::all(keyframes.format);
    let pairs = pair_errors(keyframes, &candidates);
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let errors_of = |candidate: usize| -> Vec<f64> {
        pairs.iter().map(|errors| errors[candidate].total).collect()
    };
    let given = errors_of(0);
    let from = "from one keyframe to the next the mismatch (colour and depth) is";
    let error = mean(&given)?;
    let best_of = |is_convention: bool| {
        let others = (1..candidates.len())
            .filter(|&i| matches!(candidates[i], Candidate::Convention(_)) == is_convention);
        best(others.map(|i| (candidates[i], errors_of(i))), &given)
    };
    match best_of(true).or_else(|| best_of(false)) {
        Some((Candidate::Convention(convention), other)) => Some(format!(
            "wrong convention? {from} {error:.2} of 1, and {other:.2} if the poses are {}: {} is \
             expected to hold {}",
            convention.description(keyframes.format),
            keyframes.path.display(),
            keyframes.format.convention()
        )),
        Some((Candidate::Scaled(scale), other)) => Some(format!(
            "depths and poses in different units? {from} {error:.2} of 1, and {other:.2} if \
             positions are multiplied by about {scale}"
        )),
        None => {
            let overlap: Vec<f64> = pairs.iter().filter_map(|errors| errors[0].overlap).collect();
            let error = mean(&overlap)
                .filter(|&error| overlap.len() >= MIN_PAIRS && error > MAX_OVERLAP_ERROR)?;
            Some(format!(
                "depths and poses disagree: {from} {error:.2} of 1, and no other convention fits \
                 better; are they of these pictures?"
            ))
        }
    }
}

/// The candidate of the least mean error and that error, if clearly smaller than the given one's.
fn best<T>(candidates: impl Iterator<Item = (T, Vec<f64>)>, given: &[f64]) -> Option<(T, f64)> {
    let means = candidates.filter_map(|(what, errors)| Some((what, mean(&errors)?, errors)));
    let (what, mean_error, errors) = means.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let wins = errors.iter().zip(given).filter(|(other, given)| other < given).count();
    let clearly = mean_error < BETTER_RATIO * mean(given)? && 3 * wins > 2 * given.len();
    clearly.then_some((what, mean_error))
}

/// Errors of all candidates, for every pair of keyframes that can be compared. Holds two keyframes
/// at a time.
fn pair_errors(
    keyframes: &ImportedKeyframes,
    candidates: &[Candidate],
) -> Vec<Vec<ReprojectionError>> {
    let of_pair = |(first, second): (usize, usize)| {
        let (a, b) = (keyframes.load(first).ok()?, keyframes.load(second).ok()?);
        let error = |candidate: &Candidate| {
            let pose = |pose: Pose<f64>| candidate.reinterpret(pose, keyframes.format);
            let b_from_a = pose(b.world_from_camera).inverse() * pose(a.world_from_camera);
            ReprojectionError::between(&keyframes.camera, &a, &b, b_from_a)
        };
        candidates.iter().map(error).collect::<Option<Vec<ReprojectionError>>>()
    };
    choose_pairs(keyframes).into_iter().filter_map(of_pair).collect()
}

/// Pairs spread over all keyframes: neighbours in time, or the most covisible ones.
fn choose_pairs(keyframes: &ImportedKeyframes) -> Vec<(usize, usize)> {
    let last = keyframes.len().saturating_sub(1);
    let mut firsts: Vec<usize> = (0..PAIRS).map(|k| k * last / PAIRS).collect();
    firsts.dedup();
    let covisible = |index: usize| keyframes.source.most_covisible(&keyframes.keyframes, index);
    firsts.into_iter().map(|index| (index, covisible(index).unwrap_or(index + 1))).collect()
}

/// Disagreement of depth and colour between two keyframes, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ReprojectionError {
    /// Error of all pixels; those outside the other image beyond the usual share count as 1.
    total: f64,
    /// Error of overlapping pixels; `None` if these are few.
    overlap: Option<f64>,
}

impl ReprojectionError {
    /// Reprojects `a` into `b`; `None` if `a` has too little depth.
    fn between(
        camera: &Camera<f64>,
        a: &Keyframe,
        b: &Keyframe,
        b_from_a: Pose<f64>,
    ) -> Option<Self> {
        let pixels = reproject(camera, a, b_from_a)?;
        let colour = colour_error(&pixels, a, b);
        let error = depth_error(&pixels, b).map_or(colour, |depth| 0.5 * (colour + depth));
        let count = pixels.iter().filter(|pixel| pixel.target.is_some()).count();
        let share = count as f64 / pixels.len() as f64;
        let has_overlap = count >= MIN_OVERLAP_PIXELS && share >= MIN_OVERLAP;
        let total = with_outside(error, 1.0 - share);
        Some(Self { total, overlap: has_overlap.then_some(error) })
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// A pixel of one image in another one.
struct Reprojected {
    /// Index of the pixel in its own image.
    source: usize,
    /// Position in the other image, and depth there; `None`: outside.
    target: Option<(Tap<f32>, f64)>,
}

fn reproject(camera: &Camera<f64>, a: &Keyframe, b_from_a: Pose<f64>) -> Option<Vec<Reprojected>> {
    let depth = &a.depth.as_ref()?.data;
    let valid = depth.iter().filter(|&&z| z > 0.0).count();
    let every = (valid / SAMPLES).max(1);
    let chosen = depth.iter().enumerate().filter(|(_, z)| **z > 0.0).step_by(every);
    let pixels = chosen.map(|(source, &z)| {
        let (u, v) = Camera::<f64>::pixel_centre(source % camera.width, source / camera.width);
        let p = b_from_a * camera.unproject(u, v, f64::from(z));
        let (u, v) = camera.project(p);
        let tap = Tap::new(camera.width, camera.height, u as f32, v as f32);
        let target = tap.filter(|_| p.z > 0.0).map(|tap| (tap, p.z));
        Reprojected { source, target }
    });
    let pixels: Vec<Reprojected> = pixels.collect();
    (pixels.len() >= MIN_OVERLAP_PIXELS).then_some(pixels)
}

/// Mixes the error of overlapping pixels with 1 for the share `outside` beyond the usual one.
fn with_outside(error: f64, outside: f64) -> f64 {
    let unusual = ((outside - USUAL_SHARE_OUTSIDE) / (1.0 - USUAL_SHARE_OUTSIDE)).max(0.0);
    error * (1.0 - unusual) + unusual
}

/// Mean relative difference of depths, 0 to 1; `None` if the other depth is too sparse.
fn depth_error(pixels: &[Reprojected], b: &Keyframe) -> Option<f64> {
    let depth = &b.depth.as_ref()?.data;
    let overlap: Vec<(Tap<f32>, f64)> = pixels.iter().filter_map(|pixel| pixel.target).collect();
    let difference = |&(tap, z): &(Tap<f32>, f64)| {
        let around = tap.values(depth);
        // Inverse depth is linear in the image of a plane.
        let inverse = || f64::from(tap.interpolate(around.map(f32::recip)).0);
        let is_known = around.iter().all(|&z| z > 0.0);
        is_known.then(|| ((inverse() * z - 1.0).abs() / FULL_DEPTH_ERROR).min(1.0))
    };
    let errors: Vec<f64> = overlap.iter().filter_map(difference).collect();
    if overlap.is_empty() {
        return Some(1.0);
    }
    (2 * errors.len() >= overlap.len()).then(|| mean(&errors).unwrap_or(1.0))
}

/// `(1 - correlation) / 2` of the brightness of overlapping pixels.
fn colour_error(pixels: &[Reprojected], a: &Keyframe, b: &Keyframe) -> f64 {
    let brightness = |keyframe: &Keyframe, value: &dyn Fn(&[f32]) -> f32| -> f64 {
        (0..3).map(|channel| f64::from(value(keyframe.colour.plane(channel)))).sum()
    };
    let both = |pixel: &Reprojected| {
        let (tap, _) = pixel.target?;
        let here = brightness(a, &|plane| plane[pixel.source]);
        Some((here, brightness(b, &|plane| tap.sample(plane).0)))
    };
    let overlap: Vec<(f64, f64)> = pixels.iter().filter_map(both).collect();
    if overlap.len() < MIN_OVERLAP_PIXELS {
        return 1.0;
    }
    0.5 * (1.0 - correlation(&overlap).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reinterpretation_undoes_other_conventions() {
        let pose = Pose::new(Rotation::exp(Vec3::new(0.4, -0.2, 0.9)), Vec3::new(1.0, -2.0, 0.5));
        let near = |a: Pose<f64>, b: Pose<f64>| {
            let apart = a.local(b);
            assert!(apart.translation.norm() + apart.rotation.norm() < 1e-12, "{a:?} {b:?}");
        };
        for format in ImportFormat::ALL {
            near(PoseConvention::ALL[0].reinterpret(pose, format), pose);
            near(PoseConvention::new(true, false, false).reinterpret(pose.inverse(), format), pose);
        }
        // A file with w x y z, read as x y z w.
        let Rotation { w, v } = pose.rotation;
        let misread = Rotation::from_wxyz(v.z, w, v.x, v.y).expect("a rotation");
        let misread = Pose::new(misread, pose.translation);
        near(
            PoseConvention::new(false, false, true).reinterpret(misread, ImportFormat::Trajectory),
            pose,
        );
    }
}
