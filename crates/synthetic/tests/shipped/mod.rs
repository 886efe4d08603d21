//! The specifications that come with the program, at a small size.

use crate::support::{Scratch, files, render};
use i2slam_dataset::{OpenOptions, Sequence, read_trajectory};
use i2slam_synthetic::Spec;
use std::path::Path;

/// A shipped specification in small pictures and coarse light.
fn small(name: &str) -> Spec {
    let mut spec = Spec::shipped(name).expect("a specification");
    (spec.camera.width, spec.camera.height) = (64, 48);
    (spec.camera.sub_frames, spec.camera.sharp_samples) = (8, 2);
    spec.light.texel = 0.2;
    spec
}

/// Columns of `exposure.csv` by name, row by row.
fn table(folder: &Path, names: &[&str]) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(folder.join("exposure.csv")).expect("a table");
    let header: Vec<&str> = text.lines().next().expect("names").split(',').collect();
    let places = names.iter().map(|name| header.iter().position(|n| n == name).expect("a column"));
    let places: Vec<usize> = places.collect();
    let row = |line: &str| {
        let cells: Vec<f64> = line.split(',').map(|c| c.parse().expect("a number")).collect();
        places.iter().map(|&place| cells[place]).collect()
    };
    text.lines().skip(1).map(row).collect()
}

/// Share of the pixels whose green is white, and whose green is nearly black.
fn clipped(sequence: &Sequence, frame: usize) -> [f64; 2] {
    let colour = sequence.load(frame).expect("a frame").colour;
    let green = colour.plane(1);
    let share = |is: &dyn Fn(f32) -> bool| {
        green.iter().filter(|&&v| is(v)).count() as f64 / green.len() as f64
    };
    [share(&|v| v > 0.99), share(&|v| v < 0.2)]
}

#[test]
fn lamps_clip_and_shades_are_deep() {
    let scratch = Scratch::new("lamps");
    let mut spec = small("lamps");
    (spec.camera.frames, spec.camera.frame_rate) = (6, 2.0);
    render(&spec, &scratch.0);
    let sequence = Sequence::open(&scratch.0, &OpenOptions::default()).expect("a sequence");
    let ends: Vec<[f64; 2]> = (0..6).map(|frame| clipped(&sequence, frame)).collect();
    assert!(ends.iter().filter(|[white, _]| *white > 0.01).count() >= 3, "{ends:?}");
    assert!(ends.iter().any(|[_, black]| *black > 0.02), "{ends:?}");
    let names = ["wb_r", "wb_b", "vignetting_a", "vignetting_b", "vignetting_c"];
    for row in table(&scratch.0, &names) {
        assert!((row[0] * row[1] - 1.0).abs() < 1e-5);
        assert!((1.0 + row[2] + row[3] + row[4] - 0.6).abs() < 1e-6, "corners: {row:?}");
    }
}

#[test]
fn a_polished_room_is_the_same_with_any_number_of_threads() {
    let mut spec = small("glossy");
    spec.camera.frames = 2;
    let with_threads = |threads: usize, spec: &Spec, name: &str| {
        let scratch = Scratch::new(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| render(spec, &scratch.0));
        files(&scratch.0)
    };
    let one = with_threads(1, &spec, "glossy-one");
    assert!(one == with_threads(3, &spec, "glossy-three"), "files differ");
    let readme = String::from_utf8_lossy(&one[Path::new("README.md")]).into_owned();
    assert!(readme.contains("## Gloss") && !readme.contains("## Lens"), "{readme}");
    spec.gloss.polish = 0.01;
    let dull = with_threads(2, &spec, "glossy-dull");
    let [depth, hdr] = ["depth/000000.png", "hdr/000000.exr"].map(Path::new);
    assert!(one[depth] == dull[depth] && one[hdr] != dull[hdr]);
}

#[test]
fn stills_are_blurred_by_their_lengths_and_sharp_on_request() {
    let (blurred, sharp) = (Scratch::new("stills"), Scratch::new("stills-sharp"));
    let mut spec = small("stills");
    spec.noise.read = 0.0;
    spec.noise.shot = 0.0;
    render(&spec, &blurred.0);
    let lengths = table(&blurred.0, &["blur_px_median"]);
    assert_eq!(lengths.len(), 27);
    for (i, row) in lengths.iter().enumerate() {
        // 5 to 20 px in pictures of 640 px; what is nearer or farther moves more or less.
        let length = row[0] * 640.0 / 64.0;
        let due = if i % 7 == 0 { 0.0..=1e-6 } else { 3.5..=25.0 };
        assert!(due.contains(&length), "{i}: {length}");
    }
    (spec.exposure.shutter_minimum, spec.exposure.shutter_maximum) = (0.0, 0.0);
    spec.output.hdr_every = 0;
    render(&spec, &sharp.0);
    assert!(table(&sharp.0, &["blur_px_median"]).iter().all(|row| row[0] == 0.0));
    let poses = |folder: &Path| std::fs::read(folder.join("groundtruth.txt")).expect("poses");
    assert!(poses(&blurred.0) == poses(&sharp.0), "the same photographs");
    let trajectory = read_trajectory(sharp.0.join("groundtruth.txt")).expect("poses");
    let place = |i: usize| trajectory[i].world_from_camera.translation;
    let nearest = (1..27).map(|i| (place(i) - place(i - 1)).norm()).fold(f64::INFINITY, f64::min);
    assert!(nearest > 0.25, "neighbours are {nearest} m apart");
}
