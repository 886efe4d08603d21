//! The file of a suite: which sequences, configurations and seeds a benchmark runs.

use crate::console::Failure;
use i2slam::config::line_of_key;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::Table;

/// Suites that come with the program: name and text.
pub(crate) const SHIPPED: [(&str, &str); 14] = [
    ("ablation", include_str!("../../../suites/ablation.toml")),
    ("ablation-scannet", include_str!("../../../suites/ablation-scannet.toml")),
    ("virtual-cameras", include_str!("../../../suites/virtual-cameras.toml")),
    ("runtime", include_str!("../../../suites/runtime.toml")),
    ("tum", include_str!("../../../suites/tum.toml")),
    ("scannet", include_str!("../../../suites/scannet.toml")),
    ("synthetic", include_str!("../../../suites/synthetic.toml")),
    ("presets", include_str!("../../../suites/presets.toml")),
    ("blur-models", include_str!("../../../suites/blur-models.toml")),
    ("shapes", include_str!("../../../suites/shapes.toml")),
    ("maps", include_str!("../../../suites/maps.toml")),
    ("paper", include_str!("../../../suites/paper.toml")),
    ("rgb", include_str!("../../../suites/rgb.toml")),
    ("rgb-tum", include_str!("../../../suites/rgb-tum.toml")),
];

/// The sequences, configurations and seeds of a benchmark.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Suite {
    /// Heading of the results.
    pub(crate) title: String,
    /// A sentence or two for the reader of the results.
    #[serde(default)]
    pub(crate) about: String,
    /// Seeds of the runs.
    #[serde(default = "default_seeds")]
    pub(crate) seeds: Vec<u64>,
    /// Jobs that run at once; overridden by `--jobs`.
    pub(crate) jobs: Option<usize>,
    /// Protocol that judges pictures [default: all frames, or the sequence's `list`].
    pub(crate) protocol: Option<Protocol>,
    /// Whether poses are optimised before pictures are judged.
    #[serde(default)]
    pub(crate) optimise_poses: bool,
    /// Tables to make, in this order.
    #[serde(default = "default_tables")]
    pub(crate) tables: Vec<TableKind>,
    #[serde(rename = "sequence", default)]
    pub(crate) sequences: Vec<SequenceEntry>,
    #[serde(rename = "configuration", default)]
    pub(crate) configurations: Vec<ConfigurationEntry>,
}

/// A protocol of `i2slam eval` for all sequences.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Protocol {
    I2slam,
    HeldOut,
}

/// A table of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum TableKind {
    Rendering,
    Tracking,
    Ablation,
    Runtime,
    VirtualCameras,
    Map,
}

/// A `[[sequence]]`: one sequence, or all that a pattern finds. Exactly one of `path`, `find` and
/// `synth` is given.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SequenceEntry {
    /// Heading of its column [default: the folder's name].
    pub(crate) name: Option<String>,
    /// Folder, relative to `--data` or to the suite.
    pub(crate) path: Option<PathBuf>,
    /// Pattern of folders in the data folder that no other entry names; `*` matches anything.
    pub(crate) find: Option<String>,
    /// A specification for `i2slam synth`, rendered once.
    pub(crate) synth: Option<Table>,
    /// Heading over the columns of a data set.
    #[serde(default)]
    pub(crate) group: String,
    /// Whether a missing folder is left out with a note instead of failing.
    #[serde(default)]
    pub(crate) optional: bool,
    /// Frames A to B-1 of the associated stream, `"A..B"` [default: all].
    pub(crate) frames: Option<FrameRange>,
    /// Every N-th frame.
    pub(crate) stride: Option<usize>,
    /// Size of the processed pictures over that of the recorded ones.
    pub(crate) scale: Option<f64>,
    /// Longer side of the processed pictures at most [px].
    pub(crate) max_side: Option<u32>,
    /// Camera file, relative as `path` is.
    pub(crate) camera: Option<PathBuf>,
    /// `[fx, fy, cx, cy]`, pixel centres at integers [px].
    pub(crate) intrinsics: Option<[f64; 4]>,
    /// Depth image value of one metre.
    pub(crate) depth_scale: Option<f64>,
    /// Frames whose pictures are judged: a published list, a file, or `auto`.
    pub(crate) list: Option<String>,
    /// Added to every number of the list, for lists counted within `frames`.
    #[serde(default)]
    pub(crate) list_offset: usize,
}

impl SequenceEntry {
    /// The options of `i2slam run` that read the sequence so; `locate` finds files of the suite.
    pub(crate) fn arguments(&self, locate: &impl Fn(&Path) -> PathBuf) -> Vec<String> {
        let mut arguments = Vec::new();
        let mut add = |option: &str, value: Option<String>| {
            if let Some(value) = value {
                arguments.extend([option.to_owned(), value]);
            }
        };
        add("--frames", self.frames.map(|range| format!("{}..{}", range.start, range.end)));
        add("--stride", self.stride.map(|n| n.to_string()));
        add("--scale", self.scale.map(|s| s.to_string()));
        add("--max-side", self.max_side.map(|side| side.to_string()));
        add("--camera", self.camera.as_ref().map(|path| locate(path).display().to_string()));
        add("--depth-scale", self.depth_scale.map(|s| s.to_string()));
        if let Some(numbers) = self.intrinsics {
            arguments.push("--intrinsics".to_owned());
            arguments.extend(numbers.map(|n| n.to_string()));
        }
        arguments
    }
}

/// Half-open range of frames, written `"A..B"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct FrameRange {
    start: usize,
    end: usize,
}

impl TryFrom<String> for FrameRange {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let number = |part: &str| part.trim().parse::<usize>().ok();
        let ends = text.split_once("..").and_then(|(a, b)| Some((number(a)?, number(b)?)));
        let range = ends.filter(|(start, end)| start < end);
        let wrong = || format!("`{text}` is no range of frames as in \"10..20\"");
        range.map(|(start, end)| Self { start, end }).ok_or_else(wrong)
    }
}

/// A `[[configuration]]`: one row of the tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ConfigurationEntry {
    /// Heading of the row.
    pub(crate) name: String,
    /// Preset to start from [default: `default`, `default-rgb` with `rgb`].
    pub(crate) preset: Option<String>,
    /// Whether depth pictures are ignored.
    #[serde(default)]
    pub(crate) rgb: bool,
    /// Settings that replace those of the preset, as in a file for `--config`.
    #[serde(default)]
    pub(crate) config: Table,
    /// Configurations of one series are joined by a line in plots.
    pub(crate) series: Option<String>,
}

impl ConfigurationEntry {
    pub(crate) fn preset(&self) -> &str {
        let default = if self.rgb { "default-rgb" } else { "default" };
        self.preset.as_deref().unwrap_or(default)
    }
}

fn default_seeds() -> Vec<u64> {
    vec![0, 1, 2]
}

fn default_tables() -> Vec<TableKind> {
    vec![TableKind::Rendering, TableKind::Tracking, TableKind::Runtime]
}

/// A suite with the file that it was read from.
pub(crate) struct SuiteFile {
    pub(crate) suite: Suite,
    pub(crate) text: String,
    /// Name or path, for messages.
    pub(crate) name: String,
    /// Folder that its paths are relative to; none of a suite that comes with the program.
    pub(crate) folder: Option<PathBuf>,
}

/// Opens a file, or a suite that comes with the program.
pub(crate) fn open(name: &Path) -> Result<SuiteFile, Failure> {
    let shown = name.display().to_string();
    if name.is_file() {
        let text = std::fs::read_to_string(name)
            .map_err(|e| Failure::Failed(format!("{shown}: cannot be read: {e}")))?;
        let folder = Some(name.parent().unwrap_or(Path::new("")).to_owned());
        return Ok(SuiteFile { suite: parse(&text, &shown)?, text, name: shown, folder });
    }
    let Some((_, text)) = SHIPPED.iter().find(|(known, _)| *known == shown) else {
        let known: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        return Err(Failure::Usage(format!(
            "`{shown}` is neither a file nor a suite of the program ({})",
            known.join(", ")
        )));
    };
    let (suite, text) = (parse(text, &shown)?, (*text).to_owned());
    Ok(SuiteFile { suite, text, name: shown, folder: None })
}

/// Parses a suite; `origin` names it in errors.
pub(crate) fn parse(text: &str, origin: &str) -> Result<Suite, Failure> {
    let wrong = |reason: &str| Failure::Usage(format!("{origin}: {reason}"));
    let suite: Suite = toml::from_str(text).map_err(|error| {
        let reason = error.to_string();
        match reason.contains("unknown field `flags`") {
            true => wrong(&format!(
                "{}\n  `flags` became configuration: instead of \"--no-blur\", \"--no-tone\", \
                 \"--map\", ... write config.formation.blur = false, config.formation.tone = false, \
                 config.map.kind = \"hashgrid\", and rgb = true for \"--rgb\"",
                reason.trim_end()
            )),
            false => wrong(reason.trim_end()),
        }
    })?;
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

/// A name as part of a path: lower case, other characters as `-`.
pub(crate) fn slug(name: &str) -> String {
    let plain =
        |c: char| if c.is_alphanumeric() || c == '_' { c.to_ascii_lowercase() } else { '-' };
    let slug: String = name.chars().map(plain).collect();
    let parts: Vec<&str> = slug.split('-').filter(|part| !part.is_empty()).collect();
    parts.join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "title = \"t\"\n[[sequence]]\npath = \"room\"\n[[configuration]]\n\
                         name = \"a\"\n";

    fn refused(text: &str) -> String {
        let failure = parse(text, "mine.toml").expect_err("a bad suite");
        assert_eq!(failure.exit_code(), 2);
        failure.message().expect("a message").to_owned()
    }

    #[test]
    fn missing_keys_take_their_defaults() {
        let suite = parse(SMALL, "mine.toml").expect("a suite");
        assert_eq!(suite.seeds, [0, 1, 2]);
        assert_eq!(suite.tables, default_tables());
        assert_eq!(suite.configurations[0].preset(), "default");
        let rgb = parse(&format!("{SMALL}rgb = true\n"), "mine.toml").expect("a suite");
        assert_eq!(rgb.configurations[0].preset(), "default-rgb");
    }

    #[test]
    fn mistakes_are_named_with_their_lines() {
        let unknown = refused(&SMALL.replace("path", "patth"));
        assert!(unknown.contains("mine.toml") && unknown.contains("patth"), "{unknown}");
        assert!(unknown.contains("line 3"), "{unknown}");
        assert!(refused("title = \"t\"\n").contains("[[sequence]]"));
        let none = refused(&SMALL.replace("path = \"room\"", ""));
        assert!(none.contains("mine.toml, line 2: ") && none.contains("exactly one"), "{none}");
        let listed = SMALL.replace("path", "list = \"auto\"\npath");
        assert!(refused(&format!("protocol = \"held-out\"\n{listed}")).contains("list"));
        assert!(refused(&format!("seeds = []\n{SMALL}")).contains("seeds"));
        let flags = refused(&format!("{SMALL}flags = [\"--no-blur\"]\n"));
        assert!(flags.contains("line 6") && flags.contains("formation.blur = false"), "{flags}");
        let range = refused(&SMALL.replace("path", "frames = \"20..10\"\npath"));
        assert!(range.contains("line 3") && range.contains("20..10"), "{range}");
    }

    #[test]
    fn a_sequence_is_read_by_options_of_run() {
        let entry = SequenceEntry {
            frames: "3..7".to_owned().try_into().ok(),
            camera: Some("cam.json".into()),
            intrinsics: Some([500.0, 501.5, 320.0, 240.0]),
            ..SequenceEntry::default()
        };
        let arguments = entry.arguments(&|path| Path::new("/data").join(path)).join(" ");
        let expected = "--frames 3..7 --camera /data/cam.json --intrinsics 500 501.5 320 240";
        assert_eq!(arguments, expected);
    }

    #[test]
    fn names_become_parts_of_paths() {
        assert_eq!(slug("Paper: no blur, N = 5"), "paper-no-blur-n-5");
        assert_eq!(slug("../x"), "x");
    }
}
