//! A keyframe with the surface that the map shows from its pose.

use super::context::MappingContext;
use super::depth_inpainting::MIN_SURFACE_OPACITY;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use crate::keyframes::project_rolling;
use crate::objective::Observation;
use i2slam_formation::CentreVelocity;
use i2slam_formation::blur_estimate::MOMENTS;
use i2slam_formation::vignetting::squared_radius;
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};
use std::sync::Arc;

/// Relative difference of depth up to which two views see one surface.
const MAX_DEPTH_DIFFERENCE: f64 = 0.02;

/// A picture at the place of a surface point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PictureSample {
    /// Picture values of red, green and blue.
    pub(super) values: [f32; 3],
    /// Squared distance from the middle of the picture, in half diagonals.
    pub(super) squared_radius: f64,
}

/// A place within a pixel, anywhere with equal chance: pictures that are compared are interpolated alike
/// then, which takes away contrast between pixel centres.
pub(super) fn place_within((column, row): (usize, usize)) -> (f64, f64) {
    // Golden ratios in two dimensions (Roberts' R2 sequence).
    let number = (column * 7919 + row) as f64;
    let within = |ratio: f64| (number * ratio).fract();
    (column as f64 + within(0.754_877_666_246_693), row as f64 + within(0.569_840_290_998_053))
}

/// A picture at moments of an exposure.
pub(super) type MomentSamples = [PictureSample; MOMENTS];

/// Depth \[m\] of the surface that the map shows from a keyframe at mid-exposure, 0 without one; `None`
/// without a map.
pub(super) fn surface_of(
    mapper: &mut dyn Mapper,
    context: &MappingContext<'_>,
    keyframe: &Keyframe,
) -> Option<Image<f32>> {
    let pose = context.frames[keyframe.frame].middle();
    Some(mapper.render(pose)?.surface(MIN_SURFACE_OPACITY))
}

/// A keyframe, and the surface that the map shows from its pose.
pub(super) struct View {
    world_from_camera: Pose<f64>,
    camera_from_world: Pose<f64>,
    /// Motion over the exposure.
    velocity: Tangent<f64>,
    /// Time from the first to the last row \[exposures\].
    readout: f64,
    /// Depth at mid-exposure \[m\]; 0 without a surface.
    surface: Arc<Image<f32>>,
    observation: Arc<Observation>,
    /// Place among all frames.
    frame: usize,
}

impl View {
    pub(super) fn new(
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
    ) -> Option<Self> {
        let surface = surface_of(mapper, context, keyframe)?;
        Some(Self::with_surface(context, keyframe, Arc::new(surface)))
    }

    /// A keyframe with the [surface](surface_of) that the map shows from its pose.
    pub(super) fn with_surface(
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
        surface: Arc<Image<f32>>,
    ) -> Self {
        let estimate = &context.frames[keyframe.frame];
        let world_from_camera = estimate.middle();
        Self {
            world_from_camera,
            camera_from_world: world_from_camera.inverse(),
            velocity: CentreVelocity::from(estimate.shutter).velocity,
            readout: estimate.readout,
            surface,
            observation: keyframe.observation.get(),
            frame: keyframe.frame,
        }
    }

    /// Place among all frames.
    pub(super) fn frame(&self) -> usize {
        self.frame
    }

    /// Points of the surface in the world, some `count`.
    pub(super) fn points(&self, camera: &Camera<f64>, count: usize) -> Vec<Vec3<f64>> {
        let stride = ((camera.pixels() as f64 / count as f64).sqrt().ceil() as usize).max(1);
        let rows = (stride / 2..camera.height).step_by(stride);
        let places =
            rows.flat_map(|y| (stride / 2..camera.width).step_by(stride).map(move |x| (x, y)));
        let point = |(column, row): (usize, usize)| {
            let z = f64::from(self.surface.at(0, column, row));
            let (u, v) = place_within((column, row));
            (z > 0.0).then(|| self.world_from_camera * camera.unproject(u, v, z))
        };
        places.filter_map(point).collect()
    }

    /// The picture at a place, with the contrast between pixel centres.
    pub(super) fn sample(&self, camera: &Camera<f64>, (u, v): (f64, f64)) -> Option<PictureSample> {
        let colour = &self.observation.colour;
        let tap = colour.cubic_tap(u as f32, v as f32)?;
        Some(PictureSample {
            values: std::array::from_fn(|channel| tap.sample(colour.plane(channel))),
            squared_radius: squared_radius(camera, u, v),
        })
    }

    /// Change of the picture values per pixel along rows and columns, by channel.
    pub(super) fn slopes(&self, (u, v): (f64, f64)) -> Option<[[f32; 2]; 3]> {
        let colour = &self.observation.colour;
        let tap = colour.tap(u as f32, v as f32)?;
        Some(std::array::from_fn(|channel| {
            let (_, by_u, by_v) = tap.sample(colour.plane(channel));
            [by_u, by_v]
        }))
    }

    /// The way that the surface at a place of `moving` takes through the picture during the exposure of
    /// that; `None` where it is not seen all the time.
    pub(super) fn places_along(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        (moving, place): (&Self, (f64, f64)),
    ) -> Option<[(f64, f64); MOMENTS]> {
        let mut places = [(0.0, 0.0); MOMENTS];
        for (moment, at) in places.iter_mut().enumerate() {
            let time = (moment as f64 + 0.5) / MOMENTS as f64 - 0.5;
            let point = moving.surface_point(camera, place, time)?;
            *at = self.place_of(camera, valid_mask, point)?;
        }
        Some(places)
    }

    /// The picture along [that way](Self::places_along).
    pub(super) fn samples_along(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        moving: (&Self, (f64, f64)),
    ) -> Option<MomentSamples> {
        let places = self.places_along(camera, valid_mask, moving)?;
        let mut samples = [PictureSample::default(); MOMENTS];
        for (sample, place) in samples.iter_mut().zip(places) {
            *sample = self.sample(camera, place)?;
        }
        Some(samples)
    }

    /// The keyframe with another motion over its exposure, and time from the first to the last row
    /// \[exposures\].
    pub(super) fn with_motion(self, velocity: Tangent<f64>, readout: f64) -> Self {
        Self { velocity, readout, ..self }
    }

    /// The keyframe with an exposure that is so many times as long, its rows read in the same time.
    pub(super) fn scaled(self, length: f64) -> Self {
        let (velocity, readout) = (self.velocity.scaled(length), self.readout / length);
        Self { velocity, readout, ..self }
    }

    /// The point of the world that a place in the picture shows at a time of the exposure, from -½ to ½;
    /// `None` without a surface.
    pub(super) fn surface_point(
        &self,
        camera: &Camera<f64>,
        (u, v): (f64, f64),
        time: f64,
    ) -> Option<Vec3<f64>> {
        let z = f64::from(self.surface.at(0, u as usize, v as usize));
        let time = time + self.readout * (v / camera.height as f64 - 0.5);
        let moved = Pose::identity().retract(self.velocity.scaled(time));
        (z > 0.0).then(|| self.world_from_camera * (moved * camera.unproject(u, v, z)))
    }

    /// Place of a point of the world in the picture; `None` where it is hidden or outside.
    pub(super) fn place_of(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point_in_world: Vec3<f64>,
    ) -> Option<(f64, f64)> {
        self.place(camera, valid_mask, self.seen_point(camera, point_in_world)?)
    }

    /// A point of the world in the camera at mid-exposure; `None` where it is hidden or outside.
    fn seen_point(&self, camera: &Camera<f64>, point_in_world: Vec3<f64>) -> Option<Vec3<f64>> {
        let point = self.camera_from_world * point_in_world;
        let (u, v) = (point.z > 0.0).then(|| camera.project(point))?;
        if !camera.contains(u, v, 0.0) {
            return None;
        }
        let surface = f64::from(self.surface.at(0, u as usize, v as usize));
        ((point.z - surface).abs() < MAX_DEPTH_DIFFERENCE * point.z).then_some(point)
    }

    /// Where the picture shows a point in the camera at mid-exposure; `None` outside of it and of the
    /// valid mask.
    fn place(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point: Vec3<f64>,
    ) -> Option<(f64, f64)> {
        let (u, v) = project_rolling(camera, self.velocity, self.readout, point)?;
        let is_valid = |mask: &Image<bool>| mask.at(0, u as usize, v as usize);
        (camera.contains(u, v, 0.0) && valid_mask.is_none_or(is_valid)).then_some((u, v))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use i2slam_formation::{
        CameraResponse, Formation, FrameTone, NodeSpacing, ResponseCurve, StartCurve, Vignetting,
    };

    pub(in crate::mapping) const CAMERA: Camera<f64> =
        Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };
    const WALL: f64 = 2.0;

    /// Radiance of the wall `z` = 2 m, of several colours and with some texture.
    fn wall(x: f64, y: f64, channel: usize) -> f64 {
        let texture = (9.0 * x + channel as f64).sin() * (7.0 * y).cos();
        0.2 + 0.05 * texture + 0.03 * (2.0 * x - y).sin()
    }

    /// The response of the cameras.
    pub(in crate::mapping) fn curve() -> ResponseCurve<f32> {
        CameraResponse::new(3, StartCurve::Shoulder, NodeSpacing::Power(2.2)).curve()
    }

    /// Moments of an exposure that are averaged.
    const MOMENTS: usize = 24;

    /// A view of the wall from a camera that moves while the shutter is open, in 8 bits.
    pub(in crate::mapping) fn exposed_view(
        world_from_camera: Pose<f64>,
        velocity: Tangent<f64>,
        tone: &FrameTone<f32>,
        lens: &Vignetting<f32>,
        frame: usize,
    ) -> View {
        let (mut hdr, mut surface) = (Image::new(160, 120, 3), Image::new(160, 120, 1));
        for moment in 0..MOMENTS {
            let time = (moment as f64 + 0.5) / MOMENTS as f64 - 0.5;
            let pose = world_from_camera * Pose::identity().retract(velocity.scaled(time));
            for pixel in 0..CAMERA.pixels() {
                let (u, v) = Camera::<f64>::pixel_centre(pixel % 160, pixel / 160);
                let ray = |pose: Pose<f64>| {
                    let ray = pose * CAMERA.unproject(u, v, 1.0) - pose.translation;
                    (ray, (WALL - pose.translation.z) / ray.z)
                };
                let (direction, depth) = ray(pose);
                let point = pose.translation + direction * depth;
                surface.data[pixel] = ray(world_from_camera).1 as f32;
                for channel in 0..3 {
                    let share = wall(point.x, point.y, channel) as f32 / MOMENTS as f32;
                    hdr.plane_mut(channel)[pixel] += share;
                }
            }
        }
        let (curve, vignetting) = (curve(), lens.at_pixels(&CAMERA.cast()));
        let mut picture = Image::default();
        let formation = Formation { tone: *tone, curve: &curve, vignetting: Some(&vignetting) };
        formation.form(&hdr, &mut picture);
        picture.data.iter_mut().for_each(|v| *v = (255.0 * v.clamp(0.0, 1.0)).round() / 255.0);
        View {
            world_from_camera,
            camera_from_world: world_from_camera.inverse(),
            velocity,
            readout: 0.0,
            observation: Arc::new(Observation::new(picture, surface.clone())),
            surface: Arc::new(surface),
            frame,
        }
    }

    #[test]
    fn hidden_points_are_not_seen() {
        let views = [0.0, 0.1].map(|x| {
            let pose = Pose::identity().retract(Tangent::from_array([x, 0.0, 0.0, 0.0, 0.0, 0.0]));
            let tone = FrameTone::default();
            exposed_view(pose, Tangent::zero(), &tone, &Vignetting::default(), 0)
        });
        let [first, mut second] = views;
        let points = first.points(&CAMERA, 900);
        let seen = |view: &View| {
            points.iter().filter(|p| view.place_of(&CAMERA, None, **p).is_some()).count()
        };
        assert!(seen(&first) > 500 && seen(&second) > 300, "{} {}", seen(&first), seen(&second));
        Arc::make_mut(&mut second.surface).data.iter_mut().for_each(|d| *d *= 1.1);
        assert_eq!(seen(&second), 0);
    }
}
