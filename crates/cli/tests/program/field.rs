//! A run whose map is a radiance field.

use crate::scene::Scene;
use crate::tools::{Scratch, number, run};
use std::fs;
use std::path::Path;

const QUICK: &str = "[hashgrid]\nlevels = 6\nlog2_table = 12\nfinest_cell = 0.02\n\
    hidden_width = 16\noccupancy_cells = 64\nrays = 1024\nfirst_iterations = 120\n\
    iterations = 12\nfinal_iterations = 30\n";

fn reconstruct(data: &Path, out: &Path, threads: &str) {
    let config = out.with_extension("toml");
    fs::write(&config, QUICK).expect("room");
    let [data, out, config] = [data, out, &config].map(|path| path.to_str().expect("a name"));
    let flags = ["--map", "hashgrid", "--config", config, "--threads", threads];
    let arguments = ["run", data, "--out", out].into_iter().chain(flags);
    let ran = run(arguments).ended_with(0);
    assert!(ran.out.contains("a hash grid of"), "{}", ran.out);
}

#[test]
fn a_field_is_saved_drawn_again_and_judged() {
    let scratch = Scratch::new("field");
    let (data, a, b) = (scratch.join("room"), scratch.join("a"), scratch.join("b"));
    Scene { frames: 4, ..Scene::default() }.write(&data);
    reconstruct(&data, &a, "1");
    reconstruct(&data, &b, "2");
    for file in ["map.i2slam", "trajectory_shutter.txt", "state.json"] {
        let same = fs::read(a.join(file)).expect(file) == fs::read(b.join(file)).expect(file);
        assert!(same, "{file} depends on the number of threads");
    }
    assert!(a.join("map.i2slam").is_file() && !a.join("map.ply").exists());
    let page = fs::read_to_string(a.join("report.html")).expect("a report");
    assert!(page.contains("<code>map.i2slam</code>") && !page.contains("<code>map.ply</code>"));
    let metrics = a.join("metrics.json");
    assert_eq!(
        (number(&metrics, "tracked"), number(&metrics, "gaussians")),
        (Some(4.0), Some(0.0))
    );
    assert!(number(&metrics, "ate_rmse_m").is_some_and(|error| error < 0.01));
    assert!(number(&metrics, "psnr_blurred_db").is_some_and(|psnr| psnr > 20.0));
    let again = scratch.join("again");
    let [a_name, again_name] = [&a, &again].map(|path| path.to_str().expect("a name"));
    run(["render", a_name, "--out", again_name]).ended_with(0);
    for file in ["sharp/000003.png", "blurred/000003.png", "depth/000003.png", "hdr/000003.exr"] {
        let first = fs::read(a.join("renders").join(file)).expect(file);
        assert!(first == fs::read(again.join(file)).expect(file), "{file}");
    }
    let truth = data.to_str().expect("a name");
    run(["eval", a_name, "--reference", truth]).ended_with(0);
}
