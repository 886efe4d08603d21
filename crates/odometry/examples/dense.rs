//! Compares dense depth of keyframes with the depth pictures of a sequence.
//!
//! `cargo run --release -p i2slam-odometry --example dense -- SEQUENCE [--true-poses]` finds the
//! camera path from the colour pictures alone, and the depth of every keyframe; compared with the
//! depth pictures after one scale for the sequence. `--true-poses`: from the true poses instead.

use i2slam_compute::median;
use i2slam_dataset::{OpenOptions, Sequence};
use i2slam_geometry::{Image, Pose, StampedPose, Trajectory};
use i2slam_odometry::{DenseDepthEstimator, FrontEnd, Intrinsics, PosedView, Reconstruction};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: dense SEQUENCE")?;
    let options = OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() };
    let sequence = Sequence::open(Path::new(&folder), &options)?;
    let mut front_end = FrontEnd::new(Intrinsics::Known(sequence.camera));
    for frame in sequence.stream() {
        let frame = frame?;
        front_end.push(&frame.colour, frame.timestamp)?;
    }
    let mut found = front_end.finish()?;
    if std::env::args().any(|a| a == "--true-poses") {
        place_truly(&mut found, &sequence.true_trajectory()?);
    }
    let views = found.keyframes.iter().map(|k| PosedView {
        world_from_camera: k.world_from_camera,
        landmarks: k.depths.iter().map(|d| d.depth).collect(),
    });
    let mut dense = DenseDepthEstimator::new(found.camera, views.collect());
    let picture = |k: usize| sequence.load(found.keyframes[k].index).ok();
    let (mut seconds, mut all) = (0.0, Vec::new());
    for (k, keyframe) in found.keyframes.iter().enumerate() {
        let clock = Instant::now();
        let depth = dense.estimate(k, &mut |k| picture(k).map(|frame| frame.colour));
        seconds += clock.elapsed().as_secs_f64();
        let (Some(depth), Some(truth)) = (depth, picture(k)) else {
            println!("{:4} nothing", keyframe.index);
            continue;
        };
        all.push((keyframe.index, depth, truth.depth));
    }
    let pairs = |found: &Image<f32>, truth: &Image<f32>| -> Vec<(usize, f32, f32)> {
        let both = found.data.iter().zip(&truth.data).enumerate();
        both.filter(|(_, (f, t))| **f > 0.0 && **t > 0.0).map(|(i, (f, t))| (i, *f, *t)).collect()
    };
    let mut ratios: Vec<f32> = Vec::new();
    for (_, found, truth) in &all {
        ratios.extend(pairs(&found.depth, truth).iter().map(|(_, f, t)| t / f));
    }
    let scale = median(&mut ratios).unwrap_or(1.0);
    let (mut offs, mut deviations, mut coverage) = (Vec::new(), Vec::new(), 0.0);
    for (index, found, truth) in &all {
        let pairs = pairs(&found.depth, truth);
        let off = |(_, f, t): &(usize, f32, f32)| (f * scale - t).abs() / t;
        let mut here: Vec<f32> = pairs.iter().map(off).collect();
        let covered =
            pairs.len() as f64 / truth.data.iter().filter(|d| **d > 0.0).count().max(1) as f64;
        coverage += covered / all.len() as f64;
        offs.extend(&here);
        let deviation =
            |(i, f, t): &(usize, f32, f32)| (f - t / scale).abs() / found.variance.data[*i].sqrt();
        deviations.extend(pairs.iter().map(deviation));
        println!(
            "{index:4}: {:4.1} % known, median error {:.2} %",
            100.0 * covered,
            100.0 * median(&mut here).unwrap_or(1.0)
        );
    }
    offs.sort_by(f32::total_cmp);
    let at =
        |share: f64| 100.0 * offs.get((share * offs.len() as f64) as usize).copied().unwrap_or(1.0);
    println!(
        "all: {:.1} % known, error {:.2} % (median), {:.2} % (90 of 100), {:.2} deviations (median; 0.67 due), {:.2} s per keyframe",
        100.0 * coverage,
        at(0.5),
        at(0.9),
        median(&mut deviations).unwrap_or(0.0),
        seconds / all.len().max(1) as f64,
    );
    Ok(())
}

/// Puts keyframes and landmarks where they are; the unit becomes that of the truth.
fn place_truly(found: &mut Reconstruction, truth: &Trajectory) {
    let at = |timestamp: f64| {
        let near = |p: &&StampedPose| (p.timestamp - timestamp).abs() < 1e-3;
        truth.iter().find(near).map(|p| p.world_from_camera)
    };
    let ends = [&found.keyframes[0], &found.keyframes[found.keyframes.len() - 1]];
    let way = |a: Pose<f64>, b: Pose<f64>| (a.translation - b.translation).norm();
    let estimated = way(ends[0].world_from_camera, ends[1].world_from_camera);
    let [Some(first), Some(last)] = ends.map(|k| at(k.timestamp)) else { return };
    let unit = way(first, last) / estimated;
    for keyframe in &mut found.keyframes {
        if let Some(pose) = at(keyframe.timestamp) {
            keyframe.world_from_camera = pose;
        }
        keyframe.depths.iter_mut().for_each(|d| d.depth *= unit);
    }
}
