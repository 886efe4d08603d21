//! `results.md`, `results.html` and the CSV files.

use super::layouts;
use super::notes;
use super::plots;
use super::queue::Outcome;
use super::summary::Results;
use super::table::{Table, csv_line};
use crate::failure::Failure;
use crate::output::counted;
use i2slam_result::ResultFolder;
use i2slam_result::report::{STYLE, escape};
use std::collections::BTreeSet;
use std::path::Path;

const OWN_STYLE: &str = include_str!("page.css");

/// Writes everything that a reader wants, each file complete or not at all.
pub(super) fn write(results: &Results<'_>, out: &Path) -> Result<(), Failure> {
    let folder = ResultFolder::create(out)?;
    let tables = layouts::tables(results);
    for table in &tables {
        folder.write_text(&format!("tables/{}.csv", table.slug), &table.csv())?;
    }
    folder.write_text("cells.csv", &cells(results))?;
    folder.write_text("results.md", &markdown(results, &tables))?;
    folder.write_text("results.html", &html(results, &tables))?;
    Ok(())
}

/// How many cells finished, failed, and did not run.
pub(super) fn counts(results: &Results<'_>) -> [usize; 3] {
    let all = 0..results.outcomes.len();
    let finished = all.clone().filter(|&place| results.finished(place)).count();
    let failed = all.filter(|&place| results.failure(place).is_some()).count();
    [finished, failed, results.outcomes.len() - finished - failed]
}

/// The same in words.
pub(super) fn state(results: &Results<'_>) -> String {
    let [finished, failed, left] = counts(results);
    let mut text = format!("{finished} of {} finished", counted(results.outcomes.len(), "cell"));
    if failed > 0 {
        text += &format!(", {failed} failed");
    }
    if left > 0 {
        text += &format!(", {left} not run");
    }
    text
}

/// What the reader must know besides the tables.
fn remarks(results: &Results<'_>) -> Vec<String> {
    let mut remarks = results.plan.notes.clone();
    let builds: BTreeSet<&str> = results
        .outcomes
        .iter()
        .filter_map(|outcome| match outcome {
            Outcome::Ended(record) => Some(record.build.as_str()),
            _ => None,
        })
        .collect();
    let builds: Vec<&str> = builds.into_iter().collect();
    match builds.as_slice() {
        [] => {}
        [build] => remarks.push(format!("Program: i2slam {build}.")),
        builds => remarks.push(format!(
            "Cells are of different builds of the program ({}); --fresh runs all of them again.",
            builds.join(", ")
        )),
    }
    let seconds: f64 = results
        .outcomes
        .iter()
        .map(|outcome| match outcome {
            Outcome::Ended(record) => record.seconds,
            _ => 0.0,
        })
        .sum();
    remarks.push(match seconds < 120.0 {
        true => format!("All cells together took {seconds:.0} seconds."),
        false => format!("All cells together took {:.0} minutes.", seconds / 60.0),
    });
    remarks.push(notes::machine(results));
    remarks.retain(|remark| !remark.is_empty());
    remarks
}

fn markdown(results: &Results<'_>, tables: &[Table]) -> String {
    let suite = &results.plan.suite;
    let mut text = format!("# {}\n\n{}\n\n{}.\n\n", suite.title, suite.about, state(results));
    for remark in remarks(results) {
        text += &format!("* {remark}\n");
    }
    for table in tables {
        text += &format!("\n{}", table.markdown());
    }
    text += "\n## Configurations\n\n";
    for (name, words) in configurations(results) {
        text += &format!("* **{name}**: {words}\n");
    }
    text
}

/// Every configuration with what makes it.
fn configurations(results: &Results<'_>) -> Vec<(String, String)> {
    let words = |setting: &super::plan::Setting| {
        let mut parts = vec![format!("preset {}", setting.entry.preset)];
        parts.extend(setting.entry.flags.iter().cloned());
        dotted("", &setting.entry.config, &mut parts);
        (setting.entry.name.clone(), parts.join(", "))
    };
    results.plan.settings.iter().map(words).collect()
}

/// `section.key = value` for every value.
fn dotted(section: &str, table: &toml::Table, parts: &mut Vec<String>) {
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => dotted(&format!("{section}{key}."), inner, parts),
            value => parts.push(format!("{section}{key} = {value}")),
        }
    }
}

/// One line for every cell, with all its figures, units as in `metrics.json`.
fn cells(results: &Results<'_>) -> String {
    let keys: BTreeSet<&String> = results.figures.iter().flat_map(|f| f.keys()).collect();
    let own = ["sequence", "configuration", "cell_seed", "state", "reason", "cell_seconds"];
    let own = own.iter().map(|&name| name.to_owned());
    let mut text = csv_line(&own.chain(keys.iter().map(|&key| key.clone())).collect::<Vec<_>>());
    for (place, cell) in results.plan.cells.iter().enumerate() {
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
            results.plan.sequences[cell.sequence].name.clone(),
            results.plan.settings[cell.setting].entry.name.clone(),
            cell.seed.to_string(),
            state.to_owned(),
            results.failure(place).unwrap_or_default().to_owned(),
            seconds,
        ];
        let figures = &results.figures[place];
        line.extend(
            keys.iter().map(|&key| figures.get(key).map(f64::to_string).unwrap_or_default()),
        );
        text += &csv_line(&line);
    }
    text
}

fn html(results: &Results<'_>, tables: &[Table]) -> String {
    let suite = &results.plan.suite;
    let title = escape(&suite.title);
    let tables: String = tables.iter().map(Table::html).collect();
    let plots: String = plots::plots(results).iter().map(super::plot::Plot::html).collect();
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
         <footer>{} · every figure of every cell is in cells.csv</footer>\n</body>\n</html>\n",
        escape(&suite.about),
        escape(&state(results)),
        escape(concat!("i2slam ", env!("CARGO_PKG_VERSION"))),
    )
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{plan, results};
    use super::*;

    #[test]
    fn failed_cells_are_counted_and_named() {
        let plan = plan();
        let results = results(&plan, &[(1, 0, 0)]);
        assert_eq!(state(&results), "7 of 8 cells finished, 1 failed");
        let csv = cells(&results);
        assert_eq!(csv.lines().count(), 9);
        assert!(csv.contains("b,on,0,failed,no | room,,,"), "{csv}");
    }

    #[test]
    fn the_page_needs_nothing_else_and_escapes_names() {
        let plan = plan();
        let results = results(&plan, &[(1, 0, 0)]);
        let page = html(&results, &layouts::tables(&results));
        assert!(page.contains("off | &lt;x&gt;") && page.contains("t &lt;1&gt;"));
        assert!(page.contains("<svg viewBox") && page.contains("no | room"));
        for outside in ["src=", "href=", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
