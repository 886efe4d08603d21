//! Sparse models of COLMAP, and the names of their images.

use super::assert_same;
use super::scene::{
    CAMERA_JSON, HEIGHT, WIDTH, camera, colour_png, colour_sequence, pose, render, sequence, stamp,
};
use crate::support::{Folder, assert_says, assert_warns, import};
use i2slam_dataset::OpenOptions;
use i2slam_dataset::import::{ImportDepth, ImportFormat, ImportOptions, ImportedKeyframes};
use i2slam_geometry::{Camera, Vec3};

const CAMERA: &str = "1 PINHOLE 48 32 40 40 24 16\n";

/// Points of the room that the middle of frame 0 sees.
fn points() -> Vec<Vec3<f64>> {
    let depth = render(0).0;
    let place = |(column, row): (usize, usize)| {
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        pose(0) * camera().unproject(u, v, depth[row * WIDTH + column])
    };
    [(20, 12), (24, 16), (30, 20)].map(place).to_vec()
}

fn numbers(i: usize) -> [f64; 7] {
    let p = pose(i).inverse();
    let (q, t) = (p.rotation, p.translation);
    [q.w, q.v.x, q.v.y, q.v.z, t.x, t.y, t.z]
}

/// Two lines for the image with a name at the pose of frame `i`.
fn image_lines(i: usize, name: &str, points: &str) -> String {
    let words: Vec<String> = numbers(i).iter().map(f64::to_string).collect();
    format!("{} {} 1 {name}\n{points}\n", i + 1, words.join(" "))
}

/// The text of images of some names, at the first poses.
fn images_named(names: &[&str]) -> String {
    names.iter().enumerate().map(|(i, name)| image_lines(i, name, "")).collect()
}

fn images_text(frames: &[usize]) -> String {
    let image = |&i: &usize| image_lines(i, &format!("{i:03}.png"), "1.5 2.5 -1 3.5 4.5 7");
    let head = "# Image list with two lines of data per image:\n";
    head.to_owned() + &frames.iter().map(image).collect::<String>()
}

fn points_text(frames: &[usize]) -> String {
    let track: String = frames.iter().map(|i| format!(" {} 0", i + 1)).collect();
    let line = |p: &Vec3<f64>| format!("1 {} {} {} 9 9 9 0.5{track}\n", p.x, p.y, p.z);
    points().iter().map(line).collect()
}

/// The pictures of some frames and the model of others.
pub(super) fn text_model(pictures: usize, frames: &[usize]) -> Folder {
    let folder = pictures_in_images(pictures);
    folder.write("sparse/0/cameras.txt", format!("# cameras\n{CAMERA}"));
    folder.write("sparse/0/images.txt", images_text(frames));
    folder.write("sparse/0/points3D.txt", points_text(frames));
    folder
}

fn pictures_in_images(count: usize) -> Folder {
    let folder = colour_sequence(count);
    std::fs::rename(folder.join("rgb"), folder.join("images")).expect("renames");
    for name in ["rgb.txt", "camera.json"] {
        std::fs::remove_file(folder.join(name)).expect("removes");
    }
    folder
}

fn cameras_binary() -> Vec<u8> {
    let mut out = 1_u64.to_le_bytes().to_vec();
    out.extend(1_u32.to_le_bytes());
    out.extend(1_i32.to_le_bytes());
    out.extend([WIDTH as u64, HEIGHT as u64].map(u64::to_le_bytes).concat());
    out.extend([40.0_f64, 40.0, 24.0, 16.0].map(f64::to_le_bytes).concat());
    out
}

pub(super) fn images_binary(frames: &[usize]) -> Vec<u8> {
    let mut out = (frames.len() as u64).to_le_bytes().to_vec();
    for &i in frames {
        out.extend((i as u32 + 1).to_le_bytes());
        out.extend(numbers(i).map(f64::to_le_bytes).concat());
        out.extend(1_u32.to_le_bytes());
        out.extend(format!("{i:03}.png\0").bytes());
        out.extend(1_u64.to_le_bytes());
        out.extend([0; 24]);
    }
    out
}

fn points_binary(frames: &[usize]) -> Vec<u8> {
    let points = points();
    let mut out = (points.len() as u64).to_le_bytes().to_vec();
    for point in points {
        out.extend(7_u64.to_le_bytes());
        out.extend(point.to_array().map(f64::to_le_bytes).concat());
        out.extend([9; 3]);
        out.extend(0.5_f64.to_le_bytes());
        out.extend((frames.len() as u64).to_le_bytes());
        for &i in frames {
            out.extend((i as u32 + 1).to_le_bytes());
            out.extend(0_u32.to_le_bytes());
        }
    }
    out
}

pub(super) fn write_binary(folder: &Folder, frames: &[usize]) {
    folder.write("sparse/0/cameras.bin", cameras_binary());
    folder.write("sparse/0/images.bin", images_binary(frames));
    folder.write("sparse/0/points3D.bin", points_binary(frames));
}

#[test]
fn a_text_model_gives_poses_and_sparse_depth() {
    let folder = text_model(5, &[0, 2, 3]);
    let files = import(&folder).expect("opens");
    assert_eq!((files.format, files.len()), (ImportFormat::Colmap, 3));
    assert_eq!((files.unmatched.poses_without_image, files.unmatched.images_without_pose), (0, 2));
    assert!(files.warnings.is_empty(), "{:?}", files.warnings);
    assert_eq!(files.camera, camera());
    let keyframe = files.load(1).expect("loads");
    assert_eq!((keyframe.index, keyframe.timestamp), (2, 2.0 / 30.0));
    assert_same(keyframe.world_from_camera, pose(2));
    let first = files.load(0).expect("loads");
    let (depth, variance) = (first.depth.expect("depth"), first.variance.expect("variance"));
    let seen = depth.data.iter().filter(|&&z| z > 0.0).count();
    assert_eq!(seen, 3);
    let due = render(0).0[16 * WIDTH + 24];
    assert!((f64::from(depth.at(0, 24, 16)) - due).abs() < 1e-5);
    let sigma = variance.at(0, 24, 16).sqrt();
    assert!((0.005..0.5).contains(&sigma), "{sigma}");
    assert_eq!(variance.data.iter().filter(|&&v| v > 0.0).count(), 3);
}

#[test]
fn a_binary_model_holds_the_same() {
    let folder = text_model(4, &[0, 1, 3]);
    let text = import(&folder).expect("opens");
    let all = |files: &ImportedKeyframes| {
        (0..3).map(|i| files.load(i).expect("loads")).collect::<Vec<_>>()
    };
    write_binary(&folder, &[0, 1, 3]);
    for name in ["cameras", "images", "points3D"] {
        std::fs::remove_file(folder.join(&format!("sparse/0/{name}.txt"))).expect("removes");
    }
    let binary = import(&folder).expect("opens");
    assert_eq!(all(&binary), all(&text));
    let by_file = import(&folder.join("sparse/0/images.bin"));
    assert_eq!(by_file.expect("opens").keyframes, text.keyframes);
}

#[test]
fn a_binary_model_may_end_nowhere() {
    let folder = pictures_in_images(3);
    write_binary(&folder, &[0, 1]);
    for (name, whole) in [
        ("cameras", cameras_binary()),
        ("images", images_binary(&[0, 1])),
        ("points3D", points_binary(&[0, 1])),
    ] {
        let file = format!("sparse/0/{name}.bin");
        for cut in 0..whole.len() {
            folder.write(&file, &whole[..cut]);
            assert_says(import(&folder), &[&file, "cut off"]);
        }
        folder.write(&file, whole);
    }
    assert!(import(&folder).is_ok());
    let mut newer = cameras_binary();
    newer[12] = 11;
    folder.write("sparse/0/cameras.bin", newer);
    assert_says(import(&folder), &["camera 0 of 1", "number 11 is not supported", "undistort"]);
    folder.write("sparse/0/cameras.bin", cameras_binary());
    let mut wrong = images_binary(&[0, 1]);
    wrong[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
    folder.write("sparse/0/images.bin", &wrong);
    assert_says(import(&folder), &["images.bin", "image 0 of 2", "not finite"]);
    wrong[12..20].copy_from_slice(&3.0_f64.to_le_bytes());
    folder.write("sparse/0/images.bin", &wrong);
    assert_says(import(&folder), &["images.bin", "image 0 of 2", "length", "expected 1"]);
    let nameless = images_binary(&[0, 1]);
    let name = nameless.windows(7).position(|word| word == b"000.png").expect("a name");
    folder.write("sparse/0/images.bin", [&nameless[..name], &nameless[name + 7..]].concat());
    assert_says(import(&folder), &["images.bin", "image 0 of 2", "no name"]);
}

#[test]
fn lenses_are_removed() {
    let folder = text_model(3, &[0, 1]);
    for (text, distorted) in [
        ("1 SIMPLE_PINHOLE 48 32 40 24 16\n", false),
        ("1 SIMPLE_RADIAL 48 32 40 24 16 -0.1\n", true),
        ("1 RADIAL 48 32 40 24 16 -0.1 0.01\n", true),
        ("1 OPENCV 48 32 40 40 24 16 -0.1 0.01 0.001 0.002\n", true),
        ("1 FULL_OPENCV 48 32 40 40 24 16 -0.1 0.01 0.001 0.002 0 0 0 0\n", true),
    ] {
        folder.write("sparse/0/cameras.txt", text);
        let files = import(&folder).expect("opens");
        assert_eq!(files.camera, camera());
        let colour = files.load(0).expect("loads").colour;
        let plain = f32::from(render(0).1[0]) / 255.0;
        assert_eq!(colour.at(0, 0, 0) != plain, distorted, "{text}");
    }
    let picture = |camera: &str| {
        folder.write("sparse/0/cameras.txt", camera);
        import(&folder).expect("opens").load(0).expect("loads").colour
    };
    let radial = picture("1 SIMPLE_RADIAL 48 32 40 24 16 -0.1\n");
    assert_eq!(radial, picture("1 OPENCV 48 32 40 40 24 16 -0.1 0 0 0\n"));
}

#[test]
fn two_cameras_are_refused_unless_they_are_one() {
    let folder = text_model(3, &[0, 1]);
    let images = images_text(&[0, 1]).replace(" 1 001.png", " 2 001.png");
    folder.write("sparse/0/images.txt", images);
    folder.write("sparse/0/cameras.txt", format!("{CAMERA}2 PINHOLE 48 32 44 44 24 16\n"));
    assert_says(import(&folder), &["cameras 1 and 2 differ", "single_camera"]);
    folder.write("sparse/0/cameras.txt", format!("{CAMERA}2 PINHOLE 48 32 40.01 40.01 24 16\n"));
    assert_eq!(import(&folder).expect("opens").len(), 2);
}

#[test]
fn unusable_lines_are_named() {
    let image = |line: &str| images_text(&[0, 1]) + line + "\n\n";
    for (name, text, parts) in [
        (
            "images",
            image("3 1 0 0 0 0 0 0 1"),
            &["images.txt, line 6", "9 columns, expected 10"][..],
        ),
        ("images", image("3 2 0 0 0 0 0 0 1 002.png"), &["line 6", "length 2.000", "expected 1"]),
        ("images", image("3 0 0 0 0 0 0 0 1 002.png"), &["line 6", "length 0.000"]),
        ("images", image("3 1 0 inf 0 0 0 0 1 002.png"), &["line 6", "qy is inf"]),
        ("images", image("x 1 0 0 0 0 0 0 1 002.png"), &["image is 'x'", "whole number"]),
        ("images", "# none\n".into(), &["images", "is empty"]),
        ("points3D", "1 0 0 0 9 9\n".into(), &["points3D.txt, line 1", "6 columns"]),
        (
            "cameras",
            "1 OPENCV_FISHEYE 48 32 40 40 24 16 0 0 0 0\n".into(),
            &["OPENCV_FISHEYE is not"],
        ),
        ("cameras", "1 FISHY 48 32 40\n".into(), &["line 1", "FISHY is not", "image_undistorter"]),
        ("cameras", "1 PINHOLE 48 32 40 40 24\n".into(), &["3 parameters of PINHOLE, expected 4"]),
        ("cameras", "1 PINHOLE 48 32 40 nan 24 16\n".into(), &["line 1", "parameter is NaN"]),
        ("cameras", "1 PINHOLE 48\n".into(), &["line 1", "3 columns"]),
        ("cameras", "2 PINHOLE 48 32 40 40 24 16\n".into(), &["no camera 1", "image 000.png"]),
        (
            "cameras",
            "1 PINHOLE 96 64 80 80 48 32\n".into(),
            &["000.png is 48x32", "cameras.txt says"],
        ),
    ] {
        let folder = text_model(3, &[0, 1]);
        folder.write(&format!("sparse/0/{name}.txt"), text);
        assert_says(import(&folder), parts);
    }
    let folder = text_model(3, &[0, 1]);
    std::fs::remove_file(folder.join("sparse/0/points3D.txt")).expect("removes");
    assert!(!import(&folder).expect("opens").has_depth);
}

#[test]
fn missing_pictures_are_counted_and_named() {
    let folder = text_model(3, &[0, 1, 2, 5, 6]);
    let files = import(&folder).expect("opens");
    assert_eq!((files.len(), files.unmatched.poses_without_image), (3, 2));
    assert_warns(&files.warnings, &["2 of 5 poses left out", "the first is 005.png"]);
    let folder = text_model(3, &[1, 5, 6]);
    assert_says(import(&folder), &["1 of 3 poses", "by name", "005.png"]);
    std::fs::remove_dir_all(folder.join("images")).expect("removes");
    assert_says(import(&folder), &["no folder images/", "name the folder"]);
}

#[test]
fn pictures_of_a_sequence_bring_their_times_and_depth() {
    let model = text_model(1, &[0, 2, 4]);
    let pictures = sequence(6);
    pictures.write("camera.json", CAMERA_JSON);
    let options = ImportOptions { depth: ImportDepth::Pictures, ..ImportOptions::default() };
    let files = ImportedKeyframes::open(&model.0, Some(&pictures.0), &options).expect("opens");
    let keyframe = files.load(2).expect("loads");
    assert_eq!((keyframe.index, keyframe.timestamp), (4, stamp(4)));
    let due = render(4).0[8 * WIDTH + 8];
    assert!((f64::from(keyframe.depth.expect("depth").at(0, 8, 8)) - due).abs() < 2e-4);
    let open = OpenOptions { scale: 0.5, ..OpenOptions::default() };
    let options = ImportOptions { open, ..ImportOptions::default() };
    let files = ImportedKeyframes::open(&model.0, Some(&pictures.0), &options).expect("opens");
    let keyframe = files.load(0).expect("loads");
    let (depth, due) = (keyframe.depth.expect("depth"), render(0).0[16 * WIDTH + 24]);
    assert!((f64::from(depth.at(0, 12, 8)) - due).abs() < 1e-5);
}

/// The picture of every keyframe, below `images/`.
fn pictures(files: &ImportedKeyframes) -> Vec<String> {
    let sequence = files.sequence().expect("a sequence");
    let name = |index: usize| {
        let path = &sequence.entries[index].colour;
        let (_, below) = path.to_str().expect("a name").rsplit_once("images/").expect("images/");
        below.to_owned()
    };
    files.keyframes.iter().map(|keyframe| name(keyframe.index)).collect()
}

/// A model of images of some names, and pictures `images/PATH`.
fn model(names: &[&str], pictures: &[&str]) -> Folder {
    let folder = text_model(1, &[]);
    std::fs::remove_dir_all(folder.join("images")).expect("removes");
    folder.write("sparse/0/images.txt", images_named(names));
    for (i, path) in pictures.iter().enumerate() {
        folder.write(&format!("images/{path}"), colour_png(i));
    }
    folder
}

#[test]
fn pictures_in_folders_are_found_by_their_whole_names() {
    let names = ["right/1.png", "left/0.png", "left/1.png"];
    let folder = model(&names, &["left/0.png", "left/1.png", "right/0.png", "right/1.png"]);
    let files = import(&folder).expect("opens");
    assert_eq!(pictures(&files), ["left/0.png", "left/1.png", "right/1.png"]);
    assert_eq!(files.unmatched.images_without_pose, 1);
}

#[test]
fn a_name_with_another_folder_takes_no_picture_of_another_image() {
    let names = ["left/0.png", "right/0.png", "left/1.png", "left/2.png"];
    let files = import(&model(&names, &["0.png", "1.png", "2.png"])).expect("opens");
    assert_eq!(pictures(&files), ["1.png", "2.png"]);
    assert_warns(&files.warnings, &["2 of 4 poses left out", "left/0.png"]);
    // Two pictures end like the second name, and none is it.
    let names = ["left/0.png", "1.png", "2.png"];
    let files = import(&model(&names, &["left/0.png", "left/1.png", "right/1.png", "right/2.png"]))
        .expect("opens");
    assert_eq!(pictures(&files), ["left/0.png", "right/2.png"]);
    assert_warns(&files.warnings, &["1 of 3 poses left out", "1.png"]);
}

#[test]
fn blank_lines_may_stand_before_an_image_only() {
    let folder = model(&["0.png"], &["0.png", "1.png", "2.png"]);
    let image =
        |i: usize| images_named(&["", "1.png", "2.png"]).lines().nth(2 * i).map(String::from);
    let (second, third) = (image(1).expect("a line"), image(2).expect("a line"));
    let text = format!("# head\n\n{second}\n\n\n# middle\n{third}\n1 2 -1 3 4 5\n\n");
    folder.write("sparse/0/images.txt", text);
    assert_eq!(pictures(&import(&folder).expect("opens")), ["1.png", "2.png"]);
    for (points, count) in [("1 2 -1 3", "4 columns"), (third.as_str(), "10 columns")] {
        folder.write("sparse/0/images.txt", format!("{second}\n{points}\n{third}\n\n"));
        assert_says(import(&folder), &["images.txt, line 2", count, "2D points"]);
    }
}
