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
        let dense = dense.with_cancellation(cancellation);
        let reader = PictureReader::new((0..poses.len()).collect(), load, found.is_unordered);
        Some(Self {
            camera,
            poses,
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

    /// A sentence on the refinement for the user.
    pub fn summary(&self) -> String {
        let depth = if self.has_depth { "" } else { "; depth is found by matching" };
        let which = match (self.is_refined, self.correlations) {
            (true, None) => "poses are adjusted to what the photographs show",
            (false, None) => "the imported poses are kept: the pictures show no errors of theirs",
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
        let (number, world_from_camera) = (self.next, *self.poses.get(self.next)?);
        let exposure_motion = self.motions.get(number).copied().flatten();
        self.next += 1;
        let seen = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        if let Some(measured) = &seen.depth {
            let depth = EstimatedDepth { depth: (*measured.image).clone(), variance: None };
            let keyframe = PosedKeyframe::from_frame(seen, world_from_camera);
            return Some(Ok(PosedKeyframe { depth: Some(depth), exposure_motion, ..keyframe }));
        }
        let mut picture = |k: usize| {
            let colour = Arc::clone(&self.reader.picture(k)?.colour);
            Some(KeyframePictures::colour_only(colour))
        };
        let depth = self.dense.estimate(number, &mut picture);
        Some(Ok(PosedKeyframe {
            depth: depth.map(|d| EstimatedDepth { depth: d.depth, variance: Some(d.variance) }),
            exposure_motion,
            ..PosedKeyframe::from_frame(seen, world_from_camera)
        }))
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
mod tests {
    use super::super::monocular::tests::{camera, stamped};
    use super::super::{Intrinsics, OdometryProgress};
    use super::*;
    use i2slam_check::noise;
    use i2slam_dataset::DepthPicture;
    use i2slam_geometry::{Tangent, Vec3};

    const COUNT: usize = 14;

    /// The true pose of a picture of the wall, in a unit of a third of the wall's.
    fn truth(place: usize) -> Pose<f64> {
        let translation = Vec3::new(3.0 * 0.06 * place as f64, 0.0, 0.0);
        Pose { translation, ..Pose::identity() }
    }

    /// True poses disturbed at random by up to so much of the unit and so many radians.
    fn disturbed(by: (f64, f64)) -> Vec<Pose<f64>> {
        let numbers = noise(7, 6 * COUNT);
        let error = |place: usize| {
            let n = &numbers[6 * place..6 * place + 6];
            let factors = [by.0, by.0, by.0, by.1, by.1, by.1];
            Tangent::from_array(std::array::from_fn(|i| n[i] * factors[i]))
        };
        (0..COUNT).map(|place| truth(place).retract(error(place))).collect()
    }

    fn refined(poses: Vec<Pose<f64>>) -> Vec<PosedKeyframe> {
        let camera = camera();
        refined_from(poses, |place| Ok(stamped(&camera, place, place as f64 / 30.0)))
    }

    /// Depth of the wall in the unit of [`truth`].
    fn wall_depth() -> Image<f32> {
        let camera = camera();
        Image::from_fn(camera.width, camera.height, 1, |_, column, row| {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let is_near = 2.0 * camera.unproject(u, v, 1.0).y > 0.1;
            if is_near { 3.0 * 2.0 } else { 3.0 * 3.5 }
        })
    }

    fn refined_from(
        poses: Vec<Pose<f64>>,
        load: impl Fn(usize) -> Result<Frame, PictureError>,
    ) -> Vec<PosedKeyframe> {
        let camera = camera();
        let found = MonocularSource::find(
            Intrinsics::Known(camera),
            COUNT,
            &load,
            &OdometryProgress::default(),
        )
        .expect("a path");
        let mut source =
            RefinedImport::new(camera, poses, &found, &load, CancellationToken::default())
                .expect("all were found");
        let keyframes = std::iter::from_fn(|| source.next_keyframe());
        keyframes.map(|keyframe| keyframe.expect("pictures can be read")).collect()
    }

    /// Largest error of the motion from one keyframe to the next: length and angle.
    fn errors(poses: impl Iterator<Item = Pose<f64>>) -> (f64, f64) {
        let poses: Vec<Pose<f64>> = poses.collect();
        let due = truth(1).translation.norm();
        poses.windows(2).fold((0.0, 0.0), |(length, angle): (f64, f64), pair| {
            let motion = pair[0].local(pair[1]).to_array();
            let long = motion[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
            let turn = motion[3..].iter().map(|x| x * x).sum::<f64>().sqrt();
            (length.max((long - due).abs()), angle.max(turn))
        })
    }

    #[test]
    fn poses_that_do_not_fit_the_pictures_are_refined_and_all_keyframes_have_depth() {
        let input_poses = disturbed((0.06, 0.02));
        let before = errors(input_poses.iter().copied());
        let keyframes = refined(input_poses);
        let after = errors(keyframes.iter().map(|k| k.world_from_camera));
        assert!(after.0 < 0.3 * before.0 && after.1 < 0.3 * before.1, "{before:?} {after:?}");
        assert_eq!(keyframes.len(), COUNT);
        for keyframe in &keyframes {
            let depth = &keyframe.depth.as_ref().expect("depth").depth;
            let known: Vec<f32> = depth.data.iter().copied().filter(|d| *d > 0.0).collect();
            assert!(2 * known.len() > depth.pixels(), "{}: {}", keyframe.index, known.len());
            // The wall is 3.5 of its units away, its lower part 2.
            let inside = known.iter().filter(|d| (4.5..14.0).contains(*d)).count();
            assert!(10 * inside > 9 * known.len(), "{}", keyframe.index);
        }
    }

    #[test]
    fn with_measured_depth_poses_are_refined_in_its_unit_and_it_is_delivered() {
        let camera = camera();
        let load = |place: usize| {
            let frame = stamped(&camera, place, place as f64 / 30.0);
            let image = Arc::new(wall_depth());
            let depth = Some(DepthPicture { image, timestamp: frame.timestamp });
            Ok(Frame { depth, ..frame })
        };
        let input_poses = disturbed((0.06, 0.02));
        let before = errors(input_poses.iter().copied());
        let keyframes = refined_from(input_poses, load);
        let after = errors(keyframes.iter().map(|k| k.world_from_camera));
        assert!(after.0 < 0.1 * before.0 && after.1 < 0.1 * before.1, "{before:?} {after:?}");
        for keyframe in keyframes {
            let depth = keyframe.depth.expect("depth");
            assert!(depth.variance.is_none() && depth.depth == wall_depth());
        }
    }

    #[test]
    fn poses_that_fit_are_kept() {
        let input_poses = disturbed((0.0, 0.0));
        let keyframes = refined(input_poses.clone());
        assert!(keyframes.iter().map(|k| k.world_from_camera).eq(input_poses));
    }

    #[test]
    fn unposed_keyframes_follow_the_motion_in_the_files() {
        let input_poses: Vec<Pose<f64>> = (0..4).map(truth).collect();
        let found = [None, Some(truth(1)), None, Some(truth(3))];
        assert!((scale(&input_poses, &found).expect("a scale") - 1.0).abs() < 1e-12);
        let poses = aligned_poses(&input_poses, &found, 1.0).expect("one is known");
        for (pose, due) in poses.iter().zip(&input_poses) {
            assert!((pose.translation - due.translation).norm() < 1e-12);
        }
    }

    #[test]
    fn photographs_are_moved_as_a_whole() {
        let input_poses: Vec<Pose<f64>> = (0..6).map(truth).collect();
        let turned = Pose::new(truth(0).rotation, Vec3::new(0.3, 0.2, 0.1));
        let moved = |place: usize| {
            let Pose { rotation, translation } = turned * truth(place);
            (place != 4).then_some(Pose { rotation, translation: translation * 0.4 })
        };
        let found: Vec<_> = (0..6).map(moved).collect();
        let (scale, poses) = nearest_poses(&input_poses, &found).expect("a path");
        assert!((scale - 2.5).abs() < 1e-9);
        for (pose, due) in poses.iter().zip(&input_poses) {
            assert!((pose.translation - due.translation).norm() < 1e-9);
        }
    }
}
