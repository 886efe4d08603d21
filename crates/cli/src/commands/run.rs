//! `i2slam run`: reconstructs a sequence into a result folder.

use crate::arguments::{Input, Live, Machine, Rerun, existing_path, memory, number};
use crate::console::print_status;
use crate::failure::Failure;
use crate::held_out_frames::{HoldOut, parse_hold_out};
use crate::interrupt::{self, Reading};
use crate::pose_lines::PoseLines;
use crate::reconstruction::{self, Job, RenderSelection};
use crate::recording::{Recorder, Recording};
use crate::result_folder::refuse_results;
use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum};
use i2slam::config::{MapKind, PRESET_NAMES, line_of_key};
use i2slam::dataset::{OpenOptions, is_stream, is_video, is_without_depth};
use i2slam::keyframes::ImportDepth;
use i2slam::{CancellationToken, Config, PoseSource, RunOptions};
use i2slam_result::UnitOfLength;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Args, Clone, Debug)]
pub(crate) struct Run {
    /// Sequence: a folder in one of the known layouts (docs/datasets.md), a .sens or .r3d file, a video, which
    /// ffmpeg decodes, with depth where its second track is 16-bit grey, or a stream of one: an address
    /// such as rtsp://HOST/PATH, a named pipe, - for the standard input
    pub(crate) dataset: PathBuf,
    /// Folder for the results [default: NAME-i2slam in the current folder, with the name of the
    /// sequence; streams need one]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Settings to start from, see `i2slam presets` [default: default]
    #[arg(
        long,
        value_name = "NAME",
        value_parser = PossibleValuesParser::new(PRESET_NAMES),
        hide_possible_values = true
    )]
    pub(crate) preset: Option<String>,
    /// TOML file whose values replace those of the preset
    #[arg(long, value_name = "FILE.toml", value_parser = existing_path())]
    pub(crate) config: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) input: Input,
    /// Colour alone, as always where there is no depth: poses are estimated from the pictures, or come with
    /// --keyframes; poses, exposure and map are refined together [default preset: default-rgb]
    #[arg(long)]
    pub(crate) rgb: bool,
    /// By colour alone, lens distortion: that of the camera file, if there is one, or estimated from the
    /// pictures (k1, k2) together with the focal length, where nothing gives the camera
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Distortion::Given)]
    pub(crate) distortion: Distortion,
    /// Keyframes and poses that another program found (docs/import.md); implies --rgb
    #[arg(long, value_name = "PATH")]
    pub(crate) keyframes: Option<PathBuf>,
    /// Which depth the keyframes get
    #[arg(long, value_enum, default_value_t = KeyframeDepth::Imported, requires = "keyframes")]
    pub(crate) keyframe_depth: KeyframeDepth,
    /// Folder with the variance of depth pictures (.npy [m²], or 16-bit PNG of the deviation)
    #[arg(long, value_name = "DIR", requires = "keyframes")]
    pub(crate) depth_variance: Option<PathBuf>,
    /// Kind of map [default: that of --preset or --config; without these gaussian, or
    /// hashgrid with --keyframe-depth none]
    #[arg(long, value_enum, value_name = "KIND")]
    pub(crate) map: Option<Map>,
    #[command(flatten)]
    pub(crate) formation: Formation,
    /// Hold out every N-th frame, or the frames that a file names, by number or file name, one a line:
    /// tracked, but never mapped, for `eval --protocol held-out`
    #[arg(long, value_name = "N or FILE", value_parser = parse_hold_out)]
    pub(crate) hold_out: Option<HoldOut>,
    /// Write poses while frames come, a line in the TUM format for each frame that has one, to a new
    /// file, a named pipe, or - for the standard output (results then go to standard error);
    /// trajectory.txt has the final ones. With --overwrite poses of the run before move to FILE.previous
    #[arg(long, value_name = "FILE")]
    pub(crate) poses: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) live: Live,
    #[command(flatten)]
    pub(crate) rerun: Rerun,
    /// Which frames to render under renders/ [default: all; none of a video on a hash grid, which is
    /// slow to render: `i2slam render` does it later]
    #[arg(long, value_enum, value_name = "WHICH")]
    pub(crate) render: Option<RenderSelection>,
    /// Replace the earlier result in the folder; other files in it stay
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Seed of all random choices; the same seed gives the same bytes
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        value_parser = number::<u64>("a whole number as in 7")
    )]
    pub(crate) seed: Option<u64>,
    /// Memory of the run, about [GB]: pictures beyond a sixth of it wait in a file; no result depends on
    /// it
    #[arg(long, value_name = "GB", allow_negative_numbers = true, value_parser = memory)]
    pub(crate) memory: Option<f64>,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

impl Run {
    /// Folder for the results: that of `--out`, else one named after the sequence.
    fn out(&self) -> Result<PathBuf, Failure> {
        if let Some(out) = &self.out {
            return Ok(out.clone());
        }
        let dataset = &self.dataset;
        let named = std::path::absolute(dataset).ok().filter(|_| !is_stream(dataset));
        let name = named.as_deref().and_then(|path| match path.is_dir() {
            true => path.file_name(),
            false => path.file_stem(),
        });
        let Some(name) = name else {
            return Err(Failure::Usage(format!(
                "{} has no name for the result: give a folder with --out DIR",
                dataset.display()
            )));
        };
        let mut folder = name.to_owned();
        folder.push("-i2slam");
        Ok(PathBuf::from(folder))
    }
}

/// Switches of the image-formation module.
#[derive(Args, Clone, Debug)]
pub(crate) struct Formation {
    /// Virtual cameras over the exposure
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        value_parser = number::<usize>("a count of cameras as in 5")
    )]
    pub(crate) virtual_cameras: Option<usize>,
    /// Model pictures as sharp, without motion blur
    #[arg(long)]
    pub(crate) no_blur: bool,
    /// Use pictures as they are, without exposure, white balance or camera response
    #[arg(long)]
    pub(crate) no_tone: bool,
    /// Do not tie the motion during an exposure to the motion between frames; for comparisons as in the paper
    #[arg(long)]
    pub(crate) no_trajectory_loss: bool,
}

/// Kind of map.
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
    /// Estimated from the pictures, and removed from them
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

pub(crate) fn run(arguments: &Run, recorder: Option<Recorder>) -> Result<(), Failure> {
    if is_stream(&arguments.dataset) {
        return run_stream(arguments, recorder);
    }
    refuse_results(&arguments.dataset)?;
    if !arguments.rgb && (arguments.keyframes.is_some() || is_without_depth(&arguments.dataset)) {
        let arguments = Run { rgb: true, ..arguments.clone() };
        let is_rgb_chosen = arguments.keyframes.is_none() && !is_video(&arguments.dataset);
        return reconstruction::run(&Job { is_rgb_chosen, ..job(&arguments, recorder)? });
    }
    reconstruction::run(&job(arguments, recorder)?)
}

/// Runs on a stream: with depth, if there is any.
fn run_stream(arguments: &Run, recorder: Option<Recorder>) -> Result<(), Failure> {
    let name = arguments.dataset.display();
    if arguments.keyframes.is_some() {
        return Err(Failure::Usage(format!(
            "{name} is a stream: --keyframes goes with a file or a folder"
        )));
    }
    if arguments.distortion == Distortion::Estimate {
        refuse_estimate(&Run { rgb: true, ..arguments.clone() })?;
    }
    if let Some(HoldOut::Listed(list)) = &arguments.hold_out {
        return Err(Failure::Usage(format!(
            "{name} is a stream, whose frames are not known yet: --hold-out {} goes with a file or a \
             folder, --hold-out N with both",
            list.display()
        )));
    }
    let settings = settings(arguments)?;
    let is_rgb = arguments.rgb || settings.is_rgb();
    let poses = match is_rgb {
        true => PoseSource::colour_alone(),
        false => PoseSource::with_depth(&settings),
    };
    let options = RunOptions::new(settings, poses);
    // What lies in the way is said before a stream is read that may have no end.
    pose_lines(arguments, &options)?;
    recording(arguments, recorder)?;
    reconstruction::check_output(&arguments.dataset, &arguments.out()?, arguments.overwrite)?;
    let open = arguments.input.open_options(options.open)?;
    // With depth a camera is needed, which is asked for once depth was seen.
    let Input { camera, intrinsics, fov, .. } = &arguments.input;
    let is_given = camera.is_some() || intrinsics.is_some() || fov.is_some();
    let guess_camera = open.guess_camera || !is_given;
    let options = RunOptions { open: OpenOptions { guess_camera, ..open }, ..options };
    if !arguments.machine.quiet {
        print_status(&format!(
            "reading the stream {name} (Ctrl-C ends it, and goes on with what came)"
        ));
    }
    interrupt::listen();
    let end = CancellationToken::when(interrupt::requested);
    let reading = Reading::start();
    let live = options.open_stream(&arguments.dataset, end)?;
    let arguments = Run { rgb: !live.has_depth(), ..arguments.clone() };
    reconstruction::run_stream(&job(&arguments, recorder)?, live, reading)
}

fn job(arguments: &Run, recorder: Option<Recorder>) -> Result<Job<'_>, Failure> {
    let config = settings(arguments)?;
    arguments.machine.use_threads()?;
    let poses = pose_source(arguments, &config)?;
    let renders = arguments.render.unwrap_or_else(|| default_renders(arguments, &config));
    let options = RunOptions::new(config, poses);
    let open = arguments.input.open_options(options.open)?;
    let options = RunOptions { open, ..options }.with_camera_of_keyframes();
    let poses = pose_lines(arguments, &options)?;
    Ok(Job {
        dataset: arguments.dataset.clone(),
        out: arguments.out()?,
        options,
        settings_file: arguments.config.as_deref(),
        held_out_frames: match &arguments.hold_out {
            Some(HoldOut::Listed(list)) => Some(list.as_path()),
            _ => None,
        },
        renders,
        is_rgb_chosen: false,
        overwrite: arguments.overwrite,
        quiet: arguments.machine.quiet,
        poses,
        live: arguments.live.start()?,
        recording: recording(arguments, recorder)?,
        title: None,
    })
}

/// The receiver of poses, where one is asked for.
fn pose_lines(arguments: &Run, options: &RunOptions) -> Result<Option<Arc<PoseLines>>, Failure> {
    let Some(path) = &arguments.poses else { return Ok(None) };
    let unit = match options.poses {
        PoseSource::Files { .. } => {
            return Err(Failure::Usage(
                "--poses does not go with --keyframes, whose poses are known".to_owned(),
            ));
        }
        PoseSource::FrontEnd { with_depth: false, .. } => UnitOfLength::Unknown,
        PoseSource::FrontEnd { with_depth: true, .. } | PoseSource::Map => UnitOfLength::Metre,
    };
    let out = arguments.out()?;
    let folders = [arguments.dataset.as_path(), out.as_path()];
    Ok(Some(Arc::new(PoseLines::new(path, folders, unit, arguments.overwrite)?)))
}

/// The recording, where one is asked for.
fn recording(arguments: &Run, recorder: Option<Recorder>) -> Result<Option<Recording>, Failure> {
    let out = arguments.out()?;
    let folders = [arguments.dataset.as_path(), out.as_path()];
    Recording::of(&arguments.rerun, recorder, folders, arguments.overwrite)
}

/// Settings of the preset, replaced by those of the file, then by flags.
fn settings(arguments: &Run) -> Result<Config, Failure> {
    let usual = if arguments.rgb { "default-rgb" } else { "default" };
    let preset = arguments.preset.as_deref();
    let config = match &arguments.config {
        Some(file) => Config::from_toml_file(file, preset.or(Some(usual)))?,
        None => Config::preset(preset.unwrap_or(usual))?,
    };
    with_flags(with_default_map(config, arguments), arguments)
}

/// Keyframes without the depth that Gaussians start from become a radiance field unless the configuration
/// file or a flag names the map.
fn with_default_map(mut config: Config, arguments: &Run) -> Config {
    let named = arguments.config.as_deref().is_some_and(names_map_kind);
    let is_without_depth = arguments.keyframe_depth == KeyframeDepth::None;
    if arguments.keyframes.is_some() && is_without_depth && config.is_rgb() && !named {
        config.map.kind = MapKind::HashGrid;
    }
    config
}

fn names_map_kind(file: &Path) -> bool {
    let text = i2slam_storage::read_text(file);
    text.is_ok_and(|text| line_of_key(&text, &["map", "kind"]).is_some())
}

/// Source of the poses; refuses settings that are for another one.
fn pose_source(arguments: &Run, config: &Config) -> Result<PoseSource, Failure> {
    let preset = &config.preset;
    let estimate_distortion = arguments.distortion == Distortion::Estimate;
    if estimate_distortion {
        refuse_estimate(arguments)?;
    }
    match (arguments.rgb, &arguments.keyframes, config.is_rgb()) {
        (false, _, false) => Ok(PoseSource::with_depth(config)),
        (false, _, true) => {
            Err(Failure::Usage(format!("preset {preset} is for colour alone: add --rgb")))
        }
        (true, _, false) => Err(Failure::Usage(format!(
            "preset {preset} is for RGB-D: {} goes with default-rgb, paper-rgb or paper-rgb-s",
            "colour alone (--rgb, --keyframes, or an input without depth)"
        ))),
        (true, None, true) => Ok(PoseSource::FrontEnd { with_depth: false, estimate_distortion }),
        (true, Some(path), true) => Ok(PoseSource::Files {
            keyframes: path.clone(),
            pictures: arguments.dataset.clone(),
            depth: match arguments.keyframe_depth {
                KeyframeDepth::None => ImportDepth::None,
                KeyframeDepth::Imported => ImportDepth::Imported,
                KeyframeDepth::Pictures => ImportDepth::Pictures,
            },
            variance: arguments.depth_variance.clone(),
        }),
    }
}

/// Refuses `--distortion estimate` unless pictures alone have to give the camera.
fn refuse_estimate(arguments: &Run) -> Result<(), Failure> {
    let Input { camera, intrinsics, fov, .. } = &arguments.input;
    let why = if !arguments.rgb {
        "goes with --rgb, or an input without depth"
    } else if arguments.keyframes.is_some() {
        "does not go with --keyframes, whose poses belong to a camera that is known"
    } else if camera.is_some() || intrinsics.is_some() || fov.is_some() {
        "does not go with --camera, --intrinsics or --fov: the focal length is estimated with it"
    } else {
        return Ok(());
    };
    Err(Failure::Usage(format!("--distortion estimate {why}")))
}

/// Default of `--render`. The report has pictures in any case.
fn default_renders(arguments: &Run, config: &Config) -> RenderSelection {
    match config.map.kind {
        MapKind::HashGrid if is_video(&arguments.dataset) => RenderSelection::None,
        _ => RenderSelection::All,
    }
}

/// Applies the flags to `config`.
fn with_flags(mut config: Config, arguments: &Run) -> Result<Config, Failure> {
    let Formation { virtual_cameras, no_blur, no_tone, no_trajectory_loss } = arguments.formation;
    let formation = &mut config.formation;
    formation.blur &= !no_blur;
    formation.tone &= !no_tone;
    formation.trajectory_loss &= !no_trajectory_loss;
    if let Some(count) = virtual_cameras {
        formation.virtual_cameras = count;
    }
    match &arguments.hold_out {
        Some(HoldOut::Every(every)) => config.mapping.hold_out = *every,
        Some(HoldOut::Listed(_)) => config.mapping.hold_out = 0,
        None => {}
    }
    if let Some(map) = arguments.map {
        config.map.kind = match map {
            Map::Gaussian => MapKind::Gaussian,
            Map::Hashgrid => MapKind::HashGrid,
        };
    }
    config.seed = arguments.seed.unwrap_or(config.seed);
    config.memory = arguments.memory.unwrap_or(config.memory);
    config.validate()?;
    Ok(config)
}
