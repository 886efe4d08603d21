//! `i2slam degrade`: a sequence made worse in known ways.

use super::synth::interrupted;
use crate::arguments::{Machine, frame_range};
use crate::console::{counted, print};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use clap::{Args, ValueEnum};
use i2slam_synthetic::{
    Degradation, ExposureStep, KinectNoise, NoiseSpec, Response, degrade as write_degraded,
};
use std::ops::Range;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Degrade {
    /// Folder of the sequence
    pub(crate) dataset: PathBuf,
    /// Folder for the degraded sequence
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Replace what was written into the folder before; other files in it stay
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Noise, steps and holes of a first-generation Kinect on depth
    #[arg(long)]
    pub(crate) depth_noise: bool,
    /// Noise of the colour sensor: standard deviation of black, variance of white (1.0)
    #[arg(long, value_names = ["READ", "SHOT"], num_args = 2)]
    pub(crate) sensor_noise: Option<Vec<f64>>,
    /// Change exposure from a frame on, by stops against the recording, as in 40:-1.5; may repeat
    #[arg(long, value_name = "FRAME:STOPS", value_parser = exposure_step)]
    pub(crate) exposure_step: Vec<ExposureStep>,
    /// Leave out this share of the frames by chance
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub(crate) drop: f64,
    /// Leave out frames A to B-1; may repeat
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) drop_frames: Vec<Range<usize>>,
    /// Cover the lens in frames A to B-1: almost black, no depth; may repeat
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) cover: Vec<Range<usize>>,
    /// Response that the pictures are taken to have, for noise and exposure
    #[arg(long, value_enum, default_value_t = Curve::Srgb, value_name = "CURVE")]
    pub(crate) response: Curve,
    /// Seed of all random choices
    #[arg(long, value_name = "N", default_value_t = 7)]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// Camera responses.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Curve {
    /// The sRGB encoding
    Srgb,
    /// (x / (1 + x))^(1/2.2)
    Reinhard,
    /// Toe, shoulder, channels that differ
    Measured,
}

pub(crate) fn degrade(arguments: &Degrade) -> Result<(), Failure> {
    arguments.machine.use_threads()?;
    let (out, what) = (&arguments.out, degradation(arguments));
    interrupt::listen();
    let progress = Progress::new(0, arguments.machine.quiet);
    let step = &mut |done: usize, total: usize| {
        progress.step("frames", done, total);
        !interrupt::requested()
    };
    let done = write_degraded(&arguments.dataset, out, arguments.overwrite, &what, step);
    progress.clear();
    let done = done.map_err(|error| interrupted(error, out))?;
    print(&format!(
        "{} in {}, {} left out, {} covered",
        counted(done.frames, "frame"),
        out.display(),
        done.dropped,
        done.covered
    ));
    Ok(())
}

fn degradation(arguments: &Degrade) -> Degradation {
    let noise = arguments.sensor_noise.as_deref();
    Degradation {
        seed: arguments.seed,
        depth_noise: arguments.depth_noise.then(KinectNoise::default),
        sensor_noise: noise.and_then(|n| Some(NoiseSpec { read: *n.first()?, shot: *n.get(1)? })),
        exposure_steps: arguments.exposure_step.clone(),
        drop_share: arguments.drop,
        dropped: arguments.drop_frames.clone(),
        covered: arguments.cover.clone(),
        response: match arguments.response {
            Curve::Srgb => Response::Srgb,
            Curve::Reinhard => Response::Reinhard,
            Curve::Measured => Response::Measured,
        },
    }
}

fn exposure_step(text: &str) -> Result<ExposureStep, String> {
    let parts = text.split_once(':').and_then(|(frame, stops)| {
        let stops: f64 = stops.trim().parse().ok()?;
        Some(ExposureStep { frame: frame.trim().parse().ok()?, stops })
    });
    let finite = parts.filter(|step| step.stops.is_finite());
    finite.ok_or_else(|| "expected a frame number and stops as in 40:-1.5".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_steps_name_a_frame_and_stops() {
        assert_eq!(exposure_step("40:-1.5"), Ok(ExposureStep { frame: 40, stops: -1.5 }));
        for wrong in ["40", "40:", ":1", "-1:2", "4:nan"] {
            assert!(exposure_step(wrong).is_err(), "{wrong}");
        }
    }
}
