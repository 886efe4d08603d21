//! Vignetting of the lens, from surface points that several keyframes see.
//!
//! See [`i2slam_formation::vignetting`].

use super::context::MappingContext;
use super::surface_pairs::{BlurredSample, ComparedViews, PLACE_DEVIATION};
use i2slam_formation::vignetting::{RadiancePair, estimate};
use i2slam_formation::{ResponseCurve, Vignetting};
use rayon::prelude::*;

/// Picture values between which a pixel is well exposed: below, steps of 8 bits are large in linear
/// light; above, the response is flat.
const EXPOSED: [f32; 2] = [0.08, 0.92];
/// Standard deviation of the logarithm of linear values in a plain area.
const LOG_DEVIATION: f64 = 0.02;
/// Least loss of light in the corner that counts. Gloss and an inexact response leave less.
const MIN_LOSS: f64 = 0.025;

/// The vignetting of a session's lens.
#[derive(Clone, Debug)]
pub(crate) struct LensVignetting {
    lens: Vignetting<f32>,
    at_pixels: Vec<f32>,
}

impl LensVignetting {
    pub(crate) fn lens(&self) -> Vignetting<f32> {
        self.lens
    }

    /// Share of light at every pixel.
    pub(crate) fn at_pixels(&self) -> &[f32] {
        &self.at_pixels
    }

    /// The vignetting that the keyframes show, `Some(None)` of a lens without; `None` where they show too
    /// little to tell.
    pub(crate) fn find(
        context: &MappingContext<'_>,
        compared: &[ComparedViews],
    ) -> Option<Option<Self>> {
        let curves: Vec<ResponseCurve<f32>> =
            context.responses.iter().map(|response| response.curve()).collect();
        let lens = lens_of_views(compared, |frame| &curves[context.frames[frame].response])?;
        Some((!lens.is_none()).then(|| {
            let lens = Vignetting { coefficients: lens.coefficients.map(|c| c as f32) };
            Self { lens, at_pixels: lens.at_pixels(&context.camera.cast()) }
        }))
    }
}

/// Linear value of a picture at a place.
#[derive(Clone, Copy)]
struct LinearValue {
    /// Mean over the channels of its logarithm.
    log: f64,
    /// Change of that per pixel.
    slope: f64,
}

impl LinearValue {
    /// `None` where the picture is badly exposed.
    fn new(sample: &BlurredSample, curve: &ResponseCurve<f32>) -> Option<Self> {
        let mut value = Self { log: 0.0, slope: 0.0 };
        for (channel, (&picture, &slope)) in sample.values.iter().zip(&sample.slopes).enumerate() {
            if !(EXPOSED[0]..=EXPOSED[1]).contains(&picture) {
                return None;
            }
            let x = curve.inverse(channel, picture);
            let by_log = f64::from(curve.slope(channel, x) * x).max(1e-6);
            value.log += f64::from(x).ln() / 3.0;
            value.slope += f64::from(slope) / by_log / 3.0;
        }
        Some(value)
    }
}

/// Vignetting that the views show, none if it is too weak to tell; `None` of too few points.
fn lens_of_views<'a>(
    compared: &[ComparedViews],
    curve_of_frame: impl Fn(usize) -> &'a ResponseCurve<f32> + Sync,
) -> Option<Vignetting<f64>> {
    let pairs = |views: &ComparedViews| -> Vec<RadiancePair> {
        let [first, second] = views.frames.map(&curve_of_frame);
        let pair = |[here, there]: &[BlurredSample; 2]| {
            let values = [LinearValue::new(here, first)?, LinearValue::new(there, second)?];
            Some(radiance_pair([here, there].map(|sample| sample.squared_radius), values))
        };
        views.points.iter().filter_map(pair).collect()
    };
    let found = estimate(&compared.par_iter().map(pairs).collect::<Vec<_>>())?;
    match found.is_significant(MIN_LOSS) {
        true => Some(found.vignetting),
        false => Some(Vignetting::default()),
    }
}

fn radiance_pair(squared_radii: [f64; 2], [here, there]: [LinearValue; 2]) -> RadiancePair {
    let by_place = PLACE_DEVIATION * here.slope.hypot(there.slope);
    RadiancePair {
        log_ratio: here.log - there.log,
        squared_radii,
        deviation: LOG_DEVIATION.hypot(by_place),
    }
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{GAINS, compared_views};
    use super::super::view::tests::curve;
    use super::*;

    #[test]
    fn vignetting_of_pictures_is_found_within_two_percent() {
        let curve = curve();
        for coefficients in [[-0.25, -0.25, 0.0], [-0.5, 0.0, 0.0], [-0.05, -0.1, -0.15]] {
            let lens = Vignetting { coefficients };
            for count in [4, 7] {
                let compared = compared_views(count, &lens, GAINS);
                let found = lens_of_views(&compared, |_| &curve).expect("a wall");
                let error = found.corner() / f64::from(lens.corner()) - 1.0;
                assert!(error.abs() < 0.02, "{coefficients:?}, {count} views: {found:?}");
            }
        }
    }

    #[test]
    fn a_lens_without_vignetting_has_none() {
        let curve = curve();
        let compared = compared_views(6, &Vignetting::default(), GAINS);
        assert_eq!(lens_of_views(&compared, |_| &curve), Some(Vignetting::default()));
    }

    #[test]
    fn badly_exposed_points_do_not_count() {
        let sample = |value: f32| BlurredSample {
            values: [0.5, value, 0.5],
            slopes: [0.01; 3],
            blur: 0.0,
            squared_radius: 0.2,
        };
        let exposed = [0.01, 0.3, 0.95].map(|v| LinearValue::new(&sample(v), &curve()).is_some());
        assert_eq!(exposed, [false, true, false]);
    }
}
