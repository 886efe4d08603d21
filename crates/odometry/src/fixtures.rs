//! Synthetic states shared by unit tests.

use crate::sfm_state::SfmState;
use crate::track::tracks::{Observation, Track, Tracks};
use i2slam_check::noise;
use i2slam_geometry::{Camera, Image, Pose, Vec3};

/// Camera of the unit tests.
pub(crate) fn camera() -> Camera<f64> {
    Camera { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 160.0, cy: 120.0 }
}

/// A state with true poses. Every frame begins `per_frame` points within `spread` pixels of the
/// centre, seen in twelve frames where `observe` projects them, given two numbers for noise.
pub(crate) fn state(
    (frames, per_frame, keyframe_step): (usize, usize, usize),
    spread: [f64; 2],
    pose: impl Fn(usize) -> Pose<f64>,
    observe: impl Fn(Vec3<f64>, usize, &[f64]) -> Option<[f64; 2]>,
) -> SfmState {
    let track = |index: usize| {
        let (begin, n) = (index / per_frame, noise(index as u64, 27));
        let (u, v) = (160.0 + spread[0] * n[0], 120.0 + spread[1] * n[1]);
        let point = pose(begin) * camera().unproject(u, v, 2.5 + n[2]);
        let observations = (begin..(begin + 12).min(frames)).filter_map(|frame| {
            let at = observe(point, frame, &n[3 + 2 * (frame - begin)..])?;
            Some(Observation::new(frame, at, 0.3))
        });
        Track { observations: observations.collect() }
    };
    let tracks = (0..per_frame * frames).map(track).collect();
    let keyframes = (0..frames).step_by(keyframe_step).collect();
    let tracks = Tracks { tracks, keyframes, frames, ..Tracks::default() };
    let mut state = SfmState::new(camera(), tracks);
    state.poses = (0..frames).map(|frame| Some(pose(frame))).collect();
    state.triangulate_missing();
    state
}

/// Random brightness of 6 px blobs, moved to the right by `shift` [px].
pub(crate) fn moved_blobs(shift: f32) -> Image<f32> {
    let numbers = noise(3, 40 * 40);
    let at = |i: usize, j: usize| numbers[j * 40 + i] as f32;
    Image::from_fn(96, 72, 1, |_, column, row| {
        let (x, y) = ((column as f32 - shift) / 6.0 + 10.0, row as f32 / 6.0 + 10.0);
        let (i, j, u, v) = (x as usize, y as usize, x.fract(), y.fract());
        let top = at(i, j) * (1.0 - u) + at(i + 1, j) * u;
        let bottom = at(i, j + 1) * (1.0 - u) + at(i + 1, j + 1) * u;
        0.5 + 0.4 * (top * (1.0 - v) + bottom * v)
    })
}
