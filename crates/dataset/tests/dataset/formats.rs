//! Formats: recognised by their files, with camera and poses.

use crate::support::{
    Folder, HEIGHT, WIDTH, assert_says, assert_warns, depth_png, jpeg, open, rgb_png,
};
use i2slam_dataset::{
    DepthPairing, Layout, OpenOptions, Sequence, read_trajectory, write_trajectory,
};
use i2slam_geometry::{Pose, Rotation, StampedPose, Vec3};

fn replica(folder: &Folder, scene: &str) {
    for i in 0..3 {
        let name = |kind: &str, end: &str| format!("{scene}results/{kind}{i:06}.{end}");
        folder.write(&name("frame", "jpg"), jpeg(WIDTH, HEIGHT, &[102; 3 * WIDTH * HEIGHT]));
        folder.write(&name("depth", "png"), depth_png(WIDTH, HEIGHT, 13107));
    }
    let line = |x: f64| format!("1 0 0 {x} 0 1 0 0 0 0 1 0 0 0 0 1\n");
    folder.write(&format!("{scene}traj.txt"), [0.0, 0.5, 1.0].map(line).concat());
}

#[test]
fn replica_with_the_camera_one_folder_up() {
    let folder = Folder::new();
    replica(&folder, "room0/");
    let camera = r#"{"camera":{"w":16,"h":12,"fx":14,"fy":14,"cx":7.5,"cy":5.5,"scale":6553.5}}"#;
    folder.write("cam_params.json", camera);
    let path = folder.join("room0");
    let sequence = Sequence::open(&path, &OpenOptions::default()).expect("opens");
    assert_eq!((sequence.layout, sequence.len()), (Layout::Replica, 3));
    assert_eq!((sequence.camera.cx, sequence.camera.cy), (8.0, 6.0));
    assert_eq!(sequence.warnings, [""; 0]);
    let frame = sequence.load(2).expect("loads");
    assert!((frame.depth_image().expect("depth").at(0, 1, 1) - 2.0).abs() < 1e-6);
    assert!((frame.timestamp - 2.0 / 30.0).abs() < 1e-9);
    let truth = sequence.true_trajectory().expect("poses");
    let x: Vec<f64> = truth.iter().map(|p| p.world_from_camera.translation.x).collect();
    assert_eq!(x, [0.0, 0.5, 1.0]);
    assert_eq!(truth[2].timestamp, frame.timestamp);
}

#[test]
fn replica_with_a_bad_camera_or_trajectory() {
    let folder = Folder::new();
    replica(&folder, "");
    assert_says(open(&folder), &["16x12", "expected 1200x680", "the published camera says"]);
    folder.write("cam_params.json", r#"{"camera":{"w":16}}"#);
    assert_says(open(&folder), &["cam_params.json", "missing field `h`"]);
    let camera = r#"{"camera":{"w":16,"h":12,"fx":14,"fy":14,"cx":7.5,"cy":5.5,"scale":0}}"#;
    folder.write("cam_params.json", camera);
    assert_says(open(&folder), &["scale must be positive"]);
    folder.write("cam_params.json", camera.replace(":0}", ":6553.5}"));
    folder.write("traj.txt", "1 0 0\n");
    let sequence = open(&folder).expect("opens");
    assert_warns(&sequence.warnings, &["traj.txt, line 1: expected the 16 numbers"]);
    assert!(sequence.true_trajectory().expect("none").is_empty());
}

#[test]
fn seven_scenes_is_delivered_on_the_grid_of_depth() {
    let folder = Folder::new();
    for i in 0..2 {
        let name = |end: &str| format!("frame-{i:06}.{end}");
        // Red left of the middle: both principal points lie there, so that it stays the edge.
        let value = |k: usize| if k.is_multiple_of(3) && k / 3 % 640 < 320 { 255 } else { 0 };
        let data: Vec<u8> = (0..3 * 640 * 480).map(value).collect();
        let (rgb, eight) = (png::ColorType::Rgb, png::BitDepth::Eight);
        folder.write(&name("color.png"), crate::support::png((640, 480), rgb, eight, None, &data));
        let depth = if i == 0 { 1500 } else { u16::MAX };
        folder.write(&name("depth.png"), depth_png(640, 480, depth));
        folder.write(&name("pose.txt"), format!("0 0 1 {i}\n0 1 0 2\n-1 0 0 3\n0 0 0 1\n"));
    }
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.layout, sequence.len()), (Layout::SevenScenes, 2));
    assert_eq!((sequence.camera.fx, sequence.camera.cx), (585.0, 320.0));
    assert!(sequence.valid_mask.is_none());
    assert_warns(&sequence.warnings, &["no calibration between colour and depth"]);
    let frame = sequence.load(0).expect("loads");
    assert_eq!((frame.colour.at(0, 300, 9), frame.colour.at(0, 340, 9)), (1.0, 0.0));
    assert_eq!(frame.depth_image().expect("depth").at(0, 5, 5), 1.5);
    let invalid = sequence.load(1).expect("loads");
    assert!(invalid.depth_image().expect("depth").data.iter().all(|&z| z == 0.0));
    let pose = sequence.poses[1].world_from_camera;
    assert_eq!(pose.translation, Vec3::new(1.0, 2.0, 3.0));
    assert!((pose.rotation.rotate(Vec3::new(0.0, 0.0, 1.0)).x - 1.0).abs() < 1e-12);
    let one = OpenOptions { intrinsics: Some([500.0, 500.0, 319.5, 239.5]), ..Default::default() };
    assert_eq!(Sequence::open(&folder.0, &one).expect("opens").camera.fx, 500.0);
}

#[test]
fn eth3d_has_its_camera_beside_the_lists() {
    let folder = Folder::tum(4);
    std::fs::remove_file(folder.join("camera.json")).expect("removes");
    folder.write("calibration.txt", "14.0 14.5 7.5 5.5\n");
    folder.write("groundtruth.txt", "0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0 1\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.layout, sequence.len()), (Layout::Eth3d, 4));
    let c = sequence.camera;
    assert_eq!((c.fx, c.fy, c.cx, c.cy), (14.0, 14.5, 8.0, 6.0));
    assert_eq!(sequence.true_trajectory().expect("reads").len(), 2);
}

const SCENE: &str = r#"{"camera_model": "OPENCV", "fl_x": 28, "fl_y": 28, "cx": 16, "cy": 12,
  "w": 32, "h": 24, "frames": [
  {"file_path": "images/frame_00010.png", "depth_file_path": "depth/frame_00010.png",
   "transform_matrix": [[1,0,0,7],[0,1,0,8],[0,0,1,9],[0,0,0,1]]},
  {"file_path": "images/frame_00002.png", "depth_file_path": "depth/frame_00002.png",
   "transform_matrix": [[1,0,0,1],[0,-1,0,2],[0,0,-1,3],[0,0,0,1]]},
  {"file_path": "images/frame_00003.png"}]}"#;

fn nerfstudio() -> Folder {
    let folder = Folder::new();
    for (i, name) in ["00002", "00010"].iter().enumerate() {
        folder.write(&format!("images/frame_{name}.png"), rgb_png(32, 24, 90));
        let depth = depth_png(8, 6, 1000 * (i as u16 + 1));
        folder.write(&format!("depth/frame_{name}.png"), depth);
    }
    folder.write("transforms.json", SCENE);
    folder
}

#[test]
fn nerfstudio_frames_come_in_order_with_opencv_axes() {
    let folder = nerfstudio();
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.layout, sequence.len()), (Layout::Nerfstudio, 3));
    assert!(sequence.are_times_assumed, "its pictures are numbered");
    assert_eq!((sequence.frames_with_depth(), sequence.dropped.without_depth), (2, 0));
    let nearest = OpenOptions { depth_pairing: DepthPairing::Nearest, ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.0, &nearest).expect("opens");
    assert_eq!((sequence.len(), sequence.dropped.without_depth), (2, 1));
    assert_warns(&sequence.warnings, &["1 colour image left out: no depth_file_path"]);
    assert_eq!((sequence.camera.width, sequence.camera.cx), (32, 16.0));
    let frame = sequence.load(1).expect("loads");
    assert_eq!(
        (
            frame.depth_image().expect("depth").width,
            frame.depth_image().expect("depth").at(0, 31, 23)
        ),
        (32, 2.0)
    );
    // y and z of the first camera point against OpenGL's: with OpenCV's axes it is unturned.
    let first = sequence.poses[0].world_from_camera;
    assert_eq!(first.translation, Vec3::new(1.0, 2.0, 3.0));
    let ahead = first.rotation.rotate(Vec3::new(0.0, 0.0, 1.0));
    assert!((ahead - Vec3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
    assert!((sequence.poses[1].world_from_camera.rotation.rotate(ahead).z + 1.0).abs() < 1e-12);
}

#[test]
fn nerfstudio_scales_are_used() {
    let folder = nerfstudio();
    let scales = r#""integer_depth_scale": 0.002, "applied_scale": 0.5, "frames""#;
    folder.write("transforms.json", SCENE.replace(r#""frames""#, scales));
    let sequence = open(&folder).expect("opens");
    let frame = sequence.load(0).expect("loads");
    assert!((frame.depth_image().expect("depth").at(0, 9, 9) - 2.0).abs() < 1e-6);
    assert_eq!(sequence.poses[0].world_from_camera.translation, Vec3::new(2.0, 4.0, 6.0));
}

#[test]
fn nerfstudio_files_that_cannot_be_used() {
    let folder = nerfstudio();
    for (from, to, part) in [
        ("OPENCV", "OPENCV_FISHEYE", "'OPENCV_FISHEYE' is not supported"),
        (r#""fl_x": 28, "#, "", "no fl_x"),
        (r#""fl_x": 28"#, r#""fl_x": -1"#, "fl_x and fl_y above 0"),
        (r#""w": 32"#, r#""w": 64"#, "expected 64x24"),
        ("\"transform_matrix\": [[", "\"transform_matrix\": [\"x\", [", "transform_matrix"),
        (r#""w": 32"#, r#""w": 32.5"#, "no size"),
        (r#""w": 32"#, r#""w": 32, "k4": 0.1"#, "k4 is not supported"),
        (r#""w": 32"#, r#""w": 32, "applied_scale": 0"#, "applied_scale is 0"),
        (r#""frames": ["#, r#""frames": 1, "depth_file_path": ["#, "expected a transforms.json"),
    ] {
        assert!(SCENE.contains(from), "{from}");
        folder.write("transforms.json", SCENE.replace(from, to));
        assert_says(open(&folder), &[part]);
    }
    let own = r#""fl_x": 40, "file_path": "images/frame_00010.png""#;
    folder.write("transforms.json", SCENE.replace(r#""file_path": "images/frame_00010.png""#, own));
    assert_warns(
        &open(&folder).expect("opens").warnings,
        &["focal length changes by up to 42.9 %"],
    );
}

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
fn stamps_without_a_pose_are_left_out() {
    let text =
        "0 0 0 0 0 0 0 1\n1 nan nan NaN nan nan nan nan\n2 -inf -inf -inf -inf -inf -inf -inf\n";
    let poses = read_trajectory(Folder::new().write("t.txt", text)).expect("one pose");
    assert_eq!(poses.iter().map(|pose| pose.timestamp).collect::<Vec<_>>(), [0.0]);
}

#[test]
fn bad_lines_are_named() {
    let folder = Folder::new();
    for (text, parts) in [
        ("0 0 0 0 0 0 0 1\n1 NaN 0 0 0 0 0 1\n", ["line 2", "tx is NaN"]),
        ("# c\n1 0 0 0 0 0 1\n", ["line 2", "7 columns, expected 8"]),
        ("1 nan nan\n", ["line 1", "3 columns, expected 8"]),
        ("nan nan nan nan nan nan nan nan\n", ["line 1", "time stamp is NaN"]),
        ("1 0 0 0 0 0 0 0\n", ["line 1", "quaternion is zero"]),
        ("1 0 0 zero 0 0 0 1\n", ["line 1", "tz is 'zero'"]),
        ("# only a comment\n", ["is empty", "timestamp tx ty tz"]),
    ] {
        let [place, problem] = parts;
        assert_says(read_trajectory(folder.write("t.txt", text)), &["t.txt", place, problem]);
    }
    assert_says(read_trajectory(folder.join("none.txt")), &["none.txt"]);
}
