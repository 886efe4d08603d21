//! A table as Markdown, CSV and HTML.

use crate::metrics::Metric;
use crate::summary::Value;
use i2slam_result::html::escape;

/// A table of the results.
pub(crate) struct Table {
    /// File name.
    pub(crate) slug: &'static str,
    pub(crate) title: &'static str,
    pub(crate) caption: String,
    /// Headings over some columns, with their widths; empty where there is none.
    pub(crate) groups: Vec<(String, usize)>,
    pub(crate) header: Vec<String>,
    pub(crate) rows: Vec<Vec<Entry>>,
}

/// Content of a table cell.
#[derive(Clone)]
pub(crate) enum Entry {
    Words(String),
    Number { value: Value, metric: &'static Metric, best: bool },
}

impl Entry {
    pub(crate) fn number(value: Value, metric: &'static Metric) -> Self {
        Self::Number { value, metric, best: false }
    }

    /// The content as shown.
    pub(crate) fn text(&self) -> String {
        let (value, metric) = match self {
            Self::Words(words) => return words.clone(),
            Self::Number { value, metric, .. } => (value, metric),
        };
        let measured = match value {
            Value::SeedMean(measured) => measured,
            Value::Unknown => return "–".to_owned(),
            Value::Failed => return "failed".to_owned(),
            Value::NotRun => return "not run".to_owned(),
        };
        let mut text = metric.text(measured.mean);
        if let Some(spread) = measured.spread {
            let digits = metric.digits(measured.mean);
            text += &format!(" ± {:.digits$}", spread * metric.factor);
        }
        if measured.seeds < measured.planned {
            text += &format!(" ({} of {})", measured.seeds, measured.planned);
        }
        text
    }

    fn best(&self) -> bool {
        matches!(self, Self::Number { best: true, .. })
    }

    fn mean(&self) -> Option<(f64, &'static Metric)> {
        match self {
            Self::Number { value, metric, .. } => {
                value.measured().map(|measured| (measured.mean, *metric))
            }
            Self::Words(_) => None,
        }
    }
}

/// Marks the best entries of one metric, equal ones included; a single entry is not marked.
pub(crate) fn mark_best<'a>(entries: impl Iterator<Item = &'a mut Entry>) {
    let mut entries: Vec<&mut Entry> = entries.collect();
    let means: Vec<(f64, &'static Metric)> = entries.iter().filter_map(|e| e.mean()).collect();
    let better = |a: f64, b: f64, lower: bool| if lower { a.min(b) } else { a.max(b) };
    let best = means.iter().copied().reduce(|(a, f), (b, _)| (better(a, b, f.lower), f));
    let Some((target, metric)) = best.filter(|_| means.len() > 1) else { return };
    let target = metric.text(target);
    for entry in &mut entries {
        let mean = entry.mean();
        if let Entry::Number { best, .. } = entry {
            *best = mean.is_some_and(|(mean, metric)| metric.text(mean) == target);
        }
    }
}

impl Table {
    /// Names of the columns with those of their groups.
    fn columns(&self) -> Vec<String> {
        let mut groups = self.groups.iter().flat_map(|(name, width)| vec![name.as_str(); *width]);
        let full = |name: &String| match groups.next() {
            Some(group) if !group.is_empty() => format!("{group} {name}"),
            _ => name.clone(),
        };
        self.header.iter().map(full).collect()
    }

    pub(crate) fn markdown(&self) -> String {
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let bold = |entry: &Entry| match entry.best() {
            true => format!("**{}**", markdown_text(&entry.text())),
            false => markdown_text(&entry.text()),
        };
        let caption = markdown_text(&self.caption);
        let mut text = format!("## {}\n\n{caption}\n\n", self.title);
        text += &line(self.columns().iter().map(|name| markdown_text(name)).collect());
        text += &line(vec!["---".to_owned(); self.header.len()]);
        self.rows.iter().for_each(|row| text += &line(row.iter().map(bold).collect()));
        text
    }

    /// The table as CSV: a column of numbers becomes three (mean, standard deviation, seeds).
    pub(crate) fn csv(&self) -> String {
        let numeric: Vec<bool> = (0..self.header.len())
            .map(|i| self.rows.iter().any(|row| matches!(row.get(i), Some(Entry::Number { .. }))))
            .collect();
        let mut header = Vec::new();
        for (name, numeric) in self.columns().iter().zip(&numeric) {
            let name = name.trim_end_matches([' ', '↓', '↑']);
            match numeric {
                true => header.extend(["mean", "sd", "seeds"].map(|part| format!("{name} {part}"))),
                false => header.push(name.to_owned()),
            }
        }
        let mut text = csv_line(&header);
        for row in &self.rows {
            text += &csv_line(&row.iter().flat_map(csv_cells).collect::<Vec<_>>());
        }
        text
    }

    pub(crate) fn html(&self) -> String {
        let mut text = format!(
            "<section id=\"{}\"><h2>{}</h2><p>{}</p><div class=\"scroll\"><table class=\"figures\">\
             <thead>",
            self.slug,
            self.title,
            escape(&self.caption)
        );
        if self.groups.iter().any(|(name, _)| !name.is_empty()) {
            let head = |(name, width): &(String, usize)| {
                let class = if name.is_empty() { "" } else { " class=\"group\"" };
                format!("<th colspan=\"{width}\"{class}>{}</th>", escape(name))
            };
            text += &format!("<tr>{}</tr>", self.groups.iter().map(head).collect::<String>());
        }
        let head = |name: &String| format!("<th>{}</th>", escape(name));
        text += &format!(
            "<tr>{}</tr></thead><tbody>",
            self.header.iter().map(head).collect::<String>()
        );
        for (place, row) in self.rows.iter().enumerate() {
            let cells: String = row.iter().skip(1).map(html_cell).collect();
            text += &format!("<tr>{}{cells}</tr>", self.html_head(place));
        }
        text + "</tbody></table></div></section>\n"
    }

    /// The first cell of a row, spanning all rows of its name.
    fn html_head(&self, place: usize) -> String {
        let name = |row: &Vec<Entry>| row.first().map(Entry::text).unwrap_or_default();
        let own = name(&self.rows[place]);
        if place > 0 && name(&self.rows[place - 1]) == own {
            return String::new();
        }
        let height = self.rows[place..].iter().take_while(|row| name(row) == own).count();
        format!("<th scope=\"row\" rowspan=\"{height}\">{}</th>", escape(&own))
    }
}

fn html_cell(entry: &Entry) -> String {
    let text = escape(&entry.text());
    match entry {
        Entry::Words(_) => format!("<td>{text}</td>"),
        Entry::Number { best: true, .. } => format!("<td class=\"best\">{text}</td>"),
        Entry::Number { value: Value::Failed, .. } => format!("<td class=\"failed\">{text}</td>"),
        Entry::Number { .. } => format!("<td>{text}</td>"),
    }
}

fn csv_cells(entry: &Entry) -> Vec<String> {
    let (value, metric) = match entry {
        Entry::Words(words) => return vec![words.clone()],
        Entry::Number { value, metric, .. } => (value, metric),
    };
    match value.measured() {
        Some(measured) => vec![
            (measured.mean * metric.factor).to_string(),
            measured.spread.map(|s| (s * metric.factor).to_string()).unwrap_or_default(),
            measured.seeds.to_string(),
        ],
        None => vec![String::new(), String::new(), entry.text()],
    }
}

/// A line of comma-separated values, quoted where necessary (RFC 4180).
pub(crate) fn csv_line(cells: &[String]) -> String {
    let quoted = |cell: &String| {
        let cell = if is_formula(cell) { format!("'{cell}") } else { cell.clone() };
        match cell.contains([',', '"', '\'', '\t', '\n', '\r']) {
            true => format!("\"{}\"", cell.replace('"', "\"\"")),
            false => cell,
        }
    };
    cells.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n"
}

/// Whether a spreadsheet would compute a cell instead of showing it. A leading apostrophe, which
/// such a cell gets, makes it text.
fn is_formula(cell: &str) -> bool {
    let signs = ['=', '+', '-', '@', '\t', '\r', '＝', '＋', '－', '＠'];
    cell.trim_start_matches(' ').starts_with(signs) && cell.parse::<f64>().is_err()
}

/// A text in one line of Markdown, shown as it is: no HTML, no links, no pictures, no code, no cell
/// of its own.
pub(crate) fn markdown_text(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '<' => shown += "&lt;",
            '\\' | '`' | '*' | '|' | '[' => shown.extend(['\\', character]),
            other if other.is_control() => shown.push(' '),
            other => shown.push(other),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{ATE, PSNR};
    use crate::summary::SeedMean;

    fn measured(mean: f64, seeds: usize) -> Value {
        let spread = (seeds > 1).then_some(0.001);
        Value::SeedMean(SeedMean { mean, spread, seeds, planned: 3 })
    }

    #[test]
    fn means_spreads_and_gaps_are_written_out() {
        let text = |value| Entry::number(value, &ATE).text();
        assert_eq!(text(measured(0.0256, 3)), "2.56 ± 0.10");
        assert_eq!(text(measured(0.0256, 2)), "2.56 ± 0.10 (2 of 3)");
        assert_eq!(text(measured(0.0256, 1)), "2.56 (1 of 3)");
        assert_eq!(
            [Value::Unknown, Value::Failed, Value::NotRun].map(text),
            ["–", "failed", "not run"]
        );
    }

    #[test]
    fn the_best_is_the_least_error_or_the_greatest_likeness() {
        let best = |metric: &'static Metric| {
            let values = [measured(2.0, 3), Value::Failed, measured(1.0, 3)];
            let mut entries = values.map(|value| Entry::number(value, metric));
            mark_best(entries.iter_mut());
            entries.map(|entry| entry.best())
        };
        assert_eq!(best(&ATE), [false, false, true]);
        assert_eq!(best(&PSNR), [true, false, false]);
        let mut alone = [Entry::number(measured(1.0, 3), &ATE)];
        mark_best(alone.iter_mut());
        assert!(!alone[0].best());
    }

    #[test]
    fn cells_are_neither_formulas_nor_markup() {
        let line = |cell: &str| csv_line(&[cell.to_owned(), "b".to_owned()]);
        for (cell, due) in [
            ("=1+1", "\"'=1+1\",b\n"),
            ("=HYPERLINK(\"x\")", "\"'=HYPERLINK(\"\"x\"\")\",b\n"),
            ("@SUM(A1)", "\"'@SUM(A1)\",b\n"),
            ("-cmd", "\"'-cmd\",b\n"),
            (" +a", "\"' +a\",b\n"),
            ("\t=1", "\"'\t=1\",b\n"),
            ("-1.5e-3", "-1.5e-3,b\n"),
            ("a=b - c", "a=b - c,b\n"),
        ] {
            assert_eq!(line(cell), due);
        }
        let markup = "<svg onload=x> `a` ![p](http://x) *b*\n\n# c \\";
        let due = "&lt;svg onload=x> \\`a\\` !\\[p](http://x) \\*b\\*  # c \\\\";
        assert_eq!(markdown_text(markup), due);
    }

    #[test]
    fn one_table_in_three_forms() {
        let row = vec![Entry::Words("a|b, <c>".to_owned()), Entry::number(measured(0.02, 3), &ATE)];
        let table = Table {
            slug: "tracking",
            title: "Tracking",
            caption: "ATE.".to_owned(),
            groups: vec![(String::new(), 1), ("TUM".to_owned(), 1)],
            header: vec!["Method".to_owned(), "desk ↓".to_owned()],
            rows: vec![row],
        };
        assert!(table.markdown().contains("| Method | TUM desk ↓ |"), "{}", table.markdown());
        assert!(table.markdown().contains("| a\\|b, &lt;c> | 2.00 ± 0.10 |"));
        let csv = "Method,TUM desk mean,TUM desk sd,TUM desk seeds\n\"a|b, <c>\",2,0.1,3\n";
        assert_eq!(table.csv(), csv);
        assert!(table.html().contains(">a|b, &lt;c&gt;</th><td>2.00 ± 0.10</td>"));
    }
}
