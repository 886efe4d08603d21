//! Cube and occupancy cells of a radiance field.

use super::shape::FieldShape;
use crate::config::Config;
use i2slam_geometry::{Camera, Image, Pose, Vec3};
use i2slam_radiance::View;
use i2slam_radiance::hashgrid::{
    FieldSettings, HashGridField, HashGridMap, MarchSettings, Occupancy, OccupancySettings, Ray,
    SettingsError,
};

/// Least half edge of a cube [m].
const MIN_BOUND: f64 = 0.1;
/// Least growth of a cube that is too small: retraining a field in it is expensive.
pub(in crate::mapping) const MIN_CUBE_GROWTH: f64 = 1.5;
/// Share of the surface points that a cube holds: outliers at depth edges do not size it.
const SURFACE_QUANTILE: f64 = 0.99;

/// Surface points of a depth picture, in the camera.
fn surface_points<'a>(
    camera: &'a Camera<f64>,
    depth: &'a Image<f32>,
) -> impl Iterator<Item = Vec3<f64>> + 'a {
    let seen = depth.data.iter().enumerate().filter(|(_, d)| **d > 0.0);
    seen.map(move |(pixel, &d)| {
        let (u, v) = Camera::<f64>::pixel_centre(pixel % depth.width, pixel / depth.width);
        camera.unproject(u, v, f64::from(d))
    })
}

/// Half edge [m] of a cube around the camera that holds 99 % of the surfaces, with the margin.
pub(super) fn initial_bound(config: &Config, camera: &Camera<f64>, depth: &Image<f32>) -> f64 {
    let bound = config.hashgrid.bound;
    if bound > 0.0 {
        return f64::from(bound);
    }
    let distance = surface_distance(camera, depth);
    distance.map_or(MIN_BOUND, |d| (f64::from(config.parameters.field.margin) * d).max(MIN_BOUND))
}

/// Distance from the camera [m] that 99 % of the surfaces lie within; `None` without depth.
pub(in crate::mapping) fn surface_distance(
    camera: &Camera<f64>,
    depth: &Image<f32>,
) -> Option<f64> {
    surface_quantile(surface_points(camera, depth).map(|p| p.norm()).collect())
}

/// The 99 % quantile of `distances`; `None` without any.
fn surface_quantile(mut distances: Vec<f64>) -> Option<f64> {
    let inside = (SURFACE_QUANTILE * distances.len() as f64).ceil() as usize;
    let (_, far, _) =
        (inside > 0).then(|| distances.select_nth_unstable_by(inside - 1, f64::total_cmp))?;
    Some(*far)
}

/// Half edge [m] of the cube around `centre` that holds 99 % of the surfaces of a frame.
pub(super) fn required_extent(
    centre: [f64; 3],
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
    depth: &Image<f32>,
) -> f64 {
    let places = surface_points(camera, depth).map(|point| world_from_camera * point);
    surface_quantile(places.map(|place| chebyshev_distance(place, centre)).collect()).unwrap_or(0.0)
}

/// Chebyshev distance: half edge [m] of the smallest cube around `centre` that holds a point.
pub(in crate::mapping) fn chebyshev_distance(point: Vec3<f64>, centre: [f64; 3]) -> f64 {
    let offsets = point.to_array().into_iter().zip(centre).map(|(p, c)| (p - c).abs());
    offsets.fold(0.0, f64::max)
}

/// Share of all pixels whose surface lies outside of a field's cube.
pub(super) fn share_outside(
    field: &FieldSettings,
    camera: &Camera<f64>,
    world_from_camera: Pose<f64>,
    depth: &Image<f32>,
) -> f64 {
    let outside = surface_points(camera, depth)
        .filter(|&point| chebyshev_distance(world_from_camera * point, field.centre) > field.bound);
    outside.count() as f64 / depth.data.len().max(1) as f64
}

/// Most rays along a side of a pixel when cells are marked.
const MAX_RAYS_PER_SIDE: f32 = 8.0;

/// Rays along each side of a pixel that leave no gap between cells of edge `cell` [m].
fn rays_per_side(camera: &Camera<f32>, depth: &Image<f32>, cell: f32) -> usize {
    let far = depth.data.iter().fold(0.0_f32, |far, &d| far.max(d));
    let apart = far / camera.fx.min(camera.fy);
    (apart / cell).ceil().clamp(1.0, MAX_RAYS_PER_SIDE) as usize
}

/// Marks the cells that the rays of a depth picture cross within `range` of pixel and depth.
pub(in crate::mapping) fn mark_cells(
    occupancy: &mut Occupancy,
    field: &HashGridField,
    (camera, world_from_camera): (&Camera<f32>, Pose<f64>),
    depth: &Image<f32>,
    range: impl Fn(usize, f32) -> (f32, f32),
) {
    let cell = 2.0 * field.settings().bound as f32 / occupancy.settings().resolution as f32;
    let fine = rays_per_side(camera, depth, cell);
    let camera = camera.resized(depth.width * fine, depth.height * fine);
    let view = View { camera, world_from_camera: world_from_camera.cast() };
    for (pixel, &d) in depth.data.iter().enumerate().filter(|(_, d)| **d > 0.0) {
        let (column, row) = (fine * (pixel % depth.width), fine * (pixel / depth.width));
        let (from, to) = range(pixel, d);
        for (i, j) in (0..fine).flat_map(|j| (0..fine).map(move |i| (i, j))) {
            let ray = Ray::through_pixel(&view, column + i, row + j);
            occupancy.mark_cells(field, &ray, from, to);
        }
    }
}

/// An untrained field in a cube of half edge `bound` [m] around `centre`; all cells are empty.
pub(in crate::mapping) fn untrained_field(
    shape: &FieldShape,
    centre: [f64; 3],
    bound: f64,
    seed: u64,
) -> Result<HashGridMap, SettingsError> {
    let occupancy =
        OccupancySettings { resolution: shape.occupancy_cells, ..OccupancySettings::default() };
    let march = MarchSettings {
        step_min: shape.step_min,
        cone: shape.step,
        steps_max: 1 << 14,
        ..MarchSettings::cube(bound)
    };
    Ok(HashGridMap {
        field: HashGridField::new(shape.settings(centre, bound), seed)?,
        occupancy: Occupancy::empty(occupancy),
        march,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Camera<f64> =
        Camera { width: 20, height: 10, fx: 1e6, fy: 1e6, cx: 10.0, cy: 5.0 };

    #[test]
    fn rays_of_coarse_pixels_are_no_farther_apart_than_cells() {
        let camera = Camera { fx: 20.0, fy: 25.0, ..CAMERA.cast() };
        let mut depth = Image::new(CAMERA.width, CAMERA.height, 1);
        assert_eq!(rays_per_side(&camera, &depth, 0.05), 1);
        // At two metres pixels are 10 cm wide.
        depth.data[3] = 2.0;
        assert_eq!(rays_per_side(&camera, &depth, 0.2), 1);
        assert_eq!(rays_per_side(&camera, &depth, 0.04), 3);
        assert_eq!(rays_per_side(&camera, &depth, 1e-6), MAX_RAYS_PER_SIDE as usize);
    }

    #[test]
    fn a_spike_of_depth_does_not_size_the_cube() {
        let config = Config::default();
        let mut depth = Image::new(CAMERA.width, CAMERA.height, 1);
        assert_eq!(initial_bound(&config, &CAMERA, &depth), MIN_BOUND);
        depth.data.fill(2.0);
        let plain = initial_bound(&config, &CAMERA, &depth);
        assert!((plain - 2.0 * f64::from(config.parameters.field.margin)).abs() < 1e-6, "{plain}");
        depth.data[77] = 40.0;
        assert_eq!(initial_bound(&config, &CAMERA, &depth), plain);
        // Three pixels of two hundred are a surface.
        depth.data[78..80].fill(40.0);
        assert!(initial_bound(&config, &CAMERA, &depth) > 15.0 * plain);
    }
}
