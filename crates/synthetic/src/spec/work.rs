//! Bounds on the work and the memory that a specification asks for: numbers in their ranges may
//! still be too much together.

use super::Spec;
use crate::error::SyntheticError;
use std::num::NonZero;

/// Most pixels of a picture: eight thousand by four thousand.
const MAX_PIXELS: usize = 1 << 25;

/// Most rays of a sequence: days of work for a large machine, which traces some ten million a
/// second.
const MAX_RAYS: u64 = 10_000_000_000_000;

/// Bytes of a pixel while a frame is rendered: radiance twice, depth twice, the picture, and what
/// is encoded.
const PIXEL: u64 = 64;

/// Bytes of a frame that are kept to the end: a depth picture of 80x60 px, pose and exposure.
const FRAME: u64 = 80 * 60 * 4 + 256;

/// Bytes of a texel of light in all grids that exist at once, and most texels of a room: some
/// twenty large surfaces of a thousand by a thousand.
const TEXEL: u64 = 48;
const MAX_TEXELS: u64 = 20 << 20;

/// Area of all surfaces of a room over the area of its walls, floor and ceiling.
const AREA_RATIO: f64 = 3.0;

impl Spec {
    /// An error for more pixels or rays than can be rendered.
    pub(super) fn check_work(&self) -> Result<(), SyntheticError> {
        let camera = &self.camera;
        let (width, height) = (camera.width, camera.height);
        if width.saturating_mul(height) > MAX_PIXELS {
            let most = MAX_PIXELS / width.max(1);
            let expected =
                format!("at most {most} with a width of {width}, {MAX_PIXELS} pixels in all");
            return refuse("camera.height", height, expected);
        }
        let samples = camera.sub_frames + camera.sharp_samples.pow(2);
        let per_frame = (width * height * samples) as u64;
        let most = NonZero::new(per_frame).map_or(MAX_RAYS, |each| MAX_RAYS / each);
        if camera.frames as u64 > most {
            let expected = format!(
                "at most {most} with {width}x{height} px and {samples} samples a pixel: 10^13 rays"
            );
            return refuse("camera.frames", camera.frames, expected);
        }
        Ok(())
    }

    /// Memory that rendering takes, about \[bytes\].
    fn memory(&self) -> u64 {
        let camera = &self.camera;
        let [width, depth, height] = self.room.size;
        let walls = 2.0 * (width * depth + depth * height + height * width);
        let texels = (AREA_RATIO * walls / self.light.texel.powi(2)) as u64;
        let pixels = (camera.width * camera.height) as u64;
        pixels * PIXEL + camera.frames as u64 * FRAME + texels.min(MAX_TEXELS) * TEXEL
    }

    /// An error for more memory than this machine has.
    pub fn validate_memory(&self) -> Result<(), SyntheticError> {
        self.check_memory(i2slam_compute::machine_memory())
    }

    fn check_memory(&self, available: Option<u64>) -> Result<(), SyntheticError> {
        let needed = self.memory();
        if available.is_none_or(|available| needed <= available) {
            return Ok(());
        }
        let gigabytes = |bytes: u64| bytes as f64 * 1e-9;
        let available = available.map_or(0.0, gigabytes);
        let pixels = self.camera.width * self.camera.height;
        let expected = format!(
            "rendering takes about {:.1} GB of memory, and this machine has {available:.1} GB: \
             smaller pictures (camera.width, camera.height), fewer frames (camera.frames) or \
             coarser light (light.texel)",
            gigabytes(needed)
        );
        refuse("camera.width", format!("{} ({pixels} pixels)", self.camera.width), expected)
    }
}

fn refuse(key: &str, value: impl ToString, expected: String) -> Result<(), SyntheticError> {
    Err(SyntheticError::OutOfRange { key: key.to_owned(), value: value.to_string(), expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        Spec::from_toml(text, "a.toml").expect_err(text).to_string()
    }

    #[test]
    fn each_in_its_range_may_be_too_much_together() {
        let large = message("[camera]\nwidth = 8192\nheight = 8192");
        assert!(large.starts_with("camera.height = 8192 is out of range: at most 4096"), "{large}");
        let long = message("[camera]\nframes = 100000\nwidth = 4096\nheight = 4096");
        assert!(long.starts_with("camera.frames = 100000 is out of range: at most "), "{long}");
        assert!(message("[camera]\nframes = 100001").contains("1 to 100000"));
        Spec::from_toml("[camera]\nframes = 100000", "a.toml").expect("a long sequence");
        Spec::from_toml("[camera]\nwidth = 8192\nheight = 4096", "a.toml").expect("a large one");
    }

    #[test]
    fn memory_is_estimated_before_it_is_taken() {
        let mut spec = Spec::default();
        assert!((10_000_000..500_000_000).contains(&spec.memory()), "{}", spec.memory());
        spec.check_memory(Some(1 << 30)).expect("a small room");
        (spec.camera.width, spec.camera.height) = (8192, 4096);
        spec.check_memory(None).expect("memory that is not known");
        let refusal = spec.check_memory(Some(1 << 30)).expect_err("large pictures").to_string();
        assert!(refusal.starts_with("camera.width = 8192 (33554432 pixels)"), "{refusal}");
    }
}
