//! A suite: which sequences, configurations and seeds a benchmark runs. Read from TOML.

use crate::failure::Failure;
use i2slam::config::line_of_key;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::Table;

/// Suites that come with the program, name and text.
pub(super) const SHIPPED: [(&str, &str); 10] = [
    ("ablation", include_str!("../../../../../suites/ablation.toml")),
    ("ablation-scannet", include_str!("../../../../../suites/ablation-scannet.toml")),
    ("virtual-cameras", include_str!("../../../../../suites/virtual-cameras.toml")),
    ("runtime", include_str!("../../../../../suites/runtime.toml")),
    ("tum", include_str!("../../../../../suites/tum.toml")),
    ("scannet", include_str!("../../../../../suites/scannet.toml")),
    ("synthetic", include_str!("../../../../../suites/synthetic.toml")),
    ("presets", include_str!("../../../../../suites/presets.toml")),
    ("blur-models", include_str!("../../../../../suites/blur-models.toml")),
    ("maps", include_str!("../../../../../suites/maps.toml")),
];

/// What a benchmark runs.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Suite {
    /// Heading of the results.
    pub(super) title: String,
    /// A sentence or two for the reader of the results.
    #[serde(default)]
    pub(super) about: String,
    /// Seeds of the runs.
    #[serde(default = "three")]
    pub(super) seeds: Vec<u64>,
    /// Cells that run at once, unless `--jobs` says otherwise.
    pub(super) jobs: Option<usize>,
    /// Protocol that judges pictures, if not that of the sequence: all frames, or its list.
    pub(super) protocol: Option<Protocol>,
    /// Whether poses are optimised before pictures are judged.
    #[serde(default)]
    pub(super) optimise_poses: bool,
    /// Tables to make, in this order.
    #[serde(default = "usual_tables")]
    pub(super) tables: Vec<Layout>,
    #[serde(rename = "sequence", default)]
    pub(super) sequences: Vec<SequenceEntry>,
    #[serde(rename = "configuration", default)]
    pub(super) configurations: Vec<Configuration>,
}

/// A protocol of `i2slam eval` for all sequences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Protocol {
    I2slam,
    HeldOut,
}

/// A table of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Layout {
    Rendering,
    Tracking,
    Ablation,
    Runtime,
    VirtualCameras,
}

/// One sequence, or all that a pattern finds. Exactly one of `path`, `find` and `synth`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SequenceEntry {
    /// Heading of its column [default: the folder's name].
    pub(super) name: Option<String>,
    /// Folder, relative to `--data` or to the suite.
    pub(super) path: Option<PathBuf>,
    /// Folders of the data folder that no other entry names, `*` stands for anything.
    pub(super) find: Option<String>,
    /// A specification for `i2slam synth`, rendered once.
    pub(super) synth: Option<Table>,
    /// Heading over the columns of a data set.
    #[serde(default)]
    pub(super) group: String,
    /// Left out, with a note, where the folder does not exist.
    #[serde(default)]
    pub(super) optional: bool,
    /// As `--frames` of `i2slam run`.
    pub(super) frames: Option<String>,
    /// As `--stride`.
    pub(super) stride: Option<usize>,
    /// As `--scale`.
    pub(super) scale: Option<f64>,
    /// As `--camera`, relative as `path` is.
    pub(super) camera: Option<PathBuf>,
    /// As `--intrinsics`.
    pub(super) intrinsics: Option<[f64; 4]>,
    /// As `--depth-scale`.
    pub(super) depth_scale: Option<f64>,
    /// Frames whose pictures are judged: a published list, a file, or `auto`.
    pub(super) list: Option<String>,
    /// Added to every number of the list, for lists counted within `frames`.
    #[serde(default)]
    pub(super) list_offset: usize,
}

/// One row of the tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Configuration {
    /// Heading of the row.
    pub(super) name: String,
    /// Preset to start from.
    #[serde(default = "default_preset")]
    pub(super) preset: String,
    /// Further flags of `i2slam run`.
    #[serde(default)]
    pub(super) flags: Vec<String>,
    /// Values that replace those of the preset, as in a file for `--config`.
    #[serde(default)]
    pub(super) config: Table,
    /// Configurations of one series are joined by a line in plots.
    pub(super) series: Option<String>,
}

fn three() -> Vec<u64> {
    vec![0, 1, 2]
}

fn usual_tables() -> Vec<Layout> {
    vec![Layout::Rendering, Layout::Tracking, Layout::Runtime]
}

fn default_preset() -> String {
    "default".to_owned()
}

/// A suite and where it is from.
pub(super) struct Origin {
    pub(super) suite: Suite,
    /// Its file.
    pub(super) text: String,
    /// Name or path, for messages.
    pub(super) name: String,
    /// Folder that its paths are relative to.
    pub(super) folder: PathBuf,
}

impl Origin {
    /// Whether it came with the program, and has no folder.
    pub(super) fn is_shipped(&self) -> bool {
        self.folder.as_os_str().is_empty() && shipped(&self.name).is_some()
    }
}

/// The text of a shipped suite.
pub(super) fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// A file, or a suite that comes with the program.
pub(super) fn open(name: &Path) -> Result<Origin, Failure> {
    let shown = name.display().to_string();
    if name.is_file() {
        let text = std::fs::read_to_string(name)
            .map_err(|e| Failure::Failed(format!("{shown}: cannot be read: {e}")))?;
        let folder = name.parent().unwrap_or(Path::new("")).to_owned();
        return Ok(Origin { suite: parse(&text, &shown)?, text, name: shown, folder });
    }
    let Some(text) = shipped(&shown) else {
        let known: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        return Err(Failure::Usage(format!(
            "`{shown}` is neither a file nor a suite of the program ({})",
            known.join(", ")
        )));
    };
    let (suite, text) = (parse(text, &shown)?, text.to_owned());
    Ok(Origin { suite, text, name: shown, folder: PathBuf::new() })
}

/// A suite from text; `origin` names it in errors.
pub(super) fn parse(text: &str, origin: &str) -> Result<Suite, Failure> {
    let wrong = |reason: &str| Failure::Usage(format!("{origin}: {reason}"));
    let suite: Suite = toml::from_str(text).map_err(|e| wrong(e.to_string().trim_end()))?;
    if suite.sequences.is_empty() {
        return Err(wrong("no [[sequence]] to run on"));
    }
    if suite.configurations.is_empty() {
        return Err(wrong("no [[configuration]] to run"));
    }
    if suite.seeds.is_empty() {
        return Err(wrong("`seeds` is empty"));
    }
    for (place, entry) in suite.sequences.iter().enumerate() {
        let at = line_of_key(text, &["sequence", &place.to_string()]);
        let at = at.map(|line| format!(", line {line}")).unwrap_or_default();
        let wrong = |reason: &str| Failure::Usage(format!("{origin}{at}: {reason}"));
        let sources = [entry.path.is_some(), entry.find.is_some(), entry.synth.is_some()];
        if sources.iter().filter(|given| **given).count() != 1 {
            return Err(wrong("every [[sequence]] needs exactly one of path, find and synth"));
        }
        if entry.list.is_some() && suite.protocol == Some(Protocol::HeldOut) {
            return Err(wrong("protocol \"held-out\" judges its own frames, not a `list`"));
        }
        if entry.synth.is_some() && entry.name.is_none() {
            return Err(wrong("a [[sequence]] with synth needs a name"));
        }
        if entry.find.is_some() && entry.name.is_some() {
            return Err(wrong("a [[sequence]] with find takes the names of what it finds"));
        }
    }
    Ok(suite)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "title = \"t\"\n[[sequence]]\npath = \"room\"\n[[configuration]]\n\
                         name = \"a\"\n";

    fn refused(text: &str) -> String {
        let failure = parse(text, "mine.toml").expect_err("a bad suite");
        assert_eq!(failure.exit_code(), 2);
        failure.message().unwrap_or_default().to_owned()
    }

    #[test]
    fn what_is_left_out_takes_its_default() {
        let suite = parse(SMALL, "mine.toml").expect("a suite");
        assert_eq!(suite.seeds, [0, 1, 2]);
        assert_eq!(suite.tables, usual_tables());
        assert_eq!(suite.configurations[0].preset, "default");
    }

    #[test]
    fn mistakes_are_named() {
        let unknown = refused(&SMALL.replace("path", "patth"));
        assert!(unknown.contains("mine.toml") && unknown.contains("patth"), "{unknown}");
        assert!(unknown.contains("line 3"), "{unknown}");
        assert!(refused("title = \"t\"\n").contains("[[sequence]]"));
        let none = refused(&SMALL.replace("path = \"room\"", ""));
        assert!(none.contains("mine.toml, line 2: ") && none.contains("exactly one"), "{none}");
        let listed = SMALL.replace("path", "list = \"auto\"\npath");
        assert!(refused(&format!("protocol = \"held-out\"\n{listed}")).contains("list"));
        assert!(refused(&format!("seeds = []\n{SMALL}")).contains("seeds"));
    }
}
