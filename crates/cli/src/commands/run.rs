//! `i2slam run`: a sequence to a result folder.

use super::use_threads;
use crate::arguments::{Formation, Input, KeyframeDepth, Map, Run};
use crate::failure::Failure;
use crate::pipeline::{self, Job, Keyframes};
use i2slam::Config;
use i2slam::config::MapKind;
use i2slam::dataset::OpenOptions;
use i2slam::keyframes::ImportDepth;

pub(crate) fn run(arguments: &Run) -> Result<(), Failure> {
    let config = settings(arguments)?;
    use_threads(&arguments.machine)?;
    pipeline::run(&Job {
        dataset: arguments.dataset.clone(),
        out: arguments.out.clone(),
        keyframes: keyframes(arguments, &config)?,
        open: OpenOptions {
            colour_only: arguments.rgb,
            ..open_options(&arguments.input, &config)?
        },
        config,
        draw: arguments.render,
        overwrite: arguments.overwrite,
        quiet: arguments.machine.quiet,
        title: None,
    })
}

/// Preset, then file, then flags.
fn settings(arguments: &Run) -> Result<Config, Failure> {
    let usual = if arguments.rgb { "default-rgb" } else { "default" };
    let preset = arguments.preset.as_deref();
    let config = match &arguments.config {
        Some(file) => Config::from_toml_file_on(file, preset.or(Some(usual)))?,
        None => Config::preset(preset.unwrap_or(usual))?,
    };
    with_flags(config, arguments)
}

/// Where keyframes with poses come from, if this run takes them; only settings for that will do.
fn keyframes(arguments: &Run, config: &Config) -> Result<Option<Keyframes>, Failure> {
    let preset = &config.preset;
    match (arguments.rgb, &arguments.keyframes, config.is_rgb()) {
        (false, _, false) => Ok(None),
        (false, _, true) => {
            Err(Failure::Usage(format!("preset {preset} is for colour alone: add --rgb")))
        }
        (true, _, false) => Err(Failure::Usage(format!(
            "preset {preset} is for RGB-D: --rgb goes with default-rgb, paper-rgb or paper-rgb-s"
        ))),
        (true, None, true) => Ok(Some(Keyframes::Native)),
        (true, Some(path), true) => Ok(Some(Keyframes::Files {
            path: path.clone(),
            depth: match arguments.keyframe_depth {
                KeyframeDepth::None => ImportDepth::None,
                KeyframeDepth::Imported => ImportDepth::Imported,
                KeyframeDepth::Pictures => ImportDepth::Pictures,
            },
            variance: arguments.depth_variance.clone(),
        })),
    }
}

/// The values of `config` that flags do not replace.
pub(super) fn with_flags(mut config: Config, arguments: &Run) -> Result<Config, Failure> {
    let Formation { virtual_cameras, no_blur, no_tone, no_trajectory_loss } = arguments.formation;
    let formation = &mut config.formation;
    formation.blur &= !no_blur;
    formation.tone &= !no_tone;
    formation.trajectory_loss &= !no_trajectory_loss;
    if let Some(count) = virtual_cameras {
        formation.virtual_cameras = count;
    }
    if let Some(every) = arguments.hold_out {
        config.mapping.hold_out = every;
    }
    if let Some(map) = arguments.map {
        config.map.kind = match map {
            Map::Gaussian => MapKind::Gaussian,
            Map::Hashgrid => MapKind::HashGrid,
        };
    }
    if let Some(seed) = arguments.seed {
        config.seed = seed;
    }
    config.validate()?;
    Ok(config)
}

pub(super) fn open_options(input: &Input, config: &Config) -> Result<OpenOptions, Failure> {
    let intrinsics = input.intrinsics.as_deref().map(<[f64; 4]>::try_from).transpose();
    let four = |_| Failure::Usage("--intrinsics needs the four numbers fx fy cx cy".to_owned());
    Ok(OpenOptions {
        camera: input.camera.clone(),
        intrinsics: intrinsics.map_err(four)?,
        depth_scale: input.depth_scale,
        frames: input.frames.clone(),
        stride: input.stride,
        scale: input.scale,
        crop_border: config.input.crop_border,
        minimum_gap: config.input.minimum_gap,
        ..OpenOptions::default()
    })
}
