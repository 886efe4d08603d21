//! Poses of a camera that moves sideways, as the formats write them.

/// Time stamp of a frame [s].
pub(super) fn stamp(frame: usize) -> f64 {
    100.0 + frame as f64 / 10.0
}

/// x of a frame's position [m]; nothing else changes.
pub(super) fn position(frame: usize) -> f64 {
    0.05 * frame as f64
}

/// A row-major matrix 4x4, `x` metres along x.
pub(super) fn matrix(x: f64) -> [f64; 16] {
    [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
}

/// Numbers with blanks between.
pub(super) fn words(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// A trajectory in TUM's format.
pub(super) fn trajectory(frames: usize) -> String {
    let line = |i: usize| format!("{:.6} {} 0 0 0 0 0 1\n", stamp(i), position(i));
    let lines: String = (0..frames).map(line).collect();
    format!("# timestamp tx ty tz qx qy qz qw\n{lines}")
}

/// Intrinsics of the pictures, pixel centres at integers [px].
pub(super) const INTRINSICS: [f64; 4] = [20.0, 20.0, 11.5, 8.5];
