//! Sequences: options, images, streams, the demo clip.

use crate::support::{
    CAMERA, Folder, HEIGHT, WIDTH, assert_warns, depth_png, jpeg, open, png, rgb_png, shared_data,
};
use i2slam_dataset::{DepthPairing, OpenOptions, Sequence, read_trajectory};
use png::{BitDepth, ColorType};
use std::path::Path;

#[test]
fn a_tum_folder_opens_and_every_frame_is_delivered() {
    let folder = Folder::tum(5);
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.len(), sequence.warnings.len()), (5, 0), "{:?}", sequence.warnings);
    assert!((sequence.frame_rate - 30.0).abs() < 1e-3);
    assert_eq!((sequence.camera.cx, sequence.camera.cy), (8.0, 6.0));
    for (i, frame) in sequence.stream().enumerate() {
        let frame = frame.expect("loads");
        assert_eq!((frame.index, frame.warnings.len()), (i, 0));
        assert!((frame.timestamp - i as f64 / 30.0).abs() < 1e-6);
        let value = (60 + i) as u8;
        let expected = [value, value / 2, value / 3].map(|v| f32::from(v) / 255.0);
        for channel in 0..3 {
            assert_eq!(frame.colour.at(channel, 3, 4), expected[channel]);
        }
        assert!(
            (frame.depth_image().expect("depth").at(0, 3, 4) - (1.0 + i as f32 / 10.0)).abs()
                < 1e-6
        );
    }
}

#[test]
fn range_and_stride_keep_the_place_in_the_stream() {
    let folder = Folder::tum(10);
    let options = OpenOptions { frames: Some(2..9), stride: 3, ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    let indices: Vec<usize> = sequence.entries.iter().map(|e| e.index).collect();
    assert_eq!(indices, [2, 5, 8]);
    assert_eq!(sequence.load(1).expect("loads").index, 5);
    assert!((sequence.frame_rate - 30.0).abs() < 1e-3);
    let options = OpenOptions { frames: Some(8..99), ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    assert_eq!(sequence.len(), 2);
    assert_warns(&sequence.warnings, &["ends at 10"]);
}

#[test]
fn camera_follows_crop_and_scale() {
    let folder = Folder::tum(1);
    let options = OpenOptions { crop_border: 2, scale: 0.5, ..OpenOptions::default() };
    let small = OpenOptions { crop_border: 4, ..options.clone() };
    assert!(Sequence::open(&folder.0, &small).is_err());
    let folder = Folder::new();
    folder.write("rgb.txt", "0 c.png\n");
    folder.write("depth.txt", "0 d.png\n");
    folder.write("c.png", rgb_png(36, 28, 90));
    folder.write("d.png", depth_png(36, 28, 5000));
    folder.write("camera.json", r#"{"fx":30,"fy":31,"cx":18.0,"cy":14.0,"pixel_centre":0.5}"#);
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    let camera = sequence.camera;
    assert_eq!((camera.width, camera.height), (16, 12));
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (15.0, 15.5, 8.0, 6.0));
    let frame = sequence.load(0).expect("loads");
    assert_eq!((frame.colour.width, frame.depth_image().expect("depth").height), (16, 12));
    assert_eq!(frame.depth_image().expect("depth").data, vec![1.0; 16 * 12]);
}

#[test]
fn flags_go_before_the_camera_file() {
    let folder = Folder::tum(1);
    let options = OpenOptions {
        intrinsics: Some([20.0, 21.0, 7.0, 5.0]),
        depth_scale: Some(1000.0),
        max_depth: Some(4.9),
        ..OpenOptions::default()
    };
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    let c = sequence.camera;
    assert_eq!((c.fx, c.fy, c.cx, c.cy), (20.0, 21.0, 7.5, 5.5));
    let frame = sequence.load(0).expect("loads");
    assert!(frame.warnings[0].contains("no pixel has a valid depth"));
    let options = OpenOptions { max_depth: None, ..options };
    let frame = Sequence::open(&folder.0, &options).and_then(|s| s.load(0)).expect("loads");
    assert_eq!(frame.depth_image().expect("depth").at(0, 0, 0), 5.0);
}

#[test]
fn freiburg_cameras_are_known_by_the_folder() {
    let folder = Folder::new();
    for (name, fx, cx) in
        [("rgbd_dataset_freiburg2_xyz", 520.9, 325.6), ("my_fr3_run", 535.4, 320.6)]
    {
        folder.write(&format!("{name}/rgb.txt"), "1.5 c.png\n");
        folder.write(&format!("{name}/depth.txt"), "1.5 d.png\n");
        folder.write(&format!("{name}/c.png"), rgb_png(640, 480, 90));
        folder.write(&format!("{name}/d.png"), depth_png(640, 480, 5000));
        let path = folder.join(name);
        let sequence = Sequence::open(&path, &OpenOptions::default()).expect("opens");
        assert!((sequence.camera.fx - fx).abs() < 1e-9 && (sequence.camera.cx - cx).abs() < 1e-9);
        assert_eq!(sequence.name, name);
        assert_eq!(sequence.valid_mask.is_some(), name.contains("freiburg2"));
    }
}

#[test]
fn plain_folders_pair_by_number_and_count_frames() {
    let folder = Folder::new();
    for i in [1, 2, 10] {
        let depth = depth_png(WIDTH, HEIGHT, 1000 * i);
        folder.write(&format!("depth/depth{i}.png"), depth);
        folder.write(&format!("images/frame{i}.png"), rgb_png(WIDTH, HEIGHT, 99));
    }
    folder.write("images/frame3.png", rgb_png(WIDTH, HEIGHT, 99));
    folder.write("camera.json", CAMERA.replace('}', r#","fps":60,"depth_scale":1000}"#));
    let depths = |depth_pairing: DepthPairing, warning: &str| {
        let options = OpenOptions { depth_pairing, ..OpenOptions::default() };
        let sequence = Sequence::open(&folder.0, &options).expect("opens");
        assert_warns(&sequence.warnings, &[warning]);
        let frames = sequence.stream().map(|f| f.expect("loads"));
        let seen = frames.map(|f| {
            let depth = f.depth_image().map(|depth| depth.at(0, 0, 0));
            (f.index, (f.timestamp * 60.0).round(), depth)
        });
        (seen.collect::<Vec<_>>(), sequence.dropped.without_depth)
    };
    let (seen, dropped) = depths(DepthPairing::OneToOne, "3 of 4 frames have a depth image");
    assert_eq!(
        seen,
        [(0, 0.0, Some(1.0)), (1, 1.0, Some(2.0)), (2, 2.0, None), (3, 3.0, Some(10.0))]
    );
    assert_eq!(dropped, 0);
    let (seen, dropped) = depths(DepthPairing::Nearest, "1 colour image left out");
    assert_eq!(seen, [(0, 0.0, Some(1.0)), (1, 1.0, Some(2.0)), (2, 3.0, Some(10.0))]);
    assert_eq!(dropped, 1);
}

#[test]
fn plain_folders_with_times_for_names_are_associated_by_time() {
    let folder = Folder::new();
    for (i, time) in ["10.000", "10.033", "10.067"].iter().enumerate() {
        folder.write(&format!("color/{time}.png"), rgb_png(WIDTH, HEIGHT, 99));
        let depth = depth_png(WIDTH, HEIGHT, 5000 + i as u16);
        folder.write(&format!("depth/{time}1.png"), depth);
    }
    folder.write("camera.json", CAMERA);
    let sequence = open(&folder).expect("opens");
    let stamps: Vec<f64> = sequence.entries.iter().map(|e| e.timestamp).collect();
    assert_eq!(stamps, [10.0, 10.033, 10.067]);
}

#[test]
fn every_kind_of_colour_image_gives_the_same_picture() {
    let folder = Folder::tum(1);
    let size = (WIDTH, HEIGHT);
    let n = WIDTH * HEIGHT;
    let jpeg = |color, data: &[u8]| {
        let mut bytes = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut bytes, 100);
        encoder.encode(data, WIDTH as u16, HEIGHT as u16, color).expect("encodes");
        bytes
    };
    let kinds = [
        png(size, ColorType::Rgb, BitDepth::Eight, None, &vec![102; 3 * n]),
        png(size, ColorType::Rgba, BitDepth::Eight, None, &vec![102; 4 * n]),
        png(size, ColorType::Rgb, BitDepth::Sixteen, None, &vec![102; 6 * n]),
        png(size, ColorType::Grayscale, BitDepth::Eight, None, &vec![102; n]),
        png(size, ColorType::GrayscaleAlpha, BitDepth::Sixteen, None, &vec![102; 4 * n]),
        png(size, ColorType::Indexed, BitDepth::Four, Some(vec![102; 6]), &vec![0x10; n / 2]),
        jpeg(jpeg_encoder::ColorType::Rgb, &vec![102; 3 * n]),
        jpeg(jpeg_encoder::ColorType::Luma, &vec![102; n]),
    ];
    for (kind, bytes) in kinds.iter().enumerate() {
        folder.write("rgb/000.png", bytes);
        let frame = open(&folder).expect("opens").load(0).expect("loads");
        assert_eq!(frame.colour.channels, 3);
        for value in &frame.colour.data {
            assert!((value - 0.4).abs() < 1e-6, "kind {kind}: {value}");
        }
    }
}

#[test]
fn channels_of_a_jpeg_are_red_green_blue() {
    let folder = Folder::tum(1);
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|_| [250, 120, 10]).collect();
    folder.write("rgb/000.png", jpeg(WIDTH, HEIGHT, &pixels));
    let colour = open(&folder).expect("opens").load(0).expect("loads").colour;
    for (channel, expected) in [250.0, 120.0, 10.0].into_iter().enumerate() {
        assert!((colour.at(channel, 5, 5) * 255.0 - expected).abs() <= 2.0);
    }
}

#[test]
fn reading_ahead_is_bounded_and_ends_with_the_stream() {
    let folder = Folder::tum(30);
    let sequence = open(&folder).expect("opens");
    assert!(sequence.stream().next().is_some_and(|frame| frame.is_ok()), "dropped after a frame");
    let mut stream = sequence.stream();
    assert!(stream.next().is_some_and(|frame| frame.is_ok()));
    // Time for the thread to read as far ahead as it will.
    std::thread::sleep(std::time::Duration::from_millis(100));
    folder.write("rgb/010.png", "not read yet");
    let readable: Vec<bool> = stream.map(|frame| frame.is_ok()).collect();
    assert_eq!(readable.len(), 29);
    assert_eq!(readable.iter().position(|ok| !ok), Some(9));
    assert_eq!(readable.iter().filter(|ok| !**ok).count(), 1);
}

#[test]
fn the_demo_clip_opens_and_every_frame_loads() {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../cli/assets/demo"));
    let sequence = Sequence::open(path, &OpenOptions::default()).expect("opens");
    assert_eq!((sequence.len(), sequence.warnings.len()), (66, 0), "{:?}", sequence.warnings);
    assert!(sequence.valid_mask.is_none());
    assert!((sequence.frame_rate - 30.0).abs() < 2.0);
    let truth = read_trajectory(sequence.ground_truth.as_ref().expect("ground truth"));
    let truth = truth.expect("reads");
    for (i, frame) in sequence.stream().enumerate() {
        let frame = frame.expect("loads");
        assert_eq!((frame.index, frame.warnings.len()), (i, 0), "{:?}", frame.warnings);
        assert_eq!((frame.colour.width, frame.colour.height, frame.colour.channels), (304, 224, 3));
        let valid = frame
            .depth_image()
            .expect("depth")
            .data
            .iter()
            .filter(|&&z| (0.3..10.0).contains(&z))
            .count();
        assert!(
            valid * 2 > frame.depth_image().expect("depth").data.len(),
            "frame {i}: {valid} depths"
        );
        assert!(truth.iter().any(|pose| (pose.timestamp - frame.timestamp).abs() < 0.02));
    }
}

#[test]
#[ignore = "needs the rendered sequences of ../shared/data"]
fn rendered_sequences_keep_all_frames() {
    for name in ["classroom", "dining-room"] {
        let path = shared_data(name);
        let sequence = Sequence::open(&path, &OpenOptions::default()).expect("opens");
        assert_eq!((sequence.len(), sequence.warnings.len()), (80, 0), "{:?}", sequence.warnings);
        assert_eq!((sequence.camera.cx, sequence.camera.cy), (160.0, 120.0));
        let frame = sequence.load(79).expect("loads");
        assert_eq!((frame.index, frame.warnings.len()), (79, 0));
    }
}

/// One gap of the recorded clip (after frame 98) is 0.03057 s, below the 1/32 s of the published
/// protocol: thinning leaves out one frame of the 105.
#[test]
#[ignore = "needs ../shared/data/tum_fr1_rpy_clip"]
fn the_recorded_clip_loses_one_frame_to_thinning() {
    let path = shared_data("tum_fr1_rpy_clip");
    let thinned = Sequence::open(&path, &OpenOptions::default()).expect("opens");
    assert_eq!((thinned.len(), thinned.dropped.too_close), (104, 1));
    let all = Sequence::open(&path, &OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() })
        .expect("opens");
    assert_eq!(all.len(), 105);
    assert_eq!((all.camera.cx, all.camera.cy), (319.1, 255.8));
    assert!(all.warnings.iter().any(|w| w.contains("crop_border = 18")), "{:?}", all.warnings);
    let cropped = OpenOptions { crop_border: 18, scale: 0.5, ..OpenOptions::default() };
    let sequence = Sequence::open(&path, &cropped).expect("opens");
    assert!(sequence.valid_mask.is_none());
    let frame = sequence.load(50).expect("loads");
    assert_eq!((frame.colour.width, frame.colour.height), (302, 222));
}
