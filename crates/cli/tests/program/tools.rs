//! Folders and the program.

use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// An empty folder for one test, removed when dropped.
pub(crate) struct Scratch {
    path: PathBuf,
}

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("i2slam-cli-{name}-{}", std::process::id()));
        fs::remove_dir_all(&path).ok();
        fs::create_dir_all(&path).expect("a temporary folder");
        Self { path }
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.path).ok();
    }
}

/// The program with arguments.
pub(crate) fn program<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_i2slam"));
    command.args(arguments);
    command
}

/// What a finished program left.
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Ran {
    pub(crate) fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Panics, showing everything, unless the exit code is this one and nothing panicked.
    #[track_caller]
    pub(crate) fn ended_with(self, code: i32) -> Self {
        let Self { out, err, .. } = &self;
        assert_eq!(self.code, Some(code), "standard output:\n{out}\nstandard error:\n{err}");
        assert!(!err.contains("mistake of i2slam") && !err.contains("panicked"), "{err}");
        self
    }

    /// Panics unless standard error holds this text.
    #[track_caller]
    pub(crate) fn complaining(self, text: &str) -> Self {
        assert!(self.err.contains(text), "`{text}` is not in:\n{}", self.err);
        self
    }
}

/// A program that runs, whose standard error is read as it comes.
pub(crate) struct Running {
    child: Child,
    lines: Lines<BufReader<ChildStderr>>,
    heard: String,
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("the program starts");
        let errors = child.stderr.take().expect("a pipe");
        Self { child, lines: BufReader::new(errors).lines(), heard: String::new() }
    }

    /// Waits for a line with this text.
    #[track_caller]
    pub(crate) fn until(&mut self, text: &str) -> String {
        for line in self.lines.by_ref().map_while(Result::ok) {
            self.heard += &format!("{line}\n");
            if line.contains(text) {
                return line;
            }
        }
        panic!("`{text}` is not in:\n{}", self.heard);
    }

    /// Sends Ctrl-C, after which it has some seconds to write what there is.
    #[track_caller]
    pub(crate) fn interrupted(mut self) -> Ran {
        let sent = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status();
        assert!(sent.expect("kill").success());
        let begun = Instant::now();
        self.heard.extend(self.lines.map_while(Result::ok).map(|line| line + "\n"));
        let output = self.child.wait_with_output().expect("an end");
        assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
        let ran = Ran::of(output);
        Ran { err: self.heard, ..ran }
    }
}

/// Run the program to its end.
pub(crate) fn run<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ran {
    Ran::of(program(arguments).output().expect("the program starts"))
}

/// `i2slam run` on a folder with settings that are quick.
pub(crate) fn reconstruct(dataset: &Path, out: &Path, more: &[&str]) -> Ran {
    let config = out.with_extension("quick.toml");
    fs::write(&config, "[mapping]\nfinal_iterations = 3\niterations = 12\n").expect("room");
    let mut arguments: Vec<&OsStr> = vec!["run".as_ref(), dataset.as_ref()];
    arguments.extend(["--out".as_ref(), out.as_os_str(), "--config".as_ref(), config.as_ref()]);
    arguments.extend(more.iter().map(OsStr::new));
    run(arguments)
}

/// The number that a key of a flat JSON file has; `None` for null.
pub(crate) fn number(json: &Path, key: &str) -> Option<f64> {
    let text = fs::read_to_string(json).expect("a JSON file");
    let object: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let value = object.get(key);
    value.unwrap_or_else(|| panic!("{key} is not in {text}")).as_f64()
}

/// Lines of a text file that are no comments.
pub(crate) fn rows(path: &Path) -> usize {
    let text = fs::read_to_string(path).expect("a text file");
    text.lines().filter(|line| !line.starts_with('#')).count()
}
