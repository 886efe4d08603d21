//! Gaussians on the surface that a camera sees.

use super::scale_bounds::ScaleBounds;
use i2slam_geometry::{Camera, Pose, Vec3};
use i2slam_radiance::Render;
use i2slam_radiance::gaussian::GaussianMap;

/// Distance between a Gaussian and the rendered surface up to which it counts as seen, as a share of
/// its depth.
const MAX_DEPTH_DIFFERENCE: f32 = 0.02;

/// A camera and the surface that it sees.
#[derive(Clone, Copy)]
pub(super) struct SurfaceView<'a> {
    pub(super) camera: &'a Camera<f64>,
    pub(super) camera_from_world: Pose<f64>,
    /// The map in this camera.
    pub(super) render: &'a Render,
}

impl SurfaceView<'_> {
    /// Centre of a Gaussian in the camera [m], if it lies on the surface.
    pub(super) fn seen(&self, map: &GaussianMap, index: usize) -> Option<Vec3<f64>> {
        let point = self.camera_from_world * Vec3::from_array(map.means[index]).cast::<f64>();
        let at = (point.z > 0.0).then(|| pixel_at(self.camera, self.camera.project(point)))??;
        let pixel = at[1] * self.camera.width + at[0];
        let surface = self.render.depth.data[pixel] / self.render.opacity.data[pixel];
        let z = point.z as f32;
        ((z - surface).abs() <= MAX_DEPTH_DIFFERENCE * z).then_some(point)
    }

    /// Lowers the least size of the Gaussians that are seen from nearer than before.
    pub(super) fn lower_bounds(&self, map: &GaussianMap, bounds: &mut ScaleBounds) {
        for index in 0..map.len() {
            if let Some(point) = self.seen(map, index) {
                bounds.see(index, (point.z / self.camera.fx) as f32);
            }
        }
    }
}

/// Column and row of the pixel at an image position, if it lies in the picture.
pub(super) fn pixel_at(camera: &Camera<f64>, (u, v): (f64, f64)) -> Option<[usize; 2]> {
    let (column, row) = (u as usize, v as usize);
    let is_inside = camera.contains(u, v, 0.0) && column < camera.width && row < camera.height;
    is_inside.then_some([column, row])
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::RadianceMap;
    use i2slam_radiance::gaussian::{
        ColourActivation, Gaussian, RasterSettings, Rasterizer, Shape, View,
    };

    const SIDE: usize = 32;

    /// A disc at 4 m that fills the picture, and a speck behind it.
    fn scene() -> (GaussianMap, ScaleBounds) {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        let mut bounds = ScaleBounds::default();
        for (z, deviations) in [(4.0, [8.0, 8.0, 0.01]), (5.0, [0.1; 3])] {
            let log_scale = deviations.map(f32::ln);
            let (mean, rotation) = ([0.0, 0.0, z], [1.0, 0.0, 0.0, 0.0]);
            map.push(Gaussian { mean, log_scale, rotation, opacity_logit: 6.0, colour: [0.5; 3] });
            bounds.push(z / SIDE as f32, log_scale);
        }
        (map, bounds)
    }

    /// Least deviations after a keyframe at a distance from the disc saw the scene [m].
    fn least_seen_from(distance: f64) -> [f32; 2] {
        let (mut map, mut bounds) = scene();
        let half = 0.5 * SIDE as f64;
        let focal = SIDE as f64;
        let camera = Camera { width: SIDE, height: SIDE, fx: focal, fy: focal, cx: half, cy: half };
        let world_from_camera =
            Pose { translation: Vec3::new(0.0, 0.0, 4.0 - distance), ..Pose::identity() };
        let view = View { camera: camera.cast(), world_from_camera: world_from_camera.cast() };
        let mut render = Render::new(SIDE, SIDE);
        map.render(&mut Rasterizer::new(RasterSettings::default()), &view, &mut render);
        let camera_from_world = world_from_camera.inverse();
        let surface = SurfaceView { camera: &camera, camera_from_world, render: &render };
        surface.lower_bounds(&map, &mut bounds);
        map.log_scales.iter_mut().for_each(|scale| *scale = [-20.0; 3]);
        bounds.clamp(&mut map);
        [0, 1].map(|index| map.log_scales[index][0].exp())
    }

    #[test]
    fn a_nearer_camera_lowers_the_least_size_of_what_it_sees() {
        let [far, hidden] = least_seen_from(8.0);
        assert!((far - 0.3 * 4.0 / SIDE as f32).abs() < 1e-5, "{far}");
        let [near, still_hidden] = least_seen_from(1.0);
        assert!((near - 0.3 * 1.0 / SIDE as f32).abs() < 1e-5, "{near}");
        assert_eq!(hidden, still_hidden);
    }
}
