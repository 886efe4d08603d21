//! `i2slam run`: a sequence to a result folder.

use super::use_threads;
use crate::arguments::{Distortion, Draw, Formation, Input, KeyframeDepth, Map, Run};
use crate::failure::Failure;
use crate::output::complain;
use crate::pipeline::{self, Job};
use i2slam::config::{MapKind, line_of_key};
use i2slam::dataset::{OpenOptions, is_video, is_without_depth};
use i2slam::keyframes::ImportDepth;
use i2slam::{Config, PoseSource, RunOptions};
use std::path::{Path, PathBuf};

pub(crate) fn run(arguments: &Run) -> Result<(), Failure> {
    if is_by_itself_rgb(arguments) {
        if !arguments.machine.quiet {
            let name = arguments.dataset.display();
            complain(&format!(
                "{name} has pictures and no depth: run by colour alone, as with --rgb"
            ));
        }
        return reconstruct(&Run { rgb: true, ..arguments.clone() });
    }
    reconstruct(arguments)
}

/// Whether nothing but pictures is there, which nobody said.
fn is_by_itself_rgb(arguments: &Run) -> bool {
    !is_rgb(arguments) && is_without_depth(&arguments.dataset)
}

fn reconstruct(arguments: &Run) -> Result<(), Failure> {
    let config = settings(arguments)?;
    use_threads(&arguments.machine)?;
    let poses = pose_source(arguments, &config)?;
    let draw = arguments.render.unwrap_or_else(|| usual_drawing(arguments, &config));
    let options = RunOptions::new(config, poses);
    let open = open_options(&arguments.input, options.open)?;
    pipeline::run(&Job {
        dataset: arguments.dataset.clone(),
        out: arguments.out.clone(),
        options: RunOptions { open, ..options },
        draw,
        overwrite: arguments.overwrite,
        quiet: arguments.machine.quiet,
        title: None,
    })
}

/// Preset, then file, then flags.
fn settings(arguments: &Run) -> Result<Config, Failure> {
    let usual = if is_rgb(arguments) { "default-rgb" } else { "default" };
    let preset = arguments.preset.as_deref();
    let config = match &arguments.config {
        Some(file) => Config::from_toml_file_on(file, preset.or(Some(usual)))?,
        None => Config::preset(preset.unwrap_or(usual))?,
    };
    with_flags(with_usual_map(config, arguments), arguments)
}

/// Keyframes of other programs may lack the depth that Gaussians start from: they become a radiance
/// field unless the configuration file or a flag names the map.
fn with_usual_map(mut config: Config, arguments: &Run) -> Config {
    let named = arguments.config.as_deref().is_some_and(names_map_kind);
    if is_rgb(arguments) && arguments.keyframes.is_some() && config.is_rgb() && !named {
        config.map.kind = MapKind::HashGrid;
    }
    config
}

fn names_map_kind(file: &Path) -> bool {
    let text = std::fs::read_to_string(file);
    text.is_ok_and(|text| line_of_key(&text, &["map", "kind"]).is_some())
}

/// Source of the poses; refuses settings that are for another one.
fn pose_source(arguments: &Run, config: &Config) -> Result<PoseSource, Failure> {
    let preset = &config.preset;
    let estimate_distortion = arguments.distortion == Distortion::Estimate;
    if estimate_distortion {
        refuse_estimate(arguments)?;
    }
    match (is_rgb(arguments), &arguments.keyframes, config.is_rgb()) {
        (false, _, false) => Ok(PoseSource::Depth),
        (false, _, true) => {
            Err(Failure::Usage(format!("preset {preset} is for colour alone: add --rgb")))
        }
        (true, _, false) => Err(Failure::Usage(format!(
            "preset {preset} is for RGB-D: {} goes with default-rgb, paper-rgb or paper-rgb-s",
            if arguments.rgb { "colour alone (--rgb)" } else { "a video, which has no depth," }
        ))),
        (true, None, true) => Ok(PoseSource::Odometry { estimate_distortion }),
        (true, Some(path), true) => Ok(PoseSource::Imported {
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

/// The lens is looked for while the path is found from pictures alone, and the camera with it.
fn refuse_estimate(arguments: &Run) -> Result<(), Failure> {
    let Input { camera, intrinsics, fov, .. } = &arguments.input;
    let why = if !is_rgb(arguments) {
        "goes with --rgb or a video"
    } else if arguments.keyframes.is_some() {
        "does not go with --keyframes, whose poses belong to a camera that is known"
    } else if camera.is_some() || intrinsics.is_some() || fov.is_some() {
        "does not go with --camera, --intrinsics or --fov: the focal length is found with the lens"
    } else {
        return Ok(());
    };
    Err(Failure::Usage(format!("--distortion estimate {why}")))
}

/// What is drawn if nothing is said. The report has pictures in any case.
fn usual_drawing(arguments: &Run, config: &Config) -> Draw {
    match config.map.kind {
        MapKind::HashGrid if is_video(&arguments.dataset) => Draw::None,
        _ => Draw::All,
    }
}

/// Whether the run is one of colour alone.
fn is_rgb(arguments: &Run) -> bool {
    arguments.rgb || is_video(&arguments.dataset)
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

/// The options of `usual` that flags do not replace. `--scale` replaces the usual size, too.
pub(super) fn open_options(input: &Input, usual: OpenOptions) -> Result<OpenOptions, Failure> {
    let given = input.intrinsics.as_deref().map(intrinsics).transpose()?;
    let (file, intrinsics) = given.unwrap_or_default();
    let usual_side = usual.max_side.filter(|_| input.scale.is_none());
    Ok(OpenOptions {
        camera: file.or_else(|| input.camera.clone()),
        intrinsics,
        field_of_view: input.fov,
        depth_scale: input.depth_scale,
        frames: input.frames.clone(),
        stride: input.stride,
        scale: input.scale.unwrap_or(1.0),
        max_side: input.max_side.map(|side| side as usize).or(usual_side),
        ..usual
    })
}

/// What stands behind `--intrinsics`: a file, or four numbers.
fn intrinsics(words: &[String]) -> Result<(Option<PathBuf>, Option<[f64; 4]>), Failure> {
    let refuse = |why: &str| {
        let words = words.join(" ");
        Failure::Usage(format!(
            "--intrinsics {words}: {why}; it takes a file, or the four numbers FX FY CX CY"
        ))
    };
    let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
    match (words, numbers) {
        (_, Some(numbers)) => match <[f64; 4]>::try_from(numbers) {
            Ok(four) => Ok((None, Some(four))),
            Err(_) => Err(refuse("not four numbers")),
        },
        ([file], None) => Ok((Some(file.into()), None)),
        _ => Err(refuse("not a file and not four numbers (the sequence stands before the flags)")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_are_a_file_or_four_numbers() {
        let of = |text: &str| {
            let words: Vec<String> = text.split(' ').map(str::to_owned).collect();
            intrinsics(&words)
        };
        assert!(matches!(of("500 501 -3.5 240"), Ok((None, Some([500.0, 501.0, -3.5, 240.0])))));
        assert!(matches!(of("cam.json"), Ok((Some(file), None)) if file.ends_with("cam.json")));
        for wrong in ["500", "500 501 320", "cam.json video.mp4", "1 2 3 x"] {
            assert!(matches!(of(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
    }
}
