//! Recordings of the app Record3D.

use super::picture::{SIZE, jpeg};
use super::scene::INTRINSICS;
use crate::container::join_zip;
use crate::corpus::Files;

const DEPTH_SIZE: (usize, usize) = (12, 9);
const FRAMES: usize = 2;

/// The files of a recording, depth and confidence compressed.
pub(super) fn folder() -> Files {
    let [fx, fy, cx, cy] = INTRINSICS;
    let metadata = format!(
        r#"{{"w": {}, "h": {}, "dw": {}, "dh": {}, "fps": 30, "K": [{fx}, 0, 0, 0, {fy}, 0, {cx}, {cy}, 1],
 "perFrameIntrinsicCoeffs": [[{fx}, {fy}, {cx}, {cy}], [{fx}, {fy}, {cx}, {cy}]],
 "frameTimestamps": [0, 0.033], "poses": [[0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0.01, 0, 0]]}}"#,
        SIZE.0, SIZE.1, DEPTH_SIZE.0, DEPTH_SIZE.1
    );
    let mut all = Files::from([("metadata".to_owned(), metadata.into_bytes())]);
    for i in 0..FRAMES {
        let depth = |k: usize| (1.0 + 0.001 * (k + i) as f32).to_le_bytes();
        let depth: Vec<u8> = (0..DEPTH_SIZE.0 * DEPTH_SIZE.1).flat_map(depth).collect();
        let confidence: Vec<u8> = (0..DEPTH_SIZE.0 * DEPTH_SIZE.1).map(|k| (k % 3) as u8).collect();
        all.insert(format!("rgbd/{i}.jpg"), jpeg(SIZE, i, None));
        all.insert(format!("rgbd/{i}.depth"), compressed(&depth));
        all.insert(format!("rgbd/{i}.conf"), compressed(&confidence));
    }
    all
}

/// These files as an archive, the metadata deflated.
pub(super) fn archive() -> Vec<u8> {
    let files = folder();
    let methods: Vec<u16> =
        files.keys().map(|name| if name == "metadata" { 8 } else { 0 }).collect();
    let parts = files.into_iter().flat_map(|(name, bytes)| [name.into_bytes(), bytes]);
    join_zip(&parts.collect::<Vec<_>>(), &methods)
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    // Memory takes everything that is written.
    lzfse_rust::encode_bytes(bytes, &mut out).unwrap_or_default();
    out
}
