//! Metering: how bright a view is, by the statistics that cameras set their exposure by.

use i2slam_compute::median;
use i2slam_geometry::Image;

/// Least opacity of a pixel that is metered.
const MIN_OPACITY: f32 = 0.5;
/// Least share of a view that is metered: less is no view.
const MIN_SHARE: f64 = 0.1;
/// Exponent of light over picture values: that of a display, whichever response the camera has.
const DISPLAY_GAMMA: f64 = 2.2;
/// Deviation of the weights of centre-weighted metering [half diagonals]. At 0.3 a Kinect (TUM fr1/rpy,
/// both clips) has the slope -1, at 0.2 and 0.4 -0.84 and -1.1.
const CENTRE_DEVIATION: f64 = 0.3;
/// Shares of red, green and blue in luminance (Rec. 709).
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// A statistic of the luminance Y of a view. All are multiplied by k where Y is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meter {
    /// The median.
    Median,
    /// The mean of picture values, `(mean Y^γ)^(1/γ)` with γ = 1/2.2: highlights count less.
    PictureMean,
    /// The mean.
    Mean,
    /// The mean with weights that fall from the middle of the picture as a Gaussian does.
    CentreWeighted,
}

impl Meter {
    /// Every meter, the plainest first.
    pub const ALL: [Self; 4] = [Self::Median, Self::PictureMean, Self::Mean, Self::CentreWeighted];

    /// Its name in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Median => "median of light",
            Self::PictureMean => "mean of picture values",
            Self::Mean => "mean of light",
            Self::CentreWeighted => "centre-weighted mean of light",
        }
    }
}

/// Readings of all meters in one view: natural logarithms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metering([f64; Meter::ALL.len()]);

impl Metering {
    /// From the reading of each meter [ln], in any unit of light.
    pub fn new(reading: impl FnMut(Meter) -> f64) -> Self {
        Self(Meter::ALL.map(reading))
    }

    /// Meters a view, linear radiance (R, G, B) with its opacity, under white-balance gains; `None`
    /// where less than a tenth of it is opaque and lit.
    pub fn of(
        radiance: &Image<f32>,
        opacity: &Image<f32>,
        white_balance: [f32; 3],
    ) -> Option<Self> {
        let weights: [f32; 3] = std::array::from_fn(|c| LUMINANCE[c] * white_balance[c]);
        let pixels = (0..radiance.pixels()).filter_map(|i| {
            let light: f32 = (0..3).map(|c| weights[c] * radiance.plane(c)[i]).sum();
            let is_seen = opacity.data[i] >= MIN_OPACITY && light.is_finite() && light > 0.0;
            is_seen.then(|| (f64::from(light), centre_weight(radiance, i)))
        });
        let pixels: Vec<(f64, f64)> = pixels.collect();
        let is_view = pixels.len() as f64 >= MIN_SHARE * radiance.pixels() as f64;
        is_view.then(|| Self::new(|meter| statistic(meter, &pixels).ln()))
    }

    /// The reading of one meter.
    pub const fn get(&self, meter: Meter) -> f64 {
        self.0[meter as usize]
    }
}

/// Weight of a pixel in centre-weighted metering.
fn centre_weight(picture: &Image<f32>, pixel: usize) -> f64 {
    let (width, height) = (picture.width as f64, picture.height as f64);
    let x = (pixel % picture.width) as f64 + 0.5 - 0.5 * width;
    let y = (pixel / picture.width) as f64 + 0.5 - 0.5 * height;
    let deviation = 0.5 * CENTRE_DEVIATION * width.hypot(height);
    (-0.5 * (x * x + y * y) / (deviation * deviation)).exp()
}

/// A statistic of pixels, luminance and weight in the middle; at least one.
fn statistic(meter: Meter, pixels: &[(f64, f64)]) -> f64 {
    let mean = |value: fn(f64) -> f64, weight: fn(f64) -> f64| {
        let sums = pixels.iter().fold((0.0, 0.0), |(sum, total), (light, centre)| {
            let weight = weight(*centre);
            (sum + weight * value(*light), total + weight)
        });
        sums.0 / sums.1
    };
    match meter {
        Meter::Median => {
            let mut values: Vec<f64> = pixels.iter().map(|(light, _)| *light).collect();
            median(&mut values).unwrap_or(0.0)
        }
        Meter::PictureMean => mean(|y| y.powf(1.0 / DISPLAY_GAMMA), |_| 1.0).powf(DISPLAY_GAMMA),
        Meter::Mean => mean(|y| y, |_| 1.0),
        Meter::CentreWeighted => mean(|y| y, |centre| centre),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey wall with a lamp in the middle.
    fn wall(gain: f32) -> (Image<f32>, Image<f32>) {
        let radiance = Image::from_fn(12, 12, 3, |_, column, row| {
            let is_lamp = (5..7).contains(&column) && (5..7).contains(&row);
            gain * if is_lamp { 100.0 } else { 0.5 }
        });
        (radiance, Image::from_fn(12, 12, 1, |_, _, _| 1.0))
    }

    #[test]
    fn meters_read_a_wall_with_a_lamp() {
        let (radiance, opacity) = wall(1.0);
        let read = Metering::of(&radiance, &opacity, [1.0; 3]).expect("a view");
        let light = |meter| read.get(meter).exp();
        assert!((light(Meter::Median) - 0.5).abs() < 1e-5);
        assert!((light(Meter::Mean) - (0.5 * 140.0 + 100.0 * 4.0) / 144.0).abs() < 1e-4);
        // A lamp of 200 times the wall's light counts eleven times.
        let picture = (140.0 + 4.0 * 200.0_f64.powf(1.0 / 2.2)) / 144.0;
        assert!((light(Meter::PictureMean) - 0.5 * picture.powf(2.2)).abs() < 1e-4);
        // Weights are exp(-r²/2σ²) with σ = 2.5 pixels; those of the lamp lie half a pixel off the middle.
        let along = |i: i32| (-(f64::from(i) - 5.5).powi(2) / (2.0 * 0.09 * 72.0)).exp();
        let (lamp, all): (f64, f64) = ((5..7).map(along).sum(), (0..12).map(along).sum());
        let share = (lamp / all).powi(2);
        assert!((light(Meter::CentreWeighted) - 0.5 - 99.5 * share).abs() < 1e-3);
    }

    #[test]
    fn every_meter_follows_the_light() {
        let [(dark, opacity), (bright, _)] = [wall(1.0), wall(8.0)];
        let [dark, bright] =
            [dark, bright].map(|v| Metering::of(&v, &opacity, [1.0; 3]).expect("a view"));
        for meter in Meter::ALL {
            let stops = (bright.get(meter) - dark.get(meter)) / std::f64::consts::LN_2;
            assert!((stops - 3.0).abs() < 1e-5, "{meter:?} {stops}");
        }
    }

    #[test]
    fn only_what_is_seen_is_metered() {
        let (mut radiance, mut opacity) = wall(1.0);
        let whole = Metering::of(&radiance, &opacity, [1.0; 3]).expect("a view");
        for pixel in 96..144 {
            opacity.data[pixel] = 0.2;
            radiance.plane_mut(1)[pixel] = 0.01;
        }
        let part = Metering::of(&radiance, &opacity, [1.0; 3]).expect("a view");
        assert_eq!(part.get(Meter::Median), whole.get(Meter::Median));
        opacity.data[10..].fill(0.0);
        assert_eq!(Metering::of(&radiance, &opacity, [1.0; 3]), None);
    }

    #[test]
    fn white_balance_is_applied_first() {
        let radiance = Image::from_fn(4, 4, 3, |channel, _, _| [2.0, 1.0, 0.5][channel]);
        let opacity = Image::from_fn(4, 4, 1, |_, _, _| 1.0);
        let read = Metering::of(&radiance, &opacity, [0.5, 1.0, 2.0]).expect("a view");
        assert!(read.get(Meter::Median).abs() < 1e-6);
    }
}
