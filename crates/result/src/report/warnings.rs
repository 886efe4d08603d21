//! What there is to know of the run, below its figures.

use super::escape;
use i2slam::Warning;
use std::fmt::Write;

/// Warnings that are seen without unfolding the others.
const OPEN: usize = 6;

/// The section; nothing where nothing was unusual.
pub(super) fn section(warnings: &[Warning]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let (open, folded) = warnings.split_at(warnings.len().min(OPEN));
    let mut out = format!(
        "<section id=\"warnings\">\n<h2>Warnings</h2>\n<ul class=\"warnings\">{}</ul>",
        items(open)
    );
    if !folded.is_empty() {
        let (count, items) = (folded.len(), items(folded));
        write!(
            out,
            "<details><summary>{count} more</summary><ul class=\"warnings\">{items}</ul></details>"
        )
        .ok();
    }
    out + "\n</section>"
}

fn items(warnings: &[Warning]) -> String {
    let item = |warning: &Warning| {
        let time = warning.time_s.map(|time| format!(" <small>at {time:.2} s</small>"));
        format!("<li>{}{}</li>", escape(&warning.text), time.unwrap_or_default())
    };
    warnings.iter().map(item).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_warning_is_there_with_its_time_and_many_are_folded() {
        assert_eq!(section(&[]), "");
        let of = |count: usize| -> String {
            let warning = |i| Warning::of_frame(i, "a < b").with_time(|i| Some(0.5 * i as f64));
            section(&(0..count).map(warning).collect::<Vec<_>>())
        };
        let two = of(2);
        assert!(two.contains("<li>frame 1: a &lt; b <small>at 0.50 s</small></li>"), "{two}");
        assert!(!two.contains("details"));
        let many = of(OPEN + 3);
        assert!(many.contains("3 more") && many.matches("<li>").count() == OPEN + 3, "{many}");
    }
}
