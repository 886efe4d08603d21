//! Settings and arguments that exceed any machine, and runs that found nothing.

use crate::program::{Ran, Room, Scene, TemporaryFolder, i2slam, number, reconstruct};
use serde_json::Value;
use std::fs;
use std::io::BufReader;
use std::path::Path;

fn few() -> Scene {
    Scene { frames: 3, ..Scene::default() }
}

/// `degraded_because` of the result, one sentence behind another.
fn reasons(room: &Room) -> String {
    let metrics: Value = serde_json::from_str(&room.text("metrics.json")).expect("JSON");
    assert_eq!(metrics["complete"], Value::Bool(true));
    let all = metrics["degraded_because"].as_array().expect("a list");
    assert_eq!(metrics["degraded"], Value::Bool(!all.is_empty()));
    all.iter().map(|reason| reason.as_str().expect("a sentence")).collect::<Vec<_>>().join("; ")
}

/// The first error, and what comes after it on standard error.
#[track_caller]
fn first_error(ran: &Ran) -> &str {
    let mut errors = ran.err.lines().filter_map(|line| line.strip_prefix("error: "));
    let (first, second) = (errors.next(), errors.next());
    assert!(second.is_none(), "{}", ran.err);
    first.unwrap_or_else(|| panic!("no error in {}", ran.err))
}

#[test]
fn a_run_that_found_nothing_ends_with_exit_status_1() {
    let room = Room::new("nothing", few());
    let cases: [(&[&str], &str, &str); 2] = [
        (
            &["--depth-scale", "1e-300"],
            "wrong depth scale?",
            "frame 0, rgb/100.000000.png: it has no depth",
        ),
        (
            &["--intrinsics", "1e-5", "1e-5", "48", "36"],
            "with a focal length of 0.00001 px and the principal point at 48.5, 36.5",
            "the map was empty",
        ),
    ];
    for (flags, warning, cause) in cases {
        let flags = [flags, &["--overwrite"]].concat();
        let ran = room.run(&flags).exits_with(1).stderr_contains(warning);
        let error = first_error(&ran);
        assert!(error.starts_with("0 of 3 frames were tracked: "), "{error}");
        assert!(error.contains(cause) && error.contains("the map is empty"), "{error}");
        assert_eq!(reasons(&room), error);
        let out = &ran.out;
        assert!(out.starts_with("0 of 3 frames tracked (degraded), 0 Gaussians\n"), "{out}");
        assert!(out.contains("results in ") && room.has("trajectory.txt"), "{out}");
        assert!(room.text("report.html").contains("This result is degraded: 0 of 3 frames"));
    }
    // A good run is not degraded, and a worse one does not replace it.
    room.run(&["--overwrite"]).exits_with(0);
    assert_eq!(reasons(&room), "");
    let ran = room.run(&["--depth-scale", "1e-300", "--overwrite"]).exits_with(1);
    ran.stderr_contains("this run found too little: the earlier result");
    assert_eq!((reasons(&room), room.metric("tracked")), (String::new(), Some(3.0)));
}

/// Depth in which a tenth of the pixels are spikes, near and far.
fn add_spikes(path: &Path, random: &mut impl FnMut() -> u64) {
    let file = BufReader::new(fs::File::open(path).expect("a picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a header");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    for unit in bytes.chunks_exact_mut(2) {
        match random() % 100 {
            0..5 => unit.copy_from_slice(&u16::MAX.to_be_bytes()),
            5..10 => unit.copy_from_slice(&100_u16.to_be_bytes()),
            _ => {}
        }
    }
    let mut encoder =
        png::Encoder::new(fs::File::create(path).expect("a file"), info.width, info.height);
    encoder.set_color(info.color_type);
    encoder.set_depth(info.bit_depth);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&bytes).expect("room");
}

#[test]
fn depth_full_of_spikes_leaves_the_path_to_the_pictures() {
    let frames = 16;
    let scratch = TemporaryFolder::new("spikes");
    let (clip, out) = (scratch.join("clip"), scratch.join("out"));
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
    for part in ["", "rgb", "depth"] {
        fs::create_dir_all(clip.join(part)).expect("a folder");
        for file in fs::read_dir(demo.join(part)).expect("the clip").flatten() {
            if file.path().is_file() {
                fs::copy(file.path(), clip.join(part).join(file.file_name())).expect("room");
            }
        }
    }
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        state >> 33
    };
    let mut depths: Vec<_> =
        fs::read_dir(clip.join("depth")).expect("depth").flatten().map(|f| f.path()).collect();
    depths.sort();
    depths.iter().take(frames + 4).for_each(|path| add_spikes(path, &mut random));
    let range = format!("0..{frames}");
    let flags = ["--frames", &range, "--max-side", "80", "--render", "none"];
    reconstruct(&clip, &out, &flags).exits_with(0);
    let figure = |key| number(&out.join("metrics.json"), key).expect(key);
    let (tracked, error) = (figure("tracked"), figure("ate_rmse_m"));
    assert!(tracked >= 13.0 && error < 0.01, "{tracked} of 16 frames, {error} m");
    // Frames between keyframes share steps; the result tells those that were set.
    let config = fs::read_to_string(out.join("config.toml")).expect("the configuration");
    let mapping = config.split("[mapping]").nth(1).expect("its section");
    assert!(mapping.contains("\niterations = 12\n"), "{mapping}");
}

#[test]
fn frames_that_could_not_be_held_out_are_told() {
    let room = Room::new("none-held-out", few());
    let ran = room.run(&["--hold-out", "3", "--render", "none"]).exits_with(2);
    let words =
        "--hold-out 3 (mapping.hold_out) holds out none of 3 frames: expected a smaller number";
    assert_eq!(first_error(&ran), words);
    assert!(!room.out.exists());
    room.run(&["--hold-out", "2", "--render", "none"]).exits_with(0);
    assert_eq!(reasons(&room), "");
}

#[test]
fn settings_beyond_any_machine_are_refused_by_line() {
    let room = Room::new("beyond", few());
    let file = room.scratch.join("mine.toml");
    let refused = |text: &str, flags: &[&str], words: &str| {
        fs::write(&file, text).expect("room");
        let ran = i2slam!("run", room.data, "--out", room.out, "--config", file; flags);
        let ran = ran.exits_with(2);
        assert!(first_error(&ran).contains(words), "{} is not in {}", words, ran.err);
        assert!(!room.out.exists());
    };
    for (key, value) in [
        ("hashgrid.rays", "1000000000000"),
        ("mapping.iterations", "9223372036854775807"),
        ("tracking.iterations", "1000001"),
        ("hashgrid.final_iterations", "9000000000000000000"),
        ("mapping.window", "10001"),
        ("map.capacity", "100000001"),
        ("input.crop_border", "9223372036854775807"),
        ("formation.virtual_cameras", "65"),
    ] {
        let line = format!("mine.toml, line 2: {key} = {value} is out of range: ");
        refused(&format!("\n{key} = {value}\n"), &[], &line);
    }
    let field = "[map]\nkind = \"hashgrid\"\n[hashgrid]\nrays = 1000000\n\
                 [formation]\nvirtual_cameras = 64\n";
    let line = "mine.toml, line 4: hashgrid.rays = 1000000 needs about ";
    refused(field, &["--rgb"], line);
}

#[test]
fn arguments_beyond_any_machine_are_refused() {
    let room = Room::new("arguments", few());
    for (flag, value) in [
        ("--threads", "1000000000"),
        ("--threads", "1025"),
        ("--threads", "-1"),
        ("--memory", "2GB"),
        ("--memory", "-1"),
        ("--depth-scale", "0"),
        ("--depth-scale", "-5000"),
        ("--depth-scale", "700000"),
        ("--virtual-cameras", "65"),
        ("--hold-out", "1000001"),
        ("--scale", "1000"),
        ("--stride", "0"),
    ] {
        room.run(&[flag, value]).exits_with(2).stderr_contains(value);
        assert!(!room.out.exists(), "{flag} {value}");
    }
    room.run(&["--stride", "9223372036854775807", "--render", "none"]).exits_with(0);
    assert_eq!(room.metric("tracked"), Some(1.0));
}

#[test]
fn sequences_beyond_any_machine_are_not_rendered() {
    let scratch = TemporaryFolder::new("synth-limits");
    let (spec, out) = (scratch.join("spec.toml"), scratch.join("out"));
    for (text, words) in [
        ("[camera]\nwidth = 8192\nheight = 8192\n", "spec.toml, line 3: camera.height = 8192"),
        (
            "[camera]\nframes = 100000\nwidth = 4096\nheight = 4096\nsub_frames = 1024\n",
            "spec.toml, line 2: camera.frames = 100000",
        ),
        ("[light]\ntexel = 1e-9\n", "spec.toml, line 2: light.texel"),
    ] {
        fs::write(&spec, text).expect("room");
        i2slam!("synth", spec, "--out", out).exits_with(2).stderr_contains(words);
        assert!(!out.exists());
    }
}
