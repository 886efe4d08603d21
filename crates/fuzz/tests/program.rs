//! The program catches every kind of misbehaviour, attributes it to its case, and goes on.

use i2slam_check::{Ran, TemporaryFolder};
use std::fs;
use std::process::Command;

fn program(arguments: &[&str]) -> Ran {
    Ran::of(Command::new(env!("CARGO_BIN_EXE_i2slam-fuzz")).args(arguments))
}

/// A corpus of the misbehaving reader with a seed for every act; "regression" where it may refuse.
fn corpus(name: &str, acts: &[(&str, &str)]) -> TemporaryFolder {
    let corpus = TemporaryFolder::new(name);
    for (seed, act) in acts {
        let folder = corpus.join("misbehaving").join(seed);
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join("act.txt"), act).expect("room");
    }
    corpus
}

fn run_seeds(corpus: &TemporaryFolder) -> Ran {
    let folder = corpus.0.display().to_string();
    program(&[
        "misbehaving",
        "--corpus",
        &folder,
        "--cases",
        "0",
        "--time-limit",
        "1",
        "--seed",
        "1",
    ])
}

#[test]
fn every_failure_is_attributed_to_its_case() {
    let acts = [
        ("a", "accept", ""),
        ("b", "panic", "panic"),
        ("c", "panic in a thread", "panic"),
        ("d", "abort", "death"),
        ("e", "hang", "hang"),
        ("f", "overflow the stack", "death"),
        ("regression-g", "say nothing", "message: empty"),
        ("regression-h", "name no file", "message: names no file"),
        ("regression-i", "show an error's insides", "message: shows the insides"),
        ("j", "print", "printed: a library prints"),
        ("k", "no such act", "seed refused"),
        ("regression-l", "no such act", ""),
        ("m", "accept", ""),
    ];
    let corpus = corpus("fuzz-acts", &acts.map(|(seed, act, _)| (seed, act)));
    let ran = run_seeds(&corpus).exits_with_failures();
    for (seed, act, expected) in acts {
        let line = ran.lines().find(|line| line.contains(&format!(" seed {seed}: ")));
        match (line, expected) {
            (Some(line), "") => panic!("{act}: {line}"),
            (None, "") => {}
            (Some(line), _) => assert!(line.contains(expected), "{act}: {line}"),
            (None, _) => panic!("{act} was not noticed:\n{ran}"),
        }
    }
    assert!(ran.contains("| misbehaving       |    13 |        2 |       1 |       10 |"), "{ran}");
}

trait Failures {
    fn exits_with_failures(self) -> String;
}

impl Failures for Ran {
    #[track_caller]
    fn exits_with_failures(self) -> String {
        assert_eq!(self.code, Some(1), "{}{}", self.out, self.err);
        self.out
    }
}

#[test]
#[cfg(target_os = "linux")]
fn memory_is_bounded() {
    let corpus = corpus("fuzz-memory", &[("a", "reserve"), ("b", "accept")]);
    let ran = run_seeds(&corpus).exits_with_failures();
    let line = ran.lines().find(|line| line.contains(" seed a: ")).expect("a failure");
    assert!(line.contains("death") && ran.contains("memory allocation"), "{ran}");
    assert!(!ran.contains(" seed b: "), "{ran}");
}

#[test]
fn a_case_is_reproduced_and_its_files_written() {
    let scratch = TemporaryFolder::new("fuzz-case");
    let written = |name: &str| {
        let folder = scratch.join(name);
        let path = folder.display().to_string();
        let case = ["trajectory", "--seed", "3", "--case", "11", "--write", &path];
        let ran = program(&case).exits_with(0);
        assert!(ran.out.contains("Refused") || ran.out.contains("Accepted"), "{}", ran.out);
        fs::read(folder.join("trajectory.txt")).ok()
    };
    assert_eq!(written("a"), written("b"));
}

#[test]
fn an_unknown_reader_is_refused() {
    let ran = program(&["trajectories"]).exits_with(2);
    assert!(ran.err.contains("trajectories") && ran.err.contains("import-colmap"), "{}", ran.err);
}

#[test]
fn seeds_and_stored_regressions_pass() {
    program(&["--cases", "0", "--seed", "1"]).exits_with(0);
}
