use super::*;
use i2slam_dataset::DepthPicture;
use i2slam_geometry::{Image, Rotation};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A wall with a step in depth, seen from `position` tenths to the right.
pub(in crate::keyframes) fn picture(camera: &Camera<f64>, position: usize) -> Image<f32> {
    let mut out = Image::new(camera.width, camera.height, 3);
    let pixels = camera.pixels();
    for i in 0..pixels {
        let (u, v) = Camera::pixel_centre(i % camera.width, i / camera.width);
        let ray = camera.unproject(u, v, 1.0);
        let at = |z: f64| (ray.x * z + 0.06 * position as f64, ray.y * z);
        let near = at(2.0);
        let (x, y) = if near.1 > 0.1 { near } else { at(3.5) };
        let wave = |a: f64, b: f64| (a * x + b * y).sin();
        let value = 0.5 + 0.12 * (wave(13.0, 5.0) + wave(-6.0, 17.0) + wave(23.0, -19.0));
        (0..3).for_each(|c| out.data[c * pixels + i] = value as f32);
    }
    out
}

pub(in crate::keyframes) fn stamped(
    camera: &Camera<f64>,
    position: usize,
    timestamp: f64,
) -> Frame {
    Frame::colour_only(2 * position, timestamp, picture(camera, position))
}

pub(in crate::keyframes) fn camera() -> Camera<f64> {
    Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 }
}

/// The picture at a position of a video of 30 frames per second.
fn load(position: usize) -> Result<Frame, PictureError> {
    Ok(stamped(&camera(), position, position as f64 / 30.0))
}

/// Reconstructs the first `count` pictures of `load`.
fn find<L: FnMut(usize) -> Result<Frame, PictureError>>(
    count: usize,
    load: L,
) -> Result<MonocularSource<L>, MonocularError> {
    let progress = OdometryProgress::default();
    MonocularSource::find(Intrinsics::Known(camera()), count, load, &progress)
}

#[test]
fn pictures_become_keyframes_with_poses_and_sparse_depth() {
    let camera = camera();
    let load = |position: usize| match position {
        3 => Err("damaged".into()),
        _ => self::load(position),
    };
    let mut source = find(14, load).expect("a path");
    assert_eq!(source.camera(), &camera);
    assert!(matches!(source.refused(), [(3, why)] if why.to_string() == "damaged"));
    let count = source.reconstruction().keyframes.len();
    let mut positions = Vec::new();
    while let Some(keyframe) = source.next_keyframe() {
        let keyframe = keyframe.expect("keyframes can be read again");
        let position = keyframe.index / 2;
        assert_eq!(*keyframe.colour, picture(&camera, position));
        let depth = keyframe.depth.expect("sparse depth");
        let variance = depth.variance.expect("with variance");
        let known = depth.depth.data.iter().zip(&variance.data).filter(|(d, _)| **d > 0.0);
        assert!(known.clone().count() > 20 && known.clone().all(|(_, v)| *v > 0.0));
        positions.push(position);
    }
    assert!(positions.len() == count && count > 2 && !positions.contains(&3), "{positions:?}");
    assert!(positions.is_sorted() && source.reconstruction().trajectory().len() == 13);
}

#[test]
fn dense_depth_and_non_keyframes_are_delivered() {
    let camera = camera();
    let found = find(14, load).expect("a path");
    let others: Vec<PosedKeyframe> =
        found.non_keyframes(load).map(|frame| frame.expect("read again")).collect();
    let mut source = found.with_dense_depth(CancellationToken::default());
    let (mut known, mut indices) = (0, Vec::new());
    while let Some(keyframe) = source.next_keyframe() {
        let keyframe = keyframe.expect("keyframes can be read again");
        assert_eq!(keyframe.before.is_some(), keyframe.index > 0);
        let depth = keyframe.depth.expect("depth");
        known += depth.depth.data.iter().filter(|d| **d > 0.0).count();
        indices.push(keyframe.index);
    }
    assert!(2 * known > indices.len() * camera.pixels(), "{known} of {}", indices.len());
    assert!(others.iter().all(|frame| frame.depth.is_none()));
    indices.extend(others.iter().map(|frame| frame.index));
    indices.sort_unstable();
    assert!(indices.into_iter().eq((0..14).map(|position| 2 * position)));
}

/// The picture at a position with its true depth.
fn load_with_depth(position: usize) -> Result<Frame, PictureError> {
    let (camera, frame) = (camera(), load(position)?);
    let depth = Image::from_fn(camera.width, camera.height, 1, |_, column, row| {
        let (u, v) = Camera::pixel_centre(column, row);
        if camera.unproject(u, v, 2.0).y > 0.1 { 2.0 } else { 3.5 }
    });
    let measured = DepthPicture { image: Arc::new(depth), timestamp: frame.timestamp };
    Ok(Frame { depth: Some(measured), ..frame })
}

#[test]
fn frames_between_keyframes_come_in_order_with_their_measured_depth() {
    let found = find(14, load_with_depth).expect("a path");
    let keyframes = found.reconstruction().keyframes.len();
    let mut source =
        found.with_frames_between(load_with_depth).with_dense_depth(CancellationToken::default());
    assert_eq!(source.remaining(), 14);
    let mut delivered = Vec::new();
    while let Some(frame) = source.next_keyframe() {
        let frame = frame.expect("pictures can be read again");
        let truth =
            load_with_depth(frame.index / 2).expect("a picture").depth.expect("depth").image;
        let depth = frame.depth.expect("depth").depth;
        let near =
            depth.data.iter().zip(&truth.data).filter(|(z, due)| (*z / *due - 1.0).abs() < 0.02);
        assert!(10 * near.count() > 9 * depth.pixels(), "{}", frame.index);
        delivered.push((frame.index, frame.is_keyframe));
    }
    assert!(delivered.iter().map(|(index, _)| *index).eq((0..14).map(|position| 2 * position)));
    assert_eq!(delivered.iter().filter(|(_, is_keyframe)| *is_keyframe).count(), keyframes);
    assert!(keyframes < 14 && source.remaining() == 0);
}

/// Of fourteen frames ten are delivered as keyframes, none of them unusable; with measured depth the others
/// come, too.
#[test]
fn frames_that_a_map_is_fitted_to_come_as_keyframes() {
    let is_usable = |position: usize| position % 4 != 3;
    let delivered = |with_depth: bool| {
        let load = if with_depth { load_with_depth } else { load };
        let found = find(14, load).expect("a path").with_fitted_frames(10, is_usable);
        let found = if with_depth { found.with_frames_between(load) } else { found };
        let others = found.non_keyframes(load).count();
        let mut source = found.with_dense_depth(CancellationToken::default());
        let next = || source.next_keyframe();
        let frames: Vec<PosedKeyframe> = std::iter::from_fn(next).map(Result::unwrap).collect();
        let (keyframes, between): (Vec<_>, Vec<_>) = frames.iter().partition(|f| f.is_keyframe);
        let known = |frame: &&PosedKeyframe| {
            let depth = &frame.depth.as_ref().expect("depth").depth;
            2 * depth.data.iter().filter(|z| **z > 0.0).count() > depth.pixels()
        };
        assert_eq!((keyframes.len(), others), (10, 4));
        assert!(keyframes.iter().all(known));
        assert!(frames.is_sorted_by_key(|frame| frame.index));
        between.len()
    };
    assert_eq!([true, false].map(delivered), [4, 0]);
}

#[test]
fn frames_whose_depth_is_missing_are_no_keyframes() {
    let found = find(14, load_with_depth).expect("a path");
    let keyframes = found.reconstruction().keyframes.len();
    let mut source = found
        .with_fitted_frames(14, |_| true)
        .with_frames_between(load)
        .with_dense_depth(CancellationToken::default());
    let next = || source.next_keyframe();
    let frames: Vec<PosedKeyframe> = std::iter::from_fn(next).map(Result::unwrap).collect();
    let delivered = frames.iter().filter(|frame| frame.is_keyframe).count();
    assert_eq!((frames.len(), delivered), (14, keyframes));
}

#[test]
fn keyframes_may_be_smaller_than_the_odometry_pictures() {
    let small = camera().resized(80, 60);
    let found = find(14, load).expect("a path");
    let reduced = move |position: usize| {
        let of = self::load(position)?;
        Ok(Frame { colour: Arc::new(of.colour.resized_by_area(80, 60)), ..of })
    };
    let mut source =
        found.with_pictures((80, 60), reduced).with_dense_depth(CancellationToken::default());
    assert_eq!(*source.camera(), small);
    let (mut near, mut all) = (0, 0);
    while let Some(keyframe) = source.next_keyframe() {
        let keyframe = keyframe.expect("keyframes can be read again");
        assert_eq!((keyframe.colour.width, keyframe.colour.height), (80, 60));
        let depth = keyframe.depth.expect("depth").depth;
        // The rows below the step are as near to those above as 2 to 3.5.
        let (above, below) = depth.data.split_at(80 * 30);
        let mean = |z: &[f32]| {
            let known: Vec<f32> = z.iter().copied().filter(|z| *z > 0.0).collect();
            known.iter().sum::<f32>() / known.len().max(1) as f32
        };
        near += usize::from((mean(below) / mean(above) - 2.0 / 3.5).abs() < 0.06);
        all += 1;
    }
    assert!(all > 2 && near == all, "{near} of {all}");
}

#[test]
fn pictures_are_read_in_order_and_keyframes_once_more() {
    let positions = std::cell::RefCell::new(Vec::new());
    let load = |position: usize| {
        positions.borrow_mut().push(position);
        self::load(position)
    };
    let found = find(30, load).expect("a path");
    let mut source = found.with_dense_depth(CancellationToken::default());
    assert!(positions.take().into_iter().eq(0..30));
    while let Some(keyframe) = source.next_keyframe() {
        keyframe.expect("keyframes can be read again");
    }
    let again = positions.take();
    let rising = again.windows(2).all(|pair| pair[0] < pair[1]);
    assert!(
        rising && again.len() == source.reconstruction().keyframes.len() && again.len() > 5,
        "{again:?}"
    );
}

#[test]
fn cancellation_ends_the_search() {
    let camera = camera();
    let asked = Arc::new(AtomicUsize::new(0));
    let load = |position: usize| {
        asked.fetch_add(1, Ordering::SeqCst);
        self::load(position)
    };
    let cancellation = CancellationToken::when({
        let asked = Arc::clone(&asked);
        move || asked.load(Ordering::SeqCst) == 12
    });
    let progress = OdometryProgress::new(cancellation, |_, _, _| {});
    let found = MonocularSource::find(Intrinsics::Known(camera), 30, load, &progress);
    assert!(matches!(
        found.err(),
        Some(MonocularError::NoPath { failure: OdometryError::Cancelled, .. })
    ));
    assert_eq!(asked.load(Ordering::SeqCst), 12);
}

#[test]
fn errors_name_the_refused_pictures() {
    let camera = camera();
    let load = |position: usize| match position {
        0..2 => Ok(stamped(&camera, position, position as f64)),
        _ => Err("damaged".into()),
    };
    let found = find(5, load);
    let message = found.err().expect("two pictures show no path").to_string();
    assert!(message.contains("2 pictures are too few"), "{message}");
    assert!(message.contains("3 pictures could not be used, the first, 2: damaged"));
}

/// A straight path by colour alone takes the unit of the given one, with measured depth it keeps metres.
#[test]
fn a_path_is_moved_near_given_poses() {
    let turned = Rotation::exp(Vec3::new(0.3, -0.8, 0.2));
    let length = |with_depth: bool| {
        let truth = |position: usize| Vec3::new(0.06 * position as f64, 0.0, 0.0);
        let given = |position: usize| {
            let moved = turned.rotate(truth(position) * 4.0) + Vec3::new(1.0, 2.0, 3.0);
            Pose::new(turned, moved)
        };
        let given: Vec<Pose<f64>> = (0..14).map(given).collect();
        let load = if with_depth { load_with_depth } else { load };
        assert!(find(14, load).expect("a path").near(&given[..5]).is_some());
        let found = find(10, load).expect("a path");
        let more: Vec<Pose<f64>> = given.iter().chain(&given).copied().collect();
        assert!(found.near(&more).is_none(), "10 of 28 are too few");
        let near = find(14, load).expect("a path").near(&given).expect("near");
        let at = |frame: usize| near.reconstruction.poses[frame].expect("posed");
        let middle =
            |frames: [usize; 2]| (at(frames[0]).translation + at(frames[1]).translation) * 0.5;
        let due = (given[0].translation + given[13].translation) * 0.5;
        assert!((middle([0, 13]) - due).norm() < 0.03, "{:?}", middle([0, 13]));
        assert!(at(7).local(given[7]).rotation.norm() < 0.02);
        (at(13).translation - at(0).translation).norm() / (13.0 * 0.06)
    };
    let [alone, with_depth] = [length(false), length(true)];
    assert!((alone - 4.0).abs() < 0.1 && (with_depth - 1.0).abs() < 0.03, "{alone} {with_depth}");
}
