//! Pinholes: places where a map of Gaussians lets light pass through a surface that a frame has seen.
//!
//! The camera moves towards the surface by 0.4 of its median depth, and its picture becomes four
//! times as wide. Gaussians are projected as viewers of splats do (Kerbl et al. 2023): with `J` the
//! derivative of the projection and `V` the covariance in the camera,
//!
//! ```text
//! Σ₂ = J V Jᵀ + 0.3 I,   α(δ) = min(0.99, o exp(−½ δᵀ Σ₂⁻¹ δ)),   T = Π (1 − α)
//! ```
//!
//! over the Gaussians whose centre lies within a tenth of the depth of the surface at the pixel. A
//! pixel of the surface is a pinhole where more than half of the light passes: `T > 0.5`. Where it
//! passes the Gaussians at all depths, too, a viewer shows the background.

use super::Splat;
use crate::EvalError;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};

/// Share of the median depth by which the camera comes nearer.
const APPROACH: f64 = 0.4;
/// Width of the picture over that of the frame.
const MAGNIFICATION: usize = 4;
/// Relative difference of neighbouring depths above which there is an edge and no surface.
const MAX_JUMP: f32 = 0.05;
/// Distance to the surface up to which a Gaussian counts, as a share of the surface's depth.
const MAX_DISTANCE: f64 = 0.1;
/// Light that passes a pinhole, at least.
const MIN_TRANSMITTANCE: f32 = 0.5;
/// Variance added to footprints [px²], largest and least opacity, deviations drawn, and the margin
/// around the picture beyond which the projection is not linearised, all as in viewers.
const LOW_PASS: f64 = 0.3;
const MAX_ALPHA: f32 = 0.99;
const MIN_ALPHA: f32 = 1.0 / 255.0;
const EXTENT: f64 = 3.0;
const MAX_TANGENT: f64 = 1.3;

/// Pixels of a surface, and how many of them are pinholes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pinholes {
    /// Pixels through which more than half of the light passes.
    pub open: usize,
    /// Pixels through which it passes even where Gaussians at all depths count.
    pub see_through: usize,
    /// Pixels of the surface.
    pub surface: usize,
}

impl std::ops::AddAssign for Pinholes {
    fn add_assign(&mut self, other: Self) {
        self.open += other.open;
        self.see_through += other.see_through;
        self.surface += other.surface;
    }
}

/// Counts pinholes in the surface of a frame: its camera, pose, and true depth in the unit of the
/// map, 0 where it is unknown. [`EvalError::TooFew`] where there is no depth.
pub fn pinholes(
    splats: &[Splat],
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
    depth: &Image<f32>,
) -> Result<Pinholes, EvalError> {
    let mut known: Vec<f32> = depth.data.iter().copied().filter(|z| *z > 0.0).collect();
    let middle = known.len() / 2;
    if known.is_empty() {
        return Err(EvalError::TooFew { what: "pixels with true depth", found: 0, needed: 1 });
    }
    let median = f64::from(*known.select_nth_unstable_by(middle, f32::total_cmp).1);
    let approach = APPROACH * median;
    let step = Pose::new(Rotation::identity(), Vec3::new(0.0, 0.0, approach));
    let near = magnified(camera);
    let surface = surface(camera, &near, depth, approach);
    let light = transmittance(splats, &near, (world_from_camera * step).inverse(), &surface);
    let pixels = surface.iter().zip(&light).filter(|(z, _)| **z > 0.0).map(|(_, light)| light);
    let count = |passes: fn(&Light) -> f32| {
        pixels.clone().filter(|light| passes(light) > MIN_TRANSMITTANCE).count()
    };
    Ok(Pinholes {
        open: count(|light| light.surface),
        see_through: count(|light| light.all),
        surface: pixels.clone().count(),
    })
}

fn magnified(camera: &Camera<f64>) -> Camera<f64> {
    let factor = MAGNIFICATION as f64;
    Camera {
        width: MAGNIFICATION * camera.width,
        height: MAGNIFICATION * camera.height,
        fx: factor * camera.fx,
        fy: factor * camera.fy,
        cx: factor * camera.cx,
        cy: factor * camera.cy,
    }
}

/// Depth of the surface in the nearer picture, 0 where there is none: triangles between neighbouring
/// pixels of the frame, edges left out.
fn surface(
    camera: &Camera<f64>,
    near: &Camera<f64>,
    depth: &Image<f32>,
    approach: f64,
) -> Vec<f64> {
    let mut inverse = vec![0.0_f64; near.width * near.height];
    for row in 1..depth.height {
        for column in 1..depth.width {
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| {
                let (column, row) = (column - 1 + x, row - 1 + y);
                let z = depth.data[row * depth.width + column];
                let (u, v) = Camera::<f64>::pixel_centre(column, row);
                (z, camera.unproject(u, v, f64::from(z)))
            });
            let least = corners.iter().map(|c| c.0).fold(f32::INFINITY, f32::min);
            let most = corners.iter().map(|c| c.0).fold(0.0, f32::max);
            let is_surface = least > 0.0 && most - least <= MAX_JUMP * least;
            if !is_surface || f64::from(least) <= 1.1 * approach {
                continue;
            }
            let [a, b, c, d] = corners.map(|(_, point)| {
                let z = point.z - approach;
                let (u, v) = near.project(Vec3::new(point.x, point.y, z));
                [u, v, 1.0 / z]
            });
            fill([a, b, c], near, &mut inverse);
            fill([b, d, c], near, &mut inverse);
        }
    }
    inverse.into_iter().map(|w| if w > 0.0 { 1.0 / w } else { 0.0 }).collect()
}

/// Draws a triangle of `u`, `v` and inverse depth; the nearest surface stays.
fn fill([a, b, c]: [[f64; 3]; 3], camera: &Camera<f64>, inverse: &mut [f64]) {
    let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
    let area = cross([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let bounds = |k: usize, size: usize| {
        let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
        let first = (low - 0.5).ceil().max(0.0) as usize;
        first..((high - 0.5).floor() + 1.0).clamp(0.0, size as f64) as usize
    };
    if area == 0.0 {
        return;
    }
    for y in bounds(1, camera.height) {
        for x in bounds(0, camera.width) {
            let at = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
            let s = cross(at, [c[0] - a[0], c[1] - a[1]]) / area;
            let t = cross([b[0] - a[0], b[1] - a[1]], at) / area;
            if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
                let w = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2]);
                let pixel = &mut inverse[y * camera.width + x];
                *pixel = pixel.max(w);
            }
        }
    }
}

/// Share of the light of a pixel that passes.
#[derive(Clone, Copy)]
struct Light {
    /// The Gaussians at the surface.
    surface: f32,
    /// All Gaussians.
    all: f32,
}

/// Light that passes, for every pixel.
fn transmittance(
    splats: &[Splat],
    camera: &Camera<f64>,
    camera_from_world: Pose<f64>,
    surface: &[f64],
) -> Vec<Light> {
    let mut light = vec![Light { surface: 1.0, all: 1.0 }; surface.len()];
    for splat in splats {
        let Some(Footprint { centre, depth, conic, reach }) =
            footprint(splat, camera, camera_from_world)
        else {
            continue;
        };
        let bounds = |k: usize, size: usize| {
            let first = (centre[k] - reach).floor().clamp(0.0, size as f64) as usize;
            first..(centre[k] + reach).ceil().clamp(0.0, size as f64) as usize
        };
        for y in bounds(1, camera.height) {
            for x in bounds(0, camera.width) {
                let pixel = y * camera.width + x;
                let z = surface[pixel];
                if z <= 0.0 {
                    continue;
                }
                let [u, v] = [x as f64 + 0.5 - centre[0], y as f64 + 0.5 - centre[1]];
                let power = conic[0] * u * u + 2.0 * conic[1] * u * v + conic[2] * v * v;
                let alpha = (splat.opacity * (-0.5 * power).exp() as f32).min(MAX_ALPHA);
                if alpha >= MIN_ALPHA {
                    let is_at_surface = (depth - z).abs() <= MAX_DISTANCE * z;
                    light[pixel].all *= 1.0 - alpha;
                    light[pixel].surface *= if is_at_surface { 1.0 - alpha } else { 1.0 };
                }
            }
        }
    }
    light
}

/// A Gaussian in a picture.
struct Footprint {
    /// [px].
    centre: [f64; 2],
    depth: f64,
    /// Inverse covariance: `xx`, `xy`, `yy` [px⁻²].
    conic: [f64; 3],
    /// Half of the square that is drawn [px].
    reach: f64,
}

fn footprint(splat: &Splat, camera: &Camera<f64>, pose: Pose<f64>) -> Option<Footprint> {
    let point = pose * splat.mean;
    if point.z <= 0.01 {
        return None;
    }
    let limit = |size: usize, focal: f64| MAX_TANGENT * 0.5 * size as f64 / focal;
    let (wide, high) = (limit(camera.width, camera.fx), limit(camera.height, camera.fy));
    let x = (point.x / point.z).clamp(-wide, wide);
    let y = (point.y / point.z).clamp(-high, high);
    let (by_u, by_v) = (camera.fx / point.z, camera.fy / point.z);
    // Columns of J V^½: the Gaussian's axes in the picture.
    let rotation = (pose.rotation * splat.rotation).matrix();
    let [mut xx, mut xy, mut yy] = [LOW_PASS, 0.0, LOW_PASS];
    for (axis, scale) in splat.scale.iter().enumerate() {
        let [a, b, c] = [0, 1, 2].map(|row| scale * rotation[(row, axis)]);
        let (u, v) = (by_u * (a - x * c), by_v * (b - y * c));
        xx += u * u;
        xy += u * v;
        yy += v * v;
    }
    let determinant = xx * yy - xy * xy;
    let middle = 0.5 * (xx + yy);
    let largest = middle + (middle * middle - determinant).max(0.0).sqrt();
    let (u, v) = camera.project(point);
    let conic = [yy / determinant, -xy / determinant, xx / determinant];
    let footprint = Footprint {
        centre: [u, v],
        depth: point.z,
        conic,
        reach: (EXTENT * largest.sqrt()).ceil(),
    };
    (u.is_finite() && v.is_finite() && determinant > 0.0).then_some(footprint)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEPTH: f64 = 2.0;

    fn camera() -> Camera<f64> {
        Camera { width: 24, height: 16, fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 }
    }

    fn wall() -> Image<f32> {
        Image { data: vec![DEPTH as f32; 24 * 16], ..Image::new(24, 16, 1) }
    }

    /// One splat for every pixel of a wall, of a deviation in pixels.
    fn grid(deviation: f64, depth: f64) -> Vec<Splat> {
        let pixels = (0..24 * 16).map(|p| Camera::<f64>::pixel_centre(p % 24, p / 24));
        let splat = |(u, v)| Splat {
            mean: camera().unproject(u, v, depth),
            scale: [deviation * depth / 20.0; 3],
            rotation: Rotation::identity(),
            opacity: 0.95,
        };
        pixels.map(splat).collect()
    }

    /// Shares of pinholes, and of those that all Gaussians leave.
    fn shares(splats: &[Splat]) -> [f64; 2] {
        let found = pinholes(splats, &camera(), Pose::identity(), &wall()).expect("depth");
        assert!(found.surface > 5000, "{found:?}");
        [found.open, found.see_through].map(|count| count as f64 / found.surface as f64)
    }

    #[test]
    fn a_wall_of_small_splats_is_a_sieve() {
        assert_eq!(shares(&grid(0.6, DEPTH)), [0.0; 2]);
        assert!(shares(&grid(0.1, DEPTH)).iter().all(|share| *share > 0.5));
        assert_eq!(shares(&[]), [1.0; 2]);
    }

    #[test]
    fn a_wall_elsewhere_stops_the_light_but_is_no_surface() {
        assert_eq!(shares(&grid(0.6, 1.05 * DEPTH)), [0.0; 2]);
        for depth in [0.7, 1.3] {
            assert_eq!(shares(&grid(0.6, depth * DEPTH)), [1.0, 0.0]);
        }
    }

    #[test]
    fn the_surface_comes_nearer_and_ends_at_edges() {
        let mut depth = wall();
        for row in 0..16 {
            depth.data[row * 24..row * 24 + 8].fill(3.0);
        }
        let near = magnified(&camera());
        let surface = surface(&camera(), &near, &depth, 0.8);
        let at = |column: usize, row: usize| surface[row * near.width + column];
        // The wall at 2 m stands at 1.2 m, in front of the one at 3 m; between the two is nothing.
        let edge = (0..near.width).find(|&c| (at(c, 32) - 1.2).abs() < 1e-6).expect("the wall");
        let due = 48.0 + 80.0 * (8.5 - 12.0) / 20.0 * 2.0 / 1.2;
        assert!((edge as f64 + 0.5 - due).abs() <= 1.0, "{edge} {due}");
        assert!((at(8, 32) - 2.2).abs() < 1e-6 && at(edge - 1, 32) == 0.0);
    }

    #[test]
    fn without_depth_nothing_is_measured() {
        let nothing =
            pinholes(&grid(0.6, 2.0), &camera(), Pose::identity(), &Image::new(24, 16, 1));
        assert!(matches!(nothing, Err(EvalError::TooFew { .. })));
    }
}
