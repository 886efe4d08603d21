//! Results in the formats of other programs, and what is refused.

use crate::program::{Room, Scene, i2slam, rows};
use std::collections::HashMap;
use std::fs;
use std::path::Path;

fn reconstructed(name: &str) -> Room {
    Room::reconstructed(name, Scene { frames: 4, ..Scene::default() }, &[])
}

/// Exports to a name beside the result; returns the path.
fn export(room: &Room, format: &str, name: &str, flags: &[&str]) -> std::path::PathBuf {
    let out = room.scratch.join(name);
    i2slam!("export", room.out, "--format", format, "--out", out; flags).exits_with(0);
    out
}

/// Number that a header of PLY gives for an element.
fn ply_count(file: &Path, element: &str) -> usize {
    let bytes = fs::read(file).expect("written");
    let text = String::from_utf8_lossy(&bytes);
    let start = format!("element {element} ");
    let line = text.lines().find_map(|line| line.strip_prefix(&start));
    line.and_then(|count| count.parse().ok()).expect("a count")
}

/// Lines that are no comment, as words.
fn words(file: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(file).expect("written");
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(|line| line.split_whitespace().map(str::to_owned).collect()).collect()
}

fn numbers<const N: usize>(words: &[String]) -> [f64; N] {
    std::array::from_fn(|k| words[k].parse().expect("a number"))
}

/// `R(q) x + t` for a quaternion w, x, y, z.
fn transform([w, a, b, c, t0, t1, t2]: [f64; 7], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let cross =
        |[a, b, c]: [f64; 3], [x, y, z]: [f64; 3]| [b * z - c * y, c * x - a * z, a * y - b * x];
    let v = [a, b, c];
    let first = cross(v, [x, y, z]);
    let second = cross(v, first);
    let turned: [f64; 3] = std::array::from_fn(|k| [x, y, z][k] + 2.0 * (w * first[k] + second[k]));
    [turned[0] + t0, turned[1] + t1, turned[2] + t2]
}

#[test]
fn points_of_a_colmap_model_project_where_its_pictures_show_them() {
    let room = reconstructed("colmap");
    let out = export(&room, "colmap", "model", &[]);
    let sparse = out.join("sparse/0");
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        assert!(sparse.join(file).is_file(), "{file}");
    }
    let camera = &words(&sparse.join("cameras.txt"))[0];
    let [fx, fy, cx, cy] = numbers::<4>(&camera[4..]);
    let points: HashMap<String, [f64; 3]> = words(&sparse.join("points3D.txt"))
        .into_iter()
        .map(|point| (point[0].clone(), numbers::<3>(&point[1..])))
        .collect();
    let images = words(&sparse.join("images.txt"));
    assert_eq!(images.len(), 2 * 4, "two lines for each picture");
    let mut observations = 0;
    for image in images.chunks(2) {
        assert!(out.join("images").join(&image[0][9]).is_file(), "{}", image[0][9]);
        let pose = numbers::<7>(&image[0][1..]);
        for observation in image[1].chunks(3).filter(|observation| observation[2] != "-1") {
            let [u, v] = numbers::<2>(observation);
            let [x, y, z] = transform(pose, points[&observation[2]]);
            let (column, row) = (fx * x / z + cx, fy * y / z + cy);
            assert!((column - u).hypot(row - v) < 1.0, "{column} {row} for {u} {v}");
            observations += 1;
        }
    }
    assert!(observations > 100, "{observations}");
}

/// Pictures of an export, in the order of frames.
fn pictures(folder: &Path) -> Vec<Vec<u8>> {
    let mut files: Vec<_> = fs::read_dir(folder.join("images"))
        .expect("a folder")
        .flatten()
        .map(|f| f.path())
        .collect();
    files.sort();
    files.into_iter().map(|file| fs::read(file).expect("a picture")).collect()
}

#[test]
fn pictures_have_detail_of_those_taken_while_the_map_is_whole_and_these_are_there() {
    let room = reconstructed("detail");
    let whole = pictures(&export(&room, "colmap", "whole", &[]));
    let cut = pictures(&export(&room, "colmap", "cut", &["--min-opacity", "0.000001"]));
    fs::rename(&room.data, room.scratch.join("elsewhere")).expect("a folder");
    let out = room.scratch.join("alone");
    i2slam!("export", room.out, "--format", "colmap", "--out", out)
        .exits_with(0)
        .stderr_contains("the pictures are the map's alone")
        .stderr_contains("if it was moved, write its new place into `dataset` of");
    let alone = pictures(&out);
    let input = room.out.join("input.json");
    let text = fs::read_to_string(&input).expect("the input");
    let moved = room.scratch.join("elsewhere");
    let [before, after] = [&room.data, &moved].map(|path| path.to_str().expect("a plain path"));
    fs::write(&input, text.replace(before, after)).expect("room");
    let again = pictures(&export(&room, "colmap", "again", &[]));
    fs::write(room.out.join("input.json"), "{").expect("room");
    i2slam!("export", room.out, "--format", "html", "--out", room.scratch.join("page.html"))
        .exits_with(0)
        .stderr_contains("input.json");
    assert_eq!(whole.len(), 4);
    assert_eq!(cut, alone);
    assert_eq!(again, whole);
    assert!(whole.iter().zip(&alone).all(|(whole, alone)| whole != alone));
}

#[test]
fn every_format_holds_the_whole_result() {
    let room = reconstructed("formats");
    let count = ply_count(&room.out.join("map.ply"), "vertex");
    assert_eq!(ply_count(&export(&room, "ply", "a.ply", &[]), "vertex"), count);
    let compressed = export(&room, "compressed-ply", "a.compressed.ply", &[]);
    assert_eq!(ply_count(&compressed, "vertex"), count);
    assert_eq!(ply_count(&compressed, "chunk"), count.div_ceil(256));
    let size = |file: &Path| fs::metadata(file).expect("written").len();
    assert!(3 * size(&compressed) < size(&room.out.join("map.ply")));

    let glb = fs::read(export(&room, "glb", "a.glb", &[])).expect("written");
    assert_eq!(&glb[..4], b"glTF");
    assert_eq!(u32::from_le_bytes(glb[8..12].try_into().expect("four")) as usize, glb.len());
    assert!(String::from_utf8_lossy(&glb).contains("KHR_gaussian_splatting"));

    assert!(ply_count(&export(&room, "mesh", "mesh.ply", &[]), "face") > 100);
    assert_eq!(rows(&export(&room, "tum", "path.txt", &[])), 4);
    assert_eq!(rows(&export(&room, "csv", "path.csv", &[])), 5);

    let folder = export(&room, "nerfstudio", "nerf", &[]);
    let text = fs::read_to_string(folder.join("transforms.json")).expect("written");
    let transforms: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let frames = transforms["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), 4);
    for frame in frames {
        let picture = folder.join(frame["file_path"].as_str().expect("a path"));
        assert!(picture.is_file(), "{}", picture.display());
    }

    let page = fs::read_to_string(export(&room, "html", "a.html", &[])).expect("written");
    assert!(page.contains("<canvas") && !page.contains("src=\"http"), "not self-contained");
}

#[test]
fn a_box_and_an_opacity_cut_the_map() {
    let room = reconstructed("cut");
    let whole = ply_count(&export(&room, "ply", "whole.ply", &[]), "vertex");
    let right = ["--crop", "0 -100 -100 100 100 100"];
    let cut = ply_count(&export(&room, "ply", "right.ply", &right), "vertex");
    assert!((1..whole).contains(&cut), "{cut} of {whole}");
    let opaque = export(&room, "ply", "opaque.ply", &["--min-opacity", "0.9"]);
    let often = export(&room, "ply", "often.ply", &["--min-views", "2"]);
    for part in [opaque, often] {
        assert!((1..whole).contains(&ply_count(&part, "vertex")), "{}", part.display());
    }
    let out = room.scratch.join("empty.ply");
    let box_of_nothing = ["--crop", "500 500 500 501 501 501"];
    let none = i2slam!("export", room.out, "--format", "ply", "--out", out; box_of_nothing);
    none.exits_with(1).stderr_contains("no Gaussian is left");
    assert!(!out.exists());
}

#[test]
fn nothing_but_an_earlier_export_is_replaced() {
    let room = reconstructed("replace");
    let out = export(&room, "ply", "a.ply", &[]);
    let again =
        |flags: &[&str]| i2slam!("export", room.out, "--format", "ply", "--out", out; flags);
    again(&[]).exits_with(2).stderr_contains("--overwrite");
    again(&["--overwrite"]).exits_with(0);
    fs::write(&out, "mine").expect("room");
    again(&["--overwrite"]).exits_with(2).stderr_contains("choose another name");
    assert_eq!(fs::read_to_string(&out).ok().as_deref(), Some("mine"));

    let folder = room.scratch.join("mine");
    fs::create_dir_all(folder.join("images")).expect("a folder");
    fs::write(folder.join("images/a.png"), "mine").expect("room");
    i2slam!("export", room.out, "--format", "colmap", "--out", folder; ["--overwrite"])
        .exits_with(2);
    assert!(folder.join("images/a.png").is_file() && !folder.join("sparse").exists());

    let nerfstudio = export(&room, "nerfstudio", "other", &[]);
    i2slam!("export", room.out, "--format", "colmap", "--out", nerfstudio; ["--overwrite"])
        .exits_with(2);
    assert!(nerfstudio.join("transforms.json").is_file() && !nerfstudio.join("sparse").exists());
    let again = ["--overwrite", "--keyframes"];
    i2slam!("export", room.out, "--format", "nerfstudio", "--out", nerfstudio; again).exits_with(0);
}

/// Whoever edits a path may lose a day's work with it.
#[test]
fn a_path_that_is_replaced_is_kept_beside_it() {
    let room = reconstructed("previous");
    let out = export(&room, "tum", "path.txt", &[]);
    let edited = fs::read_to_string(&out).expect("a path") + "# my own move\n";
    fs::write(&out, &edited).expect("room");
    let again = i2slam!("export", room.out, "--format", "tum", "--out", out; ["--overwrite"]);
    let previous = room.scratch.join("path.txt.previous");
    again.exits_with(0).stderr_contains("path.txt.previous");
    assert_eq!(fs::read_to_string(&previous).ok(), Some(edited));
    fs::write(&previous, "mine").expect("room");
    i2slam!("export", room.out, "--format", "tum", "--out", out; ["--overwrite"])
        .exits_with(2)
        .stderr_contains("move it away");
    assert_eq!(fs::read_to_string(&previous).ok().as_deref(), Some("mine"));
}

#[test]
fn views_of_another_world_are_refused() {
    let room = reconstructed("levelled");
    let levelled = export(&room, "tum", "levelled.txt", &[]);
    let kept = export(&room, "tum", "kept.txt", &["--up", "keep"]);
    let out = room.scratch.join("views");
    let render = |poses: &Path| i2slam!("render", room.out, "--poses", poses, "--out", out);
    render(&levelled).exits_with(1).stderr_contains("--up keep");
    render(&kept).exits_with(0);
    let film = room.scratch.join("film.mp4");
    i2slam!("export", room.out, "--format", "video", "--poses", levelled, "--out", film)
        .exits_with(1)
        .stderr_contains("levelled world");
}

#[test]
fn what_cannot_be_exported_is_told() {
    let room = reconstructed("refused");
    let refused = |flags: &[&str], due: &str| {
        let out = room.scratch.join("refused.ply");
        i2slam!("export", room.out, "--out", out; flags).exits_with(2).stderr_contains(due);
        assert!(!out.exists());
    };
    refused(&["--format", "las"], "possible values");
    refused(&["--format", "glb"], ".glb");
    refused(&["--format", "tum", "--min-opacity", "0.5"], "the path alone");
    refused(&["--format", "mesh", "--linear"], "ply and glb, not for mesh");
    refused(&["--format", "compressed-ply", "--linear"], "not for compressed-ply");
    refused(&["--format", "ply", "--keyframes"], "ply holds the map alone");
    i2slam!("export", room.out, "--format", "tum", "--out", "-")
        .exits_with(2)
        .stderr_contains("name a file");
    i2slam!(
        "export",
        room.out.join("config.toml"),
        "--format",
        "tum",
        "--out",
        room.scratch.join("a")
    )
    .exits_with(2)
    .stderr_contains("a file, where");
    let constant = ["--format", "ply", "--constant-exposure"];
    refused(&constant, "--constant-exposure is for --format video");
    refused(&["--format", "ply", "--voxel", "0.1"], "--voxel is for --format mesh");
    let views = room.scratch.join("views.txt");
    fs::write(&views, "1 0 0 0 0 0 0 1\n").expect("room");
    let views = views.to_str().expect("a path");
    refused(&["--format", "ply", "--poses", views], "--poses is for --format video");
    refused(&["--format", "video", "--poses", views], "at least two poses");
    refused(&["--format", "ply", "--crop", "0 0 0"], "six numbers");
    refused(&["--format", "ply", "--up", "down"], "expected `estimate`");
    let out = room.scratch.join("a.ply");
    i2slam!("export", room.data, "--format", "ply", "--out", out)
        .exits_with(2)
        .stderr_contains("no result of a run");
    assert!(!out.exists());
}

/// Sizes and counts beyond what the scene has: what would do is said.
#[test]
fn a_size_beyond_the_scene_is_told_with_one_that_fits() {
    let room = reconstructed("beyond");
    let out = room.scratch.join("mesh.ply");
    let refused = |flags: &[&str]| {
        let ran =
            i2slam!("export", room.out, "--format", "mesh", "--out", out; flags).exits_with(1);
        assert!(!out.exists());
        ran
    };
    let size = refused(&["--voxel", "500"]);
    size.stderr_contains("voxels of 500 are too large")
        .stderr_contains("choose smaller ones as in --voxel 0.0");
    let views = refused(&["--min-views", "99"]);
    views
        .stderr_contains("--min-views 99: expected 1 to 4")
        .stderr_contains("4 frames with a pose");
}

#[test]
fn poses_are_those_of_the_run_though_its_path_was_edited() {
    let room = reconstructed("edited");
    let note = "trajectory_shutter.txt";
    let path = |name: &str| {
        let out = room.scratch.join(name);
        let ran = i2slam!("export", room.out, "--format", "tum", "--out", out).exits_with(0);
        (ran.err, fs::read_to_string(out).expect("written"))
    };
    let (err, before) = path("before.txt");
    assert!(!err.contains(note), "{err}");
    let edited = room.text("trajectory.txt").replacen(" 1.000000000\n", " 0.9\n", 1);
    let edited = edited.replacen("0.000000000", "5.000000000", 1);
    fs::write(room.out.join("trajectory.txt"), edited).expect("room");
    let (err, after) = path("after.txt");
    assert!(err.contains("is not as the run wrote it") && err.contains(note), "{err}");
    assert_eq!(before, after);
    i2slam!("render", room.out, "--frames", "0..1").exits_with(0).stderr_contains(note);
    fs::remove_file(room.out.join("trajectory.txt")).expect("a file");
    assert!(!path("without.txt").0.contains(note));
}

#[test]
fn without_ffmpeg_a_video_says_what_is_needed() {
    let room = reconstructed("no-ffmpeg");
    let out = room.scratch.join("a.mp4");
    let mut command =
        crate::program::program(["export".as_ref(), room.out.as_os_str(), "--format".as_ref()]);
    command.args(["video", "--out"]).arg(&out).env("I2SLAM_FFMPEG", room.scratch.join("none"));
    let ran = crate::program::Ran::of(&mut command).exits_with(1);
    ran.stderr_contains("ffmpeg");
    assert!(!out.exists());
}
