//! Keyframes with poses from files of other programs.

mod colmap;
mod conventions;
mod depth;
mod droid;
mod matching;
mod nerfstudio;
mod scene;
mod trajectory;

use i2slam_geometry::Pose;

#[track_caller]
fn assert_same(a: Pose<f64>, b: Pose<f64>) {
    let apart = a.local(b);
    assert!(apart.translation.norm() + apart.rotation.norm() < 1e-6, "{a:?} {b:?}");
}
