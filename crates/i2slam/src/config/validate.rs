//! Agreement of settings with each other.

use super::*;

impl Config {
    /// Checks that every value is in its range and that they agree.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_counts()?;
        self.validate_ranges()?;
        self.validate_depth_stamps()?;
        self.validate_rolling_shutter()
    }

    /// Sets the readout found by a front end [s], if none is set and the settings support one.
    #[must_use]
    pub fn with_found_readout(self, seconds: f64) -> Self {
        if self.input.is_rolling() {
            return self;
        }
        let mut rolling = self.clone();
        rolling.input.rolling_shutter_readout = seconds;
        if rolling.validate().is_ok() { rolling } else { self }
    }

    fn validate_counts(&self) -> Result<(), ConfigError> {
        if i64::try_from(self.seed).is_err() {
            return refuse("seed", self.seed.to_string(), "at most 2^63 - 1");
        }
        let curves = self.formation.response_curves;
        if !matches!(curves, 1 | 3) {
            return refuse("formation.response_curves", curves.to_string(), "1 or 3");
        }
        Ok(())
    }

    fn validate_depth_stamps(&self) -> Result<(), ConfigError> {
        let first_order =
            self.tracking.method == TrackingMethod::Adam || self.tracking.iterations > 0;
        if self.input.depth_stamps && first_order {
            let expected = "false, or tracking.method \"second-order\" with tracking.iterations 0: \
                            first-order tracking compares depth at the best pose of the exposure";
            return refuse("input.depth_stamps", "true".to_owned(), expected);
        }
        Ok(())
    }

    /// A rolling shutter needs a blur model that extrapolates the motion of the exposure to all rows.
    fn validate_rolling_shutter(&self) -> Result<(), ConfigError> {
        let (input, formation) = (&self.input, &self.formation);
        let (readout, key) = (input.rolling_shutter_readout, "input.rolling_shutter_readout");
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
        if !self.is_rgb() {
            return Ok(());
        }
        if input.optimise_rolling_shutter {
            let expected = "false with an RGB preset: the front end finds the readout";
            return refuse("input.optimise_rolling_shutter", "true".to_owned(), expected);
        }
        if self.map.kind == MapKind::HashGrid {
            let expected = "0 with an RGB preset and map.kind \"hashgrid\"";
            return refuse(key, readout.to_string(), expected);
        }
        Ok(())
    }
}

fn refuse(key: &'static str, value: String, expected: &str) -> Result<(), ConfigError> {
    let (place, expected) = (String::new(), expected.to_owned());
    Err(ConfigError::OutOfRange { place, key, value, expected })
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
    fn a_readout_that_was_found_goes_to_maps_that_can_see_it() {
        let config = |kind, preset| {
            let mut config = Config::preset(preset).expect("known");
            config.map.kind = kind;
            config
        };
        let readout =
            |config: Config| config.with_found_readout(0.02).input.rolling_shutter_readout;
        assert_eq!(readout(config(MapKind::Gaussian, "default-rgb")), 0.02);
        assert_eq!(readout(config(MapKind::HashGrid, "default-rgb")), 0.0);
        assert_eq!(readout(config(MapKind::Gaussian, "paper-rgb")), 0.0);
        let mut still = config(MapKind::Gaussian, "default-rgb");
        still.formation.blur = false;
        assert_eq!(readout(still), 0.0);
        let mut given = config(MapKind::Gaussian, "default-rgb");
        given.input.rolling_shutter_readout = -0.01;
        assert_eq!(readout(given), -0.01);
        let mut searched = config(MapKind::Gaussian, "default-rgb");
        searched.input.optimise_rolling_shutter = true;
        let refusal = searched.validate().expect_err("nothing looks for it").to_string();
        assert!(refusal.contains("optimise_rolling_shutter"), "{refusal}");
    }
}
