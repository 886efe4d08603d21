//! Median and correlation.

/// Standard deviation of a normal distribution of mean zero over its median absolute value.
pub const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// The element in the middle of `values` by size (of an even number, the upper one), which are
/// reordered; `None` without any. NaN counts as larger than every number.
pub fn median<T: PartialOrd + Copy>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let is_nan = |v: &T| v.partial_cmp(v).is_none();
    let by_size = |a: &T, b: &T| a.partial_cmp(b).unwrap_or_else(|| is_nan(a).cmp(&is_nan(b)));
    Some(*values.select_nth_unstable_by(middle, by_size).1)
}

/// Pearson correlation of pairs of numbers; `None` where either side is constant or not finite.
pub fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let count = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
    let mean = (mean.0 / count, mean.1 / count);
    let (mut both, mut first, mut second) = (0.0, 0.0, 0.0);
    for pair in pairs {
        let (x, y) = (pair.0 - mean.0, pair.1 - mean.1);
        both += x * y;
        first += x * x;
        second += y * y;
    }
    let scale = (first * second).sqrt();
    (scale > 0.0).then(|| both / scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_by_size() {
        assert_eq!(median(&mut [3.0, 9.0, 1.0]), Some(3.0));
        assert_eq!(median(&mut [4, 1, 3, 2]), Some(3));
        assert_eq!(median(&mut [f32::NAN, 5.0, 1.0, f32::NAN, 3.0]), Some(5.0));
        assert_eq!(median::<f32>(&mut []), None);
    }

    #[test]
    fn correlation_sees_neither_gain_nor_bias() {
        let pairs = [1.0, 4.0, 2.0, 9.0].map(|x| (x, 3.0 - 0.5 * x));
        assert!((correlation(&pairs).expect("spread") + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&[(1.0, 2.0), (1.0, 5.0)]), None);
        assert_eq!(correlation(&[]), None);
    }
}
