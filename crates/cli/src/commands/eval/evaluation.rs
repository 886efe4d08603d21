//! All results of an evaluation, as a table, as JSON and as a section of the report.

use super::metric_value::{MetricValue, TableRow};
use super::pictures::PictureErrors;
use super::{Eval, Protocol, trajectory};
use crate::console::{print, print_status};
use crate::failure::{Failure, failed};
use crate::messages::note_displaced;
use i2slam_result::report::{
    EvaluationSection, EvaluationSource, GroundTruthSource, insert_evaluations,
};
use i2slam_storage::OutputFolder;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// All figures of an evaluation.
#[derive(Default)]
pub(super) struct Evaluation {
    pub(super) protocol: String,
    pub(super) trajectory: Option<trajectory::TrajectoryErrors>,
    pub(super) pictures: Option<PictureErrors>,
    /// Mean pose corrections; `None` without pose optimisation.
    pub(super) corrections: Option<Vec<MetricValue>>,
    pub(super) radiance: Vec<MetricValue>,
    /// Exposure and white balance.
    pub(super) tones: Vec<MetricValue>,
    /// Whether renders were compared with the recorded, blurred pictures.
    pub(super) is_against_recorded: bool,
    /// The true trajectory.
    pub(super) true_trajectory: Option<GroundTruthSource>,
    /// The true pictures.
    pub(super) true_pictures: Option<GroundTruthSource>,
    /// Ground truth from elsewhere than the dataset of the run, and that dataset.
    pub(super) foreign: Option<(Vec<PathBuf>, PathBuf)>,
    /// Parts that were not evaluated, with reasons.
    pub(super) not_evaluated: Vec<String>,
    /// Error of the pictures, reported after all results.
    pub(super) problem: Option<Failure>,
}

impl Evaluation {
    /// One flat object with all results, and an array of frames.
    pub(super) fn json(&self) -> Result<Value, Failure> {
        let mut object = Map::new();
        object.insert("protocol".to_owned(), self.protocol.as_str().into());
        object.insert("poses_optimised".to_owned(), self.corrections.is_some().into());
        if let Some(errors) = &self.trajectory {
            object.extend(errors.json()?);
        }
        if let Some(pictures) = &self.pictures {
            object.extend(pictures.json());
        }
        object.extend(self.corrections.iter().flatten().map(MetricValue::json));
        object.extend(self.radiance.iter().map(MetricValue::json));
        object.extend(self.tones.iter().map(MetricValue::json));
        object.insert("against_pictures_taken".to_owned(), self.is_against_recorded.into());
        object.insert("true_trajectory".to_owned(), json!(self.true_trajectory));
        object.insert("true_pictures".to_owned(), json!(self.true_pictures));
        object.insert("not_judged".to_owned(), json!(self.not_evaluated));
        Ok(Value::Object(object))
    }

    pub(super) fn print(&self) {
        self.rows().iter().for_each(|row| print(&row.line()));
        self.remarks().iter().for_each(|line| print_status(line));
    }

    /// Notes and warnings that qualify the results.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks: Vec<String> =
            self.not_evaluated.iter().map(|what| format!("note: {what}")).collect();
        if let Some((truths, dataset)) = &self.foreign {
            let names: Vec<String> = truths.iter().map(|t| t.display().to_string()).collect();
            remarks.push(format!(
                "note: the run read {}, and is evaluated against {}",
                dataset.display(),
                names.join(" and ")
            ));
        }
        if self.is_against_recorded {
            remarks.push("note: compared with the pictures taken, no sharp ones are known".into());
        }
        remarks.extend(self.pictures.iter().flat_map(PictureErrors::remarks));
        remarks
    }

    fn rows(&self) -> Vec<TableRow> {
        let mut rows: Vec<TableRow> =
            self.trajectory.iter().flat_map(|errors| errors.rows()).collect();
        if self.corrections.is_some() {
            rows.iter_mut().for_each(|row| row.rest += ", poses as tracked");
        }
        rows.extend(self.pictures.iter().flat_map(PictureErrors::rows));
        if self.is_against_recorded {
            // The true pictures are blurred as well.
            rows.iter_mut().for_each(|row| row.name = row.name.replace("sharp ", ""));
        }
        rows.extend(self.corrections.iter().flatten().map(MetricValue::row));
        rows.extend(self.radiance.iter().map(MetricValue::row));
        rows.extend(self.tones.iter().map(MetricValue::row));
        rows
    }

    /// Section of the report. Its title names all options that change the results, as a section
    /// replaces the one with its title.
    pub(super) fn section(&self, arguments: &Eval) -> EvaluationSection {
        let mut title = format!("Protocol {}", self.protocol);
        let list = self.pictures.as_ref().and_then(|pictures| pictures.list.as_ref());
        if let Some(list) = list {
            title += &format!(", list {list}");
        }
        if arguments.protocol == Protocol::Splatam {
            title += &format!(", every {}", arguments.every);
        }
        if self.pictures.is_none() && self.radiance.is_empty() {
            title += ", trajectory alone";
        }
        if self.corrections.is_some() {
            title += ", poses optimised";
        }
        if self.trajectory.as_ref().is_some_and(trajectory::TrajectoryErrors::is_scaled) {
            title += ", aligned with scale";
        }
        for truth in self.foreign.iter().flat_map(|(truths, _)| truths) {
            title += &format!(", against {}", truth.display());
        }
        let row =
            |row: TableRow| (row.name, format!("{}{}", row.number, row.rest).trim_end().to_owned());
        let rows = self.rows().into_iter().map(row).collect();
        EvaluationSection { title, notes: self.remarks(), rows, source: Some(self.source()) }
    }

    fn source(&self) -> EvaluationSource {
        let pictures = self.pictures.as_ref();
        EvaluationSource {
            protocol: self.protocol.clone(),
            list: pictures.and_then(|pictures| pictures.list.clone()),
            frames: pictures.map(PictureErrors::frames).unwrap_or_default(),
            trajectory: self.true_trajectory.clone(),
            pictures: self.true_pictures.clone(),
            against_pictures_taken: self.is_against_recorded,
        }
    }
}

const FILE: &str = "evaluation.json";
const PAGE: &str = "report.html";

/// Adds a section to `evaluation.json` and `report.html`, or replaces the one with its title. A
/// folder without a report was written by another program and stays as it is.
pub(super) fn add_to_report(result: &Path, section: EvaluationSection) -> Result<(), Failure> {
    let page = result.join(PAGE);
    if !page.is_file() {
        return Ok(());
    }
    let mut folder = OutputFolder::extend(result, "i2slam eval", &[FILE, PAGE])?;
    let text = i2slam_storage::read_text(&page).map_err(|e| failed(&page, e))?;
    let mut sections = saved_sections(&result.join(FILE))?;
    match sections.iter_mut().find(|known| known.title == section.title) {
        Some(known) => *known = section,
        None => sections.push(section),
    }
    let Some(text) = insert_evaluations(&text, &sections) else {
        return Err(failed(&page, "has no place for evaluations: an older program wrote it"));
    };
    let json = serde_json::to_string_pretty(&sections);
    let json = json.map_err(|e| Failure::Failed(e.to_string()))?;
    folder.write_text(FILE, &(json + "\n"))?;
    folder.write_text(PAGE, &text)?;
    note_displaced(&folder.commit()?);
    Ok(())
}

fn saved_sections(file: &Path) -> Result<Vec<EvaluationSection>, Failure> {
    if !file.is_file() {
        return Ok(Vec::new());
    }
    let text = i2slam_storage::read_text(file).map_err(|e| failed(file, e))?;
    serde_json::from_str(&text).map_err(|e| failed(file, e))
}
