//! What can be typed.

use crate::commands;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::ops::Range;
use std::path::PathBuf;

/// SLAM that inverts image formation: a blurred, exposure-drifting video goes in, with depth or
/// without, and a sharp HDR map and a camera path come out.
#[derive(Parser, Debug)]
#[command(name = "i2slam", version, max_term_width = 100)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Subcommand, Debug)]
pub(crate) enum Command {
    /// Reconstruct a sequence
    Run(Box<Run>),
    /// Draw pictures of a result: sharp, blurred as observed, HDR, depth
    Render(Render),
    /// Measure a result against the truth
    Eval(Eval),
    /// Reconstruct the clip that comes with the program (2 s, hand-held, blurred)
    Demo(Demo),
    /// List the presets, or print every value of one
    Presets(Presets),
    /// Render a test sequence with known truth: a furnished room, blur, exposure changes
    Synth(commands::SynthArguments),
    /// Put noise, exposure steps, gaps or a covered lens on a sequence
    Degrade(commands::DegradeArguments),
    /// Run sequences x configurations x seeds, and put the figures into tables
    Bench(commands::BenchArguments),
    /// Tell what is known of a sequence before it is run: layout, times, camera, depth, exposure
    Info(commands::InfoArguments),
}

#[derive(Args, Clone, Debug)]
pub(crate) struct Run {
    /// Sequence: a folder in one of the known layouts (docs/datasets.md), a .sens file, a video
    /// (colour alone; ffmpeg decodes it), or a stream: an address such as rtsp://HOST/PATH, a named
    /// pipe, - for the standard input
    pub(crate) dataset: PathBuf,
    /// Folder for the results
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Settings to start from, see `i2slam presets` [default: default]
    #[arg(long, value_name = "NAME")]
    pub(crate) preset: Option<String>,
    /// TOML file whose values replace those of the preset
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) input: Input,
    /// Colour alone, as always for a video: the path is found from the pictures, or comes with
    /// --keyframes, and poses, tone and map are refined together [default preset: default-rgb]
    #[arg(long)]
    pub(crate) rgb: bool,
    /// With --rgb, lens distortion: that of the camera file, if there is one, or estimated from the
    /// pictures (k1, k2) together with the focal length, where nothing gives the camera
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Distortion::Given)]
    pub(crate) distortion: Distortion,
    /// With --rgb, keyframes and poses that another program found (docs/import.md)
    #[arg(long, value_name = "PATH", requires = "rgb")]
    pub(crate) keyframes: Option<PathBuf>,
    /// Which depth the keyframes get
    #[arg(long, value_enum, default_value_t = KeyframeDepth::Imported, requires = "keyframes")]
    pub(crate) keyframe_depth: KeyframeDepth,
    /// Folder with the variance of depth pictures (.npy [m²], or 16-bit PNG of the deviation)
    #[arg(long, value_name = "DIR", requires = "keyframes")]
    pub(crate) depth_variance: Option<PathBuf>,
    /// What the map consists of [default: that of --preset or --config; without these gaussian, or
    /// hashgrid with --keyframes]
    #[arg(long, value_enum, value_name = "KIND")]
    pub(crate) map: Option<Map>,
    #[command(flatten)]
    pub(crate) formation: Formation,
    /// Hold out every N-th frame: tracked, but never mapped, for `eval --protocol held-out`
    #[arg(long, value_name = "N")]
    pub(crate) hold_out: Option<usize>,
    /// Which frames to draw under renders/ [default: all; none of a video on a hash grid, which is
    /// slow to draw: `i2slam render` does it later]
    #[arg(long, value_enum, value_name = "WHICH")]
    pub(crate) render: Option<Draw>,
    /// Replace the earlier result in the folder; other files in it stay
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Seed of all random choices; the same seed gives the same bytes
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// How the sequence is read.
#[derive(Args, Clone, Debug)]
pub(crate) struct Input {
    /// Only frames A to B-1 of the associated stream
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) frames: Option<Range<usize>>,
    /// Every N-th frame
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) stride: usize,
    /// Size of the processed pictures over that of the recorded ones [default: 1, but see
    /// --max-side]
    #[arg(long, value_name = "S")]
    pub(crate) scale: Option<f64>,
    /// Longer side of the processed pictures at most [px] [default: 640 for videos and colour
    /// alone, unless --scale is given]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..))]
    pub(crate) max_side: Option<u32>,
    /// Camera file to use instead of the folder's camera.json
    #[arg(long, value_name = "FILE.json")]
    pub(crate) camera: Option<PathBuf>,
    /// Camera: a file (camera.json, transforms.json, COLMAP's cameras.txt, a line `fx fy cx cy`),
    /// or four numbers FX FY CX CY without distortion [px], pixel centres at integers
    #[arg(
        long,
        value_name = "FILE or NUMBERS",
        num_args = 1..=4,
        allow_negative_numbers = true,
        conflicts_with_all = ["camera", "fov"]
    )]
    pub(crate) intrinsics: Option<Vec<String>>,
    /// Camera: horizontal field of view, without distortion. For colour alone it is looked for in
    /// the pictures where nothing is given
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, conflicts_with = "camera")]
    pub(crate) fov: Option<f64>,
    /// Value of one metre in the depth images
    #[arg(long, value_name = "N")]
    pub(crate) depth_scale: Option<f64>,
}

/// Switches of the image-formation module.
#[derive(Args, Clone, Debug)]
pub(crate) struct Formation {
    /// Virtual cameras over the exposure
    #[arg(long, value_name = "N")]
    pub(crate) virtual_cameras: Option<usize>,
    /// Take pictures as sharp
    #[arg(long)]
    pub(crate) no_blur: bool,
    /// Take pictures as they are: no exposure, white balance or camera response
    #[arg(long)]
    pub(crate) no_tone: bool,
    /// Do not tie the motion during an exposure to the motion between frames
    #[arg(long)]
    pub(crate) no_trajectory_loss: bool,
}

#[derive(Args, Clone, Debug)]
pub(crate) struct Machine {
    /// Threads to use [default: all cores]; results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) threads: Option<u16>,
    /// Print warnings and the summary only
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// What a map consists of.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Map {
    /// 3D Gaussians
    Gaussian,
    /// A radiance field in a multi-resolution hash grid
    Hashgrid,
}

/// Lens distortion.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Distortion {
    /// That of the camera file; none where the camera is unknown
    Given,
    /// Found in the pictures, and removed from them
    Estimate,
}

/// Depth of keyframes.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum KeyframeDepth {
    None,
    /// That of the imported files, if they have any
    Imported,
    /// That of the dataset's depth pictures
    Pictures,
}

/// Which frames are drawn.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Draw {
    All,
    Keyframes,
    None,
}

#[derive(Args, Debug)]
pub(crate) struct Render {
    /// Result folder of a run
    pub(crate) result: PathBuf,
    /// Only frames A to B-1 of the associated stream
    #[arg(long, value_name = "A..B", value_parser = frame_range, conflicts_with_all = ["pose", "poses"])]
    pub(crate) frames: Option<Range<usize>>,
    /// A pose of your own, world from camera
    #[arg(
        long,
        value_name = "\"tx ty tz qx qy qz qw\"",
        allow_hyphen_values = true,
        conflicts_with = "poses"
    )]
    pub(crate) pose: Option<String>,
    /// Poses of your own, a file in the TUM format
    #[arg(long, value_name = "FILE")]
    pub(crate) poses: Option<PathBuf>,
    /// What to draw: sharp, blurred, hdr, depth [default: all that apply]
    #[arg(long, value_name = "KINDS", value_delimiter = ',')]
    pub(crate) kinds: Option<Vec<String>>,
    /// Folder for the pictures, with their poses [default: renders/ of the result, views/ for poses
    /// of your own, numbered after those that are there]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Replace what was drawn into that folder before; other files in it stay
    #[arg(long, requires = "out")]
    pub(crate) overwrite: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Eval {
    /// Result folder of a run, a trajectory in the TUM format, or a folder of pictures
    pub(crate) estimate: PathBuf,
    /// True trajectory in the TUM format [default: that of the dataset]
    #[arg(long, value_name = "FILE")]
    pub(crate) groundtruth: Option<PathBuf>,
    /// True pictures: a folder of NNNNNN.png (or .exr) named as the renders, or the dataset of the
    /// run (its sharp/ if there is one, else the pictures taken) [default: the dataset that the
    /// result names]
    #[arg(long, value_name = "DIR")]
    pub(crate) reference: Option<PathBuf>,
    /// Which frames are judged, and by which numbers
    #[arg(long, value_enum, default_value_t = Protocol::AllFrames, value_name = "NAME")]
    pub(crate) protocol: Protocol,
    /// Judge these frames only: a file with one frame number a line, a published list (names:
    /// --list help), or `auto` for the sharp frames of the dataset
    #[arg(long, value_name = "LIST")]
    pub(crate) list: Option<String>,
    /// Write the list of the sharp frames of ESTIMATE, a dataset or a folder of pictures
    #[arg(long, value_name = "FILE", conflicts_with_all = ["reference", "groundtruth", "list"])]
    pub(crate) write_list: Option<PathBuf>,
    /// Replace an earlier list of that name
    #[arg(long, requires = "write_list")]
    pub(crate) overwrite: bool,
    /// With --protocol splatam, the first and every N-th frame
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) every: u32,
    /// Move every judged frame to where the map fits its true picture best, and judge what is seen
    /// from there: leaves pose errors out. Needs the map of the result
    #[arg(long)]
    pub(crate) optimise_poses: bool,
    /// Judge the renders that are there, though others are missing
    #[arg(long)]
    pub(crate) partial: bool,
    /// What may be fitted before errors are measured: se3, but sim3 where the trajectory says that
    /// its unit of length is unknown
    #[arg(long, value_enum, value_name = "GROUP")]
    pub(crate) align: Option<Fit>,
    /// Step of the relative pose error: frames (`1`, `30`) or seconds (`0.5s`)
    #[arg(long, value_name = "STEP", default_value = "1", value_parser = relative_step)]
    pub(crate) rpe: RelativeStep,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Published ways to judge a run.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// Every frame that has a true picture
    AllFrames,
    /// I2-SLAM: listed sharp frames, poses at mid-exposure
    I2slam,
    /// SplaTAM: the first and every N-th frame, pixels with true depth
    Splatam,
    /// MonoGS: every fifth frame that is no keyframe; trajectory error of keyframes
    Monogs,
    /// Frames that the map never saw (`i2slam run --hold-out N`)
    HeldOut,
}

/// Step of the relative pose error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum RelativeStep {
    Frames(usize),
    Seconds(f64),
}

/// Alignment of two trajectories.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fit {
    /// Rotation and translation
    Se3,
    /// Rotation, translation and scale
    Sim3,
}

#[derive(Args, Debug)]
pub(crate) struct Demo {
    /// Folder for clip and results
    #[arg(long, value_name = "DIR", default_value = "i2slam-demo")]
    pub(crate) out: PathBuf,
    /// By colour alone: the clip's depth is not looked at
    #[arg(long)]
    pub(crate) rgb: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

#[derive(Args, Debug)]
pub(crate) struct Presets {
    /// Print this preset as a file for --config
    pub(crate) name: Option<String>,
}

pub(crate) fn frame_range(text: &str) -> Result<Range<usize>, String> {
    let number = |part: &str| part.trim().parse::<usize>().ok();
    let ends = text.split_once("..").and_then(|(a, b)| Some(number(a)?..number(b)?));
    match ends {
        Some(range) if !range.is_empty() => Ok(range),
        Some(_) => Err("holds no frame: the second number must be larger".to_owned()),
        None => Err("expected two frame numbers as in 10..20".to_owned()),
    }
}

fn relative_step(text: &str) -> Result<RelativeStep, String> {
    let step = match text.trim().strip_suffix('s') {
        Some(seconds) => seconds.parse().ok().map(RelativeStep::Seconds),
        None => text.trim().parse().ok().map(RelativeStep::Frames),
    };
    let sound = |step: &RelativeStep| match *step {
        RelativeStep::Frames(n) => n > 0,
        RelativeStep::Seconds(s) => s.is_finite() && s > 0.0,
    };
    step.filter(sound).ok_or_else(|| "expected frames as in 30, or seconds as in 0.5s".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn definitions_are_sound() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn ranges_are_half_open() {
        assert_eq!(frame_range("3..7"), Ok(3..7));
        for wrong in ["7..3", "3..3", "3", "3..", "a..b", "-1..4"] {
            assert!(frame_range(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn steps_are_frames_or_seconds() {
        assert_eq!(relative_step("30"), Ok(RelativeStep::Frames(30)));
        assert_eq!(relative_step("0.5s"), Ok(RelativeStep::Seconds(0.5)));
        for wrong in ["0", "0s", "-1s", "1.5", "x", "", "infs"] {
            assert!(relative_step(wrong).is_err(), "{wrong}");
        }
    }
}
