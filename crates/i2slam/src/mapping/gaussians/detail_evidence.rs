//! Evidence that a Gaussian covers detail: keyframes agree that its two sides differ in colour.
//!
//! Each candidate is rendered as four parts, two along each of its long axes. Let `g_k` be the derivative
//! of the loss of keyframe `k` by the contrast of its sides, three channels: by the colours of the parts on
//! one side less that by those on the other. It has the same sign in all keyframes where the scene has
//! detail, and either sign where noise, a pose that is off or a reflection differs from the prediction. With
//! the mean `ḡ` over the `n` keyframes that see the Gaussian the ratio of variances
//!
//! ```text
//! F = n (n - 1) |ḡ|² / Σ_k |g_k - ḡ|²
//! ```
//!
//! is 1 by chance.

use super::scale_bounds::ScaleBounds;
use super::splitting::{HALF, MIN_SPLIT_DEVIATION, axes};
use i2slam_radiance::gaussian::{GaussianMap, MapGradient};

/// Ratio of variances from which keyframes agree.
const MIN_F: f32 = 4.0;
/// Parts of a candidate: bit `k` of a part is its side along long axis `k`.
const PARTS: usize = 4;

/// Sums over the keyframes that see a Gaussian, of derivatives by the contrast along one axis.
#[derive(Clone, Copy, Default)]
struct ContrastSums {
    keyframes: usize,
    derivative: [f32; 3],
    squares: f32,
}

impl ContrastSums {
    fn add(&mut self, derivative: [f32; 3]) {
        self.keyframes += 1;
        for (sum, value) in self.derivative.iter_mut().zip(derivative) {
            *sum += value;
            self.squares += value * value;
        }
    }

    /// Whether keyframes agree; a single one cannot disagree.
    fn is_consistent(&self) -> bool {
        let n = self.keyframes as f32;
        let common = self.derivative.iter().map(|sum| sum * sum).sum::<f32>() / n.max(1.0);
        self.keyframes < 2 || common * (n - 1.0) >= MIN_F * (self.squares - common)
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

    /// Adds a keyframe by the derivative of its loss by the [map in parts](Self::map_in_parts).
    pub(super) fn add(&mut self, gradient: &MapGradient) {
        let parts = gradient.colours.chunks(PARTS).zip(gradient.seen.chunks(PARTS));
        for (candidate, (colours, seen)) in self.candidates.iter_mut().zip(parts) {
            if !seen.contains(&true) {
                continue;
            }
            for (k, contrast) in candidate.contrasts.iter_mut().enumerate() {
                let derivative =
                    |c: usize| (0..PARTS).map(|part| side(part, k) * colours[part][c]).sum();
                contrast.add([0, 1, 2].map(derivative));
            }
        }
    }

    /// Whether nothing speaks against detail along an axis of a Gaussian.
    pub(super) fn supports(&self, index: usize, axis: usize) -> bool {
        let candidate = self.places[index].map(|place| &self.candidates[place]);
        let along = |candidate: &Candidate| {
            let place = candidate.axes.iter().position(|known| *known == axis)?;
            Some(candidate.contrasts[place].is_consistent())
        };
        candidate.and_then(along).unwrap_or(true)
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

    #[test]
    fn keyframes_agree_on_detail_and_not_on_noise() {
        // Sides along the longest axis, z, differ by about as much in all keyframes; along x by chance.
        let noise = [0.3, -0.4, 0.2, -0.2, 0.3, -0.1];
        let keyframes = noise.map(|x| [-1.0 - x, 1.0 - x, -0.8 + x, 0.8 + x]);
        let evidence = evidence(&keyframes);
        assert!(evidence.supports(0, 2) && !evidence.supports(0, 0));
    }

    #[test]
    fn nothing_speaks_against_what_one_keyframe_or_none_has_seen() {
        let one = evidence(&[[1.0, -1.0, 0.5, -0.5]]);
        let two = evidence(&[[1.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 1.0, 0.0]]);
        for index in [0, 1] {
            assert!(
                (0..3).all(|axis| one.supports(index, axis) && evidence(&[]).supports(index, axis))
            );
        }
        assert!(!two.supports(0, 0) && two.supports(1, 0));
    }

    #[test]
    fn halves_have_the_evidence_of_the_whole() {
        let mut two = evidence(&[[1.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 1.0, 0.0]]);
        two.inherit(&[1, 0]);
        assert!(two.supports(2, 0) && !two.supports(3, 0));
    }
}
