//! Indices and weights of the corners around sixteen positions at once.

use super::Level;

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

/// The entries of a level.
#[inline(always)]
pub(super) fn entries<'a, const F: usize>(table: &'a [f32], level: &Level) -> &'a [[f32; F]] {
    &table.as_chunks::<F>().0[level.first..level.first + level.entries]
}
