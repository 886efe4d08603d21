//! Detection of the sharp frames of a video.

use crate::EvalError;
use crate::image::check_side;
use crate::statistics::percentile;
use i2slam_geometry::Image;

/// Variance of the Laplacian of the grey picture, the usual measure of sharpness.
///
/// Grey is `0.299 R + 0.587 G + 0.114 B` (the only channel of a grey picture); the Laplacian
/// is the sum of the four neighbours less four times the pixel, the picture mirrored about its
/// outer pixels: `cv2.Laplacian(grey, cv2.CV_64F).var()`, and `scipy.ndimage.laplace(grey,
/// mode='mirror').var()`. Pictures in `[0, 1]`: multiply by 255² for 8-bit values. Takes one
/// channel or three, at least two pixels a side.
pub fn laplacian_variance(picture: &Image<f32>) -> Result<f64, EvalError> {
    let (width, height) = (picture.width, picture.height);
    check_side(picture, 2)?;
    let grey = grey(picture)?;
    let mirrored = |i: usize, step: isize, size: usize| match i.checked_add_signed(step) {
        Some(next) if next < size => next,
        _ => i.saturating_add_signed(-step),
    };
    let (mut sum, mut squares) = (0.0, 0.0);
    for row in 0..height {
        let rows = [mirrored(row, -1, height), mirrored(row, 1, height)];
        for column in 0..width {
            let columns = [mirrored(column, -1, width), mirrored(column, 1, width)];
            let beside: f64 = columns.iter().map(|c| grey[row * width + c]).sum();
            let above: f64 = rows.iter().map(|r| grey[r * width + column]).sum();
            let laplacian = beside + above - 4.0 * grey[row * width + column];
            sum += laplacian;
            squares += laplacian * laplacian;
        }
    }
    let pixels = grey.len() as f64;
    let variance = squares / pixels - (sum / pixels).powi(2);
    if variance.is_finite() {
        Ok(variance.max(0.0))
    } else {
        Err(EvalError::NotFinite { what: "the picture" })
    }
}

fn grey(picture: &Image<f32>) -> Result<Vec<f64>, EvalError> {
    let weights: &[f64] = match picture.channels {
        1 => &[1.0],
        3 => &[0.299, 0.587, 0.114],
        channels => {
            let (first, second) = (vec![channels], vec![3]);
            return Err(EvalError::ShapeMismatch { what: "picture and R, G, B", first, second });
        }
    };
    let at = |i: usize| -> f64 {
        weights.iter().enumerate().map(|(c, w)| w * f64::from(picture.plane(c)[i])).sum()
    };
    Ok((0..picture.pixels()).map(at).collect())
}

/// Criteria for sharp frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharpnessRule {
    /// Half width of the window of the running median [frames].
    pub window: usize,
    /// Smallest ratio of a sharp frame's sharpness to the median.
    pub ratio: f64,
    /// Distance within which a sharp frame must be the sharpest [frames].
    pub apart: usize,
}

impl Default for SharpnessRule {
    /// One second of 30 Hz, one frame in eleven at most: the paper's lists hold one in ten.
    fn default() -> Self {
        Self { window: 15, ratio: 1.1, apart: 5 }
    }
}

/// Indices of the sharp frames of a video, in order, by the sharpness of every frame
/// ([`laplacian_variance`]): those that stand out against the running median of their
/// neighbourhood and are the sharpest nearby (of equals the first).
///
/// The running median follows the scene: a white wall is less sharp than a bookshelf however
/// still the camera is held. A video that is equally sharp throughout has no sharp frame.
pub fn sharp_frames(sharpness: &[f64], rule: SharpnessRule) -> Result<Vec<usize>, EvalError> {
    let around = |i: usize, reach: usize| {
        i.saturating_sub(reach)..(i + reach).saturating_add(1).min(sharpness.len())
    };
    let mut sharp = Vec::new();
    for (i, &value) in sharpness.iter().enumerate() {
        let median = percentile(&sharpness[around(i, rule.window)], 50.0)?;
        let near = around(i, rule.apart);
        let sharpest =
            near.clone().all(|j| sharpness[j] < value || (j >= i && sharpness[j] == value));
        if value > 0.0 && value >= rule.ratio * median && sharpest {
            sharp.push(i);
        }
    }
    Ok(sharp)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey_picture(width: usize, data: &[f32]) -> Image<f32> {
        Image { width, height: data.len() / width, channels: 1, data: data.to_vec() }
    }

    #[test]
    fn laplacian_by_hand() {
        // Mirrored about the outer pixels: [2(1-0)], [(0+0)-2], [2(1-0)] along the middle row.
        let picture = grey_picture(3, &[0.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
        let laplacian = [2.0, -2.0, 2.0];
        let mean = laplacian.iter().sum::<f64>() / 3.0;
        let due = laplacian.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 3.0;
        assert!((laplacian_variance(&picture).unwrap() - due).abs() < 1e-12);
        assert_eq!(laplacian_variance(&grey_picture(2, &[0.3; 4])).unwrap(), 0.0);
    }

    #[test]
    fn sharp_frames_stand_out_against_their_surroundings() {
        // A textured part, then a plain one a hundred times less sharp.
        let mut sharpness: Vec<f64> = (0..60).map(|i| if i < 30 { 100.0 } else { 1.0 }).collect();
        (sharpness[10], sharpness[12], sharpness[50]) = (130.0, 150.0, 1.5);
        let rule = SharpnessRule { window: 8, ratio: 1.2, apart: 4 };
        assert_eq!(sharp_frames(&sharpness, rule).unwrap(), [12, 50]);
        assert_eq!(sharp_frames(&[3.0; 20], rule).unwrap(), []);
        assert_eq!(sharp_frames(&[], rule).unwrap(), []);
    }

    #[test]
    fn of_equals_the_first_is_taken() {
        let rule = SharpnessRule { window: 3, ratio: 1.0, apart: 2 };
        let sharpness = [1.0, 2.0, 2.0, 1.0, 0.0, 0.0, 1.0, 1.0];
        assert_eq!(sharp_frames(&sharpness, rule).unwrap(), [1, 6]);
    }

    #[test]
    fn poison_is_refused() {
        let bad = sharp_frames(&[1.0, f64::NAN], SharpnessRule::default());
        assert!(matches!(bad, Err(EvalError::NotFinite { .. })));
        let bad = laplacian_variance(&grey_picture(2, &[f32::NAN; 4]));
        assert!(matches!(bad, Err(EvalError::NotFinite { .. })));
        let bad = laplacian_variance(&grey_picture(4, &[0.0; 4]));
        assert!(matches!(bad, Err(EvalError::TooFew { .. })));
        let two = Image::<f32>::new(3, 3, 2);
        assert!(matches!(laplacian_variance(&two), Err(EvalError::ShapeMismatch { .. })));
    }
}
