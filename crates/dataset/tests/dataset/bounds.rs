//! Files that never end, or that claim more than they hold, are refused before they are read.

use crate::support::{
    CAMERA, Folder, HEIGHT, WIDTH, assert_says, assert_warns, import, jpeg, jpeg_header, open, png,
    png_header,
};
use i2slam_dataset::{OpenOptions, Sequence, read_trajectory};
use std::path::Path;

/// Replaces a file by a named pipe without a writer, which blocks whoever opens it as a file.
#[cfg(unix)]
fn replace_by_pipe(path: &Path) {
    let _ = std::fs::remove_file(path);
    let made = std::process::Command::new("mkfifo").arg(path).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
}

#[test]
#[cfg(unix)]
fn pipes_and_devices_in_place_of_files_are_refused_by_name() {
    const NO_FILE: &str = "no regular file";
    for name in ["rgb.txt", "depth.txt", "camera.json"] {
        let folder = Folder::tum(2);
        replace_by_pipe(&folder.join(name));
        assert_says(open(&folder), &["cannot read", name, NO_FILE]);
    }
    let folder = Folder::tum(3);
    replace_by_pipe(&folder.join("groundtruth.txt"));
    let sequence = open(&folder).expect("opens");
    assert_warns(&sequence.warnings, &["ground truth ignored", "groundtruth.txt", NO_FILE]);
    // One picture is left out, as a damaged one.
    std::fs::remove_file(folder.join("rgb/001.png")).expect("removes");
    std::os::unix::fs::symlink("/dev/zero", folder.join("rgb/001.png")).expect("links");
    replace_by_pipe(&folder.join("depth/002.png"));
    let frames: Vec<_> = open(&folder).expect("opens").stream().collect();
    let [Ok(_), Err(device), Err(pipe)] = &frames[..] else { panic!("{frames:?}") };
    for (error, name) in [(device, "rgb/001.png"), (pipe, "depth/002.png")] {
        let message = error.to_string();
        assert!(error.concerns_one_frame(), "{message}");
        assert!(message.contains(name) && message.contains(NO_FILE), "{message}");
    }
    let pipe = folder.join("poses");
    replace_by_pipe(&pipe);
    assert_says(read_trajectory(&pipe), &["poses", NO_FILE]);
    assert_says(import(&pipe), &["poses", NO_FILE]);
    let device = Path::new("/dev/null");
    assert_says(Sequence::open(device, &OpenOptions::default()), &["/dev/null", NO_FILE]);
}

/// A black PNG of one bit a pixel, a few kilobytes even if it has many pixels.
fn wide_png(side: usize) -> Vec<u8> {
    let rows = vec![0; side.div_ceil(8) * side];
    png((side, side), png::ColorType::Grayscale, png::BitDepth::One, None, &rows)
}

#[test]
fn an_oversize_picture_is_left_out_wherever_it_is() {
    let wide = wide_png(8000);
    for camera in [CAMERA, r#"{"fx":14.0,"fy":14.0,"cx":7.5,"cy":5.5}"#] {
        for oversize in 0..3 {
            let folder = Folder::tum(3);
            folder.write("camera.json", camera);
            folder.write(&format!("rgb/00{oversize}.png"), &wide);
            let sequence = open(&folder).expect("opens");
            assert_eq!(sequence.recorded_size, (WIDTH, HEIGHT), "{camera} {oversize}");
            for (frame, read) in sequence.stream().enumerate() {
                match read {
                    Ok(_) => assert_ne!(frame, oversize),
                    Err(error) => {
                        assert!(frame == oversize && error.concerns_one_frame(), "{error}");
                        assert!(error.to_string().contains("is 8000x8000 px, expected 16x12"));
                    }
                }
            }
        }
    }
}

#[test]
fn pictures_that_nothing_is_known_about_are_bounded() {
    let folder = Folder::tum(1);
    folder.write("camera.json", r#"{"fx":14.0,"fy":14.0,"cx":7.5,"cy":5.5}"#);
    let noise = vec![128; 3 * WIDTH * HEIGHT];
    for (bytes, parts) in [
        (png_header(32000, 32000), ["32000x32000 px", "at most 134 megapixels"]),
        (png_header(u32::MAX >> 1, u32::MAX >> 1), ["2147483647x2147483647 px", "megapixels"]),
        (png_header(11000, 11000), ["bytes hold no image of", "11000x11000 px"]),
        (jpeg_header(jpeg(WIDTH, HEIGHT, &noise), 16000, 16000), ["16000x16000", "megapixels"]),
    ] {
        folder.write("rgb/000.png", bytes);
        assert_says(open(&folder), &parts);
    }
    // A photograph of 100 megapixels is one that can be opened.
    folder.write("rgb/000.png", wide_png(10_000));
    assert_eq!(open(&folder).expect("opens").recorded_size, (10_000, 10_000));
}
