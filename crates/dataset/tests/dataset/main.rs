//! Reading of datasets and of keyframes of other programs, on files made by the tests.

mod bounds;
mod failures;
mod formats;
mod import;
mod own_camera;
mod record3d;
mod scannet;
mod sequences;
mod stray_scanner;
mod support;
#[cfg(unix)]
mod video_depth;
