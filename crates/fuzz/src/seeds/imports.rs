//! Keyframes of other programs: the poses in `poses/`, the pictures in `pictures/`.

use super::picture::{SIZE, colour, depth};
use super::scene::{matrix, position, stamp, trajectory, words};
use super::{NamedSeed, arrays, below, colmap, files};
use crate::corpus::Files;

const FRAMES: usize = 3;
const CAMERA: &[u8] = br#"{"fx": 20, "fy": 20, "cx": 12, "cy": 9, "pixel_centre": 0.5}"#;

pub(super) fn seeds() -> Vec<NamedSeed> {
    vec![
        ("import-nerfstudio", "transforms", nerfstudio()),
        ("import-colmap", "text", with_pictures(&colmap::text(), numbered())),
        ("import-colmap", "binary", with_pictures(&colmap::binary(), numbered())),
        ("import-arrays", "droid", droid()),
        ("import-archive", "stored", files([("run.npz", &arrays::archive(false))])),
        ("import-archive", "deflated", files([("run.npz", &arrays::archive(true))])),
        ("import-trajectory", "variance", trajectory_with_variance()),
    ]
}

fn numbered() -> Files {
    (0..FRAMES).map(|i| (format!("{i}.png"), colour(SIZE, i))).collect()
}

fn with_pictures(poses: &Files, pictures: Files) -> Files {
    let mut all = below("poses", poses);
    all.extend(below("pictures", &pictures));
    all
}

fn nerfstudio() -> Files {
    let frame = |i: usize| {
        let rows: Vec<String> =
            matrix(position(i)).chunks(4).map(|row| words(row).replace(' ', ", ")).collect();
        let rows = rows.join("], [");
        format!(r#"{{"file_path": "rgb/{i}.png", "transform_matrix": [[{rows}]]}}"#)
    };
    let frames: Vec<String> = (0..FRAMES).map(frame).collect();
    let text = format!(
        "{{\"camera_angle_x\": 1.1, \"w\": 24, \"h\": 18, \"frames\": [\n{}]}}",
        frames.join(",\n")
    );
    let mut all = files([("transforms.json", text.as_bytes())]);
    all.extend(below("rgb", &numbered()));
    below("poses", &all)
}

fn droid() -> Files {
    let members = arrays::members().into_iter();
    members.map(|(name, bytes)| (format!("poses/{name}"), bytes)).collect()
}

/// A TUM sequence, its trajectory, and the variance of its depth.
fn trajectory_with_variance() -> Files {
    let (mut all, mut rgb, mut depths) = (Files::new(), String::new(), String::new());
    for i in 0..FRAMES {
        rgb += &format!("{:.6} rgb/{i}.png\n", stamp(i));
        depths += &format!("{:.6} depth/{i}.png\n", stamp(i));
        all.insert(format!("pictures/rgb/{i}.png"), colour(SIZE, i));
        all.insert(format!("pictures/depth/{i}.png"), depth(SIZE, 5000));
        all.insert(format!("variance/{i}.npy"), arrays::variance(SIZE));
    }
    all.extend(files([
        ("pictures/rgb.txt", rgb.as_bytes()),
        ("pictures/depth.txt", depths.as_bytes()),
        ("pictures/camera.json", CAMERA),
        ("poses/trajectory.txt", trajectory(FRAMES).as_bytes()),
    ]));
    all
}
