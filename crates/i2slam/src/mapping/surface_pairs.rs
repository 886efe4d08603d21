//! Surface points that several keyframes see, with what their pictures show there.
//!
//! The map tells where a point of one keyframe lies in another, and whether it is hidden there. Only
//! the pictures are compared, never the map's colours, so that what the map has wrongly learned so far
//! does not count.
//!
//! A camera that is exposed for longer takes pictures that are brighter and more blurred. In these, dark
//! places have light of what is around them, as if the response were flatter in the dark. So each picture is
//! averaged along the motion of the other one, `x` being the linear value of a picture value and `p_i(t)` the
//! place in picture `i` of what is seen at time `t` of the exposure of the other:
//!
//! ```text
//! x̄₁ = mean_t x₁(p₁(t))        x̄₂ = mean_t x₂(p₂(t))
//! ```
//!
//! Both have both blurs then, and differ in exposure, white balance and vignetting alone.

use super::context::MappingContext;
use super::keyframe::Keyframe;
use super::mapper::Mapper;
use super::view::View;
use i2slam_formation::ResponseCurve;
use i2slam_formation::vignetting::squared_radius;
use i2slam_geometry::{Camera, Image, Vec3};
use rayon::prelude::*;

/// Brightest picture value that is not clipped.
pub(super) const MAX_VALUE: f32 = 0.985;

/// Keyframes from which they are compared.
const MIN_KEYFRAMES: usize = 4;
/// They are compared again when there are so many times the keyframes: 4, 6, 9, 13, 19, 28, …
const GROWTH: (usize, usize) = (3, 2);
/// Most keyframes that are compared, each with each, spread over the sequence.
const MAX_VIEWS: usize = 14;
/// Points of a keyframe, about.
const POINTS: usize = 900;
/// Standard deviation of a point's place in a picture \[px\].
pub(super) const PLACE_DEVIATION: f64 = 0.5;

/// A picture at a surface point, with the blur of the other picture besides its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BlurredSample {
    /// Picture values of red, green and blue; 1 where a part of the light is clipped.
    pub(super) values: [f32; 3],
    /// Their change per pixel.
    pub(super) slopes: [f32; 3],
    /// Length over which the picture is averaged \[px\].
    pub(super) blur: f64,
    /// Squared distance from the middle of the picture, in half diagonals.
    pub(super) squared_radius: f64,
}

/// A surface point in two keyframes.
pub(super) type SamplePair = [BlurredSample; 2];

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
    let curves: Vec<_> = context.responses.iter().map(|response| response.curve()).collect();
    let curve_of_frame = |frame: usize| &curves[context.frames[frame].response];
    compare(&views, (context.camera, context.valid_mask), curve_of_frame)
}

/// At most `most` of `count` indices, evenly spread, the first and the last among them.
pub(super) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let chosen = count.min(most);
    (0..chosen).map(move |i| i * (count - 1) / (chosen - 1).max(1))
}

/// Points of each pair of views.
fn compare<'a>(
    views: &[View],
    (camera, valid_mask): (&Camera<f64>, Option<&Image<bool>>),
    curve_of_frame: impl Fn(usize) -> &'a ResponseCurve<f32> + Sync,
) -> Vec<ComparedViews> {
    let points: Vec<_> = views.par_iter().map(|view| view.points(camera, POINTS)).collect();
    let pairs = (0..views.len()).flat_map(|i| (0..views.len()).map(move |j| (i, j)));
    let pairs: Vec<(usize, usize)> = pairs.filter(|(i, j)| i < j).collect();
    let of_pair = |&(i, j): &(usize, usize)| {
        let both = [&views[i], &views[j]];
        let frames = both.map(View::frame);
        let curves = frames.map(&curve_of_frame);
        let pair = |point: &Vec3<f64>| sample_pair(both, curves, (camera, valid_mask), *point);
        // Half of either, so that both are sampled alike, in the order of rows.
        let halves = points[i].iter().step_by(2).zip(points[j].iter().skip(1).step_by(2));
        let of_both = halves.flat_map(|(of_first, of_second)| [of_first, of_second]);
        ComparedViews { frames, points: of_both.filter_map(pair).collect() }
    };
    pairs.par_iter().map(of_pair).collect()
}

/// A point of the world in two views, each with the blur of both; `None` where one does not see it all the
/// time.
fn sample_pair(
    [first, second]: [&View; 2],
    curves: [&ResponseCurve<f32>; 2],
    (camera, valid_mask): (&Camera<f64>, Option<&Image<bool>>),
    point: Vec3<f64>,
) -> Option<SamplePair> {
    let place = |view: &View| view.place_of(camera, valid_mask, point);
    let (in_first, in_second) = (place(first)?, place(second)?);
    let along_second = first.places_along(camera, valid_mask, (second, in_second))?;
    let along_first = second.places_along(camera, valid_mask, (first, in_first))?;
    Some([
        mean_sample(first, (camera, in_first), &along_second, curves[0])?,
        mean_sample(second, (camera, in_second), &along_first, curves[1])?,
    ])
}

/// The mean of the light that a picture shows at places, about one of its points.
fn mean_sample(
    view: &View,
    (camera, middle): (&Camera<f64>, (f64, f64)),
    places: &[(f64, f64)],
    curve: &ResponseCurve<f32>,
) -> Option<BlurredSample> {
    let count = places.len() as f32;
    let (mut light, mut slopes, mut is_clipped) = ([0.0; 3], [[0.0; 2]; 3], [false; 3]);
    for &place in places {
        let sample = view.sample(camera, place)?;
        let by_place = view.slopes(place)?;
        for channel in 0..3 {
            let value = sample.values[channel].max(0.0);
            is_clipped[channel] |= value > MAX_VALUE;
            light[channel] += curve.inverse(channel, value) / count;
            slopes[channel][0] += by_place[channel][0] / count;
            slopes[channel][1] += by_place[channel][1] / count;
        }
    }
    let [first, .., last] = places else { return None };
    let intervals = places.len() as f64 / (places.len() - 1) as f64;
    let value = |channel: usize| match is_clipped[channel] {
        true => 1.0,
        false => curve.evaluate(channel, light[channel]),
    };
    Some(BlurredSample {
        values: std::array::from_fn(value),
        slopes: slopes.map(|[by_u, by_v]| by_u.hypot(by_v)),
        blur: intervals * (last.0 - first.0).hypot(last.1 - first.1),
        squared_radius: squared_radius(camera, middle.0, middle.1),
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::view::tests::{CAMERA, curve, exposed_view};
    use super::*;
    use i2slam_formation::{FrameTone, Vignetting};
    use i2slam_geometry::{Pose, Tangent};

    /// Largest change of gains from their mean over views: of exposure, in stops, and the logarithm of red.
    #[derive(Clone, Copy)]
    pub(in crate::mapping) struct Gains {
        pub(in crate::mapping) stops: f32,
        pub(in crate::mapping) red: f32,
    }

    pub(in crate::mapping) const GAINS: Gains = Gains { stops: 0.3, red: 0.09 };

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

    /// Points of pairs of so many views through a lens, whose gains change.
    pub(in crate::mapping) fn compared_views(
        count: usize,
        lens: &Vignetting<f32>,
        gains: Gains,
    ) -> Vec<ComparedViews> {
        let views: Vec<View> = (0..count).map(|index| view(index, lens, gains)).collect();
        let curve = curve();
        compare(&views, (&CAMERA, None), |_| &curve)
    }

    /// Root mean square of the difference of ln x between two pictures of points, less their mean.
    fn deviation(points: impl Iterator<Item = [[f32; 3]; 2]>) -> f32 {
        let curve = curve();
        let difference = |values: [[f32; 3]; 2]| {
            let [a, b] = values.map(|v| curve.inverse(1, v[1]).ln());
            a - b
        };
        let all: Vec<f32> = points.map(difference).collect();
        assert!(all.len() > 300, "{}", all.len());
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        (all.iter().map(|d| (d - mean).powi(2)).sum::<f32>() / all.len() as f32).sqrt()
    }

    #[test]
    fn pictures_of_different_blur_show_the_same_light() {
        let exposed = |x: f64, [by_x, by_y]: [f64; 2], log_exposure: f32| {
            let pose = Pose::identity().retract(Tangent::from_array([x, 0.0, 0.0, 0.0, 0.0, 0.0]));
            let velocity = Tangent::from_array([by_x, by_y, 0.0, 0.0, 0.0, 0.0]);
            let tone = FrameTone { log_exposure, ..FrameTone::default() };
            exposed_view(pose, velocity, &tone, &Vignetting::default(), 0)
        };
        let views = [exposed(0.0, [0.4, 0.0], 0.3), exposed(0.1, [0.0, 0.1], -0.3)];
        let curve = curve();
        let compared = compare(&views, (&CAMERA, None), |_| &curve);
        let points = compared[0].points.iter();
        let equal = deviation(points.map(|pair| pair.map(|sample| sample.values)));
        let sample = |point: &Vec3<f64>| {
            let of = |view: &View| {
                Some(view.sample(&CAMERA, view.place_of(&CAMERA, None, *point)?)?.values)
            };
            Some([of(&views[0])?, of(&views[1])?])
        };
        let plain = deviation(views[0].points(&CAMERA, POINTS).iter().filter_map(sample));
        assert!(equal < 0.2 * plain, "{equal} {plain}");
    }

    #[test]
    fn keyframes_are_compared_ever_more_rarely() {
        let due: Vec<usize> = (0..50).filter(|count| is_due(*count)).collect();
        assert_eq!(due, [4, 6, 9, 13, 19, 28, 42]);
        assert_eq!(spread(5, 3).collect::<Vec<_>>(), [0, 2, 4]);
        assert_eq!(spread(2, 3).collect::<Vec<_>>(), [0, 1]);
    }
}
