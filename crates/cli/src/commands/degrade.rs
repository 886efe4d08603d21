//! `i2slam degrade`: a sequence made worse in known ways.

use super::synth::interrupted;
use crate::arguments::{Machine, frame_range};
use crate::console::{counted, print};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use clap::{Args, ValueEnum};
use i2slam_synthetic::{
    Degradation, DegradationCounts, DepthDegradation, ExposureStep, KinectNoise, NoiseSpec,
    Response, degrade as write_degraded,
};
use std::ops::Range;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Degrade {
    /// Folder of the sequence
    pub(crate) dataset: PathBuf,
    /// Folder for the degraded sequence
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Replace what was written into the folder before; other files in it stay
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Size of the written pictures over that of the recorded ones; lengths in pixels are those of
    /// the written pictures
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    pub(crate) scale: f64,
    /// Noise, steps and holes of a first-generation Kinect on depth; with =3 three times the noise
    #[arg(long, value_name = "FACTOR", num_args = 0..=1, require_equals = true, default_missing_value = "1")]
    pub(crate) depth_noise: Option<f64>,
    /// Depth that is not registered to colour: shifted to the right and down [px]
    #[arg(long, value_names = ["RIGHT", "DOWN"], num_args = 2, allow_negative_numbers = true)]
    pub(crate) depth_shift: Option<Vec<i32>>,
    /// Stamps of depth are so much later than the moments that it shows [ms], negative: earlier
    #[arg(long, value_name = "MS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(crate) depth_delay: f64,
    /// Factor on all depth
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub(crate) depth_factor: f64,
    /// Smooth depth by a Gaussian of this deviation, over holes and edges alike, as the depth maps of
    /// telephones are [px]
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0)]
    pub(crate) depth_smoothing: f64,
    /// One reading for every block of N x N pixels; 2 is half resolution
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) depth_block: usize,
    /// Replace this share of the depth readings by ones that are off by a factor of 1.1 to 2
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub(crate) depth_outliers: f64,
    /// Vignetting: share of the light that reaches the corners of a picture, 0.2 to 1; the truth is
    /// written to vignetting.json
    #[arg(long, value_name = "CORNER")]
    pub(crate) vignetting: Option<f64>,
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
    /// One grey instead of the picture in frames A to B-1, depth as it is; may repeat
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) grey: Vec<Range<usize>>,
    /// Repeat colour and depth of the frame before in frames A to B-1; may repeat
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) freeze: Vec<Range<usize>>,
    /// Put the pictures of frames A to B-1 into a random order, while time stamps rise; may repeat
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) shuffle: Vec<Range<usize>>,
    /// A textured ball moves before the camera, in colour and depth, over this share of the picture
    #[arg(long, value_name = "SHARE")]
    pub(crate) moving_object: Option<f64>,
    /// Response that the pictures are taken to have, for vignetting, noise and exposure
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
    print(&format!("{} in {}{}", counted(done.frames, "frame"), out.display(), counts(&done)));
    Ok(())
}

/// `, 2 left out, 1 covered`, and what else was done to frames.
fn counts(done: &DegradationCounts) -> String {
    let always = format!(", {} left out, {} covered", done.dropped, done.covered);
    let others = [(done.grey, "grey"), (done.displaced, "with the picture of another moment")];
    let others = others.into_iter().filter(|(count, _)| *count > 0);
    others.fold(always, |text, (count, what)| format!("{text}, {count} {what}"))
}

fn degradation(arguments: &Degrade) -> Degradation {
    let noise = arguments.sensor_noise.as_deref();
    let shift = arguments.depth_shift.as_deref();
    Degradation {
        seed: arguments.seed,
        scale: arguments.scale,
        depth: DepthDegradation {
            delay: arguments.depth_delay * 1e-3,
            noise: arguments.depth_noise.map(KinectNoise::times),
            block: arguments.depth_block,
            smoothing: arguments.depth_smoothing,
            factor: arguments.depth_factor,
            shift: shift.and_then(|s| Some([*s.first()?, *s.get(1)?])).unwrap_or_default(),
            outliers: arguments.depth_outliers,
        },
        vignetting: arguments.vignetting,
        sensor_noise: noise.and_then(|n| Some(NoiseSpec { read: *n.first()?, shot: *n.get(1)? })),
        exposure_steps: arguments.exposure_step.clone(),
        drop_share: arguments.drop,
        dropped: arguments.drop_frames.clone(),
        covered: arguments.cover.clone(),
        grey: arguments.grey.clone(),
        frozen: arguments.freeze.clone(),
        shuffled: arguments.shuffle.clone(),
        moving_object: arguments.moving_object,
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
    use clap::Parser;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        degrade: Degrade,
    }

    fn typed(text: &str) -> Degradation {
        let words = format!("degrade room --out bad {text}");
        degradation(&Typed::try_parse_from(words.split_whitespace()).expect("arguments").degrade)
    }

    #[test]
    fn arguments_say_how_frames_and_depth_are_made_worse() {
        assert_eq!(typed(""), Degradation::default());
        let depth =
            typed("--depth-noise --depth-shift -8 2 --depth-delay -20 --depth-factor 1.03").depth;
        assert_eq!((depth.noise, depth.shift), (Some(KinectNoise::default()), [-8, 2]));
        assert!((depth.delay + 0.02).abs() < 1e-12 && (depth.factor - 1.03).abs() < 1e-12);
        let three = typed("--depth-noise=3 --depth-block 2 --depth-smoothing 2.5").depth;
        assert_eq!((three.noise, three.block), (Some(KinectNoise::times(3.0)), 2));
        let frames = typed("--grey 1..3 --freeze 4..6 --shuffle 7..9 --moving-object 0.2");
        assert_eq!(
            (&frames.grey[0], &frames.frozen[0], &frames.shuffled[0]),
            (&(1..3), &(4..6), &(7..9))
        );
        assert_eq!(frames.moving_object, Some(0.2));
    }

    #[test]
    fn counts_name_what_there_is() {
        let done = DegradationCounts { dropped: 2, displaced: 3, ..DegradationCounts::default() };
        assert_eq!(counts(&done), ", 2 left out, 0 covered, 3 with the picture of another moment");
    }

    #[test]
    fn exposure_steps_name_a_frame_and_stops() {
        assert_eq!(exposure_step("40:-1.5"), Ok(ExposureStep { frame: 40, stops: -1.5 }));
        for wrong in ["40", "40:", ":1", "-1:2", "4:nan"] {
            assert!(exposure_step(wrong).is_err(), "{wrong}");
        }
    }
}
