//! The other commands, on one small result.

use crate::program::{Ran, Room, Scene, TemporaryFolder, i2slam, program, run};
use std::fs;
use std::path::Path;

#[test]
fn a_saved_result_and_poses_of_ones_own_are_drawn() {
    let room = Room::reconstructed("render", Scene::default(), &[]);
    let (out, again) = (&room.out, room.scratch.join("again"));
    i2slam!("render", out, "--frames", "2..4", "--out", again).exits_with(0);
    for (kind, extension) in
        [("sharp", "png"), ("blurred", "png"), ("hdr", "exr"), ("depth", "png")]
    {
        let file = |frame: usize| format!("{kind}/{frame:06}.{extension}");
        let first = fs::read(out.join("renders").join(file(2))).expect("a render of the run");
        assert!(first == fs::read(again.join(file(2))).expect("a new render"), "{kind}");
        assert!(again.join(file(3)).is_file() && !again.join(file(4)).exists());
    }
    let pose = ["--pose", "-0.01 0 0 0 0 0 1", "--kinds", "sharp,hdr"];
    i2slam!("render", out; pose).exits_with(0);
    assert!(room.has("views/sharp/000000.png") && room.has("views/hdr/000000.exr"));
    assert!(!room.has("views/depth"));
    i2slam!("render", out, "--poses", out.join("trajectory.txt")).exits_with(0);
    assert!(room.has("views/depth/000005.png") && !room.has("views/blurred"));
    for (flags, word) in [
        (&["--pose", "1 2 3"][..], "seven numbers"),
        (&["--pose", "0 0 0 0 0 0 0"], "no pose"),
        (&["--pose", "0 0 0 0 0 0 1", "--kinds", "blurred"], "no motion"),
        (&["--kinds", "sharpest"], "sharpest"),
        (&["--frames", "90..99"], "90..99"),
        (&["--frames", "4..2"], "holds no frame"),
    ] {
        i2slam!("render", out; flags).exits_with(2).stderr_contains(word);
    }
    let far = ["--pose", "100 0 0 0 0 0 1", "--kinds", "sharp"];
    i2slam!("render", out; far).exits_with(0).stderr_contains("nothing from 1 of 1 poses");
    let nowhere = room.scratch.join("nowhere");
    i2slam!("render", nowhere).exits_with(2).stderr_contains("no such folder");
    i2slam!("render", room.data).exits_with(2).stderr_contains("no result of a run");
}

#[test]
fn eval_fits_the_scale_of_a_unit_that_is_unknown() {
    let room = Room::reconstructed("eval-unit", Scene::default(), &["--render", "none"]);
    let (truth, metric) = (room.data.join("groundtruth.txt"), room.out.join("trajectory.txt"));
    let unknown = room.scratch.join("unknown.txt");
    let text = room.text("trajectory.txt");
    fs::write(&unknown, text.replacen("[m]", "[unit of length unknown]", 1)).expect("room");
    let fit = |file: &Path, flags: &[&str]| {
        i2slam!("eval", file, "--groundtruth", truth; flags).exits_with(0).out
    };
    assert!(fit(&metric, &[]).contains("SE(3)"));
    assert!(fit(&unknown, &[]).contains("Sim(3)"));
    assert!(fit(&unknown, &["--align", "se3"]).contains("SE(3)"));
}

#[test]
fn usage_is_checked() {
    run(["run"]).exits_with(2);
    run(["bench", "ablation", "--out", "x"]).exits_with(2).stderr_contains("i2slam-bench");
    for (flags, word) in [
        (&["--sharpen"][..], "--sharpen"),
        (&["--preset", "fast"], "paper-tum"),
        (&["--threads", "0"], "--threads"),
        (&["--virtual-cameras", "0"], "virtual_cameras"),
        (&["--rgb", "--keyframes", "p", "--preset", "paper-tum"], "is for RGB-D"),
        (&["--preset", "paper-rgb"], "add --rgb"),
    ] {
        i2slam!("run", "data", "--out", "out"; flags).exits_with(2).stderr_contains(word);
    }
}

#[test]
fn presets_are_listed_and_printed() {
    let list = run(["presets"]).exits_with(0).out;
    for name in ["default", "paper-tum", "paper-scannet-s", "paper-synthetic"] {
        assert!(list.contains(name), "{name}");
    }
    let printed = run(["presets", "paper-synthetic"]).exits_with(0).out;
    for words in ["[tracking]", "# Adam steps per frame", "Paper: 5", "`second-order`"] {
        assert!(printed.contains(words), "{words} is not in\n{printed}");
    }
    run(["presets", "none"]).exits_with(2);
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_ends_nothing_badly() {
    use crate::program::{Ran, program};
    use std::process::Stdio;
    let mut child = program(["presets", "default"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    Ran::from(child.wait_with_output().expect("an end")).exits_with(0);
}

#[test]
fn a_result_without_a_name_has_that_of_its_sequence() {
    let room = Room::new("unnamed", Scene { frames: 3, ..Scene::default() });
    let config = room.scratch.join("quick.toml");
    fs::write(&config, "[mapping]\nfinal_iterations = 3\niterations = 3\n").expect("room");
    let name = room.data.file_name().expect("a name").to_string_lossy().into_owned();
    let mut command = program(["run".as_ref(), room.data.as_os_str()]);
    command.arg("--config").arg(&config).args(["--render", "none"]);
    Ran::of(command.current_dir(room.scratch.join(""))).exits_with(0);
    assert!(room.scratch.join(&format!("{name}-i2slam/trajectory.txt")).is_file());
    run(["run", "-"]).exits_with(2).stderr_contains("--out DIR");
}

#[test]
fn a_result_is_no_sequence_and_a_preset_may_be_misspelt() {
    let room = Room::reconstructed("mistaken", Scene { frames: 3, ..Scene::default() }, &[]);
    i2slam!("info", room.out).exits_with(2).stderr_contains("is a result of `i2slam run`");
    i2slam!("run", room.out).exits_with(2).stderr_contains("is a result of `i2slam run`");
    for (pose, words) in
        [("0 0 0 0 0 0 nan", "expected seven numbers"), ("0,0,0, 0,0,0,0", "has no length")]
    {
        i2slam!("render", room.out, "--pose", pose).exits_with(2).stderr_contains(words);
    }
    let ply = room.scratch.join("map.ply");
    let ran = i2slam!("export", room.out, "--format", "PLY", "-o", ply).exits_with(0);
    let found = ran.err.split("lie in --crop \"").nth(1).and_then(|rest| rest.split('"').next());
    let found = found.unwrap_or_else(|| panic!("no box: {}", ran.err));
    i2slam!("export", room.out, "--format", "ply", "-o", ply, "--overwrite", "--crop", found)
        .exits_with(0);
    let misspelt = run(["run", "nowhere", "--preset", "defualt"]).exits_with(2);
    misspelt.stderr_contains("a similar value exists: 'default'");
}

/// A path without an input is a wrong argument, of whichever flag.
#[test]
fn an_input_that_is_not_there_is_a_wrong_argument() {
    let scratch = TemporaryFolder::new("not-there");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    for flags in [
        &["--camera", "no.json"][..],
        &["--intrinsics", "no.json"],
        &["--config", "no.toml"],
        &["--hold-out", "no.txt"],
    ] {
        let ran = i2slam!("run", data, "--out", out; flags).exits_with(2);
        ran.stderr_contains(flags[flags.len() - 2]).stderr_contains(flags[flags.len() - 1]);
        assert!(!out.exists());
    }
    let keyframes =
        i2slam!("run", data, "--out", out, "--rgb", "--keyframes", "nowhere").exits_with(2);
    keyframes.stderr_contains("nowhere holds no keyframes");
    for command in ["run", "info", "eval", "render"] {
        i2slam!(command, "nowhere").exits_with(2).stderr_contains("nowhere");
    }
    for flag in ["--groundtruth", "--reference"] {
        i2slam!("eval", data, flag, "nowhere").exits_with(2).stderr_contains(flag);
    }
    i2slam!("render", data, "--poses", "nowhere").exits_with(2).stderr_contains("--poses");
}

#[test]
fn shells_have_completions() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = run(["completions", shell]).exits_with(0).out;
        assert!(script.contains("export") && script.contains("min-opacity"), "{shell}");
        let is_of_lines = script.lines().count() > 100 && !script.contains("}\\n");
        assert!(is_of_lines, "{shell}: a script of lines\n{script}");
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let page = run(["man"]).exits_with(0).out;
    assert!(
        page.contains(".TH i2slam 1 \"\" \"i2slam ") && page.contains("i2slam\\-run(1)"),
        "{page}"
    );
    let scratch = TemporaryFolder::new("man");
    let (folder, foreign) = (scratch.join("man1"), scratch.join("man1/notes.1"));
    fs::create_dir(&folder).expect("a folder");
    fs::write(&foreign, "mine").expect("room");
    for _ in ["new", "replaced"] {
        i2slam!("man", "--out", folder).exits_with(0);
    }
    assert!(foreign.is_file());
    let options = fs::read_to_string(folder.join("i2slam-export.1")).expect("a page");
    assert!(options.contains(".TH i2slam-export 1"), "{options}");
    assert!(options.contains("min\\-opacity"), "{options}");
    let help = run(["--help"]).exits_with(0).out;
    assert!(help.lines().all(|line| line.chars().count() <= 100), "{help}");
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    // Descriptions that go on in a next line are indented further.
    let names = commands.take_while(|line| !line.is_empty());
    let names = names.filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    let names: Vec<_> = names.filter(|name| !matches!(*name, "" | "help")).collect();
    assert!(names.contains(&"demo") && names.contains(&"info"), "{names:?}");
    for name in names {
        assert!(folder.join(format!("i2slam-{name}.1")).is_file(), "{name}");
    }
    assert!(!folder.join("i2slam-bench.1").exists());
    fs::write(folder.join("i2slam-run.1"), "mine").expect("room");
    i2slam!("man", "--out", folder).exits_with(2).stderr_contains("no manual page");
    assert_eq!(fs::read_to_string(folder.join("i2slam-run.1")).expect("a file"), "mine");
}
