//! Refinement of imported keyframes.
//!
//! The front end reconstructs the pictures of a video on its own, with depth where it was measured. Its
//! path, in the unit of length of the files or of the depth, replaces theirs where it aligns the pictures
//! clearly better; poses of photographs it adjusts. Keyframes without depth get dense depth in either
//! case.

use super::monocular::PictureReader;
use super::{EstimatedDepth, KeyframeSource, MonocularSource, PictureError, PosedKeyframe};
use i2slam_compute::{CancellationToken, correlation};
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use i2slam_odometry::{
    DenseDepthEstimator, Keyframe, KeyframePictures, MIN_POSED_SHARE, PosedView, Reconstruction,
    SparseDepth, align_path, photograph_motions,
};
use std::sync::Arc;

/// Least gain in picture correlation for which the poses of the front end are used.
const MIN_CORRELATION_GAIN: f64 = 0.02;
/// Channel in which pictures are compared.
const GREEN: usize = 1;
/// Half side of the compared patches [px].
const HALF_PATCH: i32 = 2;

/// Imported keyframes with refined poses and dense depth.
pub struct RefinedImport<L> {
    camera: Camera<f64>,
    poses: Vec<Pose<f64>>,
    /// Time stamps of the pictures that the odometry took [s].
    timestamps: Vec<Option<f64>>,
    dense: DenseDepthEstimator,
    reader: PictureReader<L>,
    next: usize,
    /// Mean correlation of neighbouring pictures at the imported and at the odometry's poses, where both were
    /// compared.
    correlations: Option<[f64; 2]>,
    /// Whether the poses of the odometry are used.
    is_refined: bool,
    /// Whether depth was measured.
    has_depth: bool,
    /// True if the keyframes are photographs.
    is_unordered: bool,
    /// Motions of photographs during their exposures.
    motions: Vec<Option<Tangent<f64>>>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> RefinedImport<L> {
    /// Refines the imported `poses` [world from camera] by `odometry`, which was run on their
    /// pictures in any size; `load` reads the picture at a position. `None` for a rolling shutter
    /// or if too few keyframes were posed. After `cancellation` neither depth nor motion is estimated.
    pub fn new<P>(
        camera: Camera<f64>,
        mut poses: Vec<Pose<f64>>,
        odometry: &MonocularSource<P>,
        mut load: L,
        cancellation: CancellationToken,
    ) -> Option<Self>
    where
        P: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let found = odometry.reconstruction().clone().resized(camera.width, camera.height);
        if found.rolling_shutter_readout != 0.0 {
            return None;
        }
        let path = OdometryPath::new(&poses, &found, |frame| odometry.position(frame))?;
        // Photographs, too far apart for a comparison of patches, were adjusted from the imported poses.
        let (is_refined, correlations) = if found.is_unordered || found.has_given_poses {
            (!found.has_given_poses, None)
        } else {
            let both = path.correlations([&poses, &path.poses], &mut load, &cancellation);
            (both[1] > both[0] + MIN_CORRELATION_GAIN, Some(both))
        };
        if is_refined {
            poses.clone_from(&path.poses);
        }
        let views = poses.iter().enumerate().map(|(place, pose)| PosedView {
            world_from_camera: *pose,
            landmarks: path.landmarks_near(place),
        });
        let dense = DenseDepthEstimator::new(camera, views.collect());
        let dense = if found.is_unordered { dense.with_any_order() } else { dense };
        let motions = path.photograph_motions(poses.len(), &mut load, &cancellation);
        let timestamps = timestamps(odometry, poses.len());
        let dense = dense.with_cancellation(cancellation);
        let reader = PictureReader::new((0..poses.len()).collect(), load, found.is_unordered);
        Some(Self {
            camera,
            poses,
            timestamps,
            dense,
            reader,
            next: 0,
            correlations,
            is_refined,
            has_depth: found.depth_model.is_some(),
            is_unordered: found.is_unordered,
            motions,
        })
    }

    /// True if nothing tells whether the imported poses, which are kept, are right.
    pub fn is_unchecked(&self) -> bool {
        !(self.is_refined || self.is_unordered) && self.correlations.is_none()
    }

    /// A sentence on the refinement for the user.
    pub fn summary(&self) -> String {
        let depth = if self.has_depth { "" } else { "; depth is found by matching" };
        let which = match (self.is_refined, self.correlations) {
            (true, None) => "poses are adjusted to what the photographs show",
            (false, None) if self.is_unordered => {
                "the imported poses are kept: the pictures show no errors of theirs"
            }
            (false, None) => {
                "the imported poses are used as they are, unchecked: too few frames could be posed by their \
                 pictures; were they in another convention, such as camera from world, nothing would tell"
            }
            (true, Some(_)) => "poses are refined by their pictures",
            (false, Some(_)) => "the imported poses are kept",
        };
        let Some([imported, found]) = self.correlations else { return format!("{which}{depth}") };
        format!(
            "{which}: neighbouring pictures correlate by {imported:.3} at the imported poses, by \
             {found:.3} at those found from the pictures{depth}"
        )
    }
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> KeyframeSource for RefinedImport<L> {
    fn camera(&self) -> &Camera<f64> {
        &self.camera
    }

    fn is_unordered(&self) -> bool {
        self.is_unordered
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let number = self.next;
        self.poses.get(number)?;
        self.next += 1;
        let seen = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        if let Some(measured) = &seen.depth {
            let depth = EstimatedDepth { depth: (*measured.image).clone(), variance: None };
            return Some(Ok(self.posed(number, seen, Some(depth))));
        }
        let mut picture = |k: usize| {
            let colour = Arc::clone(&self.reader.picture(k)?.colour);
            Some(KeyframePictures::colour_only(colour))
        };
        let depth = self.dense.estimate(number, &mut picture);
        let depth = depth.map(|d| EstimatedDepth { depth: d.depth, variance: Some(d.variance) });
        Some(Ok(self.posed(number, seen, depth)))
    }
}

impl<L> RefinedImport<L> {
    /// A keyframe with those before and after it, of photographs with its motion, in their place.
    fn posed(&self, number: usize, frame: Frame, depth: Option<EstimatedDepth>) -> PosedKeyframe {
        let neighbour = |number: usize| {
            let stamp = (*self.timestamps.get(number)?)?;
            Some((stamp, *self.poses.get(number)?)).filter(|_| !self.is_unordered)
        };
        PosedKeyframe {
            before: number.checked_sub(1).and_then(neighbour),
            after: neighbour(number + 1),
            exposure_motion: self.motions.get(number).copied().flatten(),
            depth,
            ..PosedKeyframe::from_frame(frame, self.poses[number])
        }
    }
}

/// The path of the odometry at all keyframes, in the world and the unit of length of the files.
struct OdometryPath<'a> {
    found: &'a Reconstruction,
    /// Index among the imported keyframes of every keyframe of `found`.
    places: Vec<usize>,
    /// Length in the files of one unit of `found`.
    scale: f64,
    /// One pose per imported keyframe.
    poses: Vec<Pose<f64>>,
}

impl<'a> OdometryPath<'a> {
    fn new(
        input_poses: &[Pose<f64>],
        found: &'a Reconstruction,
        place: impl Fn(usize) -> Option<usize>,
    ) -> Option<Self> {
        let mut at: Vec<Option<Pose<f64>>> = vec![None; input_poses.len()];
        for (frame, pose) in found.poses.iter().enumerate() {
            if let (Some(place), Some(_)) = (place(frame), pose) {
                *at.get_mut(place)? = *pose;
            }
        }
        let posed = at.iter().flatten().count();
        if (posed as f64) < MIN_POSED_SHARE * input_poses.len() as f64 || posed < 3 {
            return None;
        }
        let places = found.keyframes.iter().map(|k| place(k.index)).collect::<Option<Vec<_>>>()?;
        let (scale, poses) = if found.is_unordered || found.has_given_poses {
            nearest_poses(input_poses, &at)?
        } else {
            let is_metric = found.depth_model.is_some();
            let scale = if is_metric { 1.0 } else { scale(input_poses, &at)? };
            (scale, aligned_poses(input_poses, &at, scale)?)
        };
        Some(Self { found, places, scale, poses })
    }

    /// Landmark depths of the keyframe of `found` nearest to an imported one.
    fn landmarks_near(&self, place: usize) -> Vec<f64> {
        let near = self.places.iter().zip(&self.found.keyframes);
        let nearest = near.min_by_key(|(other, _)| other.abs_diff(place));
        nearest.map_or_else(Vec::new, |(_, keyframe)| {
            keyframe.depths.iter().map(|point| self.scale * point.depth).collect()
        })
    }

    /// Motions of photographs during their exposures, by their index among `count` imported keyframes.
    fn photograph_motions(
        &self,
        count: usize,
        load: &mut dyn FnMut(usize) -> Result<Frame, PictureError>,
        cancellation: &CancellationToken,
    ) -> Vec<Option<Tangent<f64>>> {
        let mut motions = vec![None; count];
        if self.found.is_unordered {
            let Reconstruction { camera, keyframes, .. } = self.found;
            let mut load = |number: usize| Some(load(self.places[number]).ok()?.colour);
            let found = photograph_motions(camera, keyframes, &mut load, cancellation);
            self.places.iter().zip(found).for_each(|(place, motion)| motions[*place] = motion);
        }
        motions
    }

    /// Mean correlation of patches around landmarks with the next keyframe, for two `paths`.
    fn correlations(
        &self,
        paths: [&[Pose<f64>]; 2],
        load: &mut dyn FnMut(usize) -> Result<Frame, PictureError>,
        cancellation: &CancellationToken,
    ) -> [f64; 2] {
        let (mut sums, mut count) = ([0.0; 2], 0);
        let mut last: Option<(usize, &Keyframe, Arc<Image<f32>>)> = None;
        for (&place, keyframe) in self.places.iter().zip(&self.found.keyframes) {
            if cancellation.is_cancelled() {
                break;
            }
            let Ok(Frame { colour, .. }) = load(place) else { continue };
            if let Some((before, seen, picture)) = &last {
                let motions = paths.map(|poses| self.motion(poses, *before, place));
                for point in &seen.depths {
                    let both = motions
                        .map(|motion| self.landmark_correlation(point, motion, picture, &colour));
                    if let [Some(first), Some(second)] = both {
                        (sums[0], sums[1], count) = (sums[0] + first, sums[1] + second, count + 1);
                    }
                }
            }
            last = Some((place, keyframe, colour));
        }
        sums.map(|sum| sum / f64::from(count.max(1)))
    }

    /// `next_from_here` on a path, and the landmark scale that fits it: drift must not count.
    fn motion(&self, poses: &[Pose<f64>], here: usize, next: usize) -> (Pose<f64>, f64) {
        let next_from_here = |poses: &[Pose<f64>]| poses[next].inverse() * poses[here];
        let (motion, own) = (next_from_here(poses), next_from_here(&self.poses));
        let ratio = motion.translation.norm() / own.translation.norm();
        let ratio = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        (motion, self.scale * ratio)
    }

    /// Correlation of the patch around a landmark with its projection into the next picture.
    fn landmark_correlation(
        &self,
        point: &SparseDepth,
        (next_from_here, scale): (Pose<f64>, f64),
        here: &Image<f32>,
        next: &Image<f32>,
    ) -> Option<f64> {
        let (camera, [u, v]) = (&self.found.camera, point.at);
        let seen = next_from_here * camera.unproject(u, v, scale * point.depth);
        if seen.z <= 0.0 {
            return None;
        }
        patch_correlation(here, (u, v), next, camera.project(seen))
    }
}

/// Time stamps of `count` pictures, as far as the odometry took them [s].
fn timestamps<P>(odometry: &MonocularSource<P>, count: usize) -> Vec<Option<f64>>
where
    P: FnMut(usize) -> Result<Frame, PictureError>,
{
    let mut timestamps = vec![None; count];
    for (frame, stamp) in odometry.reconstruction().timestamps.iter().enumerate() {
        let place = odometry.position(frame);
        if let Some(of_place) = place.and_then(|place| timestamps.get_mut(place)) {
            *of_place = Some(*stamp);
        }
    }
    timestamps
}

/// Scale from the path of the odometry to the imported one, by least squares on distances.
fn scale(input_poses: &[Pose<f64>], found: &[Option<Pose<f64>>]) -> Option<f64> {
    let both: Vec<_> =
        input_poses.iter().zip(found).filter_map(|(input, f)| Some((*input, (*f)?))).collect();
    let apart = |a: Pose<f64>, b: Pose<f64>| (a.translation - b.translation).norm();
    let (mut product, mut square) = (0.0, 0.0);
    for (i, (input, found)) in both.iter().enumerate() {
        for (other_input, other_found) in &both[..i] {
            let distance = apart(*found, *other_found);
            product += apart(*input, *other_input) * distance;
            square += distance * distance;
        }
    }
    Some(product / square).filter(|s| s.is_finite() && *s > 0.0)
}

/// Length in the files of one unit of the odometry's poses, and these, moved as a whole as near as possible to
/// those of the files, which missing ones keep.
fn nearest_poses(
    input_poses: &[Pose<f64>],
    found: &[Option<Pose<f64>>],
) -> Option<(f64, Vec<Pose<f64>>)> {
    let pairs: Vec<_> = found
        .iter()
        .zip(input_poses)
        .filter_map(|(found, input)| Some(((*found)?, *input)))
        .collect();
    let by = align_path(&pairs)?;
    let moved = |(found, input): (&Option<Pose<f64>>, &Pose<f64>)| {
        found.map_or(*input, |found| by.apply_to_pose(found))
    };
    Some((by.scale, found.iter().zip(input_poses).map(moved).collect()))
}

/// The odometry's poses in the files' world; missing ones continue by the motion in the files.
fn aligned_poses(
    input_poses: &[Pose<f64>],
    found: &[Option<Pose<f64>>],
    scale: f64,
) -> Option<Vec<Pose<f64>>> {
    let scaled = |pose: Pose<f64>| Pose { translation: pose.translation * scale, ..pose };
    let first = found.iter().position(Option::is_some)?;
    let world_from_found = input_poses[first] * scaled(found[first]?).inverse();
    let mut known = (input_poses[first], input_poses[first]);
    let align = |(input, found): (&Pose<f64>, &Option<Pose<f64>>)| {
        if let Some(found) = found {
            known = (*input, world_from_found * scaled(*found));
        }
        known.1 * (known.0.inverse() * *input)
    };
    Some(input_poses.iter().zip(found).map(align).collect())
}

/// Normalised correlation of the patches around two points; `None` at a border or without contrast.
fn patch_correlation(
    a: &Image<f32>,
    at: (f64, f64),
    b: &Image<f32>,
    to: (f64, f64),
) -> Option<f64> {
    let patch = |image: &Image<f32>, (u, v): (f64, f64)| -> Option<Vec<f64>> {
        let around = (-HALF_PATCH..=HALF_PATCH)
            .flat_map(|y| (-HALF_PATCH..=HALF_PATCH).map(move |x| (x as f32, y as f32)));
        let value = |(x, y)| {
            let tap = image.tap(u as f32 + x, v as f32 + y)?;
            Some(f64::from(tap.interpolate(tap.values(image.plane(GREEN))).0))
        };
        around.map(value).collect::<Option<Vec<f64>>>()
    };
    let pairs: Vec<(f64, f64)> = patch(a, at)?.into_iter().zip(patch(b, to)?).collect();
    correlation(&pairs)
}

#[cfg(test)]
mod tests;
