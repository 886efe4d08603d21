//! Keyframes of files without depth whose pictures are a video: with dense depth, and at better
//! poses where the pictures tell.
//!
//! The front end follows points through the pictures as if nothing were known of them. Its path, in
//! the unit of length of the files, takes the place of theirs where it lays the pictures on each
//! other clearly better; a path of another program that is as good stays as it is.

use super::picture_reader::Reader;
use super::{EstimatedDepth, KeyframeSource, MonocularSource, PictureError, PosedKeyframe};
use i2slam_compute::{CancellationToken, correlation};
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{
    DenseDepthEstimator, FrameStatus, Keyframe, PosedView, Reconstruction, SparseDepth,
};
use std::sync::Arc;

/// Share of the keyframes that the front end must have found a pose for.
const FOUND: f64 = 0.6;
/// By how much the correlation of the pictures must be higher with the path that was found.
const CLEARLY: f64 = 0.02;
/// The channel that is compared.
const GREEN: usize = 1;
/// Half the side of the patches that are compared [px].
const HALF_PATCH: i32 = 2;

/// Keyframes of files, their poses refined, with dense depth.
pub struct RefinedImport<L> {
    camera: Camera<f64>,
    poses: Vec<Pose<f64>>,
    dense: DenseDepthEstimator,
    reader: Reader<L>,
    next: usize,
    /// Mean correlation of the pictures with the poses as they came and as they were found.
    correlations: [f64; 2],
    /// Whether poses are those that were found.
    moved: bool,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> RefinedImport<L> {
    /// Keyframes of `camera` at poses as they came, world from camera, with the path that was found
    /// from their pictures, of whatever size, in order; `load` gives the picture at a place. None
    /// where too few of them were found, or their rows were read in turn, which poses of files say
    /// nothing of. No depth is looked for any more once `cancellation` is cancelled.
    pub fn new<P>(
        camera: Camera<f64>,
        mut poses: Vec<Pose<f64>>,
        native: &MonocularSource<P>,
        mut load: L,
        cancellation: CancellationToken,
    ) -> Option<Self>
    where
        P: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let found = native.reconstruction().clone().resized(camera.width, camera.height);
        if found.rolling_shutter_readout != 0.0 {
            return None;
        }
        let path = Path::of(&poses, &found, |frame| native.place(frame))?;
        let correlations = path.correlations([&poses, &path.poses], &mut load, &cancellation);
        let moved = correlations[1] > correlations[0] + CLEARLY;
        if moved {
            poses.clone_from(&path.poses);
        }
        let views = poses.iter().enumerate().map(|(place, pose)| PosedView {
            world_from_camera: *pose,
            landmarks: path.landmarks_near(place),
        });
        let dense =
            DenseDepthEstimator::new(camera, views.collect()).with_cancellation(cancellation);
        let reader = Reader::new((0..poses.len()).collect(), load);
        Some(Self { camera, poses, dense, reader, next: 0, correlations, moved })
    }

    /// Number of keyframes, taken or not.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no keyframe.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// What became of the poses, in words.
    pub fn told(&self) -> String {
        let [came, found] = self.correlations;
        let which = match self.moved {
            true => "poses are refined by their pictures",
            false => "poses stay as they came",
        };
        format!(
            "{which}: neighbouring pictures correlate by {came:.3} with the poses of the files, by \
             {found:.3} with those found from the pictures; their depth is found by matching"
        )
    }
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> KeyframeSource for RefinedImport<L> {
    fn camera(&self) -> &Camera<f64> {
        &self.camera
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let (number, world_from_camera) = (self.next, *self.poses.get(self.next)?);
        self.next += 1;
        let seen = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        let mut picture = |k: usize| Some(Arc::clone(&self.reader.picture(k)?.colour));
        let depth = self.dense.estimate(number, &mut picture);
        Some(Ok(PosedKeyframe {
            depth: depth.map(|d| EstimatedDepth { depth: d.depth, variance: Some(d.variance) }),
            ..PosedKeyframe::from_frame(seen, world_from_camera)
        }))
    }
}

/// A path through all keyframes, in the world and the unit of length of the files.
struct Path<'a> {
    found: &'a Reconstruction,
    /// Place of every keyframe of `found` among those of the files.
    places: Vec<usize>,
    /// Units of the files in one of `found`.
    scale: f64,
    /// One for each keyframe of the files.
    poses: Vec<Pose<f64>>,
}

impl<'a> Path<'a> {
    fn of(
        came: &[Pose<f64>],
        found: &'a Reconstruction,
        place: impl Fn(usize) -> Option<usize>,
    ) -> Option<Self> {
        let mut at: Vec<Option<Pose<f64>>> = vec![None; came.len()];
        for (frame, status) in found.frames.iter().enumerate() {
            if let (Some(place), FrameStatus::Posed { world_from_camera, .. }) =
                (place(frame), status)
            {
                *at.get_mut(place)? = Some(*world_from_camera);
            }
        }
        let posed = at.iter().flatten().count();
        if (posed as f64) < FOUND * came.len() as f64 || posed < 3 {
            return None;
        }
        let scale = scale(came, &at)?;
        let places = found.keyframes.iter().map(|k| place(k.index)).collect::<Option<Vec<_>>>()?;
        Some(Self { found, places, scale, poses: poses(came, &at, scale)? })
    }

    /// Depths of the landmarks of the keyframe of `found` that is nearest to one of the files.
    fn landmarks_near(&self, place: usize) -> Vec<f64> {
        let near = self.places.iter().zip(&self.found.keyframes);
        let nearest = near.min_by_key(|(other, _)| other.abs_diff(place));
        nearest.map_or_else(Vec::new, |(_, keyframe)| {
            keyframe.depths.iter().map(|point| self.scale * point.depth).collect()
        })
    }

    /// Mean correlation of patches around the landmarks of a keyframe with the next one, if the
    /// cameras stand at each of `paths`, over what both of them say is seen.
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
                    let both = motions.map(|motion| self.fit(point, motion, picture, &colour));
                    if let [Some(came), Some(found)] = both {
                        (sums[0], sums[1], count) = (sums[0] + came, sums[1] + found, count + 1);
                    }
                }
            }
            last = Some((place, keyframe, colour));
        }
        sums.map(|sum| sum / f64::from(count.max(1)))
    }

    /// `next_from_here` on a path, and its unit of length in that of `found` between the two: what
    /// one of the paths has drifted in scale until here is no fault of the other.
    fn motion(&self, poses: &[Pose<f64>], here: usize, next: usize) -> (Pose<f64>, f64) {
        let next_from_here = |poses: &[Pose<f64>]| poses[next].inverse() * poses[here];
        let (motion, own) = (next_from_here(poses), next_from_here(&self.poses));
        let ratio = motion.translation.norm() / own.translation.norm();
        let ratio = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        (motion, self.scale * ratio)
    }

    /// How well the surroundings of a landmark in one picture fit the next.
    fn fit(
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

/// The factor that makes distances on the path found those of the files, by least squares.
fn scale(came: &[Pose<f64>], found: &[Option<Pose<f64>>]) -> Option<f64> {
    let both: Vec<_> = came.iter().zip(found).filter_map(|(c, f)| Some((*c, (*f)?))).collect();
    let apart = |a: Pose<f64>, b: Pose<f64>| (a.translation - b.translation).norm();
    let (mut product, mut square) = (0.0, 0.0);
    for (i, (came, found)) in both.iter().enumerate() {
        for (other_came, other_found) in &both[..i] {
            let distance = apart(*found, *other_found);
            product += apart(*came, *other_came) * distance;
            square += distance * distance;
        }
    }
    Some(product / square).filter(|s| s.is_finite() && *s > 0.0)
}

/// The path found in the world of the files; where it has no pose, from the last one that it has by
/// the motion in the files.
fn poses(came: &[Pose<f64>], found: &[Option<Pose<f64>>], scale: f64) -> Option<Vec<Pose<f64>>> {
    let scaled = |pose: Pose<f64>| Pose { translation: pose.translation * scale, ..pose };
    let first = found.iter().position(Option::is_some)?;
    let world_from_found = came[first] * scaled(found[first]?).inverse();
    let mut known = (came[first], came[first]);
    let place = |(came, found): (&Pose<f64>, &Option<Pose<f64>>)| {
        if let Some(found) = found {
            known = (*came, world_from_found * scaled(*found));
        }
        known.1 * (known.0.inverse() * *came)
    };
    Some(came.iter().zip(found).map(place).collect())
}

/// Normalised correlation of the patches around two points; none at a border or without contrast.
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
    use i2slam_geometry::{Tangent, Vec3};

    const COUNT: usize = 14;

    /// The true pose of a picture of the wall, in a unit of a third of the wall's.
    fn truth(place: usize) -> Pose<f64> {
        let translation = Vec3::new(3.0 * 0.06 * place as f64, 0.0, 0.0);
        Pose { translation, ..Pose::identity() }
    }

    /// True poses moved at random by up to so much of the unit and so many radians.
    fn moved(by: (f64, f64)) -> Vec<Pose<f64>> {
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
        let load = |place: usize| Ok(stamped(&camera, place, place as f64 / 30.0));
        let found = MonocularSource::find(
            Intrinsics::Known(camera),
            COUNT,
            load,
            &OdometryProgress::default(),
        )
        .expect("a path");
        let mut source =
            RefinedImport::new(camera, poses, &found, load, CancellationToken::default())
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
        let came = moved((0.06, 0.02));
        let before = errors(came.iter().copied());
        let keyframes = refined(came);
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
    fn poses_that_fit_stay_as_they_came() {
        let came = moved((0.0, 0.0));
        let keyframes = refined(came.clone());
        assert!(keyframes.iter().map(|k| k.world_from_camera).eq(came));
    }

    #[test]
    fn keyframes_that_were_not_found_follow_the_motion_in_the_files() {
        let came: Vec<Pose<f64>> = (0..4).map(truth).collect();
        let found = [None, Some(truth(1)), None, Some(truth(3))];
        assert!((scale(&came, &found).expect("a scale") - 1.0).abs() < 1e-12);
        let poses = poses(&came, &found, 1.0).expect("one is known");
        for (pose, due) in poses.iter().zip(&came) {
            assert!((pose.translation - due.translation).norm() < 1e-12);
        }
    }
}
