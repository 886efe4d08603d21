//! Pictures with depth, prepared for alignment.

use super::depth_smoothing::smoothed_depth;
use super::pyramid::{halved_by_mean, halved_camera, halved_depth};
use super::residual::{DepthSamples, FrameLevel, TargetLevel};
use i2slam_formation::{CameraResponse, NodeSpacing, ResponseCurve, StartCurve};
use i2slam_geometry::{Camera, Image, Tangent};

/// Distance of samples [px]; the coarsest level uses every pixel.
const STRIDE: usize = 2;
/// Columns and rows of tiles of the picture whose errors count as independent.
const TILES: [usize; 2] = [8, 6];
/// Shorter side of the coarsest level, at least [px].
const COARSEST_SIDE: usize = 48;
/// Spacing of the nodes of the response, the exponent of the sRGB encoding.
const NODE_SPACING: f64 = 2.2;

/// A picture with depth at several sizes, to be aligned and to be aligned to. Some 100 bytes per
/// pixel.
pub struct DensePyramid {
    pub(super) camera: Camera<f64>,
    /// Finest first.
    pub(super) frames: Vec<FrameLevel>,
    pub(super) targets: Vec<TargetLevel>,
    /// The samples of the finest level, tile by tile.
    pub(super) tiles: Vec<DepthSamples>,
    pub(super) has_depth: bool,
}

impl DensePyramid {
    /// From picture values in [0, 1], planes R, G, B or one of brightness, and depth along the
    /// optical axis [m], 0 = no reading, at mid-exposure of the middle row.
    ///
    /// # Panics
    /// Where a picture is not of the camera's size.
    pub fn new(camera: &Camera<f64>, picture: &Image<f32>, depth: Option<&Image<f32>>) -> Self {
        let size = [camera.width, camera.height];
        assert_eq!([picture.width, picture.height], size, "picture and camera");
        let fits = |depth: &Image<f32>| [depth.width, depth.height] == size;
        assert!(depth.is_none_or(fits), "depth and camera");
        let has_depth = depth.is_some();
        let colour = three_planes(picture);
        let empty = || Image::new(camera.width, camera.height, 1);
        let depth = depth.map_or_else(empty, |depth| smoothed_depth(camera, depth));
        let levels = levels(camera);
        let stride = |level: usize| if level + 1 == levels { 1 } else { STRIDE };
        let mut frames = vec![FrameLevel::new(camera.cast(), colour, depth, stride(0))];
        for level in 1..levels {
            let fine = &frames[level - 1];
            let colour = halved_by_mean(&fine.colour);
            let camera = halved_camera(&fine.camera, &colour);
            frames.push(FrameLevel::new(camera, colour, halved_depth(&fine.depth), stride(level)));
        }
        let curve = response();
        let target = |frame: &FrameLevel| {
            let depth = if has_depth { Image::clone(&frame.depth) } else { Image::default() };
            TargetLevel::new(radiance(&curve, &frame.colour), depth)
        };
        let targets = frames.iter().map(target).collect();
        let tiles = if has_depth { frames[0].tiles(stride(0), TILES) } else { Vec::new() };
        Self { camera: *camera, frames, targets, tiles, has_depth }
    }
}

/// The camera's motion while a picture is taken.
#[derive(Clone, Copy, Debug)]
pub struct ExposureMotion {
    /// Velocity in the camera's own frame [m/s, rad/s].
    pub velocity: Tangent<f64>,
    /// Time for which the shutter is open [s].
    pub exposure: f64,
    /// Rolling-shutter readout from the first to the last row [s].
    pub readout: f64,
}

impl ExposureMotion {
    /// A camera at rest.
    pub fn still() -> Self {
        Self { velocity: Tangent::zero(), exposure: 0.0, readout: 0.0 }
    }
}

/// A picture with the motion while it was taken.
#[derive(Clone, Copy)]
pub struct DenseView<'a> {
    /// Picture and depth.
    pub pictures: &'a DensePyramid,
    /// Motion while they were taken.
    pub motion: ExposureMotion,
}

/// The response that pictures are compared through, sRGB with a shoulder: gains are multiplied,
/// and blur is averaged, on about linear values. An error of it cancels where the gains of both
/// pictures agree.
pub(super) fn response() -> ResponseCurve<f32> {
    CameraResponse::new(1, StartCurve::Shoulder, NodeSpacing::Power(NODE_SPACING)).curve()
}

/// Levels of the pyramid.
fn levels(camera: &Camera<f64>) -> usize {
    let side = camera.width.min(camera.height);
    (0..).take_while(|level| side >> level >= COARSEST_SIDE).count().max(1)
}

fn three_planes(picture: &Image<f32>) -> Image<f32> {
    let last = picture.channels.saturating_sub(1);
    Image::from_fn(picture.width, picture.height, 3, |channel, column, row| {
        picture.at(channel.min(last), column, row)
    })
}

fn radiance(curve: &ResponseCurve<f32>, picture: &Image<f32>) -> Image<f32> {
    let data = picture.data.iter().map(|&value| curve.inverse(0, value)).collect();
    Image { data, ..*picture }
}
