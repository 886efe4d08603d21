//! nerfstudio's `transforms.json`.

use super::assert_same;
use super::scene::{WIDTH, colour_sequence, pose, render, sequence};
use crate::support::{Folder, assert_says, assert_warns, import, import_with};
use i2slam_dataset::import::{ImportDepth, ImportFormat, ImportOptions, ImportedKeyframes};
use i2slam_geometry::{Pose, Vec3};

/// The matrix of a pose, camera axes of OpenGL if asked for.
fn matrix(pose: Pose<f64>, opengl: bool) -> String {
    let sign = if opengl { -1.0 } else { 1.0 };
    let axes = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, sign, 0.0), Vec3::new(0.0, 0.0, sign)];
    let [x, y, z] = axes.map(|axis| pose.rotation.rotate(axis).to_array());
    let t = pose.translation.to_array();
    let rows = (0..3).map(|i| format!("[{}, {}, {}, {}]", x[i], y[i], z[i], t[i]));
    format!("[{}, [0, 0, 0, 1]]", rows.collect::<Vec<_>>().join(", "))
}

/// `transforms.json` of some frames.
pub(super) fn transforms(frames: &[usize], with_depth: bool, opengl: bool) -> String {
    let frame = |&i: &usize| {
        let depth = format!(r#""depth_file_path": "depth/{i:03}.png", "#);
        let depth = if with_depth { depth } else { String::new() };
        let matrix = matrix(pose(i), opengl);
        format!(r#"{{"file_path": "rgb/{i:03}.png", {depth}"transform_matrix": {matrix}}}"#)
    };
    let frames: Vec<String> = frames.iter().map(frame).collect();
    format!(
        r#"{{"fl_x": 40, "fl_y": 40, "cx": 24, "cy": 16, "w": 48, "h": 32,
            "integer_depth_scale": 0.0002, "frames": [{}]}}"#,
        frames.join(", ")
    )
}

/// Without the `camera.json`, which would go before the file.
fn pictures(with_depth: bool) -> Folder {
    let folder = if with_depth { sequence(4) } else { colour_sequence(4) };
    for name in ["camera.json", "rgb.txt", "depth.txt"] {
        let _ = std::fs::remove_file(folder.join(name));
    }
    folder
}

#[test]
fn poses_are_turned_to_opencv_axes() {
    for with_depth in [false, true] {
        let folder = pictures(with_depth);
        let file = folder.write("transforms.json", transforms(&[0, 1, 3], with_depth, true));
        let files = import(&file).expect("opens");
        assert_eq!((files.format, files.len()), (ImportFormat::Nerfstudio, 3));
        assert_eq!(files.has_depth, with_depth);
        assert!(files.warnings.is_empty(), "{:?}", files.warnings);
        let keyframe = files.load(2).expect("loads");
        assert_same(keyframe.world_from_camera, pose(3));
        assert_eq!((keyframe.index, keyframe.timestamp), (2, 2.0 / 30.0));
        assert_eq!(keyframe.depth.is_some(), with_depth);
        if let Some(depth) = keyframe.depth {
            let due = render(3).0[5 * WIDTH + 9];
            assert!((f64::from(depth.at(0, 9, 5)) - due).abs() < 2e-4);
        }
        let by_folder = import_with(&folder.0, &folder);
        let by_folder = by_folder.expect("opens");
        assert_eq!((by_folder.keyframes, by_folder.warnings.len()), (files.keyframes, 0));
        let other = pictures(false);
        let elsewhere = import_with(&folder.0, &other);
        assert_warns(&elsewhere.expect("opens").warnings, &["transforms.json names, not those of"]);
        let options = ImportOptions { depth: ImportDepth::None, ..ImportOptions::default() };
        assert!(!ImportedKeyframes::open(&file, None, &options).expect("opens").has_depth);
    }
}

#[test]
fn frames_without_a_pose_or_a_picture_are_left_out() {
    let folder = pictures(false);
    let text = transforms(&[0, 1, 2, 3], false, true);
    let broken = text.replacen("[0, 0, 0, 1]]}", "[0, 0, 0, 1]], \"odd\": 1}", 1);
    let place = broken.find("transform_matrix\": [[").expect("a matrix") + 21;
    let broken = format!("{}9{}", &broken[..place], &broken[place..]);
    folder.write("transforms.json", broken);
    std::fs::remove_file(folder.join("rgb/002.png")).expect("removes");
    let files = import(&folder).expect("opens");
    let indices: Vec<usize> = files.keyframes.iter().map(|keyframe| keyframe.index).collect();
    assert_eq!(indices, [1, 3]);
    assert_warns(&files.warnings, &["1 frame without a finite, rigid true pose"]);
    assert_warns(&files.warnings, &["1 of 3 pictures are missing", "002.png"]);
    std::fs::remove_file(folder.join("rgb/003.png")).expect("removes");
    assert_says(import(&folder), &["expected at least 2", "pictures are missing"]);
}

#[test]
fn unusable_files_are_named() {
    let folder = pictures(false);
    let open = || import(&folder);
    folder.write("transforms.json", "{");
    assert_says(open(), &["transforms.json", "expected a transforms.json"]);
    folder.write("transforms.json", r#"{"fl_x": 40, "cx": 1, "cy": 1, "frames": []}"#);
    assert_says(open(), &["transforms.json is empty", "frames"]);
    folder.write("transforms.json", transforms(&[0, 1], false, true));
    let options = ImportOptions { depth: ImportDepth::Pictures, ..ImportOptions::default() };
    assert_says(
        ImportedKeyframes::open(&folder.0, None, &options),
        &["transforms.json", "no frame has a depth_file_path"],
    );
}
