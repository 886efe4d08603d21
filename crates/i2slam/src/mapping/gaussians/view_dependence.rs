//! Which Gaussians show another colour from each direction.
//!
//! The derivative of the loss by the colour of a Gaussian is due to chance where it looks the same
//! from everywhere. Where it follows the direction of the view instead, the Gaussian gets a view
//! colour on the cone of the directions from which keyframes see it.

use i2slam_geometry::{Mat3, Rotation, Vec3};
use i2slam_radiance::gaussian::{Cone, GaussianMap, MapGradient, TERMS, ViewColours};
use rayon::prelude::*;

/// Keyframes that see a Gaussian, for each term of its polynomial, and two more.
const VIEWS_PER_TERM: usize = 3;
/// Least standard deviation of the directions \[rad\]: between nearer ones gloss hardly changes.
const MIN_DEVIATION: f32 = 0.01;
/// Border of a cone, in standard deviations of the directions.
const BORDER: f32 = 2.0;
/// F statistic of the regression on the direction, two degrees of freedom, from which the colour is
/// taken to depend on it: chance exceeds it once in 20 times to once in 50.
const MIN_F: f32 = 4.0;
/// Added to the variance of directions along each axis, as a share of their sum: cameras often move
/// along a line.
const RIDGE: f32 = 0.01;

/// Sums over the views of a Gaussian.
#[derive(Clone, Copy, Default)]
struct Sums {
    views: usize,
    /// Unit vectors `d` to the Gaussian, and their products: xx, xy, xz, yy, yz, zz.
    direction: [f32; 3],
    products: [f32; 6],
    /// Derivatives `g_c` by the colours, their squares, and their products with `d`.
    derivative: [f32; 3],
    squares: [f32; 3],
    moments: [[f32; 3]; 3],
}

impl Sums {
    fn add(&mut self, d: [f32; 3], g: [f32; 3]) {
        self.views += 1;
        let [x, y, z] = d;
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        self.products.iter_mut().zip(products).for_each(|(sum, v)| *sum += v);
        for k in 0..3 {
            self.direction[k] += d[k];
            self.derivative[k] += g[k];
            self.squares[k] += g[k] * g[k];
            (0..3).for_each(|j| self.moments[k][j] += g[k] * d[j]);
        }
    }

    /// The cone of the directions, if the derivatives depend on where in it the camera is.
    fn dependent_cone(&self) -> Option<Cone<f32>> {
        let n = self.views as f32;
        let mean = Vec3::from_array(self.direction) * n.recip();
        let rotation = shortest_turn(mean * mean.norm().recip());
        let matrix = rotation.matrix();
        let axes = [0, 1].map(|k| Vec3::new(matrix[(0, k)], matrix[(1, k)], matrix[(2, k)]));
        let [a, b, c] = self.covariance(axes, mean);
        let deviation = (0.5 * (a + c)).sqrt();
        let enough = self.views >= VIEWS_PER_TERM * TERMS[1] && deviation >= MIN_DEVIATION;
        if !enough || self.f_statistic(axes, mean, [a, b, c]) < MIN_F {
            return None;
        }
        let v = rotation.v;
        let spread = (BORDER * deviation).min(1.0);
        Some(Cone { rotation: [rotation.w, v.x, v.y, v.z], spread })
    }

    /// Covariance of the directions along two axes: xx, xy, yy.
    fn covariance(&self, [x, y]: [Vec3<f32>; 2], mean: Vec3<f32>) -> [f32; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.products.map(|sum| sum / self.views as f32);
        let second = Mat3 { rows: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] };
        [(x, x), (x, y), (y, y)].map(|(a, b)| a.dot(second * b) - a.dot(mean) * b.dot(mean))
    }

    /// Explained over unexplained variance of the derivatives in their regression on two coordinates
    /// of the direction, each by its degrees of freedom, all channels together.
    fn f_statistic(&self, axes: [Vec3<f32>; 2], mean: Vec3<f32>, [a, b, c]: [f32; 3]) -> f32 {
        let n = self.views as f32;
        let ridge = RIDGE * (a + c);
        let (a, c) = (a + ridge, c + ridge);
        let (mut explained, mut total) = (0.0, 0.0);
        for k in 0..3 {
            let g = self.derivative[k] / n;
            let moment = Vec3::from_array(self.moments[k]);
            let [p, q] = axes.map(|axis| moment.dot(axis) / n - g * mean.dot(axis));
            explained += (c * p * p - 2.0 * b * p * q + a * q * q) / (a * c - b * b);
            total += self.squares[k] / n - g * g;
        }
        let rest = (total - explained).max(f32::MIN_POSITIVE);
        0.5 * explained * (n - 3.0) / rest
    }

    /// Terms that so many views tell apart.
    fn terms(&self) -> usize {
        let told = |terms: &&usize| VIEWS_PER_TERM * **terms <= self.views;
        TERMS.iter().rev().find(told).copied().unwrap_or(0)
    }
}

/// The shortest rotation of the third axis onto a unit vector.
fn shortest_turn(axis: Vec3<f32>) -> Rotation<f32> {
    let turn = Rotation::from_wxyz(1.0 + axis.z, -axis.y, axis.x, 0.0);
    turn.unwrap_or(Rotation { w: 0.0, v: Vec3::new(1.0, 0.0, 0.0) })
}

/// Statistics of all keyframes on the view dependence of each Gaussian.
pub(super) struct ViewDependence(Vec<Sums>);

impl ViewDependence {
    /// Of a map of so many Gaussians.
    pub(super) fn new(gaussians: usize) -> Self {
        Self(vec![Sums::default(); gaussians])
    }

    /// Adds the derivative of the loss of a keyframe whose camera is at `origin` \[m\].
    pub(super) fn add(&mut self, map: &GaussianMap, gradient: &MapGradient, origin: Vec3<f32>) {
        let seen = self.0.par_iter_mut().enumerate().filter(|(i, _)| gradient.seen[*i]);
        seen.for_each(|(i, sums)| {
            let towards = Vec3::from_array(map.means[i]) - origin;
            let direction = towards * towards.norm().recip();
            sums.add(direction.to_array(), gradient.colours[i]);
        });
    }

    /// The view colours, zero so far, of the Gaussians that ask for one.
    pub(super) fn view_colours(&self) -> ViewColours {
        let mut colours = ViewColours::default();
        for (i, sums) in self.0.iter().enumerate() {
            if let Some(cone) = sums.dependent_cone() {
                colours.push(i, cone, &vec![[0.0; 3]; sums.terms()]);
            }
        }
        colours
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// Sums over views along an arc of a Gaussian whose derivative is noise and a share of the place
    /// on the arc.
    fn sums(views: usize, arc: f32, share: f32, seed: u64) -> Sums {
        let (mut sums, noise) = (Sums::default(), noise(seed, 3 * views));
        for (view, noise) in noise.chunks(3).enumerate() {
            let place = view as f32 / (views - 1) as f32 - 0.5;
            let angle = arc * place;
            let d = [angle.sin(), 0.1 * (3.0 * angle).sin(), angle.cos()];
            let norm = d.iter().map(|v| v * v).sum::<f32>().sqrt();
            sums.add(
                d.map(|v| v / norm),
                std::array::from_fn(|c| share * place + 0.1 * noise[c] as f32),
            );
        }
        sums
    }

    #[test]
    fn only_colours_that_follow_the_direction_depend_on_it() {
        let dependent = |share: f32| {
            (0..200).filter(|seed| sums(12, 0.5, share, *seed).dependent_cone().is_some()).count()
        };
        assert!(dependent(0.0) < 14, "{} of 200 by chance", dependent(0.0));
        assert_eq!(dependent(0.6), 200);
        assert!(sums(12, 0.02, 0.6, 1).dependent_cone().is_none(), "too narrow");
        assert!(sums(5, 0.5, 0.6, 1).dependent_cone().is_none(), "too few views");
    }

    #[test]
    fn the_cone_holds_the_directions() {
        let cone = sums(15, 0.5, 0.6, 3).dependent_cone().expect("dependent");
        let [w, x, y, z] = cone.rotation;
        let axis = Rotation { w, v: Vec3::new(x, y, z) }.rotate(Vec3::new(0.0, 0.0, 1.0));
        assert!((axis - Vec3::new(0.0, 0.0, 1.0)).norm() < 0.02, "{axis:?}");
        assert!(cone.spread > 0.15 && cone.spread < 0.3, "{}", cone.spread);
    }

    #[test]
    fn terms_rise_with_the_views() {
        let terms = [6, 14, 15, 26, 27].map(|views| sums(views, 0.5, 0.6, 1).terms());
        assert_eq!(terms, [2, 2, 5, 5, 9]);
    }

    #[test]
    fn the_shortest_turn_reaches_every_direction() {
        for axis in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]] {
            let axis = Vec3::from_array(axis);
            let turned = shortest_turn(axis).rotate(Vec3::new(0.0, 0.0, 1.0));
            assert!((turned - axis).norm() < 1e-6, "{axis:?} {turned:?}");
        }
    }
}
