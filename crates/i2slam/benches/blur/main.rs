//! Accuracy and cost of the methods of motion blur.
//!
//! ```sh
//! cargo bench -p i2slam --bench blur             # all tables
//! cargo bench -p i2slam --bench blur -- quality  # one of: quality, steps
//! ```
//!
//! Tables are lines of comma-separated values under a line `# name`; `docs/performance.py` writes
//! them into `docs/performance.md`.

mod fitted;
#[path = "../support/tables.rs"]
mod tables;

use fitted::{Fitted, psnr};
use i2slam::formation::{Formation, ShutterPoses, ShutterTangent};
use i2slam::objective::{
    BlurMethod, Exposure, FrameVariables, ImageLoss, Observation, PixelLoss, Sampling,
};
use i2slam::radiance::gaussian::MapGradient;
use i2slam_check::processor_seconds;
use std::time::Instant;
use tables::{Outcome, Table};

const TABLES: [Table; 2] = [("quality", print_quality), ("steps", print_steps)];

fn main() -> Outcome {
    tables::print(&TABLES)
}

/// That of the default preset.
const LOSS: ImageLoss = ImageLoss { pixel: PixelLoss::PseudoHuber, ssim_share: 0.2, weight: 0.5 };

const LENGTHS: [f64; 11] = [0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 40.0];

/// Directions of motion, tangents (ρ, φ) of any length.
const MOTIONS: [(&str, [f64; 6]); 3] = [
    ("rotation", [0.0, 0.0, 0.0, 0.6, 0.8, 0.5]),
    ("translation", [0.8, -0.6, 0.2, 0.0, 0.0, 0.0]),
    ("both", [0.6, 0.0, 0.3, 0.25, -0.1, 0.15]),
];

/// Views of the exact exposure.
const EXACT_VIEWS: usize = 32;

/// Frames at whose poses the exposures are centred.
const FRAME_INDICES: [usize; 3] = [6, 15, 24];

/// Each method against an exact exposure of 32 views, on a map of the demo clip: mean PSNR [dB] over
/// the frames, and the least for the method `image`.
fn print_quality() -> Outcome {
    let mut fitted = Fitted::demo()?;
    println!("motion,blur_px,views,margin_px,sharp,exact,image,image_least,image_without_margin");
    for (name, direction) in MOTIONS {
        for length in LENGTHS {
            let sampling = fitted.sampling(length, BlurMethod::Reprojected);
            let mut sums = [0.0; 4];
            let mut least = f64::MAX;
            for index in FRAME_INDICES {
                let values = compare_with_exact(&mut fitted, index, direction, length);
                (0..4).for_each(|k| sums[k] += values[k] / FRAME_INDICES.len() as f64);
                least = least.min(values[2]);
            }
            let [sharp, exact, image, without] = sums;
            println!(
                "{name},{length},{},{},{sharp:.1},{exact:.1},{image:.1},{least:.1},\
                 {without:.1}",
                sampling.virtual_cameras, sampling.margin
            );
        }
    }
    Ok(())
}

/// Sharp, exact, image and image without a margin, against the exact exposure.
fn compare_with_exact(
    fitted: &mut Fitted,
    index: usize,
    direction: [f64; 6],
    length: f64,
) -> [f64; 4] {
    let frame = fitted.scene.frames[index].clone();
    let depth = fitted.depth(frame.middle());
    let shutter = fitted.exposure(frame.middle(), &depth, direction, length);
    let sampling = |method| fitted.sampling(length, method);
    let image = sampling(BlurMethod::Reprojected);
    let methods = [
        Sampling::SINGLE_CAMERA,
        sampling(BlurMethod::Exact),
        image,
        Sampling { margin: 0, ..image },
    ];
    let exact = Sampling { virtual_cameras: EXACT_VIEWS, ..sampling(BlurMethod::Exact) };
    let reference = fitted.predict(&frame, shutter, exact);
    methods.map(|sampling| psnr(&fitted.predict(&frame, shutter, sampling), &reference))
}

/// Blur length of the timed steps [px], and virtual cameras of the methods with several.
const STEP_BLUR: f64 = 10.0;
const STEP_VIEWS: usize = 5;
const ROUNDS: usize = 60;

/// Time of a mapping step with blur (formation, loss and all derivatives) relative to one without:
/// fastest and mean processor time. Methods take turns, so that a busy machine slows all of them.
fn print_steps() -> Outcome {
    let mut fitted = Fitted::demo()?;
    let frame = fitted.scene.frames[15].clone();
    let depth = fitted.depth(frame.middle());
    let direction = [0.6, 0.0, 0.3, 0.25, -0.1, 0.15];
    let blurred = fitted.exposure(frame.middle(), &depth, direction, STEP_BLUR);
    let source = &fitted.frames[15];
    let depth = source.depth_image().ok_or("a frame without depth")?.clone();
    let observation = Observation::new(source.colour.clone(), depth);
    let with =
        |method| Sampling { virtual_cameras: STEP_VIEWS, ..fitted.sampling(STEP_BLUR, method) };
    let image = with(BlurMethod::Reprojected);
    let cases = [
        ("sharp", ShutterPoses::still(frame.middle()), Sampling::SINGLE_CAMERA),
        ("image", blurred, image),
        ("image with 7 views", blurred, Sampling { virtual_cameras: 7, ..image }),
        ("image without a margin", blurred, Sampling { margin: 0, ..image }),
        ("exact", blurred, with(BlurMethod::Exact)),
    ];
    let curve = fitted.scene.responses[frame.response].curve();
    let mut gradient = MapGradient::new(&fitted.map);
    let (mut best, mut busy) = ([f64::MAX; 5], [0.0; 5]);
    for _ in 0..ROUNDS {
        for (k, (_, shutter, sampling)) in cases.iter().enumerate() {
            let exposure =
                Exposure { shutter: *shutter, sampling: *sampling, readout: 0.0, depth_pose: None };
            let tone = Some(Formation { tone: frame.tone, curve: &curve, vignetting: None });
            let (clock, before) = (Instant::now(), processor_seconds());
            let (map, variables) = (&fitted.map, FrameVariables { exposure, tone });
            let evaluation =
                fitted.objective.map(map, &observation, &variables, (LOSS, 1.0), &mut gradient);
            let seconds = clock.elapsed().as_secs_f64();
            assert!(k == 0 || evaluation.shutter != ShutterTangent::zero(), "no gradient");
            best[k] = best[k].min(seconds);
            busy[k] += processor_seconds() - before;
        }
    }
    println!("method,ms,sharp_steps,processor_ms,processor_sharp_steps");
    for (k, (name, ..)) in cases.iter().enumerate() {
        let processor = busy[k] / ROUNDS as f64;
        println!(
            "{name},{:.2},{:.2},{:.2},{:.2}",
            best[k] * 1e3,
            best[k] / best[0],
            processor * 1e3,
            busy[k] / busy[0]
        );
        println!("time,steps/{name},{:.6e}", best[k]);
    }
    Ok(())
}
