//! The vertical of a scene: floors, tables and walls say where it is, cameras which end is up.

use super::ground::{Patch, ground};
use i2slam::geometry::{Camera, Image, Mat3, Pose, Rotation, Vec3, symmetric_eigen};
use i2slam::{FrameEstimate, Reconstruction};

/// Where up is in the world of a result.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Up {
    /// Estimated from cameras and surfaces.
    #[default]
    Estimated,
    /// Against the y axis: the world stays as it is.
    Kept,
    /// In this direction.
    Given(Vec3<f64>),
}

/// Up of a levelled world, whose y axis points down.
pub(crate) const LEVEL_UP: Vec3<f64> = Vec3 { x: 0.0, y: -1.0, z: 0.0 };

/// Views whose surfaces are measured.
const VIEWS: usize = 12;
/// Pixels from one normal to the next, and between the points that span it.
const SPACING: usize = 4;
/// Largest angles to the vertical or the horizontal at which a surface still counts, wide to narrow
/// [degrees]: people hold cameras level to about 20 degrees on average.
const WINDOWS: [f64; 4] = [20.0, 12.0, 6.0, 3.0];
/// Least share of all surfaces that must lie flat or stand, else cameras alone count.
const MIN_SHARE: f64 = 0.15;
/// Least share of the surfaces that bear out the best direction at which another one counts: to right
/// angles, any of three does.
const MIN_SUPPORT: f64 = 0.6;
/// Largest mean angle by which cameras look up or down [degrees].
const MAX_PITCH: f64 = 60.0;
/// Least share of the second smallest spread of the cameras' right axes at which they span a plane.
const MIN_SPREAD: f64 = 0.02;

/// The rotation from the world of a result to a levelled one, without a turn about the vertical, and the
/// height of the ground in it; `None` where it was not found, and in a world that is kept.
pub(crate) fn level(reconstruction: &Reconstruction, up: Up) -> (Rotation<f64>, Option<f64>) {
    if up == Up::Kept {
        return (Rotation::identity(), None);
    }
    let frames = reconstruction.frames.iter().filter(|frame| frame.tracked);
    let poses: Vec<Pose<f64>> = frames.map(FrameEstimate::middle).collect();
    let surfaces = surfaces_of(reconstruction, &poses);
    let up = match up {
        Up::Given(direction) => unit(direction),
        _ => up_of_cameras(&poses).map(|first| {
            let normals: Vec<Vec3<f64>> = surfaces.iter().map(|patch| patch.normal).collect();
            best_up(&normals, &poses, first)
        }),
    };
    let turn = up.map_or_else(Rotation::identity, |up| between(up, LEVEL_UP));
    (turn, ground(&surfaces, turn.inverse().rotate(LEVEL_UP)))
}

/// Surfaces in the depth of some views; none of an empty map.
fn surfaces_of(reconstruction: &Reconstruction, poses: &[Pose<f64>]) -> Vec<Patch> {
    if reconstruction.map.is_empty() {
        return Vec::new();
    }
    let views = poses.len().min(VIEWS);
    let mut viewer = reconstruction.viewer();
    let mut surfaces = Vec::new();
    for view in 0..views {
        let pose = poses[(2 * view + 1) * poses.len() / (2 * views)];
        surfaces.extend(patches_of(&viewer.depth(pose), &reconstruction.camera, pose));
    }
    surfaces
}

/// Up by surfaces, from the first guess and from what is up in some pictures: a camera that tilts
/// far without a turn has a mean far off. Of the directions that surfaces bear out about as well, the
/// one from which cameras are tilted least, and rolled least; people look down more often than up.
fn best_up(normals: &[Vec3<f64>], poses: &[Pose<f64>], first: Vec3<f64>) -> Vec3<f64> {
    let apart = poses.len().div_ceil(VIEWS).max(1);
    let of_pictures = poses.iter().step_by(apart).map(|p| p.rotation.rotate(LEVEL_UP));
    let ups: Vec<Vec3<f64>> = std::iter::once(first)
        .chain(of_pictures)
        .map(|start| up_of_surfaces(normals, start))
        .collect();
    let support = |up: Vec3<f64>| {
        let (near, upright) = (WINDOWS[2].to_radians().cos(), WINDOWS[2].to_radians().sin());
        let holds = |n: &&Vec3<f64>| !(upright..=near).contains(&n.dot(up).abs());
        normals.iter().filter(holds).count() as f64 / normals.len().max(1) as f64
    };
    let tilt = |up: Vec3<f64>| {
        let tilts = poses.iter().map(|pose| {
            let [over, forward] =
                [LEVEL_UP, Vec3::new(0.0, 0.0, 1.0)].map(|axis| pose.rotation.rotate(axis).dot(up));
            over.clamp(-1.0, 1.0).acos() + forward.clamp(0.0, 1.0).asin()
        });
        tilts.sum::<f64>()
    };
    let most = ups.iter().map(|&up| support(up)).fold(MIN_SHARE, f64::max);
    let borne_out = ups.iter().copied().filter(|&up| support(up) >= MIN_SUPPORT * most);
    borne_out.min_by(|&a, &b| tilt(a).total_cmp(&tilt(b))).unwrap_or(first)
}

/// Up by the cameras of tracked frames alone; none without.
pub(crate) fn up_of_frames(frames: &[FrameEstimate]) -> Option<Vec3<f64>> {
    let tracked = frames.iter().filter(|frame| frame.tracked);
    up_of_cameras(&tracked.map(FrameEstimate::middle).collect::<Vec<_>>())
}

/// Up by the cameras alone: perpendicular to their right axes where these span a plane, as those of
/// a camera that is held level do while it turns; else the mean of what is up in the pictures.
fn up_of_cameras(poses: &[Pose<f64>]) -> Option<Vec3<f64>> {
    let (mut mean, mut spread) = (Vec3::zero(), Mat3::zero());
    for pose in poses {
        mean = mean - pose.rotation.rotate(Vec3::new(0.0, 1.0, 0.0));
        let right = pose.rotation.rotate(Vec3::new(1.0, 0.0, 0.0));
        spread = spread + Mat3::outer(right, right);
    }
    let mean = unit(mean)?;
    let (axis, second) = least_axis(&spread);
    let axis = if axis.dot(mean) < 0.0 { -axis } else { axis };
    let is_plane = second > MIN_SPREAD * poses.len() as f64;
    let is_near = axis.dot(mean) > MAX_PITCH.to_radians().cos();
    Some(if is_plane && is_near { axis } else { mean })
}

/// Up by surfaces that lie flat or stand, near a first guess: the direction `u` with the least
/// `Σ_flat |u × n|² + Σ_standing (u · n)²`, in windows that narrow.
fn up_of_surfaces(normals: &[Vec3<f64>], first: Vec3<f64>) -> Vec3<f64> {
    let mut up = first;
    for window in WINDOWS {
        let (near, upright) = (window.to_radians().cos(), window.to_radians().sin());
        let (mut spread, mut count) = (Mat3::zero(), 0);
        for &normal in normals {
            let along = normal.dot(up).abs();
            let outer = Mat3::outer(normal, normal);
            if along > near {
                spread = spread + Mat3::identity() + outer.scaled(-1.0);
            } else if along < upright {
                spread = spread + outer;
            } else {
                continue;
            }
            count += 1;
        }
        let (axis, second) = least_axis(&spread);
        // One wall alone leaves a direction open.
        if count == 0
            || (count as f64) < MIN_SHARE * normals.len() as f64
            || second < 0.05 * count as f64
        {
            return up;
        }
        up = if axis.dot(up) < 0.0 { -axis } else { axis };
    }
    up
}

/// Patches of the surfaces in a depth picture, in the world.
fn patches_of(
    depth: &Image<f32>,
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
) -> Vec<Patch> {
    let point = |column: usize, row: usize| {
        let z = f64::from(depth.at(0, column, row));
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        (z > 0.0).then(|| camera.unproject(u, v, z))
    };
    let mut patches = Vec::new();
    for row in (0..depth.height.saturating_sub(SPACING)).step_by(SPACING) {
        for column in (0..depth.width.saturating_sub(SPACING)).step_by(SPACING) {
            let corner = point(column, row);
            let sides = (point(column + SPACING, row), point(column, row + SPACING));
            let (Some(a), (Some(b), Some(c))) = (corner, sides) else { continue };
            // Of a surface seen at a very low angle noise is all there is; an edge is none.
            let normal = unit((b - a).cross(c - a)).filter(|n| n.dot(a).abs() > 0.1 * a.norm());
            patches.extend(normal.map(|normal| {
                let towards = if normal.dot(a) > 0.0 { -normal } else { normal };
                Patch {
                    place: world_from_camera * a,
                    normal: world_from_camera.rotation.rotate(towards),
                    area: a.z * a.z / (towards.dot(a) / a.norm()).abs(),
                    depth: a.z,
                }
            }));
        }
    }
    patches
}

/// The axis of a symmetric matrix with the least eigenvalue, and the second smallest eigenvalue.
fn least_axis(matrix: &Mat3<f64>) -> (Vec3<f64>, f64) {
    let (values, vectors) = symmetric_eigen(matrix);
    let values = values.to_array();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let axis = Vec3::from_array(std::array::from_fn(|row| vectors[(row, order[0])]));
    (axis, values[order[1]])
}

fn unit(v: Vec3<f64>) -> Option<Vec3<f64>> {
    let norm = v.norm();
    (norm.is_finite() && norm > 0.0).then(|| v * norm.recip())
}

/// The shortest rotation from one unit vector to another.
fn between(from: Vec3<f64>, to: Vec3<f64>) -> Rotation<f64> {
    let cosine = from.dot(to);
    if cosine > -0.999_999 {
        return Rotation { w: 1.0 + cosine, v: from.cross(to) }.normalized();
    }
    // Upside down: about any axis that is perpendicular; the forward one keeps the direction of view.
    let forward = Vec3::new(0.0, 0.0, 1.0);
    let across = unit(forward - to * forward.dot(to)).unwrap_or(Vec3::new(1.0, 0.0, 0.0));
    Rotation { w: 0.0, v: across }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pitched(yaw: f64, pitch: f64) -> Pose<f64> {
        let turn = |x, y, z| Rotation::exp(Vec3::new(x, y, z));
        Pose::new(turn(0.0, yaw, 0.0) * turn(pitch, 0.0, 0.0), Vec3::zero())
    }

    fn degrees(a: Vec3<f64>, b: Vec3<f64>) -> f64 {
        a.cross(b).norm().atan2(a.dot(b)).to_degrees()
    }

    #[test]
    fn a_camera_that_turns_and_looks_down_is_level() {
        let poses: Vec<_> = (0..10).map(|i| pitched(0.1 * f64::from(i), -0.4)).collect();
        let up = up_of_cameras(&poses).expect("poses");
        assert!(degrees(up, LEVEL_UP) < 1e-6, "{up:?}");
        // One that does not turn tells no more than what is up in its pictures.
        let up = up_of_cameras(&[pitched(0.0, -0.3); 3]).expect("poses");
        assert!((degrees(up, LEVEL_UP) - 0.3_f64.to_degrees()).abs() < 1e-6, "{up:?}");
        assert_eq!(up_of_cameras(&[]), None);
    }

    #[test]
    fn surfaces_correct_the_cameras() {
        let truth = unit(Vec3::new(0.2, -1.0, 0.1)).expect("a direction");
        let frame = between(Vec3::new(0.0, 0.0, 1.0), truth);
        let normal = |x, y, z| frame.rotate(Vec3::new(x, y, z));
        let (floor, walls) =
            (normal(0.0, 0.0, -1.0), [normal(1.0, 0.0, 0.0), normal(0.6, 0.8, 0.0)]);
        let slope = unit(normal(0.0, 0.3, 1.0)).expect("a direction");
        let first = frame.rotate(unit(Vec3::new(0.12, -0.1, 1.0)).expect("a direction"));
        let mixed = |floors, standing: usize, slopes| {
            let mut normals = vec![floor; floors];
            normals.extend((0..standing).map(|i| walls[i % 2]));
            normals.extend(vec![slope; slopes]);
            up_of_surfaces(&normals, first)
        };
        assert!(degrees(mixed(30, 0, 20), truth) < 0.1);
        assert!(degrees(mixed(0, 60, 10), truth) < 0.1);
        // One wall, or hardly a surface that lies or stands: the first guess stays.
        assert_eq!(up_of_surfaces(&[walls[0]; 40], first), first);
        assert_eq!(up_of_surfaces(&[], first), first);
    }

    #[test]
    fn a_camera_that_tilts_without_a_turn_is_righted_by_surfaces() {
        // From level to 60 degrees down, before a wall and over a table, in a world tilted by 5 degrees.
        let world = Rotation::exp(Vec3::new(0.05, 0.0, 0.07));
        let poses: Vec<_> = (0..13)
            .map(|i| {
                let Pose { rotation, translation } =
                    pitched(0.0, -5.0_f64.to_radians() * f64::from(i));
                Pose::new(world * rotation, translation)
            })
            .collect();
        let (wall, table) = (Vec3::new(0.0, 0.0, -1.0), LEVEL_UP);
        let normals: Vec<_> = [wall, table, Vec3::new(1.0, 0.0, 0.0)]
            .iter()
            .flat_map(|&normal| vec![world.rotate(normal); 20])
            .collect();
        let first = up_of_cameras(&poses).expect("poses");
        let truth = world.rotate(LEVEL_UP);
        assert!(degrees(first, truth) > 25.0);
        let up = best_up(&normals, &poses, first);
        assert!(degrees(up, truth) < 0.1, "{up:?}");
        assert_eq!(best_up(&[], &poses, first), first);
    }

    #[test]
    fn a_camera_that_rolls_is_not_laid_on_its_side() {
        let poses: Vec<_> = (-2..10)
            .map(|i| Rotation::exp(Vec3::new(0.0, 0.0, 10.0_f64.to_radians() * f64::from(i))))
            .map(|rotation| Pose::new(rotation, Vec3::zero()))
            .collect();
        let normals: Vec<_> = [Vec3::new(0.0, 0.0, -1.0), LEVEL_UP, Vec3::new(1.0, 0.0, 0.0)]
            .iter()
            .flat_map(|&normal| vec![normal; 20])
            .collect();
        let first = up_of_cameras(&poses).expect("poses");
        let up = best_up(&normals, &poses, first);
        assert!(degrees(up, LEVEL_UP) < 0.1, "{up:?}");
    }

    #[test]
    fn the_shortest_rotation_meets_its_target() {
        for from in [Vec3::new(0.6, 0.0, 0.8), LEVEL_UP, -LEVEL_UP, Vec3::new(0.0, 0.0, -1.0)] {
            let turned = between(from, LEVEL_UP).rotate(from);
            assert!((turned - LEVEL_UP).norm() < 1e-9, "{from:?} {turned:?}");
        }
    }
}
