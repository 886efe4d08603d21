//! Errors of dense constraints over the deviations that they claim, on a sequence with true poses.
//!
//! `cargo run --release -p i2slam-odometry --example dense_constraints -- SEQUENCE [--scale S]
//! [--open SHARE] [--readout SECONDS] [--truth-noise METRES] [--truth-delay SECONDS]
//! [--colour-only 1] [--first-only 1]` aligns pairs of
//! frames 1, 3, 5, 10 and 15 frames apart, from their true relative pose moved by 5 mm and a
//! quarter of a degree on every axis. For each distance it prints the share of pairs with a
//! constraint, median and largest errors of position and rotation, and medians of |error| over
//! deviation per axis, which are 0.67 where deviations are right. SHARE is the part of the frame
//! interval for which the shutter is open.

use i2slam_dataset::{Frame, OpenOptions, Sequence, read_trajectory};
use i2slam_geometry::{Pose, StampedPose, Tangent};
use i2slam_odometry::alignment::{DenseConstraint, DensePyramid, DenseView, ExposureMotion, align};
use i2slam_odometry::register_depth;
use std::error::Error;
use std::path::Path;

const DISTANCES: [usize; 5] = [1, 3, 5, 10, 15];

struct View {
    pictures: DensePyramid,
    motion: ExposureMotion,
    world_from_camera: Pose<f64>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, flags @ ..] = arguments.as_slice() else {
        return Err("usage: dense_constraints SEQUENCE [--scale S] [--open SHARE] [--readout SECONDS] [--truth-noise METRES]".into());
    };
    let options =
        OpenOptions { scale: number(flags, "--scale")?.unwrap_or(1.0), ..OpenOptions::default() };
    let sequence = Sequence::open(Path::new(folder), &options)?;
    let truth = read_trajectory(Path::new(folder).join("groundtruth.txt"))?;
    let frames = sequence.stream().collect::<Result<Vec<Frame>, _>>()?;
    let interval =
        (frames[frames.len() - 1].timestamp - frames[0].timestamp) / (frames.len() - 1) as f64;
    let open = number(flags, "--open")?.unwrap_or(0.0) * interval;
    let readout = number(flags, "--readout")?.unwrap_or(0.0);
    let noise = number(flags, "--truth-noise")?.unwrap_or(0.0);
    let truth_delay = number(flags, "--truth-delay")?.unwrap_or(0.0);
    let colour_only = number(flags, "--colour-only")?.is_some();
    let views: Vec<View> = frames
        .iter()
        .filter_map(|frame| {
            let at = |time: f64| pose_at(&truth, time + truth_delay);
            let (before, after) = (at(frame.timestamp - 0.02), at(frame.timestamp + 0.02));
            let world_from_camera = at(frame.timestamp)?;
            let pose = |p: Option<Pose<f64>>| p.unwrap_or(world_from_camera);
            let time = if before.is_some() && after.is_some() { 0.04 } else { 0.02 };
            let moved = pose(before).local(pose(after));
            let velocity = moved.scaled(1.0 / time);
            let motion = ExposureMotion { velocity, exposure: open, readout };
            let depth = frame.depth.as_ref().map(|depth| {
                let delay = depth.timestamp - frame.timestamp;
                let pose = Pose::identity().retract(velocity.scaled(delay));
                match delay == 0.0 {
                    true => depth.image.as_ref().clone(),
                    false => {
                        register_depth(&depth.image, &sequence.camera, [0.0; 2], &pose.inverse())
                    }
                }
            });
            let pictures = DensePyramid::new(&sequence.camera, &frame.colour, depth.as_ref());
            Some(View { pictures, motion, world_from_camera })
        })
        .collect();
    let bare: Vec<DensePyramid> = match colour_only {
        true => {
            frames.iter().map(|f| DensePyramid::new(&sequence.camera, &f.colour, None)).collect()
        }
        false => Vec::new(),
    };
    println!(
        "frames apart  pairs  found  |t| mm median, p90, max   |r| mrad median, p90, max   |e|/sigma x y z  rx ry rz   overlap"
    );
    let distances =
        if number(flags, "--first-only")?.is_some() { &DISTANCES[..1] } else { &DISTANCES };
    for &distance in distances {
        let mut errors: Vec<([f64; 6], DenseConstraint)> = Vec::new();
        let pairs = views.len().saturating_sub(distance);
        let began = std::time::Instant::now();
        for i in 0..pairs {
            let (reference, frame) = (&views[i], &views[i + distance]);
            let true_pose = reference.world_from_camera.inverse() * frame.world_from_camera;
            let sign = |k: usize| if (i + k).is_multiple_of(2) { 1.0 } else { -1.0 };
            let offset = std::array::from_fn(|k| sign(k) * if k < 3 { 0.005 } else { 0.0045 });
            let start = true_pose.retract(Tangent::from_array(offset));
            let view = |v: &'_ View| v.motion;
            let pictures = if colour_only { &bare[i + distance] } else { &frame.pictures };
            let found = align(
                DenseView { pictures: &reference.pictures, motion: view(reference) },
                DenseView { pictures, motion: view(frame) },
                start,
            );
            if let Some(found) = found {
                errors.push((found.reference_from_frame.local(true_pose).to_array(), found));
            }
        }
        let elapsed = began.elapsed().as_secs_f64() / pairs.max(1) as f64;
        print_row(distance, pairs, &errors, noise);
        println!("      {:.1} ms each", 1e3 * elapsed);
    }
    Ok(())
}

fn print_row(distance: usize, pairs: usize, errors: &[([f64; 6], DenseConstraint)], noise: f64) {
    let norm =
        |e: &[f64; 6], from: usize| 1e3 * (from..from + 3).map(|i| e[i] * e[i]).sum::<f64>().sqrt();
    let sorted = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            values
                .get((share * (values.len().max(1) - 1) as f64) as usize)
                .copied()
                .unwrap_or(f64::NAN)
        };
        [at(0.5), at(0.9), at(1.0)]
    };
    let part = |from: usize| sorted(errors.iter().map(|(e, _)| norm(e, from)).collect());
    let ratio = |axis: usize| {
        let of = |(e, found): &([f64; 6], DenseConstraint)| {
            let extra = if axis < 3 { noise * noise } else { 0.0 };
            e[axis].abs() / (variance(&found.information, axis) + extra).sqrt()
        };
        sorted(errors.iter().map(of).collect())[0]
    };
    let overlap = sorted(errors.iter().map(|(_, c)| c.overlap).collect())[0];
    let weight = sorted(errors.iter().map(|(_, c)| c.image_weight).collect())[0];
    let (depth, image) = (
        sorted(errors.iter().map(|(_, c)| f64::from(c.scales.depth)).collect())[0],
        sorted(errors.iter().map(|(_, c)| f64::from(c.scales.image)).collect())[0],
    );
    let [t, r] = [part(0), part(3)];
    let z: Vec<String> = (0..6).map(|i| format!("{:.2}", ratio(i))).collect();
    print!(
        "{distance:4} {pairs:4} {:4}  {:7.3} {:7.3} {:7.3}  {:7.3} {:7.3} {:7.3}  {}  {overlap:.2} w {weight:.3} depth {:.2} mm image {image:.4}",
        errors.len(),
        t[0],
        t[1],
        t[2],
        r[0],
        r[1],
        r[2],
        z.join(" "),
        1e3 * depth,
    );
}

/// Variance of one number, by Gauss-Jordan elimination of the information.
fn variance(information: &[[f64; 6]; 6], axis: usize) -> f64 {
    let mut m = *information;
    let mut x = [0.0; 6];
    x[axis] = 1.0;
    for i in 0..6 {
        for r in (0..6).filter(|r| *r != i) {
            let factor = m[r][i] / m[i][i];
            for c in 0..6 {
                m[r][c] -= factor * m[i][c];
            }
            x[r] -= factor * x[i];
        }
    }
    x[axis] / m[axis][axis]
}

/// The true pose at a time, between the two stamps around it; `None` outside.
fn pose_at(truth: &[StampedPose], time: f64) -> Option<Pose<f64>> {
    let next = truth.partition_point(|p| p.timestamp < time);
    let (after, before) = (truth.get(next)?, truth.get(next.checked_sub(1).unwrap_or(next))?);
    let span = after.timestamp - before.timestamp;
    let u = if span > 0.0 { (time - before.timestamp) / span } else { 0.0 };
    (after.timestamp - time < 0.1)
        .then(|| before.world_from_camera.interpolate(after.world_from_camera, u))
}

/// The number behind a flag.
fn number(flags: &[String], name: &str) -> Result<Option<f64>, Box<dyn Error>> {
    let value = flags.iter().position(|flag| flag == name).and_then(|i| flags.get(i + 1));
    Ok(value.map(|v| v.parse()).transpose()?)
}
