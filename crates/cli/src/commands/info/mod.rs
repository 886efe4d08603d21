//! `i2slam info`: describes a sequence before it is run.

mod frames;
mod sequence;
mod table;

use crate::arguments::{Input, Machine};
use crate::failure::Failure;
use crate::ground_truth::GroundTruth;
use crate::interrupt;
use crate::output::{print, print_status};
use crate::progress::Progress;
use clap::Args;
use frames::PictureStats;
use i2slam::dataset::{DatasetError, Sequence, is_video};
use i2slam::{Config, PoseSource, RunOptions};
use sequence::SequenceInfo;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Info {
    /// Sequence: a folder in one of the sequence_info layouts (docs/datasets.md), a .sens file or a video;
    /// or keyframes of another program (docs/import.md)
    pub(crate) dataset: PathBuf,
    /// Settings that decide which frames there are and how much is cropped
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub(crate) preset: String,
    #[command(flatten)]
    pub(crate) input: Input,
    /// Read lists and headers only, without depth, brightness and sharpness
    #[arg(long)]
    pub(crate) quick: bool,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// Everything printed; the JSON object.
#[derive(Serialize)]
struct InfoReport {
    #[serde(flatten)]
    sequence_info: SequenceInfo,
    /// `null` with `--quick`.
    pictures: Option<PictureStats>,
    warnings: Vec<String>,
}

/// Opens the sequence, with depth or else without; `None` if the path held keyframes of another
/// program, which were printed.
fn open(arguments: &Info) -> Result<Option<Sequence>, Failure> {
    let path = &arguments.dataset;
    let config = Config::preset(&arguments.preset)?;
    let options = |poses: PoseSource| {
        arguments.input.open_options(RunOptions::new(config.clone(), poses).open)
    };
    let with_depth = options(PoseSource::Depth)?;
    let colour_alone = options(PoseSource::Odometry { estimate_distortion: false })?;
    if is_video(path) {
        return Ok(Some(Sequence::open(path, &colour_alone)?));
    }
    match Sequence::open(path, &with_depth) {
        Ok(sequence) => Ok(Some(sequence)),
        Err(error) if sequence::print_keyframes(arguments, with_depth, &error)? => Ok(None),
        Err(DatasetError::UnknownLayout { has_colour: true, .. }) => {
            Ok(Some(Sequence::open(path, &colour_alone)?))
        }
        Err(error) => Err(error.into()),
    }
}

pub(crate) fn info(arguments: &Info) -> Result<(), Failure> {
    arguments.machine.use_threads()?;
    let Some(sequence) = open(arguments)? else { return Ok(()) };
    let truth = GroundTruth::open(&arguments.dataset, &sequence);
    let mut warnings = sequence.warnings.clone();
    warnings.extend(truth.warnings.iter().cloned());
    let sequence_info = SequenceInfo::new(&sequence, &truth);
    let pictures = if arguments.quick {
        None
    } else {
        let progress = Progress::new(sequence.len(), arguments.machine.quiet);
        interrupt::listen();
        let pictures = PictureStats::new(&sequence, &truth, &progress);
        progress.clear();
        Some(pictures?)
    };
    let report = InfoReport { sequence_info, pictures, warnings };
    if arguments.json {
        let text = serde_json::to_string_pretty(&report);
        print(&text.map_err(|e| Failure::Failed(format!("cannot write JSON: {e}")))?);
        return Ok(());
    }
    for line in table::lines(&report.sequence_info, report.pictures.as_ref()) {
        print(&line);
    }
    for warning in &report.warnings {
        print_status(&format!("warning: {warning}"));
    }
    Ok(())
}
