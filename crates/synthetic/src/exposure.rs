//! Automatic exposure and the shutter that goes with it (the paper's appendix, "Synthetic
//! dataset").

use crate::response::Response;
use crate::rgb::luminance;
use crate::spec::ExposureSpec;
use i2slam_compute::median;
use i2slam_geometry::Image;

/// `raw EV = log2(CRF⁻¹(½) / median Y)`: the picture of the median grey would be half of white.
/// A black picture gives `None`.
pub fn raw_exposure_value(radiance: &Image<f32>, response: Response) -> Option<f64> {
    let (red, green, blue) = (radiance.plane(0), radiance.plane(1), radiance.plane(2));
    let grey = (0..radiance.pixels()).map(|i| luminance([red[i], green[i], blue[i]]));
    let mut grey: Vec<f32> = grey.filter(|y| y.is_finite()).collect();
    let median = median(&mut grey)?;
    (median > 0.0).then(|| f64::from(response.invert(0.5, 1) / median).log2())
}

/// The causal low pass `EV_i = EV_{i-1} + (raw_i - EV_{i-1}) / smoothing`, `EV_0 = raw_0`.
#[derive(Clone, Debug, Default)]
pub struct AutoExposure {
    value: Option<f64>,
}

impl AutoExposure {
    /// The exposure value of the next frame.
    pub fn next(&mut self, raw: Option<f64>, spec: &ExposureSpec) -> f64 {
        let next = match (self.value, raw) {
            (None, raw) => raw.unwrap_or(0.0),
            (Some(value), Some(raw)) if spec.automatic => value + (raw - value) / spec.smoothing,
            (Some(value), _) => value,
        };
        self.value = Some(next);
        next
    }
}

/// The line `SV = a 2^EV + b` from exposure to the open share of the frame interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShutterRule {
    /// Slope.
    pub a: f64,
    /// Share at zero exposure.
    pub b: f64,
}

impl ShutterRule {
    /// The line on which the smallest and largest exposure of a sequence open the shutter for
    /// `shutter_minimum` and `shutter_maximum`; without a spread, always their middle.
    pub fn new(exposure_values: &[f64], spec: &ExposureSpec) -> Self {
        let (low, high) = (spec.shutter_minimum, spec.shutter_maximum);
        let gains = exposure_values.iter().map(|ev| ev.exp2());
        let (least, most) = gains.fold((f64::INFINITY, 0.0_f64), |(a, b), g| (a.min(g), b.max(g)));
        let spread = most - least;
        if spread.is_nan() || spread <= 1e-6 * most {
            return Self { a: 0.0, b: 0.5 * (low + high) };
        }
        let a = (high - low) / spread;
        Self { a, b: low - a * least }
    }

    /// The open share of the frame interval at an exposure value.
    pub fn share(&self, exposure_value: f64) -> f64 {
        self.a * exposure_value.exp2() + self.b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_grey_becomes_half_of_white() {
        let mut image = Image::<f32>::new(5, 1, 3);
        for (i, v) in [0.1, 9.0, 0.4, 0.05, 2.0].into_iter().enumerate() {
            (0..3).for_each(|c| image.plane_mut(c)[i] = v);
        }
        for response in [Response::Reinhard, Response::Srgb, Response::Measured] {
            let ev = raw_exposure_value(&image, response).expect("light");
            let shown = response.apply(0.4 * ev.exp2() as f32, 1);
            assert!((shown - 0.5).abs() < 1e-4, "{response:?} {shown}");
        }
        assert!(raw_exposure_value(&Image::new(4, 4, 3), Response::Reinhard).is_none());
    }

    #[test]
    fn exposure_follows_by_a_third() {
        let (mut auto, spec) = (AutoExposure::default(), ExposureSpec::default());
        let raw = [1.0, 4.0, 4.0];
        let values = raw.map(|r| auto.next(Some(r), &spec));
        for (value, expected) in values.into_iter().zip([1.0, 2.0, 8.0 / 3.0]) {
            assert!((value - expected).abs() < 1e-12);
        }
        assert_eq!(auto.next(None, &spec), values[2], "a black frame keeps it");
        let fixed = ExposureSpec { automatic: false, ..spec };
        assert_eq!(auto.next(Some(9.0), &fixed), values[2]);
    }

    #[test]
    fn the_shutter_spans_its_range() {
        let spec = ExposureSpec::default();
        let values = [0.3, 1.2, -0.4];
        let rule = ShutterRule::new(&values, &spec);
        let shares = values.map(|ev| rule.share(ev));
        assert!((shares[1] - 1.0).abs() < 1e-12 && (shares[2] - 0.1).abs() < 1e-12);
        assert!(shares[0] > 0.1 && shares[0] < 1.0);
        assert!((ShutterRule::new(&[0.5, 0.5], &spec).share(0.5) - 0.55).abs() < 1e-12);
    }
}
