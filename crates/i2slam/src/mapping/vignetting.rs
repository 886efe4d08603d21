//! Vignetting of the lens, from surface points that several keyframes see.
//!
//! The map tells where a point of one keyframe lies in another, and whether it is hidden there. Only
//! the pictures are compared, never the map's colours, so that what the map has wrongly learned so far
//! does not count. See [`i2slam_formation::vignetting`].

use super::context::MappingContext;
use super::depth_inpainting::MIN_SURFACE_OPACITY;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use crate::keyframes::project_rolling;
use crate::objective::Observation;
use i2slam_formation::vignetting::{RadiancePair, estimate, squared_radius};
use i2slam_formation::{CentreVelocity, ResponseCurve, Vignetting};
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Keyframes from which it is looked for.
const MIN_KEYFRAMES: usize = 4;
/// It is looked for again when there are so many times the keyframes: 4, 6, 9, 13, 19, 28, …
const GROWTH: (usize, usize) = (3, 2);
/// Most keyframes that are compared, each with each, spread over the sequence.
const MAX_VIEWS: usize = 14;
/// Points of a keyframe, about.
const POINTS: usize = 900;
/// Picture values between which a pixel is well exposed: below, steps of 8 bits are large in linear
/// light; above, the response is flat.
const EXPOSED: [f32; 2] = [0.08, 0.92];
/// Relative difference of depth up to which two views see one surface.
const MAX_DEPTH_DIFFERENCE: f64 = 0.02;
/// Standard deviation of the logarithm of linear values in a plain area.
const LOG_DEVIATION: f64 = 0.02;
/// Standard deviation of a point's place in a picture \[px\].
const PLACE_DEVIATION: f64 = 0.5;
/// Least loss of light in the corner that counts. Gloss and an inexact response leave less.
const MIN_LOSS: f64 = 0.025;

/// The vignetting of a session's lens.
#[derive(Clone, Debug)]
pub(crate) struct LensVignetting {
    lens: Vignetting<f32>,
    at_pixels: Vec<f32>,
}

impl LensVignetting {
    pub(crate) fn lens(&self) -> Vignetting<f32> {
        self.lens
    }

    /// Share of light at every pixel.
    pub(crate) fn at_pixels(&self) -> &[f32] {
        &self.at_pixels
    }

    /// True if it is time to look for it after a frame was mapped.
    pub(crate) fn is_due(context: &MappingContext<'_>, current: &Keyframe) -> bool {
        is_due(context.keyframes.len()) && context.is_keyframe(current.frame)
    }

    /// The vignetting that the keyframes show, `Some(None)` of a lens without; `None` where they show too
    /// little to tell.
    pub(crate) fn find(
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
    ) -> Option<Option<Self>> {
        if context.keyframes.len() < MIN_KEYFRAMES {
            return None;
        }
        let chosen = spread(context.keyframes.len(), MAX_VIEWS);
        let views = chosen.map(|i| View::new(mapper, context, &context.keyframes[i]));
        let views = views.collect::<Option<Vec<View>>>()?;
        let lens = lens_of_views(&views, context.camera, context.valid_mask)?;
        Some((!lens.is_none()).then(|| {
            let lens = Vignetting { coefficients: lens.coefficients.map(|c| c as f32) };
            Self { lens, at_pixels: lens.at_pixels(&context.camera.cast()) }
        }))
    }
}

fn is_due(keyframes: usize) -> bool {
    let next = |due: &usize| Some(due * GROWTH.0 / GROWTH.1);
    let mut all = std::iter::successors(Some(MIN_KEYFRAMES), next);
    all.find(|due| *due >= keyframes) == Some(keyframes)
}

/// At most `most` of `count` indices, evenly spread, the first and the last among them.
fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let chosen = count.min(most);
    (0..chosen).map(move |i| i * (count - 1) / (chosen - 1).max(1))
}

/// A keyframe, and the surface that the map shows from its pose.
struct View {
    world_from_camera: Pose<f64>,
    camera_from_world: Pose<f64>,
    /// Motion over the exposure.
    velocity: Tangent<f64>,
    /// Time from the first to the last row \[exposures\].
    readout: f64,
    /// Depth at mid-exposure \[m\]; 0 without a surface.
    surface: Image<f32>,
    observation: Arc<Observation>,
    curve: ResponseCurve<f32>,
}

/// Linear value of a picture at a place.
#[derive(Clone, Copy)]
struct LinearValue {
    /// Mean over the channels of its logarithm.
    log: f64,
    /// Change of that per pixel.
    slope: f64,
    squared_radius: f64,
}

impl View {
    fn new(
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
    ) -> Option<Self> {
        let estimate = &context.frames[keyframe.frame];
        let world_from_camera = estimate.middle();
        Some(Self {
            world_from_camera,
            camera_from_world: world_from_camera.inverse(),
            velocity: CentreVelocity::from(estimate.shutter).velocity,
            readout: estimate.readout,
            surface: mapper.render(world_from_camera)?.surface(MIN_SURFACE_OPACITY),
            observation: keyframe.observation.get(),
            curve: context.responses[estimate.response].curve(),
        })
    }

    /// Points of the surface in the world that the picture shows well exposed.
    fn points(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
    ) -> Vec<(Vec3<f64>, LinearValue)> {
        let stride = ((camera.pixels() as f64 / POINTS as f64).sqrt().ceil() as usize).max(1);
        let rows = (stride / 2..camera.height).step_by(stride);
        let places =
            rows.flat_map(|y| (stride / 2..camera.width).step_by(stride).map(move |x| (x, y)));
        let point = |(column, row): (usize, usize)| {
            let z = f64::from(self.surface.at(0, column, row));
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let point = camera.unproject(u, v, z);
            let value = (z > 0.0).then(|| self.linear_value(camera, valid_mask, point))??;
            Some((self.world_from_camera * point, value))
        };
        places.filter_map(point).collect()
    }

    /// Linear value at a point of the world; `None` where it is hidden or badly exposed.
    fn value_of(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point_in_world: Vec3<f64>,
    ) -> Option<LinearValue> {
        let point = self.camera_from_world * point_in_world;
        let (u, v) = (point.z > 0.0).then(|| camera.project(point))?;
        if !camera.contains(u, v, 0.0) {
            return None;
        }
        let surface = f64::from(self.surface.at(0, u as usize, v as usize));
        let is_seen = (point.z - surface).abs() < MAX_DEPTH_DIFFERENCE * point.z;
        is_seen.then(|| self.linear_value(camera, valid_mask, point))?
    }

    /// Linear value at a point in the camera at mid-exposure.
    fn linear_value(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point: Vec3<f64>,
    ) -> Option<LinearValue> {
        let (u, v) = project_rolling(camera, self.velocity, self.readout, point)?;
        if !camera.contains(u, v, 0.0)
            || valid_mask.is_some_and(|mask| !mask.at(0, u as usize, v as usize))
        {
            return None;
        }
        let colour = &self.observation.colour;
        let tap = colour.tap(u as f32, v as f32)?;
        let mut value =
            LinearValue { log: 0.0, slope: 0.0, squared_radius: squared_radius(camera, u, v) };
        for channel in 0..3 {
            let (picture, du, dv) = tap.sample(colour.plane(channel));
            if !(EXPOSED[0]..=EXPOSED[1]).contains(&picture) {
                return None;
            }
            let x = self.curve.inverse(channel, picture);
            let by_log = f64::from(self.curve.slope(channel, x) * x).max(1e-6);
            value.log += f64::from(x).ln() / 3.0;
            value.slope += f64::from(du.hypot(dv)) / by_log / 3.0;
        }
        Some(value)
    }
}

/// Vignetting that the views show, none if it is too weak to tell; `None` of too few points.
fn lens_of_views(
    views: &[View],
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
) -> Option<Vignetting<f64>> {
    let points: Vec<_> = views.par_iter().map(|view| view.points(camera, valid_mask)).collect();
    let pairs = (0..views.len()).flat_map(|i| (0..views.len()).map(move |j| (i, j)));
    let pairs: Vec<(usize, usize)> = pairs.filter(|(i, j)| i < j).collect();
    let compare = |&(i, j): &(usize, usize)| -> Vec<RadiancePair> {
        let seen = points[i].iter().filter_map(|(point, here)| {
            let there = views[j].value_of(camera, valid_mask, *point)?;
            Some(radiance_pair(*here, there))
        });
        seen.collect()
    };
    let found = estimate(&pairs.par_iter().map(compare).collect::<Vec<_>>())?;
    match found.is_significant(MIN_LOSS) {
        true => Some(found.vignetting),
        false => Some(Vignetting::default()),
    }
}

fn radiance_pair(here: LinearValue, there: LinearValue) -> RadiancePair {
    let by_place = PLACE_DEVIATION * here.slope.hypot(there.slope);
    RadiancePair {
        log_ratio: here.log - there.log,
        squared_radii: [here.squared_radius, there.squared_radius],
        deviation: LOG_DEVIATION.hypot(by_place),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_formation::{CameraResponse, Formation, FrameTone, NodeSpacing, StartCurve};

    const CAMERA: Camera<f64> =
        Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };
    const WALL: f64 = 2.0;

    /// Radiance of the wall `z` = 2 m, of several colours and with some texture.
    fn wall(x: f64, y: f64, channel: usize) -> f64 {
        let texture = (9.0 * x + channel as f64).sin() * (7.0 * y).cos();
        0.2 + 0.05 * texture + 0.03 * (2.0 * x - y).sin()
    }

    /// A view of the wall from a camera that has moved and turned, with gains of its own, in 8 bits.
    fn view(index: usize, lens: &Vignetting<f32>, start: StartCurve) -> View {
        let at = index as f64;
        let motion =
            [0.15 * at - 0.4, 0.1 * (2.0 * at).sin(), -0.05 * at, 0.02 * at.cos(), 0.0, 0.1];
        let world_from_camera = Pose::identity().retract(Tangent::from_array(motion));
        let (mut hdr, mut surface) = (Image::new(160, 120, 3), Image::new(160, 120, 1));
        for pixel in 0..CAMERA.pixels() {
            let (u, v) = Camera::<f64>::pixel_centre(pixel % 160, pixel / 160);
            let origin = world_from_camera.translation;
            let ray = world_from_camera * CAMERA.unproject(u, v, 1.0) - origin;
            let depth = (WALL - origin.z) / ray.z;
            let point = origin + ray * depth;
            surface.data[pixel] = depth as f32;
            (0..3).for_each(|c| hdr.plane_mut(c)[pixel] = wall(point.x, point.y, c) as f32);
        }
        let curve = CameraResponse::new(3, start, NodeSpacing::Power(2.2)).curve();
        let tone = FrameTone {
            log_exposure: 0.2 * (3.0 * at).sin() as f32,
            log_white_balance: [0.1 * at.cos() as f32, 0.0, -0.05],
        };
        let vignetting = lens.at_pixels(&CAMERA.cast());
        let mut picture = Image::default();
        Formation { tone, curve: &curve, vignetting: Some(&vignetting) }.form(&hdr, &mut picture);
        picture.data.iter_mut().for_each(|v| *v = (255.0 * v.clamp(0.0, 1.0)).round() / 255.0);
        View {
            world_from_camera,
            camera_from_world: world_from_camera.inverse(),
            velocity: Tangent::zero(),
            readout: 0.0,
            observation: Arc::new(Observation::new(picture, surface.clone())),
            surface,
            curve,
        }
    }

    fn views(count: usize, lens: &Vignetting<f32>) -> Vec<View> {
        (0..count).map(|index| view(index, lens, StartCurve::Shoulder)).collect()
    }

    #[test]
    fn vignetting_of_pictures_is_found_within_two_percent() {
        for coefficients in [[-0.25, -0.25, 0.0], [-0.5, 0.0, 0.0], [-0.05, -0.1, -0.15]] {
            let lens = Vignetting { coefficients };
            for count in [4, 7] {
                let found = lens_of_views(&views(count, &lens), &CAMERA, None).expect("a wall");
                let error = found.corner() / f64::from(lens.corner()) - 1.0;
                assert!(error.abs() < 0.02, "{coefficients:?}, {count} views: {found:?}");
            }
        }
    }

    #[test]
    fn a_lens_without_vignetting_has_none() {
        let found = lens_of_views(&views(6, &Vignetting::default()), &CAMERA, None);
        assert_eq!(found, Some(Vignetting::default()));
    }

    #[test]
    fn hidden_and_badly_exposed_points_do_not_count() {
        let lens = Vignetting { coefficients: [-0.25, -0.25, 0.0] };
        let mut hidden = views(6, &lens);
        hidden[2..].iter_mut().flat_map(|v| &mut v.surface.data).for_each(|d| *d *= 1.1);
        let seen = |views: &[View]| {
            let points = views[0].points(&CAMERA, None);
            let seen = |view: &View| {
                points.iter().filter(|(p, _)| view.value_of(&CAMERA, None, *p).is_some()).count()
            };
            views.iter().map(seen).collect::<Vec<_>>()
        };
        let counts = seen(&hidden);
        assert!(counts[0] > 500 && counts[1] > 300 && counts[2..] == [0; 4], "{counts:?}");
        let mut white = views(2, &lens);
        let colour = Image { data: vec![1.0; 3 * CAMERA.pixels()], ..Image::new(160, 120, 3) };
        white[1].observation = Arc::new(Observation::new(colour, white[1].surface.clone()));
        assert_eq!(seen(&white)[1], 0);
    }

    #[test]
    fn it_is_looked_for_ever_more_rarely() {
        let due: Vec<usize> = (0..50).filter(|count| is_due(*count)).collect();
        assert_eq!(due, [4, 6, 9, 13, 19, 28, 42]);
        assert_eq!(spread(5, 3).collect::<Vec<_>>(), [0, 2, 4]);
        assert_eq!(spread(2, 3).collect::<Vec<_>>(), [0, 1]);
    }
}
