//! Reading, checking and writing settings.

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
    /// The text is not TOML, or a value has the wrong type.
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
    /// A value outside its range.
    #[error("{key} = {value} is out of range: {expected}")]
    OutOfRange {
        /// Key with section.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
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
        let malformed = |message: String| ConfigError::Malformed {
            origin: origin.to_owned(),
            message: message.trim_end().to_owned(),
        };
        let mut changes: Table =
            text.parse().map_err(|e: toml::de::Error| malformed(e.to_string()))?;
        // `i2slam_version` is written for the reader of a result and has no effect.
        changes.remove("i2slam_version");
        let name = match changes.get("preset") {
            Some(Value::String(name)) => name.clone(),
            Some(_) => return Err(malformed("`preset` must be a string".to_owned())),
            None => preset.unwrap_or("default").to_owned(),
        };
        let mut table =
            Table::try_from(Self::preset(&name)?).map_err(|e| malformed(e.to_string()))?;
        merge(&mut table, changes, "the top level", text, origin)?;
        let config: Self = table.try_into().map_err(|e| malformed(e.to_string()))?;
        config.validate()?;
        Ok(config)
    }

    /// The settings as TOML, with the version that wrote them.
    pub fn to_toml(&self) -> String {
        let body = toml::to_string(self).unwrap_or_default();
        format!("i2slam_version = \"{}\"\n{body}", env!("CARGO_PKG_VERSION"))
    }

    /// Whether every value is in its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let f = &self.formation;
        between("formation.virtual_cameras", f.virtual_cameras, 1, 64, "1 to 64")?;
        if !matches!(f.response_curves, 1 | 3) {
            return Err(ConfigError::OutOfRange {
                key: "formation.response_curves",
                value: f.response_curves.to_string(),
                expected: "1 or 3",
            });
        }
        let a = &self.tracking.alignment;
        between("tracking.alignment.levels", a.levels, 1, 8, "1 to 8")?;
        let refined = self.tracking.method == TrackingMethod::Adam || self.tracking.iterations > 0;
        if self.input.depth_stamps && refined {
            return Err(ConfigError::OutOfRange {
                key: "input.depth_stamps",
                value: "true".to_owned(),
                expected: "false, or tracking.method \"second-order\" with tracking.iterations 0: \
                           first-order tracking compares depth at the best pose of the exposure",
            });
        }
        self.validate_rolling_shutter()?;
        match self.tracking.method {
            TrackingMethod::Adam => at_least("tracking.iterations", self.tracking.iterations, 1)?,
            TrackingMethod::SecondOrder => {
                between("tracking.alignment.iterations", a.iterations, 2, 1000, "2 to 1000")?;
            }
        }
        positive("tracking.alignment.depth_scale_floor", a.depth_scale_floor)?;
        positive("tracking.alignment.image_scale_floor", a.image_scale_floor)?;
        at_least("tracking.alignment.renders", self.tracking.alignment.renders, 1)?;
        at_least("mapping.interval", self.mapping.interval, 1)?;
        if self.mapping.hold_out == 1 {
            return Err(ConfigError::OutOfRange {
                key: "mapping.hold_out",
                value: "1".to_owned(),
                expected: "0 for none, or 2 and more: a map needs frames",
            });
        }
        at_least("mapping.window", self.mapping.window, 1)?;
        at_least("mapping.keyframe_interval", self.mapping.keyframe_interval, 1)?;
        at_least("map.capacity", self.map.capacity, 1)?;
        positive("formation.response_node_power", f.response_node_power)?;
        positive("map.initial_scale", self.map.initial_scale)?;
        positive("map.screen_variance", self.map.screen_variance)?;
        positive("mapping.scene_radius_ratio", self.mapping.scene_radius_ratio)?;
        inside("map.initial_opacity", self.map.initial_opacity)?;
        inside("mapping.prune_opacity", self.mapping.prune_opacity)?;
        self.validate_hashgrid()?;
        if i64::try_from(self.seed).is_err() {
            return Err(ConfigError::OutOfRange {
                key: "seed",
                value: self.seed.to_string(),
                expected: "at most 2^63 - 1",
            });
        }
        share("tracking.silhouette_threshold", self.tracking.silhouette_threshold)?;
        share("mapping.ssim_share", self.mapping.ssim_share)?;
        self.rates().into_iter().try_for_each(|(key, value)| not_negative(key, value))
    }

    fn validate_hashgrid(&self) -> Result<(), ConfigError> {
        let h = &self.hashgrid;
        between("hashgrid.levels", h.levels, 1, 32, "1 to 32")?;
        between("hashgrid.log2_table", h.log2_table as usize, 4, 24, "4 to 24")?;
        between("hashgrid.hidden_width", h.hidden_width, 1, 1024, "1 to 1024")?;
        between("hashgrid.occupancy_cells", h.occupancy_cells as usize, 1, 512, "1 to 512")?;
        at_least("hashgrid.rays", h.rays, 1)?;
        positive("hashgrid.margin", h.margin)?;
        positive("hashgrid.finest_cell", h.finest_cell)?;
        positive("hashgrid.step_min", h.step_min)?;
        inside("hashgrid.shell", h.shell)?;
        if self.map.kind == MapKind::HashGrid && self.formation.blur_model == BlurModel::Splat {
            return Err(ConfigError::OutOfRange {
                key: "formation.blur_model",
                value: "splat".to_owned(),
                expected: "exact, image or auto with map.kind \"hashgrid\": a field has no splats",
            });
        }
        Ok(())
    }

    /// Rows that are read in turn are seen by the motion over the exposure, continued.
    fn validate_rolling_shutter(&self) -> Result<(), ConfigError> {
        let (input, formation) = (&self.input, &self.formation);
        let refuse =
            |key, value: String, expected| Err(ConfigError::OutOfRange { key, value, expected });
        let (readout, key) = (input.rolling_shutter_readout, "input.rolling_shutter_readout");
        if !(-1.0..=1.0).contains(&readout) {
            return refuse(key, readout.to_string(), "-1 to 1 [s]");
        }
        if !input.is_rolling() {
            return Ok(());
        }
        if !formation.blur {
            let expected = "true with a rolling shutter: rows are seen along the exposure's motion";
            return refuse("formation.blur", "false".to_owned(), expected);
        }
        if formation.blur_model == BlurModel::Exact {
            let expected = "\"image\", \"splat\" or \"auto\" with a rolling shutter: \"exact\" would \
                            need a render for every row";
            return refuse("formation.blur_model", "\"exact\"".to_owned(), expected);
        }
        if self.map.kind == MapKind::HashGrid && formation.blur_model != BlurModel::Image {
            let expected = "\"image\" with a rolling shutter and map.kind \"hashgrid\"";
            return refuse("formation.blur_model", "\"auto\"".to_owned(), expected);
        }
        if input.optimise_rolling_shutter && self.tracking.method == TrackingMethod::Adam {
            let expected = "false, or tracking.method \"second-order\"";
            return refuse("input.optimise_rolling_shutter", "true".to_owned(), expected);
        }
        Ok(())
    }

    fn rates(&self) -> [(&'static str, f32); 35] {
        let (f, t, m) = (&self.formation, &self.tracking, &self.mapping);
        [
            ("hashgrid.bound", self.hashgrid.bound),
            ("hashgrid.step", self.hashgrid.step),
            ("hashgrid.rate", self.hashgrid.rate),
            ("hashgrid.image_weight", self.hashgrid.image_weight),
            ("hashgrid.depth_weight", self.hashgrid.depth_weight),
            ("formation.tone_rate", f.tone_rate),
            ("formation.blur_per_camera", f.blur_per_camera),
            ("formation.response_prior", f.response_prior),
            ("tracking.rotation_rate", t.rotation_rate),
            ("tracking.translation_rate", t.translation_rate),
            ("tracking.image_weight", t.image_weight),
            ("tracking.depth_weight", t.depth_weight),
            ("tracking.trajectory_weight", t.trajectory_weight),
            ("mapping.mean_rate", m.mean_rate),
            ("mapping.colour_rate", m.colour_rate),
            ("mapping.opacity_rate", m.opacity_rate),
            ("mapping.scale_rate", m.scale_rate),
            ("mapping.tone_rate", m.tone_rate),
            ("mapping.response_rate", m.response_rate),
            ("mapping.pose_rotation_rate", m.pose_rotation_rate),
            ("mapping.pose_translation_rate", m.pose_translation_rate),
            ("mapping.rotation_rate", m.rotation_rate),
            ("mapping.image_weight", m.image_weight),
            ("mapping.depth_weight", m.depth_weight),
            ("mapping.densify_opacity", m.densify_opacity),
            ("mapping.densify_depth_medians", m.densify_depth_medians),
            ("mapping.prune_scale", m.prune_scale),
            ("mapping.keyframe_motion", m.keyframe_motion),
            ("mapping.seconds_per_frame", m.seconds_per_frame),
            ("tracking.initial_split", t.initial_split),
            ("tracking.velocity_rotation_share", t.velocity_rotation_share),
            ("tracking.velocity_translation_share", t.velocity_translation_share),
            ("tracking.alignment.image_weight", t.alignment.image_weight),
            ("tracking.alignment.motion_prior", t.alignment.motion_prior),
            ("tracking.alignment.white_balance_inertia", t.alignment.white_balance_inertia),
        ]
    }
}

fn merge(
    base: &mut Table,
    changes: Table,
    section: &str,
    text: &str,
    origin: &str,
) -> Result<(), ConfigError> {
    for (key, value) in changes {
        let known = || base.keys().cloned().collect::<Vec<_>>().join(", ");
        let unknown = |known: String| ConfigError::UnknownKey {
            origin: origin.to_owned(),
            line: line_of(text, &key),
            key: key.clone(),
            section: section.to_owned(),
            known,
        };
        let known_keys = known();
        match (base.get_mut(&key), value) {
            (None, _) => return Err(unknown(known_keys)),
            (Some(Value::Table(inner)), Value::Table(changes)) => {
                merge(inner, changes, &key, text, origin)?;
            }
            (Some(Value::Float(old)), Value::Integer(new)) => *old = new as f64,
            (Some(old), new) => *old = new,
        }
    }
    Ok(())
}

fn line_of(text: &str, key: &str) -> usize {
    let names_key = |line: &str| {
        let line = line.trim_start().trim_start_matches('[');
        line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with(['=', ']', '.']))
    };
    text.lines().position(names_key).map_or(1, |i| i + 1)
}

fn at_least(key: &'static str, value: usize, least: usize) -> Result<(), ConfigError> {
    let expected = "at least 1";
    let error = || ConfigError::OutOfRange { key, value: value.to_string(), expected };
    (value >= least).then_some(()).ok_or_else(error)
}

fn check(
    key: &'static str,
    value: f32,
    good: bool,
    expected: &'static str,
) -> Result<(), ConfigError> {
    let error = || ConfigError::OutOfRange { key, value: value.to_string(), expected };
    good.then_some(()).ok_or_else(error)
}

fn positive(key: &'static str, value: f32) -> Result<(), ConfigError> {
    check(key, value, value > 0.0 && value.is_finite(), "a number above 0")
}

fn not_negative(key: &'static str, value: f32) -> Result<(), ConfigError> {
    check(key, value, value >= 0.0 && value.is_finite(), "a number of at least 0")
}

fn inside(key: &'static str, value: f32) -> Result<(), ConfigError> {
    check(key, value, value > 0.0 && value < 1.0, "above 0 and below 1")
}

fn between(
    key: &'static str,
    value: usize,
    least: usize,
    most: usize,
    expected: &'static str,
) -> Result<(), ConfigError> {
    let error = || ConfigError::OutOfRange { key, value: value.to_string(), expected };
    (least..=most).contains(&value).then_some(()).ok_or_else(error)
}

fn share(key: &'static str, value: f32) -> Result<(), ConfigError> {
    check(key, value, (0.0..=1.0).contains(&value), "between 0 and 1")
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
        let text = "preset = \"paper-tum\"\n[mapping]\nmean_rate = 1\n";
        let config = Config::from_toml(text, "test", None).expect("valid");
        assert_eq!(config.mapping.mean_rate, 1.0);
        assert_eq!(config.mapping.window, 20);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let text = "[mapping]\nwindow = 3\nwindoww = 4\n";
        let message = Config::from_toml(text, "a.toml", None).expect_err("bad").to_string();
        assert!(message.contains("a.toml, line 3") && message.contains("windoww"), "{message}");
    }

    #[test]
    fn a_rolling_shutter_needs_a_route_that_can_roll() {
        let refusal = |rest: &str| {
            let text = format!("[input]\nrolling_shutter_readout = 0.02\n{rest}");
            Config::from_toml(&text, "test", None).expect_err(rest).to_string()
        };
        let message = refusal("[formation]\nblur_model = \"exact\"");
        assert!(message.contains("splat") && message.contains("blur_model"), "{message}");
        assert!(refusal("[formation]\nblur = false").contains("formation.blur"));
        let text = "[input]\nrolling_shutter_readout = -0.02";
        assert!(Config::from_toml(text, "test", None).is_ok());
        assert!(Config::from_toml("[input]\nrolling_shutter_readout = 2", "test", None).is_err());
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let wrong = [
            "[formation]\nvirtual_cameras = 0",
            "[map]\ninitial_opacity = 2.0",
            "[mapping]\nhold_out = 1",
        ];
        for text in wrong {
            assert!(Config::from_toml(text, "test", None).is_err(), "{text}");
        }
    }
}
