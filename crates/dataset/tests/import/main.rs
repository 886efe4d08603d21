//! Keyframes with poses from files of other programs.

#[path = "../support/mod.rs"]
mod support;

mod scene;
mod trajectory;

use i2slam_dataset::DatasetError;

#[track_caller]
fn assert_says<T>(result: Result<T, DatasetError>, parts: &[&str]) {
    let message = result.err().expect("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "'{part}' is not in: {message}");
    }
}

#[track_caller]
fn assert_warns(warnings: &[String], parts: &[&str]) {
    let all_in = |warning: &String| parts.iter().all(|part| warning.contains(part));
    assert!(warnings.iter().any(all_in), "no warning with {parts:?} in {warnings:?}");
}
