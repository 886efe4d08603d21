//! Surface points that several keyframes see, with what their pictures show there.
//!
//! The map tells where a point of one keyframe lies in another, and whether it is hidden there. Only
//! the pictures are compared, never the map's colours, so that what the map has wrongly learned so far
//! does not count.

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
use rayon::prelude::*;
use std::sync::Arc;

/// Keyframes from which they are compared.
const MIN_KEYFRAMES: usize = 4;
/// They are compared again when there are so many times the keyframes: 4, 6, 9, 13, 19, 28, …
const GROWTH: (usize, usize) = (3, 2);
/// Most keyframes that are compared, each with each, spread over the sequence.
const MAX_VIEWS: usize = 14;
/// Points of a keyframe, about.
const POINTS: usize = 900;
/// Relative difference of depth up to which two views see one surface.
const MAX_DEPTH_DIFFERENCE: f64 = 0.02;
/// Standard deviation of a point's place in a picture \[px\].
pub(super) const PLACE_DEVIATION: f64 = 0.5;

/// A picture at the place of a surface point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PictureSample {
    /// Picture values of red, green and blue.
    pub(super) values: [f32; 3],
    /// Their change per pixel.
    pub(super) slopes: [f32; 3],
    /// Squared distance from the middle of the picture, in half diagonals.
    pub(super) squared_radius: f64,
}

/// A place within a pixel, anywhere with equal chance: pictures that are compared are interpolated alike
/// then, which
/// takes away contrast between pixel centres.
pub(super) fn place_within((column, row): (usize, usize)) -> (f64, f64) {
    // Golden ratios in two dimensions (Roberts' R2 sequence).
    let number = (column * 7919 + row) as f64;
    let within = |ratio: f64| (number * ratio).fract();
    (column as f64 + within(0.754_877_666_246_693), row as f64 + within(0.569_840_290_998_053))
}

/// A picture at moments of an exposure.
pub(super) type MomentSamples = [PictureSample; MOMENTS];

/// A surface point in two keyframes.
pub(super) type SamplePair = [PictureSample; 2];

/// Points that two keyframes see.
pub(crate) struct ComparedViews {
    /// Places of the two among all frames.
    pub(super) frames: [usize; 2],
    pub(super) points: Vec<SamplePair>,
}

/// True if it is time to compare keyframes after a frame was mapped.
pub(crate) fn is_comparison_due(context: &MappingContext<'_>, current: &Keyframe) -> bool {
    is_due(context.keyframes.len()) && context.is_keyframe(current.frame)
}

fn is_due(keyframes: usize) -> bool {
    let next = |due: &usize| Some(due * GROWTH.0 / GROWTH.1);
    let mut all = std::iter::successors(Some(MIN_KEYFRAMES), next);
    all.find(|due| *due >= keyframes) == Some(keyframes)
}

/// Points that pairs of keyframes see; none of too few keyframes or an empty map.
pub(crate) fn compare_keyframes(
    mapper: &mut dyn Mapper,
    context: &MappingContext<'_>,
) -> Vec<ComparedViews> {
    if context.keyframes.len() < MIN_KEYFRAMES {
        return Vec::new();
    }
    let chosen = spread(context.keyframes.len(), MAX_VIEWS);
    let views = chosen.map(|i| View::new(mapper, context, &context.keyframes[i]));
    let views = views.collect::<Option<Vec<View>>>().unwrap_or_default();
    compare(&views, context.camera, context.valid_mask)
}

/// At most `most` of `count` indices, evenly spread, the first and the last among them.
pub(super) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let chosen = count.min(most);
    (0..chosen).map(move |i| i * (count - 1) / (chosen - 1).max(1))
}

/// Points of each pair of views.
fn compare(
    views: &[View],
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
) -> Vec<ComparedViews> {
    let points: Vec<_> = views.par_iter().map(|view| view.points(camera, valid_mask)).collect();
    let pairs = (0..views.len()).flat_map(|i| (0..views.len()).map(move |j| (i, j)));
    let pairs: Vec<(usize, usize)> = pairs.filter(|(i, j)| i < j).collect();
    let of_pair = |&(i, j): &(usize, usize)| {
        let seen = points[i].iter().filter_map(|(point, here)| {
            Some([*here, views[j].sample_of(camera, valid_mask, *point)?])
        });
        ComparedViews { frames: [views[i].frame, views[j].frame], points: seen.collect() }
    };
    pairs.par_iter().map(of_pair).collect()
}

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

    /// Points of the surface in the world.
    fn points(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
    ) -> Vec<(Vec3<f64>, PictureSample)> {
        let stride = ((camera.pixels() as f64 / POINTS as f64).sqrt().ceil() as usize).max(1);
        let rows = (stride / 2..camera.height).step_by(stride);
        let places =
            rows.flat_map(|y| (stride / 2..camera.width).step_by(stride).map(move |x| (x, y)));
        let point = |(column, row): (usize, usize)| {
            let z = f64::from(self.surface.at(0, column, row));
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let point = camera.unproject(u, v, z);
            let sample = (z > 0.0).then(|| self.sample(camera, valid_mask, point))??;
            Some((self.world_from_camera * point, sample))
        };
        places.filter_map(point).collect()
    }

    /// The picture at a point of the world; `None` where it is hidden or outside.
    fn sample_of(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point_in_world: Vec3<f64>,
    ) -> Option<PictureSample> {
        let point = self.seen_point(camera, point_in_world)?;
        self.sample(camera, valid_mask, point)
    }

    /// [`sample_of`](Self::sample_of) that keeps the contrast between pixel centres, without slopes.
    pub(super) fn cubic_sample_of(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point_in_world: Vec3<f64>,
    ) -> Option<PictureSample> {
        let (u, v) = self.place_of(camera, valid_mask, point_in_world)?;
        let colour = &self.observation.colour;
        let tap = colour.cubic_tap(u as f32, v as f32)?;
        Some(PictureSample {
            values: std::array::from_fn(|channel| tap.sample(colour.plane(channel))),
            slopes: [0.0; 3],
            squared_radius: squared_radius(camera, u, v),
        })
    }

    /// The picture along the way that the surface at a place of `moving` takes through it during the
    /// exposure of that; `None` where it is not seen all the time.
    pub(super) fn samples_along(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        (moving, place): (&Self, (f64, f64)),
    ) -> Option<MomentSamples> {
        let mut samples = [PictureSample::default(); MOMENTS];
        for (moment, sample) in samples.iter_mut().enumerate() {
            let time = (moment as f64 + 0.5) / MOMENTS as f64 - 0.5;
            let point = moving.surface_point(camera, place, time)?;
            *sample = self.cubic_sample_of(camera, valid_mask, point)?;
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

    /// Where the picture shows a point in the camera at mid-exposure; `None` where it recorded nothing.
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

    /// The picture at a point in the camera at mid-exposure.
    fn sample(
        &self,
        camera: &Camera<f64>,
        valid_mask: Option<&Image<bool>>,
        point: Vec3<f64>,
    ) -> Option<PictureSample> {
        let (u, v) = self.place(camera, valid_mask, point)?;
        let colour = &self.observation.colour;
        let tap = colour.tap(u as f32, v as f32)?;
        let channels = std::array::from_fn(|channel| tap.sample(colour.plane(channel)));
        Some(PictureSample {
            values: channels.map(|(value, _, _): (f32, f32, f32)| value),
            slopes: channels.map(|(_, du, dv)| du.hypot(dv)),
            squared_radius: squared_radius(camera, u, v),
        })
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
    /// Largest change of gains from their mean over views: of exposure, in stops, and the logarithm of red.
    #[derive(Clone, Copy)]
    pub(in crate::mapping) struct Gains {
        pub(in crate::mapping) stops: f32,
        pub(in crate::mapping) red: f32,
    }

    pub(in crate::mapping) const GAINS: Gains = Gains { stops: 0.3, red: 0.09 };

    /// Radiance of the wall `z` = 2 m, of several colours and with some texture.
    fn wall(x: f64, y: f64, channel: usize) -> f64 {
        let texture = (9.0 * x + channel as f64).sin() * (7.0 * y).cos();
        0.2 + 0.05 * texture + 0.03 * (2.0 * x - y).sin()
    }

    /// The response of the cameras of [`views`].
    pub(in crate::mapping) fn curve() -> ResponseCurve<f32> {
        CameraResponse::new(3, StartCurve::Shoulder, NodeSpacing::Power(2.2)).curve()
    }

    /// Moments of an exposure that are averaged.
    const MOMENTS: usize = 24;

    /// A view of the wall from a camera that has moved and turned, with gains of its own, in 8 bits.
    fn view(index: usize, lens: &Vignetting<f32>, gains: Gains) -> View {
        let at = index as f64;
        let motion =
            [0.15 * at - 0.4, 0.1 * (2.0 * at).sin(), -0.05 * at, 0.02 * at.cos(), 0.0, 0.1];
        let tone = FrameTone {
            log_exposure: gains.stops * 2.0_f32.ln() * (3.0 * at).sin() as f32,
            log_white_balance: [gains.red * at.cos() as f32, 0.0, -0.05],
        };
        let pose = Pose::identity().retract(Tangent::from_array(motion));
        exposed_view(pose, Tangent::zero(), &tone, lens, index)
    }

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

    fn views(count: usize, lens: &Vignetting<f32>) -> Vec<View> {
        (0..count).map(|index| view(index, lens, GAINS)).collect()
    }

    /// Points of pairs of so many views through a lens, whose gains change.
    pub(in crate::mapping) fn compared_views(
        count: usize,
        lens: &Vignetting<f32>,
        gains: Gains,
    ) -> Vec<ComparedViews> {
        let views: Vec<View> = (0..count).map(|index| view(index, lens, gains)).collect();
        compare(&views, &CAMERA, None)
    }

    #[test]
    fn hidden_points_do_not_count() {
        let mut hidden = views(6, &Vignetting::default());
        let surfaces = hidden[2..].iter_mut().map(|view| Arc::make_mut(&mut view.surface));
        surfaces.flat_map(|surface| &mut surface.data).for_each(|d| *d *= 1.1);
        let points = hidden[0].points(&CAMERA, None);
        let seen = |view: &View| {
            points.iter().filter(|(p, _)| view.sample_of(&CAMERA, None, *p).is_some()).count()
        };
        let counts: Vec<usize> = hidden.iter().map(seen).collect();
        assert!(counts[0] > 500 && counts[1] > 300 && counts[2..] == [0; 4], "{counts:?}");
    }

    #[test]
    fn keyframes_are_compared_ever_more_rarely() {
        let due: Vec<usize> = (0..50).filter(|count| is_due(*count)).collect();
        assert_eq!(due, [4, 6, 9, 13, 19, 28, 42]);
        assert_eq!(spread(5, 3).collect::<Vec<_>>(), [0, 2, 4]);
        assert_eq!(spread(2, 3).collect::<Vec<_>>(), [0, 1]);
    }
}
