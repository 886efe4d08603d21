//! Depth error over the pixels whose true depth is known.

use crate::EvalError;
use crate::image::check_shapes;
use i2slam_geometry::Image;
use serde::Serialize;

/// Depth error; a depth is valid if it is above zero and finite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthError {
    /// `Σ |D̂ - D| / n` over pixels with valid true depth `D` [m]. A missing estimate (0) counts
    /// with the whole depth, as in SplaTAM's and Nice-SLAM's depth L1.
    pub l1_m: f64,
    /// L1 over pixels where the estimate is valid too [m]; `None` if there are none.
    pub l1_seen_m: Option<f64>,
    /// Share of the pixels with valid true depth where the estimate is valid, in `[0, 1]`.
    pub coverage: f64,
    /// Number of pixels with valid true depth.
    pub valid_pixels: usize,
}

/// L1 of an estimated against a true depth picture (one channel) [m].
pub fn depth_error(estimate: &Image<f32>, truth: &Image<f32>) -> Result<DepthError, EvalError> {
    check_shapes(estimate, truth)?;
    if estimate.data.iter().any(|d| !d.is_finite()) {
        return Err(EvalError::NotFinite { what: "the estimated depth" });
    }
    let (mut valid, mut seen, mut sum, mut seen_sum) = (0_usize, 0_usize, 0.0, 0.0);
    for (&e, &t) in estimate.data.iter().zip(&truth.data) {
        if !(t > 0.0 && t.is_finite()) {
            continue;
        }
        let error = (f64::from(e) - f64::from(t)).abs();
        valid += 1;
        sum += error;
        if e > 0.0 {
            seen += 1;
            seen_sum += error;
        }
    }
    if valid == 0 {
        return Err(EvalError::TooFew { what: "pixels with true depth", found: 0, needed: 1 });
    }
    Ok(DepthError {
        l1_m: sum / valid as f64,
        l1_seen_m: (seen > 0).then(|| seen_sum / seen as f64),
        coverage: seen as f64 / valid as f64,
        valid_pixels: valid,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn depth(values: &[f32]) -> Image<f32> {
        Image { width: values.len(), height: 1, channels: 1, data: values.to_vec() }
    }

    #[test]
    fn by_hand() {
        let truth = depth(&[0.0, f32::NAN, 2.0, 4.0]);
        let e = depth_error(&depth(&[9.0, 9.0, 2.5, 0.0]), &truth).unwrap();
        assert_eq!((e.l1_m, e.l1_seen_m, e.coverage, e.valid_pixels), (2.25, Some(0.5), 0.5, 2));
    }

    #[test]
    fn images_without_depth_are_refused() {
        let nothing = depth_error(&depth(&[1.0]), &depth(&[0.0]));
        assert!(matches!(nothing, Err(EvalError::TooFew { .. })));
        let poisoned = depth_error(&depth(&[f32::NAN]), &depth(&[1.0]));
        assert!(matches!(poisoned, Err(EvalError::NotFinite { .. })));
        let unseen = depth_error(&depth(&[0.0]), &depth(&[1.0])).unwrap();
        assert_eq!((unseen.l1_seen_m, unseen.coverage), (None, 0.0));
    }
}
