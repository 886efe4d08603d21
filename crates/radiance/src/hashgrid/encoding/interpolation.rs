//! Trilinear interpolation of sixteen positions at once, and its slopes.

use super::Level;

/// `F` numbers of each of sixteen positions.
pub(super) type Rows<const F: usize> = [[f32; F]; GROUP];

/// Every number `F` times.
#[inline(always)]
pub(super) fn spread<const F: usize>(fraction: &[[f32; GROUP]; 3]) -> [Rows<F>; 3] {
    let mut out = [[[0.0; F]; GROUP]; 3];
    for k in 0..3 {
        for i in 0..GROUP {
            out[k][i] = [fraction[k][i]; F];
        }
    }
    out
}

/// The entries of each corner.
#[inline(always)]
pub(super) fn gather<const F: usize>(
    entries: &[[f32; F]],
    index: &[[u32; GROUP]; 8],
) -> [Rows<F>; 8] {
    let mut values = [[[0.0; F]; GROUP]; 8];
    for i in 0..GROUP {
        for c in 0..8 {
            values[c][i] = entries[index[c][i] as usize];
        }
    }
    values
}

/// The values between the corners.
#[inline(always)]
pub(super) fn interpolate<const F: usize>(
    fraction: &[Rows<F>; 3],
    values: &[Rows<F>; 8],
) -> Rows<F> {
    let mut out = [[0.0; F]; GROUP];
    let [x, y, z] = flat(fraction);
    let v = flat(values);
    for (j, out) in out.as_flattened_mut().iter_mut().enumerate() {
        let (a, b) = (lerp(v[0][j], v[1][j], x[j]), lerp(v[2][j], v[3][j], x[j]));
        let (c, d) = (lerp(v[4][j], v[5][j], x[j]), lerp(v[6][j], v[7][j], x[j]));
        *out = lerp(lerp(a, b, y[j]), lerp(c, d, y[j]), z[j]);
    }
    out
}

/// The slopes of the values between the corners, along x, y and z.
#[inline(always)]
pub(super) fn slopes_of<const F: usize>(
    scale: f32,
    fraction: &[Rows<F>; 3],
    values: &[Rows<F>; 8],
) -> [Rows<F>; 3] {
    let mut out = [[[0.0; F]; GROUP]; 3];
    let [x, y, z] = flat(fraction);
    let v = flat(values);
    let [by_x, by_y, by_z] = &mut out;
    let (by_x, by_y) = (by_x.as_flattened_mut(), by_y.as_flattened_mut());
    let by_z = by_z.as_flattened_mut();
    for j in 0..GROUP * F {
        let (dx00, dx10) = (v[1][j] - v[0][j], v[3][j] - v[2][j]);
        let (dx01, dx11) = (v[5][j] - v[4][j], v[7][j] - v[6][j]);
        by_x[j] = scale * lerp(lerp(dx00, dx10, y[j]), lerp(dx01, dx11, y[j]), z[j]);
        let (a, b) = (v[0][j] + x[j] * dx00, v[2][j] + x[j] * dx10);
        let (c, d) = (v[4][j] + x[j] * dx01, v[6][j] + x[j] * dx11);
        by_y[j] = scale * lerp(b - a, d - c, z[j]);
        by_z[j] = scale * lerp(c - a, d - b, y[j]);
    }
    out
}

#[inline(always)]
fn flat<const F: usize, const N: usize>(rows: &[Rows<F>; N]) -> [&[f32]; N] {
    let mut out = [rows[0].as_flattened(); N];
    for n in 0..N {
        out[n] = rows[n].as_flattened();
    }
    out
}

#[inline(always)]
fn lerp(a: f32, b: f32, u: f32) -> f32 {
    a + u * (b - a)
}

/// Positions of a group.
pub(super) const GROUP: usize = 16;

/// Added to a float under 2²³ it leaves its nearest integer in the low bits.
const ROUND: f32 = 8_388_608.0;

/// The eight corners around sixteen positions.
pub(super) struct Corners {
    pub(super) index: [[u32; GROUP]; 8],
    pub(super) fraction: [[f32; GROUP]; 3],
}

impl Corners {
    /// `⌊x s + ½⌋` is taken as the nearest integer of `x s`: where both differ, at ties, the
    /// fraction is 1 instead of 0, and the interpolated value is the same.
    #[inline(always)]
    pub(super) fn new(level: &Level, axes: &[[f32; GROUP]; 3]) -> Self {
        let (mut low, mut high) = ([[0_u32; GROUP]; 3], [[0_u32; GROUP]; 3]);
        let mut fraction = [[0.0; GROUP]; 3];
        let scale = level.scale as f32;
        for k in 0..3 {
            let factor = level.factors[k];
            for i in 0..GROUP {
                let p = axes[k][i] * scale;
                let shifted = p + ROUND;
                let node = shifted.to_bits() & 0x007f_ffff;
                fraction[k][i] = p - (shifted - ROUND) + 0.5;
                low[k][i] = node.wrapping_mul(factor);
                high[k][i] = low[k][i].wrapping_add(factor);
            }
        }
        let mut index = [[0; GROUP]; 8];
        let mask = (level.entries - 1) as u32;
        for c in 0..8 {
            let [x, y, z] = [
                if c & 1 == 0 { &low[0] } else { &high[0] },
                if c & 2 == 0 { &low[1] } else { &high[1] },
                if c & 4 == 0 { &low[2] } else { &high[2] },
            ];
            if level.hashed {
                for i in 0..GROUP {
                    index[c][i] = (x[i] ^ y[i] ^ z[i]) & mask;
                }
            } else {
                for i in 0..GROUP {
                    index[c][i] = x[i].wrapping_add(y[i]).wrapping_add(z[i]);
                }
            }
        }
        Self { index, fraction }
    }

    /// `Π_k (c_k ? f_k : 1 - f_k)` of each corner.
    #[inline(always)]
    pub(super) fn weights(&self) -> [[f32; GROUP]; 8] {
        let [x, y, z] = &self.fraction;
        let mut weights = [[0.0; GROUP]; 8];
        for i in 0..GROUP {
            let (x1, y1, z1) = (x[i], y[i], z[i]);
            let (x0, y0, z0) = (1.0 - x1, 1.0 - y1, 1.0 - z1);
            let (a, b, c, d) = (y0 * z0, y1 * z0, y0 * z1, y1 * z1);
            let all = [x0 * a, x1 * a, x0 * b, x1 * b, x0 * c, x1 * c, x0 * d, x1 * d];
            for c in 0..8 {
                weights[c][i] = all[c];
            }
        }
        weights
    }
}

/// Sixteen positions, one row per axis.
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "NaN must give an index within the table")]
pub(super) fn axes(positions: &[[f32; 3]]) -> [[f32; GROUP]; 3] {
    let mut axes = [[0.0; GROUP]; 3];
    for (i, x) in positions.iter().enumerate().take(GROUP) {
        for k in 0..3 {
            axes[k][i] = x[k].max(0.0).min(1.0);
        }
    }
    axes
}

#[inline(always)]
pub(super) fn entries<'a, const F: usize>(table: &'a [f32], level: &Level) -> &'a [[f32; F]] {
    &table.as_chunks::<F>().0[level.first..level.first + level.entries]
}
