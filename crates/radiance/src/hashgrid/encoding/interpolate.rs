//! Trilinear interpolation of sixteen positions at once, and its slopes.

use super::corners::GROUP;

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

/// Rows as plain slices.
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
