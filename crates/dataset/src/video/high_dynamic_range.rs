//! Videos of high dynamic range (ITU-R BT.2100: HLG and PQ, with the primaries of BT.2020) as pictures
//! with the primaries of BT.709.
//!
//! Their transfer functions are known, and so is the response of the pictures made of them: the curve
//! that a reconstruction [starts with](StartCurve::Shoulder), applied to scene light. Colours that BT.709
//! cannot show are mixed with grey of their luminance; of PQ light above 1000 cd/m² is white.

use i2slam_formation::tone::StartCurve;
use i2slam_geometry::Image;
use std::sync::Arc;

/// Transfer functions as ffmpeg calls them.
const FFMPEG_NAMES: [(&str, Transfer); 2] =
    [("arib-std-b67", Transfer::Hlg), ("smpte2084", Transfer::Pq)];

/// Linear BT.2020 to linear BT.709 (ITU-R BT.2087).
const BT709_FROM_BT2020: [[f32; 3]; 3] =
    [[1.660_5, -0.587_6, -0.072_8], [-0.124_6, 1.132_9, -0.008_3], [-0.018_2, -0.100_6, 1.118_7]];

const IDENTITY: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Luminance of linear BT.2020, and of linear BT.709.
const LUMINANCE: [f32; 3] = [0.262_7, 0.678, 0.059_3];
const LUMINANCE_BT709: [f32; 3] = [0.212_6, 0.715_2, 0.072_2];

/// White of swscale's `rgb48`, which shifts 8 bits up.
const WHITE: f64 = 65_280.0;

/// Luminance of white of the display that PQ is converted for \[cd/m²\], and the exponent by which a
/// display of it shows scene light (BT.2100, BT.2408).
const PEAK: f64 = 1000.0;
const SYSTEM_GAMMA: f32 = 1.2;

/// Transfer function from light to the values of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transfer {
    /// Hybrid log-gamma, of scene light.
    Hlg,
    /// Perceptual quantiser, of the light of a display.
    Pq,
}

impl Transfer {
    /// The one that a text of ffmpeg names.
    pub(super) fn named_in(text: &str) -> Option<Self> {
        FFMPEG_NAMES.iter().find(|(name, _)| text.contains(name)).map(|(_, transfer)| *transfer)
    }

    /// Its usual name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Hlg => "HLG",
            Self::Pq => "PQ",
        }
    }

    /// Linear light of a value in [0, 1]: of the scene, 1 the brightest (HLG), or of the display, 1 for
    /// [`PEAK`] (PQ).
    fn linear(self, value: f64) -> f64 {
        match self {
            Self::Hlg if value <= 0.5 => value * value / 3.0,
            Self::Hlg => {
                let (a, b, c) = (0.178_832_77, 0.284_668_92, 0.559_910_73);
                (((value - c) / a).exp() + b) / 12.0
            }
            Self::Pq => {
                let (m1, m2) = (2610.0 / 16384.0, 2523.0 / 32.0);
                let (c1, c2, c3) = (3424.0 / 4096.0, 2413.0 / 128.0, 2392.0 / 128.0);
                let power = value.powf(1.0 / m2);
                10_000.0 / PEAK * ((power - c1).max(0.0) / (c2 - c3 * power)).powf(1.0 / m1)
            }
        }
    }
}

/// Conversion of pictures of 16 bits a channel.
#[derive(Clone, Debug)]
pub(super) struct Conversion {
    transfer: Transfer,
    bt709_from_video: [[f32; 3]; 3],
    /// Linear light of every value.
    linear: Arc<[f32]>,
}

impl Conversion {
    /// For videos of a transfer function, with the primaries of BT.2020 or of BT.709.
    pub(super) fn new(transfer: Transfer, has_wide_primaries: bool) -> Self {
        let of = |value: u16| transfer.linear((f64::from(value) / WHITE).min(1.0)) as f32;
        let bt709_from_video = if has_wide_primaries { BT709_FROM_BT2020 } else { IDENTITY };
        Self { transfer, bt709_from_video, linear: (0..=u16::MAX).map(of).collect() }
    }

    pub(super) fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// A picture of pixels R G B, two bytes each, the lower one first.
    pub(super) fn image(&self, (width, height): (usize, usize), bytes: &[u8]) -> Image<f32> {
        let mut out = Image::new(width, height, 3);
        for (pixel, bytes) in bytes.chunks_exact(6).enumerate() {
            let value = |channel: usize| {
                let value = u16::from_le_bytes([bytes[2 * channel], bytes[2 * channel + 1]]);
                self.linear[usize::from(value)]
            };
            let colour = self.picture_values([value(0), value(1), value(2)]);
            for (channel, value) in colour.into_iter().enumerate() {
                out.data[channel * width * height + pixel] = value;
            }
        }
        out
    }

    /// Picture values of linear light.
    fn picture_values(&self, linear: [f32; 3]) -> [f32; 3] {
        let scene = match self.transfer {
            Transfer::Hlg => linear,
            Transfer::Pq => scene_light(linear),
        };
        let light = within_gamut(self.bt709_from_video.map(|row| dot(row, scene)));
        light.map(|value| StartCurve::Shoulder.evaluate(f64::from(value)) as f32)
    }
}

/// A colour of linear BT.709, mixed with grey of its luminance until all channels are in [0, 1].
fn within_gamut(colour: [f32; 3]) -> [f32; 3] {
    let grey = dot(LUMINANCE_BT709, colour).clamp(0.0, 1.0);
    let share = colour.into_iter().fold(1.0_f32, |share, value| match value - grey {
        above if value > 1.0 => share.min((1.0 - grey) / above),
        below if value < 0.0 => share.min(grey / -below),
        _ => share,
    });
    colour.map(|value| (share * value + (1.0 - share) * grey).clamp(0.0, 1.0))
}

/// Scene light that a display of [`PEAK`] shows so: the inverse of the system of HLG, which multiplies
/// by a power of luminance.
fn scene_light(display: [f32; 3]) -> [f32; 3] {
    let luminance = dot(LUMINANCE, display).max(1e-6);
    display.map(|light| light * luminance.powf(1.0 / SYSTEM_GAMMA - 1.0))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Signal of 75 % in HLG and of 203 cd/m² in PQ: white paper (BT.2408).
    #[test]
    fn white_paper_is_the_same_in_both() {
        let of = |transfer: Transfer, value: f64| {
            let value = (value * WHITE).round() as u16;
            let bytes = [value.to_le_bytes(); 3].concat();
            Conversion::new(transfer, true).image((1, 1), &bytes).data
        };
        let (hlg, pq) = (of(Transfer::Hlg, 0.75), of(Transfer::Pq, 0.5807));
        let expected = StartCurve::Shoulder.evaluate(0.265) as f32;
        for value in hlg.iter().chain(&pq) {
            assert!((value - expected).abs() < 2e-3, "{hlg:?} {pq:?}, not {expected}");
        }
        // The ends of both.
        assert_eq!(of(Transfer::Hlg, 0.0), [0.0; 3]);
        assert!(of(Transfer::Hlg, 1.0).iter().all(|value| (value - 1.0).abs() < 1e-3));
        assert!(of(Transfer::Pq, 0.7518).iter().all(|value| (value - 1.0).abs() < 1e-3));
    }

    /// The inverse of BT.2087's matrix times a colour of BT.709, through HLG.
    #[test]
    fn primaries_are_those_of_bt709() {
        let bt2020_from_bt709 =
            [[0.627_4, 0.329_3, 0.043_3], [0.069_1, 0.919_5, 0.011_4], [0.016_4, 0.088, 0.895_6]];
        let hlg = |light: f32| (3.0 * light).sqrt();
        let known = [0.05_f32, 0.02, 0.01];
        let bytes: Vec<u8> = bt2020_from_bt709
            .iter()
            .flat_map(|row| ((hlg(dot(*row, known)) * WHITE as f32).round() as u16).to_le_bytes())
            .collect();
        let found = Conversion::new(Transfer::Hlg, true).image((1, 1), &bytes).data;
        for (found, known) in found.iter().zip(known) {
            let expected = StartCurve::Shoulder.evaluate(f64::from(known)) as f32;
            assert!((found - expected).abs() < 1e-3, "{found} for {expected}");
        }
    }

    #[test]
    fn colours_beyond_bt709_keep_their_luminance() {
        for colour in [[1.2, 0.3, 0.1], [-0.1, 0.3, 0.05], [1.4, -0.2, 0.1], [0.3, 0.9, 0.2]] {
            let found = within_gamut(colour);
            assert!(found.iter().all(|value| (0.0..=1.0).contains(value)), "{found:?}");
            let luminance = [colour, found].map(|colour| dot(LUMINANCE_BT709, colour));
            assert!((luminance[0] - luminance[1]).abs() < 1e-6, "{colour:?} {found:?}");
        }
        assert_eq!(within_gamut([0.3, 0.9, 0.2]), [0.3, 0.9, 0.2]);
        assert_eq!(within_gamut([2.0, 2.0, 2.0]), [1.0; 3]);
    }
}
