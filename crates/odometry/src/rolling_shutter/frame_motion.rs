//! Motion of the camera around a frame: velocity and acceleration from the poses around it.
//!
//! A hand trembles with up to 12 Hz, of which two frame intervals at 30 frames a second are a good part: the
//! mean velocity over them is `sin(ω)/ω` of that at the frame, for `ω` radians an interval (0.83 at 5 Hz, 0.59
//! at 8 Hz). A cubic spline with continuous curvature has `3 sin(ω)/(ω (2 + cos(ω)))` of it (0.99 and 0.94), and
//! none of errors that alternate from frame to frame. In tangents at the frame, with the times `h_i` between
//! poses and the slopes `d_i` of the chords, its curvatures `M_i` solve
//!
//! ```text
//! h_{i-1} M_{i-1} + 2 (h_{i-1} + h_i) M_i + h_i M_{i+1} = 6 (d_i - d_{i-1}),   M = 0 at both ends
//! ```
//!
//! The acceleration is the second difference `2 (d_i - d_{i-1})/(h_{i-1} + h_i)`: the spline's own triples
//! errors that alternate from frame to frame.

use i2slam_geometry::{Pose, Tangent};

/// Poses before and after a frame that the spline goes through: each counts for a quarter of the one before it.
const NEIGHBOURS: usize = 4;
/// Largest distance of neighbouring poses [frame intervals].
pub(super) const MAX_GAP: f64 = 4.5;

/// Motion of a camera around the time of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameMotion {
    pub(crate) world_from_camera: Pose<f64>,
    /// Per second, in the frame's own axes.
    pub(crate) velocity: Tangent<f64>,
    /// Per second and second, in the frame's own axes; zero at the ends of a path.
    pub(crate) acceleration: Tangent<f64>,
}

impl FrameMotion {
    /// Motion around one of the frames with these poses; `None` where those before and after are far away in
    /// median frame intervals \[s\].
    pub(crate) fn new(
        poses: &[Option<Pose<f64>>],
        timestamps: &[f64],
        frame: usize,
        interval: f64,
    ) -> Option<Self> {
        let world_from_camera = poses[frame]?;
        let frames = frames_around(poses, timestamps, frame, interval);
        let knot =
            |f: &usize| Some((timestamps[*f], world_from_camera.local(poses[*f]?).to_array()));
        let knots: Vec<Knot> = frames.iter().filter_map(knot).collect();
        let place = frames.iter().position(|f| *f == frame)?;
        let velocity = Tangent::from_array(slope_at(&knots, place)?);
        let is_inside = 0 < place && place + 1 < knots.len();
        let bend =
            if is_inside { second_difference(&knots[place - 1..=place + 1]) } else { [0.0; 6] };
        Some(Self { world_from_camera, velocity, acceleration: Tangent::from_array(bend) })
    }

    /// The pose some time `later` \[s\].
    pub(crate) fn pose_at(&self, later: f64) -> Pose<f64> {
        let bend = self.acceleration.scaled(0.5 * later * later);
        self.world_from_camera.retract(self.velocity.scaled(later).plus(bend))
    }
}

/// A frame and the ones with a pose around it, in order.
fn frames_around(
    poses: &[Option<Pose<f64>>],
    timestamps: &[f64],
    frame: usize,
    interval: f64,
) -> Vec<usize> {
    let is_near = |a: usize, b: usize| {
        let time = (timestamps[a] - timestamps[b]).abs();
        0.0 < time && time < MAX_GAP * interval
    };
    let mut frames = vec![frame];
    for _ in 0..NEIGHBOURS {
        let (first, last) = (frames[0], frames[frames.len() - 1]);
        let before = (0..first).rev().find(|f| poses[*f].is_some());
        let after = (last + 1..poses.len()).find(|f| poses[*f].is_some());
        frames.extend(after.filter(|f| is_near(*f, last)));
        frames.splice(0..0, before.filter(|f| is_near(*f, first)));
    }
    frames
}

/// Time and value of a knot.
type Knot = (f64, [f64; 6]);

/// Derivative of the natural cubic spline through some knots at one of them; `None` for a single one.
fn slope_at(knots: &[Knot], place: usize) -> Option<[f64; 6]> {
    let last = knots.len().checked_sub(1).filter(|last| *last > 0)?;
    let curvatures = curvatures(knots);
    // The end of a spline is that of its last piece.
    let (from, to) = if place < last { (place, place + 1) } else { (place, place - 1) };
    let (time, chord) = chord(knots[from], knots[to]);
    let [near, far] = [from, to].map(|i| curvatures[i]);
    Some(std::array::from_fn(|k| chord[k] - time / 6.0 * (2.0 * near[k] + far[k])))
}

/// Second derivative of the parabola through three knots.
fn second_difference(knots: &[Knot]) -> [f64; 6] {
    let [(before, fall), (after, rise)] = [0, 1].map(|i| chord(knots[i], knots[i + 1]));
    std::array::from_fn(|k| 2.0 * (rise[k] - fall[k]) / (before + after))
}

/// Time and slope from one knot to another.
fn chord(from: Knot, to: Knot) -> (f64, [f64; 6]) {
    let time = to.0 - from.0;
    (time, std::array::from_fn(|k| (to.1[k] - from.1[k]) / time))
}

/// Curvatures of the natural spline at its knots (Thomas algorithm).
fn curvatures(knots: &[Knot]) -> Vec<[f64; 6]> {
    let mut out = vec![[0.0; 6]; knots.len()];
    let mut ratios = vec![0.0; knots.len()];
    for i in 1..knots.len() - 1 {
        let [(before, fall), (after, rise)] = [i - 1, i].map(|k| chord(knots[k], knots[k + 1]));
        let pivot = 2.0 * (before + after) - before * ratios[i - 1];
        ratios[i] = after / pivot;
        let known = out[i - 1];
        out[i] = std::array::from_fn(|k| (6.0 * (rise[k] - fall[k]) - before * known[k]) / pivot);
    }
    for i in (1..knots.len() - 1).rev() {
        let next = out[i + 1];
        (0..6).for_each(|k| out[i][k] -= ratios[i] * next[k]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    /// A place that trembles with `hertz` at 30 frames a second.
    fn trembling(hertz: f64) -> impl Fn(f64) -> Pose<f64> {
        move |time: f64| {
            let phase = std::f64::consts::TAU * hertz * time + 0.4;
            let turn = Rotation::exp(Vec3::new(0.0, 0.01 * phase.sin(), 0.0));
            Pose::new(turn, Vec3::new(0.02 * phase.cos(), 0.1 * time, 0.0))
        }
    }

    #[test]
    fn the_motion_of_a_trembling_hand_is_found() {
        let timestamps: Vec<f64> = (0..40).map(|f| f64::from(f) / 30.0).collect();
        for (hertz, due, largest) in [(2.0, 1.0, 1e-5), (5.0, 0.9925, 6e-4), (8.0, 0.9394, 3e-3)] {
            let place = trembling(hertz);
            let poses: Vec<_> = timestamps.iter().map(|time| Some(place(*time))).collect();
            let (mut found, mut along) = (0.0, 0.0);
            for frame in 8..32 {
                let motion =
                    FrameMotion::new(&poses, &timestamps, frame, 1.0 / 30.0).expect("neighbours");
                let (time, step) = (timestamps[frame], 1e-5);
                let change = place(time - step).local(place(time + step)).scaled(0.5 / step);
                found += motion.velocity.rotation.dot(change.rotation);
                along += change.rotation.norm_squared();
                assert!((motion.velocity.translation.y - 0.1).abs() < 1e-9, "{motion:?}");
                // A third of an interval later, as the last rows of a frame.
                let off = motion.pose_at(0.011).local(place(time + 0.011));
                assert!(off.rotation.norm() < largest, "{hertz} Hz: {off:?}");
            }
            assert!((found / along - due).abs() < 0.01, "{hertz} Hz: {}", found / along);
        }
    }

    #[test]
    fn frames_far_away_tell_no_motion() {
        let timestamps: Vec<f64> = (0..12).map(f64::from).collect();
        let place = trembling(0.01);
        let mut poses = vec![None; 12];
        let around = |poses: &[Option<Pose<f64>>], frame: usize| {
            FrameMotion::new(poses, &timestamps, frame, 1.0)
        };
        poses[4] = Some(place(4.0));
        assert!(around(&poses, 4).is_none());
        poses[10] = Some(place(10.0));
        assert!(around(&poses, 4).is_none());
        poses[8] = Some(place(8.0));
        let chord = place(4.0).local(place(8.0)).scaled(0.25).to_array();
        let motion = around(&poses, 4).expect("one neighbour");
        assert_eq!(motion.acceleration.to_array(), [0.0; 6]);
        for (found, due) in motion.velocity.to_array().into_iter().zip(chord) {
            // Frame 10 bends the spline.
            assert!((found - due).abs() < 2e-3, "{motion:?}");
        }
        assert!(around(&poses, 3).is_none());
    }
}
