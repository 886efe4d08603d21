//! Each method against the true blur of a path tracer, along the true motion of its camera.

use super::Outcome;
use super::fitted::{Fitted, psnr};
use i2slam::formation::ShutterPoses;
use i2slam::geometry::{Pose, Rotation, Vec3};
use i2slam::objective::{BlurMethod, Sampling, blur_length};
use std::error::Error;
use std::path::PathBuf;

const SEQUENCES: [&str; 2] = ["classroom", "dining-room"];

/// Frames that the map is fitted to.
const FRAMES: usize = 80;

/// Edges of the classes of blur length [px].
const EDGES: [f64; 6] = [0.0, 0.5, 1.0, 2.0, 4.0, f64::INFINITY];

/// Mean PSNR in decibels by class of blur length. What is left is the error of the map.
pub(crate) fn print() -> Outcome {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    println!("sequence,blur_from_px,blur_to_px,frames,sharp,exact,image,exact_32");
    for name in SEQUENCES {
        let folder = PathBuf::from(data).join(name);
        if !folder.is_dir() {
            eprintln!("truth: {} is not there, left out", folder.display());
            continue;
        }
        let mut fitted = Fitted::new(&folder, FRAMES)?;
        let exposures =
            exposures(&std::fs::read_to_string(folder.join("groundtruth_shutter.txt"))?)?;
        let values: Vec<_> =
            (0..fitted.frames.len()).map(|i| compare(&mut fitted, i, &exposures)).collect();
        for edges in EDGES.windows(2) {
            let inside = |(length, _): &&(f64, [f64; 4])| (edges[0]..edges[1]).contains(length);
            let class: Vec<_> = values.iter().filter(inside).map(|(_, psnr)| psnr).collect();
            if class.is_empty() {
                continue;
            }
            let mean = |k: usize| class.iter().map(|v| v[k]).sum::<f64>() / class.len() as f64;
            let means: Vec<_> = (0..4).map(|k| format!("{:.2}", mean(k))).collect();
            println!("{name},{},{},{},{}", edges[0], edges[1], class.len(), means.join(","));
        }
    }
    Ok(())
}

/// The blur of a frame [px], and how close sharp, exact, image and 32 exact views come.
fn compare(fitted: &mut Fitted, index: usize, exposures: &[ShutterPoses<f64>]) -> (f64, [f64; 4]) {
    let frame = fitted.scene.frames[index].clone();
    let shutter = exposures[index];
    let length = blur_length(&fitted.scene.camera, &shutter, &fitted.frames[index].depth);
    let taken = fitted.frames[index].colour.clone();
    let methods = [
        Sampling::SINGLE_CAMERA,
        fitted.sampling(length, BlurMethod::Exact),
        fitted.sampling(length, BlurMethod::Reprojected),
        Sampling { virtual_cameras: 32, ..fitted.sampling(length, BlurMethod::Exact) },
    ];
    (length, methods.map(|sampling| psnr(&fitted.predict(&frame, shutter, sampling), &taken)))
}

/// Poses at shutter open and close from lines of a time and twice `t q` (x, y, z, w), in the frame
/// of the first camera at mid-exposure.
fn exposures(text: &str) -> Result<Vec<ShutterPoses<f64>>, Box<dyn Error>> {
    let mut all = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty()) {
        let numbers = line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        let pose = |n: &[f64]| {
            let rotation = Rotation::from_wxyz(n[6], n[3], n[4], n[5])?;
            Some(Pose::new(rotation, Vec3::new(n[0], n[1], n[2])))
        };
        let [start, end] = [numbers.get(1..8), numbers.get(8..15)].map(|n| n.and_then(pose));
        let (Some(start), Some(end)) = (start, end) else { return Err("not two poses".into()) };
        all.push(ShutterPoses { start, end });
    }
    let first = all.first().ok_or("no poses")?.middle().inverse();
    all.iter_mut().for_each(|s| (s.start, s.end) = (first * s.start, first * s.end));
    Ok(all)
}
