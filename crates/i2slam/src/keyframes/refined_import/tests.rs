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
    let mut source = RefinedImport::new(camera, poses, &found, &load, CancellationToken::default())
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
    // The motion during an exposure starts from the pictures before and after.
    for (place, keyframe) in keyframes.iter().enumerate() {
        let near =
            |place: usize| keyframes.get(place).map(|k| (place as f64 / 30.0, k.world_from_camera));
        let due = [place.checked_sub(1).and_then(near), near(place + 1)];
        assert_eq!([keyframe.before, keyframe.after], due, "{place}");
    }
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
