//! Colour that depends on the direction it is seen from.
//!
//! A surface with gloss shows another colour from each side. Of the directions from which a video
//! sees it, most lie in a narrow cone, on which spherical harmonics are all nearly constant; so the
//! colour is a polynomial on that cone. With the unit vector `d` from the camera to the Gaussian,
//! the rotation `Q` from the cone's axes to the world and the cone's `spread`,
//!
//! ```text
//! (x, y, ·) = Qᵀ d / spread                       0 on the axis, ±1 at its border
//! s = (x, y) / √(1 + x² + y²)                     within the unit disc: beyond the cone the
//!                                                 colour tends to that of its border
//! y_c = Σ_k a_kc b_k(s)                           channel c
//! colour_c + L tanh(y_c / L)                      within 1.5 stops of the colour on the axis
//! b = x, y | 2xy, x² - y², x² + y² | x³ - 3xy², 3x²y - y³, x(x² + y²), y(x² + y²)
//! ```
//!
//! of degree 1, 2 or 3: 2, 5 or 9 terms, the solid harmonics of the disc in front. All are 0 on the
//! axis. Gaussians without a view colour cost four bytes.

use i2slam_geometry::{Real, Rotation, Vec3};
use std::ops::Range;

/// Largest deviation from the colour on the axis: 1.5 stops of log-radiance.
pub const MAX_DEVIATION: f64 = 1.5 * std::f64::consts::LN_2;
/// Terms of a polynomial by its degree.
pub const TERMS: [usize; 4] = [0, 2, 5, 9];
const MAX_TERMS: usize = TERMS[3];
/// Entry of a Gaussian without view colour.
const NONE: u32 = u32::MAX;

/// Directions from which a Gaussian was seen.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Cone<T> {
    /// Unit quaternion w, x, y, z from the cone's axes to the world; the third axis points from the
    /// cameras to the Gaussian.
    pub rotation: [T; 4],
    /// Sine of the angle between axis and border, above 0.
    pub spread: T,
}

/// View colours of some Gaussians of a map.
#[derive(Clone, PartialEq, Debug)]
pub struct ViewColours<T = f32> {
    /// Number of the view colour by Gaussian, or `NONE`; missing ones have none.
    slots: Vec<u32>,
    cones: Vec<Cone<T>>,
    /// First coefficient of each, and the end of the last.
    starts: Vec<u32>,
    coefficients: Vec<[T; 3]>,
}

/// View colour of one Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct ViewColour<'a, T> {
    /// Directions that it was fitted to.
    pub cone: Cone<T>,
    /// `a_kc`, one row for each term.
    pub coefficients: &'a [[T; 3]],
}

impl<T> Default for ViewColours<T> {
    fn default() -> Self {
        Self { slots: Vec::new(), cones: Vec::new(), starts: vec![0], coefficients: Vec::new() }
    }
}

impl<T: Real> ViewColours<T> {
    /// True if no Gaussian has one.
    pub fn is_empty(&self) -> bool {
        self.cones.is_empty()
    }

    /// Number of Gaussians that have one.
    pub fn len(&self) -> usize {
        self.cones.len()
    }

    /// One behind the last Gaussian that has one.
    pub fn end(&self) -> usize {
        self.slots.len()
    }

    /// Coefficients of all, in order of the Gaussians.
    pub fn coefficients(&self) -> &[[T; 3]] {
        &self.coefficients
    }

    /// Coefficients of all, to change.
    pub fn coefficients_mut(&mut self) -> &mut [[T; 3]] {
        &mut self.coefficients
    }

    /// Appends a view colour to a Gaussian behind all that have one.
    ///
    /// # Panics
    /// If a later Gaussian has one, or the number of coefficients is that of no degree.
    pub fn push(&mut self, gaussian: usize, cone: Cone<T>, coefficients: &[[T; 3]]) {
        assert!(self.slots.len() <= gaussian, "view colours come in the order of Gaussians");
        assert!(TERMS[1..].contains(&coefficients.len()), "2, 5 or 9 terms");
        self.slots.resize(gaussian, NONE);
        self.slots.push(self.cones.len() as u32);
        self.cones.push(cone);
        self.coefficients.extend_from_slice(coefficients);
        self.starts.push(self.coefficients.len() as u32);
    }

    /// That of a Gaussian.
    #[inline]
    pub fn get(&self, gaussian: usize) -> Option<ViewColour<'_, T>> {
        let range = self.range(gaussian)?;
        let cone = self.cones[self.slots[gaussian] as usize];
        Some(ViewColour { cone, coefficients: &self.coefficients[range] })
    }

    /// All with the index of their Gaussian, in order.
    pub fn iter(&self) -> impl Iterator<Item = (usize, ViewColour<'_, T>)> {
        (0..self.slots.len()).filter_map(|gaussian| Some((gaussian, self.get(gaussian)?)))
    }

    /// Places of a Gaussian's coefficients among [all](Self::coefficients).
    #[inline]
    pub(crate) fn range(&self, gaussian: usize) -> Option<Range<usize>> {
        let slot = *self.slots.get(gaussian).filter(|slot| **slot != NONE)? as usize;
        Some(self.starts[slot] as usize..self.starts[slot + 1] as usize)
    }

    /// Keeps those of the Gaussians that are kept: whose entry is true or missing.
    pub fn retain(&mut self, keep: &[bool]) {
        let mut kept = Self::default();
        let mut removed = 0;
        for gaussian in 0..self.slots.len() {
            if !keep.get(gaussian).unwrap_or(&true) {
                removed += 1;
            } else if let Some(ViewColour { cone, coefficients }) = self.get(gaussian) {
                kept.push(gaussian - removed, cone, coefficients);
            }
        }
        *self = kept;
    }

    /// One flag for each coefficient: whether its Gaussian's flag is true or missing.
    pub fn spread_flags(&self, of_gaussians: &[bool]) -> Vec<bool> {
        let flag = |gaussian: usize| *of_gaussians.get(gaussian).unwrap_or(&true);
        let each = self.iter();
        each.flat_map(|(i, colour)| vec![flag(i); colour.coefficients.len()]).collect()
    }

    /// Rotates the directions of a Gaussian's view colour.
    pub fn rotate(&mut self, gaussian: usize, rotation: Rotation<T>) {
        let slot = self.slots.get(gaussian).copied().filter(|slot| *slot != NONE);
        let Some(cone) = slot.map(|slot| &mut self.cones[slot as usize]) else { return };
        let [w, x, y, z] = cone.rotation;
        let turned = (rotation * Rotation { w, v: Vec3::new(x, y, z) }).normalized();
        cone.rotation = [turned.w, turned.v.x, turned.v.y, turned.v.z];
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> ViewColours<U> {
        let of = |v: T| U::of(v.to_f64());
        ViewColours {
            slots: self.slots.clone(),
            cones: (self.cones.iter())
                .map(|c| Cone { rotation: c.rotation.map(of), spread: of(c.spread) })
                .collect(),
            starts: self.starts.clone(),
            coefficients: self.coefficients.iter().map(|row| row.map(of)).collect(),
        }
    }

    /// Splits values of coefficients into those of each `count` Gaussians of a map, with the number of
    /// the first.
    pub(crate) fn chunks<'a, V>(
        &self,
        mut values: &'a mut [V],
        gaussians: usize,
        count: usize,
    ) -> Vec<(usize, &'a mut [V])> {
        assert_eq!(values.len(), self.coefficients.len(), "gradient and map differ in size");
        let (numbers, mut next) = (0..gaussians.div_ceil(count), 0);
        let chunk = |number: usize| {
            let rows = number * count..gaussians.min((number + 1) * count);
            let length = rows.filter_map(|i| self.range(i)).map(|range| range.len()).sum();
            let (first, rest) = std::mem::take(&mut values).split_at_mut(length);
            values = rest;
            next += length;
            (next - length, first)
        };
        numbers.map(chunk).collect()
    }
}

/// A direction in the coordinates of a cone.
struct ConeCoordinates<T> {
    /// Columns x and y of `Q`.
    axes: [Vec3<T>; 2],
    /// Unit vector from the camera to the Gaussian.
    direction: Vec3<T>,
    /// One over the distance \[1/m\].
    inverse_distance: T,
    /// `s`.
    place: [T; 2],
    /// `1 / √(1 + x² + y²)`.
    shrink: T,
}

impl<T: Real> ViewColour<'_, T> {
    fn coordinates(&self, mean: [T; 3], origin: [T; 3]) -> ConeCoordinates<T> {
        let offset = Vec3::from_array(mean) - Vec3::from_array(origin);
        let inverse_distance = offset.norm().recip();
        let direction = offset * inverse_distance;
        let [w, x, y, z] = self.cone.rotation;
        let matrix = Rotation { w, v: Vec3::new(x, y, z) }.matrix();
        let axes = [0, 1].map(|k| Vec3::new(matrix[(0, k)], matrix[(1, k)], matrix[(2, k)]));
        let [x, y] = axes.map(|axis| axis.dot(direction) / self.cone.spread);
        let shrink = (T::one() + x * x + y * y).sqrt().recip();
        ConeCoordinates {
            axes,
            direction,
            inverse_distance,
            place: [x * shrink, y * shrink],
            shrink,
        }
    }

    /// `tanh(y_c / L)`.
    fn bounded(&self, terms: &[T; MAX_TERMS]) -> [T; 3] {
        let limit = T::of(MAX_DEVIATION);
        std::array::from_fn(|c| {
            let rows = self.coefficients.iter().zip(terms);
            let sum: T = rows.map(|(row, term)| row[c] * *term).sum();
            (sum / limit).tanh()
        })
    }

    /// Deviation from the colour of a Gaussian at `mean`, seen from `origin` \[m\].
    pub fn deviation(&self, mean: [T; 3], origin: [T; 3]) -> [T; 3] {
        let terms = terms(self.coordinates(mean, origin).place);
        self.bounded(&terms).map(|b| b * T::of(MAX_DEVIATION))
    }

    /// Adds `∂L/∂coefficients` to `rows`; returns `∂L/∂mean` through the direction, of which the
    /// camera's centre receives the opposite. `d_colour` is `∂L/∂` of the colour that is seen.
    pub(crate) fn pull_back(
        &self,
        mean: [T; 3],
        origin: [T; 3],
        d_colour: [T; 3],
        rows: Option<&mut [[T; 3]]>,
    ) -> [T; 3] {
        let at = self.coordinates(mean, origin);
        let terms = terms(at.place);
        let bounded = self.bounded(&terms);
        let d: [T; 3] = std::array::from_fn(|c| d_colour[c] * (T::one() - bounded[c] * bounded[c]));
        for (row, term) in rows.into_iter().flatten().zip(&terms) {
            (0..3).for_each(|c| row[c] += d[c] * *term);
        }
        let mut d_place = [T::zero(); 2];
        for (coefficients, slope) in self.coefficients.iter().zip(slopes(at.place)) {
            let along: T = (0..3).map(|c| coefficients[c] * d[c]).sum();
            (0..2).for_each(|k| d_place[k] += along * slope[k]);
        }
        // s = v n with n = 1 / √(1 + |v|²): ∂s/∂v = n (I - s sᵀ).
        let [s, t] = at.place;
        let radial = s * d_place[0] + t * d_place[1];
        let factor = at.shrink / self.cone.spread;
        let d_direction = at.axes[0] * ((d_place[0] - s * radial) * factor)
            + at.axes[1] * ((d_place[1] - t * radial) * factor);
        let tangential = d_direction - at.direction * at.direction.dot(d_direction);
        (tangential * at.inverse_distance).to_array()
    }
}

/// `b_k` at a place in the disc.
fn terms<T: Real>([x, y]: [T; 2]) -> [T; MAX_TERMS] {
    let (two, three, r2) = (T::of(2.0), T::of(3.0), x * x + y * y);
    [
        x,
        y,
        two * x * y,
        x * x - y * y,
        r2,
        x * (x * x - three * y * y),
        y * (three * x * x - y * y),
        x * r2,
        y * r2,
    ]
}

/// `∂b_k/∂(x, y)`.
fn slopes<T: Real>([x, y]: [T; 2]) -> [[T; 2]; MAX_TERMS] {
    let (two, three, six) = (T::of(2.0), T::of(3.0), T::of(6.0));
    let (one, zero, r2) = (T::one(), T::zero(), x * x + y * y);
    [
        [one, zero],
        [zero, one],
        [two * y, two * x],
        [two * x, -two * y],
        [two * x, two * y],
        [three * (x * x - y * y), -six * x * y],
        [six * x * y, three * (x * x - y * y)],
        [r2 + two * x * x, two * x * y],
        [two * x * y, r2 + two * y * y],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_close, assert_gradient, noise};

    fn cone(spread: f64) -> Cone<f64> {
        let rotation = Rotation::exp(Vec3::new(0.3, -0.7, 0.2));
        Cone { rotation: [rotation.w, rotation.v.x, rotation.v.y, rotation.v.z], spread }
    }

    fn axis(cone: &Cone<f64>) -> Vec3<f64> {
        let [w, x, y, z] = cone.rotation;
        Rotation { w, v: Vec3::new(x, y, z) }.rotate(Vec3::new(0.0, 0.0, 1.0))
    }

    fn rows(seed: u64, count: usize) -> Vec<[f64; 3]> {
        noise(seed, 3 * count).as_chunks::<3>().0.to_vec()
    }

    #[test]
    fn nothing_is_added_on_the_axis_and_at_most_the_limit_anywhere() {
        let cone = cone(0.1);
        let coefficients = rows(4, 9).iter().map(|row| row.map(|v| 30.0 * v)).collect::<Vec<_>>();
        let colour = ViewColour { cone, coefficients: &coefficients };
        let origin = [0.5, -0.25, 1.0];
        let mean = (Vec3::from_array(origin) + axis(&cone) * 2.0).to_array();
        let deviation = colour.deviation(mean, origin);
        assert!(deviation.iter().all(|v| v.abs() < 1e-12), "{deviation:?}");
        for n in 0..50 {
            let mean = noise(n, 3);
            let deviation = colour.deviation([mean[0], mean[1], mean[2]], origin);
            assert!(deviation.iter().all(|v| v.abs() <= MAX_DEVIATION), "{deviation:?}");
        }
    }

    /// Far beyond the cone the colour is that of its border.
    #[test]
    fn the_colour_settles_beyond_the_cone() {
        let cone = cone(0.05);
        let coefficients = rows(5, 9);
        let colour = ViewColour { cone, coefficients: &coefficients };
        let [w, x, y, z] = cone.rotation;
        let rotation = Rotation { w, v: Vec3::new(x, y, z) };
        let towards = |angle: f64| {
            let d = Vec3::new(angle.sin() * 0.6, angle.sin() * 0.8, angle.cos());
            colour.deviation(rotation.rotate(d).to_array(), [0.0; 3])
        };
        let change = |a: f64, b: f64| {
            let (a, b) = (towards(a), towards(b));
            (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max)
        };
        assert!(change(0.0, 0.1) > 0.2);
        assert!(change(0.5, 1.0) < 0.02, "{}", change(0.5, 1.0));
    }

    #[test]
    fn gradients_agree_with_central_differences() {
        let (mean, origin, d_colour) = ([0.4_f64, 1.1, -0.3], [0.2, -0.1, 0.4], [0.7, -1.3, 0.4]);
        for terms in TERMS.into_iter().skip(1) {
            let towards = Vec3::from_array(mean) - Vec3::from_array(origin);
            let turn = Vec3::new(0.0, 0.0, 1.0).cross(towards * towards.norm().recip());
            let rotation = Rotation::exp(turn * 1.4);
            let rotation = [rotation.w, rotation.v.x, rotation.v.y, rotation.v.z];
            let cone = Cone { rotation, spread: 0.3 };
            let coefficients = rows(6, terms);
            let value = |coefficients: &[[f64; 3]], mean: [f64; 3], origin: [f64; 3]| {
                let deviation = ViewColour { cone, coefficients }.deviation(mean, origin);
                (0..3).map(|c| deviation[c] * d_colour[c]).sum::<f64>()
            };
            let mut d_rows = vec![[0.0; 3]; terms];
            let colour = ViewColour { cone, coefficients: &coefficients };
            let d_mean = colour.pull_back(mean, origin, d_colour, Some(&mut d_rows));
            assert!(d_mean.iter().any(|d| d.abs() > 1e-2), "{d_mean:?}");
            let x = coefficients.as_flattened();
            assert_gradient("coefficients", x, d_rows.as_flattened(), 1e-5, 1e-7, |x| {
                value(x.as_chunks::<3>().0, mean, origin)
            });
            assert_gradient("mean", &mean, &d_mean, 1e-5, 1e-7, |x| {
                value(&coefficients, [x[0], x[1], x[2]], origin)
            });
            let d_origin = d_mean.map(|d| -d);
            assert_gradient("origin", &origin, &d_origin, 1e-5, 1e-7, |x| {
                value(&coefficients, mean, [x[0], x[1], x[2]])
            });
        }
    }

    #[test]
    fn kept_ones_follow_their_gaussians() {
        let mut colours = ViewColours::default();
        for (gaussian, terms) in [(1, 2), (2, 9), (5, 5)] {
            colours.push(gaussian, cone(0.1 * gaussian as f64), &rows(gaussian as u64, terms));
        }
        let mut values: Vec<usize> = (0..16).collect();
        let chunks = colours.chunks(&mut values, 8, 2);
        let extents: Vec<_> = chunks.iter().map(|(first, rows)| (*first, rows.len())).collect();
        assert_eq!(extents, [(0, 2), (2, 9), (11, 5), (16, 0)]);
        assert_eq!((chunks[1].1[0], chunks[2].1[0]), (2, 11));
        let keep = [false, true, false, true, true];
        let flags = colours.spread_flags(&keep);
        assert_eq!(flags.iter().filter(|&&f| f).count(), 7);
        colours.retain(&keep);
        let left: Vec<_> = colours.iter().map(|(i, c)| (i, c.coefficients.len())).collect();
        assert_eq!(left, [(0, 2), (3, 5)]);
        assert_eq!(colours.get(3).expect("kept").coefficients, rows(5, 5));
        assert_eq!(colours.cast::<f32>().cast::<f64>().len(), 2);
        assert!(colours.get(1).is_none() && colours.get(9).is_none());
    }

    /// A Gaussian and its camera, turned together, show the same colour.
    #[test]
    fn view_colours_turn_with_the_world() {
        let (mean, origin) = (Vec3::new(0.4, 1.1, -0.3), Vec3::new(0.2, -0.1, 0.4));
        let mut colours = ViewColours::default();
        colours.push(0, cone(0.4), &rows(2, 5));
        let seen = |colours: &ViewColours<f64>, mean: Vec3<f64>, origin: Vec3<f64>| {
            colours.get(0).expect("pushed").deviation(mean.to_array(), origin.to_array())
        };
        let before = seen(&colours, mean, origin);
        let turn = Rotation::exp(Vec3::new(-0.8, 0.3, 1.2));
        colours.rotate(0, turn);
        let after = seen(&colours, turn.rotate(mean), turn.rotate(origin));
        assert_close("turned", &after, &before, 1e-12);
    }
}
