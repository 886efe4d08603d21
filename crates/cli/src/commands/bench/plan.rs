//! From a suite to the cells that are to be run.

use super::input::{List, settings_of};
use super::sequences::sequences;
use super::suite::{Configuration, Origin, Protocol, Suite};
use crate::failure::Failure;
use i2slam::Config;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What is wanted of a suite.
#[derive(Debug, Default)]
pub(super) struct Wanted {
    /// Folder of the data sets.
    pub(super) data: Option<PathBuf>,
    /// As typed: names separated by commas; none stands for all.
    pub(super) sequences: Vec<String>,
    pub(super) configurations: Vec<String>,
    pub(super) seeds: Option<Vec<u64>>,
}

/// All that is to be run.
pub(super) struct Plan {
    pub(super) suite: Suite,
    pub(super) sequences: Vec<Sequence>,
    pub(super) settings: Vec<Setting>,
    pub(super) cells: Vec<Cell>,
    /// What the reader of the results must know.
    pub(super) notes: Vec<String>,
}

/// A column of the tables.
pub(super) struct Sequence {
    pub(super) name: String,
    pub(super) slug: String,
    pub(super) group: String,
    pub(super) source: Source,
    /// Flags of `i2slam run` that say how it is read.
    pub(super) flags: Vec<String>,
    pub(super) list: Option<List>,
}

/// Where frames come from.
pub(super) enum Source {
    Folder(PathBuf),
    /// The specification, as a file for `i2slam synth`.
    Synth(String),
}

/// A row of the tables.
pub(super) struct Setting {
    pub(super) entry: Configuration,
    pub(super) slug: String,
    /// The overrides, as a file for `--config`.
    pub(super) overrides: String,
    /// What a run with all of it has.
    pub(super) config: Config,
}

/// One run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    /// Place in [`Plan::sequences`].
    pub(super) sequence: usize,
    /// Place in [`Plan::settings`].
    pub(super) setting: usize,
    pub(super) seed: u64,
}

impl Plan {
    /// Everything that can be checked before the first run is checked here.
    pub(super) fn new(origin: Origin, wanted: &Wanted) -> Result<Self, Failure> {
        let mut notes = Vec::new();
        let mut sequences = sequences(&origin, wanted.data.as_deref(), &mut notes)?;
        let entries = origin.suite.configurations.iter().cloned().enumerate();
        let settings: Result<Vec<Setting>, Failure> = entries
            .map(|(place, entry)| settings_of(entry, &origin.name, &origin.text, place))
            .collect();
        let mut settings = settings?;
        keep(&mut sequences, &wanted.sequences, |s| &s.name, "sequence")?;
        keep(&mut settings, &wanted.configurations, |s| &s.entry.name, "configuration")?;
        distinct(sequences.iter().map(|s| (&s.slug, &s.name)), "sequences", &origin.name)?;
        distinct(
            settings.iter().map(|s| (&s.slug, &s.entry.name)),
            "configurations",
            &origin.name,
        )?;
        let mut suite = origin.suite;
        let all_mapped = settings.iter().find(|s| s.config.mapping.hold_out == 0);
        if let (Some(Protocol::HeldOut), Some(setting)) = (suite.protocol, all_mapped) {
            let message = format!(
                "{}: protocol \"held-out\" judges frames that the map never saw, and configuration \
                 `{}` holds none out: give it config.mapping.hold_out",
                origin.name, setting.entry.name
            );
            return Err(Failure::Usage(message));
        }
        if let Some(seeds) = &wanted.seeds {
            suite.seeds.clone_from(seeds);
        }
        suite.seeds.sort_unstable();
        suite.seeds.dedup();
        if sequences.is_empty() {
            let missing = notes.join("; ");
            let message = format!("{}: there is no sequence to run on: {missing}", origin.name);
            return Err(Failure::Failed(message));
        }
        let cells = cells(sequences.len(), settings.len(), &suite.seeds);
        Ok(Self { suite, sequences, settings, cells, notes })
    }

    /// Folder of a cell, relative to that of the benchmark.
    pub(super) fn folder(&self, cell: &Cell) -> PathBuf {
        let (sequence, setting) = (&self.sequences[cell.sequence], &self.settings[cell.setting]);
        let seed = format!("seed-{}", cell.seed);
        [Path::new("cells"), sequence.slug.as_ref(), setting.slug.as_ref(), seed.as_ref()]
            .iter()
            .collect()
    }

    /// How the pictures of a sequence are judged, if not by the figures of the run itself:
    /// protocol, and whether poses are optimised first.
    pub(super) fn judgement(&self, sequence: usize) -> Option<String> {
        let listed = self.sequences[sequence].list.is_some();
        let protocol = match self.suite.protocol {
            Some(Protocol::HeldOut) => "held-out",
            Some(Protocol::I2slam) => "i2slam",
            None if listed => "i2slam",
            None if self.suite.optimise_poses => "all-frames",
            None => return None,
        };
        let poses = if self.suite.optimise_poses { ", poses optimised" } else { "" };
        Some(format!("{protocol}{poses}"))
    }

    /// The cell in words.
    pub(super) fn title(&self, cell: &Cell) -> String {
        let (sequence, setting) = (&self.sequences[cell.sequence], &self.settings[cell.setting]);
        format!("{}, {}, seed {}", sequence.name, setting.entry.name, cell.seed)
    }
}

/// Seeds outermost, so that an early end leaves every row with some figure.
fn cells(sequences: usize, settings: usize, seeds: &[u64]) -> Vec<Cell> {
    let mut cells = Vec::new();
    for &seed in seeds {
        for sequence in 0..sequences {
            cells.extend((0..settings).map(|setting| Cell { sequence, setting, seed }));
        }
    }
    cells
}

/// A name as part of a path: lower case, other characters as `-`.
pub(super) fn slug(name: &str) -> String {
    let plain =
        |c: char| if c.is_alphanumeric() || c == '_' { c.to_ascii_lowercase() } else { '-' };
    let slug: String = name.chars().map(plain).collect();
    let parts: Vec<&str> = slug.split('-').filter(|part| !part.is_empty()).collect();
    parts.join("-")
}

/// Only what is asked for; a name that nothing has is an error.
fn keep<T>(
    all: &mut Vec<T>,
    wanted: &[String],
    name: impl Fn(&T) -> &String,
    kind: &str,
) -> Result<(), Failure> {
    if wanted.is_empty() {
        return Ok(());
    }
    let known: Vec<&str> = all.iter().map(|one| name(one).as_str()).collect();
    let mut chosen = Vec::new();
    for typed in wanted {
        let names = names(typed, &known).map_err(|asked| {
            let known = known.join(", ");
            Failure::Usage(format!("no {kind} is called `{asked}`: there are {known}"))
        })?;
        chosen.extend(names);
    }
    all.retain(|one| chosen.contains(name(one)));
    Ok(())
}

/// The known names in a text that has them between commas, where a name may itself hold commas:
/// the longest that fits counts. The error is a part that is no name.
fn names(typed: &str, known: &[&str]) -> Result<Vec<String>, String> {
    let parts: Vec<&str> = typed.split(',').collect();
    let (mut names, mut at) = (Vec::new(), 0);
    while at < parts.len() {
        let longest = (at + 1..=parts.len()).rev().find_map(|end| {
            let name = parts[at..end].join(",").trim().to_owned();
            known.contains(&name.as_str()).then_some((name, end))
        });
        let (name, end) = longest.ok_or_else(|| parts[at].trim().to_owned())?;
        names.push(name);
        at = end;
    }
    Ok(names)
}

/// Two cells must not share a folder.
fn distinct<'a>(
    names: impl Iterator<Item = (&'a String, &'a String)>,
    kind: &str,
    origin: &str,
) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    for (slug, name) in names {
        if slug.is_empty() || !seen.insert(slug) {
            let message = format!("{origin}: `{name}` has no name of its own among the {kind}");
            return Err(Failure::Usage(message));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::suite::{SHIPPED, parse};
    use super::*;

    #[test]
    fn names_become_parts_of_paths() {
        assert_eq!(slug("Paper: no blur, N = 5"), "paper-no-blur-n-5");
        assert_eq!(slug("../x"), "x");
    }

    #[test]
    fn names_may_hold_commas() {
        let known = ["on", "blur, no tone", "no tone", "blur"];
        let found = |typed| names(typed, &known);
        let owned = |names: &[&str]| Ok(names.iter().map(|&n| n.to_owned()).collect::<Vec<_>>());
        assert_eq!(found("blur, no tone"), owned(&["blur, no tone"]));
        assert_eq!(found("on,blur, no tone,no tone"), owned(&["on", "blur, no tone", "no tone"]));
        assert_eq!(found("blur, on"), owned(&["blur", "on"]));
        assert_eq!(found("on,off"), Err("off".to_owned()));
    }

    #[test]
    fn frames_are_held_out_where_they_are_judged() {
        let text = "title = \"t\"\nprotocol = \"held-out\"\n[[sequence]]\npath = \"a\"\n\
                    [[configuration]]\nname = \"c\"\n";
        let plan = |text: &str| {
            let suite = parse(text, "t").expect("a suite");
            let (name, text) = ("t".to_owned(), text.to_owned());
            let origin = Origin { suite, text, name, folder: PathBuf::new() };
            Plan::new(origin, &Wanted::default())
        };
        let message = plan(text).err().expect("nothing is held out");
        assert!(message.message().is_some_and(|m| m.contains("hold_out")));
        let plan = plan(&format!("{text}flags = [\"--hold-out\", \"4\"]\n")).expect("a plan");
        assert_eq!(plan.judgement(0).as_deref(), Some("held-out"));
    }

    #[test]
    fn seeds_are_outermost_and_every_cell_is_there_once() {
        let cells = cells(2, 3, &[4, 5]);
        assert_eq!(cells.len(), 12);
        assert_eq!(cells[1], Cell { sequence: 0, setting: 1, seed: 4 });
        assert!(cells[..6].iter().all(|cell| cell.seed == 4));
    }

    #[test]
    fn shipped_suites_can_be_planned() {
        for (name, text) in SHIPPED {
            let suite = parse(text, name).unwrap_or_else(|e| panic!("{name}: {e:?}"));
            let count = suite.configurations.len();
            for (place, entry) in suite.configurations.into_iter().enumerate() {
                settings_of(entry, name, text, place).unwrap_or_else(|e| panic!("{name}: {e:?}"));
            }
            assert!(count >= 2 && suite.seeds.len() == 3 && !suite.about.is_empty(), "{name}");
        }
    }

    #[test]
    fn a_folder_that_is_missing_fails_later_unless_it_is_optional() {
        let text = "title = \"t\"\n[[sequence]]\npath = \"nowhere/a\"\n[[sequence]]\n\
                    path = \"nowhere/b\"\noptional = true\n[[configuration]]\nname = \"c\"\n";
        let suite = parse(text, "t").expect("a suite");
        let origin =
            Origin { suite, text: String::new(), name: "t".to_owned(), folder: PathBuf::new() };
        let plan = Plan::new(origin, &Wanted::default()).expect("a plan");
        assert_eq!((plan.cells.len(), plan.notes.len()), (3, 1));
        assert_eq!(plan.sequences[0].name, "a");
    }
}
