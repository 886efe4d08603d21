//! Gradient checks, comparisons, noise, temporary folders, finished programs and a clock; never
//! shipped.

mod program;

pub use program::Ran;
use std::path::{Path, PathBuf};

/// An empty folder for one test, removed when dropped.
pub struct TemporaryFolder(pub PathBuf);

impl TemporaryFolder {
    /// Creates the folder; `name` must be unique within the test program.
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("i2slam-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&path).ok();
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    /// The path of a file or folder in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

/// Names in a folder, sorted; none if it does not exist.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The gradient of `f` at `x` by central differences of fourth order,
/// `(8 [f(x+h) - f(x-h)] - [f(x+2h) - f(x-2h)]) / 12h`.
pub fn central_differences(x: &[f64], step: f64, mut f: impl FnMut(&[f64]) -> f64) -> Vec<f64> {
    let mut probe = x.to_vec();
    (0..x.len())
        .map(|i| {
            let mut at = |offset: f64| {
                probe[i] = x[i] + offset;
                let value = f(&probe);
                probe[i] = x[i];
                value
            };
            let near = at(step) - at(-step);
            let far = at(2.0 * step) - at(-2.0 * step);
            (8.0 * near - far) / (12.0 * step)
        })
        .collect()
}

/// Largest difference over the largest entry of two vectors; infinity if anything is NaN.
pub fn relative_error(actual: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(actual.len(), expected.len(), "vectors of different length");
    if actual.iter().chain(expected).any(|v| !v.is_finite()) {
        return f64::INFINITY;
    }
    let scale = actual.iter().chain(expected).fold(0.0_f64, |m, v| m.max(v.abs()));
    let worst = actual.iter().zip(expected).fold(0.0_f64, |m, (a, e)| m.max((a - e).abs()));
    if scale == 0.0 { 0.0 } else { worst / scale }
}

/// Panics, listing every entry that disagrees, unless `actual` is within `tolerance` of
/// `expected`, relative to the largest entry.
#[track_caller]
pub fn assert_close(name: &str, actual: &[f64], expected: &[f64], tolerance: f64) {
    let error = relative_error(actual, expected);
    if error <= tolerance {
        return;
    }
    let scale = expected.iter().fold(1e-300_f64, |m, v| m.max(v.abs()));
    let rows: Vec<String> = actual
        .iter()
        .zip(expected)
        .enumerate()
        .filter(|(_, (a, e))| (*a - *e).abs() > tolerance * scale || !(*a - *e).is_finite())
        .take(12)
        .map(|(i, (a, e))| format!("  [{i}] {a:.9e} expected {e:.9e}"))
        .collect();
    panic!("{name}: relative error {error:.3e} above {tolerance:.1e}\n{}", rows.join("\n"));
}

/// Panics unless `gradient` agrees with central differences of `f` at `x`.
#[track_caller]
pub fn assert_gradient(
    name: &str,
    x: &[f64],
    gradient: &[f64],
    step: f64,
    tolerance: f64,
    f: impl FnMut(&[f64]) -> f64,
) {
    assert_close(name, gradient, &central_differences(x, step, f), tolerance);
}

/// Reproducible numbers in `[-1, 1)` for test inputs (SplitMix64).
pub fn noise(seed: u64, count: usize) -> Vec<f64> {
    let mut state = seed;
    (0..count)
        .map(|_| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        })
        .collect()
}

/// Processor time of all threads of this process \[s\]; 0 where the system does not report it.
pub fn processor_seconds() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let nanoseconds = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse().ok()
    };
    tasks.flatten().filter_map(nanoseconds).sum::<f64>() * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_the_right_gradient() {
        let x = [0.3_f64, -1.2];
        let f = |x: &[f64]| x[0].sin() * x[1].exp();
        let gradient = [x[0].cos() * x[1].exp(), x[0].sin() * x[1].exp()];
        assert_gradient("sin exp", &x, &gradient, 1e-3, 1e-9, f);
    }

    #[test]
    #[should_panic(expected = "relative error")]
    fn refuses_a_wrong_gradient() {
        assert_gradient("square", &[1.0], &[2.1], 1e-3, 1e-6, |x| x[0] * x[0]);
    }

    #[test]
    #[should_panic(expected = "relative error")]
    fn refuses_a_missing_entry() {
        assert_close("missing", &[1.0, 0.0], &[1.0, 0.2], 1e-3);
    }

    #[test]
    #[should_panic(expected = "relative error")]
    fn refuses_nan() {
        assert_close("nan", &[f64::NAN], &[0.0], 1e-3);
    }
}
