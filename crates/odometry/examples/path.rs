//! The camera path of a sequence or video.
//!
//! `cargo run --release -p i2slam-odometry --example path -- SEQUENCE OUT.txt [--depth]
//! [--scale FACTOR] [--stride N] [--fov DEGREES] [--guess FACTOR] [--open]
//! [--online FILE] [--scratch MB] [--near FILE]` writes `world_from_camera` poses in the TUM format, and prints
//! their error where the sequence has a true path, also over the deviations that they claim, that of
//! the poses as they were known when the frames came, that of the last pose as seen from the first ones
//! (the seam of a loop), and the time of frames and stages.
//! Depth is used with `--depth`; with `--open` no loop is closed; with `--scratch` pictures take up
//! to so much memory, and others leave it for a file. Photographs are matched near the poses of `--near`.
//! The focal length is taken from the sequence or `--fov`; it is estimated where neither gives it,
//! or from FACTOR times that of the sequence with `--guess`.

use i2slam_compute::CancellationToken;
use i2slam_dataset::{OpenOptions, Sequence, read_trajectory, write_trajectory};
use i2slam_eval::trajectory::{
    Alignment, ClaimedPose, DEFAULT_TOLERANCE, DeviationRatios, TrajectoryError,
    absolute_trajectory_error, deviation_ratios,
};
use i2slam_geometry::{Camera, Pose, StampedPose};
use i2slam_odometry::{
    DepthPicture, FrontEnd, Intrinsics, MIN_NEIGHBOURS, NEIGHBOUR_WINDOW, Progress, Reconstruction,
    Stage,
};
use i2slam_storage::ScratchStore;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, out, flags @ ..] = arguments.as_slice() else {
        return Err(
            "usage: path SEQUENCE OUT.txt [FLAGS], see the first lines of its source".into()
        );
    };
    let uses_depth = flags.iter().any(|flag| flag == "--depth");
    let options = OpenOptions {
        colour_only: !uses_depth,
        scale: number(flags, "--scale")?.unwrap_or(1.0),
        stride: number(flags, "--stride")?.unwrap_or(1.0) as usize,
        guess_camera: true,
        field_of_view: number(flags, "--fov")?,
        minimum_gap: 0.0,
        ..OpenOptions::default()
    };
    let sequence = Sequence::open(Path::new(folder), &options)?;
    let camera = sequence.camera;
    let mut front_end = FrontEnd::new(match number(flags, "--guess")? {
        Some(f) => Intrinsics::Guess(Camera { fx: f * camera.fx, fy: f * camera.fy, ..camera }),
        None if sequence.camera_is_guess => Intrinsics::Guess(camera),
        None => Intrinsics::Known(camera),
    });
    if flags.iter().any(|flag| flag == "--open") {
        front_end = front_end.without_loop_closure();
    }
    if let Some(place) = flags.iter().position(|flag| flag == "--scratch") {
        let megabytes = flags.get(place + 1).ok_or("--scratch needs a number of megabytes")?;
        let bytes = megabytes.parse::<usize>()? << 20;
        front_end = front_end.with_scratch(ScratchStore::new(bytes, std::env::temp_dir()));
    }
    let started = Instant::now();
    let (mut seconds, mut stamps) = (Vec::new(), Vec::new());
    let mut focal_length_before = front_end.camera().fx;
    for frame in sequence.stream() {
        let frame = frame?;
        let depth = frame
            .depth
            .as_ref()
            .map(|depth| DepthPicture { depth: &depth.image, timestamp: depth.timestamp });
        let pushed = Instant::now();
        let update = front_end.push(&frame.colour, frame.timestamp, depth.as_ref())?;
        stamps.push(frame.timestamp);
        if update.is_loop_closed {
            println!("a loop is closed when frame {} comes", update.frame);
        }
        seconds.push(pushed.elapsed().as_secs_f64());
        let focal_length = front_end.camera().fx;
        if focal_length != focal_length_before {
            println!("frame {}: focal length {focal_length:.1} px", update.frame);
            focal_length_before = focal_length;
        }
    }
    let tracked = started.elapsed().as_secs_f64();
    let when_last_came = front_end.path_so_far(None).trajectory();
    let stages = Arc::new(Mutex::new(StageTimes::default()));
    let listened = Arc::clone(&stages);
    let progress = Progress::new(CancellationToken::default(), move |stage, _, _| {
        if let Ok(mut stages) = listened.lock() {
            stages.enter(stage);
        }
    });
    let found = match flags.iter().position(|flag| flag == "--near") {
        Some(place) => {
            let known = read_trajectory(flags.get(place + 1).ok_or("--near needs a file")?)?;
            let at = |stamp: &f64| {
                let near = known.iter().find(|pose| (pose.timestamp - stamp).abs() < 0.01);
                near.map(|pose| pose.world_from_camera)
            };
            front_end.finish_near(&stamps.iter().map(at).collect::<Vec<_>>(), progress)?
        }
        None => front_end.finish(progress)?,
    };
    found.warnings.iter().for_each(|warning| println!("warning: {warning}"));
    println!(
        "{} of {} frames posed, {} keyframes; focal length {:.1} px, deviation {:?}; readout {:.1} ms",
        found.trajectory().len(),
        found.poses.len(),
        found.keyframes.len(),
        found.camera.fx,
        found.focal_deviation,
        1e3 * found.rolling_shutter_readout,
    );
    println!("depth sensor: {:?}", found.depth_model);
    println!("{tracked:.1} s for tracking, {:.1} s in all", started.elapsed().as_secs_f64());
    if let Ok(mut stages) = stages.lock() {
        println!("seconds from one report of progress to the next: {}", stages.end());
    }
    let hundreds = seconds.chunks_exact(100).map(|hundred| 10.0 * hundred.iter().sum::<f64>());
    let hundreds: Vec<String> = hundreds.map(|milliseconds| format!("{milliseconds:.1}")).collect();
    println!("milliseconds a frame in every hundred: {}", hundreds.join(" "));
    let mut slowest: Vec<(usize, f64)> = seconds.iter().copied().enumerate().collect();
    slowest.sort_by(|a, b| b.1.total_cmp(&a.1));
    let slowest: Vec<String> =
        slowest.iter().take(8).map(|(frame, s)| format!("{frame}: {:.0}", 1e3 * s)).collect();
    println!("slowest frames [ms]: {}", slowest.join(", "));
    write_trajectory(out, &found.trajectory())?;
    if let Some(place) = flags.iter().position(|flag| flag == "--online") {
        let online = flags.get(place + 1).ok_or("--online needs a file")?;
        write_trajectory(online, &found.online_trajectory())?;
    }
    let truth = sequence.true_trajectory()?;
    let mut unit = 1.0;
    let (online, path) = (found.online_trajectory(), found.trajectory());
    let alignments = [
        ("online, Se3", &online, Alignment::Se3),
        ("online, Sim3", &online, Alignment::Sim3),
        ("Se3", &path, Alignment::Se3),
        ("Sim3", &path, Alignment::Sim3),
    ];
    for (name, path, alignment) in alignments {
        let error = absolute_trajectory_error(path, &truth, alignment, DEFAULT_TOLERANCE);
        let Ok(TrajectoryError { ate_rmse_m, ate_max_m, pairs, scale, .. }) = error else {
            continue;
        };
        let [rmse, max] = [ate_rmse_m, ate_max_m].map(|v| 100.0 * v);
        unit = if uses_depth { 1.0 } else { scale };
        println!("{name}: {rmse:.3} cm, largest {max:.2}, {pairs} frames, scale {scale:.4}");
    }
    for (name, path) in [("when the last frame came", &when_last_came), ("in the end", &path)] {
        if let Some([distance, angle]) = seam(path, &truth) {
            println!("seam {name}: {:.3} cm, {:.2} mrad", 100.0 * distance, 1e3 * angle);
        }
    }
    print_deviations(&found, &truth, unit)
}

/// Seconds from each report of a stage to the next report.
#[derive(Default)]
struct StageTimes {
    present: Option<(Stage, Instant)>,
    seconds: BTreeMap<String, f64>,
}

impl StageTimes {
    fn enter(&mut self, stage: Stage) {
        self.leave();
        self.present = Some((stage, Instant::now()));
    }

    fn leave(&mut self) {
        if let Some((stage, since)) = self.present.take() {
            *self.seconds.entry(format!("{stage:?}")).or_default() += since.elapsed().as_secs_f64();
        }
    }

    fn end(&mut self) -> String {
        self.leave();
        let of = |(stage, seconds): (&String, &f64)| format!("{stage} {seconds:.1}");
        self.seconds.iter().map(of).collect::<Vec<_>>().join(", ")
    }
}

/// Error of the last pose as seen from the nearest true one of the first half of the path
/// [m, rad], after one scale.
fn seam(path: &[StampedPose], truth: &[StampedPose]) -> Option<[f64; 2]> {
    let error = absolute_trajectory_error(path, truth, Alignment::Sim3, DEFAULT_TOLERANCE).ok()?;
    let true_pose = |pose: &StampedPose| {
        let is_near = |t: &&StampedPose| (t.timestamp - pose.timestamp).abs() < DEFAULT_TOLERANCE;
        truth.iter().find(is_near).map(|t| (pose.world_from_camera, t.world_from_camera))
    };
    let (last, there) = true_pose(path.last()?)?;
    let far = |other: &Pose<f64>| {
        there.local(*other).translation.norm() + there.local(*other).rotation.norm()
    };
    let (first, from) = path[..path.len() / 2]
        .iter()
        .filter_map(true_pose)
        .min_by(|a, b| far(&a.1).total_cmp(&far(&b.1)))?;
    let (found, true_step) = (first.inverse() * last, from.inverse() * there);
    let off = (found.translation * error.scale - true_step.translation).norm();
    Some([off, found.local(true_step).rotation.norm()])
}

/// Errors over claimed deviations.
fn print_deviations(
    found: &Reconstruction,
    truth: &[StampedPose],
    unit: f64,
) -> Result<(), Box<dyn Error>> {
    let claimed = |frame: usize| {
        let (pose, deviation) = (found.poses[frame]?, found.deviations[frame]?);
        let pose = StampedPose { timestamp: found.timestamps[frame], world_from_camera: pose };
        Some(ClaimedPose { pose, deviation: [deviation.position, deviation.rotation] })
    };
    let all: Vec<ClaimedPose> = (0..found.poses.len()).filter_map(claimed).collect();
    let converged = found.deviations.iter().flatten().filter(|d| d.converged).count();
    let DeviationRatios { errors, ratios, truth, offset } =
        deviation_ratios(&all, truth, unit, (NEIGHBOUR_WINDOW, MIN_NEIGHBOURS))?;
    println!(
        "against neighbours: error {:.3} mm {:.3} mrad, over deviation {:.2} {:.2} (0.89 is due), truth's own {:.2} mm {:.2} mrad, {:.0} ms late; {converged} converged",
        1e3 * errors[0],
        1e3 * errors[1],
        ratios[0],
        ratios[1],
        1e3 * truth[0],
        1e3 * truth[1],
        1e3 * offset,
    );
    Ok(())
}

/// The number behind a flag.
fn number(flags: &[String], name: &str) -> Result<Option<f64>, Box<dyn Error>> {
    let value = flags.iter().position(|flag| flag == name).and_then(|i| flags.get(i + 1));
    Ok(value.map(|v| v.parse()).transpose()?)
}
