//! Ranges of the settings that are numbers. What they need of a machine is checked when a run
//! starts (`run::memory`); these hold on every machine.

use super::{Config, ConfigError};
use i2slam_radiance::hashgrid::FieldSettings;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Most steps of a round, or of a frame: at the fastest, a millisecond each, they take a quarter of
/// an hour.
const MAX_STEPS: f64 = 1e6;
/// Most frames from one to the next: more than nine hours of video.
const MAX_FRAMES: f64 = 1e6;
/// Most keyframes in a window, each of which takes part in every step.
const MAX_WINDOW: f64 = 1e4;
/// Most virtual cameras, each of which costs a render; beyond, streaks show no steps any more.
const MAX_VIRTUAL_CAMERAS: f64 = 64.0;
/// Most Gaussians: some 40 GB with gradient and moments.
const MAX_GAUSSIANS: f64 = 1e8;
/// Most rays of a step: three for every pixel of a picture of 640x480.
const MAX_RAYS: f64 = 1e6;
/// Largest border [px]: the longest side that a JPEG file can have.
const MAX_BORDER: f64 = 65_535.0;
/// Largest length [m]: beyond, positions in single precision are coarser than centimetres.
const MAX_LENGTH: f64 = 1e5;
/// Smallest length [m], whose square is still a normal number in single precision.
const MIN_LENGTH: f64 = 1e-6;
/// Largest weight of a loss: products with gradients stay finite in single precision.
const MAX_WEIGHT: f64 = 1e12;
/// Least memory of a run [GB].
pub const MIN_MEMORY: f64 = 1e-3;
/// Most memory of a run [GB].
pub const MAX_MEMORY: f64 = 1e5;
/// Longest time of a frame or between frames [s]: an hour.
const MAX_TIME: f64 = 3600.0;
/// Longest readout, and delay of depth [s].
const MAX_DELAY: f64 = 1.0;
/// Largest motion of the picture in widths, and blur length in pixels: no picture moves as far.
const MAX_MOTION: f64 = 1e5;

/// A number with the values that it may take.
pub(super) struct Ranged {
    pub(super) key: &'static str,
    /// The value as in a file.
    text: String,
    value: f64,
    pub(super) range: RangeInclusive<f64>,
    /// Reason for the lower end; empty where it is plain.
    reason: &'static str,
}

impl Ranged {
    fn new(key: &'static str, value: impl Display, range: RangeInclusive<f64>) -> Self {
        // As it is typed: the single-precision number for 0.000001 is smaller than that.
        let text = value.to_string();
        Self { key, value: text.parse().unwrap_or(f64::NAN), text, range, reason: "" }
    }

    fn because(self, reason: &'static str) -> Self {
        Self { reason, ..self }
    }

    fn check(self) -> Result<(), ConfigError> {
        if self.range.contains(&self.value) {
            return Ok(());
        }
        let expected = format!("{} to {}{}", self.range.start(), self.range.end(), self.reason);
        Err(ConfigError::OutOfRange {
            place: String::new(),
            key: self.key,
            value: self.text,
            expected,
        })
    }
}

impl Config {
    /// Checks every number but the seed and the number of response curves.
    pub(super) fn validate_ranges(&self) -> Result<(), ConfigError> {
        self.ranges().into_iter().try_for_each(Ranged::check)
    }

    /// All numbers but the seed and the number of response curves.
    pub(super) fn ranges(&self) -> Vec<Ranged> {
        let (input, f, t) = (&self.input, &self.formation, &self.tracking);
        let mut all = vec![
            Ranged::new("memory", self.memory, MIN_MEMORY..=MAX_MEMORY),
            Ranged::new("input.crop_border", input.crop_border, 0.0..=MAX_BORDER),
            Ranged::new("input.minimum_gap", input.minimum_gap, 0.0..=MAX_TIME),
            Ranged::new("input.depth_delay", input.depth_delay, -MAX_DELAY..=MAX_DELAY),
            Ranged::new(
                "input.rolling_shutter_readout",
                input.rolling_shutter_readout,
                -MAX_DELAY..=MAX_DELAY,
            ),
            Ranged::new("formation.virtual_cameras", f.virtual_cameras, 1.0..=MAX_VIRTUAL_CAMERAS),
            Ranged::new("formation.blur_per_camera", f.blur_per_camera, 0.0..=MAX_MOTION),
            Ranged::new("map.capacity", self.map.capacity, 1.0..=MAX_GAUSSIANS),
            Ranged::new("keyframed.reach", self.keyframed.reach, MIN_LENGTH..=MAX_LENGTH),
            Ranged::new("tracking.iterations", t.iterations, self.first_order_steps()..=MAX_STEPS),
            Ranged::new("tracking.trajectory_weight", t.trajectory_weight, 0.0..=MAX_WEIGHT),
        ];
        all.extend(self.field_ranges());
        all.extend(self.mapping_ranges());
        all
    }

    /// Least number of steps of Adam while tracking.
    fn first_order_steps(&self) -> f64 {
        if self.tracking.method == super::TrackingMethod::Adam { 1.0 } else { 0.0 }
    }

    fn field_ranges(&self) -> [Ranged; 7] {
        let h = &self.hashgrid;
        let max_table = f64::from(FieldSettings::MAX_LOG2_TABLE);
        [
            Ranged::new("hashgrid.bound", h.bound, 0.0..=MAX_LENGTH),
            Ranged::new("hashgrid.log2_table", h.log2_table, 4.0..=max_table),
            Ranged::new("hashgrid.finest_cell", h.finest_cell, MIN_LENGTH..=MAX_LENGTH),
            Ranged::new("hashgrid.rays", h.rays, 1.0..=MAX_RAYS),
            Ranged::new("hashgrid.iterations", h.iterations, 0.0..=MAX_STEPS),
            Ranged::new("hashgrid.first_iterations", h.first_iterations, 0.0..=MAX_STEPS),
            Ranged::new("hashgrid.final_iterations", h.final_iterations, 0.0..=MAX_STEPS),
        ]
    }

    fn mapping_ranges(&self) -> [Ranged; 10] {
        let m = &self.mapping;
        // None, or every second and more.
        let hold_out = if m.hold_out == 0 { 0.0 } else { 2.0 };
        let held_out = Ranged::new("mapping.hold_out", m.hold_out, hold_out..=MAX_FRAMES);
        [
            Ranged::new("mapping.interval", m.interval, 1.0..=MAX_FRAMES),
            Ranged::new("mapping.iterations", m.iterations, 0.0..=MAX_STEPS),
            Ranged::new("mapping.seconds_per_frame", m.seconds_per_frame, 0.0..=MAX_TIME),
            Ranged::new("mapping.first_iterations", m.first_iterations, 0.0..=MAX_STEPS),
            Ranged::new("mapping.final_iterations", m.final_iterations, 0.0..=MAX_STEPS),
            held_out.because(", or 0 for none: a map needs frames"),
            Ranged::new("mapping.window", m.window, 1.0..=MAX_WINDOW),
            Ranged::new("mapping.keyframe_interval", m.keyframe_interval, 1.0..=MAX_FRAMES),
            Ranged::new("mapping.keyframe_motion", m.keyframe_motion, 0.0..=MAX_MOTION),
            Ranged::new("mapping.depth_weight", m.depth_weight, 0.0..=MAX_WEIGHT),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::{Table, Value};

    /// Every key of a table that holds a number, with its section.
    fn numbers(table: &Table, path: &str) -> Vec<String> {
        let each = table.iter().flat_map(|(name, value)| match value {
            Value::Table(inner) => numbers(inner, &format!("{name}.")),
            Value::Integer(_) | Value::Float(_) => vec![format!("{path}{name}")],
            _ => Vec::new(),
        });
        each.collect()
    }

    /// The settings of `preset` with one value.
    fn with(preset: &str, key: &str, value: &str) -> Result<Config, ConfigError> {
        Config::from_toml(&format!("{key} = {value}\n"), "a.toml", Some(preset))
    }

    fn refused(key: &str, value: &str) {
        let message = with("default", key, value).expect_err(key).to_string();
        let start = format!("a.toml, line 1: {key} = ");
        assert!(message.starts_with(&start) && message.contains("out of range"), "{message}");
    }

    /// The largest whole number of a file, which need not fit the type of the setting.
    fn refuses_largest(key: &str) {
        let message = with("default", key, &i64::MAX.to_string()).expect_err(key).to_string();
        assert!(message.starts_with(&format!("a.toml, line 1: {key}")), "{message}");
    }

    #[test]
    fn every_number_has_a_range_up_to_its_ends() {
        let table = Table::try_from(Config::default()).expect("settings");
        let ranges = Config::default().ranges();
        for key in numbers(&table, "") {
            if matches!(key.as_str(), "seed" | "formation.response_curves") {
                continue;
            }
            let found = ranges.iter().find(|ranged| ranged.key == key);
            let Ranged { range, .. } = found.unwrap_or_else(|| panic!("{key} has no range"));
            let (least, most) = (*range.start(), *range.end());
            let section =
                key.split('.').fold(Value::Table(table.clone()), |at, name| at[name].clone());
            match section {
                Value::Integer(_) => {
                    for end in [least, most] {
                        with("default", &key, &end.to_string()).expect(&key);
                    }
                    refused(&key, &(most + 1.0).to_string());
                    refuses_largest(&key);
                }
                _ => {
                    for end in [least, most] {
                        with("default", &key, &format!("{end:e}")).expect(&key);
                    }
                    let beyond = most * 1.001;
                    for wrong in [format!("{beyond:e}"), "nan".into(), "inf".into(), "-inf".into()]
                    {
                        refused(&key, &wrong);
                    }
                }
            }
        }
        assert_eq!(ranges.len() + 2, numbers(&table, "").len(), "a range of no setting");
    }

    #[test]
    fn other_numbers_are_bounded_too() {
        with("default", "seed", &i64::MAX.to_string()).expect("the largest seed");
        with("default", "formation.response_curves", "1").expect("a monochrome camera");
        refused("formation.response_curves", "2");
        refused("mapping.hold_out", "1");
        let config = Config { seed: 1 << 63, ..Config::default() };
        assert!(config.validate().expect_err("too large").to_string().contains("seed = "));
        let steps = "tracking.iterations = 0\n";
        let none = Config::from_toml(steps, "a.toml", Some("paper-tum")).expect_err("no step");
        assert!(none.to_string().contains("tracking.iterations = 0 is out of range: 1 to 1000000"));
    }
}
