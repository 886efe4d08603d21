//! The results: `results.md`, `results.html` and CSV files.

use crate::console::{Failure, counted};
use crate::metrics::{ATE, Metric, PSNR, SECONDS};
use crate::queue::Outcome;
use crate::suite::TableKind;
use crate::summary::Results;
use crate::table::{Table, csv_line, markdown_text};
use crate::tables;
use i2slam_result::html::{STYLE, escape};
use i2slam_result::plot::{Horizontal, Plot, Point, Series};
use i2slam_storage::write_file;
use std::collections::BTreeSet;
use std::path::Path;

const OWN_STYLE: &str = include_str!("report.css");

/// Writes tables, jobs and report.
pub(crate) fn write(results: &Results<'_>, out: &Path) -> Result<(), Failure> {
    let write = |name: &str, text: &str| {
        write_file(&out.join(name), |file| file.write_all(text.as_bytes()))
    };
    let tables = tables::tables(results);
    for table in &tables {
        write(&format!("tables/{}.csv", table.slug), &table.csv())?;
    }
    write("jobs.csv", &job_table(results))?;
    write("results.md", &markdown(results, &tables))?;
    write("results.html", &html(results, &tables))?;
    Ok(())
}

/// Numbers of jobs that finished, failed, and did not run.
pub(crate) fn counts(results: &Results<'_>) -> [usize; 3] {
    let all = 0..results.outcomes.len();
    let finished = all.clone().filter(|&place| results.finished(place)).count();
    let failed = all.filter(|&place| results.failure(place).is_some()).count();
    [finished, failed, results.outcomes.len() - finished - failed]
}

/// Counts of jobs in words.
pub(crate) fn state(results: &Results<'_>) -> String {
    let [finished, failed, left] = counts(results);
    let mut text = format!("{finished} of {} finished", counted(results.outcomes.len(), "job"));
    if failed > 0 {
        text += &format!(", {failed} failed");
    }
    if left > 0 {
        text += &format!(", {left} not run");
    }
    text
}

/// Notes on sequences, builds and times.
fn remarks(results: &Results<'_>) -> Vec<String> {
    let mut remarks = results.plan.notes.clone();
    let builds: BTreeSet<&str> = results.records().map(|record| record.build.as_str()).collect();
    let builds: Vec<&str> = builds.into_iter().collect();
    match builds.as_slice() {
        [] => {}
        [build] => remarks.push(format!("Program: i2slam {build}.")),
        builds => remarks.push(format!(
            "Jobs are of different builds of the program ({}); --fresh runs all of them again.",
            builds.join(", ")
        )),
    }
    let seconds: f64 = results.records().map(|record| record.seconds).sum();
    remarks.push(match seconds < 120.0 {
        true => format!("All jobs together took {seconds:.0} seconds."),
        false => format!("All jobs together took {:.0} minutes.", seconds / 60.0),
    });
    remarks.push(tables::machine(results));
    remarks.retain(|remark| !remark.is_empty());
    remarks
}

fn markdown(results: &Results<'_>, tables: &[Table]) -> String {
    let suite = &results.plan.suite;
    let (title, about) = (markdown_text(&suite.title), markdown_text(&suite.about));
    let mut text = format!("# {title}\n\n{about}\n\n{}.\n\n", state(results));
    for remark in remarks(results) {
        text += &format!("* {}\n", markdown_text(&remark));
    }
    for table in tables {
        text += &format!("\n{}", table.markdown());
    }
    text += "\n## Configurations\n\n";
    for (name, words) in configurations(results) {
        text += &format!("* **{}**: {}\n", markdown_text(&name), markdown_text(&words));
    }
    text
}

/// Name and settings of every configuration.
fn configurations(results: &Results<'_>) -> Vec<(String, String)> {
    let words = |configuration: &crate::plan::Configuration| {
        let mut parts = vec![format!("preset {}", configuration.entry.preset())];
        parts.extend(configuration.entry.rgb.then(|| "colour alone".to_owned()));
        dotted("", &configuration.entry.config, &mut parts);
        (configuration.entry.name.clone(), parts.join(", "))
    };
    results.plan.configurations.iter().map(words).collect()
}

/// Collects `section.key = value` of every value.
fn dotted(section: &str, table: &toml::Table, parts: &mut Vec<String>) {
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => dotted(&format!("{section}{key}."), inner, parts),
            value => parts.push(format!("{section}{key} = {value}")),
        }
    }
}

/// `jobs.csv`: one line per job with all its metrics, units as in `metrics.json`.
fn job_table(results: &Results<'_>) -> String {
    let keys: BTreeSet<&String> = results.metrics.iter().flat_map(|f| f.keys()).collect();
    let own = ["sequence", "configuration", "job_seed", "state", "reason", "job_seconds"];
    let own = own.iter().map(|&name| name.to_owned());
    let mut text = csv_line(&own.chain(keys.iter().map(|&key| key.clone())).collect::<Vec<_>>());
    for (place, job) in results.plan.jobs.iter().enumerate() {
        let seconds = match &results.outcomes[place] {
            Outcome::Ended(record) => format!("{:.2}", record.seconds),
            _ => String::new(),
        };
        let state = match (results.finished(place), results.failure(place)) {
            (true, _) => "finished",
            (false, Some(_)) => "failed",
            (false, None) => "not run",
        };
        let mut line = vec![
            results.plan.sequences[job.sequence].name.clone(),
            results.plan.configurations[job.configuration].entry.name.clone(),
            job.seed.to_string(),
            state.to_owned(),
            results.failure(place).unwrap_or_default().to_owned(),
            seconds,
        ];
        let value = |&key| results.metrics[place].get(key).map(f64::to_string).unwrap_or_default();
        line.extend(keys.iter().map(value));
        text += &csv_line(&line);
    }
    text
}

fn html(results: &Results<'_>, tables: &[Table]) -> String {
    let suite = &results.plan.suite;
    let title = escape(&suite.title);
    let tables: String = tables.iter().map(Table::html).collect();
    let plots: String = plots(results).iter().map(Plot::html).collect();
    let plots = match plots.is_empty() {
        true => String::new(),
        false => format!(
            "<section id=\"plots\"><h2>Plots</h2><p>One point a configuration.</p>\
             <div class=\"plots\">{plots}</div></section>"
        ),
    };
    let item = |text: String| format!("<li>{}</li>", escape(&text));
    let remarks: String = remarks(results).into_iter().map(item).collect();
    let row = |(name, words): (String, String)| {
        format!("<tr><td>{}</td><td><code>{}</code></td></tr>", escape(&name), escape(&words))
    };
    let configurations: String = configurations(results).into_iter().map(row).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title} · I²-SLAM</title>\n\
         <style>\n{STYLE}\n{OWN_STYLE}</style>\n</head>\n<body>\n<header>\n\
         <p class=\"brand\">I²-SLAM benchmark</p>\n<h1>{title}</h1>\n\
         <p class=\"lead\">{} <b>{}.</b></p>\n</header>\n<main>\n{tables}{plots}\n\
         <section id=\"configurations\"><h2>Configurations</h2><p>What makes each row.</p>\
         <div class=\"scroll\"><table class=\"words\">{configurations}</table></div></section>\n\
         <section id=\"remarks\"><h2>Remarks</h2><ul>{remarks}</ul></section>\n</main>\n\
         <footer>{} · every metric of every job is in jobs.csv</footer>\n</body>\n</html>\n",
        escape(&suite.about),
        escape(&state(results)),
        escape(concat!("i2slam ", env!("CARGO_PKG_VERSION"))),
    )
}

/// The plots for which there are metrics.
fn plots(results: &Results<'_>) -> Vec<Plot> {
    let mut plots = Vec::new();
    let (over_cameras, over_time) = ("over the number of virtual cameras", "over time per frame");
    if results.plan.suite.tables.contains(&TableKind::VirtualCameras) {
        let cameras = |place: usize| {
            Some(results.plan.configurations[place].config.formation.virtual_cameras as f64)
        };
        for metric in [&PSNR, &ATE] {
            plots.push(plot(
                results,
                metric,
                (over_cameras, "virtual cameras"),
                Horizontal::FromZero,
                cameras,
            ));
        }
    }
    let seconds =
        |place: usize| results.over_sequences(place, &SECONDS).measured().map(|value| value.mean);
    for metric in [&ATE, &PSNR] {
        plots.push(plot(
            results,
            metric,
            (over_time, "seconds per frame [s]"),
            Horizontal::AutoLogarithmic,
            seconds,
        ));
    }
    plots.retain(|plot| !plot.series.is_empty());
    plots
}

/// Plots a metric over the value `x` of each configuration.
fn plot(
    results: &Results<'_>,
    metric: &'static Metric,
    (over, x_label): (&str, &str),
    horizontal: Horizontal,
    x: impl Fn(usize) -> Option<f64>,
) -> Plot {
    let mut series: Vec<(&str, Vec<Point>)> = Vec::new();
    for (place, configuration) in results.plan.configurations.iter().enumerate() {
        let value = results.over_sequences(place, metric);
        let (Some(x), Some(value)) = (x(place), value.measured()) else { continue };
        let point = Point {
            name: configuration.entry.name.clone(),
            x,
            y: value.mean * metric.factor,
            deviation: value.spread.unwrap_or(0.0) * metric.factor,
        };
        let name = configuration.entry.series.as_ref().unwrap_or(&configuration.entry.name);
        match series.iter_mut().find(|(known, _)| known == name) {
            Some((_, points)) => points.push(point),
            None => series.push((name, vec![point])),
        }
    }
    let series = series.into_iter().enumerate().map(|(index, (name, mut points))| {
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series::markers(name, index, points)
    });
    let better = if metric.lower { "Lower is better" } else { "Higher is better" };
    let means = match results.sequences_with(metric).len() {
        0 | 1 => String::new(),
        count => format!(", mean over {count} sequences"),
    };
    let bars = if results.plan.suite.seeds.len() > 1 {
        "; bars are the standard deviation over seeds"
    } else {
        ""
    };
    Plot {
        title: format!("{} {over}", metric.label),
        explanation: format!("{better}{means}{bars}."),
        x_label: x_label.to_owned(),
        y_label: match metric.unit {
            "" => metric.label.to_owned(),
            unit => format!("{} [{unit}]", metric.label),
        },
        horizontal,
        from_zero: metric.lower,
        series: series.collect(),
        marks: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::{plan, results};

    #[test]
    fn failed_jobs_are_counted_and_named() {
        let plan = plan();
        let results = results(&plan, &[(1, 0, 0)]);
        assert_eq!(state(&results), "7 of 8 jobs finished, 1 failed");
        let csv = job_table(&results);
        assert_eq!(csv.lines().count(), 9);
        assert!(csv.contains("b,on,0,failed,no | room,,,"), "{csv}");
    }

    #[test]
    fn the_page_needs_nothing_else_and_escapes_names() {
        let plan = plan();
        let results = results(&plan, &[(1, 0, 0)]);
        let page = html(&results, &tables::tables(&results));
        assert!(page.contains("off | &lt;x&gt;") && page.contains("t &lt;1&gt;"));
        assert!(page.contains("<svg viewBox") && page.contains("no | room"));
        for outside in ["src=", "href=", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
    }

    #[test]
    fn the_text_holds_no_markup_of_names() {
        let mut plan = plan();
        plan.suite.title = "<svg onload=x>".to_owned();
        plan.suite.about = "[a](http://b)\n# c".to_owned();
        let results = results(&plan, &[(1, 0, 0)]);
        let text = markdown(&results, &tables::tables(&results));
        assert!(text.starts_with("# &lt;svg onload=x>\n\n\\[a](http://b) # c\n\n"), "{text}");
        assert!(!text.contains('<'), "{text}");
    }

    #[test]
    fn a_configuration_that_failed_has_no_point() {
        let plan = plan();
        let plots = plots(&results(&plan, &[(1, 0, 0), (1, 0, 1)]));
        assert_eq!(plots.len(), 2, "no PSNR was measured");
        let over_time = &plots[1];
        assert_eq!(over_time.series.len(), 1);
        let point = &over_time.series[0].points[0];
        assert_eq!((point.x, point.y), (1.5, 10650.0));
    }
}
