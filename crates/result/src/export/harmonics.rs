//! Real spherical harmonics up to degree 2, as viewers of 3D Gaussian splatting add them up.

use super::splat::Display;
use i2slam::geometry::{Rotation, Vec3};
use i2slam::radiance::gaussian::{ColourActivation, Cone, ViewColour};
use i2slam_compute::NormalEquations;
use std::f64::consts::PI;

/// Harmonics of degree 0 to 2.
pub(crate) const COUNT: usize = 9;
/// Rings of directions in a cone, as shares of its width, and directions on each.
const RINGS: ([f64; 2], usize) = ([0.5, 1.0], 8);
/// Directions over the whole sphere, and the weight of each beside 1 in the cone.
const SPHERE: (usize, f64) = (32, 0.02);

/// The harmonics at a unit vector from the camera to the Gaussian, with the signs of Kerbl et al.
pub(crate) fn basis(d: Vec3<f64>) -> [f64; COUNT] {
    let Vec3 { x, y, z } = d;
    [
        0.282_094_791_773_878,
        -0.488_602_511_902_92 * y,
        0.488_602_511_902_92 * z,
        -0.488_602_511_902_92 * x,
        1.092_548_430_592_08 * x * y,
        -1.092_548_430_592_08 * y * z,
        0.315_391_565_252_52 * (2.0 * z * z - x * x - y * y),
        -1.092_548_430_592_08 * x * z,
        0.546_274_215_296_04 * (x * x - y * y),
    ]
}

/// Coefficients whose sum is `colour - 0.5` in the least-squares sense, over the directions that
/// were seen and, weakly, over all others, so that it stays tame there. `turn` rotates the world.
pub(crate) fn fit(
    colour: [f32; 3],
    view: ViewColour<'_, f32>,
    (display, activation): (&Display, ColourActivation),
    turn: Rotation<f64>,
) -> [[f32; 3]; COUNT] {
    let mut equations: [NormalEquations<COUNT>; 3] = Default::default();
    let weighted = cone_directions(&view.cone).map(|d| (d, 1.0));
    for (d, weight) in weighted.chain(sphere_directions().map(|d| (d, SPHERE.1))) {
        let deviation = view.deviation(d.to_array().map(|v| v as f32), [0.0; 3]);
        let seen = std::array::from_fn(|c| colour[c] + deviation[c]);
        let value = display.colour(activation.radiance(seen));
        let terms = basis(turn.rotate(d));
        for (equations, value) in equations.iter_mut().zip(value) {
            equations.add(&terms, 0.5 - f64::from(value), weight);
        }
    }
    let solved = equations.map(|e| e.step(0.0).unwrap_or([0.0; COUNT]));
    std::array::from_fn(|k| std::array::from_fn(|c| solved[c][k] as f32))
}

/// Directions in a cone: its axis and rings about it.
fn cone_directions(cone: &Cone<f32>) -> impl Iterator<Item = Vec3<f64>> {
    let [w, x, y, z] = cone.rotation.map(f64::from);
    let (rotation, spread) = (Rotation { w, v: Vec3::new(x, y, z) }, f64::from(cone.spread));
    let on_ring = move |share: f64, k: usize| {
        let (sine, angle) = ((share * spread).min(1.0), 2.0 * PI * k as f64 / RINGS.1 as f64);
        let d = Vec3::new(sine * angle.cos(), sine * angle.sin(), (1.0 - sine * sine).sqrt());
        rotation.rotate(d)
    };
    let rings = RINGS.0.into_iter().flat_map(move |share| (0..RINGS.1).map(move |k| (share, k)));
    std::iter::once((0.0, 0)).chain(rings).map(move |(share, k)| on_ring(share, k))
}

/// Directions that fill the sphere evenly (a Fibonacci lattice).
fn sphere_directions() -> impl Iterator<Item = Vec3<f64>> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    (0..SPHERE.0).map(move |k| {
        let z = 1.0 - (2 * k + 1) as f64 / SPHERE.0 as f64;
        let (radius, angle) = ((1.0 - z * z).sqrt(), golden * k as f64);
        Vec3::new(radius * angle.cos(), radius * angle.sin(), z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// A viewer shows the colours of the map from the directions that were seen, in a turned
    /// world too: narrow cones come out flatter, so that colours stay tame elsewhere.
    #[test]
    fn harmonics_follow_the_view_colour_within_its_cone() {
        let axis = Rotation::exp(Vec3::new(0.4, -0.9, 0.3));
        let turn = Rotation::exp(Vec3::new(-0.2, 1.3, 0.5));
        let rotation = [axis.w, axis.v.x, axis.v.y, axis.v.z].map(|v| v as f32);
        let colour = [-1.2_f32, -0.7, -2.0];
        for (seed, spread, share) in [(1, 0.1, 0.5), (2, 0.3, 0.2), (3, 0.8, 0.2)] {
            let n: Vec<f32> = noise(seed, 6).iter().map(|v| *v as f32).collect();
            let coefficients = [[n[0], n[1], n[2]], [n[3], n[4], n[5]]];
            let view = ViewColour { cone: Cone { rotation, spread }, coefficients: &coefficients };
            let kind = (&Display::Linear, ColourActivation::Exponential);
            let fitted = fit(colour, view, kind, turn);
            let (mut change, mut error) = (0.0_f64, 0.0_f64);
            for d in cone_directions(&view.cone) {
                let deviation = view.deviation(d.to_array().map(|v| v as f32), [0.0; 3]);
                let terms = basis(turn.rotate(d));
                for c in 0..3 {
                    let due = f64::from((colour[c] + deviation[c]).exp());
                    let shown =
                        0.5 + (0..COUNT).map(|k| terms[k] * f64::from(fitted[k][c])).sum::<f64>();
                    change = change.max((due - f64::from(colour[c].exp())).abs());
                    error = error.max((due - shown).abs());
                }
            }
            assert!(change > 0.05 && error < share * change, "{spread}: {error:.3} of {change:.3}");
            for d in sphere_directions() {
                let shown = (0..COUNT).map(|k| basis(d)[k] * f64::from(fitted[k][1])).sum::<f64>();
                let due = f64::from(colour[1].exp());
                assert!((0.5 + shown - due).abs() < 0.75, "{spread} {d:?}: {shown}");
            }
        }
    }

    #[test]
    fn directions_fill_the_sphere() {
        let sum = sphere_directions().fold(Vec3::zero(), |sum, d| sum + d);
        assert!(sum.norm() < 1.0 && sphere_directions().all(|d| (d.norm() - 1.0).abs() < 1e-12));
    }
}
