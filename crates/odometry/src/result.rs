//! Result of the odometry.

use crate::depth::sensor_model::DepthModel;
use crate::intrinsics::focal_length::Intrinsics;
use crate::intrinsics::observability::reestimate_intrinsics;
use crate::multiview::lens_distortion::brown_coefficients;
use crate::pose_deviation::{PoseDeviation, pose_deviations};
use crate::register::registration::MAX_JOINTLY_ADJUSTED_FRAMES;
use crate::rolling_shutter::readout::{median_frame_interval, pose_later};
use crate::sfm_state::SfmState;
use crate::track::tracks::Observation;
use crate::warning::Warning;
use i2slam_compute::median;
use i2slam_geometry::{Camera, Pose, StampedPose, Trajectory};
use std::sync::Arc;

/// Consecutive lost frames of a warning, and points tracked in them that show another place.
const MIN_LISTED_FRAMES: usize = 4;
const MIN_TRACKED_POINTS: usize = 40;
/// Largest deviation of a near point's inverse depth over the median inverse depth.
const MAX_NEAR_DEVIATION: f64 = 0.3;

/// A landmark observed in a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparseDepth {
    /// Image position of the undistorted pinhole camera, all rows exposed with the middle one [px].
    pub at: [f64; 2],
    /// Depth along the optical axis, in the unit of the poses.
    pub depth: f64,
    /// Variance of the depth with poses fixed, in that unit squared.
    pub variance: f64,
}

/// A keyframe with its landmarks.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Index of the frame among the accepted pictures.
    pub index: usize,
    /// Timestamp [s].
    pub timestamp: f64,
    /// Pose at mid-exposure.
    pub world_from_camera: Pose<f64>,
    /// Landmarks, in no particular order.
    pub depths: Vec<SparseDepth>,
}

/// Camera path with sparse structure. The unit of length is the metre where depth was measured.
/// Monocular scale is not observable: without depth it is the median depth of all landmarks in
/// keyframes.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// The pinhole camera: as given, or with the estimated focal length.
    pub camera: Camera<f64>,
    /// Radial distortion `(k1, k2)` as in OpenCV, where it was estimated, zero if not observable: a
    /// point at `c + f x` of the pinhole camera is seen at `c + f x (1 + k1 ‖x‖² + k2 ‖x‖⁴)`.
    pub distortion: Option<[f64; 2]>,
    /// Relative standard deviation of the focal length, where it was estimated and is observable.
    pub focal_deviation: Option<f64>,
    /// Rolling-shutter readout from the first to the last row [s], positive if the top row comes
    /// first; 0 for a global shutter. Poses are of the middle row.
    pub rolling_shutter_readout: f64,
    /// `world_from_camera` at mid-exposure of every accepted picture; `None` where it is lost.
    pub poses: Vec<Option<Pose<f64>>>,
    /// `world_from_camera` of every accepted picture as it was known when the picture came; `None`
    /// before the start and where it was lost. Empty with depth where the camera had to be estimated.
    pub online_poses: Vec<Option<Pose<f64>>>,
    /// Deviation of every pose against those of the frames around it; `None` where it is lost, or
    /// not determined.
    pub deviations: Vec<Option<PoseDeviation>>,
    /// Timestamps of all frames [s].
    pub timestamps: Vec<f64>,
    /// Model of the depth sensor; lengths are metres then. `None` by colour alone.
    pub depth_model: Option<DepthModel>,
    /// True if the poses are the given ones, which the pictures do not contradict or cannot replace.
    pub has_given_poses: bool,
    /// Registered keyframes, in order.
    pub keyframes: Vec<Keyframe>,
    /// True if the pictures are photographs, which were matched instead of tracked, in any order.
    pub is_unordered: bool,
    /// Degradations that a user should know of.
    pub warnings: Vec<Warning>,
}

impl Reconstruction {
    /// Scales camera, image positions and warnings to pictures of another size.
    #[must_use]
    pub fn resized(mut self, width: usize, height: usize) -> Self {
        let scale =
            [width as f64 / self.camera.width as f64, height as f64 / self.camera.height as f64];
        self.camera = self.camera.resized(width, height);
        let points = self.keyframes.iter_mut().flat_map(|k| &mut k.depths);
        points.for_each(|point| (0..2).for_each(|i| point.at[i] *= scale[i]));
        if let Some(model) = &mut self.depth_model {
            (0..2).for_each(|i| model.shift[i] *= scale[i]);
        }
        self.warnings.iter_mut().for_each(|warning| *warning = warning.resized(width));
        self
    }

    /// Multiplies all lengths by a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        let poses = self.poses.iter_mut().chain(&mut self.online_poses).flatten();
        let keyframes = self.keyframes.iter_mut();
        for pose in poses.chain(keyframes.map(|keyframe| &mut keyframe.world_from_camera)) {
            pose.translation = pose.translation * factor;
        }
        for point in self.keyframes.iter_mut().flat_map(|k| &mut k.depths) {
            (point.depth, point.variance) =
                (point.depth * factor, point.variance * factor * factor);
        }
        self.deviations.iter_mut().flatten().for_each(|d| d.position *= factor);
        self
    }

    /// Moves all poses to another world, `to_from_world`; those of when frames came stay in theirs.
    pub fn transform(&mut self, to_from_world: &Pose<f64>) {
        let poses = self.poses.iter_mut().flatten();
        let keyframes = self.keyframes.iter_mut().map(|k| &mut k.world_from_camera);
        poses.chain(keyframes).for_each(|pose| *pose = *to_from_world * *pose);
    }

    /// Median depth of the landmarks of all keyframes.
    pub fn median_depth(&self) -> Option<f64> {
        let depths = self.keyframes.iter().flat_map(|k| k.depths.iter().map(|d| d.depth));
        median(&mut depths.collect::<Vec<f64>>()).filter(|depth| *depth > 0.0)
    }

    /// The camera of a frame as seen from where it was when a depth picture with this timestamp
    /// \[s\] was taken, interpolated between the frames around it; the identity where that is not
    /// known.
    pub fn depth_from_colour(&self, frame: usize, depth_timestamp: f64) -> Pose<f64> {
        let delay = self.depth_model.as_ref().map_or(0.0, |model| model.delay);
        let of = |interval: f64| {
            let pose = (*self.poses.get(frame)?)?;
            let nearest = self.posed_frame_nearest(depth_timestamp + delay)?;
            let later = depth_timestamp + delay - self.timestamps[nearest];
            let then = pose_later(&self.poses, &self.timestamps, nearest, (later, interval))?;
            Some(then.inverse() * pose)
        };
        median_frame_interval(&self.timestamps).and_then(of).unwrap_or_else(Pose::identity)
    }

    /// The registered frame nearest to a time [s].
    fn posed_frame_nearest(&self, time: f64) -> Option<usize> {
        let end = self.timestamps.partition_point(|stamp| *stamp < time);
        let is_posed = |frame: &usize| self.poses.get(*frame).is_some_and(Option::is_some);
        let before = (0..end).rev().find(is_posed);
        let after = (end..self.poses.len()).find(is_posed);
        let distance = |frame: &usize| (self.timestamps[*frame] - time).abs();
        before.into_iter().chain(after).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Poses of all registered frames.
    pub fn trajectory(&self) -> Trajectory {
        stamped(&self.poses, &self.timestamps)
    }

    /// Poses of all frames as they were known when the frames came.
    pub fn online_trajectory(&self) -> Trajectory {
        stamped(&self.online_poses, &self.timestamps)
    }
}

fn stamped(poses: &[Option<Pose<f64>>], timestamps: &[f64]) -> Trajectory {
    let stamped = |(pose, timestamp): (&Option<Pose<f64>>, &f64)| {
        Some(StampedPose { timestamp: *timestamp, world_from_camera: (*pose)? })
    };
    poses.iter().zip(timestamps).filter_map(stamped).collect()
}

/// Builds the result in the first registered frame; the median depth is the unit without measured depth.
pub(crate) fn build_reconstruction(
    state: SfmState,
    timestamps: &[f64],
    intrinsics: &Intrinsics,
    (readout, distortion_dropped): (f64, bool),
    is_repeat: &[bool],
) -> Reconstruction {
    let posed = state.posed_frames();
    let world = posed.first().and_then(|f| state.poses[*f]).unwrap_or_else(Pose::identity);
    let is_metric = state.is_metric();
    let noise_scale = state.residual_scale().unwrap_or(1.0);
    let mut keyframes =
        keyframes_with_depth(&state, timestamps, &state.tracks.keyframes, noise_scale);
    let inverse = world.inverse();
    keyframes.iter_mut().for_each(|k| k.world_from_camera = inverse * k.world_from_camera);
    let poses: Vec<_> = state.poses.iter().map(|pose| pose.map(|pose| inverse * pose)).collect();
    let mut warnings = Vec::new();
    let lost = poses.len() - posed.len();
    if lost > 0 {
        if state.photographs.is_some() {
            let (count, photographs) = (lost, poses.len());
            warnings.push(Warning::PhotographsNotPlaced { count, photographs });
        } else {
            warnings.push(Warning::FramesLost { lost, frames: poses.len() });
            warnings.extend(lost_frame_warnings(&state));
        }
    }
    let distortion = match distortion_dropped {
        true => Some([0.0; 2]),
        false => {
            state.estimates_distortion.then(|| brown_coefficients(&state.camera, state.distortion))
        }
    };
    // Those of photographs are not known: neighbours in time, against which they count, are far away.
    let is_unordered = state.photographs.is_some();
    let (deviations, links) = match is_unordered {
        true => (vec![None; state.poses.len()], Vec::new()),
        false => pose_deviations(&state, is_repeat),
    };
    let (camera, depth_model) = (state.camera, is_metric.then(|| state.depth_model.clone()));
    let focal_deviation = focal_deviation(state, intrinsics, &mut warnings);
    if focal_deviation.is_some() && readout != 0.0 {
        warnings.push(Warning::RollingShutterFocalLength);
    }
    warnings.extend(distortion_dropped.then_some(Warning::DistortionUndetermined));
    warnings.extend(links.iter().map(|link| Warning::ScaleUncertain {
        frames: link.frames,
        percent: (100.0 * link.deviation).min(100.0),
    }));
    let found = Reconstruction {
        camera,
        is_unordered,
        has_given_poses: false,
        distortion,
        focal_deviation,
        rolling_shutter_readout: readout,
        poses,
        online_poses: Vec::new(),
        deviations,
        timestamps: timestamps.to_vec(),
        depth_model,
        keyframes,
        warnings,
    };
    match found.median_depth().filter(|_| !is_metric) {
        Some(unit) => found.scaled(unit.recip()),
        None => found,
    }
}

/// The path so far in its own world and unit of length, with the landmarks of one keyframe, given
/// by its frame, or of none.
pub(crate) fn reconstruction_so_far(state: &SfmState, keyframe: Option<usize>) -> Reconstruction {
    let timestamps = &state.timestamps;
    let readout = state.readout * median_frame_interval(timestamps).unwrap_or(0.0);
    let keyframes = keyframe.map_or_else(Vec::new, |frame| {
        keyframes_with_depth(state, timestamps, &[frame], state.noise_scale)
    });
    Reconstruction {
        camera: state.camera,
        is_unordered: state.photographs.is_some(),
        has_given_poses: false,
        distortion: None,
        focal_deviation: None,
        rolling_shutter_readout: readout,
        poses: state.poses.clone(),
        online_poses: Vec::new(),
        deviations: vec![None; state.poses.len()],
        timestamps: timestamps.to_vec(),
        depth_model: state.is_metric().then(|| state.depth_model.clone()),
        keyframes,
        warnings: Vec::new(),
    }
}

/// Warnings for long runs of frames without a pose.
fn lost_frame_warnings(state: &SfmState) -> Vec<Warning> {
    let is_lost: Vec<bool> = state.poses.iter().map(Option::is_none).collect();
    let mut out = Vec::new();
    let mut begin = 0;
    for run in is_lost.chunk_by(|a, b| a == b) {
        let frames = [begin, begin + run.len() - 1];
        begin += run.len();
        if run[0] && run.len() >= MIN_LISTED_FRAMES {
            let followed = state.tracked_points_within(frames) >= MIN_TRACKED_POINTS;
            out.push(match followed {
                true => Warning::DisconnectedFrames { frames },
                false => Warning::UntrackableFrames { frames },
            });
        }
    }
    out
}

/// Relative deviation of an estimated focal length; warns of a given one that fits badly.
fn focal_deviation(
    state: SfmState,
    intrinsics: &Intrinsics,
    warnings: &mut Vec<Warning>,
) -> Option<f64> {
    let camera = state.camera;
    let is_known = matches!(intrinsics, Intrinsics::Known(_));
    let state = match is_known {
        // Relative poses were found with the given focal length, and hold it.
        true => SfmState { relative_poses: Arc::default(), ..state },
        false => state,
    };
    let (released, covariance) = reestimate_intrinsics(state);
    let Some(covariance) = covariance else {
        let undetermined =
            Warning::FocalLengthUndetermined { focal_length: camera.fx, width: camera.width };
        warnings.extend((!is_known).then_some(undetermined));
        return None;
    };
    let relative = covariance[0][0].sqrt();
    if is_known {
        let (given, fitting) = (camera.fx, released.camera.fx);
        let off = (fitting / given).ln().abs();
        if off > 0.05 && off > 3.0 * relative {
            warnings.push(Warning::FocalLengthMismatch { given, fitting, width: camera.width });
        }
        return None;
    }
    if relative > 0.03 {
        warnings.push(Warning::FocalLengthUncertain { percent: 100.0 * relative });
    }
    Some(relative)
}

/// Those of `frames` that have a pose, with their landmarks, at residuals of `noise_scale` times
/// the tracker's deviations.
fn keyframes_with_depth(
    state: &SfmState,
    timestamps: &[f64],
    frames: &[usize],
    noise_scale: f64,
) -> Vec<Keyframe> {
    let is_long = state.posed_frames().len() > MAX_JOINTLY_ADJUSTED_FRAMES;
    let is_within = |f: usize| !is_long || state.tracks.keyframes.binary_search(&f).is_ok();
    let (mut bundle, _, tracks) = state.bundle_within(frames, false, is_within);
    // Poses stay, and take no room among the unknowns.
    bundle.fixed.fill(true);
    // Variances are multiplied by the squared scale, which is for positions alone.
    bundle.scale_depth_deviations(state.noise_scale / noise_scale.max(f64::MIN_POSITIVE));
    let mut variances = vec![None; state.landmarks.len()];
    for (track, variance) in tracks.iter().zip(bundle.inverse_depth_variances()) {
        variances[*track] = variance;
    }
    let keyframe = |index: usize| {
        let pose = state.poses[index]?;
        let depth = |(track, observation): (usize, &Observation)| {
            let (landmark, variance) = (state.landmarks[track]?, variances[track]?);
            if observation.is_outlier {
                return None;
            }
            let point_in_camera = pose.inverse() * landmark.position();
            let usable = landmark.inverse_depth() > 1e-4 && point_in_camera.z > 0.0;
            let slope = landmark.depth_by_inverse_depth(&pose);
            let variance = variance * (noise_scale * slope).powi(2);
            usable.then_some(SparseDepth {
                at: observation.at(),
                depth: point_in_camera.z,
                variance,
            })
        };
        let depths = discard_unreliable_near_points(
            state.observations_in(index).filter_map(depth).collect(),
        );
        let timestamp = timestamps[index];
        Some(Keyframe { index, timestamp, world_from_camera: pose, depths })
    };
    frames.iter().filter_map(|f| keyframe(*f)).collect()
}

/// Discards landmarks that are near only by chance: while a camera hardly moves, a point tracked a
/// pixel off fits best right before the lens, where `σ_z = z² σ_ρ` is small but `σ_ρ` is not.
fn discard_unreliable_near_points(mut depths: Vec<SparseDepth>) -> Vec<SparseDepth> {
    let usual = weighted_median_inverse_depth(&depths);
    depths.retain(|d| {
        let (inverse, deviation) = inverse_depth(d);
        inverse <= usual || deviation <= MAX_NEAR_DEVIATION * usual
    });
    depths
}

/// Inverse depth and its standard deviation.
fn inverse_depth(of: &SparseDepth) -> (f64, f64) {
    (1.0 / of.depth, of.variance.sqrt() / of.depth.powi(2))
}

/// Median inverse depth weighted by `1 / σ` against many vague points; 0 without any.
fn weighted_median_inverse_depth(depths: &[SparseDepth]) -> f64 {
    let mut weighed: Vec<(f64, f64)> = depths
        .iter()
        .map(inverse_depth)
        .map(|(inverse, deviation)| (inverse, 1.0 / deviation.max(f64::MIN_POSITIVE)))
        .collect();
    weighed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left = 0.5 * weighed.iter().map(|(_, weight)| weight).sum::<f64>();
    for &(inverse, weight) in &weighed {
        left -= weight;
        if left <= 0.0 {
            return inverse;
        }
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, camera};
    use crate::track::tracks::{DepthReading, Tracks};
    use i2slam_geometry::{Rotation, Vec3};

    /// A camera at rest sees no parallax: depth is as precise as its one reading, whether the
    /// tracker claims too little or too much.
    #[test]
    fn the_variance_of_a_measured_depth_is_that_of_the_sensor() {
        for error in [0.05, 0.4, 2.5] {
            let observe = |point: Vec3<f64>, _: usize, n: &[f64]| {
                let (u, v) = camera().project(point);
                Some([u + error * n[0], v + error * n[1]])
            };
            let mut state = fixtures::state((8, 30, 1), [100.0; 2], |_| Pose::identity(), observe);
            for (index, track) in state.tracks.tracks.iter_mut().enumerate() {
                let inverse = 0.4 + 0.001 * index as f64;
                let o = &mut track.observations[0];
                *o = o.with_depth(Some(DepthReading { inverse, sigma: 0.01 }));
            }
            state.landmarks.fill(None);
            state.triangulate_missing();
            state.update_noise_scale();
            let timestamps: Vec<f64> = (0..8).map(f64::from).collect();
            let scale = state.residual_scale().expect("residuals");
            let keyframes =
                keyframes_with_depth(&state, &timestamps, &state.tracks.keyframes, scale);
            let mut deviations: Vec<f64> =
                keyframes[0].depths.iter().map(|d| inverse_depth(d).1).collect();
            let usual = median(&mut deviations).expect("landmarks");
            assert!((usual / 0.01).ln().abs() < 0.1, "{usual} with {error} px");
        }
    }

    /// Frames a second away tell nothing of the motion.
    #[test]
    fn the_motion_until_a_depth_picture_is_that_of_near_frames() {
        let state = SfmState::new(camera(), Tracks { frames: 9, ..Tracks::default() });
        let step = Vec3::new(0.1, 0.0, 0.02);
        let timestamps: Vec<f64> =
            (0..9).map(|i| f64::from(i) / 30.0 + if i > 4 { 1.0 } else { 0.0 }).collect();
        let intrinsics = Intrinsics::Known(camera());
        let mut found =
            build_reconstruction(state, &timestamps, &intrinsics, (0.0, false), &[false; 9]);
        let pose = |i: i32| Some(Pose::new(Rotation::identity(), step * f64::from(i)));
        found.poses = (0..9).map(pose).collect();
        let moved = found.depth_from_colour(2, timestamps[2] + 0.01).translation;
        assert!((moved + step * 0.3).norm() < 1e-12, "{moved:?}");
        let beside_gap = found.depth_from_colour(4, timestamps[4] + 0.01).translation;
        assert!((beside_gap + step * 0.3).norm() < 1e-12, "{beside_gap:?}");
        assert_eq!(found.depth_from_colour(9, 0.15), Pose::identity());
        // 1.3 intervals later: on the parabola around frame 3, not 2.
        let cubic = |i: i32| {
            let x = 0.01 * f64::from(i).powi(3);
            Some(Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)))
        };
        found.poses = (0..9).map(cubic).collect();
        let moved = found.depth_from_colour(2, timestamps[2] + 1.3 / 30.0).translation.x;
        assert!((moved + 0.2821).abs() < 1e-9, "{moved}");
        found.poses[..4].fill(None);
        assert_eq!(found.depth_from_colour(4, timestamps[4] + 0.01), Pose::identity());
    }

    /// Precise points decide even where most lie before the lens; a precise near one stays.
    #[test]
    fn points_right_before_the_lens_are_left_out() {
        let point = |(depth, share): (f64, f64)| SparseDepth {
            at: [1.0, 2.0],
            depth,
            variance: (share * depth).powi(2),
        };
        let astray = [0.004, 0.006, 0.01, 0.005, 0.012, 0.3].map(|depth| (depth, 0.15));
        let measured = [(3.0, 0.02), (1.8, 0.01), (2.0, 0.02), (0.05, 0.002), (40.0, 0.5)];
        let all: Vec<SparseDepth> = astray.into_iter().chain(measured).map(point).collect();
        let kept = discard_unreliable_near_points(all);
        assert!(kept.iter().map(|d| d.depth).eq([3.0, 1.8, 2.0, 0.05, 40.0]), "{kept:?}");
        assert_eq!(discard_unreliable_near_points(Vec::new()), []);
    }

    /// A state that does not determine the focal length: a warning where it was estimated.
    #[test]
    fn a_focal_length_that_nothing_determines_is_said_to_be_a_guess() {
        let camera = camera();
        let tracks = Tracks { keyframes: vec![0, 1], frames: 2, ..Tracks::default() };
        let mut state = SfmState::new(camera, tracks);
        state.poses = vec![Some(Pose::identity()); 2];
        let warned = |intrinsics: Intrinsics| {
            let mut warnings = Vec::new();
            assert_eq!(focal_deviation(state.clone(), &intrinsics, &mut warnings), None);
            warnings
        };
        assert_eq!(warned(Intrinsics::Known(camera)), []);
        let guess = Warning::FocalLengthUndetermined { focal_length: 250.0, width: 320 };
        assert_eq!(warned(Intrinsics::Guess(camera)), [guess]);
    }
}
