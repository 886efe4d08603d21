//! `i2slam demo`: the clip inside the program, reconstructed.

use super::use_threads;
use crate::arguments::{Demo, Draw};
use crate::destination::refuse_file;
use crate::failure::Failure;
use crate::output::complain;
use crate::pipeline::{self, Job};
use i2slam::RunOptions;
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
    let options = match arguments.rgb {
        true => RunOptions::colour_alone(),
        false => RunOptions::with_depth(),
    };
    pipeline::run(&Job {
        dataset,
        out: arguments.out.clone(),
        options,
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
