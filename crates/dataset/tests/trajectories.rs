//! Trajectory files: round trip, and errors that name the line.

mod support;

use i2slam_dataset::{read_trajectory, write_trajectory};
use i2slam_geometry::{Pose, Rotation, StampedPose, Vec3};
use support::Folder;

#[test]
fn written_poses_are_read_again() {
    let folder = Folder::new();
    let poses: Vec<StampedPose> = (0..5)
        .map(|i| {
            let s = i as f64;
            let rotation = Rotation::exp(Vec3::new(0.3 * s, -0.2, 0.1 * s));
            let world_from_camera = Pose::new(rotation, Vec3::new(s, 0.5 * s, -1.0));
            StampedPose { timestamp: 1305031237.361618 + s / 30.0, world_from_camera }
        })
        .collect();
    let path = folder.join("trajectory.txt");
    write_trajectory(&path, &poses).expect("writes");
    let back = read_trajectory(&path).expect("reads");
    assert_eq!(back.len(), poses.len());
    for (a, b) in back.iter().zip(&poses) {
        let d = a.world_from_camera.local(b.world_from_camera);
        assert!((a.timestamp - b.timestamp).abs() < 1e-6);
        assert!(d.translation.norm() < 1e-8 && d.rotation.norm() < 1e-8);
    }
}

#[test]
fn columns_are_in_the_order_of_tum() {
    let folder = Folder::new();
    let text = "# t x y z qx qy qz qw\n\n2.5 1 2 3 0 0 1 0\n1.5 4 5 6 0 0 0 2\n";
    let poses = read_trajectory(folder.write("t.txt", text)).expect("reads");
    assert_eq!((poses[0].timestamp, poses[1].timestamp), (1.5, 2.5));
    assert_eq!(poses[0].world_from_camera.rotation, Rotation::identity());
    let half_turn = poses[1].world_from_camera;
    assert_eq!(half_turn.translation, Vec3::new(1.0, 2.0, 3.0));
    assert!((half_turn.rotation.rotate(Vec3::new(1.0, 0.0, 0.0)).x + 1.0).abs() < 1e-12);
}

#[test]
fn bad_lines_are_named() {
    let folder = Folder::new();
    for (text, parts) in [
        ("0 0 0 0 0 0 0 1\n1 NaN 0 0 0 0 0 1\n", ["line 2", "tx is NaN"]),
        ("# c\n1 0 0 0 0 0 1\n", ["line 2", "7 columns, expected 8"]),
        ("1 0 0 0 0 0 0 0\n", ["line 1", "quaternion is zero"]),
        ("1 0 0 zero 0 0 0 1\n", ["line 1", "tz is 'zero'"]),
        ("# only a comment\n", ["is empty", "timestamp tx ty tz"]),
    ] {
        let error = read_trajectory(folder.write("t.txt", text)).expect_err("an error").to_string();
        assert!(error.contains("t.txt"), "{error}");
        for part in parts {
            assert!(error.contains(part), "'{part}' is not in: {error}");
        }
    }
    assert!(
        read_trajectory(folder.join("none.txt")).is_err_and(|e| e.to_string().contains("none"))
    );
}
