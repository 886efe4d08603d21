//! `i2slam demo`: the clip inside the program, reconstructed.

use super::use_threads;
use crate::arguments::{Demo, Draw};
use crate::destination::refuse_file;
use crate::failure::Failure;
use crate::output::complain;
use crate::pipeline::{self, Job, Keyframes};
use i2slam::Config;
use i2slam::dataset::OpenOptions;
use i2slam_result::ResultFolder;
use std::path::{Path, PathBuf};

include!(concat!(env!("OUT_DIR"), "/clip.rs"));

pub(crate) fn demo(arguments: &Demo) -> Result<(), Failure> {
    use_threads(&arguments.machine)?;
    refuse_file(&arguments.out)?;
    let dataset = unpack(&arguments.out)?;
    if !arguments.machine.quiet {
        let how = if arguments.rgb { ", by colour alone" } else { "" };
        complain(&format!(
            "reconstructing the demo clip: 2 s from the TUM RGB-D benchmark (CC BY 4.0){how}"
        ));
    }
    let config = Config::preset(if arguments.rgb { "default-rgb" } else { "default" })?;
    let minimum_gap = config.input.minimum_gap;
    let open = OpenOptions { minimum_gap, ..OpenOptions::default() };
    pipeline::run(&Job {
        dataset,
        keyframes: arguments.rgb.then_some(Keyframes::Native { estimate_distortion: false }),
        out: arguments.out.clone(),
        open: OpenOptions { colour_only: arguments.rgb, ..open },
        config,
        draw: Draw::All,
        overwrite: true,
        quiet: arguments.machine.quiet,
        title: Some("demo clip"),
    })
}

/// Writes the clip to `clip/` in the folder, so that it can be looked at and run again.
fn unpack(out: &Path) -> Result<PathBuf, Failure> {
    let folder = ResultFolder::create(&out.join("clip"))?;
    for (name, bytes) in CLIP {
        folder.write(name, |file| file.write_all(bytes))?;
    }
    Ok(folder.path().to_owned())
}
