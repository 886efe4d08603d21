//! Evidence that a Gaussian covers detail: keyframes agree that its two sides differ in colour.
//!
//! Each candidate is rendered as four parts, two along each of its long axes. Let `g_k` be the derivative
//! of the loss of keyframe `k`, at the map in parts, by the contrast of two sides, three channels: by the
//! colours of the parts on one side less that by those on the other. It has the same sign in all keyframes
//! where the scene has detail, and either sign where noise, a pose that is off or a reflection differs from
//! the prediction. With the mean `ḡ` over the `n` keyframes that see all parts the ratio of variances
//!
//! ```text
//! F = n (n - 1) |ḡ|² / Σ_k |g_k - ḡ|²
//! ```
//!
//! is about 1 by chance for many keyframes. As many keyframes find contrasts that are far below the noise of a
//! picture, the mean of the directions g_k / |g_k| must be long as well: this is the same for keyframes from near
//! and far, whose derivatives grow with the area in the picture. Detail that is even about the middle, as a line
//! along it, has no such contrast.

use super::scale_bounds::ScaleBounds;
use super::splitting::{HALF, MIN_SPLIT_DEVIATION, axes};
use i2slam_radiance::gaussian::{GaussianMap, MapGradient};

/// Ratio of variances from which keyframes agree. Chance exceeds it in one of 7 (two keyframes) to 135
/// (many) where the channels err independently, in one of 3 to 22 where they err together.
const MIN_F: f32 = 4.0;
/// Length of the mean direction from which detail is worth two Gaussians: three of four keyframes have the same
/// sign.
const MIN_COHERENCE: f32 = 0.5;
/// Parts of a candidate: bit `k` of a part is its side along long axis `k`.
const PARTS: usize = 4;

/// Sums over the keyframes that see a Gaussian of derivatives by the contrast along one axis.
#[derive(Clone, Copy, Default)]
struct ContrastSums {
    keyframes: usize,
    derivative: [f32; 3],
    squares: f32,
    directions: [f32; 3],
}

impl ContrastSums {
    /// Adds a keyframe, unless its picture tells nothing there, as where it is clipped.
    fn add(&mut self, derivative: [f32; 3]) {
        let squares: f32 = derivative.iter().map(|value| value * value).sum();
        if squares == 0.0 {
            return;
        }
        self.keyframes += 1;
        self.squares += squares;
        for (k, value) in derivative.into_iter().enumerate() {
            self.derivative[k] += value;
            self.directions[k] += value / squares.sqrt();
        }
    }

    /// True if at least two keyframes agree.
    fn is_consistent(&self) -> bool {
        if self.keyframes < 2 {
            return false;
        }
        let n = self.keyframes as f32;
        let common = self.derivative.iter().map(|sum| sum * sum).sum::<f32>() / n;
        let coherence = self.directions.iter().map(|sum| sum * sum).sum::<f32>().sqrt() / n;
        common * (n - 1.0) >= MIN_F * (self.squares - common) && coherence >= MIN_COHERENCE
    }
}

/// A Gaussian large enough to be split, its two long axes, and the evidence along each.
struct Candidate {
    index: usize,
    axes: [usize; 2],
    contrasts: [ContrastSums; 2],
}

/// Evidence of detail within the Gaussians of a map that are large enough to be split.
pub(super) struct DetailEvidence {
    candidates: Vec<Candidate>,
    /// Place among the candidates, of every Gaussian.
    places: Vec<Option<usize>>,
}

impl DetailEvidence {
    /// Without a keyframe.
    pub(super) fn new(map: &GaussianMap, bounds: &ScaleBounds) -> Self {
        let mut found = Self { candidates: Vec::new(), places: vec![None; map.len()] };
        for (index, &log_scale) in map.log_scales.iter().enumerate() {
            let mut order = [0, 1, 2];
            order.sort_by(|&a, &b| log_scale[b].total_cmp(&log_scale[a]));
            let [longest, second, _] = order;
            if bounds.in_pixels(index, log_scale[longest]) >= MIN_SPLIT_DEVIATION {
                found.places[index] = Some(found.candidates.len());
                let (axes, contrasts) = ([longest, second], Default::default());
                found.candidates.push(Candidate { index, axes, contrasts });
            }
        }
        found
    }

    /// The map with its candidates in parts, which come first.
    pub(super) fn map_in_parts(&self, map: &GaussianMap) -> GaussianMap {
        let mut parts = GaussianMap::new(map.shape, map.activation);
        for candidate in &self.candidates {
            (0..PARTS).for_each(|part| candidate.push_part(map, part, &mut parts));
        }
        for index in (0..map.len()).filter(|index| self.places[*index].is_none()) {
            map.get(index).into_iter().for_each(|whole| parts.push(whole));
        }
        parts
    }

    /// Adds a keyframe by the derivative of its loss by the [map in parts](Self::map_in_parts). Where it
    /// sees some of the parts alone, their contrast is mixed with the error of the whole, and does not
    /// count.
    pub(super) fn add(&mut self, gradient: &MapGradient) {
        let parts = gradient.colours.chunks(PARTS).zip(gradient.seen.chunks(PARTS));
        for (candidate, (colours, seen)) in self.candidates.iter_mut().zip(parts) {
            if seen.contains(&false) {
                continue;
            }
            for (k, contrast) in candidate.contrasts.iter_mut().enumerate() {
                let derivative =
                    |c: usize| (0..PARTS).map(|part| side(part, k) * colours[part][c]).sum();
                contrast.add([0, 1, 2].map(derivative));
            }
        }
    }

    /// True if a Gaussian, or the whole that it came from, covers detail along an axis.
    pub(super) fn supports(&self, index: usize, axis: usize) -> bool {
        let candidate = self.places[index].map(|place| &self.candidates[place]);
        let along = |candidate: &Candidate| {
            let place = candidate.axes.iter().position(|known| *known == axis)?;
            Some(candidate.contrasts[place].is_consistent())
        };
        candidate.and_then(along).unwrap_or(false)
    }

    /// Appends the halves that came from these Gaussians, with the evidence of the whole.
    pub(super) fn inherit(&mut self, origins: &[usize]) {
        origins.iter().for_each(|origin| self.places.push(self.places[*origin]));
    }
}

impl Candidate {
    fn push_part(&self, map: &GaussianMap, part: usize, parts: &mut GaussianMap) {
        let Some(mut gaussian) = map.get(self.index) else { return };
        let directions = axes(gaussian.rotation);
        for (k, &axis) in self.axes.iter().enumerate() {
            let distance = side(part, k) * HALF * gaussian.log_scale[axis].exp();
            (0..3).for_each(|row| {
                gaussian.mean[row] += distance * directions[(row, axis)] as f32;
            });
            gaussian.log_scale[axis] += HALF.ln();
        }
        parts.push(gaussian);
    }
}

/// Side of a part along long axis `k`: -1 or 1.
fn side(part: usize, k: usize) -> f32 {
    if (part >> k) & 1 == 0 { -1.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::gaussian::{ColourActivation, Gaussian, Shape};

    /// Two flat Gaussians, the first of 4 by 2 pixels, the second smaller than one.
    fn map() -> (GaussianMap, ScaleBounds) {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        let mut bounds = ScaleBounds::default();
        for deviations in [[2.0_f32, 0.1, 4.0], [0.6, 0.5, 0.1]] {
            let log_scale = deviations.map(|pixels| (0.01 * pixels).ln());
            let mean = [0.0, 0.0, 2.0];
            let (rotation, colour) = ([1.0, 0.0, 0.0, 0.0], [0.5; 3]);
            map.push(Gaussian { mean, log_scale, rotation, opacity_logit: 4.0, colour });
            bounds.push(0.01, log_scale);
        }
        (map, bounds)
    }

    /// The evidence of keyframes whose losses have such derivatives by the colours of the four parts.
    fn evidence(keyframes: &[[f32; PARTS]]) -> DetailEvidence {
        let (map, bounds) = map();
        let mut evidence = DetailEvidence::new(&map, &bounds);
        for derivatives in keyframes {
            let mut gradient = MapGradient::new(&evidence.map_in_parts(&map));
            for (part, value) in derivatives.iter().enumerate() {
                (gradient.colours[part], gradient.seen[part]) = ([*value; 3], true);
            }
            evidence.add(&gradient);
        }
        evidence
    }

    #[test]
    fn a_candidate_is_drawn_in_four_parts_about_its_centre() {
        let (map, bounds) = map();
        let parts = DetailEvidence::new(&map, &bounds).map_in_parts(&map);
        assert_eq!(parts.len(), PARTS + 1);
        assert_eq!(parts.get(PARTS), map.get(1));
        let places: Vec<[f32; 3]> = parts.means[..PARTS].to_vec();
        let [x, z] = [0.6 * 0.02, 0.6 * 0.04];
        for (found, [sx, sz]) in
            places.iter().zip([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
        {
            let due = [sx * x, 0.0, 2.0 + sz * z];
            assert!(found.iter().zip(due).all(|(a, b)| (a - b).abs() < 1e-6), "{places:?}");
        }
        assert!((parts.log_scales[0][0] - (0.6_f32 * 0.02).ln()).abs() < 1e-6);
        assert_eq!(parts.log_scales[0][1], map.log_scales[0][1]);
    }

    /// Derivatives by the parts with such contrasts along x and z.
    fn contrasts([x, z]: [f32; 2]) -> [f32; PARTS] {
        [0, 1, 2, 3].map(|part| 0.25 * (side(part, 1) * x + side(part, 0) * z))
    }

    #[test]
    fn keyframes_agree_on_detail_and_not_on_noise() {
        // z is the longest axis, x the second.
        let noise = [0.9_f32, -1.2, 0.7, -0.8, 1.1, -0.4];
        let found = evidence(&noise.map(|v| contrasts([v, 2.0 + v])));
        assert!(found.supports(0, 2) && !found.supports(0, 0) && !found.supports(0, 1));
    }

    #[test]
    fn the_ratio_of_variances_decides() {
        // Two keyframes g and r g have F = ((1 + r) / (1 - r))², 4 at r = 1/3.
        for (r, agrees) in [(0.30, false), (0.36, true)] {
            let found = evidence(&[contrasts([1.0, 1.0]), contrasts([r, r])]);
            assert_eq!([0, 2].map(|axis| found.supports(0, axis)), [agrees; 2], "{r}");
        }
        // Five of 1 + e / √5 and one of 1 - √5 e have F = 5 / e², 4 at e = 1.118.
        for (e, agrees) in [(1.10_f32, true), (1.14, false)] {
            let root = 5.0_f32.sqrt();
            let mut keyframes = vec![contrasts([1.0 + e / root; 2]); 5];
            keyframes.push(contrasts([1.0 - root * e; 2]));
            assert_eq!(evidence(&keyframes).supports(0, 0), agrees, "{e}");
        }
    }

    #[test]
    fn most_keyframes_have_the_same_sign() {
        // F is 9 where 100 of 160 agree, and 53 where 120 do.
        for (agreeing, is_enough) in [(100, false), (119, false), (121, true)] {
            let signs = (0..160).map(|k| if k < agreeing { 1.0 } else { -1.0 });
            let keyframes: Vec<_> = signs.map(|sign| contrasts([sign; 2])).collect();
            assert_eq!(evidence(&keyframes).supports(0, 0), is_enough, "{agreeing}");
        }
        // One in ten is four times as near.
        let nearness = (0..240).map(|k| if k % 10 == 0 { 16.0 } else { 1.0 });
        let keyframes: Vec<_> = nearness.map(|area| contrasts([area; 2])).collect();
        assert!(evidence(&keyframes).supports(0, 0));
    }

    #[test]
    fn it_takes_two_keyframes_that_see_all_parts() {
        let see = contrasts([1.0, 1.0]);
        assert!(evidence(&[see, see]).supports(0, 0));
        assert!(!evidence(&[]).supports(0, 0) && !evidence(&[see]).supports(0, 0));
        // A keyframe without a derivative is none, nor one whose square is not told from zero; a Gaussian smaller
        // than a pixel is not looked at.
        let faint = contrasts([1e-30; 2]);
        assert!(!evidence(&[see, faint]).supports(0, 0));
        assert!(evidence(&[see, see, faint]).supports(0, 0));
        let blank = [0.0; PARTS];
        assert!(!evidence(&[see, blank]).supports(0, 0) && !evidence(&[blank; 3]).supports(0, 0));
        assert!(
            evidence(&[see, see, blank]).supports(0, 0) && !evidence(&[see, see]).supports(1, 0)
        );
        let (map, bounds) = map();
        let mut cut = DetailEvidence::new(&map, &bounds);
        let mut gradient = MapGradient::new(&cut.map_in_parts(&map));
        gradient.colours[0] = [1.0; 3];
        gradient.seen[..2].fill(true);
        (0..2).for_each(|_| cut.add(&gradient));
        assert!(!cut.supports(0, 0));
    }

    #[test]
    fn halves_have_the_evidence_of_the_whole() {
        let mut found = evidence(&[contrasts([1.0, 0.0]); 2]);
        found.inherit(&[1, 0]);
        assert!(!found.supports(2, 0) && found.supports(3, 0) && !found.supports(3, 2));
    }
}
