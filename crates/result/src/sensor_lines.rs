//! Sentences on how the sensor took rows and depth, which terminal and report share.

/// Time in which the rows are read, if not all at once: `readout` from the first to the last \[s\].
pub fn rolling_shutter_line(readout: f64) -> Option<String> {
    (readout != 0.0).then(|| format!("rolling shutter: rows read in {:.1} ms", 1e3 * readout))
}

/// When and where depth was taken, if not with its time stamps and at the pixels of the pictures: `delay` from
/// the stamps \[s\], displacement to the right and down \[px\].
pub fn depth_registration_line(delay: f64, [right, down]: [f64; 2]) -> Option<String> {
    let when = (delay != 0.0).then(|| {
        let side = if delay < 0.0 { "before" } else { "after" };
        format!("taken {:.1} ms {side} their time stamps", 1e3 * delay.abs())
    });
    let place = ([right, down] != [0.0; 2]).then(|| {
        let (across, along) =
            (if right < 0.0 { "left" } else { "right" }, if down < 0.0 { "up" } else { "down" });
        format!(
            "displaced by {:.1} px to the {across} and {:.1} px {along}",
            right.abs(),
            down.abs()
        )
    });
    let found: Vec<String> = when.into_iter().chain(place).collect();
    (!found.is_empty()).then(|| format!("depth pictures: {}, which is corrected", found.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_that_is_late_or_displaced_is_told() {
        assert_eq!(depth_registration_line(0.0, [0.0; 2]), None);
        let line = depth_registration_line(-0.0134, [0.0; 2]).expect("a delay");
        assert!(line.contains("taken 13.4 ms before their time stamps, which"), "{line}");
        let line = depth_registration_line(0.02, [-2.5, 1.0]).expect("both");
        assert!(
            line.contains("20.0 ms after their")
                && line.contains("2.5 px to the left and 1.0 px down"),
            "{line}"
        );
    }
}
