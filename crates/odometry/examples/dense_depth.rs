//! Errors of dense depth that is estimated from pictures alone, on a sequence with true poses and depth.
//!
//! `cargo run --release -p i2slam-odometry --example dense_depth -- SEQUENCE [--scale S] [--stride N]
//! [--frames N] [--photographs]` takes every N-th frame as a keyframe at its true pose. For each it prints the share of
//! pixels with true depth whose depth is estimated, quantiles of the relative error of these, shares
//! of errors beyond 2 % and 10 %, and the median of |error| over the deviation claimed, which is 0.67
//! where deviations are right; then the same of all together. `--photographs` matches in any order, by planes.

use i2slam_dataset::{Frame, OpenOptions, Sequence, read_trajectory};
use i2slam_geometry::StampedPose;
use i2slam_odometry::{DenseDepthEstimator, KeyframePictures, PosedView};
use std::error::Error;
use std::path::Path;

/// Pixels between those whose true depth stands for landmarks.
const LANDMARK_SPACING: usize = 37;

/// Relative error of a pixel, and the relative deviation claimed.
struct PixelError {
    error: f64,
    deviation: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, flags @ ..] = arguments.as_slice() else {
        return Err(
            "usage: dense_depth SEQUENCE [--scale S] [--stride N] [--frames N] [--photographs]"
                .into(),
        );
    };
    let options =
        OpenOptions { scale: number(flags, "--scale")?.unwrap_or(1.0), ..OpenOptions::default() };
    let stride = number(flags, "--stride")?.unwrap_or(5.0) as usize;
    let count = number(flags, "--frames")?.map_or(usize::MAX, |n| n as usize);
    let sequence = Sequence::open(Path::new(folder), &options)?;
    let truth = read_trajectory(Path::new(folder).join("groundtruth.txt"))?;
    let frames = sequence.stream().take(count).step_by(stride.max(1));
    let frames = frames.collect::<Result<Vec<Frame>, _>>()?;
    let views = frames.iter().map(|frame| posed_view(frame, &truth)).collect::<Option<Vec<_>>>();
    let views = views.ok_or("every frame needs true depth and a true pose")?;
    let mut estimator = DenseDepthEstimator::new(sequence.camera, views);
    if flags.iter().any(|flag| flag == "--photographs") {
        estimator = estimator.with_any_order();
    }
    println!("frame  known   error %: median  p75   p90   p95   > 2 %  > 10 %   |e|/deviation");
    let (mut all, mut pixels) = (Vec::new(), 0);
    let began = std::time::Instant::now();
    for (index, frame) in frames.iter().enumerate() {
        let mut load = |i: usize| Some(KeyframePictures::colour_only(frames[i].colour.clone()));
        let Some(found) = estimator.estimate(index, &mut load) else { continue };
        let Some(depth) = &frame.depth else { continue };
        let mut errors = Vec::new();
        let mut known = 0;
        for (pixel, due) in depth.image.data.iter().enumerate().filter(|(_, due)| **due > 0.0) {
            known += 1;
            let (z, variance) = (found.depth.data[pixel], found.variance.data[pixel]);
            if z > 0.0 {
                let deviation = f64::from(variance.sqrt() / z);
                errors.push(PixelError { error: f64::from((z / due - 1.0).abs()), deviation });
            }
        }
        print_row(&frame.index.to_string(), &errors, known);
        pixels += known;
        all.extend(errors);
    }
    print_row("all", &all, pixels);
    println!("{:.2} s a keyframe", began.elapsed().as_secs_f64() / frames.len().max(1) as f64);
    Ok(())
}

fn posed_view(frame: &Frame, truth: &[StampedPose]) -> Option<PosedView> {
    let nearest = truth.iter().min_by(|a, b| {
        (a.timestamp - frame.timestamp).abs().total_cmp(&(b.timestamp - frame.timestamp).abs())
    })?;
    let depths = frame.depth.as_ref()?.image.data.iter().step_by(LANDMARK_SPACING);
    let landmarks = depths.filter(|z| **z > 0.0).map(|z| f64::from(*z)).collect();
    Some(PosedView { world_from_camera: nearest.world_from_camera, landmarks })
}

fn print_row(name: &str, errors: &[PixelError], known: usize) {
    let sorted = |of: &dyn Fn(&PixelError) -> f64| {
        let mut values: Vec<f64> = errors.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let at = |values: &[f64], share: f64| {
        values.get((share * values.len().max(1) as f64) as usize).copied().unwrap_or(f64::NAN)
    };
    let relative = sorted(&|e| e.error);
    let ratios = sorted(&|e| e.error / e.deviation);
    let beyond = |most: f64| {
        100.0 * relative.iter().filter(|e| **e > most).count() as f64 / known.max(1) as f64
    };
    let [a, b, c, d] = [0.5, 0.75, 0.9, 0.95].map(|share| 100.0 * at(&relative, share));
    println!(
        "{name:>5}  {:5.1}   {a:14.2} {b:5.2} {c:5.1} {d:5.1}   {:5.1}  {:6.1}   {:.2}",
        100.0 * errors.len() as f64 / known.max(1) as f64,
        beyond(0.02),
        beyond(0.1),
        at(&ratios, 0.5)
    );
}

fn number(flags: &[String], name: &str) -> Result<Option<f64>, Box<dyn Error>> {
    let Some(at) = flags.iter().position(|flag| flag == name) else { return Ok(None) };
    let value = flags.get(at + 1).ok_or_else(|| format!("{name} takes a number"))?;
    Ok(Some(value.parse().map_err(|_| format!("{name}: '{value}' is not a number"))?))
}
