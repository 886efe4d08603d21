//! Allocations per step once all buffers have their size.

use super::Outcome;
use super::counting::counted;
use super::presets::Clip;
use i2slam::formation::ShutterPoses;
use i2slam::geometry::Tangent;
use i2slam::objective::{
    BlurMethod, Exposure, FrameObjective, FrameVariables, Observation, Sampling, Tone,
};
use i2slam::radiance::gaussian::{MapGradient, RasterSettings};
use i2slam::{Config, Map, Session};

const STEPS: usize = 20;

/// Runs `work` some times and then counts what `STEPS` more of it allocate, per step.
fn per_step(mut work: impl FnMut()) -> (f64, f64) {
    (0..3).for_each(|_| work());
    let before = counted();
    (0..STEPS).for_each(|_| work());
    let after = counted();
    let each = |now: usize, then: usize| (now - then) as f64 / STEPS as f64;
    (each(after.0, before.0), each(after.1, before.1))
}

/// Allocations per mapping and per tracking step of the objective, by method.
pub(crate) fn print() -> Outcome {
    let clip = Clip::demo(6, 1.0)?;
    let mut session = Session::new(Config::default(), clip.camera, clip.frame_rate);
    for frame in &clip.frames {
        session.process(frame)?;
    }
    let scene = session.reconstruction();
    let Map::Gaussians(map) = &scene.map else { return Err("no Gaussians".into()) };
    let (frame, source) = (&scene.frames[5], &clip.frames[5]);
    let observation = Observation::new(source.colour.clone(), source.depth.clone());
    let mut objective = FrameObjective::new(scene.camera.cast(), RasterSettings::default());
    let half = Tangent::from_array([0.004, 0.0, 0.002, 0.002, 0.008, 0.001]);
    let middle = frame.middle();
    let shutter =
        ShutterPoses { start: middle.retract(half.scaled(-1.0)), end: middle.retract(half) };
    let curve = scene.responses[frame.response].curve();
    let mut gradient = MapGradient::new(map.len());
    println!("step,allocations,bytes");
    let methods = [
        ("sharp", BlurMethod::Exact, 1),
        ("image", BlurMethod::Reprojected, 5),
        ("exact", BlurMethod::Exact, 5),
    ];
    for (name, method, virtual_cameras) in methods {
        let formation = &scene.config.formation;
        let sampling = Sampling { virtual_cameras, method, ..Sampling::new(formation, 5.0, 0.0) };
        let exposure = Exposure { shutter, sampling, readout: 0.0, depth_pose: None };
        let tone = Some(Tone { frame: frame.tone, curve: &curve });
        let variables = FrameVariables { exposure, tone };
        let (calls, bytes) = per_step(|| {
            objective.map(map, &observation, &variables, 0.2, (0.5, 1.0), &mut gradient);
        });
        println!("mapping {name},{calls:.1},{bytes:.0}");
        let (calls, bytes) = per_step(|| {
            objective.track(map, &observation, &variables, 0.99, (0.5, 1.0));
        });
        println!("tracking {name},{calls:.1},{bytes:.0}");
    }
    Ok(())
}
