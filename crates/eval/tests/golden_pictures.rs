//! Picture metrics against the public tools: `golden/README.md` says how the numbers were made.

mod common;

use common::numbers;
use i2slam_eval::image::{lpips, ms_ssim, psnr, psnr_channel_mean, ssim, ssim_padded};
use i2slam_eval::sharpness::laplacian_variance;
use i2slam_geometry::Image;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The procedural picture of `make_pictures.py`.
fn picture([width, height]: [usize; 2], phase: f64) -> Image<f32> {
    let mut image = Image::new(width, height, 3);
    for c in 0..3 {
        for row in 0..height {
            for column in 0..width {
                let (x, y) = (0.37 * column as f64 + 0.9 * c as f64 + phase, 0.23 * row as f64);
                let check = (column / 6 + row / 5 + c) % 2;
                let value = 0.5 + 0.3 * x.sin() * (y - phase).cos() + 0.15 * check as f64;
                image.data[(c * height + row) * width + column] = value as f32;
            }
        }
    }
    image
}

/// Every golden number of these pictures is met.
#[track_caller]
fn assert_agree(name: &str, render: &Image<f32>, truth: &Image<f32>) {
    let due = numbers("pictures.numbers");
    let close = |key: &str, value: f64, tolerance: f64| {
        let due = due[&format!("{key}_{name}")];
        assert!((value - due).abs() < tolerance, "{key} {name}: {value} expected {due}");
    };
    let structural = ssim(render, truth).unwrap();
    close("ssim", structural, 1e-6);
    close("ssim_torch", structural, 1e-4);
    close("ssim_padded", ssim_padded(render, truth).unwrap(), 1e-6);
    close("laplacian_variance", laplacian_variance(render).unwrap(), 1e-9);
    close("lpips", lpips(render, truth).unwrap(), 1e-3);
    close("psnr", psnr(render, truth).unwrap(), 1e-4);
    close("psnr_channel_mean", psnr_channel_mean(render, truth).unwrap(), 1e-4);
    if due.contains_key(&format!("ms_ssim_{name}")) {
        close("ms_ssim", ms_ssim(render, truth).unwrap(), 1e-5);
    }
}

#[test]
fn procedural_pictures_agree() {
    for (prefix, size) in [("", [48, 37]), ("large_", [203, 166])] {
        for (name, phase) in [("near", 0.05), ("far", 0.8)] {
            assert_agree(&format!("{prefix}{name}"), &picture(size, phase), &picture(size, 0.0));
        }
    }
}

#[test]
#[should_panic(expected = "expected")]
fn a_slight_change_is_noticed() {
    assert_agree("large_near", &picture([203, 166], 0.0501), &picture([203, 166], 0.0));
}

/// An 8-bit PNG without alpha.
fn read_png(path: &Path) -> Image<f32> {
    let mut reader =
        png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let mut image = Image::new(info.width as usize, info.height as usize, 3);
    for c in 0..3 {
        let values = bytes.iter().skip(c).step_by(info.color_type.samples());
        for (out, &v) in image.plane_mut(c).iter_mut().zip(values) {
            *out = f32::from(v) / 255.0;
        }
    }
    image
}

#[test]
fn the_reference_pictures_of_lpips_agree() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/weights/lpips_ref");
    let folder = Path::new(folder);
    if !folder.is_dir() {
        println!("skipped: no {}", folder.display());
        return;
    }
    let truth = read_png(&folder.join("ex_ref.png"));
    for (name, file) in [("p0", "ex_p0.png"), ("p1", "ex_p1.png")] {
        assert_agree(name, &read_png(&folder.join(file)), &truth);
    }
}
