//! The program from outside: jobs, interruptions, failures, tables.

use i2slam_check::{Ran, TemporaryFolder};
use i2slam_synthetic::{Spec, synthesise};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Once;
use std::time::SystemTime;

const QUICK: &str =
    "config.mapping = { iterations = 4, first_iterations = 8, final_iterations = 1 }";

/// A suite of one sequence, two configurations and one seed; `more` is added to the sequence.
fn suite(more: &str) -> String {
    format!(
        "title = \"Tiny\"\nseeds = [3]\ntables = [\"ablation\", \"tracking\", \"rendering\"]\n\n\
         [[sequence]]\npath = \"room\"\n{more}\n\
         [[configuration]]\nname = \"on\"\n{QUICK}\n\n\
         [[configuration]]\nname = \"off\"\nconfig.formation.blur = false\n{QUICK}\n"
    )
}

/// A data folder with one sequence whose sharp pictures are known, and a suite beside it.
fn prepared(name: &str, suite: &str) -> (TemporaryFolder, PathBuf, PathBuf) {
    let folder = TemporaryFolder::new(name);
    let mut spec = Spec { seed: 5, ..Spec::default() };
    (spec.camera.frames, spec.camera.width, spec.camera.height) = (4, 48, 36);
    (spec.camera.sub_frames, spec.camera.sharp_samples) = (4, 2);
    spec.light.texel = 0.12;
    synthesise(&spec, &folder.0.join("room"), false, &mut |_| true).expect("a sequence");
    let (file, out) = (folder.0.join("suite.toml"), folder.0.join("out"));
    fs::write(&file, suite).expect("room");
    (folder, file, out)
}

/// `i2slam-bench` with arguments. The program `i2slam` is built beside it, where it is looked for.
fn program<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Command {
    static BUILT: Once = Once::new();
    let own = Path::new(env!("CARGO_BIN_EXE_i2slam-bench"));
    BUILT.call_once(|| {
        let mut build = Command::new(env!("CARGO"));
        build.args(["build", "--quiet", "--package", "i2slam-cli", "--target-dir"]);
        let folder = own.parent().expect("target/PROFILE");
        build.arg(folder.parent().expect("target"));
        if folder.ends_with("release") {
            build.arg("--release");
        }
        assert!(build.status().expect("cargo").success());
    });
    let mut command = Command::new(own);
    command.args(arguments);
    command
}

fn run<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ran {
    Ran::of(&mut program(arguments))
}

fn bench(suite: &Path, out: &Path, more: &[&str]) -> Ran {
    let head: [&OsStr; 3] = [suite.as_ref(), "--out".as_ref(), out.as_ref()];
    run(head.into_iter().chain(more.iter().map(OsStr::new)))
}

fn written(file: &Path) -> SystemTime {
    fs::metadata(file).and_then(|data| data.modified()).expect("a file")
}

fn read(file: &Path) -> String {
    fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

#[test]
fn two_jobs_run_side_by_side_and_make_tables() {
    let (_folder, suite, out) = prepared("bench", &suite(""));
    let ran = bench(&suite, &out, &["--jobs", "2", "--threads", "2"]).exits_with(0);
    assert_eq!(ran.out.lines().next(), Some("2 of 2 jobs finished"), "{}", ran.out);
    assert_eq!(ran.out.lines().last(), out.join("results.html").to_str());
    let text = read(&out.join("results.md"));
    assert!(text.contains("| on | ✓ | ✓ | ✓ |") && text.contains("| off | ✓ | ✓ | ✗ |"), "{text}");
    assert!(text.contains("1 thread a job, 2 jobs at once"), "{text}");
    assert!(!text.contains("failed") && !text.contains("not run"), "{text}");
    let csv = read(&out.join("jobs.csv"));
    let header = csv.lines().next().expect("a header");
    for key in ["ate_rmse_m", "psnr_sharp_db", "lpips_sharp", "seconds_per_frame"] {
        assert!(header.split(',').any(|name| name == key), "{key} is not in {header}");
    }
    assert_eq!(csv.lines().count(), 3);
    assert!(read(&out.join("results.html")).contains("ATE over time per frame"));
    assert!(read(&out.join("tables/tracking.csv")).starts_with("Method,room mean,room sd"));
    let job = out.join("jobs/room/on/seed-3");
    assert!(job.join("result/report.html").is_file());
    assert!(!job.join("result/renders/sharp/000000.png").exists(), "pictures need much room");
}

#[test]
fn what_is_finished_is_not_run_again() {
    let (_folder, suite, out) = prepared("bench-resume", &suite(""));
    bench(&suite, &out, &["--configurations", "on"]).exits_with(0);
    let (on, off) = (out.join("jobs/room/on/seed-3"), out.join("jobs/room/off/seed-3"));
    let before = written(&on.join("result/metrics.json"));
    // What a killed job leaves: a folder without an end.
    fs::create_dir_all(off.join("result")).expect("a folder");
    let lock = "i2slam output process 1, i2slam run\n";
    fs::write(off.join("result/.i2slam-lock"), lock).expect("room");
    let dry = bench(&suite, &out, &["--dry-run"]).exits_with(0).out;
    assert!(dry.contains("finished  room, on, seed 3"), "{dry}");
    assert!(dry.contains("to do     room, off, seed 3"), "{dry}");
    let ran = bench(&suite, &out, &[]).exits_with(0);
    assert!(ran.err.contains("1 job is finished already"), "{}", ran.err);
    assert_eq!(written(&on.join("result/metrics.json")), before);
    assert!(off.join("result/metrics.json").is_file());
    // Another value makes other work of the job.
    fs::write(&suite, read(&suite).replace("final_iterations = 1", "final_iterations = 2"))
        .expect("room");
    let dry = bench(&suite, &out, &["--dry-run"]).exits_with(0).out;
    assert!(dry.contains("2 of 2 jobs to run"), "{dry}");
}

#[test]
fn a_job_that_fails_is_in_the_tables() {
    let missing = "\n[[sequence]]\npath = \"nowhere\"\n";
    let (_folder, suite, out) = prepared("bench-fail", &suite(missing));
    let ran = bench(&suite, &out, &["--configurations", "on"]).exits_with(1);
    ran.stderr_contains("nowhere, on, seed 3: failed").stderr_contains("one job failed");
    let text = read(&out.join("results.md"));
    assert!(text.contains("1 of 2 jobs finished, 1 failed"), "{text}");
    assert!(text.contains("| nowhere | on | 3 |") && text.contains("no file or folder"), "{text}");
    assert!(text.contains("no job of nowhere finished: it is in no mean"), "{text}");
    let record = read(&out.join("jobs/nowhere/on/seed-3/job.json"));
    assert!(record.contains("nowhere"), "{record}");
    assert!(read(&out.join("results.html")).contains("class=\"failed\""));
}

#[test]
fn a_job_with_a_degraded_result_has_failed() {
    // All depth beyond the room: no frame has any.
    let (_folder, suite, out) = prepared("bench-degraded", &suite("depth_scale = 1e-300"));
    let ran = bench(&suite, &out, &["--configurations", "on"]).exits_with(1);
    let reason = "0 of 4 frames were tracked: frame 0, rgb/000000.png: it has no depth";
    ran.stderr_contains(&format!("room, on, seed 3: failed: {reason}"));
    assert!(read(&out.join("results.md")).contains(reason));
    assert!(
        read(&out.join("jobs/room/on/seed-3/result/metrics.json")).contains("\"degraded\": true")
    );
}

#[test]
fn what_could_not_be_judged_is_judged_again_without_a_run() {
    let (folder, suite, out) = prepared("bench-judge", &suite(""));
    let sharp = folder.0.join("room/sharp");
    let list = folder.0.join("list.txt");
    fs::write(&list, "2\n").expect("room");
    fs::write(&suite, read(&suite).replace("path = ", "list = \"list.txt\"\npath = "))
        .expect("room");
    let mut pictures: Vec<PathBuf> =
        fs::read_dir(&sharp).expect("pictures").flatten().map(|entry| entry.path()).collect();
    pictures.sort();
    let whole = fs::read(&pictures[2]).expect("a picture");
    fs::write(&pictures[2], b"no picture").expect("room");
    let ran = bench(&suite, &out, &["--configurations", "on"]).exits_with(1);
    ran.stderr_contains("room, on, seed 3: failed: not judged").stderr_contains("frame 2");
    let metrics = out.join("jobs/room/on/seed-3/result/metrics.json");
    let before = written(&metrics);
    fs::write(&pictures[2], whole).expect("room");
    bench(&suite, &out, &["--configurations", "on"]).exits_with(0);
    assert_eq!(written(&metrics), before);
    let judged = read(&out.join("jobs/room/on/seed-3/eval.json"));
    assert!(judged.contains("\"sharp_frames\": 1"), "{judged}");
    bench(&suite, &out, &["--configurations", "on", "--fresh"]).exits_with(0);
    assert!(written(&metrics) > before, "--fresh runs it again");
}

#[test]
fn held_out_frames_are_judged_alone() {
    let text = format!("protocol = \"held-out\"\noptimise_poses = true\n{}", suite(""));
    let (_folder, suite, out) = prepared("bench-held-out", &text);
    bench(&suite, &out, &[]).exits_with(2).stderr_contains("hold_out");
    fs::write(&suite, text.replace("{ iterations", "{ hold_out = 2, iterations")).expect("room");
    bench(&suite, &out, &["--configurations", "on"]).exits_with(0);
    let judged = read(&out.join("jobs/room/on/seed-3/eval.json"));
    assert!(judged.contains("\"sharp_frames\": 1"), "{judged}");
    assert!(judged.contains("\"poses_optimised\": true"), "{judged}");
    assert!(read(&out.join("results.md")).contains("that the map never saw"));
}

#[test]
fn a_job_that_takes_too_long_is_ended() {
    let slow = suite("").replace("iterations = 4", "iterations = 400000");
    let (_folder, suite, out) = prepared("bench-late", &slow);
    let ran = bench(&suite, &out, &["--configurations", "on", "--timeout", "1"]).exits_with(1);
    ran.stderr_contains("ended after 1 s (--timeout)");
}

#[test]
fn mistakes_in_a_suite_are_found_before_anything_runs() {
    let refused = |name: &str, from: &str, to: &str, words: [&str; 2]| {
        let text = suite("");
        assert!(text.contains(from), "{text}");
        let (_folder, suite, out) = prepared(name, &text.replace(from, to));
        let ran = bench(&suite, &out, &[]).exits_with(2);
        words.iter().fold(ran, |ran, word| ran.stderr_contains(word));
        assert!(!out.exists());
    };
    refused("bench-key", "seeds", "sedes", ["unknown field `sedes`", "line 2"]);
    refused(
        "bench-setting",
        "final_iterations",
        "last",
        ["configuration `on`", "called `mapping.last`"],
    );
    refused(
        "bench-flags",
        "config.formation.blur = false",
        "flags = [\"--no-blur\"]",
        ["unknown field `flags`", "config.formation.blur = false"],
    );
    refused("bench-twin", "\"off\"", "\"On\"", ["`On`", "configurations"]);
    run(["ablations", "--out", "x"]).exits_with(2).stderr_contains("virtual-cameras");
}

#[test]
fn suites_come_with_the_program() {
    let list = run(["--list"]).exits_with(0).out;
    for name in
        ["ablation", "virtual-cameras", "runtime", "tum", "scannet", "synthetic", "rgb", "paper"]
    {
        assert!(list.lines().any(|line| line.starts_with(name)), "{name} is not in {list}");
    }
    let text = run(["ablation", "--print"]).exits_with(0).out;
    assert!(text.contains("[[configuration]]"), "{text}");
    let dry = run(["ablation", "--data", "/nowhere", "--dry-run"]).exits_with(0);
    assert_eq!(dry.out.lines().count(), 16, "{}", dry.out);
    assert!(dry.err.contains("dining-room is left out"), "{}", dry.err);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_the_jobs_and_writes_what_there_is() {
    use std::process::Stdio;
    use std::time::{Duration, Instant};
    let slow = suite("").replace("formation.blur", "formation.tone");
    let slow = slow.replacen("iterations = 4", "iterations = 400000", 2).replacen("400000", "4", 1);
    let (_folder, suite, out) = prepared("bench-ctrl-c", &slow);
    let arguments = [suite.as_os_str(), "--out".as_ref(), out.as_os_str()];
    let child = program(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let child = child.expect("the program starts");
    let begun = Instant::now();
    // The second job has begun, the first has its end.
    while !out.join("jobs/room/off/seed-3/run.log").exists() {
        assert!(begun.elapsed() < Duration::from_secs(60), "the first job takes too long");
        std::thread::sleep(Duration::from_millis(10));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    let ran = Ran::from(child.wait_with_output().expect("an end")).exits_with(130);
    assert!(ran.out.contains("1 of 2 jobs finished, 1 not run"), "{}", ran.out);
    assert!(!out.join("jobs/room/off/seed-3/job.json").exists());
    assert!(read(&out.join("results.md")).contains("| room | off | 3 | not run yet |"));
    let dry = bench(&suite, &out, &["--dry-run"]).exits_with(0).out;
    assert!(dry.contains("1 of 2 jobs to run"), "{dry}");
}
