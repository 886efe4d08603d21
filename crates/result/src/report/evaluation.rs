//! The section of the report that `i2slam eval` fills in.

use crate::html::escape;
use i2slam::dataset::path_text;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::PathBuf;

const BEGIN: &str = "<!-- evaluation -->";
const END: &str = "<!-- /evaluation -->";

/// Results of one protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSection {
    /// The protocol and its options.
    pub title: String,
    /// Which frames were judged, and which could not be.
    pub notes: Vec<String>,
    /// Name and value with unit.
    pub rows: Vec<(String, String)>,
    /// Ground truth and frames; `None` in files of earlier versions.
    #[serde(default)]
    pub source: Option<EvaluationSource>,
}

/// Ground truth and frames of an evaluation, by which it can be repeated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSource {
    /// Name of the protocol.
    pub protocol: String,
    /// The list of frames, as given.
    pub list: Option<String>,
    /// Frames whose pictures were judged, by position in the associated stream.
    pub frames: Vec<usize>,
    /// The true trajectory.
    pub trajectory: Option<GroundTruthSource>,
    /// The true pictures.
    pub pictures: Option<GroundTruthSource>,
    /// True if these are the pictures taken, as no sharp ones are known.
    #[serde(default)]
    pub against_pictures_taken: bool,
}

/// Ground truth of trajectory or pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundTruthSource {
    /// File or folder, absolute.
    #[serde(with = "path_text")]
    pub path: PathBuf,
    /// Poses of the trajectory, or pictures compared with.
    pub count: usize,
    /// CRC-32 of the poses (time stamp, translation, quaternion w x y z as `f64`), or of the
    /// CRC-32s of the pictures' `f32` values as they were compared, in order; little endian.
    pub crc32: String,
}

/// Replaces the evaluation sections of a report; `None` for a page that is no report.
pub fn insert_evaluations(page: &str, sections: &[EvaluationSection]) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    let mut out = String::new();
    if !sections.is_empty() {
        out += "<section id=\"evaluation\">\n<h2>Evaluation</h2>\n<p>Compared by \
                <code>i2slam eval</code> with what each section names. Figures of \
                two protocols are of different frames, by \
                different measures: they must not stand in one column. They lie \
                beside this page in <code>evaluation.json</code>.</p>\n<div class=\"plots\">";
        sections.iter().for_each(|section| write_section(&mut out, section));
        out += "</div>\n</section>\n";
    }
    Some(format!("{before}{BEGIN}\n{out}{END}{after}"))
}

fn write_section(out: &mut String, section: &EvaluationSection) {
    let title = escape(&section.title);
    // Writing to a string cannot fail.
    write!(out, "<div class=\"plot\"><h3>{title}</h3>").ok();
    if let Some(source) = &section.source {
        write_source(out, source);
    }
    for note in &section.notes {
        write!(out, "<p class=\"none\">{}</p>", escape(note)).ok();
    }
    *out += "<table class=\"grades\">";
    for (name, value) in &section.rows {
        write!(out, "<tr><td>{}</td><td>{}</td></tr>", escape(name), escape(value)).ok();
    }
    *out += "</table></div>\n";
}

/// Writes a sentence that names the ground truth.
fn write_source(out: &mut String, source: &EvaluationSource) {
    let line = |truth: &GroundTruthSource, what: &str| {
        let (path, s) =
            (escape(&truth.path.to_string_lossy()), if truth.count == 1 { "" } else { "s" });
        format!("{} {what}{s} of <code>{path}</code>", truth.count)
    };
    let trajectory = source.trajectory.iter().map(|truth| line(truth, "true pose"));
    let picture = if source.against_pictures_taken { "taken picture" } else { "true picture" };
    let pictures = source.pictures.iter().map(|truth| line(truth, picture));
    let truths: Vec<String> = trajectory.chain(pictures).collect();
    if !truths.is_empty() {
        write!(out, "<p>Against {}.</p>", truths.join(" and ")).ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(title: &str, value: &str) -> EvaluationSection {
        EvaluationSection {
            title: title.to_owned(),
            notes: vec!["3 frames".to_owned()],
            rows: vec![("sharp PSNR".to_owned(), value.to_owned())],
            source: None,
        }
    }

    #[test]
    fn sections_are_put_in_and_replaced() {
        let page = super::super::TEMPLATE;
        let once = insert_evaluations(page, &[section("i2slam", "31.20 dB")]).expect("a place");
        assert!(once.contains("<h3>i2slam</h3>") && once.contains("31.20 dB"));
        let twice = insert_evaluations(&once, &[section("<b>", "9 dB"), section("x", "8 dB")]);
        let twice = twice.expect("a place");
        assert!(twice.contains("&lt;b&gt;") && !twice.contains("31.20 dB"));
        assert_eq!(twice.matches("class=\"grades\"").count(), 2);
        assert_eq!(
            insert_evaluations(&twice, &[]).as_deref(),
            insert_evaluations(page, &[]).as_deref()
        );
        assert_eq!(insert_evaluations("<p>another page</p>", &[]), None);
    }

    #[test]
    fn the_truth_is_named_and_older_files_are_read() {
        let truth =
            GroundTruthSource { path: "/data/<room>".into(), count: 1, crc32: "0".to_owned() };
        let source = EvaluationSource { trajectory: Some(truth), ..EvaluationSource::default() };
        let section = EvaluationSection { source: Some(source), ..section("x", "1") };
        let page = insert_evaluations(super::super::TEMPLATE, std::slice::from_ref(&section))
            .expect("a place");
        assert!(page.contains("Against 1 true pose of <code>/data/&lt;room&gt;</code>."));
        let truth = GroundTruthSource { path: "/x".into(), count: 2, crc32: "0".to_owned() };
        let source = EvaluationSource {
            pictures: Some(truth),
            against_pictures_taken: true,
            ..EvaluationSource::default()
        };
        let taken = EvaluationSection { source: Some(source), ..section.clone() };
        let page = insert_evaluations(super::super::TEMPLATE, &[taken]).expect("a place");
        assert!(page.contains("Against 2 taken pictures of <code>/x</code>."));
        let text = serde_json::to_string(&section).expect("JSON");
        assert_eq!(serde_json::from_str::<EvaluationSection>(&text).ok(), Some(section));
        let older = "{\"title\":\"x\",\"notes\":[],\"rows\":[]}";
        assert!(serde_json::from_str::<EvaluationSection>(older).is_ok_and(|s| s.source.is_none()));
    }
}
