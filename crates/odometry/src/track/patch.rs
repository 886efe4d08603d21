//! Patch alignment: inverse-compositional Lucas-Kanade (Baker and Matthews 2004).
//!
//! The picture under the warp is modelled as `I(W(x)) ≈ α T(x) + β + α ∇T(x) · D(x) δ`. For a fixed
//! template `T` the unknowns `(α, β, α δ)` are linear with one constant matrix, so that changes of
//! exposure cost nothing.

use crate::multiview::whitening::mapped_covariance;
use i2slam_compute::{factorize_cholesky, solve_cholesky};
use i2slam_geometry::Image;
use pulp::Arch;

/// Half the side of a patch [px].
pub(crate) const RADIUS: usize = 7;
const SIDE: usize = 2 * RADIUS + 1;
/// Pixels of a patch.
const AREA: usize = SIDE * SIDE;
/// Side of a patch with one more pixel on every side, for central differences.
const WIDE: usize = SIDE + 2;
const MAX_ITERATIONS: usize = 15;
/// Update at which the iteration ends [px].
const MIN_UPDATE: f32 = 0.01;
/// Added to the squared length of the picture's patch, so that flat ones match nothing.
const CONTRAST_FLOOR: f32 = 1e-4;
/// Least share of the picture's variance that a patch counts as explaining.
const MIN_EXPLAINED: f32 = 0.01;

/// Affine warp of a patch into a picture: `x = centre + matrix · offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AffineWarp {
    pub(crate) matrix: [[f32; 2]; 2],
    pub(crate) centre: [f32; 2],
}

impl AffineWarp {
    /// Translation to `centre`.
    pub(crate) fn translation(centre: [f32; 2]) -> Self {
        Self { matrix: [[1.0, 0.0], [0.0, 1.0]], centre }
    }

    /// This warp on a pyramid level whose positions are `scale` times as large.
    pub(crate) fn scaled(self, scale: f32) -> Self {
        Self { centre: self.centre.map(|v| v * scale), ..self }
    }

    /// `self ∘ δ⁻¹` for `δ(x) = (I + m) x + d`.
    fn compose_inverse(self, m: [[f32; 2]; 2], d: [f32; 2]) -> Option<Self> {
        let [[a, b], [c, e]] = [[1.0 + m[0][0], m[0][1]], [m[1][0], 1.0 + m[1][1]]];
        let determinant = a * e - b * c;
        if !(0.25..4.0).contains(&determinant) {
            return None;
        }
        let inverse = [[e / determinant, -b / determinant], [-c / determinant, a / determinant]];
        let w = self.matrix;
        let row = |r: [f32; 2], k: usize| r[0] * inverse[0][k] + r[1] * inverse[1][k];
        let matrix = w.map(|r| [row(r, 0), row(r, 1)]);
        let move_by = |r: [f32; 2]| r[0] * d[0] + r[1] * d[1];
        let centre = [self.centre[0] - move_by(matrix[0]), self.centre[1] - move_by(matrix[1])];
        Some(Self { matrix, centre })
    }
}

/// A patch prepared for alignment. `N` is the number of unknowns: 4 (gain, bias, translation) or 8
/// (gain, bias, affine warp).
#[derive(Clone, Debug)]
pub(crate) struct PatchTemplate<const N: usize> {
    /// Row `k`: `α`, `β`, then the derivatives by the warp.
    basis: Vec<[f32; AREA]>,
    inverse: [[f32; N]; N],
    /// Length of the patch without its mean.
    norm: f32,
}

/// Result of an alignment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchMatch {
    pub(crate) warp: AffineWarp,
    /// Correlation of patch and picture, at most 1.
    pub(crate) correlation: f32,
    /// Covariance of the centre, `xx`, `xy`, `yy` [px²], if what the patch does not explain is noise that is
    /// independent from pixel to pixel.
    pub(crate) covariance: [f64; 3],
}

impl<const N: usize> PatchTemplate<N> {
    /// The patch around `centre`; `None` without texture to align.
    pub(crate) fn new(image: &Image<f32>, centre: [f32; 2]) -> Option<Self> {
        Arch::new().dispatch(|| Self::prepare(image, centre))
    }

    #[inline(always)]
    fn prepare(image: &Image<f32>, centre: [f32; 2]) -> Option<Self> {
        let wide = sample_patch::<WIDE>(image, &AffineWarp::translation(centre));
        let at = |i: usize, dx: usize, dy: usize| wide[i / SIDE + dy][i % SIDE + dx];
        let values: [f32; AREA] = std::array::from_fn(|i| at(i, 1, 1));
        let gx: [f32; AREA] = std::array::from_fn(|i| 0.5 * (at(i, 2, 1) - at(i, 0, 1)));
        let gy: [f32; AREA] = std::array::from_fn(|i| 0.5 * (at(i, 1, 2) - at(i, 1, 0)));
        let mean = values.iter().sum::<f32>() / AREA as f32;
        let values = values.map(|v| v - mean);
        let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        let x = |i: usize| (i % SIDE) as f32 - RADIUS as f32;
        let y = |i: usize| (i / SIDE) as f32 - RADIUS as f32;
        let mut basis = vec![values, [1.0; AREA], gx, gy];
        if N == 8 {
            basis.push(std::array::from_fn(|i| x(i) * gx[i]));
            basis.push(std::array::from_fn(|i| y(i) * gx[i]));
            basis.push(std::array::from_fn(|i| x(i) * gy[i]));
            basis.push(std::array::from_fn(|i| y(i) * gy[i]));
        }
        let inverse = inverse_normal_matrix(&basis)?;
        (norm > 1e-3).then_some(Self { basis, inverse, norm })
    }

    /// Aligns the patch with `image` from `start` on; `None` if the iteration diverges.
    pub(crate) fn align(&self, image: &Image<f32>, start: AffineWarp) -> Option<PatchMatch> {
        Arch::new().dispatch(|| self.iterate(image, start))
    }

    #[inline(always)]
    fn iterate(&self, image: &Image<f32>, start: AffineWarp) -> Option<PatchMatch> {
        let mut warp = start;
        let mut correlation = 0.0;
        for _ in 0..MAX_ITERATIONS {
            let rows = sample_patch::<SIDE>(image, &warp);
            let values: [f32; AREA] = std::array::from_fn(|i| rows[i / SIDE][i % SIDE]);
            let products: [f32; N] = std::array::from_fn(|k| dot(&self.basis[k], &values));
            correlation = self.correlation(&products, &values);
            let x: [f32; N] =
                std::array::from_fn(|k| (0..N).map(|m| self.inverse[k][m] * products[m]).sum());
            let gain = x[0];
            if !(gain.is_finite() && gain > 0.05) {
                return None;
            }
            let d = [x[2] / gain, x[3] / gain];
            let m = if N == 8 {
                [[x[4] / gain, x[5] / gain], [x[6] / gain, x[7] / gain]]
            } else {
                [[0.0; 2]; 2]
            };
            warp = warp.compose_inverse(m, d)?;
            if !is_inside(image, warp.centre) {
                return None;
            }
            if d[0].hypot(d[1]) < MIN_UPDATE {
                break;
            }
        }
        Some(PatchMatch { warp, correlation, covariance: self.covariance(&warp, correlation) })
    }

    /// Covariance of a centre that was found with a correlation: `σ² W N⁻¹ Wᵀ`, with the block `N⁻¹` of the
    /// translation, the matrix `W` of the warp, and `σ² = (1/ρ² - 1) ‖T‖² / (pixels - unknowns)`, which is the
    /// variance of what least squares leave in units of the patch.
    #[inline(always)]
    pub(crate) fn covariance(&self, warp: &AffineWarp, correlation: f32) -> [f64; 3] {
        let unexplained = (correlation * correlation).max(MIN_EXPLAINED).recip() - 1.0;
        let variance = unexplained.max(0.0) * self.norm * self.norm / (AREA - N) as f32;
        let translation =
            [(2, 2), (2, 3), (3, 3)].map(|(r, c)| f64::from(variance * self.inverse[r][c]));
        mapped_covariance(translation, warp.matrix)
    }

    #[inline(always)]
    fn correlation(&self, products: &[f32; N], values: &[f32; AREA]) -> f32 {
        let squares = dot(values, values) - products[1] * products[1] / AREA as f32;
        products[0] / (self.norm * (squares.max(0.0) + CONTRAST_FLOOR).sqrt())
    }
}

/// Inverse of the matrix of inner products, each basis vector scaled to length 1 while inverting.
#[inline(always)]
fn inverse_normal_matrix<const N: usize>(basis: &[[f32; AREA]]) -> Option<[[f32; N]; N]> {
    let lengths: [f64; N] = std::array::from_fn(|k| f64::from(dot(&basis[k], &basis[k])).sqrt());
    if lengths.iter().any(|l| *l < 1e-4) {
        return None;
    }
    let mut products = vec![0.0; N * N];
    for r in 0..N {
        for c in 0..=r {
            let ridge = if r == c { 1e-4 } else { 0.0 };
            let product = f64::from(dot(&basis[r], &basis[c]));
            products[r * N + c] = product / (lengths[r] * lengths[c]) + ridge;
        }
    }
    if !factorize_cholesky(&mut products, N) {
        return None;
    }
    let mut out = [[0.0; N]; N];
    for column in 0..N {
        let mut unit = [0.0; N];
        unit[column] = 1.0;
        solve_cholesky(&products, &mut unit);
        for row in 0..N {
            out[row][column] = (unit[row] / (lengths[row] * lengths[column])) as f32;
        }
    }
    Some(out)
}

/// Inner product in eight partial sums, so that it compiles to vector instructions.
#[inline(always)]
pub(crate) fn dot<const N: usize>(a: &[f32; N], b: &[f32; N]) -> f32 {
    let mut lanes = [0.0_f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for i in 0..8 {
            lanes[i] += a[i] * b[i];
        }
    }
    let rest: f32 = (N / 8 * 8..N).map(|i| a[i] * b[i]).sum();
    lanes.iter().sum::<f32>() + rest
}

fn is_inside(image: &Image<f32>, at: [f32; 2]) -> bool {
    at[0] >= 0.0 && at[1] >= 0.0 && at[0] < image.width as f32 && at[1] < image.height as f32
}

/// The picture under a warp, `S x S` rows and columns, its border repeated.
#[inline(always)]
fn sample_patch<const S: usize>(image: &Image<f32>, warp: &AffineWarp) -> [[f32; S]; S] {
    let half = (S / 2) as f32;
    let first = warp.centre.map(|v| v - half - 0.5);
    let most = [image.width, image.height].map(|n| n as f32 - 1.001);
    let fits = |k: usize| first[k] >= 0.0 && first[k] + 2.0 * half <= most[k];
    if warp.matrix == [[1.0, 0.0], [0.0, 1.0]] && fits(0) && fits(1) {
        return sample_translated(image, first);
    }
    std::array::from_fn(|row| sample_row(image, warp, row as f32 - half, most))
}

/// A row of [`sample_patch`], its steps apart so that all but the reading of pixels compile to
/// vector instructions.
#[inline(always)]
fn sample_row<const S: usize>(
    image: &Image<f32>,
    warp: &AffineWarp,
    dy: f32,
    most: [f32; 2],
) -> [f32; S] {
    let [[a, b], [c, d]] = warp.matrix;
    let dx = |column: usize| column as f32 - (S / 2) as f32;
    let x: [f32; S] =
        std::array::from_fn(|i| (warp.centre[0] + a * dx(i) + b * dy - 0.5).clamp(0.0, most[0]));
    let y: [f32; S] =
        std::array::from_fn(|i| (warp.centre[1] + c * dx(i) + d * dy - 0.5).clamp(0.0, most[1]));
    let (columns, rows) = (x.map(|x| x as i32), y.map(|y| y as i32));
    let u: [f32; S] = std::array::from_fn(|i| x[i] - columns[i] as f32);
    let v: [f32; S] = std::array::from_fn(|i| y[i] - rows[i] as f32);
    let mut corners = [[0.0; S]; 4];
    for i in 0..S {
        let first = rows[i] as usize * image.width + columns[i] as usize;
        let pixels = &image.data[first..first + image.width + 2];
        corners[0][i] = pixels[0];
        corners[1][i] = pixels[1];
        corners[2][i] = pixels[image.width];
        corners[3][i] = pixels[image.width + 1];
    }
    std::array::from_fn(|i| {
        let top = corners[0][i] + (corners[1][i] - corners[0][i]) * u[i];
        let bottom = corners[2][i] + (corners[3][i] - corners[2][i]) * u[i];
        top + (bottom - top) * v[i]
    })
}

/// [`sample_patch`] for a translation inside the picture: all pixels share their weights.
#[inline(always)]
fn sample_translated<const S: usize>(image: &Image<f32>, first: [f32; 2]) -> [[f32; S]; S] {
    let (column, row) = (first[0] as usize, first[1] as usize);
    let (u, v) = (first[0] - column as f32, first[1] - row as f32);
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    std::array::from_fn(|r| {
        let k = (row + r) * image.width + column;
        let (upper, lower) = (&image.data[k..=k + S], &image.data[k + image.width..][..=S]);
        std::array::from_fn(|c| {
            weights[0] * upper[c]
                + weights[1] * upper[c + 1]
                + weights[2] * lower[c]
                + weights[3] * lower[c + 1]
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth picture, drawn at `map` of every pixel centre.
    fn waves(map: impl Fn(f32, f32) -> (f32, f32), gain: f32, bias: f32) -> Image<f32> {
        Image::from_fn(64, 48, 1, |_, column, row| {
            let (x, y) = map(column as f32 + 0.5, row as f32 + 0.5);
            let value = 0.5 + 0.2 * (0.35 * x + 0.1 * y).sin() + 0.2 * (0.28 * y - 0.07 * x).cos();
            gain * value + bias
        })
    }

    /// The patch of the unmoved picture at (30, 24), aligned from there with another picture.
    fn aligned<const N: usize>(image: &Image<f32>) -> PatchMatch {
        let still = waves(|x, y| (x, y), 1.0, 0.0);
        let template = PatchTemplate::<N>::new(&still, [30.0, 24.0]).expect("textured");
        template.align(image, AffineWarp::translation([30.0, 24.0])).expect("found")
    }

    #[test]
    fn a_move_is_found_through_a_change_of_exposure() {
        let found = aligned::<4>(&waves(|x, y| (x - 1.7, y + 1.2), 0.4, 0.2));
        assert!((found.warp.centre[0] - 31.7).abs() < 0.02, "{found:?}");
        assert!((found.warp.centre[1] - 22.8).abs() < 0.02, "{found:?}");
        assert!(found.correlation > 0.995);
    }

    /// Positions found through noise scatter as their covariance says, along edges more than across.
    #[test]
    fn the_covariance_is_that_of_positions_found_through_noise() {
        let stripes = Image::from_fn(64, 48, 1, |_, column, row| {
            let (x, y) = (column as f32, row as f32);
            0.5 + 0.2 * (0.45 * (x + y)).sin() + 0.05 * (0.4 * (x - y)).sin()
        });
        let template = PatchTemplate::<8>::new(&stripes, [30.5, 24.5]).expect("textured");
        let (mut scatter, mut claimed) = ([0.0_f64; 3], [0.0_f64; 3]);
        for seed in 0..400 {
            let mut noisy = stripes.clone();
            let noise = i2slam_check::noise(seed, noisy.data.len());
            noisy.data.iter_mut().zip(noise).for_each(|(v, n)| *v += 0.02 * n as f32);
            let found = template.align(&noisy, AffineWarp::translation([30.5, 24.5]));
            let PatchMatch { warp, covariance, .. } = found.expect("found");
            let [x, y] = [warp.centre[0] - 30.5, warp.centre[1] - 24.5].map(f64::from);
            [x * x, x * y, y * y].into_iter().enumerate().for_each(|(i, v)| scatter[i] += v);
            (0..3).for_each(|i| claimed[i] += covariance[i]);
        }
        // Along the stripes, and across.
        for sign in [-1.0, 1.0] {
            let [seen, said] = [scatter, claimed].map(|[xx, xy, yy]| xx + yy + sign * 2.0 * xy);
            assert!((0.7..1.4).contains(&(seen / said)), "{sign}: {}", seen / said);
        }
        assert!(-claimed[1] > 0.5 * claimed[0], "{claimed:?}");
    }

    #[test]
    fn a_turned_patch_is_found() {
        let (s, c) = 0.12_f32.sin_cos();
        let turn = |x: f32, y: f32| {
            let (x, y) = (x - 31.0, y - 23.5);
            (c * x + s * y + 30.0, c * y - s * x + 24.0)
        };
        let found = aligned::<8>(&waves(turn, 1.3, -0.1));
        assert!((found.warp.centre[0] - 31.0).abs() < 0.05, "{found:?}");
        assert!((found.warp.centre[1] - 23.5).abs() < 0.05, "{found:?}");
        assert!((found.warp.matrix[0][1] + s).abs() < 0.02, "{found:?}");
    }

    #[test]
    fn a_flat_patch_is_no_template() {
        assert!(PatchTemplate::<4>::new(&Image::new(64, 48, 1), [30.0, 24.0]).is_none());
    }
}
