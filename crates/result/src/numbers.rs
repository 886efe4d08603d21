//! Numbers in sentences.

/// Three significant digits, without exponent.
pub(crate) fn significant(value: f64) -> String {
    let digits = if value > 0.0 && value.is_finite() { 2.0 - value.log10().floor() } else { 0.0 };
    format!("{value:.*}", digits.clamp(0.0, 6.0) as usize)
}

/// A count with narrow spaces between thousands.
pub(crate) fn thousands(count: usize) -> String {
    let digits = count.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_short() {
        assert_eq!(significant(1.8349), "1.83");
        assert_eq!(significant(0.04231), "0.0423");
        assert_eq!(significant(123.4), "123");
        assert_eq!(significant(0.0), "0");
        assert_eq!(thousands(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(thousands(12), "12");
    }
}
