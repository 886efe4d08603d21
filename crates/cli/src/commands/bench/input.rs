//! What a suite says about one sequence and one configuration, as `i2slam run` is told.

use super::plan::{Setting, slug};
use super::suite::{Configuration, SequenceEntry};
use crate::commands::run::Run;
use crate::commands::run::with_flags;
use crate::commands::{Arguments, Command};
use crate::failure::Failure;
use clap::Parser;
use i2slam::config::line_of_key;
use i2slam::{Config, ConfigError};
use i2slam_eval::frame_list;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Which frames' pictures are judged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum List {
    /// The sharp frames that the pictures themselves show.
    Auto,
    /// Positions in the associated stream.
    Frames(Vec<usize>),
}

/// Flags that say how a sequence is read.
pub(super) fn input_flags(entry: &SequenceEntry, place: &impl Fn(&Path) -> PathBuf) -> Vec<String> {
    let mut flags = Vec::new();
    let mut add = |flag: &str, value: Option<String>| {
        if let Some(value) = value {
            flags.extend([flag.to_owned(), value]);
        }
    };
    add("--frames", entry.frames.clone());
    add("--stride", entry.stride.map(|n| n.to_string()));
    add("--scale", entry.scale.map(|s| s.to_string()));
    add("--camera", entry.camera.as_ref().map(|p| place(p).display().to_string()));
    add("--depth-scale", entry.depth_scale.map(|s| s.to_string()));
    if let Some(numbers) = entry.intrinsics {
        flags.push("--intrinsics".to_owned());
        flags.extend(numbers.map(|n| n.to_string()));
    }
    flags
}

/// A list by name or file, moved by `offset`.
pub(super) fn list(
    name: &str,
    offset: usize,
    place: &impl Fn(&Path) -> PathBuf,
) -> Result<List, String> {
    if name == "auto" {
        return Ok(List::Auto);
    }
    let file = place(Path::new(name));
    let text = match frame_list::published(name) {
        Some(text) if !file.is_file() => text.to_owned(),
        _ => std::fs::read_to_string(&file).map_err(|e| {
            format!("the list `{name}` is not published, and {}: {e}", file.display())
        })?,
    };
    let frames = frame_list::parse(&text);
    let frames = frames.map_err(|n| format!("list `{name}`, line {n} is no frame number"))?;
    Ok(List::Frames(frames.into_iter().map(|frame| frame + offset).collect()))
}

/// A configuration, checked as `i2slam run` would check it; `text` is the suite's, and `place` that
/// among its configurations.
pub(super) fn settings_of(
    entry: Configuration,
    origin: &str,
    text: &str,
    place: usize,
) -> Result<Setting, Failure> {
    let wrong = |key: Option<&str>, reason: String| {
        let at = line(text, place, key).map(|line| format!(", line {line}")).unwrap_or_default();
        Failure::Usage(format!("{origin}{at}, configuration `{}`: {reason}", entry.name))
    };
    let overrides = toml::to_string(&entry.config).map_err(|e| wrong(None, e.to_string()))?;
    // A preset inside `config` would hide the one that the results name.
    if entry.config.contains_key("preset") {
        return Err(wrong(Some("preset"), "`preset` stands beside `config`, not in it".to_owned()));
    }
    if entry.config.contains_key("seed") {
        return Err(wrong(Some("seed"), "the seeds of a suite are its `seeds`".to_owned()));
    }
    let config = Config::from_toml(&overrides, origin, Some(&entry.preset));
    let config = config.map_err(|error| wrong(error.key(), reason(&error)))?;
    let parsed = run_arguments(&entry.flags).map_err(|reason| wrong(None, reason))?;
    let config = with_flags(config, &parsed);
    let config = config.map_err(|e| wrong(None, e.message().unwrap_or_default().to_owned()))?;
    Ok(Setting { slug: slug(&entry.name), overrides, config, entry })
}

/// The line of a key of a configuration's `config`, else that of the configuration.
fn line(text: &str, place: usize, key: Option<&str>) -> Option<usize> {
    let place = place.to_string();
    let own = ["configuration", place.as_str()];
    let key = key.and_then(|key| {
        let path: Vec<&str> = own.into_iter().chain(["config"]).chain(key.split('.')).collect();
        line_of_key(text, &path)
    });
    key.or_else(|| line_of_key(text, &own))
}

/// Without the place: lines of overrides are not lines of the suite.
fn reason(error: &ConfigError) -> String {
    match error {
        ConfigError::UnknownKey { key, section, known, .. } => {
            format!("no setting is called `{key}`: `{section}` has {known}")
        }
        ConfigError::Malformed { message, .. } => message.clone(),
        ConfigError::WrongValue { key, message, .. } => format!("{key}: {message}"),
        ConfigError::OutOfRange { key, value, expected, .. } => {
            format!("{key} = {value} is out of range: {expected}")
        }
        other => other.to_string(),
    }
}

/// The flags as typed after everything that a cell sets itself.
pub(super) fn run_arguments(flags: &[String]) -> Result<Box<Run>, String> {
    let own = ["i2slam", "run", "D", "--out", "O", "--preset", "P", "--config", "C", "--seed", "0"];
    let more = ["--threads", "1", "--render", "all", "--quiet"];
    let own = own.iter().chain(&more).map(OsString::from);
    match Arguments::try_parse_from(own.chain(flags.iter().map(OsString::from))) {
        Ok(Arguments { command: Command::Run(run) }) => Ok(run),
        Ok(_) => Err("flags are those of `i2slam run`".to_owned()),
        Err(error) => {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or_default();
            Err(first.trim_start_matches("error: ").to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::Table;

    fn configuration(flags: &[&str], config: &str) -> Configuration {
        Configuration {
            name: "c".to_owned(),
            preset: "default".to_owned(),
            flags: flags.iter().map(|&flag| flag.to_owned()).collect(),
            config: config.parse::<Table>().expect("TOML"),
            series: None,
        }
    }

    #[test]
    fn flags_and_overrides_make_one_configuration() {
        let entry = configuration(&["--no-blur"], "[formation]\nvirtual_cameras = 7\n");
        let setting = settings_of(entry, "t", "", 0).expect("a configuration");
        assert!(!setting.config.formation.blur && setting.config.formation.tone);
        assert_eq!(setting.config.formation.virtual_cameras, 7);
    }

    #[test]
    fn mistakes_are_found_before_anything_runs() {
        let refused = |flags: &[&str], config: &str, word: &str| {
            let entry = configuration(flags, config);
            let failure = settings_of(entry, "t", "", 0).err().expect("a mistake");
            let message = failure.message().unwrap_or_default();
            assert!(message.contains("configuration `c`") && message.contains(word), "{message}");
        };
        refused(&["--sharpen"], "", "--sharpen");
        refused(&["--seed", "4"], "", "--seed");
        refused(&["--virtual-cameras", "0"], "", "virtual_cameras");
        refused(&[], "[mapping]\niteratons = 3\n", "iteratons");
        refused(&[], "seed = 3\n", "seeds");
        refused(&[], "preset = \"paper-tum\"\n", "preset");
    }

    #[test]
    fn mistakes_are_named_with_their_line_of_the_suite() {
        let text = "[[configuration]]\nname = \"a\"\n\n[[configuration]]\nname = \"c\"\n\
                    config.mapping.window = 0\n";
        let entry = configuration(&[], "[mapping]\nwindow = 0\n");
        let failure = settings_of(entry, "t.toml", text, 1).err().expect("a mistake");
        let expected = "t.toml, line 6, configuration `c`: mapping.window = 0 is out of range";
        assert!(failure.message().is_some_and(|m| m.starts_with(expected)), "{failure:?}");
        let entry = configuration(&["--sharpen"], "");
        let failure = settings_of(entry, "t.toml", text, 1).err().expect("a mistake");
        assert!(
            failure.message().is_some_and(|m| m.starts_with("t.toml, line 4, ")),
            "{failure:?}"
        );
    }

    #[test]
    fn lists_are_moved_to_the_frames_of_the_stream() {
        let place = |path: &Path| Path::new("/nowhere").join(path);
        let Ok(List::Frames(frames)) = list("scannet-0736-00", 1000, &place) else { panic!() };
        assert_eq!(frames[..2], [1070, 1115]);
        assert_eq!(list("auto", 0, &place), Ok(List::Auto));
        assert!(list("tum-fr9", 0, &place).unwrap_err().contains("tum-fr9"));
    }
}
