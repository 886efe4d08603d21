//! Real spherical harmonics up to degree 3 (four bands, 16 functions), orthonormal on the unit
//! sphere, as polynomials of the direction.

use i2slam_geometry::Real;

/// Number of functions.
pub(crate) const HARMONICS: usize = 16;

const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 4] =
    [1.092_548_430_592_079_2, 0.946_174_695_757_56, 0.315_391_565_252_52, 0.546_274_215_296_039_6];
const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_7,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

pub(crate) fn harmonics<T: Real>([x, y, z]: [T; 3]) -> [T; HARMONICS] {
    let k = T::of;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        k(C0),
        -k(C1) * y,
        k(C1) * z,
        -k(C1) * x,
        k(C2[0]) * x * y,
        -k(C2[0]) * y * z,
        k(C2[1]) * zz - k(C2[2]),
        -k(C2[0]) * x * z,
        k(C2[3]) * (xx - yy),
        k(C3[0]) * y * (yy - k(3.0) * xx),
        k(C3[1]) * x * y * z,
        k(C3[2]) * y * (k(1.0) - k(5.0) * zz),
        k(C3[3]) * z * (k(5.0) * zz - k(3.0)),
        k(C3[2]) * x * (k(1.0) - k(5.0) * zz),
        k(C3[4]) * z * (xx - yy),
        k(C3[0]) * x * (k(3.0) * yy - xx),
    ]
}

/// `∂L/∂n` of the polynomials, given `∂L/∂harmonics`. Not yet projected to the sphere's tangent.
pub(crate) fn pull_back<T: Real>([x, y, z]: [T; 3], d: &[T; HARMONICS]) -> [T; 3] {
    let k = T::of;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (two, three, six, ten) = (k(2.0), k(3.0), k(6.0), k(10.0));
    let polar = k(1.0) - k(5.0) * zz;
    let dx = k(C2[0]) * (y * d[4] - z * d[7]) - k(C1) * d[3]
        + k(C2[3]) * two * x * d[8]
        + k(C3[0]) * (three * (yy - xx) * d[15] - six * x * y * d[9])
        + k(C3[1]) * y * z * d[10]
        + k(C3[2]) * polar * d[13]
        + k(C3[4]) * two * x * z * d[14];
    let dy = k(C2[0]) * (x * d[4] - z * d[5]) - k(C1) * d[1] - k(C2[3]) * two * y * d[8]
        + k(C3[0]) * (three * (yy - xx) * d[9] + six * x * y * d[15])
        + k(C3[1]) * x * z * d[10]
        + k(C3[2]) * polar * d[11]
        - k(C3[4]) * two * y * z * d[14];
    let dz = k(C1) * d[2] - k(C2[0]) * (y * d[5] + x * d[7])
        + k(C2[1]) * two * z * d[6]
        + k(C3[1]) * x * y * d[10]
        - k(C3[2]) * ten * z * (y * d[11] + x * d[13])
        + k(C3[3]) * (k(15.0) * zz - three) * d[12]
        + k(C3[4]) * (xx - yy) * d[14];
    [dx, dy, dz]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_agrees_with_central_differences() {
        let (n, d) = ([0.48, -0.6, 0.64], i2slam_check::noise(3, HARMONICS));
        let cotangent: [f64; HARMONICS] = std::array::from_fn(|i| d[i]);
        let gradient = pull_back(n, &cotangent);
        i2slam_check::assert_gradient("harmonics", &n, &gradient, 1e-3, 1e-9, |n| {
            harmonics([n[0], n[1], n[2]]).iter().zip(&d).map(|(a, b)| a * b).sum()
        });
    }

    /// Integrals of products over the sphere, by a product rule in `cos θ` and `φ`.
    #[test]
    fn functions_are_orthonormal() {
        let (rows, columns) = (400, 32);
        let mut gram = [[0.0_f64; HARMONICS]; HARMONICS];
        for (i, j) in (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j))) {
            let z = 2.0 * (f64::from(i) + 0.5) / f64::from(rows) - 1.0;
            let phi = std::f64::consts::TAU * f64::from(j) / f64::from(columns);
            let r = (1.0 - z * z).sqrt();
            let h = harmonics([r * phi.cos(), r * phi.sin(), z]);
            let area = 2.0 * std::f64::consts::TAU / f64::from(rows * columns);
            for a in 0..HARMONICS {
                (0..HARMONICS).for_each(|b| gram[a][b] += area * h[a] * h[b]);
            }
        }
        for a in 0..HARMONICS {
            for b in 0..HARMONICS {
                let expected = if a == b { 1.0 } else { 0.0 };
                assert!((gram[a][b] - expected).abs() < 1e-3, "{a} {b}: {}", gram[a][b]);
            }
        }
    }
}
