//! The part of the page that an evaluation fills in later.

use super::escape;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

const BEGIN: &str = "<!-- evaluation -->";
const END: &str = "<!-- /evaluation -->";

/// What one protocol found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSection {
    /// The protocol, and what else decides the numbers.
    pub title: String,
    /// Which frames were judged, and what could not be.
    pub notes: Vec<String>,
    /// Name and value with unit.
    pub rows: Vec<(String, String)>,
}

/// The page with these sections in place of those that it has; `None` for a page that has no
/// place for them.
pub fn put_evaluations(page: &str, sections: &[EvaluationSection]) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    let mut out = String::new();
    if !sections.is_empty() {
        out += "<section id=\"evaluation\">\n<h2>Evaluation</h2>\n<p>Against the truth, by \
                <code>i2slam eval</code>. Figures of two protocols are of different frames, by \
                different measures: they must not stand in one column.</p>\n<div class=\"plots\">";
        sections.iter().for_each(|section| write_section(&mut out, section));
        out += "</div>\n</section>\n";
    }
    Some(format!("{before}{BEGIN}\n{out}{END}{after}"))
}

fn write_section(out: &mut String, section: &EvaluationSection) {
    let title = escape(&section.title);
    // Writing to a string cannot fail.
    write!(out, "<div class=\"plot\"><h3>{title}</h3>").ok();
    for note in &section.notes {
        write!(out, "<p class=\"none\">{}</p>", escape(note)).ok();
    }
    *out += "<table class=\"grades\">";
    for (name, value) in &section.rows {
        write!(out, "<tr><td>{}</td><td>{}</td></tr>", escape(name), escape(value)).ok();
    }
    *out += "</table></div>\n";
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(title: &str, value: &str) -> EvaluationSection {
        EvaluationSection {
            title: title.to_owned(),
            notes: vec!["3 frames".to_owned()],
            rows: vec![("sharp PSNR".to_owned(), value.to_owned())],
        }
    }

    #[test]
    fn sections_are_put_in_and_replaced() {
        let page = super::super::TEMPLATE;
        let once = put_evaluations(page, &[section("i2slam", "31.20 dB")]).expect("a place");
        assert!(once.contains("<h3>i2slam</h3>") && once.contains("31.20 dB"));
        let twice = put_evaluations(&once, &[section("<b>", "9 dB"), section("x", "8 dB")]);
        let twice = twice.expect("a place");
        assert!(twice.contains("&lt;b&gt;") && !twice.contains("31.20 dB"));
        assert_eq!(twice.matches("class=\"grades\"").count(), 2);
        assert_eq!(put_evaluations(&twice, &[]).as_deref(), put_evaluations(page, &[]).as_deref());
        assert_eq!(put_evaluations("<p>another page</p>", &[]), None);
    }
}
