//! Whether settings are in their ranges and agree with each other.

use super::*;
use i2slam_radiance::hashgrid::FieldSettings;

impl Config {
    /// Whether every value is in its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_formation()?;
        self.validate_tracking()?;
        self.validate_rolling_shutter()?;
        self.validate_mapping()?;
        self.validate_map()?;
        self.validate_hashgrid()?;
        self.validate_keyframed()?;
        if i64::try_from(self.seed).is_err() {
            return refuse("seed", self.seed.to_string(), "at most 2^63 - 1");
        }
        self.rates().into_iter().try_for_each(|(key, value)| not_negative(key, value))
    }

    fn validate_formation(&self) -> Result<(), ConfigError> {
        let f = &self.formation;
        between("formation.virtual_cameras", f.virtual_cameras, 1, 64, "1 to 64")?;
        if !matches!(f.response_curves, 1 | 3) {
            return refuse("formation.response_curves", f.response_curves.to_string(), "1 or 3");
        }
        Ok(())
    }

    fn validate_tracking(&self) -> Result<(), ConfigError> {
        let t = &self.tracking;
        let refined = t.method == TrackingMethod::Adam || t.iterations > 0;
        if self.input.depth_stamps && refined {
            let expected = "false, or tracking.method \"second-order\" with tracking.iterations 0: \
                            first-order tracking compares depth at the best pose of the exposure";
            return refuse("input.depth_stamps", "true".to_owned(), expected);
        }
        match t.method {
            TrackingMethod::Adam => at_least("tracking.iterations", t.iterations, 1),
            TrackingMethod::SecondOrder => Ok(()),
        }
    }

    /// Rows that are read in turn are seen by the motion over the exposure, continued.
    fn validate_rolling_shutter(&self) -> Result<(), ConfigError> {
        let (input, formation) = (&self.input, &self.formation);
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
            let expected = "\"image\" or \"auto\" with a rolling shutter: \"exact\" would need a \
                            render for every row";
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

    fn validate_mapping(&self) -> Result<(), ConfigError> {
        let m = &self.mapping;
        at_least("mapping.interval", m.interval, 1)?;
        if m.hold_out == 1 {
            let expected = "0 for none, or 2 and more: a map needs frames";
            return refuse("mapping.hold_out", "1".to_owned(), expected);
        }
        at_least("mapping.window", m.window, 1)?;
        at_least("mapping.keyframe_interval", m.keyframe_interval, 1)?;
        Ok(())
    }

    fn validate_map(&self) -> Result<(), ConfigError> {
        let m = &self.map;
        at_least("map.capacity", m.capacity, 1)?;
        Ok(())
    }

    fn validate_hashgrid(&self) -> Result<(), ConfigError> {
        let h = &self.hashgrid;
        between("hashgrid.levels", h.levels, 1, FieldSettings::MAX_LEVELS, "1 to 32")?;
        let (log2_table, most) = (h.log2_table as usize, FieldSettings::MAX_LOG2_TABLE as usize);
        between("hashgrid.log2_table", log2_table, 4, most, "4 to 24")?;
        share("hashgrid.moment_jitter", h.moment_jitter)?;
        between("hashgrid.hidden_width", h.hidden_width, 1, 1024, "1 to 1024")?;
        between("hashgrid.occupancy_cells", h.occupancy_cells as usize, 1, 512, "1 to 512")?;
        at_least("hashgrid.rays", h.rays, 1)?;
        positive("hashgrid.margin", h.margin)?;
        positive("hashgrid.finest_cell", h.finest_cell)?;
        positive("hashgrid.step_min", h.step_min)?;
        inside("hashgrid.shell", h.shell)?;
        Ok(())
    }

    fn validate_keyframed(&self) -> Result<(), ConfigError> {
        let k = &self.keyframed;
        at_least("keyframed.first_keyframes", k.first_keyframes, 1)?;
        at_least("keyframed.preconditioning_interval", k.preconditioning_interval, 1)?;
        positive("keyframed.reach", k.reach)?;
        positive("keyframed.surface_depth_left", k.surface_depth_left)?;
        not_negative("keyframed.surface_cell", k.surface_cell)?;
        not_negative("keyframed.surface_growth", k.surface_growth)?;
        if k.surface_growth > 0.0 && k.surface_growth <= 1.0 {
            let growth = k.surface_growth.to_string();
            return refuse("keyframed.surface_growth", growth, "0, or above 1");
        }
        self.validate_surface_detail()?;
        if !self.is_rgb() || !self.input.is_rolling() {
            return Ok(());
        }
        if self.input.optimise_rolling_shutter {
            let expected = "false with an RGB preset: the front end finds the readout";
            return refuse("input.optimise_rolling_shutter", "true".to_owned(), expected);
        }
        if self.map.kind == MapKind::HashGrid {
            let readout = self.input.rolling_shutter_readout.to_string();
            let expected = "0 with an RGB preset and map.kind \"hashgrid\"";
            return refuse("input.rolling_shutter_readout", readout, expected);
        }
        Ok(())
    }

    /// Cells are finer around known surfaces, and there may be no more of them than a field can
    /// hold.
    fn validate_surface_detail(&self) -> Result<(), ConfigError> {
        let (key, detail) = ("keyframed.surface_detail", self.keyframed.surface_detail);
        positive(key, detail)?;
        if self.hashgrid.finer(detail).occupancy_cells > 512 {
            let expected = "a factor by which hashgrid.occupancy_cells is at most 512";
            return refuse(key, detail.to_string(), expected);
        }
        Ok(())
    }

    /// Values that any number of at least zero is good for.
    fn rates(&self) -> [(&'static str, f32); 18] {
        let (f, t, m) = (&self.formation, &self.tracking, &self.mapping);
        let k = &self.keyframed;
        [
            ("keyframed.camera_rate", k.camera_rate),
            ("keyframed.preconditioning_damping", k.preconditioning_damping),
            ("keyframed.trajectory_weight", k.trajectory_weight),
            ("keyframed.initial_split", k.initial_split),
            ("keyframed.depth_outlier", k.depth_outlier),
            ("keyframed.surface_depth_weight", k.surface_depth_weight),
            ("keyframed.surface_camera_rate", k.surface_camera_rate),
            ("keyframed.surface_steps", k.surface_steps),
            ("hashgrid.bound", self.hashgrid.bound),
            ("hashgrid.step", self.hashgrid.step),
            ("hashgrid.rate", self.hashgrid.rate),
            ("hashgrid.image_weight", self.hashgrid.image_weight),
            ("hashgrid.depth_weight", self.hashgrid.depth_weight),
            ("formation.blur_per_camera", f.blur_per_camera),
            ("tracking.trajectory_weight", t.trajectory_weight),
            ("mapping.depth_weight", m.depth_weight),
            ("mapping.keyframe_motion", m.keyframe_motion),
            ("mapping.seconds_per_frame", m.seconds_per_frame),
        ]
    }
}

fn refuse(key: &'static str, value: String, expected: &'static str) -> Result<(), ConfigError> {
    Err(ConfigError::OutOfRange { place: String::new(), key, value, expected })
}

fn at_least(key: &'static str, value: usize, least: usize) -> Result<(), ConfigError> {
    if value >= least { Ok(()) } else { refuse(key, value.to_string(), "at least 1") }
}

fn check(
    key: &'static str,
    value: f32,
    good: bool,
    expected: &'static str,
) -> Result<(), ConfigError> {
    if good { Ok(()) } else { refuse(key, value.to_string(), expected) }
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
    if (least..=most).contains(&value) { Ok(()) } else { refuse(key, value.to_string(), expected) }
}

fn share(key: &'static str, value: f32) -> Result<(), ConfigError> {
    check(key, value, (0.0..=1.0).contains(&value), "between 0 and 1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rolling_shutter_needs_a_route_that_can_roll() {
        let refusal = |rest: &str| {
            let text = format!("[input]\nrolling_shutter_readout = 0.02\n{rest}");
            Config::from_toml(&text, "test", None).expect_err(rest).to_string()
        };
        let message = refusal("[formation]\nblur_model = \"exact\"");
        assert!(message.contains("image") && message.contains("blur_model"), "{message}");
        assert!(refusal("[formation]\nblur = false").contains("formation.blur"));
        let text = "[input]\nrolling_shutter_readout = -0.02";
        assert!(Config::from_toml(text, "test", None).is_ok());
        assert!(Config::from_toml("[input]\nrolling_shutter_readout = 2", "test", None).is_err());
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let wrong = [
            "[formation]\nvirtual_cameras = 0",
            "[map]\ncapacity = 0",
            "[keyframed]\nsurface_detail = 1e9",
            "[keyframed]\nsurface_growth = 1.0",
            "[mapping]\nhold_out = 1",
        ];
        for text in wrong {
            assert!(Config::from_toml(text, "test", None).is_err(), "{text}");
        }
    }
}
