//! Local features by a learned detector and descriptor: ALIKED-t16 (Zhao et al. 2023, "ALIKED: A Lighter
//! Keypoint and Descriptor Extraction Network via Deformable Transformation"). Its
//! descriptors stand more motion blur than histograms of gradients do.

mod layers;
mod network;

use i2slam_geometry::Image;
use layers::{bilinear, selu};
use network::{DescriptorHead, FEATURES, FeatureMaps, NETWORK, POSITIONS};
use rayon::prelude::*;

/// Features of a picture, at most: those of highest score.
const MAX_FEATURES: usize = 2000;
/// Score of a keypoint, at least.
const MIN_SCORE: f32 = 0.02;
/// Distance within which a keypoint has the highest score [px].
const RADIUS: usize = 2;
/// Temperature of the scores that place a keypoint between pixels.
const TEMPERATURE: f32 = 0.1;
/// Distance of keypoints from the border [px].
const BORDER: usize = 4;

/// Side of a pixel of the larger picture that features are looked for in, in pixels of one of this size.
pub(crate) fn feature_pixel(width: usize, height: usize) -> f64 {
    if width.max(height) < SMALL_SIDE { 0.5 } else { 1.0 }
}

/// A descriptor, of length 1.
pub(super) type Descriptor = [f32; FEATURES];

/// Longer side below which pictures are enlarged to twice their size [px]: the network has learned from
/// larger ones.
const SMALL_SIDE: usize = 480;

/// Features of a picture, and of one half its size, in which motion blur is half as long; of a small picture
/// those of one of twice its size, and its own.
#[derive(Clone, Debug, Default)]
pub(crate) struct Features {
    /// Positions in the picture [px], of each size those of highest score first.
    pub(super) positions: Vec<[f64; 2]>,
    pub(super) descriptors: Vec<Descriptor>,
    /// Side of a pixel of the larger picture [px].
    pub(super) pixel: f64,
    /// Number of features of the larger picture, before those of the smaller one.
    of_larger: usize,
}

impl Features {
    /// Features of a picture of one plane.
    pub(crate) fn new(brightness: &Image<f32>) -> Self {
        let (width, height) = (brightness.width, brightness.height);
        let [mut features, smaller] = match feature_pixel(width, height) < 1.0 {
            true => [
                Self::of_resized(&doubled(brightness), [width, height]),
                Self::of_one_size(brightness),
            ],
            false => {
                let half = brightness.resized_by_area(width / 2, height / 2);
                [Self::of_one_size(brightness), Self::of_resized(&half, [width, height])]
            }
        };
        features.positions.extend(smaller.positions);
        features.descriptors.extend(smaller.descriptors);
        Self { pixel: feature_pixel(width, height), ..features }
    }

    /// Features of a resized copy of a picture, at their places in it.
    fn of_resized(copy: &Image<f32>, size: [usize; 2]) -> Self {
        let mut features = Self::of_one_size(copy);
        let scale = [size[0] as f64 / copy.width as f64, size[1] as f64 / copy.height as f64];
        features.positions.iter_mut().for_each(|[x, y]| (*x, *y) = (scale[0] * *x, scale[1] * *y));
        features
    }

    fn of_one_size(brightness: &Image<f32>) -> Self {
        let maps = NETWORK.apply(brightness);
        let keypoints = find_keypoints(&maps.scores);
        let describe = |at: &[f32; 2]| NETWORK.descriptor.describe(&maps, *at);
        Self {
            positions: keypoints.iter().map(|at| at.map(|v| f64::from(v) + 0.5)).collect(),
            descriptors: keypoints.par_iter().map(describe).collect(),
            of_larger: keypoints.len(),
            pixel: 1.0,
        }
    }

    /// The features of highest score in the smaller picture.
    pub(super) fn strongest_of_smaller(&self, count: usize) -> Self {
        let kept = self.of_larger..self.len().min(self.of_larger + count);
        Self {
            positions: self.positions[kept.clone()].to_vec(),
            descriptors: self.descriptors[kept].to_vec(),
            of_larger: 0,
            pixel: self.pixel,
        }
    }

    /// Features of one size and of the other, which match those of the same size alone.
    pub(super) fn by_size(&self) -> [std::ops::Range<usize>; 2] {
        [0..self.of_larger, self.of_larger..self.len()]
    }

    /// Features of the larger picture alone.
    #[cfg(test)]
    pub(super) fn of_larger(positions: Vec<[f64; 2]>, descriptors: Vec<Descriptor>) -> Self {
        let of_larger = positions.len();
        Self { positions, descriptors, of_larger, pixel: 1.0 }
    }

    /// Number of features.
    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }
}

/// A picture of twice the size by cubic convolution, the nearest pixel along the border.
fn doubled(picture: &Image<f32>) -> Image<f32> {
    let (width, height) = (2 * picture.width, 2 * picture.height);
    let rows = (0..height).into_par_iter().flat_map_iter(|row| {
        (0..width).map(move |column| {
            let [u, v] = [column, row].map(|i| 0.5 * (i as f32 + 0.5));
            let tap = picture.cubic_tap(u, v);
            tap.map_or_else(|| picture.at(0, column / 2, row / 2), |tap| tap.sample(&picture.data))
        })
    });
    Image { data: rows.collect(), ..Image::new(width, height, 1) }
}

/// Peaks of the scores, highest first, whole numbers in the middle of pixels.
fn find_keypoints(scores: &Image<f32>) -> Vec<[f32; 2]> {
    let (columns, rows) = (BORDER..scores.width - BORDER, BORDER..scores.height - BORDER);
    let mut peaks: Vec<(f32, usize, usize)> = Vec::new();
    for row in rows {
        for column in columns.clone() {
            let score = scores.at(0, column, row);
            if score > MIN_SCORE && neighbourhood(scores, column, row).all(|(_, _, s)| s <= score) {
                peaks.push((score, column, row));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    peaks.truncate(MAX_FEATURES);
    peaks.iter().map(|&(score, column, row)| between_pixels(scores, score, column, row)).collect()
}

/// Offsets and scores around a pixel.
fn neighbourhood(
    scores: &Image<f32>,
    column: usize,
    row: usize,
) -> impl Iterator<Item = (f32, f32, f32)> {
    let side = 2 * RADIUS + 1;
    (0..side * side).map(move |i| {
        let (dx, dy) = (i % side, i / side);
        let score = scores.at(0, column + dx - RADIUS, row + dy - RADIUS);
        (dx as f32 - RADIUS as f32, dy as f32 - RADIUS as f32, score)
    })
}

/// The mean position around a peak, weighted by exponentials of the scores.
fn between_pixels(scores: &Image<f32>, peak: f32, column: usize, row: usize) -> [f32; 2] {
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (dx, dy, score) in neighbourhood(scores, column, row) {
        let weight = ((score - peak) / TEMPERATURE).exp();
        (sum, x, y) = (sum + weight, x + weight * dx, y + weight * dy);
    }
    [column as f32 + x / sum, row as f32 + y / sum]
}

impl DescriptorHead {
    /// The descriptor of a keypoint: features at positions around it that the features at it choose.
    fn describe(&self, maps: &FeatureMaps, at: [f32; 2]) -> Descriptor {
        let features = &maps.features;
        let size = [features.width, features.height];
        let most = size[0].max(size[1]) as f32 / 4.0;
        let offsets = self.offsets_at(features, at).map(|v| v.clamp(-most, most));
        let mut out = [0.0; FEATURES];
        for position in 0..POSITIONS {
            let place = [at[0] + offsets[position], at[1] + offsets[POSITIONS + position]];
            let corners = bilinear(place, size);
            let sampled: [f32; FEATURES] = std::array::from_fn(|plane| {
                let values = features.plane(plane);
                corners.iter().map(|(i, w)| w * values[*i]).sum()
            });
            let weights = &self.aggregation[position * FEATURES * FEATURES..];
            for (i, row) in weights.chunks_exact(FEATURES).take(FEATURES).enumerate() {
                let value = selu(self.sampled.at_point(i, &sampled));
                out.iter_mut().zip(row).for_each(|(sum, weight)| *sum += value * weight);
            }
        }
        let length = out.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
        out.map(|v| v / length)
    }

    /// Offsets of the positions around a keypoint: of all columns, then of all rows.
    fn offsets_at(&self, features: &Image<f32>, at: [f32; 2]) -> [f32; 2 * POSITIONS] {
        let [column, row] = [(at[0], features.width), (at[1], features.height)]
            .map(|(v, size)| (v as usize).clamp(1, size - 2) - 1);
        let [around, chosen] = &self.offsets;
        let mut window = Vec::with_capacity(9 * FEATURES);
        for plane in 0..FEATURES {
            let tap = |i: usize| features.at(plane, column + i % 3, row + i / 3);
            window.extend((0..9).map(tap));
        }
        let hidden: Vec<f32> = around
            .weights
            .chunks_exact(window.len())
            .zip(&around.biases)
            .map(|(w, bias)| selu(bias + w.iter().zip(&window).map(|(w, v)| w * v).sum::<f32>()))
            .collect();
        std::array::from_fn(|i| chosen.at_point(i, &hidden))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Keypoints and descriptors are those that the authors' network gives for the same picture
    /// (`assets/README.md`).
    #[test]
    fn features_are_those_of_the_authors_network() {
        let picture = Image::from_fn(96, 64, 1, |_, column, row| {
            let (x, y) = (column as f64, row as f64);
            let wave = 0.5 + 0.25 * (0.35 * x + 0.11 * y).sin();
            (wave + 0.2 * (0.07 * x - 0.42 * y).cos() * (0.013 * x * y).sin()) as f32
        });
        let found = Features::of_one_size(&picture);
        let expected = [
            ([19.147, 36.146], [0.0481, 0.0549, -0.2036, -0.0017]),
            ([14.143, 50.447], [0.0966, 0.1538, -0.1094, -0.0176]),
            ([31.735, 53.346], [-0.0402, 0.0788, 0.0058, 0.0491]),
            ([56.357, 23.483], [0.0117, -0.0130, 0.0638, 0.0300]),
        ];
        for (i, (at, descriptor)) in expected.iter().enumerate() {
            let near = found.positions[i].iter().zip(at).all(|(a, b)| (a - b).abs() < 0.02);
            assert!(near, "{i}: {:?}", found.positions[i]);
            for (a, b) in found.descriptors[i].iter().zip(descriptor) {
                assert!((a - b).abs() < 4e-3, "{i}: {a} {b}");
            }
        }
    }

    #[test]
    fn small_pictures_are_doubled() {
        let value = |x: f64, y: f64| (0.01 * (0.3 * x * x - 0.2 * x * y) + 0.1 * y) as f32;
        let picture = Image::from_fn(24, 20, 1, |_, column, row| value(column as f64, row as f64));
        let large = doubled(&picture);
        assert_eq!((large.width, large.height), (48, 40));
        for (column, row) in [(6, 8), (21, 30), (40, 35)] {
            let due = value(0.5 * column as f64 - 0.25, 0.5 * row as f64 - 0.25);
            assert!((large.at(0, column, row) - due).abs() < 1e-4, "{column} {row}");
        }
        assert_eq!(large.at(0, 0, 39), picture.at(0, 0, 19));
    }

    #[test]
    fn features_of_a_doubled_picture_lie_where_the_picture_has_them() {
        // A bright disc at (40.2, 30.7), pixel centres at halves.
        let picture = Image::from_fn(96, 64, 1, |_, column, row| {
            let off = (column as f64 + 0.5 - 40.2).hypot(row as f64 + 0.5 - 30.7);
            (0.2 + 0.6 / (1.0 + (2.0 * (off - 3.0)).exp())) as f32
        });
        assert_eq!(feature_pixel(picture.width, picture.height), 0.5);
        let found = Features::new(&picture);
        let own = Features::of_one_size(&picture);
        assert_eq!(found.positions[found.of_larger..], own.positions);
        let near = |[x, y]: &[f64; 2]| (x - 40.2).hypot(y - 30.7) < 5.0;
        let of_doubled = &found.positions[..found.of_larger];
        assert!(!of_doubled.is_empty() && of_doubled.iter().all(near), "{of_doubled:?}");
    }
}
