//! What a step with blur costs, in steps without: formation, loss and the way back to map, poses,
//! exposure, white balance and response.

use super::Outcome;
use super::fitted::Fitted;
use i2slam::formation::{ShutterPoses, ShutterTangent};
use i2slam::objective::{BlurRoute, Exposure, FrameVariables, Observation, Sampling, Tone};
use i2slam::radiance::gaussian::MapGradient;
use std::time::Instant;

/// Streaks [px], and views where more than one is rendered.
const LENGTH: f64 = 10.0;
const VIEWS: usize = 5;
const ROUNDS: usize = 60;

/// The fastest of many rounds, routes in turn, so that a busy machine slows down all of them.
pub(crate) fn print() -> Outcome {
    let mut fitted = Fitted::demo()?;
    let frame = fitted.scene.frames[15].clone();
    let depth = fitted.depth(frame.middle());
    let direction = [0.6, 0.0, 0.3, 0.25, -0.1, 0.15];
    let blurred = fitted.exposure(frame.middle(), &depth, direction, LENGTH);
    let source = &fitted.frames[15];
    let observation = Observation::new(source.colour.clone(), source.depth.clone());
    let with = |route| Sampling { virtual_cameras: VIEWS, ..fitted.sampling(LENGTH, route) };
    let image = with(BlurRoute::Image);
    let cases = [
        ("sharp", ShutterPoses::still(frame.middle()), Sampling::SHARP),
        ("image", blurred, image),
        ("image without a margin", blurred, Sampling { margin: 0, ..image }),
        ("splat", blurred, with(BlurRoute::Splat)),
        ("exact", blurred, with(BlurRoute::Exact)),
    ];
    let curve = fitted.scene.responses[frame.response].curve();
    let mut gradient = MapGradient::new(fitted.scene.map.len());
    let (mut best, mut ratios) = ([f64::MAX; 5], [f64::MAX; 5]);
    for _ in 0..ROUNDS {
        let mut sharp = f64::MAX;
        for (k, (_, shutter, sampling)) in cases.iter().enumerate() {
            let exposure = Exposure { shutter: *shutter, sampling: *sampling, depth_pose: None };
            let tone = Some(Tone { frame: frame.tone, curve: &curve });
            let clock = Instant::now();
            let (map, variables) = (&fitted.scene.map, FrameVariables { exposure, tone });
            let evaluation =
                fitted.objective.map(map, &observation, &variables, 0.2, (0.5, 1.0), &mut gradient);
            let seconds = clock.elapsed().as_secs_f64();
            assert!(k == 0 || evaluation.shutter != ShutterTangent::zero(), "no gradient");
            best[k] = best[k].min(seconds);
            sharp = if k == 0 { seconds } else { sharp };
            ratios[k] = ratios[k].min(seconds / sharp);
        }
    }
    println!("route,ms,sharp_steps,least_ratio_of_a_round");
    for (k, (name, ..)) in cases.iter().enumerate() {
        println!("{name},{:.2},{:.2},{:.2}", best[k] * 1e3, best[k] / best[0], ratios[k]);
        println!("time,steps/{name},{:.6e}", best[k]);
    }
    Ok(())
}
