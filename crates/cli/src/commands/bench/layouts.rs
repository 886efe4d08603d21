//! The paper's tables.

use super::figures::{ATE, DEPTH, Figure, LPIPS, MAPPING, MEMORY, PSNR, SECONDS, SSIM, TRACKING};
use super::notes::{about, machine, over_sequences};
use super::suite::{Layout, Protocol};
use super::summary::Results;
use super::table::{Entry, Table, mark_best};

/// The tables that the suite asks for, and the list of what is missing.
pub(super) fn tables(results: &Results<'_>) -> Vec<Table> {
    let table = |layout: &Layout| match layout {
        Layout::Rendering => rendering(results),
        Layout::Tracking => tracking(results),
        Layout::Ablation => ablation(results),
        Layout::Runtime => runtime(results),
        Layout::VirtualCameras => virtual_cameras(results),
    };
    let mut tables: Vec<Table> = results.plan.suite.tables.iter().map(table).collect();
    tables.extend(missing(results));
    tables
}

/// Groups over the columns of sequences, after `before` columns and before the mean.
fn groups(results: &Results<'_>, before: usize) -> Vec<(String, usize)> {
    let mut groups = vec![(String::new(), before)];
    for sequence in &results.plan.sequences {
        match groups.last_mut() {
            Some((name, width)) if *name == sequence.group => *width += 1,
            _ => groups.push((sequence.group.clone(), 1)),
        }
    }
    groups
}

fn sequence_names(results: &Results<'_>, before: &[&str]) -> Vec<String> {
    let before = before.iter().map(|&name| name.to_owned());
    let mut header: Vec<String> =
        before.chain(results.plan.sequences.iter().map(|s| s.name.clone())).collect();
    if results.plan.sequences.len() > 1 {
        header.push("mean".to_owned());
    }
    header
}

/// One figure of one configuration on every sequence, and the mean over them.
fn across(results: &Results<'_>, setting: usize, figure: &'static Figure) -> Vec<Entry> {
    let count = results.plan.sequences.len();
    let mut values: Vec<_> = (0..count).map(|s| results.of(s, setting, figure)).collect();
    if count > 1 {
        values.push(results.over_sequences(setting, figure));
    }
    values.into_iter().map(|value| Entry::number(value, figure)).collect()
}

/// Table of the rendering quality: a block of metrics for every method.
fn rendering(results: &Results<'_>) -> Table {
    let all = [&PSNR, &SSIM, &LPIPS, &DEPTH];
    let known = all.iter().filter(|figure| !results.sequences_with(figure).is_empty());
    let mut figures: Vec<&'static Figure> = known.copied().collect();
    if figures.is_empty() {
        figures.push(&PSNR);
    }
    let mut rows = Vec::new();
    for (place, setting) in results.plan.settings.iter().enumerate() {
        for figure in &figures {
            let heads = [setting.entry.name.clone(), figure.heading()].map(Entry::Words);
            rows.push(heads.into_iter().chain(across(results, place, figure)).collect());
        }
    }
    best_by_figure(&mut rows, figures.len(), 2);
    let mut groups = groups(results, 2);
    if results.plan.sequences.len() > 1 {
        groups.push((String::new(), 1));
    }
    let mut what = "Renders at mid-exposure against true sharp pictures, or, where a list of \
                    frames is given, against the pictures taken of these frames."
        .to_owned();
    let suite = &results.plan.suite;
    if suite.protocol == Some(Protocol::HeldOut) {
        what += " Only frames that the map never saw.";
    }
    if suite.optimise_poses {
        what += " Each seen from where the map fits its true picture best.";
    }
    Table {
        slug: "rendering",
        title: "Rendering quality",
        note: about(results, &what),
        groups,
        header: sequence_names(results, &["Method", "Metric"]),
        rows,
    }
}

/// Table of the trajectory errors.
fn tracking(results: &Results<'_>) -> Table {
    let row = |place: usize| {
        let name = Entry::Words(results.plan.settings[place].entry.name.clone());
        std::iter::once(name).chain(across(results, place, &ATE)).collect()
    };
    let mut rows: Vec<Vec<Entry>> = (0..results.plan.settings.len()).map(row).collect();
    best_by_figure(&mut rows, 1, 1);
    let mut groups = groups(results, 1);
    if results.plan.sequences.len() > 1 {
        groups.push((String::new(), 1));
    }
    Table {
        slug: "tracking",
        title: "Tracking accuracy",
        note: about(
            results,
            "ATE RMSE of camera centres after rigid alignment [cm], less is better.",
        ),
        groups,
        header: sequence_names(results, &["Method"]),
        rows,
    }
}

/// Marks the best of every column among the rows of one figure; rows come in blocks of `block`.
fn best_by_figure(rows: &mut [Vec<Entry>], block: usize, first: usize) {
    let columns = rows.first().map_or(0, Vec::len);
    for offset in 0..block {
        for column in first..columns {
            let same = rows.iter_mut().skip(offset).step_by(block);
            mark_best(same.filter_map(|row| row.get_mut(column)));
        }
    }
}

/// A table with a row for every configuration and a column for every figure, each the mean over
/// the sequences.
fn averages(
    results: &Results<'_>,
    heads: &[&str],
    figures: &[&'static Figure],
    head: impl Fn(usize) -> Vec<String>,
) -> (Vec<String>, Vec<Vec<Entry>>) {
    let header = heads.iter().map(|&name| name.to_owned());
    let header = header.chain(figures.iter().map(|figure| figure.heading())).collect();
    let row = |place: usize| {
        let numbers = figures
            .iter()
            .map(|figure| Entry::number(results.over_sequences(place, figure), figure));
        head(place).into_iter().map(Entry::Words).chain(numbers).collect()
    };
    let mut rows: Vec<Vec<Entry>> = (0..results.plan.settings.len()).map(row).collect();
    best_by_figure(&mut rows, 1, heads.len());
    (header, rows)
}

fn ablation(results: &Results<'_>) -> Table {
    let tick = |on: bool| if on { "✓" } else { "✗" }.to_owned();
    let head = |place: usize| {
        let setting = &results.plan.settings[place];
        let parts = &setting.config.formation;
        let ticks = [parts.trajectory_loss, parts.tone, parts.blur].map(tick);
        std::iter::once(setting.entry.name.clone()).chain(ticks).collect()
    };
    let heads = ["Configuration", "Traj. reg.", "Tone mapping", "Motion blur"];
    let (header, rows) = averages(results, &heads, &[&ATE, &PSNR, &SSIM, &LPIPS], head);
    let note = over_sequences(results, "The parts of the image formation model, switched off.");
    Table { slug: "ablation", title: "Ablation", note, groups: Vec::new(), header, rows }
}

fn runtime(results: &Results<'_>) -> Table {
    let figures = [&MAPPING, &TRACKING, &SECONDS, &ATE, &PSNR, &SSIM, &LPIPS, &MEMORY];
    let head = |place: usize| vec![results.plan.settings[place].entry.name.clone()];
    let (header, rows) = averages(results, &["Method"], &figures, head);
    let what = format!(
        "Wall time per frame; the whole run also reads frames and refines the map at the end. {}",
        machine(results)
    );
    let note = over_sequences(results, &what);
    Table { slug: "runtime", title: "Runtime", note, groups: Vec::new(), header, rows }
}

fn virtual_cameras(results: &Results<'_>) -> Table {
    let head = |place: usize| {
        let setting = &results.plan.settings[place];
        let count = setting.config.formation.virtual_cameras;
        vec![setting.entry.name.clone(), count.to_string()]
    };
    let figures = [&PSNR, &SSIM, &LPIPS, &ATE, &SECONDS];
    let (header, rows) = averages(results, &["Configuration", "Virtual cameras"], &figures, head);
    let note = over_sequences(results, "Cameras that draw the blur of one exposure.");
    Table {
        slug: "virtual-cameras",
        title: "Number of virtual cameras",
        note,
        groups: Vec::new(),
        header,
        rows,
    }
}

/// Every cell that has no figures, with the reason.
fn missing(results: &Results<'_>) -> Option<Table> {
    let cells = results.plan.cells.iter().enumerate();
    let row = |(place, cell): (usize, &super::plan::Cell)| {
        let reason = results.failure(place).unwrap_or("not run yet");
        let plan = results.plan;
        let words = [
            plan.sequences[cell.sequence].name.clone(),
            plan.settings[cell.setting].entry.name.clone(),
            cell.seed.to_string(),
            reason.to_owned(),
        ];
        words.map(Entry::Words).into()
    };
    let rows: Vec<Vec<Entry>> =
        cells.filter(|(place, _)| !results.finished(*place)).map(row).collect();
    (!rows.is_empty()).then(|| Table {
        slug: "missing",
        title: "Cells without a result",
        note: "The same command runs them again; finished cells are kept.".to_owned(),
        groups: Vec::new(),
        header: ["Sequence", "Configuration", "Seed", "Reason"].map(str::to_owned).into(),
        rows,
    })
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{plan, results};
    use super::*;

    #[test]
    fn the_tables_of_the_paper_are_there_with_what_failed() {
        let plan = plan();
        let tables = tables(&results(&plan, &[(1, 0, 0), (1, 0, 1)]));
        let slugs: Vec<&str> = tables.iter().map(|table| table.slug).collect();
        let due = ["rendering", "tracking", "ablation", "runtime", "virtual-cameras", "missing"];
        assert_eq!(slugs, due);
        let tracking = tables[1].markdown();
        assert!(tracking.contains("| Method | G a | b | mean |"), "{tracking}");
        let row = "| on | **150.00 ± 70.71** | failed | failed |";
        assert!(tracking.contains(row), "{tracking}");
        let ablation = tables[2].markdown();
        assert!(ablation.contains("| off \\| <x> | ✓ | ✓ | ✗ | 10650.00 ± 70.71 |"), "{ablation}");
        let missing = tables[5].markdown();
        assert!(missing.contains("| b | on | 1 | no \\| room |"), "{missing}");
    }

    #[test]
    fn nothing_is_missing_where_all_cells_finished() {
        let plan = plan();
        assert_eq!(tables(&results(&plan, &[])).len(), 5);
    }
}
