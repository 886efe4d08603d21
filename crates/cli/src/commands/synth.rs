//! `i2slam synth`: a specification to a sequence.

use crate::arguments::Machine;
use crate::console::{counted, print, print_status, print_text};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use clap::Args;
use i2slam::config::line_of_key;
use i2slam_synthetic::{SHIPPED_SPECS, Spec, Stage, Summary, SyntheticError, synthesise};
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(crate) struct Synth {
    /// Specification: a file, see --print-spec, whose values left out take their defaults; or
    /// glossy, lamps, stills, turn-away or round-trip, which come with the program [default: all
    /// defaults]
    #[arg(value_name = "SPEC")]
    pub(crate) spec: Option<PathBuf>,
    /// Folder for the sequence
    #[arg(short, long, value_name = "DIR", required_unless_present = "print_spec")]
    pub(crate) out: Option<PathBuf>,
    /// Replace what was written into the folder before; other files in it stay
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Seed of room, motion and noise, instead of the specification's
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Take every picture in an instant: no blur, whatever the specification says of the shutter
    #[arg(long)]
    pub(crate) sharp: bool,
    /// Print the specification with an explanation of every value, and end
    #[arg(long)]
    pub(crate) print_spec: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

pub(crate) fn synth(arguments: &Synth) -> Result<(), Failure> {
    let mut spec = arguments.spec.as_deref().map(read).transpose()?.unwrap_or_default();
    if let Some(seed) = arguments.seed {
        spec.seed = seed;
    }
    if arguments.sharp {
        (spec.exposure.shutter_minimum, spec.exposure.shutter_maximum) = (0.0, 0.0);
    }
    match &arguments.out {
        Some(out) if !arguments.print_spec => {
            arguments.machine.use_threads()?;
            make(&spec, out, arguments)
        }
        _ => {
            print_text(spec.to_toml().trim_end());
            Ok(())
        }
    }
}

/// A specification; a bad value is named with its line.
fn read(file: &Path) -> Result<Spec, Failure> {
    let shown = file.display().to_string();
    if !file.exists() && file.extension().is_none() {
        let names: Vec<&str> = SHIPPED_SPECS.iter().map(|(name, _)| *name).collect();
        let known = names.join(", ");
        return Spec::shipped(&shown).ok_or_else(|| {
            let reason = "is neither a file nor a specification of the program";
            Failure::Usage(format!("`{shown}` {reason} ({known})"))
        });
    }
    Spec::from_toml_file(file).map_err(|error| {
        let SyntheticError::OutOfRange { key, .. } = &error else { return failure(error) };
        let text = i2slam_storage::read_text(file).unwrap_or_default();
        let line = line_of_key(&text, &key.split('.').collect::<Vec<_>>());
        let line = line.map(|line| format!(", line {line}")).unwrap_or_default();
        Failure::Usage(format!("{}{line}: {error}", file.display()))
    })
}

fn make(spec: &Spec, out: &Path, arguments: &Synth) -> Result<(), Failure> {
    interrupt::listen();
    let frames = spec.camera.frames;
    let progress = Progress::new(frames, arguments.machine.quiet);
    let summary = synthesise(spec, out, arguments.overwrite, &mut |stage| {
        match stage {
            Stage::Lighting => progress.step("lighting the room", 0, 1),
            Stage::Sharp(done) => progress.step("sharp frames", done, frames),
            Stage::Blurred(done) => progress.step("blurred frames", done, frames),
        }
        !interrupt::requested()
    });
    progress.clear();
    report(&summary.map_err(|error| interrupted(error, out))?, out);
    Ok(())
}

fn report(summary: &Summary, out: &Path) {
    let s = summary;
    print(&format!("{} in {}", counted(s.frames, "frame"), out.display()));
    let [slow, fast] = s.rotation_rate;
    print(&format!("path {:.2} m, rotation {slow:.0} to {fast:.0} degrees/s", s.path_metres));
    let [low, high] = s.exposure_values;
    let stops = high - low;
    let [least, most] = s.shutter;
    print(&format!("exposure over {stops:.2} stops, shutter open {least:.2} to {most:.2}"));
    let [median, _, largest] = s.blur;
    print(&format!("blur {median:.1} px in the median frame, {largest:.1} px at most"));
}

/// The failure; an interrupted sequence leaves nothing, which is said.
pub(super) fn interrupted(error: SyntheticError, out: &Path) -> Failure {
    if let SyntheticError::Interrupted = error {
        print_status(&format!("nothing was written to {}", out.display()));
    }
    failure(error)
}

/// Wrong specifications are the user's (exit code 2); what is wrong with a disk is not.
pub(super) fn failure(error: SyntheticError) -> Failure {
    match error {
        SyntheticError::Malformed { .. } | SyntheticError::OutOfRange { .. } => {
            Failure::Usage(error.to_string())
        }
        SyntheticError::Dataset(error) => error.into(),
        SyntheticError::Storage(error) => error.into(),
        SyntheticError::Interrupted => Failure::Interrupted,
        _ => Failure::Failed(error.to_string()),
    }
}
