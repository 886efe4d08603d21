//! The median.

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
}
