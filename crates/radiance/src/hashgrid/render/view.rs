//! The field as a radiance map: pictures from a pose.

use super::{FieldRenderer, RayGradient, RayRender};
use crate::hashgrid::{FieldGradient, HashGridMap, MarchSettings, Ray};
use crate::{RadianceMap, Render, RenderCotangent, View};
use i2slam_geometry::{Camera, Real, Tangent, Vec3};

/// Rays of a picture that are kept at once.
const BATCH: usize = 4096;

/// Direction of the ray through a pixel's centre, 1 m along the optical axis, in the camera.
fn direction_in_camera<T: Real>(camera: &Camera<T>, column: usize, row: usize) -> Vec3<T> {
    let (u, v) = Camera::pixel_centre(column, row);
    camera.unproject(u, v, T::one())
}

impl<T: Real> Ray<T> {
    /// The ray through a pixel's centre, sampled mid-step, with depth along the optical axis \[m\].
    pub fn through_pixel(view: &View<T>, column: usize, row: usize) -> Self {
        let direction = direction_in_camera(&view.camera, column, row);
        Self {
            origin: view.world_from_camera.translation,
            direction: view.world_from_camera.rotation.rotate(direction),
            offset: T::of(0.5),
        }
    }
}

impl<T: Real> RayGradient<T> {
    /// `∂L/∂ξ` for the pose `world_from_camera.retract(ξ)` of the ray of a pixel
    /// ([`Ray::through_pixel`]): with `d` the direction in the camera,
    /// `∂L/∂ρ = Rᵀ ∂L/∂origin` and `∂L/∂φ = d × Rᵀ ∂L/∂direction`.
    pub fn to_pose(&self, view: &View<T>, column: usize, row: usize) -> Tangent<f64> {
        let direction = direction_in_camera(&view.camera, column, row).cast::<f64>();
        let camera_from_world = view.world_from_camera.rotation.cast::<f64>().inverse();
        let turned = camera_from_world.rotate(self.direction.cast());
        Tangent {
            translation: camera_from_world.rotate(self.origin.cast()),
            rotation: direction.cross(turned),
        }
    }
}

/// `(column, row)` of the pixels of a batch.
fn pixels(view: &View<f32>, first: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
    let (width, count) = (view.camera.width, view.camera.pixels());
    (first..(first + BATCH).min(count)).map(move |i| (i % width, i / width))
}

/// Renders pixels `first..first + BATCH` of a view, and gives their rays.
fn render_batch(
    map: &HashGridMap,
    renderer: &mut FieldRenderer,
    view: &View<f32>,
    first: usize,
    out: &mut Vec<RayRender>,
) -> Vec<Ray> {
    let rays = pixels(view, first).map(|(column, row)| Ray::through_pixel(view, column, row));
    let rays: Vec<Ray> = rays.collect();
    renderer.render(&map.field, &map.occupancy, &rays, out);
    rays
}

impl RadianceMap for HashGridMap {
    type Settings = MarchSettings;
    type Renderer = FieldRenderer;
    type Gradient = FieldGradient;

    const RENDERS_MOTION: bool = false;

    fn renderer(settings: &MarchSettings) -> FieldRenderer {
        FieldRenderer::new(*settings)
    }

    fn render(&self, renderer: &mut FieldRenderer, view: &View<f32>, out: &mut Render) {
        out.resize(view.camera.width, view.camera.height);
        let (count, mut batch) = (view.camera.pixels(), Vec::new());
        for first in (0..count).step_by(BATCH) {
            render_batch(self, renderer, view, first, &mut batch);
            for (i, ray) in (first..).zip(&batch) {
                (0..3).for_each(|c| out.radiance.data[c * count + i] = ray.radiance[c]);
                out.depth.data[i] = ray.depth;
                out.opacity.data[i] = ray.opacity;
            }
        }
    }

    /// Nothing is kept of a picture: it is rendered again, `BATCH` pixels at a time.
    fn pull_back(
        &self,
        renderer: &mut FieldRenderer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        mut gradient: Option<&mut FieldGradient>,
    ) -> Tangent<f64> {
        cotangent.planes(view.camera.width, view.camera.height);
        let (mut batch, mut ray_gradients) = (Vec::new(), Vec::new());
        let mut pose = Tangent::zero();
        let kept = renderer.keep_slopes(true);
        for first in (0..view.camera.pixels()).step_by(BATCH) {
            let rays = render_batch(self, renderer, view, first, &mut batch);
            let cotangents: Vec<_> = pixels(view, first)
                .map(|(column, row)| {
                    let [r, g, b, depth, opacity] = cotangent.at(column, row);
                    RayRender { radiance: [r, g, b], depth, opacity }
                })
                .collect();
            let (field, gradient) = (&self.field, gradient.as_deref_mut());
            renderer.pull_back(field, &rays, &cotangents, gradient, Some(&mut ray_gradients));
            for ((column, row), ray) in pixels(view, first).zip(&ray_gradients) {
                pose = pose.plus(ray.to_pose(view, column, row));
            }
        }
        renderer.keep_slopes(kept);
        pose
    }
}
