//! Frames of the front end's path as they are delivered to a map: pose, neighbours, and dense depth
//! of measured and estimated depths.

use super::row_rectification::ReadoutMotion;
use super::{EstimatedDepth, PosedKeyframe};
use i2slam_dataset::Frame;
use i2slam_geometry::{Image, Pose};
use i2slam_odometry::{
    DenseDepth, Keyframe, KeyframePictures, MeasuredDepth, PosedView, Reconstruction,
};
use std::sync::Arc;

/// Median landmark depth without a measured unit of length: that of a room in metres.
pub(crate) const MEDIAN_DEPTH: f64 = 2.0;

/// Largest relative standard deviation of a delivered landmark depth.
const MAX_DEVIATION: f64 = 0.3;

/// Factor on delivered deviations: the few pixels with depth would outweigh the picture.
const SPARSE_DEVIATION_FACTOR: f64 = 10.0;

/// Least relative deviation of a delivered landmark depth: its own neglects errors of the poses.
const MIN_DEVIATION: f64 = 0.1;

/// A frame of the reconstruction with its neighbours.
pub(crate) fn posed(
    found: &Reconstruction,
    index: usize,
    frame: Frame,
    pose: Pose<f64>,
) -> PosedKeyframe {
    // Of photographs those before and after in time are not near.
    let neighbour = |frame: usize| stamped(found, frame).filter(|_| !found.is_unordered);
    PosedKeyframe {
        timestamp: found.timestamps[index],
        before: index.checked_sub(1).and_then(neighbour),
        after: neighbour(index + 1),
        ..PosedKeyframe::from_frame(frame, pose)
    }
}

/// Pictures of a keyframe for its dense depth, all rows exposed with the middle one.
pub(crate) fn keyframe_pictures(
    found: &Reconstruction,
    keyframe: &Keyframe,
    frame: &Frame,
) -> KeyframePictures {
    let colour = match ReadoutMotion::of_keyframe(found, keyframe) {
        Some(motion) => Arc::new(motion.rectified(&found.camera, &frame.colour)),
        None => Arc::clone(&frame.colour),
    };
    KeyframePictures { colour, depth: measured_depth(found, keyframe.index, frame) }
}

/// A keyframe as dense depth sees it.
pub(crate) fn posed_view(keyframe: &Keyframe) -> PosedView {
    PosedView {
        world_from_camera: keyframe.world_from_camera,
        landmarks: keyframe.depths.iter().map(|d| d.depth).collect(),
    }
}

/// Measured depth of a frame of the reconstruction.
pub(crate) fn measured_depth(
    found: &Reconstruction,
    index: usize,
    frame: &Frame,
) -> Option<MeasuredDepth> {
    frame.depth.as_ref().map(|measured| MeasuredDepth {
        depth: Arc::clone(&measured.image),
        depth_from_colour: found.depth_from_colour(index, measured.timestamp),
    })
}

/// Time stamp and pose of a frame.
fn stamped(found: &Reconstruction, frame: usize) -> Option<(f64, Pose<f64>)> {
    Some((*found.timestamps.get(frame)?, (*found.poses.get(frame)?)?))
}

/// Dense depth of a keyframe, or landmarks completed by it where it covers at most half the picture.
pub(crate) fn depth(
    dense: Option<DenseDepth>,
    keyframe: &Keyframe,
    (width, height): (usize, usize),
) -> EstimatedDepth {
    let mut out = sparse_depth(keyframe, (width, height));
    let Some(dense) = dense.map(into_estimated) else { return out };
    if 2 * dense.depth.data.iter().filter(|z| **z > 0.0).count() > width * height {
        return dense;
    }
    for (pixel, z) in dense.depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        out.depth.data[pixel] = *z;
        if let (Some(to), Some(from)) = (&mut out.variance, &dense.variance) {
            to.data[pixel] = from.data[pixel];
        }
    }
    out
}

/// Dense depth as a keyframe carries it.
pub(crate) fn into_estimated(DenseDepth { depth, variance, .. }: DenseDepth) -> EstimatedDepth {
    EstimatedDepth { depth, variance: Some(variance) }
}

/// Landmark depths of a keyframe as images, zero elsewhere; the nearest landmark per pixel.
fn sparse_depth(keyframe: &Keyframe, (width, height): (usize, usize)) -> EstimatedDepth {
    let (mut depth, mut variance) = (Image::new(width, height, 1), Image::new(width, height, 1));
    for point in &keyframe.depths {
        let [u, v] = point.at;
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && point.variance.sqrt() <= MAX_DEVIATION * point.depth {
            let pixel = v as usize * width + u as usize;
            let (here, known) = (point.depth as f32, depth.data[pixel]);
            if known > 0.0 && known <= here {
                continue;
            }
            depth.data[pixel] = here;
            let deviation = point.variance.sqrt().hypot(MIN_DEVIATION * point.depth);
            variance.data[pixel] = (SPARSE_DEVIATION_FACTOR * deviation).powi(2) as f32;
        }
    }
    EstimatedDepth { depth, variance: Some(variance) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_landmark_of_a_pixel_is_delivered() {
        let point =
            |depth: f64| i2slam_odometry::SparseDepth { at: [2.5, 1.5], depth, variance: 1e-6 };
        for depths in [[1.0, 2.0], [2.0, 1.0]] {
            let keyframe = Keyframe {
                index: 0,
                timestamp: 0.0,
                world_from_camera: Pose::identity(),
                depths: depths.map(point).to_vec(),
            };
            assert_eq!(sparse_depth(&keyframe, (4, 3)).depth.at(0, 2, 1), 1.0);
        }
    }
}
