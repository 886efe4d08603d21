//! Keyframes with poses from files of other programs.

#[path = "../support/mod.rs"]
mod support;

mod arrays;
mod colmap;
mod conventions;
mod counted;
mod droid;
mod maps;
mod names;
mod nerfstudio;
mod options;
mod real;
mod scene;
mod trajectory;
mod variance;

use i2slam_dataset::DatasetError;
use i2slam_geometry::Pose;

#[track_caller]
fn assert_says<T>(result: Result<T, DatasetError>, parts: &[&str]) {
    let message = result.err().expect("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "'{part}' is not in: {message}");
    }
}

#[track_caller]
fn assert_same(a: Pose<f64>, b: Pose<f64>) {
    let apart = a.local(b);
    assert!(apart.translation.norm() + apart.rotation.norm() < 1e-6, "{a:?} {b:?}");
}

#[track_caller]
fn assert_warns(warnings: &[String], parts: &[&str]) {
    let all_in = |warning: &String| parts.iter().all(|part| warning.contains(part));
    assert!(warnings.iter().any(all_in), "no warning with {parts:?} in {warnings:?}");
}
