//! `i2slam demo`: the clip inside the program, reconstructed.

use crate::arguments::{Live, Machine, Rerun};
use crate::console::print_status;
use crate::failure::Failure;
use crate::reconstruction::{self, Job, RenderSelection};
use crate::recording::{Recorder, Recording};
use crate::result_folder::is_result;
use clap::Args;
use i2slam::RunOptions;
use i2slam_storage::{Claim, Manifest, OutputFolder, first_entry};
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(crate) struct Demo {
    /// Folder for clip and results [default: i2slam-demo, with --rgb i2slam-demo-rgb]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// By colour alone: the clip's depth is not looked at
    #[arg(long)]
    pub(crate) rgb: bool,
    #[command(flatten)]
    pub(crate) live: Live,
    #[command(flatten)]
    pub(crate) rerun: Rerun,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

include!(concat!(env!("OUT_DIR"), "/clip.rs"));

pub(crate) fn demo(arguments: &Demo, recorder: Option<Recorder>) -> Result<(), Failure> {
    arguments.machine.use_threads()?;
    let (options, usual) = match arguments.rgb {
        true => (RunOptions::colour_alone(), "i2slam-demo-rgb"),
        false => (RunOptions::with_depth(), "i2slam-demo"),
    };
    let out = arguments.out.clone().unwrap_or_else(|| usual.into());
    refuse_others(&out)?;
    let recording = Recording::of(&arguments.rerun, recorder, [&out, &out], false)?;
    let job = Job {
        dataset: out.join("clip"),
        options,
        settings_file: None,
        held_out_frames: None,
        renders: RenderSelection::All,
        overwrite: true,
        quiet: arguments.machine.quiet,
        poses: None,
        live: arguments.live.start()?,
        recording,
        is_rgb_chosen: false,
        title: Some("demo clip"),
        out,
    };
    job.check_output()?;
    if !job.quiet && is_result(&job.out) {
        let out = job.out.display();
        print_status(&format!(
            "note: this run replaces the earlier result in {out}; another --out keeps it"
        ));
    }
    unpack(&job.dataset)?;
    if !arguments.machine.quiet {
        let how = if arguments.rgb { ", by colour alone" } else { "" };
        print_status(&format!(
            "reconstructing the demo clip: 2 s from the TUM RGB-D benchmark (CC BY 4.0){how}"
        ));
    }
    reconstruction::run(&job)
}

/// Command in the manifest of the clip.
const COMMAND: &str = "i2slam demo";

/// Tells if a folder holds an earlier demo, whole or in part, by its clip.
fn holds_demo(folder: &Path) -> bool {
    Manifest::of(&folder.join("clip")).is_some_and(|manifest| manifest.command == COMMAND)
}

/// Refuses a folder with anything but an earlier demo in it.
fn refuse_others(out: &Path) -> Result<(), Failure> {
    match first_entry(out).filter(|_| !holds_demo(out)) {
        Some(name) => Err(Failure::Usage(format!(
            "--out {}: is not empty, it holds {name} and no earlier demo: choose another folder",
            out.display()
        ))),
        None => Ok(()),
    }
}

/// Names of the clip's files and folders.
const NAMES: &[&str] =
    &["rgb", "depth", "rgb.txt", "depth.txt", "groundtruth.txt", "camera.json", "README.md"];

/// Writes the clip, so that it can be looked at and run again.
fn unpack(clip: &Path) -> Result<(), Failure> {
    let claim = Claim { command: COMMAND, names: NAMES, overwrite: true };
    let mut folder = OutputFolder::replace(clip, claim)?;
    for (name, bytes) in CLIP {
        folder.write(name, |file| file.write_all(bytes))?;
    }
    folder.commit()?;
    Ok(())
}
