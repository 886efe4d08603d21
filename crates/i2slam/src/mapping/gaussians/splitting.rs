//! Splitting of Gaussians that are larger than the detail a picture shows where the map is wrong.
//!
//! A pixel is wrong where its prediction, blur and tone included, is off by more than noise, and by more
//! than a shift by half a pixel explains: poses err by that much. There the
//! [rectangles](super::partition) of the picture tell how small Gaussians should be; a blurred picture
//! has large ones and asks for little. A Gaussian is split where [keyframes agree](super::detail_evidence)
//! that it covers detail.

use super::density_control::{SourceFrame, radiance_of_point};
use super::detail_evidence::DetailEvidence;
use super::flat_gaussians::EDGE_DEVIATION;
use super::partition::Partition;
use super::scale_bounds::ScaleBounds;
use super::visibility::{SurfaceView, pixel_at};
use crate::keyframes::project_rolling;
use i2slam_geometry::{Image, Mat3, Rotation, Vec3};
use i2slam_radiance::Render;
use i2slam_radiance::gaussian::GaussianMap;

/// Prediction error above which a pixel is wrong, in deviations up to which a rectangle counts as plain.
/// Noise exceeds it, but in one keyframe alone.
const MAX_ERROR: f32 = 2.0;
/// Shift of the picture that explains an error [px].
const MAX_SHIFT: f32 = 0.5;
/// Deviation over that of a Gaussian of the size asked for, from which on one is split.
const MAX_SIZE_RATIO: f32 = 2.4;
/// Least deviation of a Gaussian that is split [px]: no edge is shorter than a pixel.
pub(super) const MIN_SPLIT_DEVIATION: f32 = MAX_SIZE_RATIO * EDGE_DEVIATION as f32;
/// Deviation of the halves along the axis that is split, and their distance from the middle, in
/// deviations of the whole.
pub(super) const HALF: f32 = 0.6;
/// Most times that what came from one Gaussian is split by one frame.
const MAX_GENERATIONS: usize = 4;
/// Levels of [`Demand`].
const LEVELS: usize = 4;

/// Shorter edge of the rectangles that a picture asks for, where it is not predicted.
struct Demand {
    width: usize,
    /// For blocks of 1, 2, 4 and 8 pixels: the smallest edge asked for within [px].
    levels: [Vec<u8>; LEVELS],
}

/// Asks for nothing.
const NOTHING: u8 = u8::MAX;

impl Demand {
    fn new(colour: &Image<f32>, prediction: &Image<f32>, partition: &Partition<'_>) -> Self {
        let (width, height) = (colour.width, colour.height);
        let mut finest = partition.sizes();
        let limit = |c: usize, value: f32| MAX_ERROR * partition.max_detail(c, value);
        let is_wrong = wrong_pixels(colour, prediction, limit);
        let right = finest.iter_mut().zip(is_wrong).filter(|(_, is_wrong)| !is_wrong);
        right.for_each(|(size, _)| *size = NOTHING);
        let mut size = [width, height];
        let mut levels = [finest, Vec::new(), Vec::new(), Vec::new()];
        for level in 1..LEVELS {
            levels[level] = halved(&levels[level - 1], size);
            size = size.map(|n| n.div_ceil(2));
        }
        Self { width, levels }
    }

    /// Smallest edge asked for within a block around a pixel that is about so wide [px].
    fn at(&self, [column, row]: [usize; 2], width: f32) -> Option<f32> {
        let level = (width.log2().round().max(0.0) as usize).min(LEVELS - 1);
        let stride = (0..level).fold(self.width, |width, _| width.div_ceil(2));
        let size = self.levels[level][(row >> level) * stride + (column >> level)];
        (size != NOTHING).then_some(f32::from(size))
    }
}

/// Smallest values of blocks of two by two.
fn halved(fine: &[u8], [width, height]: [usize; 2]) -> Vec<u8> {
    let columns = width.div_ceil(2);
    let mut coarse = vec![NOTHING; columns * height.div_ceil(2)];
    for (at, &size) in fine.iter().enumerate() {
        let cell = &mut coarse[(at / width / 2) * columns + at % width / 2];
        *cell = size.min(*cell);
    }
    coarse
}

/// Pixels whose prediction is off by more than the limit of a channel about its value, and what a small
/// shift explains.
fn wrong_pixels(
    colour: &Image<f32>,
    prediction: &Image<f32>,
    limit: impl Fn(usize, f32) -> f32,
) -> Vec<bool> {
    let (width, height) = (colour.width, colour.height);
    let is_wrong = |pixel: usize, c: usize| {
        let (x, y, plane) = (pixel % width, pixel / width, colour.plane(c));
        let along =
            plane[y * width + (x + 1).min(width - 1)] - plane[y * width + x.saturating_sub(1)];
        let down =
            plane[(y + 1).min(height - 1) * width + x] - plane[y.saturating_sub(1) * width + x];
        let slope = 0.5 * along.hypot(down);
        let predicted = prediction.plane(c)[pixel];
        (predicted - plane[pixel]).abs() > limit(c, predicted) + MAX_SHIFT * slope
    };
    (0..width * height).map(|pixel| (0..3).any(|c| is_wrong(pixel, c))).collect()
}

/// Splits the Gaussians on the rendered surface that are larger than the picture asks for where it
/// differs from its prediction, and that the evidence says cover detail. Returns the index of the one that
/// each appended Gaussian came from.
pub(super) fn split_gaussians(
    map: &mut GaussianMap,
    bounds: &mut ScaleBounds,
    source: &SourceFrame<'_>,
    (render, prediction): (&Render, &Image<f32>),
    partition: &Partition<'_>,
    evidence: &DetailEvidence,
) -> Vec<usize> {
    let splitter = Splitter {
        demand: Demand::new(&source.observation.colour, prediction, partition),
        source,
        surface: source.surface(render),
    };
    let mut origins = Vec::new();
    for origin in 0..map.len() {
        let mut waiting = vec![(origin, 0)];
        while let Some((index, generation)) = waiting.pop() {
            let axis = splitter.axis_to_split(map, index);
            if let Some(axis) = axis.filter(|axis| evidence.supports(origin, *axis)) {
                splitter.split(map, bounds, index, axis);
                origins.push(origin);
                if generation + 1 < MAX_GENERATIONS {
                    waiting.push((index, generation + 1));
                    waiting.push((map.len() - 1, generation + 1));
                }
            }
        }
    }
    origins
}

struct Splitter<'a> {
    demand: Demand,
    source: &'a SourceFrame<'a>,
    /// At the pose of the depth picture.
    surface: SurfaceView<'a>,
}

impl Splitter<'_> {
    /// The axis of a Gaussian that is longest in the picture, if it is seen and too long.
    fn axis_to_split(&self, map: &GaussianMap, index: usize) -> Option<usize> {
        let point = self.surface.seen(map, index)?;
        let pixel = self.colour_pixel(point)?;
        let lengths = self.lengths(map, index, point);
        let axis = (0..3).max_by(|&a, &b| lengths[a].total_cmp(&lengths[b]))?;
        let deviation = lengths[axis];
        let wanted = EDGE_DEVIATION as f32 * self.demand.at(pixel, 2.0 * deviation)?;
        (deviation >= MAX_SIZE_RATIO * wanted).then_some(axis)
    }

    /// The pixel of the colour picture that shows a point at mid-exposure.
    fn colour_pixel(&self, point: Vec3<f64>) -> Option<[usize; 2]> {
        let (source, camera) = (self.source, self.source.camera);
        let point = source.colour_from_depth * point;
        pixel_at(camera, project_rolling(camera, source.velocity, source.readout, point)?)
    }

    /// Standard deviations along the axes of a Gaussian at a point of the camera, in the picture [px].
    fn lengths(&self, map: &GaussianMap, index: usize, point: Vec3<f64>) -> [f32; 3] {
        let camera = self.source.camera;
        let axes = self.surface.camera_from_world.rotation.matrix() * axes(map.rotations[index]);
        let ray = point * (1.0 / point.z);
        [0, 1, 2].map(|axis| {
            let [x, y, z] = [0, 1, 2].map(|row| axes[(row, axis)]);
            let pixels = (camera.fx * (x - ray.x * z)).hypot(camera.fy * (y - ray.y * z)) / point.z;
            pixels as f32 * map.log_scales[index][axis].exp()
        })
    }

    /// Replaces a Gaussian by two along an axis, with the colours of the picture.
    fn split(&self, map: &mut GaussianMap, bounds: &mut ScaleBounds, index: usize, axis: usize) {
        let Some(mut other) = map.get(index) else { return };
        let axes = axes(other.rotation);
        let distance = HALF * other.log_scale[axis].exp();
        let offset = [0, 1, 2].map(|row| distance * axes[(row, axis)] as f32);
        other.log_scale[axis] += HALF.ln();
        let colour_from_world = self.source.colour_from_depth * self.surface.camera_from_world;
        let [first, second] = [-1.0, 1.0].map(|side| {
            let mean: [f32; 3] = std::array::from_fn(|k| other.mean[k] + side * offset[k]);
            let point = colour_from_world * Vec3::from_array(mean).cast::<f64>();
            let radiance = radiance_of_point(self.source, point);
            let colour = radiance.map_or(other.colour, |radiance| map.activation.colour(radiance));
            (mean, colour)
        });
        map.log_scales[index] = other.log_scale;
        (map.means[index], map.colours[index]) = first;
        (other.mean, other.colour) = second;
        map.push(other);
        bounds.split(index, axis, HALF);
    }
}

/// Axes of a Gaussian in the world: columns.
pub(super) fn axes(rotation: [f32; 4]) -> Mat3<f64> {
    let [w, x, y, z] = rotation.map(f64::from);
    Rotation::from_wxyz(w, x, y, z).unwrap_or_else(Rotation::identity).matrix()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objective::Observation;
    use i2slam_geometry::{Camera, Image, Pose, Tangent};
    use i2slam_radiance::RadianceMap;
    use i2slam_radiance::gaussian::{
        ColourActivation, Gaussian, MapGradient, RasterSettings, Rasterizer, Shape, View,
    };
    use std::sync::Arc;

    const SIDE: usize = 32;
    const DEPTH: f32 = 2.0;

    fn camera() -> Camera<f64> {
        Camera { width: SIDE, height: SIDE, fx: 32.0, fy: 32.0, cx: 16.0, cy: 16.0 }
    }

    /// A grey wall of discs of eight pixels.
    fn wall() -> (GaussianMap, ScaleBounds) {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        let mut bounds = ScaleBounds::default();
        let pixel = DEPTH / 32.0;
        for place in 0..16 {
            let at = [place % 4, place / 4].map(|k| (8.0 * k as f32 + 4.0 - 16.0) * pixel);
            let deviation = EDGE_DEVIATION as f32 * 8.0 * pixel;
            map.push(Gaussian {
                mean: [at[0], at[1], DEPTH],
                log_scale: [deviation, deviation, 0.1 * deviation].map(f32::ln),
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 4.0,
                colour: [0.5; 3],
            });
            bounds.push(pixel, [deviation, deviation, 0.1 * deviation].map(f32::ln));
        }
        (map, bounds)
    }

    /// Splits by a picture of the wall on whose contrasts two keyframes agree; returns the map and the
    /// origins.
    fn split_by(picture: impl Fn(usize, usize) -> f32) -> (GaussianMap, Vec<usize>) {
        split_where([1.0, 1.0], picture)
    }

    /// Splits by a picture of the wall, whose contrasts are such in two keyframes.
    fn split_where(
        keyframes: [f32; 2],
        picture: impl Fn(usize, usize) -> f32,
    ) -> (GaussianMap, Vec<usize>) {
        let (mut map, mut bounds) = wall();
        let camera = camera();
        let view = View { camera: camera.cast(), world_from_camera: Pose::identity() };
        let mut render = Render::new(SIDE, SIDE);
        map.render(&mut Rasterizer::new(RasterSettings::default()), &view, &mut render);
        let mut colour = Image::new(SIDE, SIDE, 3);
        for pixel in 0..SIDE * SIDE {
            (0..3).for_each(|c| {
                colour.plane_mut(c)[pixel] = picture(pixel % SIDE, pixel / SIDE);
            });
        }
        let depth = Image { data: vec![DEPTH; SIDE * SIDE], ..Image::new(SIDE, SIDE, 1) };
        let observation = Observation::new(colour, depth.clone());
        let source = SourceFrame {
            camera: &camera,
            world_from_depth: Pose::identity(),
            colour_from_depth: Pose::identity(),
            velocity: Tangent::zero(),
            readout: 0.0,
            observation: &observation,
            depth: Arc::new(depth),
            tone: None,
        };
        let partition = super::super::flat_gaussians::partition(&source);
        let mut evidence = DetailEvidence::new(&map, &bounds);
        let parts = evidence.map_in_parts(&map);
        assert_eq!(parts.len(), 4 * map.len());
        for contrast in keyframes {
            let mut gradient = MapGradient::new(&parts);
            gradient.seen.fill(true);
            gradient.colours.iter_mut().step_by(4).for_each(|colour| *colour = [contrast; 3]);
            evidence.add(&gradient);
        }
        let origins = split_gaussians(
            &mut map,
            &mut bounds,
            &source,
            (&render, &render.radiance),
            &partition,
            &evidence,
        );
        (map, origins)
    }

    #[test]
    fn a_wall_that_is_predicted_stays() {
        let (map, origins) = split_by(|_, _| 0.5);
        assert_eq!((map.len(), origins.len()), (16, 0));
    }

    #[test]
    fn detail_that_is_not_predicted_splits_what_covers_it() {
        // A line through the second column of discs.
        let (map, origins) = split_by(|x, _| if (9..12).contains(&x) { 0.1 } else { 0.5 });
        assert_eq!(map.len(), 16 + origins.len());
        assert!(origins.len() >= 8, "{}", origins.len());
        assert!(origins.iter().all(|origin| origin % 4 == 1), "{origins:?}");
        let dark = map.means.iter().zip(&map.colours).filter(|(_, colour)| colour[0] < 0.3);
        let pixel = DEPTH / 32.0;
        let columns: Vec<f32> = dark.map(|(mean, _)| mean[0] / pixel + 16.0).collect();
        assert!(
            !columns.is_empty() && columns.iter().all(|c| (c - 10.5).abs() < 1.5),
            "{columns:?}"
        );
    }

    #[test]
    fn detail_on_which_keyframes_do_not_agree_splits_nothing() {
        let line = |x: usize, _: usize| if (9..12).contains(&x) { 0.1 } else { 0.5 };
        assert!(!split_where([1.0, 0.5], line).1.is_empty());
        assert!(split_where([1.0, -0.5], line).1.is_empty());
    }

    #[test]
    fn an_edge_off_by_a_fraction_of_a_pixel_splits_nothing() {
        // The wall is grey: a ramp that is off by less than half its slope is a shift.
        let (map, _) = split_by(|x, _| 0.5 + 0.04 * (x as f32 - 15.5).clamp(-1.0, 1.0));
        assert_eq!(map.len(), 16);
    }
}
