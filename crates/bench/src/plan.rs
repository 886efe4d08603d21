//! From a suite to the jobs that are to be run.

use crate::console::Failure;
use crate::sequences::{Sequence, resolve};
use crate::suite::{ConfigurationEntry, Protocol, Suite, SuiteFile, slug};
use clap::Args;
use i2slam::config::line_of_key;
use i2slam::{Config, ConfigError};
use std::collections::BTreeSet;
use std::path::PathBuf;

// The part of a suite that is to be run. A doc comment would replace that of the program in --help.
#[derive(Args, Debug, Default)]
pub(crate) struct Selection {
    /// Folder of the data sets that the suite names [default: that of the suite's file]
    #[arg(long, value_name = "DIR")]
    pub(crate) data: Option<PathBuf>,
    /// Only these sequences: names separated by commas; may repeat
    #[arg(long, value_name = "NAMES")]
    pub(crate) sequences: Vec<String>,
    /// Only these configurations: names separated by commas; may repeat
    #[arg(long, value_name = "NAMES")]
    pub(crate) configurations: Vec<String>,
    /// These seeds instead of the suite's
    #[arg(long, value_name = "SEEDS", value_delimiter = ',')]
    pub(crate) seeds: Option<Vec<u64>>,
}

/// All jobs of a benchmark.
pub(crate) struct Plan {
    pub(crate) suite: Suite,
    pub(crate) sequences: Vec<Sequence>,
    pub(crate) configurations: Vec<Configuration>,
    pub(crate) jobs: Vec<Job>,
    /// Sequences that were left out, for the reader of the results.
    pub(crate) notes: Vec<String>,
}

/// A row of the tables.
pub(crate) struct Configuration {
    pub(crate) entry: ConfigurationEntry,
    /// The name as part of a path.
    pub(crate) slug: String,
    /// The settings of the suite as TOML, without those of the preset.
    pub(crate) overrides: String,
    /// All settings.
    pub(crate) config: Config,
}

/// One run: a sequence, a configuration, a seed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Job {
    /// Index into [`Plan::sequences`].
    pub(crate) sequence: usize,
    /// Index into [`Plan::configurations`].
    pub(crate) configuration: usize,
    pub(crate) seed: u64,
}

impl Plan {
    /// Checks everything that can be checked before the first run.
    pub(crate) fn new(file: SuiteFile, selection: &Selection) -> Result<Self, Failure> {
        let mut notes = Vec::new();
        let mut sequences = resolve(&file, selection.data.as_deref(), &mut notes)?;
        let entries = file.suite.configurations.iter().cloned().enumerate();
        let configurations: Result<Vec<Configuration>, Failure> = entries
            .map(|(place, entry)| Configuration::new(entry, &file.name, &file.text, place))
            .collect();
        let mut configurations = configurations?;
        keep(&mut sequences, &selection.sequences, |s| &s.name, "sequence")?;
        keep(&mut configurations, &selection.configurations, |c| &c.entry.name, "configuration")?;
        distinct(sequences.iter().map(|s| (&s.slug, &s.name)), "sequences", &file.name)?;
        let names = configurations.iter().map(|c| (&c.slug, &c.entry.name));
        distinct(names, "configurations", &file.name)?;
        let mut suite = file.suite;
        let all_mapped = configurations.iter().find(|c| c.config.mapping.maps_all());
        if let (Some(Protocol::HeldOut), Some(configuration)) = (suite.protocol, all_mapped) {
            return Err(Failure::Usage(format!(
                "{}: protocol \"held-out\" judges frames that the map never saw, and configuration \
                 `{}` holds none out: give it config.mapping.hold_out",
                file.name, configuration.entry.name
            )));
        }
        if let Some(seeds) = &selection.seeds {
            suite.seeds.clone_from(seeds);
        }
        suite.seeds.sort_unstable();
        suite.seeds.dedup();
        if sequences.is_empty() {
            let missing = notes.join("; ");
            return Err(Failure::Failed(format!(
                "{}: there is no sequence to run on: {missing}",
                file.name
            )));
        }
        let jobs = jobs(sequences.len(), configurations.len(), &suite.seeds);
        Ok(Self { suite, sequences, configurations, jobs, notes })
    }

    /// Folder of a job, relative to that of the benchmark.
    pub(crate) fn folder(&self, job: &Job) -> PathBuf {
        let sequence = &self.sequences[job.sequence].slug;
        let configuration = &self.configurations[job.configuration].slug;
        let seed = format!("seed-{}", job.seed);
        ["jobs", sequence, configuration, &seed].iter().collect()
    }

    /// Protocol of `i2slam eval` that judges the pictures of a sequence; without one the metrics
    /// of the run itself count.
    pub(crate) fn protocol(&self, sequence: usize) -> Option<&'static str> {
        let listed = self.sequences[sequence].list.is_some();
        match self.suite.protocol {
            Some(Protocol::HeldOut) => Some("held-out"),
            Some(Protocol::I2slam) => Some("i2slam"),
            None if listed => Some("i2slam"),
            None => self.suite.optimise_poses.then_some("all-frames"),
        }
    }

    /// `SEQUENCE, CONFIGURATION, seed N`.
    pub(crate) fn title(&self, job: &Job) -> String {
        let sequence = &self.sequences[job.sequence].name;
        let configuration = &self.configurations[job.configuration].entry.name;
        format!("{sequence}, {configuration}, seed {}", job.seed)
    }
}

impl Configuration {
    /// Checks an entry as `i2slam run` would; `text` is the suite's, and `place` the index among
    /// its configurations.
    fn new(
        entry: ConfigurationEntry,
        origin: &str,
        text: &str,
        place: usize,
    ) -> Result<Self, Failure> {
        let wrong = |key: Option<&str>, reason: String| {
            let at = line(text, place, key).map(|line| format!(", line {line}"));
            let at = at.unwrap_or_default();
            Failure::Usage(format!("{origin}{at}, configuration `{}`: {reason}", entry.name))
        };
        let overrides = toml::to_string(&entry.config).map_err(|e| wrong(None, e.to_string()))?;
        // A preset inside `config` would hide the one that the results name.
        if entry.config.contains_key("preset") {
            let reason = "`preset` stands beside `config`, not in it".to_owned();
            return Err(wrong(Some("preset"), reason));
        }
        if entry.config.contains_key("seed") {
            return Err(wrong(Some("seed"), "the seeds of a suite are its `seeds`".to_owned()));
        }
        let config = Config::from_toml(&overrides, origin, Some(entry.preset()));
        let config = config.map_err(|error| wrong(error.key(), reason(&error)))?;
        let preset = entry.preset();
        match (entry.rgb, config.is_rgb()) {
            (true, false) => Err(wrong(None, format!("preset `{preset}` needs depth pictures"))),
            (false, true) => {
                Err(wrong(None, format!("preset `{preset}` is for colour alone: add rgb = true")))
            }
            _ => Ok(Self { slug: slug(&entry.name), overrides, config, entry }),
        }
    }
}

/// The line of a key of a configuration's `config`, else that of the configuration.
fn line(text: &str, place: usize, key: Option<&str>) -> Option<usize> {
    let place = place.to_string();
    let own = ["configuration", place.as_str()];
    let key = key.and_then(|key| {
        let path: Vec<&str> = own.into_iter().chain(["config"]).chain(key.split('.')).collect();
        line_of_key(text, &path)
    });
    key.or_else(|| line_of_key(text, &own))
}

/// The message without its place: lines of the overrides are not lines of the suite.
fn reason(error: &ConfigError) -> String {
    match error {
        ConfigError::UnknownKey { key, hint, section, known, .. } => {
            format!("no setting is called `{key}`{hint}: `{section}` has {known}")
        }
        ConfigError::RemovedKey { key, .. } => {
            format!("{key} is no longer a setting: the preset decides it")
        }
        ConfigError::Malformed { message, .. } => message.clone(),
        ConfigError::WrongValue { key, message, .. } => format!("{key}: {message}"),
        ConfigError::OutOfRange { key, value, expected, .. } => {
            format!("{key} = {value} is out of range: {expected}")
        }
        other => other.to_string(),
    }
}

/// Seeds outermost, so that an early end leaves every row with some metric.
fn jobs(sequences: usize, configurations: usize, seeds: &[u64]) -> Vec<Job> {
    let mut jobs = Vec::new();
    for &seed in seeds {
        for sequence in 0..sequences {
            let job = |configuration| Job { sequence, configuration, seed };
            jobs.extend((0..configurations).map(job));
        }
    }
    jobs
}

/// Keeps what was selected; an unknown name is an error.
fn keep<T>(
    all: &mut Vec<T>,
    selected: &[String],
    name: impl Fn(&T) -> &String,
    kind: &str,
) -> Result<(), Failure> {
    if selected.is_empty() {
        return Ok(());
    }
    let known: Vec<&str> = all.iter().map(|one| name(one).as_str()).collect();
    let mut chosen = Vec::new();
    for typed in selected {
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

/// Refuses two names of one folder.
fn distinct<'a>(
    names: impl Iterator<Item = (&'a String, &'a String)>,
    kind: &str,
    origin: &str,
) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    for (slug, name) in names {
        if slug.is_empty() || !seen.insert(slug) {
            return Err(Failure::Usage(format!(
                "{origin}: `{name}` has no name of its own among the {kind}"
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::suite::{SHIPPED, parse};

    /// The plan of a suite's text, without data.
    pub(crate) fn plan(text: &str) -> Result<Plan, Failure> {
        let suite = parse(text, "t.toml")?;
        let (name, text) = ("t.toml".to_owned(), text.to_owned());
        let file = SuiteFile { suite, text, name, folder: None };
        Plan::new(file, &Selection::default())
    }

    fn refusal(text: &str) -> String {
        let failure = plan(text).err().expect("a mistake");
        failure.message().expect("a message").to_owned()
    }

    const HEAD: &str =
        "title = \"t\"\n[[sequence]]\npath = \"a\"\n[[configuration]]\nname = \"c\"\n";

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
    fn settings_replace_those_of_the_preset() {
        let more = "rgb = true\nconfig.formation = { blur = false, virtual_cameras = 7 }\n";
        let plan = plan(&format!("{HEAD}{more}")).expect("a plan");
        let config = &plan.configurations[0].config;
        assert_eq!(config.preset, "default-rgb");
        assert!(!config.formation.blur && config.formation.tone);
        assert_eq!(config.formation.virtual_cameras, 7);
    }

    #[test]
    fn mistakes_in_a_configuration_are_named_with_their_line() {
        let refused = |more: &str, line: usize, words: &str| {
            let message = refusal(&format!("{HEAD}{more}\n"));
            let place = format!("t.toml, line {line}, configuration `c`: ");
            assert!(message.starts_with(&place) && message.contains(words), "{message}");
        };
        refused("config.mapping.window = 0", 6, "mapping.window = 0 is out of range");
        refused("config.mapping.iteratons = 3", 6, "iteratons");
        refused("config.seed = 3", 6, "seeds");
        refused("config.preset = \"paper-tum\"", 6, "beside");
        refused("preset = \"default-rgb\"", 4, "rgb = true");
        refused("preset = \"paper-tum\"\nrgb = true", 4, "needs depth");
    }

    #[test]
    fn frames_are_held_out_where_they_are_judged() {
        let text = format!("protocol = \"held-out\"\n{HEAD}");
        let message = refusal(&text);
        assert!(message.contains("hold_out"), "{message}");
        let plan = plan(&format!("{text}config.mapping.hold_out = 4\n")).expect("a plan");
        assert_eq!(plan.protocol(0), Some("held-out"));
    }

    #[test]
    fn seeds_are_outermost_and_every_job_is_there_once() {
        let jobs = jobs(2, 3, &[4, 5]);
        assert_eq!(jobs.len(), 12);
        assert_eq!(jobs[1], Job { sequence: 0, configuration: 1, seed: 4 });
        assert!(jobs[..6].iter().all(|job| job.seed == 4));
    }

    #[test]
    fn shipped_suites_can_be_planned() {
        for (name, text) in SHIPPED {
            let suite = parse(text, name).unwrap_or_else(|e| panic!("{name}: {e:?}"));
            let count = suite.configurations.len();
            for (place, entry) in suite.configurations.into_iter().enumerate() {
                let made = Configuration::new(entry, name, text, place);
                made.unwrap_or_else(|e| panic!("{name}: {e:?}"));
            }
            assert!(count >= 2 && suite.seeds.len() == 3 && !suite.about.is_empty(), "{name}");
        }
    }

    #[test]
    fn a_missing_folder_fails_later_unless_it_is_optional() {
        let text = "title = \"t\"\n[[sequence]]\npath = \"nowhere/a\"\n[[sequence]]\n\
                    path = \"nowhere/b\"\noptional = true\n[[configuration]]\nname = \"c\"\n";
        let plan = plan(text).expect("a plan");
        assert_eq!((plan.jobs.len(), plan.notes.len()), (3, 1));
        assert_eq!(plan.sequences[0].name, "a");
    }
}
