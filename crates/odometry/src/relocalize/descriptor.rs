//! Matching of points between two pictures by descriptors.
//!
//! A descriptor is the blurred, coarsely sampled surroundings of a point, upright and of one scale,
//! normalised against exposure to mean 0 and length 1 (Brown, Szeliski and Winder 2005).

use crate::track::patch::dot;
use crate::track::pyramid::Pyramid;
use i2slam_geometry::Image;

/// Samples along a side, and their distance on the second pyramid level [px].
const SAMPLES_PER_SIDE: usize = 8;
const SAMPLE_SPACING: f32 = 2.0;
const DESCRIPTOR_LENGTH: usize = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
/// Standard deviation of a descriptor's samples (brightness); below it is noise.
const MIN_CONTRAST: f32 = 0.01;
/// Largest squared distance of a match, and its largest ratio to that of the second best.
const MAX_DESCRIPTOR_DISTANCE: f32 = 0.5;
const MAX_DISTANCE_RATIO: f32 = 0.7;

/// Normalised samples around a point.
type Descriptor = [f32; DESCRIPTOR_LENGTH];

/// Points with their descriptors.
#[derive(Clone, Debug, Default)]
pub(crate) struct DescribedPoints {
    /// Index of every described point in the input list.
    indices: Vec<usize>,
    descriptors: Vec<Descriptor>,
}

impl DescribedPoints {
    /// Describes points with contrast, given by their positions on the finest level.
    pub(crate) fn new(pyramid: &Pyramid, points: &[[f64; 2]]) -> Self {
        let level = pyramid.levels.len().min(2) - 1;
        let scale = (1_usize << level) as f64;
        let mut out = Self::default();
        for (place, at) in points.iter().enumerate() {
            if let Some(d) = describe(&pyramid.levels[level], at.map(|v| (v / scale) as f32)) {
                out.indices.push(place);
                out.descriptors.push(d);
            }
        }
        out
    }

    /// Indices of mutually best matches that pass the ratio test.
    pub(crate) fn matches(&self, other: &Self) -> Vec<(usize, usize)> {
        let back = other.best_matches(self);
        let here = self.best_matches(other);
        let mutual = here.iter().enumerate().filter_map(|(i, to)| {
            let to = (*to)?;
            (back[to]? == i).then_some((self.indices[i], other.indices[to]))
        });
        mutual.collect()
    }

    /// Best match of every descriptor in another list, if it passes the ratio test.
    fn best_matches(&self, other: &Self) -> Vec<Option<usize>> {
        let of = |d: &Descriptor| {
            let (mut best, mut least, mut second) = (None, MAX_DESCRIPTOR_DISTANCE, f32::INFINITY);
            for (i, o) in other.descriptors.iter().enumerate() {
                let distance = 2.0 - 2.0 * dot(d, o);
                if distance < least {
                    second = if best.is_some() { least } else { second };
                    (best, least) = (Some(i), distance);
                } else {
                    second = second.min(distance);
                }
            }
            best.filter(|_| least < MAX_DISTANCE_RATIO * second)
        };
        self.descriptors.iter().map(of).collect()
    }
}

fn describe(image: &Image<f32>, [x, y]: [f32; 2]) -> Option<Descriptor> {
    let half = 0.5 * (SAMPLES_PER_SIDE as f32 - 1.0) * SAMPLE_SPACING;
    let most = [image.width, image.height].map(|n| n as f32 - 0.51);
    let mut out = [0.0; DESCRIPTOR_LENGTH];
    for (i, value) in out.iter_mut().enumerate() {
        let u = x - half + SAMPLE_SPACING * (i % SAMPLES_PER_SIDE) as f32;
        let v = y - half + SAMPLE_SPACING * (i / SAMPLES_PER_SIDE) as f32;
        let (u, v) = (u.clamp(0.51, most[0]), v.clamp(0.51, most[1]));
        *value = image.tap(u, v)?.sample(&image.data).0;
    }
    let mean = out.iter().sum::<f32>() / DESCRIPTOR_LENGTH as f32;
    out.iter_mut().for_each(|v| *v -= mean);
    let norm = dot(&out, &out).sqrt();
    let enough = norm > MIN_CONTRAST * (DESCRIPTOR_LENGTH as f32).sqrt();
    enough.then(|| out.map(|v| v / norm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// Random brightness of 6 px blobs; the picture's content is moved by `(dx, dy)`.
    fn blobs(dx: f64, dy: f64, gain: f32) -> Pyramid {
        let numbers = noise(3, 60 * 60);
        let at = |i: usize, j: usize| numbers[(j % 60) * 60 + i % 60];
        let image = Image::from_fn(200, 150, 1, |_, column, row| {
            let x = (column as f64 - dx) / 6.0 + 10.0;
            let y = (row as f64 - dy) / 6.0 + 10.0;
            let (c, r, u, v) = (x as usize, y as usize, x.fract(), y.fract());
            let top = at(c, r) * (1.0 - u) + at(c + 1, r) * u;
            let bottom = at(c, r + 1) * (1.0 - u) + at(c + 1, r + 1) * u;
            gain * (0.5 + 0.3 * (top * (1.0 - v) + bottom * v)) as f32
        });
        Pyramid::new(&image)
    }

    #[test]
    fn points_are_matched_through_a_move_and_a_change_of_exposure() {
        let points: Vec<[f64; 2]> = (0..60)
            .map(|i| [40.0 + 12.0 * f64::from(i % 10), 40.0 + 12.0 * f64::from(i / 10)])
            .collect();
        let moved: Vec<[f64; 2]> = points.iter().map(|p| [p[0] + 17.0, p[1] - 9.0]).collect();
        let first = DescribedPoints::new(&blobs(0.0, 0.0, 1.0), &points);
        let second = DescribedPoints::new(&blobs(17.0, -9.0, 0.5), &moved);
        let matches = first.matches(&second);
        assert!(matches.len() > 50, "{}", matches.len());
        assert!(matches.iter().all(|(a, b)| a == b));
    }
}
