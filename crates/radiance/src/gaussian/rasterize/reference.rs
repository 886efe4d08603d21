//! The reference lane: plain, one thread, any scalar, pixel by pixel.
//!
//! Every pixel visits every Gaussian that passed projection, so time is pixels times Gaussians:
//! it is the readable definition, checks gradients in `f64`, and verifies the fast lane.

use crate::gaussian::project::reference::{
    Footprint, FootprintCotangent, PoseCotangents, Projector,
};
use crate::gaussian::{
    Gaussian, GaussianMap, MapGradient, MotionGradient, RasterSettings, Render, RenderCotangent,
    ShutterMotion, View,
};
use crate::shutter_motion::row_place;
use i2slam_geometry::{Camera, Real, Tangent, Vec3};

/// Renders `view`.
pub fn render<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    settings: &RasterSettings,
) -> Render<T> {
    render_moving(map, view, &ShutterMotion::still(), settings)
}

/// Pulls `∂L/∂render` back to the map (added to `map_gradient` when given) and to the tangent of
/// `world_from_camera`.
///
/// # Panics
/// If `map_gradient` is not of the map's size, or the cotangent not of the view's.
pub fn pull_back<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    settings: &RasterSettings,
    cotangent: &RenderCotangent<T>,
    map_gradient: Option<&mut MapGradient<T>>,
) -> Tangent<T> {
    let still = ShutterMotion::still();
    pull_back_moving(map, view, &still, settings, cotangent, map_gradient).pose
}

/// Renders the average over the moments of a camera in motion.
pub fn render_moving<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    motion: &ShutterMotion<T>,
    settings: &RasterSettings,
) -> Render<T> {
    let (width, height) = (view.camera.width, view.camera.height);
    let settings = &settings.bounded();
    let footprints = project(map, view, motion, settings);
    let (moments, mut out) = (motion.counted(), Render::new(width, height));
    for row in 0..height {
        for column in 0..width {
            let mut pixel = [T::zero(); 5];
            for moment in &moments {
                let s = moment.time + motion.row_time(row, height);
                for c in contributions(&footprints, column, row, s, settings) {
                    let (value, share) = (c.value(&footprints), moment.weight * c.alpha);
                    (0..5).for_each(|k| pixel[k] += value[k] * share * c.transmittance);
                }
            }
            let at = row * width + column;
            (0..3).for_each(|k| out.radiance.plane_mut(k)[at] = pixel[k]);
            out.depth.data[at] = pixel[3];
            out.opacity.data[at] = pixel[4];
        }
    }
    out
}

/// Pulls `∂L/∂render` of [`render_moving`] back to the map (added to `map_gradient` when given),
/// the pose at mid-exposure and the motion.
///
/// # Panics
/// If `map_gradient` is not of the map's size, or the cotangent not of the view's.
pub fn pull_back_moving<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    motion: &ShutterMotion<T>,
    settings: &RasterSettings,
    cotangent: &RenderCotangent<T>,
    map_gradient: Option<&mut MapGradient<T>>,
) -> MotionGradient<T> {
    let (width, height) = (view.camera.width, view.camera.height);
    cotangent.planes(width, height);
    let settings = &settings.bounded();
    let (footprints, moments) = (project(map, view, motion, settings), motion.counted());
    let mut sums = Sums {
        cotangents: vec![FootprintCotangent::default(); footprints.len()],
        seen: vec![false; footprints.len()],
        readout: T::zero(),
    };
    for row in 0..height {
        for column in 0..width {
            let pixel = cotangent.at(column, row);
            if pixel.iter().all(|g| *g == T::zero()) {
                continue;
            }
            for moment in &moments {
                let s = moment.time + motion.row_time(row, height);
                let visited = contributions(&footprints, column, row, s, settings);
                let moment_pixel = Pixel { s, place: row_place(row, height), visited };
                let weighted = pixel.map(|g| g * moment.weight);
                moment_pixel.pull_back(&footprints, weighted, &mut sums);
            }
        }
    }
    let projector = Projector::new(map, view, motion, settings);
    let poses = pull_back_projection(map, &projector, &footprints, &sums, map_gradient);
    MotionGradient::new(motion, poses.middle, poses.ends, sums.readout)
}

/// All footprints in order of depth, ties by index.
fn project<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    motion: &ShutterMotion<T>,
    settings: &RasterSettings,
) -> Vec<Footprint<T>> {
    let projector = Projector::new(map, view, motion, settings);
    let origin = view.world_from_camera.translation.to_array();
    let seen = |(i, g)| (i, Gaussian { colour: map.colour_from(i, origin), ..g });
    let all = map.iter().enumerate().map(seen);
    let mut footprints: Vec<_> = all.filter_map(|(i, g)| projector.project(i, &g)).collect();
    footprints.sort_by(|a, b| a.depth.to_f64().total_cmp(&b.depth.to_f64()));
    footprints
}

/// One footprint's part of one pixel at one moment.
struct Contribution<T> {
    /// Position in the list of footprints.
    footprint: usize,
    /// From the footprint's centre to the pixel's \[px\].
    offset: [T; 2],
    /// `α`.
    alpha: T,
    /// True if `alpha_max` cut it.
    cut: bool,
    /// `T`, before this contribution.
    transmittance: T,
}

impl<T: Real> Contribution<T> {
    /// The composited value: `[r, g, b, depth, 1]`.
    fn value(&self, footprints: &[Footprint<T>]) -> [T; 5] {
        let f = &footprints[self.footprint];
        let ([hx, hy], [dx, dy]) = (f.depth_slope, self.offset);
        let depth = f.depth + hx * dx + hy * dy;
        [f.radiance[0], f.radiance[1], f.radiance[2], depth, T::one()]
    }
}

/// The contributions to a pixel at time `s`, front to back.
fn contributions<T: Real>(
    footprints: &[Footprint<T>],
    column: usize,
    row: usize,
    s: T,
    settings: &RasterSettings,
) -> Vec<Contribution<T>> {
    let of = |value: f32| T::of(f64::from(value));
    let (x, y) = Camera::<T>::pixel_centre(column, row);
    let mut transmittance = T::one();
    let mut visited = Vec::new();
    for (footprint, f) in footprints.iter().enumerate() {
        let shift = f.path.shift(s);
        let (dx, dy) = (x - (f.centre[0] + shift[0]), y - (f.centre[1] + shift[1]));
        let [a, b, c] = f.conic;
        let squared = a * dx * dx + T::of(2.0) * b * dx * dy + c * dy * dy;
        let free = f.opacity * (T::of(-0.5) * squared).exp();
        let alpha = free.min(of(settings.alpha_max));
        if alpha < of(settings.alpha_min) {
            continue;
        }
        let next = transmittance * (T::one() - alpha);
        if next < of(settings.transmittance_min) {
            break;
        }
        let (offset, cut) = ([dx, dy], free > alpha);
        visited.push(Contribution { footprint, offset, alpha, cut, transmittance });
        transmittance = next;
    }
    visited
}

/// Sums over all pixels.
struct Sums<T> {
    cotangents: Vec<FootprintCotangent<T>>,
    seen: Vec<bool>,
    /// `∂L/∂readout`.
    readout: T,
}

/// A pixel at one moment.
struct Pixel<T> {
    s: T,
    /// `∂s/∂readout`.
    place: T,
    visited: Vec<Contribution<T>>,
}

impl<T: Real> Pixel<T> {
    /// Back to front: with `q_i = g · v_i` and the light from behind `B_i = Σ_{j>i} q_j α_j T_j`,
    /// `∂L/∂α_i = T_i q_i - B_i / (1 - α_i)`.
    fn pull_back(&self, footprints: &[Footprint<T>], cotangent: [T; 5], sums: &mut Sums<T>) {
        let mut behind = T::zero();
        for c in self.visited.iter().rev() {
            let f = &footprints[c.footprint];
            sums.seen[c.footprint] = true;
            let value = c.value(footprints);
            let q: T = (0..5).map(|k| cotangent[k] * value[k]).sum();
            let weight = c.alpha * c.transmittance;
            let d_depth = cotangent[3] * weight;
            let sum = &mut sums.cotangents[c.footprint];
            (0..3).for_each(|k| sum.radiance[k] += cotangent[k] * weight);
            sum.depth += d_depth;
            (0..2).for_each(|k| sum.depth_slope[k] += d_depth * c.offset[k]);
            let d_alpha = c.transmittance * q - behind / (T::one() - c.alpha);
            behind += q * weight;
            // The depth at a pixel is z + h · (pixel - centre).
            let mut d_centre = f.depth_slope.map(|h| -h * d_depth);
            if !c.cut {
                // α = o exp(-½ (A dx² + 2 B dx dy + C dy²)), d = pixel - centre
                sum.opacity += d_alpha * c.alpha / f.opacity;
                let e = d_alpha * c.alpha;
                let ([dx, dy], [a, b, cc]) = (c.offset, f.conic);
                d_centre[0] += e * (a * dx + b * dy);
                d_centre[1] += e * (b * dx + cc * dy);
                sum.conic[0] -= T::of(0.5) * e * dx * dx;
                sum.conic[1] -= e * dx * dy;
                sum.conic[2] -= T::of(0.5) * e * dy * dy;
            }
            let speed = f.path.speed(self.s);
            for k in 0..2 {
                sum.centre[k] += d_centre[k];
                sum.path.velocity[k] += self.s * d_centre[k];
                sum.path.curvature[k] += self.s * self.s * d_centre[k];
                sums.readout += self.place * speed[k] * d_centre[k];
            }
        }
    }
}

/// From footprints to the map and the poses.
fn pull_back_projection<T: Real>(
    map: &GaussianMap<T>,
    projector: &Projector<T>,
    footprints: &[Footprint<T>],
    sums: &Sums<T>,
    mut map_gradient: Option<&mut MapGradient<T>>,
) -> PoseCotangents<T> {
    let mut poses = PoseCotangents { middle: Tangent::zero(), ends: [Tangent::zero(); 2] };
    for ((footprint, sum), seen) in footprints.iter().zip(&sums.cotangents).zip(&sums.seen) {
        let i = footprint.index;
        let Some(gaussian) = map.get(i) else { continue };
        let Some((mut g, d)) = projector.pull_back(&gaussian, footprint, sum) else { continue };
        poses.middle = poses.middle.plus(d.middle);
        if let Some(view) = map.view_colours.get(i) {
            let rows = map_gradient.as_deref_mut().zip(map.view_colours.range(i));
            let rows = rows.map(|(out, range)| &mut out.view_colours[range]);
            let origin = projector.origin.to_array();
            let d_mean = view.pull_back(gaussian.mean, origin, g.colour, rows);
            (0..3).for_each(|k| g.mean[k] += d_mean[k]);
            let translation = -(projector.camera_from_world * Vec3::from_array(d_mean));
            poses.middle = poses.middle.plus(Tangent { translation, rotation: Vec3::zero() });
        }
        poses.ends = [0, 1].map(|end| poses.ends[end].plus(d.ends[end]));
        if let Some(out) = map_gradient.as_deref_mut() {
            out.rows().add(i, &g, *seen);
        }
    }
    poses
}
