//! Datasets, one of each layout, of three frames.

use super::picture::{
    SIZE, colour, colour_deep, colour_palette, depth, exif, jpeg, jpeg_progressive, pattern,
};
use super::scene::{INTRINSICS, matrix, position, stamp, trajectory, words};
use super::{NamedSeed, files, record3d, sens};
use crate::corpus::Files;

const FRAMES: usize = 3;

const CAMERA: &str = r#"{"fx": 20, "fy": 20, "cx": 11.5, "cy": 8.5, "width": 24, "height": 18,
 "distortion": [0.1, -0.05, 0.001, 0.002, 0.01], "depth_scale": 5000, "frame_rate": 30}
"#;

pub(super) fn seeds() -> Vec<NamedSeed> {
    let tum = tum();
    let mut eth3d = tum.clone();
    eth3d.remove("camera.json");
    eth3d.insert("calibration.txt".into(), format!("{}\n", words(&INTRINSICS)).into_bytes());
    let mut with_rgb_only = tum.clone();
    with_rgb_only.insert("associations.txt".into(), associations().into_bytes());
    vec![
        ("tum", "lists", tum),
        ("tum", "associations", with_rgb_only),
        ("eth3d", "lists", eth3d),
        ("scannet", "extracted", scannet()),
        ("sens", "deflated", files([("scan.sens", &sens::bytes(1))])),
        ("sens", "raw", files([("scan.sens", &sens::bytes(0))])),
        ("record3d", "archive", files([("scan.r3d", &record3d::archive())])),
        ("record3d", "folder", record3d::folder()),
        ("replica", "scene", replica()),
        ("seven-scenes", "scene", seven_scenes()),
        ("nerfstudio", "depth", nerfstudio()),
        ("plain", "stamps", plain(|i| format!("{:.6}", stamp(i)))),
        ("plain", "numbers", plain(|i| format!("{i:04}"))),
        ("pictures", "jpeg", jpegs()),
        ("pictures", "png", pngs()),
        ("video", "clip", video()),
    ]
}

/// Lists, pictures, depth, ground truth and camera.
fn tum() -> Files {
    let (mut all, mut rgb, mut depths) =
        (Files::new(), String::from("# colour\n"), String::from("# depth\n"));
    for i in 0..FRAMES {
        rgb += &format!("{:.6} rgb/{i}.png\n", stamp(i));
        depths += &format!("{:.6} depth/{i}.png\n", stamp(i) + 0.004);
        all.insert(format!("rgb/{i}.png"), colour(SIZE, i));
        all.insert(format!("depth/{i}.png"), depth(SIZE, 5000 + 100 * i));
    }
    all.extend(files([
        ("rgb.txt", rgb.as_bytes()),
        ("depth.txt", depths.as_bytes()),
        ("groundtruth.txt", trajectory(FRAMES).as_bytes()),
        ("camera.json", CAMERA.as_bytes()),
    ]));
    all
}

fn associations() -> String {
    let line = |i: usize| {
        let time = stamp(i);
        format!("{time:.6} rgb/{i}.png {:.6} depth/{i}.png\n", time + 0.004)
    };
    (0..FRAMES).map(line).collect()
}

fn scannet() -> Files {
    let text = |m: [f64; 16]| {
        m.chunks(4).map(|row| format!("{}\n", words(row))).collect::<String>().into_bytes()
    };
    let camera = |[fx, fy, cx, cy]: [f64; 4]| {
        text([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    };
    let mut all = Files::new();
    for i in 0..FRAMES {
        all.insert(format!("color/{i}.jpg"), jpeg(SIZE, i, None));
        all.insert(format!("depth/{i}.png"), depth((12, 9), 1000 + i));
        all.insert(format!("pose/{i}.txt"), text(matrix(position(i))));
    }
    all.insert("intrinsic/intrinsic_color.txt".into(), camera(INTRINSICS));
    all.insert("intrinsic/intrinsic_depth.txt".into(), camera([10.0, 10.0, 5.5, 4.0]));
    all
}

fn replica() -> Files {
    let mut all = Files::new();
    let line = |i: usize| format!("{}\n", words(&matrix(position(i))));
    for i in 0..FRAMES {
        all.insert(format!("results/frame{i:06}.jpg"), jpeg(SIZE, i, None));
        all.insert(format!("results/depth{i:06}.png"), depth(SIZE, 13_107));
    }
    let poses: String = (0..FRAMES).map(line).collect();
    let camera = r#"{"camera":{"w":24,"h":18,"fx":20,"fy":20,"cx":11.5,"cy":8.5,"scale":6553.5}}"#;
    all.extend(files([("traj.txt", poses.as_bytes()), ("cam_params.json", camera.as_bytes())]));
    all
}

fn seven_scenes() -> Files {
    let mut all = Files::new();
    for i in 0..2 {
        let pose: String =
            matrix(position(i)).chunks(4).map(|row| format!("{}\n", words(row))).collect();
        all.insert(format!("frame-{i:06}.color.png"), colour((640, 480), i));
        all.insert(format!("frame-{i:06}.depth.png"), depth((640, 480), 1500));
        all.insert(format!("frame-{i:06}.pose.txt"), pose.into_bytes());
    }
    all
}

fn nerfstudio() -> Files {
    let mut all = Files::new();
    let mut frames = Vec::new();
    for i in 0..FRAMES {
        let rows: Vec<String> =
            matrix(position(i)).chunks(4).map(|row| words(row).replace(' ', ", ")).collect();
        let rows = rows.join("], [");
        frames.push(format!(
            r#"  {{"file_path": "images/{i}.png", "depth_file_path": "depth/{i}.png",
   "transform_matrix": [[{rows}]]}}"#
        ));
        all.insert(format!("images/{i}.png"), colour(SIZE, i));
        all.insert(format!("depth/{i}.png"), depth(SIZE, 1000));
    }
    let text = format!(
        r#"{{"camera_model": "OPENCV", "fl_x": 20, "fl_y": 20, "cx": 12, "cy": 9, "w": 24, "h": 18,
 "k1": 0.1, "k2": -0.01, "p1": 0, "p2": 0, "integer_depth_scale": 0.001, "frames": [
{}]}}"#,
        frames.join(",\n")
    );
    all.insert("transforms.json".into(), text.into_bytes());
    all
}

fn plain(name: impl Fn(usize) -> String) -> Files {
    let mut all = files([("camera.json", CAMERA.as_bytes())]);
    for i in 0..FRAMES {
        all.insert(format!("colour/{}.png", name(i)), colour(SIZE, i));
        all.insert(format!("depth/{}.png", name(i)), depth(SIZE, 5000));
    }
    all
}

fn jpegs() -> Files {
    let all = (0..FRAMES).map(|i| (format!("{i}.jpg"), jpeg(SIZE, i, Some(&exif(6, 26)))));
    all.collect()
}

/// Pictures of every kind of PNG, and a progressive JPEG.
fn pngs() -> Files {
    files([
        ("0.png", &colour(SIZE, 0)),
        ("1.png", &colour_deep(SIZE, 1)),
        ("2.png", &colour_palette(SIZE, 2)),
        ("3.jpg", &jpeg_progressive(SIZE, 3)),
    ])
}

/// What the stand-in for ffmpeg answers, see [`crate::ffmpeg`].
fn video() -> Files {
    let mut log = String::from(
        "Input #0, mov,mp4,m4a, from 'clip.mp4':\n  Duration: 00:00:00.10, start: 0.000000, bitrate: \
         9 kb/s\n    Stream #0:0(und): Video: h264 (High) (avc1 / 0x31637661), yuv420p, 24x18\n\
         [Parsed_showinfo_1 @ 0x5] [info] config in time_base: 1/15360, frame_rate: 30/1\n",
    );
    let mut raw = Vec::new();
    for i in 0..FRAMES {
        log += &format!(
            "[Parsed_showinfo_1 @ 0x5] [info] n:{i:4} pts:{:7} pts_time:{:.6} duration: 512 \
             fmt:yuv420p sar:1/1 s:24x18 i:P iskey:0 type:P\n",
            512 * i,
            i as f64 / 30.0
        );
        raw.extend(pattern(SIZE, i));
    }
    log += "[h264 @ 0x5] [error] error while decoding MB 3 1\n";
    files([("clip.mp4", b"no video"), ("clip.mp4.log", log.as_bytes()), ("clip.mp4.raw", &raw)])
}
