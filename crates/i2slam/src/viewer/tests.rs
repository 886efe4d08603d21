//! Pictures of a textured wall.

use super::pose_optimization::tests::room;
use super::*;
use i2slam_formation::ShutterPoses;
use i2slam_geometry::Tangent;

/// A frame that turns by `angle` [rad] while its shutter is open.
fn turning(room: &Reconstruction, angle: f64, readout: f64) -> FrameEstimate {
    let half = Tangent::from_array([0.0, 0.0, 0.0, 0.0, 0.5 * angle, 0.0]);
    let end = |half| Pose::identity().retract(half);
    FrameEstimate {
        shutter: ShutterPoses { start: end(half.scaled(-1.0)), end: end(half) },
        blur_length: angle * room.camera.fx,
        readout,
        ..room.imagined_frame(0, Pose::identity())
    }
}

fn difference(a: &Image<f32>, b: &Image<f32>) -> f64 {
    let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
    let sum: f64 = a.data.iter().zip(&b.data).map(square).sum();
    (sum / a.data.len() as f64).sqrt()
}

#[test]
fn rows_of_a_frame_without_blur_are_skewed() {
    let room = room();
    let mut viewer = room.viewer();
    // 0.36 px during the exposure, 7.2 px from the first row to the last.
    let [still, rolled] = [0.0, 20.0].map(|readout| turning(&room, 0.004, readout));
    assert_eq!(viewer.sharp(&rolled), viewer.sharp(&still));
    let [global, skewed] = [&still, &rolled].map(|frame| viewer.blurred(frame));
    assert!(difference(&global, &skewed) > 0.02);
    let (row, height) = (6, room.camera.height);
    let turned = Pose::identity().retract(Tangent::from_array([
        0.0,
        0.0,
        0.0,
        0.0,
        0.08 * ((row as f64 + 0.5) / height as f64 - 0.5),
        0.0,
    ]));
    let then = viewer.sharp_clamped(&still, turned);
    let off = |picture: &Image<f32>| {
        let columns = 8..room.camera.width - 8;
        let error = |i| f64::from(picture.at(1, i, row) - then.at(1, i, row)).abs();
        columns.map(error).sum::<f64>()
    };
    assert!(off(&skewed) < 0.3 * off(&global), "{} {}", off(&skewed), off(&global));
}

#[test]
fn a_blurred_picture_takes_no_more_renders_than_configured() {
    let room = room();
    let viewer = room.viewer();
    let most = room.config.formation.virtual_cameras;
    let sampling = |readout| viewer.sampling(&turning(&room, 0.2, readout));
    let (global, rolling) = (sampling(0.0), sampling(0.5));
    assert_eq!((global.method, global.virtual_cameras), (BlurMethod::Exact, most));
    assert_eq!(rolling.method, BlurMethod::Image);
    assert!(Sampling::new(&room.config.formation, 18.0, 0.0).virtual_cameras > most);
}

/// A still frame's blurred picture is drawn by a way of its own.
#[test]
fn pictures_of_one_pose_are_made_of_one_render() {
    let room = room();
    let mut viewer = room.viewer();
    let frame = turning(&room, 0.0, 0.0);
    let sharp = viewer.sharp(&frame);
    assert!(difference(&sharp, &viewer.blurred(&frame)) < 1e-6);
    let here = viewer.hdr(frame.middle());
    let away = Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, 0.1, 0.0]));
    assert!(difference(&here, &viewer.hdr(away)) > 0.01);
    assert_eq!(viewer.hdr(away), room.viewer().hdr(away));
    assert_eq!(viewer.depth(away), room.viewer().depth(away));
    assert_eq!(viewer.sharp_clamped(&frame, away), room.viewer().sharp_clamped(&frame, away));
    assert_eq!((viewer.sharp(&frame), viewer.hdr(frame.middle())), (sharp, here));
}
