//! Length of the motion during the exposures of keyframes, from their pictures.
//!
//! The map tells where other keyframes saw the surface of a blurred one, and the path in which direction
//! it moved; the length follows from the pictures alone, see [`i2slam_formation::blur_estimate`].

use super::context::MappingContext;
use super::keyframe::Keyframe;
use super::log_light::{FoundVignetting, LogLight};
use super::mapper::Mapper;
use super::surface_pairs::spread;
use super::view::{MomentSamples, View, place_within, surface_of};
use crate::objective::blur_length;
use crate::reconstruction::FrameEstimate;
use i2slam_formation::blur_estimate::{PARTNERS, SharedPoint, SurfacePoint, squared_length};
use i2slam_formation::{CentreVelocity, ShutterPoses, Vignetting};
use i2slam_geometry::{Camera, Image, Tangent};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Blur of which a length is sought \[px\]: shorter ones change nothing, along longer ones twelve moments lie
/// too far apart.
const SOUGHT_BLUR: RangeInclusive<f64> = 1.0..=24.0;
/// Blur of the other pictures over that, at most: theirs is known less well.
const MAX_BLUR_RATIO: f64 = 0.6;
/// Fewest other pictures: one alone has no instrument.
const MIN_PARTNERS: usize = 2;
/// Most keyframes whose length is sought: each takes as long as several steps.
const MAX_SEARCHES: usize = 64;
/// Blur that the path makes in a frame interval over that of the estimate, from which the estimate says less
/// of the direction.
const MAX_PATH_RATIO: f64 = 2.0;
/// Blur over that of the path in a frame interval, at most: the shutter is open for no longer.
const MAX_OPEN_SHARE: f64 = 1.1;
/// Pixels of a picture, about.
const PIXELS: usize = 4000;
/// Pixels of surfaces that are kept, at most; others are rendered each time.
const MAX_KEPT_PIXELS: usize = 1 << 24;
/// Most rounds in which pictures are sampled along the motion found so far.
const MAX_ROUNDS: usize = 6;
/// Bounds of the square of a length over that of the round before, and its distance from 1 at the end.
const RATIO_BOUNDS: RangeInclusive<f64> = 0.04..=9.0;
const CONVERGED_RATIO: f64 = 0.05;
/// Length over that of the start below which it is as good as none.
const MIN_LENGTH: f64 = 0.04;
/// Standard deviation up to which a length replaces the estimate by the map \[px\].
const MAX_DEVIATION: f64 = 0.3;

/// Time in which the rows of a picture are read, and the frame rate.
#[derive(Clone, Copy)]
pub(crate) struct Timing {
    /// \[s\]
    pub(crate) readout: f64,
    /// \[1/s\]
    pub(crate) frame_rate: f64,
}

/// Finds the lengths of motions that pictures tell, from the shortest on; returns the places of these
/// keyframes among all.
pub(crate) fn find_exposure_motions(
    mapper: &mut dyn Mapper,
    context: &mut MappingContext<'_>,
    lens: Vignetting<f32>,
    timing: Timing,
) -> Vec<usize> {
    let cancellation = context.cancellation;
    let mut surfaces = KeyframeSurfaces::default();
    let start = |keyframe| {
        let surface = surfaces.get(mapper, context, keyframe)?;
        Some(MotionStart::new(context, &context.keyframes[keyframe], &surface, timing))
    };
    let starts: Vec<MotionStart> = (0..context.keyframes.len())
        .take_while(|_| !cancellation.is_cancelled())
        .map(start)
        .map(Option::unwrap_or_default)
        .collect();
    let mut max_blur: Vec<f64> = starts.iter().map(MotionStart::max_blur).collect();
    let mut found = Vec::new();
    for keyframe in searched(&starts).into_iter().take_while(|_| !cancellation.is_cancelled()) {
        let start = &starts[keyframe];
        let partners = partners(keyframe, &max_blur, MAX_BLUR_RATIO * start.blur);
        if partners.len() < MIN_PARTNERS {
            continue;
        }
        let mut view = |k| surfaces.view(mapper, context, k);
        let others = partners.into_iter().map(&mut view).collect::<Option<Vec<View>>>();
        let views = view(keyframe).zip(others);
        let length = views.and_then(|views| start.relative_length(context, views, lens));
        let Some(length) = length else { continue };
        max_blur[keyframe] = start.blur * length;
        if max_blur[keyframe] >= *SOUGHT_BLUR.start() {
            start.apply(&mut context.frames[context.keyframes[keyframe].frame], length);
            found.push(keyframe);
        }
    }
    found
}

/// Surfaces of the map as keyframes see them, most of which are asked for several times.
#[derive(Default)]
struct KeyframeSurfaces {
    /// By the place of the keyframe among all.
    kept: BTreeMap<usize, Arc<Image<f32>>>,
    pixels: usize,
}

impl KeyframeSurfaces {
    fn get(
        &mut self,
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        keyframe: usize,
    ) -> Option<Arc<Image<f32>>> {
        if let Some(surface) = self.kept.get(&keyframe) {
            return Some(Arc::clone(surface));
        }
        let surface = Arc::new(surface_of(mapper, context, &context.keyframes[keyframe])?);
        if self.pixels + surface.data.len() <= MAX_KEPT_PIXELS {
            self.pixels += surface.data.len();
            self.kept.insert(keyframe, Arc::clone(&surface));
        }
        Some(surface)
    }

    fn view(
        &mut self,
        mapper: &mut dyn Mapper,
        context: &MappingContext<'_>,
        keyframe: usize,
    ) -> Option<View> {
        let surface = self.get(mapper, context, keyframe)?;
        Some(View::with_surface(context, &context.keyframes[keyframe], surface))
    }
}

/// Keyframes whose length is sought, spread over time, from the least blurred on.
fn searched(starts: &[MotionStart]) -> Vec<usize> {
    let sought: Vec<usize> =
        (0..starts.len()).filter(|&k| SOUGHT_BLUR.contains(&starts[k].blur)).collect();
    let chosen = spread(sought.len(), MAX_SEARCHES);
    let mut searched: Vec<usize> = chosen.map(|place| sought[place]).collect();
    searched.sort_by(|&a, &b| starts[a].blur.total_cmp(&starts[b].blur).then(a.cmp(&b)));
    searched
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
    /// Blur that it makes \[px\]; `NaN` without a map.
    blur: f64,
    /// Blur that the path makes in a frame interval \[px\], where it is known.
    path_blur: Option<f64>,
    /// Time from the first to the last row \[exposures\].
    readout: f64,
    /// That time in frame intervals.
    readout_intervals: f64,
}

impl Default for MotionStart {
    fn default() -> Self {
        Self {
            velocity: Tangent::zero(),
            blur: f64::NAN,
            path_blur: None,
            readout: 0.0,
            readout_intervals: 0.0,
        }
    }
}

impl MotionStart {
    /// The estimate so far, or one along the path where that moves by far more: a blurred map shortens
    /// motions, down to none.
    fn new(
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
        surface: &Image<f32>,
        Timing { readout, frame_rate }: Timing,
    ) -> Self {
        let estimate = &context.frames[keyframe.frame];
        let centre = estimate.middle();
        let blur_of = |velocity| {
            let shutter: ShutterPoses<f64> = CentreVelocity { centre, velocity }.into();
            blur_length(context.camera, &shutter, surface)
        };
        let velocity = CentreVelocity::from(estimate.shutter).velocity;
        let step = keyframe.adjacent.motion_per_interval(estimate.timestamp, frame_rate);
        let path = step.map(|step| (step, blur_of(step)));
        let known = Self {
            velocity,
            blur: blur_of(velocity),
            path_blur: path.map(|(_, blur)| blur),
            readout: estimate.readout,
            readout_intervals: readout * frame_rate,
        };
        let Some((step, path_blur)) = path.filter(|path| path.1 > MAX_PATH_RATIO * known.blur)
        else {
            return known;
        };
        let blur = known.blur.max(*SOUGHT_BLUR.start()).min(path_blur);
        let start = Self { velocity: step.scaled(blur / path_blur), blur, ..known };
        Self { readout: start.readout_of(1.0), ..start }
    }

    /// Blur that the picture may have without the map's saying so.
    fn max_blur(&self) -> f64 {
        self.path_blur.map_or(self.blur, |path_blur| path_blur.max(self.blur))
    }

    /// Readout in exposures that are so many times as long: rows are read in the same time.
    fn readout_of(&self, length: f64) -> f64 {
        match self.path_blur {
            Some(path_blur) if self.blur > 0.0 => {
                self.readout_intervals * path_blur / (self.blur * length)
            }
            _ => self.readout / length,
        }
    }

    /// Length of the motion of a keyframe over that of this start, by others; `None` where their pictures do
    /// not tell.
    fn relative_length(
        &self,
        context: &MappingContext<'_>,
        (own, others): (View, Vec<View>),
        lens: Vignetting<f32>,
    ) -> Option<f64> {
        let own = own.with_motion(self.velocity, self.readout);
        let (camera, valid_mask) = (context.camera, context.valid_mask);
        let curve = context.responses[0].curve();
        let light = LogLight::new(&curve, FoundVignetting::new(lens, &curve));
        let pictures = Pictures { camera, valid_mask, light };
        let (length, deviation) = pictures.relative_length(own, &others)?;
        let blur = self.blur * length;
        let is_possible = self.path_blur.is_none_or(|path| blur <= MAX_OPEN_SHARE * path);
        (is_possible && deviation * self.blur < MAX_DEVIATION).then_some(length)
    }

    /// Takes the motion over, so many times as long.
    fn apply(&self, estimate: &mut FrameEstimate, length: f64) {
        let centre = estimate.middle();
        let velocity = self.velocity.scaled(length);
        estimate.shutter = CentreVelocity { centre, velocity }.into();
        estimate.readout = self.readout_of(length);
        estimate.blur_length = self.blur * length;
    }
}

/// Camera and response by which pictures of keyframes are compared.
struct Pictures<'a> {
    camera: &'a Camera<f64>,
    valid_mask: Option<&'a Image<bool>>,
    light: LogLight<'a>,
}

impl Pictures<'_> {
    /// Length of the motion of a picture over that of `own`, and its standard deviation; `None` where it does
    /// not settle, unless at far below the start.
    fn relative_length(&self, mut own: View, others: &[View]) -> Option<(f64, f64)> {
        let mut length = 1.0;
        for _ in 0..MAX_ROUNDS {
            let found = squared_length(&self.surface_points(&own, others))?;
            let ratio = found.ratio.clamp(*RATIO_BOUNDS.start(), *RATIO_BOUNDS.end()).sqrt();
            own = own.scaled(ratio);
            length *= ratio;
            if (found.ratio - 1.0).abs() < CONVERGED_RATIO || length < MIN_LENGTH {
                return Some((length, 0.5 * found.deviation * length));
            }
        }
        None
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
                let [own, other] =
                    [in_own, in_other].map(|samples| self.light.at_moments(&samples, channel));
                let both = own.zip(other);
                point[partner] = both.map(|(own, other)| SharedPoint { own, other });
            }
        }
        point
    }
}

/// Samples of the first picture around a surface point at its pixel along the motion of the second, and of
/// the second along the motion of the first; `None` where either does not show all of it.
fn samples(
    [own, other]: [&View; 2],
    camera: &Camera<f64>,
    valid_mask: Option<&Image<bool>>,
    pixel: (usize, usize),
) -> Option<[MomentSamples; 2]> {
    let place = place_within(pixel);
    let place_in_other =
        other.place_of(camera, valid_mask, own.surface_point(camera, place, 0.0)?)?;
    let in_own = own.samples_along(camera, valid_mask, (other, place_in_other))?;
    Some([in_own, other.samples_along(camera, valid_mask, (own, place))?])
}

#[cfg(test)]
mod tests {
    use super::super::view::tests::{CAMERA, curve, exposed_view};
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
        let curve = curve();
        let light = LogLight::new(&curve, FoundVignetting::new(Vignetting::default(), &curve));
        let pictures = Pictures { camera: &CAMERA, valid_mask: None, light };
        let others = [view(1, 0.0), view(2, 0.2), view(3, 0.0)];
        for assumed in [0.25, 0.6, 1.3] {
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

    fn start(blur: f64, path_blur: Option<f64>) -> MotionStart {
        let (readout, readout_intervals) = (0.8, 0.4);
        MotionStart { velocity: velocity(), blur, path_blur, readout, readout_intervals }
    }

    /// The shutter is open for `blur / path_blur` of a frame interval.
    #[test]
    fn rows_are_read_in_the_same_time_by_another_motion() {
        assert!((start(2.0, Some(8.0)).readout_of(1.0) - 1.6).abs() < 1e-12);
        assert!((start(2.0, Some(8.0)).readout_of(2.0) - 0.8).abs() < 1e-12);
        assert!((start(2.0, None).readout_of(2.0) - 0.4).abs() < 1e-12);
    }

    /// A camera that moves all the time has no pictures of which the map says truly that they are sharp.
    #[test]
    fn pictures_that_may_be_blurred_are_no_partners() {
        let max_blur: Vec<f64> = [0.2, 0.5, 0.3].map(|b| start(b, Some(4.0)).max_blur()).to_vec();
        assert_eq!(partners(1, &max_blur, MAX_BLUR_RATIO * 4.0), [0_usize; 0]);
        assert_eq!(start(0.2, None).max_blur(), 0.2);
        assert!(MotionStart::default().max_blur().is_nan());
    }

    #[test]
    fn searches_are_spread_over_time_from_the_least_blurred_on() {
        let starts: Vec<MotionStart> =
            (0..200).map(|k| start(0.5 + f64::from(k % 40), None)).collect();
        let searched = searched(&starts);
        assert!((32..=MAX_SEARCHES).contains(&searched.len()), "{}", searched.len());
        assert!(searched.iter().any(|k| *k < 20) && searched.iter().any(|k| *k > 180));
        assert!(searched.windows(2).all(|pair| starts[pair[0]].blur <= starts[pair[1]].blur));
        assert!(searched.iter().all(|k| SOUGHT_BLUR.contains(&starts[*k].blur)));
    }
}
