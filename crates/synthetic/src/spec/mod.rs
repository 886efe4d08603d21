//! Specification of a sequence: every field has a default, a range and a line of explanation.

mod section;
mod sections;

use crate::error::SyntheticError;
use crate::response::Response;
use section::section;
pub use sections::{
    CameraSpec, DepthSpec, ExposureSpec, LightSpec, MotionSpec, NoiseSpec, OutputSpec, RoomSpec,
    WhiteBalanceSpec,
};
use std::path::Path;

/// A whole specification, `SPEC.toml`.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spec {
    /// Seed of room, motion and noise.
    pub seed: u64,
    /// The camera.
    pub camera: CameraSpec,
    /// The room.
    pub room: RoomSpec,
    /// The light.
    pub light: LightSpec,
    /// The motion.
    pub motion: MotionSpec,
    /// Exposure, shutter and response.
    pub exposure: ExposureSpec,
    /// White balance.
    pub white_balance: WhiteBalanceSpec,
    /// Noise of the colour sensor.
    pub noise: NoiseSpec,
    /// The depth sensor.
    pub depth: DepthSpec,
    /// Files that are written.
    pub output: OutputSpec,
}

impl Spec {
    /// The specification of a text, checked. `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, SyntheticError> {
        let malformed = |e: toml::de::Error| SyntheticError::Malformed {
            origin: origin.to_owned(),
            message: e.to_string().trim_end().to_owned(),
        };
        let spec: Self = toml::from_str(text).map_err(malformed)?;
        spec.validate()?;
        Ok(spec)
    }

    /// The specification in a file.
    pub fn from_toml_file(path: &Path) -> Result<Self, SyntheticError> {
        let text = std::fs::read_to_string(path).map_err(|e| SyntheticError::read(path, e))?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// The specification as a commented file that reads back to the same values.
    pub fn to_toml(&self) -> String {
        let mut text = String::from(
            "# Specification of a synthetic sequence. Every line may be left out: these are the\n\
             # values then taken.\n\n# Seed of room, motion and noise.\n",
        );
        text.push_str(&format!("seed = {}\n", self.seed));
        self.camera.print(&mut text);
        self.room.print(&mut text);
        self.light.print(&mut text);
        self.motion.print(&mut text);
        self.exposure.print(&mut text);
        self.white_balance.print(&mut text);
        self.noise.print(&mut text);
        self.depth.print(&mut text);
        self.output.print(&mut text);
        text
    }

    /// Refuses values outside their documented range.
    pub fn validate(&self) -> Result<(), SyntheticError> {
        self.camera.check()?;
        self.room.check()?;
        self.light.check()?;
        self.motion.check()?;
        self.exposure.check()?;
        self.white_balance.check()?;
        self.noise.check()?;
        self.depth.check()?;
        self.output.check()?;
        let (low, high) = (self.exposure.shutter_minimum, self.exposure.shutter_maximum);
        if low > high {
            return Err(SyntheticError::OutOfRange {
                key: "exposure.shutter_minimum".into(),
                value: low.to_string(),
                expected: format!("at most exposure.shutter_maximum = {high}"),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
