//! The tables of the results, in the layouts of the paper.

use crate::console::counted;
use crate::metrics::{
    ATE, DEPTH, GAUSSIANS, LPIPS, MAPPING, MEMORY, Metric, OFF_SURFACE, PINHOLES, PSNR, SECONDS,
    SEE_THROUGH, SSIM, TRACKING,
};
use crate::plan::{Configuration, Job};
use crate::suite::{Protocol, TableKind};
use crate::summary::Results;
use crate::table::{Entry, Table, mark_best};
use std::collections::BTreeSet;

/// The tables of the suite, and that of jobs without a result.
pub(crate) fn tables(results: &Results<'_>) -> Vec<Table> {
    let table = |kind: &TableKind| match kind {
        TableKind::Rendering => rendering(results),
        TableKind::Tracking => tracking(results),
        TableKind::Ablation => ablation(results),
        TableKind::Runtime => runtime(results),
        TableKind::VirtualCameras => virtual_cameras(results),
        TableKind::Map => map(results),
    };
    let mut tables: Vec<Table> = results.plan.suite.tables.iter().map(table).collect();
    tables.extend(missing(results));
    tables
}

/// A table with a column for every sequence and their mean, and a row for every configuration and
/// metric. With several metrics the second column names them.
fn sequence_table(
    results: &Results<'_>,
    (slug, title): (&'static str, &'static str),
    what: &str,
    heads: &[&str],
    metrics: &[&'static Metric],
) -> Table {
    let sequences = &results.plan.sequences;
    let has_mean = sequences.len() > 1;
    let mut groups = vec![(String::new(), heads.len())];
    for sequence in sequences {
        match groups.last_mut() {
            Some((name, width)) if *name == sequence.group => *width += 1,
            _ => groups.push((sequence.group.clone(), 1)),
        }
    }
    let mut header: Vec<String> = heads.iter().map(|&name| name.to_owned()).collect();
    header.extend(sequences.iter().map(|sequence| sequence.name.clone()));
    if has_mean {
        groups.push((String::new(), 1));
        header.push("mean".to_owned());
    }
    let mut rows = Vec::new();
    for (place, configuration) in results.plan.configurations.iter().enumerate() {
        for &metric in metrics {
            let names = [configuration.entry.name.clone(), metric.heading()];
            let names = names.into_iter().take(heads.len()).map(Entry::Words);
            let values = (0..sequences.len()).map(|s| results.of(s, place, metric));
            let mean = has_mean.then(|| results.over_sequences(place, metric));
            let numbers = values.chain(mean).map(|value| Entry::number(value, metric));
            rows.push(names.chain(numbers).collect());
        }
    }
    best_by_metric(&mut rows, metrics.len(), heads.len());
    Table { slug, title, caption: caption(results, what), groups, header, rows }
}

/// Rendering quality: a block of metrics for every configuration.
fn rendering(results: &Results<'_>) -> Table {
    let all = [&PSNR, &SSIM, &LPIPS, &DEPTH];
    let known = all.iter().filter(|metric| !results.sequences_with(metric).is_empty());
    let mut metrics: Vec<&'static Metric> = known.copied().collect();
    if metrics.is_empty() {
        metrics.push(&PSNR);
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
    let name = ("rendering", "Rendering quality");
    sequence_table(results, name, &what, &["Method", "Metric"], &metrics)
}

fn tracking(results: &Results<'_>) -> Table {
    let what = "ATE RMSE of camera centres after rigid alignment, of colour alone with scale [cm]; \
                less is better.";
    sequence_table(results, ("tracking", "Tracking accuracy"), what, &["Method"], &[&ATE])
}

/// Size and density of maps.
fn map(results: &Results<'_>) -> Table {
    let what = "Gaussians of the map, and pinholes: share of the surface seen by a frame through which \
                more than half of the light passes, as viewers draw map.ply from 40 % nearer, of these \
                the see-through ones, where no Gaussian at another depth stops it; share of the Gaussians \
                off the surface by more than 2 % of its depth.";
    sequence_table(
        results,
        ("map", "Size and density of the map"),
        what,
        &["Method", "Metric"],
        &[&GAUSSIANS, &PINHOLES, &SEE_THROUGH, &OFF_SURFACE],
    )
}

/// Marks the best of every column among the rows of one metric; there is a row per metric in every
/// block of `block` rows.
fn best_by_metric(rows: &mut [Vec<Entry>], block: usize, first: usize) {
    let columns = rows.first().map_or(0, Vec::len);
    for offset in 0..block {
        for column in first..columns {
            let same = rows.iter_mut().skip(offset).step_by(block);
            mark_best(same.filter_map(|row| row.get_mut(column)));
        }
    }
}

/// A table of means over the sequences: a row for every configuration, which begins with `head`,
/// and a column for every metric.
fn mean_table(
    results: &Results<'_>,
    (slug, title): (&'static str, &'static str),
    what: &str,
    heads: &[&str],
    metrics: &[&'static Metric],
    head: impl Fn(&Configuration) -> Vec<String>,
) -> Table {
    let header = heads.iter().map(|&name| name.to_owned());
    let header = header.chain(metrics.iter().map(|metric| metric.heading())).collect();
    let row = |(place, configuration): (usize, &Configuration)| {
        let names = head(configuration).into_iter().map(Entry::Words);
        let number = |&metric| Entry::number(results.over_sequences(place, metric), metric);
        names.chain(metrics.iter().map(number)).collect()
    };
    let mut rows: Vec<_> = results.plan.configurations.iter().enumerate().map(row).collect();
    best_by_metric(&mut rows, 1, heads.len());
    Table { slug, title, caption: mean_caption(results, what), groups: Vec::new(), header, rows }
}

fn ablation(results: &Results<'_>) -> Table {
    let tick = |on: bool| if on { "✓" } else { "✗" }.to_owned();
    let head = |configuration: &Configuration| {
        let parts = &configuration.config.formation;
        let ticks = [parts.trajectory_loss, parts.tone, parts.blur].map(tick);
        std::iter::once(configuration.entry.name.clone()).chain(ticks).collect()
    };
    let what = "The parts of the image formation model, switched off.";
    let heads = ["Configuration", "Traj. reg.", "Tone mapping", "Motion blur"];
    let metrics = [&ATE, &PSNR, &SSIM, &LPIPS];
    mean_table(results, ("ablation", "Ablation"), what, &heads, &metrics, head)
}

fn runtime(results: &Results<'_>) -> Table {
    let head = |configuration: &Configuration| vec![configuration.entry.name.clone()];
    let what = format!(
        "Wall time per frame; the whole run also reads frames and refines the map at the end. {}",
        machine(results)
    );
    let metrics = [&MAPPING, &TRACKING, &SECONDS, &ATE, &PSNR, &SSIM, &LPIPS, &MEMORY];
    mean_table(results, ("runtime", "Runtime"), &what, &["Method"], &metrics, head)
}

fn virtual_cameras(results: &Results<'_>) -> Table {
    let head = |configuration: &Configuration| {
        let count = configuration.config.formation.virtual_cameras;
        vec![configuration.entry.name.clone(), count.to_string()]
    };
    let what = "Cameras that draw the blur of one exposure.";
    let name = ("virtual-cameras", "Number of virtual cameras");
    let metrics = [&PSNR, &SSIM, &LPIPS, &ATE, &SECONDS];
    mean_table(results, name, what, &["Configuration", "Virtual cameras"], &metrics, head)
}

/// Jobs without metrics, with the reason.
fn missing(results: &Results<'_>) -> Option<Table> {
    let jobs = results.plan.jobs.iter().enumerate();
    let row = |(place, job): (usize, &Job)| {
        let reason = results.failure(place).unwrap_or("not run yet");
        let plan = results.plan;
        let words = [
            plan.sequences[job.sequence].name.clone(),
            plan.configurations[job.configuration].entry.name.clone(),
            job.seed.to_string(),
            reason.to_owned(),
        ];
        words.map(Entry::Words).into()
    };
    let rows: Vec<Vec<Entry>> =
        jobs.filter(|(place, _)| !results.finished(*place)).map(row).collect();
    (!rows.is_empty()).then(|| Table {
        slug: "missing",
        title: "Jobs without a result",
        caption: "The same command runs them again; finished jobs are kept.".to_owned(),
        groups: Vec::new(),
        header: ["Sequence", "Configuration", "Seed", "Reason"].map(str::to_owned).into(),
        rows,
    })
}

/// The caption of a table: `what`, its seeds, and sequences without a result.
fn caption(results: &Results<'_>, what: &str) -> String {
    let plan = results.plan;
    let seeds: Vec<String> = plan.suite.seeds.iter().map(u64::to_string).collect();
    let seeds = match seeds.len() {
        1 => format!("One seed: {}", seeds[0]),
        count => {
            let list = seeds.join(", ");
            format!("Mean ± standard deviation over {count} seeds ({list})")
        }
    };
    let lost = |sequence: &usize| {
        let mut jobs = plan.jobs.iter().enumerate();
        !jobs.any(|(place, job)| job.sequence == *sequence && results.finished(place))
    };
    let lost: Vec<&str> = (0..plan.sequences.len())
        .filter(lost)
        .map(|sequence| plan.sequences[sequence].name.as_str())
        .collect();
    match lost.is_empty() {
        true => format!("{what} {seeds}."),
        false => {
            format!("{what} {seeds}; no job of {} finished: it is in no mean.", lost.join(", "))
        }
    }
}

/// The caption of a table of means over sequences.
fn mean_caption(results: &Results<'_>, what: &str) -> String {
    let text = match results.plan.sequences.len() {
        1 => format!("{what} On {}.", results.plan.sequences[0].name),
        count => {
            format!("{what} Means over the {count} sequences, of those with the truth for it.")
        }
    };
    caption(results, &text)
}

/// Threads of a job and jobs at once.
pub(crate) fn machine(results: &Results<'_>) -> String {
    let used: BTreeSet<_> = results.records().map(|r| (r.threads, r.parallel)).collect();
    let words: Vec<String> = used
        .iter()
        .map(|&(threads, parallel)| {
            format!("{} a job, {} at once", counted(threads, "thread"), counted(parallel, "job"))
        })
        .collect();
    match words.len() {
        0 => String::new(),
        1 => format!("Measured with {}.", words[0]),
        _ => format!(
            "Jobs were run in different ways, so that their times cannot be compared: {}.",
            words.join("; ")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::{plan, results};

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
        assert!(
            ablation.contains("| off \\| &lt;x> | ✓ | ✓ | ✗ | 10650.00 ± 70.71 |"),
            "{ablation}"
        );
        let missing = tables[5].markdown();
        assert!(missing.contains("| b | on | 1 | no \\| room |"), "{missing}");
    }

    #[test]
    fn nothing_is_missing_where_all_jobs_finished() {
        let plan = plan();
        assert_eq!(tables(&results(&plan, &[])).len(), 5);
    }
}
