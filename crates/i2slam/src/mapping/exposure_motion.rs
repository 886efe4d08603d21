//! Length of the motion during the exposures of keyframes, from their pictures.
//!
//! The map tells where other keyframes saw the surface of a blurred one, and the path in which direction
//! it moved; the length follows from the pictures alone, see [`i2slam_formation::exposure_length`].

use super::context::MappingContext;
use super::depth_inpainting::MIN_SURFACE_OPACITY;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use super::response::log_light;
use super::surface_pairs::{PictureSample, View};
use crate::objective::blur_length;
use i2slam_formation::exposure_length::{PARTNERS, SharedPoint, SurfacePoint, squared_length};
use i2slam_formation::response_estimate::MOMENTS;
use i2slam_formation::{CentreVelocity, ResponseCurve, ShutterPoses, Vignetting};
use i2slam_geometry::{Camera, Image, Tangent};
use rayon::prelude::*;

/// Blur from which a length is sought \[px\]: shorter ones are hardly told from none, and change nothing.
const MIN_BLUR: f64 = 1.0;
/// Blur of the other pictures over that, at most: theirs is known less well.
const MAX_BLUR_RATIO: f64 = 0.6;
/// Fewest other pictures: one alone has no instrument.
const MIN_PARTNERS: usize = 2;
/// Pixels of a picture, about.
const PIXELS: usize = 4000;
/// Rounds in which pictures are sampled along the motion found so far.
const ROUNDS: usize = 3;
/// Bounds of the square of a length over that of the round before.
const RATIO_BOUNDS: [f64; 2] = [0.04, 9.0];
/// Standard deviation up to which a length replaces the estimate by the map \[px\].
const MAX_DEVIATION: f64 = 0.3;

type Samples = [PictureSample; MOMENTS];

/// Finds the lengths of motions that pictures tell, from the shortest on; returns the places of these
/// keyframes among all.
pub(crate) fn find_exposure_motions(
    mapper: &mut dyn Mapper,
    context: &mut MappingContext<'_>,
    lens: Vignetting<f32>,
    frame_rate: f64,
) -> Vec<usize> {
    let keyframes = context.keyframes.iter();
    let starts: Vec<MotionStart> = keyframes
        .map(|keyframe| MotionStart::new(mapper, context, keyframe, frame_rate).unwrap_or_default())
        .collect();
    let mut blur: Vec<f64> = starts.iter().map(|start| start.known_blur).collect();
    let mut order: Vec<usize> = (0..starts.len()).collect();
    order.retain(|&k| starts[k].blur >= MIN_BLUR && !context.cancellation.is_cancelled());
    order.sort_by(|&a, &b| starts[a].blur.total_cmp(&starts[b].blur).then(a.cmp(&b)));
    let mut found = Vec::new();
    for keyframe in order {
        let partners = partners(keyframe, &blur, MAX_BLUR_RATIO * starts[keyframe].blur);
        let length = (partners.len() >= MIN_PARTNERS)
            .then(|| relative_length(mapper, context, (keyframe, &starts), &partners, lens));
        let Some(length) = length.flatten() else { continue };
        blur[keyframe] = starts[keyframe].blur * length;
        starts[keyframe].apply(context, keyframe, length);
        found.push(keyframe);
    }
    found
}

/// The keyframes nearest in time of so much blur at most.
fn partners(keyframe: usize, blur: &[f64], max_blur: f64) -> Vec<usize> {
    let mut partners: Vec<usize> =
        (0..blur.len()).filter(|&k| k != keyframe && blur[k] <= max_blur).collect();
    partners.sort_by_key(|other| (other.abs_diff(keyframe), *other));
    partners.truncate(PARTNERS);
    partners
}

/// A motion during an exposure whose direction is known.
#[derive(Clone, Copy)]
struct MotionStart {
    velocity: Tangent<f64>,
    /// Blur that it makes \[px\].
    blur: f64,
    /// Blur of the estimate so far \[px\]; `NaN` without a map.
    known_blur: f64,
}

impl Default for MotionStart {
    fn default() -> Self {
        Self { velocity: Tangent::zero(), blur: 0.0, known_blur: f64::NAN }
    }
}

impl MotionStart {
    /// The estimate so far; where it is below [`MIN_BLUR`] and the path moves by more, so much along the
    /// path, as a blurred map hides short motions altogether.
    fn new(
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
        frame_rate: f64,
    ) -> Option<Self> {
        let estimate = &context.frames[keyframe.frame];
        let centre = estimate.middle();
        let surface = mapper.render(centre)?.surface(MIN_SURFACE_OPACITY);
        let blur = |velocity| {
            let shutter: ShutterPoses<f64> = CentreVelocity { centre, velocity }.into();
            blur_length(context.camera, &shutter, &surface)
        };
        let velocity = CentreVelocity::from(estimate.shutter).velocity;
        let known_blur = blur(velocity);
        let known = Self { velocity, blur: known_blur, known_blur };
        if known_blur >= MIN_BLUR {
            return Some(known);
        }
        let step = keyframe.adjacent.motion_per_interval(estimate.timestamp, frame_rate);
        let along_path = step.map(|step| (step, blur(step))).filter(|(_, blur)| *blur >= MIN_BLUR);
        Some(along_path.map_or(known, |(step, blur)| Self {
            velocity: step.scaled(MIN_BLUR / blur),
            blur: MIN_BLUR,
            known_blur,
        }))
    }

    /// Takes the motion over, so many times as long; rows are read in the same time as before.
    fn apply(&self, context: &mut MappingContext<'_>, keyframe: usize, length: f64) {
        let estimate = &mut context.frames[context.keyframes[keyframe].frame];
        let shutter = CentreVelocity::from(estimate.shutter);
        let velocity = self.velocity.scaled(length);
        estimate.readout *= readout_ratio(shutter.velocity, velocity);
        estimate.shutter = CentreVelocity { velocity, ..shutter }.into();
    }
}

/// Length of a keyframe's motion over that which it starts with; `None` where its pictures do not tell.
fn relative_length(
    mapper: &mut dyn Mapper,
    context: &MappingContext<'_>,
    (keyframe, starts): (usize, &[MotionStart]),
    partners: &[usize],
    lens: Vignetting<f32>,
) -> Option<f64> {
    let MotionStart { velocity, blur, .. } = starts[keyframe];
    let mut view = |k: usize| View::new(mapper, context, &context.keyframes[k]);
    let own = view(keyframe)?;
    let others = partners.iter().map(|&k| view(k)).collect::<Option<Vec<View>>>()?;
    let (camera, valid_mask) = (context.camera, context.valid_mask);
    let pictures = Pictures { camera, valid_mask, curve: context.responses[0].curve(), lens };
    let (length, deviation) = pictures.relative_length(own.with_velocity(velocity), &others)?;
    (deviation * blur < MAX_DEVIATION).then_some(length)
}

/// What pictures of keyframes are compared by.
struct Pictures<'a> {
    camera: &'a Camera<f64>,
    valid_mask: Option<&'a Image<bool>>,
    curve: ResponseCurve<f32>,
    lens: Vignetting<f32>,
}

impl Pictures<'_> {
    /// Length of the motion of a picture over that of `own`, and its standard deviation.
    fn relative_length(&self, mut own: View, others: &[View]) -> Option<(f64, f64)> {
        let (mut length, mut deviation) = (1.0, f64::INFINITY);
        for _ in 0..ROUNDS {
            let found = squared_length(&self.surface_points(&own, others))?;
            let ratio = found.ratio.clamp(RATIO_BOUNDS[0], RATIO_BOUNDS[1]).sqrt();
            own = own.scaled(ratio);
            length *= ratio;
            deviation = 0.5 * found.deviation * length;
        }
        Some((length, deviation))
    }

    /// Points of a picture in all others, by channel.
    fn surface_points(&self, own: &View, others: &[View]) -> [Vec<SurfacePoint>; 3] {
        let Camera { width, height, .. } = *self.camera;
        let stride = (((width * height) as f64 / PIXELS as f64).sqrt().ceil() as usize).max(1);
        let row = |row: usize| -> Vec<[SurfacePoint; 3]> {
            let columns = (stride / 2..width).step_by(stride);
            columns.map(|column| self.surface_point(own, others, (column, row))).collect()
        };
        let rows: Vec<usize> = (stride / 2..height).step_by(stride).collect();
        let points: Vec<[SurfacePoint; 3]> = rows.into_par_iter().flat_map_iter(row).collect();
        std::array::from_fn(|channel| points.iter().map(|point| point[channel]).collect())
    }

    fn surface_point(
        &self,
        own: &View,
        others: &[View],
        pixel: (usize, usize),
    ) -> [SurfacePoint; 3] {
        let mut point = [SurfacePoint::default(); 3];
        for (partner, other) in others.iter().enumerate() {
            let Some([in_own, in_other]) =
                samples([own, other], self.camera, self.valid_mask, pixel)
            else {
                continue;
            };
            for (channel, point) in point.iter_mut().enumerate() {
                let (own, other) = (self.logs(&in_own, channel), self.logs(&in_other, channel));
                point[partner] = own.zip(other).map(|(own, other)| SharedPoint { own, other });
            }
        }
        point
    }

    fn logs(&self, samples: &Samples, channel: usize) -> Option<[f64; MOMENTS]> {
        let mut logs = [0.0; MOMENTS];
        for (log, sample) in logs.iter_mut().zip(samples) {
            *log = log_light(&self.curve, self.lens, sample, channel)?;
        }
        Some(logs)
    }
}

/// What the first picture shows of a surface point at its pixel along the motion of the second, and the
/// second along the motion of the first; `None` where either does not show all of it.
fn samples(
    [own, other]: [&View; 2],
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
    pixel: (usize, usize),
) -> Option<[Samples; 2]> {
    let place = place_within(pixel);
    let place_in_other =
        other.place_of(camera, valid_mask, own.surface_point(camera, place, 0.0)?)?;
    let along = |moving: &View, place: (f64, f64), seen: &View| -> Option<Samples> {
        let mut samples = [PictureSample::default(); MOMENTS];
        for (moment, sample) in samples.iter_mut().enumerate() {
            let time = (moment as f64 + 0.5) / MOMENTS as f64 - 0.5;
            let point = moving.surface_point(camera, place, time)?;
            *sample = seen.cubic_sample_of(camera, valid_mask, point)?;
        }
        Some(samples)
    };
    Some([along(other, place_in_other, own)?, along(own, place, other)?])
}

/// A place within a pixel, anywhere with equal chance: both pictures are interpolated alike then, which
/// takes away contrast between pixel centres.
fn place_within((column, row): (usize, usize)) -> (f64, f64) {
    // Golden ratios in two dimensions (Roberts' R2 sequence).
    let number = (column * 7919 + row) as f64;
    let within = |ratio: f64| (number * ratio).fract();
    (column as f64 + within(0.754_877_666_246_693), row as f64 + within(0.569_840_290_998_053))
}

/// Time in which rows are read, in exposures by a motion over that by a former one: rows are read in the
/// same time.
pub(super) fn readout_ratio(former: Tangent<f64>, velocity: Tangent<f64>) -> f64 {
    let length = |motion: Tangent<f64>| motion.to_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    let (former, velocity) = (length(former), length(velocity));
    if former > 0.0 && velocity > 0.0 { former / velocity } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{CAMERA, curve, exposed_view};
    use super::*;
    use i2slam_formation::FrameTone;
    use i2slam_geometry::Pose;

    /// Views of a wall with fine texture from near by, whose cameras move by a share of a motion.
    fn view(index: usize, share: f64) -> View {
        let at = index as f64;
        let motion = [0.04 * at, -0.03 * at, -1.2, 0.01 * at, 0.0, 0.02];
        let tone = FrameTone { log_exposure: 0.2 * at as f32 - 0.3, ..FrameTone::default() };
        let pose = Pose::identity().retract(Tangent::from_array(motion.map(|v| -v)));
        exposed_view(pose, velocity().scaled(share), &tone, &Vignetting::default(), index)
    }

    fn velocity() -> Tangent<f64> {
        Tangent::from_array([0.12, 0.03, 0.0, 0.0, 0.0, 0.0])
    }

    #[test]
    fn pictures_tell_by_how_much_a_motion_is_too_short() {
        let (camera, lens) = (&CAMERA, Vignetting::default());
        let pictures = Pictures { camera, valid_mask: None, curve: curve(), lens };
        let others = [view(1, 0.0), view(2, 0.2), view(3, 0.0)];
        for assumed in [0.6, 1.3] {
            let own = view(0, 1.0).scaled(assumed);
            let (length, deviation) = pictures.relative_length(own, &others).expect("texture");
            assert!((length * assumed - 1.0).abs() < 0.06, "{assumed}: {length} ± {deviation}");
        }
    }

    #[test]
    fn partners_are_the_nearest_that_are_sharp() {
        let blur = [0.1, 5.0, f64::NAN, 0.5, 4.0, 0.2, 0.3];
        assert_eq!(partners(4, &blur, 2.0), [3, 5, 6]);
        assert_eq!(partners(0, &blur, 0.06), [0_usize; 0]);
    }

    #[test]
    fn rows_are_read_in_the_same_time_by_another_motion() {
        assert_eq!(readout_ratio(velocity(), velocity().scaled(2.0)), 0.5);
        assert_eq!(readout_ratio(Tangent::zero(), velocity()), 1.0);
    }
}
