//! Reading and writing settings.

use super::*;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// What can be wrong with settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// No preset has this name.
    #[error("no preset is called `{name}`: choose one of {}", PRESET_NAMES.join(", "))]
    UnknownPreset {
        /// What was asked for.
        name: String,
    },
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML.
    #[error("{origin}: {message}")]
    Malformed {
        /// File name.
        origin: String,
        /// The parser's words.
        message: String,
    },
    /// A key that no setting has.
    #[error("{origin}, line {line}: no setting is called `{key}`: `{section}` has {known}")]
    UnknownKey {
        /// File name.
        origin: String,
        /// Line, counted from 1.
        line: usize,
        /// The key with its section.
        key: String,
        /// Section it stands in.
        section: String,
        /// The keys of that section.
        known: String,
    },
    /// A key of an earlier version whose value is no setting any more.
    #[error("{place}{key} is no longer a setting: the preset decides it")]
    RemovedKey {
        /// File name and line, with `: `.
        place: String,
        /// Key with section.
        key: String,
    },
    /// A value of another type, or none of the names that a setting takes.
    #[error("{place}{key}: {message}")]
    WrongValue {
        /// File name and line, with `: `.
        place: String,
        /// Key with section.
        key: String,
        /// The parser's words.
        message: String,
    },
    /// A value outside its range.
    #[error("{place}{key} = {value} is out of range: {expected}")]
    OutOfRange {
        /// File name and line, with `: `; empty where no file is to blame.
        place: String,
        /// Key with section.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
}

impl ConfigError {
    /// The key that is to blame, with its section.
    pub fn key(&self) -> Option<&str> {
        match self {
            Self::UnknownKey { key, .. }
            | Self::RemovedKey { key, .. }
            | Self::WrongValue { key, .. } => Some(key),
            Self::OutOfRange { key, .. } => Some(key),
            _ => None,
        }
    }
}

impl Config {
    /// Settings from a TOML file: `preset` names the start (default: `default`), every other
    /// key replaces one value of it.
    pub fn from_toml_file(path: &Path) -> Result<Self, ConfigError> {
        Self::from_toml_file_on(path, None)
    }

    /// As [`from_toml_file`](Self::from_toml_file), starting from `preset` unless the file names
    /// another one.
    pub fn from_toml_file_on(path: &Path, preset: Option<&str>) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text, &path.display().to_string(), preset)
    }

    /// Settings from TOML text; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str, preset: Option<&str>) -> Result<Self, ConfigError> {
        let source = Source { text, origin };
        Self::from_table(&source, source.table()?, preset)
    }

    /// Settings from the `config.toml` of a result. Keys that an earlier version wrote and that are
    /// settings no more are ignored: the preset decides their values.
    pub fn from_stored(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let source = Source { text, origin };
        let mut table = source.table()?;
        for key in removed_keys() {
            remove(&mut table, &key);
        }
        Self::from_table(&source, table, None)
    }

    fn from_table(
        source: &Source<'_>,
        mut changes: Table,
        preset: Option<&str>,
    ) -> Result<Self, ConfigError> {
        // `i2slam_version` is written for the reader of a result and has no effect.
        changes.remove("i2slam_version");
        let name = match changes.get("preset") {
            Some(Value::String(name)) => name.clone(),
            Some(_) => return Err(source.wrong("preset", "must be a string")),
            None => preset.unwrap_or("default").to_owned(),
        };
        let base = Table::try_from(Self::preset(&name)?);
        let base = base.map_err(|e| source.malformed(&e.to_string()))?;
        let mut table = base.clone();
        source.merge(&mut table, &changes, "")?;
        let config: Result<Self, _> = table.try_into();
        let mut config = config.map_err(|e| source.first_wrong(&base, &changes, e.message()))?;
        config.parameters = Parameters::of_preset(&name);
        config.validate().map_err(|error| source.placed(error))?;
        Ok(config)
    }

    /// The settings as TOML, with the version that wrote them.
    pub fn to_toml(&self) -> String {
        let body = toml::to_string(self).unwrap_or_default();
        format!("i2slam_version = \"{}\"\n{body}", env!("CARGO_PKG_VERSION"))
    }
}

/// Keys of earlier versions, by section, whose values the preset decides.
const REMOVED: [(&str, &[&str]); 7] = [
    (
        "hashgrid",
        &[
            "margin",
            "levels",
            "moment_jitter",
            "hidden_width",
            "occupancy_cells",
            "shell",
            "step",
            "step_min",
            "rate",
            "image_weight",
            "depth_weight",
        ],
    ),
    (
        "keyframed",
        &[
            "first_keyframes",
            "camera_rate",
            "pose_delay",
            "preconditioning_damping",
            "preconditioning_interval",
            "trajectory_weight",
            "initial_split",
            "depth_outlier",
            "surface_depth_weight",
            "surface_depth_left",
            "surface_camera_rate",
            "surface_steps",
            "surface_samples",
            "surface_detail",
            "surface_cell",
            "surface_growth",
            "surface_searches",
            "coarse_steps",
        ],
    ),
    ("formation", &["response_node_power", "response_prior", "tone_rate"]),
    ("map", &["initial_scale", "initial_opacity", "screen_variance"]),
    (
        "mapping",
        &[
            "image_weight",
            "ssim_share",
            "mean_rate",
            "colour_rate",
            "opacity_rate",
            "scale_rate",
            "rotation_rate",
            "pose_rotation_rate",
            "pose_translation_rate",
            "exposure_rate",
            "white_balance_rate",
            "response_rate",
            "densify_opacity",
            "densify_depth_medians",
            "prune_opacity",
            "prune_scale",
            "scene_radius_ratio",
            "only_seen",
            "fresh_optimizer",
        ],
    ),
    (
        "tracking",
        &[
            "rotation_rate",
            "translation_rate",
            "velocity_rotation_share",
            "velocity_translation_share",
            "silhouette_threshold",
            "image_weight",
            "depth_weight",
            "initial_split",
        ],
    ),
    (
        "tracking.alignment",
        &[
            "levels",
            "iterations",
            "keyframe_depth",
            "renders",
            "depth_scale_floor",
            "image_scale_floor",
            "image_weight",
            "motion_prior",
            "white_balance_inertia",
        ],
    ),
];

fn removed_keys() -> impl Iterator<Item = String> {
    REMOVED.iter().flat_map(|(section, keys)| keys.iter().map(move |key| joined(section, key)))
}

/// Removes a key from a table, and its section if that is empty then.
fn remove(table: &mut Table, key: &str) {
    let Some((section, rest)) = key.split_once('.') else {
        table.remove(key);
        return;
    };
    if let Some(Value::Table(inner)) = table.get_mut(section) {
        remove(inner, rest);
        if inner.is_empty() {
            table.remove(section);
        }
    }
}

/// The text that settings are read from, and its name in errors.
struct Source<'a> {
    text: &'a str,
    origin: &'a str,
}

impl Source<'_> {
    fn malformed(&self, message: &str) -> ConfigError {
        let message = message.trim_end().to_owned();
        ConfigError::Malformed { origin: self.origin.to_owned(), message }
    }

    fn table(&self) -> Result<Table, ConfigError> {
        self.text.parse().map_err(|e: toml::de::Error| self.malformed(&e.to_string()))
    }

    fn line(&self, key: &str) -> Option<usize> {
        line_of_key(self.text, &key.split('.').collect::<Vec<_>>())
    }

    fn wrong(&self, key: &str, message: &str) -> ConfigError {
        let (place, key) = (self.place(key), key.to_owned());
        ConfigError::WrongValue { place, key, message: in_words(message.trim_end()) }
    }

    /// `FILE, line N: `, or without a line where the file does not name the key.
    fn place(&self, key: &str) -> String {
        let line = self.line(key).map(|line| format!(", line {line}")).unwrap_or_default();
        format!("{}{line}: ", self.origin)
    }

    /// The error with the place of its key.
    fn placed(&self, error: ConfigError) -> ConfigError {
        match error {
            ConfigError::OutOfRange { key, value, expected, .. } => {
                ConfigError::OutOfRange { place: self.place(key), key, value, expected }
            }
            other => other,
        }
    }

    /// Puts `changes` over the values of `base`, which is the table at `path`.
    fn merge(&self, base: &mut Table, changes: &Table, path: &str) -> Result<(), ConfigError> {
        let known: Vec<String> = base.keys().cloned().collect();
        for (name, value) in changes {
            let key = joined(path, name);
            match (base.get_mut(name), value) {
                (None, _) if removed_keys().any(|removed| leads_to(&removed, &key)) => {
                    return Err(ConfigError::RemovedKey { place: self.place(&key), key });
                }
                (None, _) => {
                    return Err(ConfigError::UnknownKey {
                        origin: self.origin.to_owned(),
                        line: self.line(&key).unwrap_or(1),
                        key,
                        section: if path.is_empty() { "the top level" } else { path }.to_owned(),
                        known: known.join(", "),
                    });
                }
                (Some(Value::Table(inner)), Value::Table(changes)) => {
                    self.merge(inner, changes, &key)?;
                }
                (Some(Value::Table(_)), _) => {
                    return Err(self.wrong(&key, "is a section, not a value"));
                }
                (Some(Value::Float(old)), Value::Integer(new)) => *old = *new as f64,
                (Some(old), new) => *old = new.clone(),
            }
        }
        Ok(())
    }

    /// The first single change that makes no settings of `base`; `otherwise` if it takes several.
    fn first_wrong(&self, base: &Table, changes: &Table, otherwise: &str) -> ConfigError {
        for (key, single) in leaves(changes, "") {
            let mut table = base.clone();
            let merged = self.merge(&mut table, &single, "");
            let read: Result<Config, toml::de::Error> = table.try_into();
            if let (Ok(()), Err(error)) = (merged, read) {
                return self.wrong(&key, error.message());
            }
        }
        self.malformed(otherwise)
    }
}

/// The parser's words, with types as a user would name them.
fn in_words(message: &str) -> String {
    let types = [
        ("expected usize", "expected a whole number of at least 0"),
        ("expected u32", "expected a whole number of at least 0"),
        ("expected u64", "expected a whole number of at least 0"),
        ("expected f32", "expected a number"),
        ("expected f64", "expected a number"),
        ("expected a boolean", "expected true or false"),
    ];
    types.iter().fold(message.to_owned(), |words, (name, plain)| words.replace(name, plain))
}

/// Whether `key` is `removed` or the section that held it.
fn leads_to(removed: &str, key: &str) -> bool {
    removed.strip_prefix(key).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

fn joined(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
}

/// Every value of a table alone, in the tables that hold it, by its key.
fn leaves(table: &Table, path: &str) -> Vec<(String, Table)> {
    let mut all = Vec::new();
    for (name, value) in table {
        let key = joined(path, name);
        match value {
            Value::Table(inner) => {
                all.extend(leaves(inner, &key).into_iter().map(|(key, single)| {
                    (key, Table::from_iter([(name.clone(), Value::Table(single))]))
                }));
            }
            value => all.push((key, Table::from_iter([(name.clone(), value.clone())]))),
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let config = Config::preset("paper-tum").expect("known");
        let back = Config::from_toml(&config.to_toml(), "test", None).expect("valid");
        assert_eq!(config, back);
    }

    #[test]
    fn a_file_changes_single_values_of_a_preset() {
        let text = "preset = \"paper-tum\"\n[mapping]\ndepth_weight = 1\n";
        let config = Config::from_toml(text, "test", None).expect("valid");
        assert_eq!(config.mapping.depth_weight, 1.0);
        assert_eq!(config.mapping.window, 20);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let text = "[mapping]\nwindow = 3\nwindoww = 4\n";
        let message = Config::from_toml(text, "a.toml", None).expect_err("bad").to_string();
        assert!(message.contains("a.toml, line 3") && message.contains("windoww"), "{message}");
    }

    #[test]
    fn a_removed_key_is_refused_and_ignored_in_results() {
        let text = "preset = \"paper-tum\"\n[tracking]\nrotation_rate = 1.0\n\
                    [tracking.alignment]\nlevels = 2\n";
        let message = Config::from_toml(text, "a.toml", None).expect_err("old").to_string();
        assert!(message.contains("alignment is no longer a setting"), "{message}");
        let rate = "[tracking]\n\nrotation_rate = 1.0\n";
        let message = Config::from_toml(rate, "a.toml", None).expect_err("old").to_string();
        let expected = "a.toml, line 3: tracking.rotation_rate is no longer a setting";
        assert!(message.starts_with(expected), "{message}");
        let stored = Config::from_stored(text, "a.toml").expect("readable");
        assert_eq!(stored, Config::preset("paper-tum").expect("known"));
    }

    #[test]
    fn a_bad_value_is_named_with_its_line() {
        let refused = |text: &str, place: &str, words: &str| {
            let message = Config::from_toml(text, "a.toml", None).expect_err(text).to_string();
            assert!(message.starts_with(place) && message.contains(words), "{message}");
        };
        let head = "[formation]\nblur = true\n[mapping]\nwindow = 3\n";
        let value = |line: &str| format!("{head}{line}\n");
        refused(
            &value("depth_weight = \"x\""),
            "a.toml, line 5: mapping.depth_weight: ",
            "a number",
        );
        refused(&value("window.x = 1"), "a.toml", "window");
        refused(&value("iterations = -1"), "a.toml, line 5: mapping.iterations: ", "-1");
        refused(
            &value("hold_out = 1"),
            "a.toml, line 5: mapping.hold_out = 1 is out",
            "2 and more",
        );
        let other = "[hashgrid]\niterations = 1\n[mapping]\ndepth_weight = -1\n";
        refused(other, "a.toml, line 4: mapping.depth_weight = -1 is out", "at least 0");
        refused("mapping = 3\n", "a.toml, line 1: mapping: ", "section");
        refused("preset = 3\n", "a.toml, line 1: preset: ", "string");
        let model = "formation.blur_model = \"blurry\"\n";
        refused(model, "a.toml, line 1: formation.blur_model: ", "image");
        // Two values that do not go together.
        let both = "input.rolling_shutter_readout = 0.02\nformation.blur_model = \"exact\"\n";
        refused(both, "a.toml, line 2: formation.blur_model = \"exact\"", "every row");
    }
}
