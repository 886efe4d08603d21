//! `i2slam presets`: lists the presets, or prints one as a file.

use crate::console::{print, print_text};
use crate::failure::Failure;
use clap::Args;
use i2slam::Config;
use i2slam::config::PRESET_NAMES;

#[derive(Args, Debug)]
pub(crate) struct Presets {
    /// Print this preset as a file for --config
    pub(crate) name: Option<String>,
}

pub(crate) fn presets(arguments: &Presets) -> Result<(), Failure> {
    if let Some(name) = &arguments.name {
        print_text(Config::preset(name)?.to_commented_toml().trim_end());
        return Ok(());
    }
    for name in PRESET_NAMES {
        print(&format!("{name:<20}{}", description(name)));
    }
    Ok(())
}

fn description(name: &str) -> &'static str {
    match name {
        "default" => "second-order tracking, cheap blur: the best result at a usable speed",
        "paper-tum" => "the paper's settings for TUM RGB-D",
        "paper-scannet" => "the paper's settings for ScanNet",
        "paper-synthetic" => "the paper's settings for its synthetic scenes",
        "default-rgb" => "colour alone: poses, exposure and map refined together (--rgb)",
        "paper-rgb" => "the paper's settings for colour alone, with keyframes and a radiance field",
        short if short.ends_with("-s") => "a fifth of the iterations",
        _ => "",
    }
}
