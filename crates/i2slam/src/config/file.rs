//! Settings as TOML files: reading, writing, and the help that printed presets carry.

use super::*;
use i2slam_storage::{line_at, nearest_key, shortened};
use std::path::Path;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

impl Config {
    /// Settings from a TOML file over those of its `preset`, else of `preset`, else `default`.
    pub fn from_toml_file(path: &Path, preset: Option<&str>) -> Result<Self, ConfigError> {
        Self::from_toml(&text(path)?, &path.display().to_string(), preset)
    }

    /// [`from_toml_file`](Self::from_toml_file) of a text; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str, preset: Option<&str>) -> Result<Self, ConfigError> {
        let source = Source { text, origin };
        Self::from_table(&source, source.table()?, preset)
    }

    /// Settings from the `config.toml` of a result. Keys and choices of earlier versions are ignored:
    /// the preset decides their values.
    pub fn from_stored(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let source = Source { text, origin };
        let mut table = source.table()?;
        for (name, section) in &mut table {
            if let Value::Table(section) = section {
                section.retain(|key, value| !is_removed(name, key, Some(value)));
            }
        }
        Self::from_table(&source, table, None)
    }

    /// [`from_stored`](Self::from_stored) of a file.
    pub fn from_stored_file(path: &Path) -> Result<Self, ConfigError> {
        Self::from_stored(&text(path)?, &path.display().to_string())
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
        let base = Self::preset(&name).map_err(|error| match changes.contains_key("preset") {
            true => source.wrong("preset", &error.to_string()),
            false => error,
        });
        let base = Table::try_from(base?);
        let base = base.map_err(|e| source.malformed(&e.to_string()))?;
        let mut table = base.clone();
        source.merge(&mut table, &changes, "").map_err(|error| with_hint(error, &base))?;
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

    /// [`to_toml`](Self::to_toml) with the help of every key as comments.
    pub fn to_commented_toml(&self) -> String {
        let mut text = String::from(
            "# A file for --config: keep what you change, the rest is that of the preset. \"Paper\" is\n\
             # its appendix A; values of `default` and `default-rgb` are ours.\n\n",
        );
        let mut section = String::new();
        for line in self.to_toml().lines() {
            if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                comment(&mut text, &help("", name));
                name.clone_into(&mut section);
            } else if let Some((key, _)) = line.split_once(" = ") {
                comment(&mut text, &help(&section, key));
            }
            text += line;
            text.push('\n');
        }
        text
    }
}

impl ConfigError {
    /// The error with the place of its key in the file that the settings came from; unchanged where
    /// it has one, or the file cannot be read.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        let origin = path.display().to_string();
        match text(path) {
            Ok(text) => Source { text: &text, origin: &origin }.placed(self),
            Err(_) => self,
        }
    }
}

fn text(path: &Path) -> Result<String, ConfigError> {
    let text = i2slam_storage::read_text(path);
    text.map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })
}

/// Columns of a comment.
const COMMENT_WIDTH: usize = 96;

/// Help of a key, or with an empty `section` of a section; empty if there is none.
fn help(section: &str, key: &str) -> String {
    let keys = match section {
        "" => Config::HELP,
        "input" => InputConfig::HELP,
        "formation" => FormationConfig::HELP,
        "map" => MapConfig::HELP,
        "hashgrid" => HashGridConfig::HELP,
        "keyframed" => KeyframedConfig::HELP,
        "tracking" => TrackingConfig::HELP,
        "mapping" => MappingConfig::HELP,
        _ => &[],
    };
    keys.iter().find(|(name, _)| *name == key).map_or_else(String::new, |(_, lines)| lines.concat())
}

/// Appends `words` as lines of a comment.
fn comment(text: &mut String, words: &str) {
    let mut line = String::new();
    for word in words.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COMMENT_WIDTH {
            *text += &format!("#{line}\n");
            line.clear();
        }
        line.push(' ');
        line += word;
    }
    if !line.is_empty() {
        *text += &format!("#{line}\n");
    }
}

/// Keys of earlier versions, by section, whose values the preset decides.
const REMOVED_KEYS: [(&str, &str); 6] = [
    ("formation", "response_node_power response_prior tone_rate"),
    ("map", "initial_scale initial_opacity screen_variance"),
    (
        "hashgrid",
        "margin levels moment_jitter hidden_width occupancy_cells shell step step_min \
         rate image_weight depth_weight",
    ),
    (
        "keyframed",
        "first_keyframes camera_rate pose_delay preconditioning_damping \
         preconditioning_interval trajectory_weight initial_split depth_outlier \
         surface_depth_weight surface_depth_left surface_camera_rate surface_steps \
         surface_samples surface_detail surface_cell surface_growth surface_searches \
         coarse_steps",
    ),
    (
        "tracking",
        "rotation_rate translation_rate velocity_rotation_share \
         velocity_translation_share silhouette_threshold image_weight depth_weight \
         initial_split alignment",
    ),
    (
        "mapping",
        "image_weight ssim_share mean_rate colour_rate opacity_rate scale_rate \
         rotation_rate pose_rotation_rate pose_translation_rate exposure_rate \
         white_balance_rate response_rate densify_opacity densify_depth_medians \
         prune_opacity prune_scale scene_radius_ratio only_seen fresh_optimizer \
         beside_tracking",
    ),
];

/// Values of earlier versions that no key takes any more.
const REMOVED_VALUES: [(&str, &str, &str); 2] =
    [("formation", "blur_model", "splat"), ("formation", "response_start", "gamma22")];

/// Whether an earlier version had a key, or a `value` of it, that this one has not.
fn is_removed(section: &str, key: &str, value: Option<&Value>) -> bool {
    let value = value.and_then(Value::as_str);
    let mut keys = REMOVED_KEYS.iter().filter(|(name, _)| *name == section);
    keys.any(|(_, keys)| keys.split_whitespace().any(|removed| removed == key))
        || value.is_some_and(|value| REMOVED_VALUES.contains(&(section, key, value)))
}

/// TOML text and its name in errors.
struct Source<'a> {
    text: &'a str,
    origin: &'a str,
}

impl Source<'_> {
    fn malformed(&self, message: &str) -> ConfigError {
        let message = shortened(message.trim_end());
        ConfigError::Malformed { origin: self.origin.to_owned(), message }
    }

    fn table(&self) -> Result<Table, ConfigError> {
        self.text.parse().map_err(|error: toml::de::Error| {
            let line = error.span().map(|at| format!(", line {}", line_at(self.text, at.start)));
            let origin = self.origin.to_owned() + &line.unwrap_or_default();
            Source { origin: &origin, ..*self }.malformed(error.message())
        })
    }

    fn line(&self, key: &str) -> Option<usize> {
        line_of_key(self.text, &key.split('.').collect::<Vec<_>>())
    }

    fn wrong(&self, key: &str, message: &str) -> ConfigError {
        let (place, key) = (self.place(key), key.to_owned());
        ConfigError::WrongValue { place, key, message: in_words(&shortened(message.trim_end())) }
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
            ConfigError::TooMuchMemory { key, value, memory, .. } => {
                ConfigError::TooMuchMemory { place: self.place(key), key, value, memory }
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
                (None, _) if is_removed(path, name, None) => {
                    return Err(ConfigError::RemovedKey { place: self.place(&key), key });
                }
                (None, _) => {
                    return Err(ConfigError::UnknownKey {
                        origin: self.origin.to_owned(),
                        line: self.line(&key).unwrap_or(1),
                        key: shortened(&key),
                        hint: Box::default(),
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

/// The error with the setting that an unknown key may mean.
fn with_hint(mut error: ConfigError, base: &Table) -> ConfigError {
    if let ConfigError::UnknownKey { key, hint, .. } = &mut error {
        let known = leaves(base, "").into_iter().map(|(known, _)| known);
        let known: Vec<String> = known.chain(base.keys().cloned()).collect();
        let nearest = nearest_key(key, known.iter().map(String::as_str));
        *hint =
            nearest.map(|known| format!(", did you mean `{known}`?").into()).unwrap_or_default();
    }
    error
}

/// Names types in a message of the parser as a user would.
fn in_words(message: &str) -> String {
    let types = [
        ("expected usize", "expected a whole number of at least 0"),
        ("expected u32", "expected a whole number of 0 to 4294967295"),
        ("expected u64", "expected a whole number of at least 0"),
        ("expected f32", "expected a number"),
        ("expected f64", "expected a number"),
        ("expected a boolean", "expected true or false"),
    ];
    types.iter().fold(message.to_owned(), |words, (name, plain)| words.replace(name, plain))
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

/// Line, counted from 1, of the key at `path`: names of tables and keys, or the index of a table in
/// an array of tables. `None` without such a key, or of text that is not TOML.
pub fn line_of_key(text: &str, path: &[&str]) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let at = in_table(table.get_ref(), path)?;
    Some(line_at(text, at))
}

/// Byte at which the key begins.
fn in_table(table: &DeTable<'_>, path: &[&str]) -> Option<usize> {
    let (first, rest) = path.split_first()?;
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == *first)?;
    if rest.is_empty() { Some(key.span().start) } else { in_value(value.get_ref(), rest) }
}

fn in_value(value: &DeValue<'_>, path: &[&str]) -> Option<usize> {
    match value {
        DeValue::Table(table) => in_table(table, path),
        DeValue::Array(array) => {
            let (place, rest) = path.split_first()?;
            let element = array.get(place.parse::<usize>().ok()?)?;
            if rest.is_empty() {
                Some(element.span().start)
            } else {
                in_value(element.get_ref(), rest)
            }
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_changes_single_values_of_a_preset() {
        let text = "preset = \"paper-tum\"\n[mapping]\ndepth_weight = 2\n";
        let config = Config::from_toml(text, "test", None).expect("valid");
        assert_eq!(config.mapping.depth_weight, 2.0);
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
        let refused = |text: &str, expected: &str| {
            let message = Config::from_toml(text, "a.toml", None).expect_err("old").to_string();
            assert!(message.starts_with(expected), "{message}");
        };
        let expected = "a.toml, line 3: tracking.rotation_rate is no longer a setting";
        refused("[tracking]\n\nrotation_rate = 1.0\n", expected);
        refused(
            "tracking.alignment.levels = 2\n",
            "a.toml, line 1: tracking.alignment is no longer",
        );
        let text = "preset = \"paper-tum\"\n[formation]\nblur_model = \"splat\"\n\
                    [tracking]\nrotation_rate = 1.0\n[tracking.alignment]\nlevels = 2\n";
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
        refused(&value("window.x = 1"), "a.toml, line 5: ", "key");
        refused("[mapping\n", "a.toml, line 1: ", "]");
        refused(&value("iterations = -1"), "a.toml, line 5: mapping.iterations: ", "-1");
        refused(
            &value("hold_out = 1"),
            "a.toml, line 5: mapping.hold_out = 1 is out",
            "2 to 1000000, or 0 for none",
        );
        let other = "[hashgrid]\niterations = 1\n[mapping]\ndepth_weight = -1\n";
        refused(other, "a.toml, line 4: mapping.depth_weight = -1 is out", "0 to 1000000000000");
        refused("mapping = 3\n", "a.toml, line 1: mapping: ", "section");
        refused("preset = 3\n", "a.toml, line 1: preset: ", "string");
        refused(
            "\npreset = \"x\"\n",
            "a.toml, line 2: preset: no preset is called `x`",
            "paper-tum",
        );
        let model = "formation.blur_model = \"blurry\"\n";
        refused(model, "a.toml, line 1: formation.blur_model: ", "image");
        // Two values that do not go together.
        let both = "input.rolling_shutter_readout = 0.02\nformation.blur_model = \"exact\"\n";
        refused(both, "a.toml, line 2: formation.blur_model = \"exact\"", "every row");
    }

    #[test]
    fn keys_are_found_however_they_are_written() {
        let text = "seed = 1\n\n[map]\nkind = \"x\"\n[mapping]\nmap.kind = 3\ninner = { a = 1,\n \
                    b = 2 }\n[[row]]\nname = \"one\"\n\n[[row]]\n# two\nname = \"two\"\n";
        let line = |path: &[&str]| line_of_key(text, path);
        assert_eq!(line(&["seed"]), Some(1));
        assert_eq!(line(&["map", "kind"]), Some(4));
        assert_eq!(line(&["mapping", "map", "kind"]), Some(6));
        assert_eq!(line(&["mapping", "inner", "b"]), Some(8));
        assert_eq!(line(&["row", "1", "name"]), Some(14));
        assert_eq!(line(&["row", "1"]), Some(12));
        assert_eq!(line(&["row", "2"]), None);
        assert_eq!(line(&["seed", "deeper"]), None);
        assert_eq!(line_of_key("a = [", &["a"]), None);
    }

    #[test]
    fn every_key_has_help_that_changes_no_value() {
        for name in PRESET_NAMES {
            let config = Config::preset(name).expect("known");
            let text = config.to_commented_toml();
            assert_eq!(Config::from_toml(&text, "test", None).ok(), Some(config));
            let mut last = "";
            for line in text.lines() {
                assert!(line.chars().count() <= COMMENT_WIDTH + 2, "{line}");
                let is_key = line.contains(" = ") && !line.starts_with('#');
                let needs_help = is_key && !line.starts_with("i2slam_version");
                assert!(!needs_help || last.starts_with("# "), "{line} has no help");
                last = line;
            }
        }
    }
}
