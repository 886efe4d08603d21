//! Power spectra of patches that two photographs show of one place.

use crate::result::{Keyframe, SparseDepth};
use crate::track::pyramid::Pyramid;
use i2slam_geometry::{Camera, Image, Pose};
use std::f32::consts::TAU;
use std::sync::LazyLock;

/// Side of a patch [px].
const SIDE: usize = 16;
const PIXELS: usize = SIDE * SIDE;
/// Periods in a patch of the highest frequency that is compared: cubic interpolation keeps these.
const MAX_PERIODS: i32 = 5;
/// Number of frequencies: half of those up to the highest, the others have the same power.
pub(super) const FREQUENCIES: usize = 40;
/// Patches of the finest level that are compared in a pair of photographs, and of each other level.
const MAX_PATCHES: [usize; 2] = [60, 30];
/// Shorter side of the coarsest level, at least [px].
const MIN_LEVEL_SIDE: usize = 3 * SIDE;
/// Power of noise in pictures of mean 1, of what one photograph alone shows, and of interpolation.
pub(super) const NOISE: f32 = 1e-4;
/// Least mean brightness of a patch, and least contrast: variance over the squared mean.
const MIN_BRIGHTNESS: f32 = 2e-3;
const MIN_CONTRAST: f32 = 2e-5;
/// Brightness of clipped pixels, and their share in a patch, at most.
const CLIPPED: f32 = 0.95;
const MAX_CLIPPED_SHARE: f32 = 0.05;
/// Correlation below which two patches do not show the same.
const MIN_CORRELATION: f32 = 0.5;
/// Changes of the slopes of a plane that are tried, one after the other.
const SLOPE_CHANGES: [f64; 2] = [0.7, 0.35];
/// Ratio of sizes in two photographs, in any direction, beyond which patches are not compared.
const MAX_STRETCH: f32 = 1.5;

type Patch = [f32; PIXELS];

/// A photograph.
pub(super) struct View<'a> {
    pub(super) number: usize,
    pub(super) keyframe: &'a Keyframe,
    /// In linear light.
    pub(super) pyramid: &'a Pyramid,
}

/// A place in two photographs.
pub(super) struct PatchPair {
    /// Numbers of the photographs.
    pub(super) photographs: [usize; 2],
    /// Pixels of the compared level over those of the finest.
    pub(super) scale: f32,
    /// Frequencies in the second photograph are this matrix times those in the first.
    second_from_first: [[f32; 2]; 2],
    /// Logarithm of the power in the first photograph over that in the second, by frequency.
    pub(super) log_ratios: [f32; FREQUENCIES],
    /// Sum of both powers.
    pub(super) sums: [f32; FREQUENCIES],
}

impl PatchPair {
    /// A frequency of the first photograph as the second shows it [rad/px].
    pub(super) fn in_second(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        self.second_from_first.map(|row| row[0] * x + row[1] * y)
    }
}

/// The compared frequencies [rad/px].
pub(super) static FREQUENCY: LazyLock<[[f32; 2]; FREQUENCIES]> =
    LazyLock::new(|| PERIODS.map(|both| both.map(|n| n as f32 * TAU / SIDE as f32)));

/// Their periods in a patch, across and down.
static PERIODS: LazyLock<[[i32; 2]; FREQUENCIES]> = LazyLock::new(|| {
    let down = -MAX_PERIODS..=MAX_PERIODS;
    let all = (0..=MAX_PERIODS).flat_map(|x| down.clone().map(move |y| [x, y]));
    let is_compared =
        |[x, y]: &[i32; 2]| (*x > 0 || *y > 0) && x * x + y * y <= MAX_PERIODS * MAX_PERIODS;
    let mut compared = all.filter(is_compared);
    std::array::from_fn(|_| compared.next().unwrap_or_default())
});

/// Raised cosine, which ends at zero beside the patch.
static WINDOW: LazyLock<Patch> = LazyLock::new(|| {
    let rise = |i: usize| 0.5 - 0.5 * (TAU * (i + 1) as f32 / (SIDE + 1) as f32).cos();
    std::array::from_fn(|i| rise(i / SIDE) * rise(i % SIDE))
});

/// Cosine and sine of every sixteenth of a turn.
static TURN: LazyLock<[[f32; 2]; SIDE]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let (sin, cos) = (TAU * i as f32 / SIDE as f32).sin_cos();
        [cos, sin]
    })
});

/// Patches around landmarks of the first photograph that the second one shows, too, on all levels.
pub(super) fn compare_patches(camera: &Camera<f64>, views: [&View<'_>; 2]) -> Vec<PatchPair> {
    let pose = |view: &View<'_>| view.keyframe.world_from_camera;
    let second_from_first = pose(views[1]).inverse() * pose(views[0]);
    let landmarks = &views[0].keyframe.depths;
    let mut pairs = Vec::new();
    let levels = views[0].pyramid.levels.iter().zip(&views[1].pyramid.levels).enumerate();
    for (level, (first, second)) in levels {
        if first.width.min(first.height) < MIN_LEVEL_SIDE {
            break;
        }
        let wanted = MAX_PATCHES[level.min(1)];
        let scale = 0.5_f64.powi(level as i32);
        let warp = |landmark: &SparseDepth| Warp {
            camera,
            second_from_first,
            scale,
            centre: landmark.at.map(|at| (at * scale).round()),
            depth: landmark.depth,
            slopes: [0.0; 2],
        };
        // Every n-th landmark first: neighbours in the list often lie on one surface.
        let steps = (landmarks.len() / (2 * wanted)).max(1);
        let spread = (0..steps).flat_map(|start| landmarks.iter().skip(start).step_by(steps));
        let numbers = [views[0].number, views[1].number];
        let compared =
            spread.filter_map(|landmark| patch_pair(warp(landmark), [first, second], numbers));
        pairs.extend(compared.take(wanted));
    }
    pairs
}

/// Maps pixels around a landmark to the second photograph, as those of a plane through it.
#[derive(Clone, Copy)]
struct Warp<'a> {
    camera: &'a Camera<f64>,
    second_from_first: Pose<f64>,
    /// Pixels of the level over those of the finest.
    scale: f64,
    /// Pixel of the landmark, and its depth.
    centre: [f64; 2],
    depth: f64,
    /// Slopes of the plane: growth of the inverse depth over that of the landmark, by tangents of angles.
    slopes: [f64; 2],
}

impl Warp<'_> {
    fn map(&self, u: f64, v: f64) -> Option<[f64; 2]> {
        let [du, dv] = [u - self.centre[0], v - self.centre[1]].map(|pixels| pixels / self.scale);
        let camera = self.camera;
        let growth = 1.0 + self.slopes[0] * du / camera.fx + self.slopes[1] * dv / camera.fy;
        let point = camera.unproject(u / self.scale, v / self.scale, self.depth / growth);
        let seen = self.second_from_first * point;
        let (u, v) = camera.project(seen);
        (growth > 0.0 && seen.z > 0.0).then_some([u * self.scale, v * self.scale])
    }

    /// Derivatives of [`map`](Self::map), as differences over a patch.
    fn jacobian(&self) -> Option<[[f32; 2]; 2]> {
        let ([u, v], half) = (self.centre, 0.5 * SIDE as f64);
        let slope = |du: f64, dv: f64| {
            let (before, after) = (self.map(u - du, v - dv)?, self.map(u + du, v + dv)?);
            Some([0, 1].map(|i| ((after[i] - before[i]) / SIDE as f64) as f32))
        };
        let (by_u, by_v) = (slope(half, 0.0)?, slope(0.0, half)?);
        Some([[by_u[0], by_v[0]], [by_u[1], by_v[1]]])
    }

    /// The patch of a level of the second photograph.
    fn patch(&self, second: &Image<f32>) -> Option<Patch> {
        let ([u, v], half) = (self.centre, 0.5 * SIDE as f64 - 0.5);
        let mut out = [0.0; PIXELS];
        for (pixel, value) in out.iter_mut().enumerate() {
            let (column, row) = ((pixel % SIDE) as f64, (pixel / SIDE) as f64);
            let [x, y] = self.map(u + column - half, v + row - half)?;
            *value = second.cubic_tap(x as f32, y as f32)?.sample(&second.data);
        }
        normalized(&out)
    }
}

/// The patches around a landmark; `None` where they do not show the same.
fn patch_pair(
    warp: Warp<'_>,
    [first, second]: [&Image<f32>; 2],
    photographs: [usize; 2],
) -> Option<PatchPair> {
    let [column, row] = warp.centre.map(|at| at as usize);
    let half = SIDE / 2;
    let is_inside = column >= half && row >= half;
    if !is_inside || column + half > first.width || row + half > first.height {
        return None;
    }
    let here: Patch = std::array::from_fn(|pixel| {
        let (u, v) = (column + pixel % SIDE - half, row + pixel / SIDE - half);
        first.data[v * first.width + u]
    });
    let here = normalized(&here)?;
    let (warp, there) = best_plane(warp, &here, second)?;
    let second_from_first = inverse_transpose(&warp.jacobian()?)?;
    let (here, there) = (powers(&here), powers(&there));
    Some(PatchPair {
        photographs,
        scale: warp.scale as f32,
        second_from_first,
        log_ratios: std::array::from_fn(|f| ((here[f] + NOISE) / (there[f] + NOISE)).ln()),
        sums: std::array::from_fn(|f| here[f] + there[f]),
    })
}

/// The plane through the landmark with which patches correlate best, and the patch of the second
/// photograph; `None` where none does.
fn best_plane<'a>(
    mut warp: Warp<'a>,
    here: &Patch,
    second: &Image<f32>,
) -> Option<(Warp<'a>, Patch)> {
    let mut there = warp.patch(second)?;
    let mut best = correlation(here, &there);
    for change in SLOPE_CHANGES {
        let around = warp.slopes;
        for (across, down) in (0..9).map(|i| (i % 3, i / 3)).filter(|at| *at != (1, 1)) {
            let moved = |slope: f64, step: i32| slope + change * f64::from(step - 1);
            let slopes = [moved(around[0], across), moved(around[1], down)];
            let tried = Warp { slopes, ..warp };
            let Some(patch) = tried.patch(second) else { continue };
            let found = correlation(here, &patch);
            if found > best {
                (best, there, warp) = (found, patch, tried);
            }
        }
    }
    (best >= MIN_CORRELATION).then_some((warp, there))
}

fn correlation(a: &Patch, b: &Patch) -> f32 {
    let product = |a: &Patch, b: &Patch| a.iter().zip(b).map(|(x, y)| x * y).sum::<f32>();
    product(a, b) / (product(a, a) * product(b, b)).sqrt()
}

/// Inverse of the transposed Jacobian, which maps frequencies; `None` where one picture shows the patch more
/// than [`MAX_STRETCH`] times larger.
fn inverse_transpose(&[[a, b], [c, d]]: &[[f32; 2]; 2]) -> Option<[[f32; 2]; 2]> {
    let determinant = a * d - b * c;
    let (sum, product) = (a * a + b * b + c * c + d * d, determinant.abs());
    // Of singular values s and t, s² + t² is the sum of squares, and s t the determinant.
    let largest = (0.5 * (sum + (sum * sum - 4.0 * product * product).max(0.0).sqrt())).sqrt();
    let is_alike = largest < MAX_STRETCH && product / largest > MAX_STRETCH.recip();
    is_alike.then(|| [[d, -c], [-b, a]].map(|row| row.map(|value| value / determinant)))
}

/// A patch divided by its mean, less one, under the window; `None` where it is dark, clipped or plain.
fn normalized(patch: &Patch) -> Option<Patch> {
    let mean = patch.iter().sum::<f32>() / PIXELS as f32;
    let clipped = patch.iter().filter(|value| **value > CLIPPED).count() as f32;
    if mean < MIN_BRIGHTNESS || clipped > MAX_CLIPPED_SHARE * PIXELS as f32 {
        return None;
    }
    let out: Patch = std::array::from_fn(|i| (patch[i] / mean - 1.0) * WINDOW[i]);
    let contrast = out.iter().map(|value| value * value).sum::<f32>() / PIXELS as f32;
    (contrast > MIN_CONTRAST).then_some(out)
}

/// Power of a patch at the compared frequencies, per pixel.
fn powers(patch: &Patch) -> [f32; FREQUENCIES] {
    const COLUMNS: usize = MAX_PERIODS as usize + 1;
    let turn =
        |periods: i32, at: usize| TURN[(periods * at as i32).rem_euclid(SIDE as i32) as usize];
    let mut rows = [[[0.0_f32; 2]; COLUMNS]; SIDE];
    for (row, sums) in rows.iter_mut().enumerate() {
        for (periods, sum) in sums.iter_mut().enumerate() {
            for column in 0..SIDE {
                let [cos, sin] = turn(periods as i32, column);
                let value = patch[row * SIDE + column];
                *sum = [sum[0] + value * cos, sum[1] - value * sin];
            }
        }
    }
    PERIODS.map(|[across, down]| {
        let mut sum = [0.0; 2];
        for (row, sums) in rows.iter().enumerate() {
            let ([re, im], [cos, sin]) = (sums[across as usize], turn(down, row));
            sum = [sum[0] + re * cos + im * sin, sum[1] + im * cos - re * sin];
        }
        (sum[0] * sum[0] + sum[1] * sum[1]) / PIXELS as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_has_its_power_at_its_frequency() {
        for (number, [x, y]) in PERIODS.iter().enumerate() {
            let wave: Patch = std::array::from_fn(|i| {
                let phase = x * (i % SIDE) as i32 + y * (i / SIDE) as i32;
                (TAU * phase as f32 / SIDE as f32 + 0.3).cos()
            });
            let found = powers(&wave);
            let expected = 0.25 * PIXELS as f32;
            for (other, power) in found.iter().enumerate() {
                let wanted = if other == number { expected } else { 0.0 };
                assert!((power - wanted).abs() < 1e-3, "{number} {other} {power}");
            }
        }
        let last = PERIODS[FREQUENCIES - 1];
        assert_eq!(last, [MAX_PERIODS, 0]);
    }

    #[test]
    fn frequencies_turn_and_shrink_with_the_picture() {
        // 1.2 times as large in a picture that is turned by 90 degrees: lower by that factor.
        let larger = [[0.0, -1.2], [1.2, 0.0]];
        let matrix = inverse_transpose(&larger).expect("alike");
        for (found, expected) in matrix.iter().flatten().zip([0.0, -1.0 / 1.2, 1.0 / 1.2, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{matrix:?}");
        }
        assert!(inverse_transpose(&[[1.6, 0.0], [0.0, 1.0]]).is_none());
        assert!(inverse_transpose(&[[1.0, 0.0], [0.0, 0.6]]).is_none());
        assert!(inverse_transpose(&[[1.0, 0.0], [0.3, 1.0]]).is_some());
    }
}
