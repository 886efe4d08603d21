//! Recordings of the app Stray Scanner, whose video ffmpeg makes.

use super::support::{Folder, assert_says, depth_png, png, rgb_png};
use i2slam_dataset::{Layout, OpenOptions, Sequence};
use std::process::Command;

const MATRIX: &str = "40.0, 0.0, 23.5\n0.0, 40.0, 15.5\n0.0, 0.0, 1.0\n";

/// Three pictures of 48x32; depth of 24x16 for the first two, the left half of the second doubtful.
fn recording() -> Folder {
    let folder = Folder::new();
    (0..3).for_each(|i| drop(folder.write(&format!("{i:03}.png"), rgb_png(48, 32, 60 + 5 * i))));
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-nostdin", "-framerate", "10", "-i"])
        .arg(folder.join("%03d.png"))
        .args(["-c:v", "libx264", "-pix_fmt", "yuv420p"])
        .arg(folder.join("rgb.mp4"))
        .status();
    assert!(made.expect("ffmpeg").success());
    folder.write("camera_matrix.csv", MATRIX);
    for i in 0..2 {
        folder.write(&format!("depth/{i:06}.png"), depth_png(24, 16, 1500 + i));
        let confidence: Vec<u8> =
            (0..24 * 16).map(|at| if i == 1 && at % 24 < 12 { 0 } else { 2 }).collect();
        let (grey, bits) = (png::ColorType::Grayscale, png::BitDepth::Eight);
        let picture = png((24, 16), grey, bits, None, &confidence);
        folder.write(&format!("confidence/{i:06}.png"), picture);
    }
    folder
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_comes_on_the_grid_of_colour_without_what_is_doubtful() {
    let folder = recording();
    let sequence = Sequence::open(&folder.join(""), &OpenOptions::default()).expect("a recording");
    assert_eq!((sequence.layout, sequence.len()), (Layout::StrayScanner, 3));
    assert_eq!((sequence.camera.width, sequence.camera.fx, sequence.camera.cx), (48, 40.0, 24.0));
    assert_eq!(sequence.frames_with_depth(), 2);
    let frames: Vec<_> = (0..3).map(|at| sequence.load(at).expect("a frame")).collect();
    let depth = |frame: usize, x: usize| frames[frame].depth_image().map(|d| d.data[48 * 16 + x]);
    assert_eq!([depth(0, 10), depth(0, 30), depth(2, 0)], [Some(1.5), Some(1.5), None]);
    assert_eq!([depth(1, 23), depth(1, 24)], [Some(0.0), Some(1.501)]);
    assert!((frames[2].timestamp - 0.2).abs() < 1e-6);

    let colour = OpenOptions { colour_only: true, ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.join(""), &colour).expect("a recording");
    assert_eq!((sequence.len(), sequence.frames_with_depth()), (3, 0));
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_recording_that_does_not_fit_is_told() {
    let folder = recording();
    let open = || Sequence::open(&folder.join(""), &OpenOptions::default());
    for (text, problem) in [
        ("1 2 3\n", "line 1: 1 columns, expected 3"),
        ("0,0,9\n0,5,9\n0,0,1\n", "expected a 3x3 matrix"),
        ("5,0,9\n0,x,9\n0,0,1\n", "line 2"),
    ] {
        folder.write("camera_matrix.csv", text);
        assert_says(open(), &["camera_matrix.csv", problem]);
    }
    folder.write("camera_matrix.csv", MATRIX);
    for i in 0..2 {
        let depth = |number: usize| folder.join(&format!("depth/{number:06}.png"));
        std::fs::rename(depth(i), depth(i + 40)).expect("renamed");
    }
    assert_says(open(), &["depth", "2 depth pictures", "3 pictures of rgb.mp4"]);
}
