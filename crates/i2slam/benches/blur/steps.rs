//! Time of a step with blur over that of a step without: formation, loss and derivatives by map,
//! poses, exposure, white balance and response.

use super::Outcome;
use super::fitted::Fitted;
use i2slam::formation::{ShutterPoses, ShutterTangent};
use i2slam::objective::{BlurMethod, Exposure, FrameVariables, Observation, Sampling, Tone};
use i2slam::radiance::gaussian::MapGradient;
use i2slam_check::processor_seconds;
use std::time::Instant;

/// Streaks [px], and views where more than one is rendered.
const LENGTH: f64 = 10.0;
const VIEWS: usize = 5;
const ROUNDS: usize = 60;

/// The fastest and the mean of the processor's time of many rounds, methods in turn, so that a busy
/// machine slows down all of them.
pub(crate) fn print() -> Outcome {
    let mut fitted = Fitted::demo()?;
    let frame = fitted.scene.frames[15].clone();
    let depth = fitted.depth(frame.middle());
    let direction = [0.6, 0.0, 0.3, 0.25, -0.1, 0.15];
    let blurred = fitted.exposure(frame.middle(), &depth, direction, LENGTH);
    let source = &fitted.frames[15];
    let observation = Observation::new(source.colour.clone(), source.depth.clone());
    let with = |method| Sampling { virtual_cameras: VIEWS, ..fitted.sampling(LENGTH, method) };
    let image = with(BlurMethod::Reprojected);
    let cases = [
        ("sharp", ShutterPoses::still(frame.middle()), Sampling::SINGLE_CAMERA),
        ("image", blurred, image),
        ("image with 7 views", blurred, Sampling { virtual_cameras: 7, ..image }),
        ("image without a margin", blurred, Sampling { margin: 0, ..image }),
        ("exact", blurred, with(BlurMethod::Exact)),
    ];
    let curve = fitted.scene.responses[frame.response].curve();
    let mut gradient = MapGradient::new(fitted.map.len());
    let (mut best, mut busy) = ([f64::MAX; 5], [0.0; 5]);
    for _ in 0..ROUNDS {
        for (k, (_, shutter, sampling)) in cases.iter().enumerate() {
            let exposure =
                Exposure { shutter: *shutter, sampling: *sampling, readout: 0.0, depth_pose: None };
            let tone = Some(Tone { frame: frame.tone, curve: &curve });
            let (clock, before) = (Instant::now(), processor_seconds());
            let (map, variables) = (&fitted.map, FrameVariables { exposure, tone });
            let evaluation =
                fitted.objective.map(map, &observation, &variables, 0.2, (0.5, 1.0), &mut gradient);
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
