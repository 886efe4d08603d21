//! Densification and pruning of Gaussians (SplaTAM's rules).

use super::flat_gaussians::EDGE_DEVIATION;
use super::partition::MAX_SIZE;
use super::visibility::SurfaceView;
use crate::config::GaussianParameters;
use crate::keyframes::project_rolling;
use crate::objective::Observation;
use i2slam_compute::median;
use i2slam_formation::Formation;
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};
use i2slam_radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Render, Shape};
use std::sync::Arc;

/// Rendered opacity below which a pixel receives a new ball (SplaTAM), and a new flat Gaussian.
const MAX_OPEN_OPACITY: [f32; 2] = [0.5, 0.7];
/// Depth error, in medians of a frame, above which a surface in front of the map is new (SplaTAM).
const MAX_DEPTH_ERROR: f32 = 50.0;
/// Opacity below which a Gaussian is removed (SplaTAM).
const MIN_OPACITY: f32 = 0.005;
/// Standard deviation over the scene's radius above which a Gaussian is removed (SplaTAM).
const MAX_SCALE: f32 = 0.1;

/// Distance of Gaussians on a surface from it, over its depth: a few deviations of a sensor.
const SURFACE_TOLERANCE: f64 = 0.03;

/// A frame as a source of new Gaussians.
pub(super) struct SourceFrame<'a> {
    pub(super) camera: &'a Camera<f64>,
    /// Camera pose when the depth picture was taken.
    pub(super) world_from_depth: Pose<f64>,
    /// From that camera to the one at mid-exposure.
    pub(super) colour_from_depth: Pose<f64>,
    /// Camera motion over the exposure.
    pub(super) velocity: Tangent<f64>,
    /// Time from the first to the last row [exposures].
    pub(super) readout: f64,
    pub(super) observation: &'a Observation,
    /// Depth at which Gaussians are placed [m]; 0 places none.
    pub(super) depth: Arc<Image<f32>>,
    pub(super) tone: Option<Formation<'a>>,
}

/// Marks the pixels at which a map of some shape has low opacity, or that lie far in front of the
/// rendered surface.
pub(super) fn unexplained_pixels(
    shape: Shape,
    source: &SourceFrame<'_>,
    render: &Render,
) -> Vec<bool> {
    let observed = &source.observation.depth.data;
    let errors: Vec<f32> = render
        .depth
        .data
        .iter()
        .zip(observed)
        .map(|(r, &o)| if o > 0.0 { (r - o).abs() } else { 0.0 })
        .collect();
    let limit = MAX_DEPTH_ERROR * median_depth_error(source.observation, &errors);
    let in_front = |i: usize| render.depth.data[i] > observed[i] && errors[i] > limit;
    let open = open_pixels(shape, render).into_iter().enumerate();
    open.map(|(pixel, open)| open || in_front(pixel)).collect()
}

/// Marks the pixels at which a map of some shape has low opacity.
pub(super) fn open_pixels(shape: Shape, render: &Render) -> Vec<bool> {
    let max_opacity = MAX_OPEN_OPACITY[usize::from(shape == Shape::Anisotropic)];
    render.opacity.data.iter().map(|opacity| *opacity < max_opacity).collect()
}

/// Median absolute depth error. SplaTAM counts pixels without depth as exact; where estimated depth
/// is missing in half the picture they would decide the median and are left out.
fn median_depth_error(observation: &Observation, errors: &[f32]) -> f32 {
    let sparse = observation.is_estimated() && 2 * observation.valid_depths() <= errors.len();
    let all = errors.iter().zip(&observation.depth.data);
    let mut counted: Vec<f32> =
        all.filter(|(_, o)| !sparse || **o > 0.0).map(|(e, _)| *e).collect();
    median(&mut counted).unwrap_or(0.0)
}

/// Standard deviation above which a Gaussian is removed [m], of a scene whose first frame has such a
/// largest depth [m]. A square of pixels that faces the camera there is not too large: in pictures of
/// less than 150 px it exceeds SplaTAM's bound.
pub(super) fn max_scale(
    shape: Shape,
    parameters: &GaussianParameters,
    camera: &Camera<f64>,
    largest_depth: f32,
) -> f32 {
    let of_scene = MAX_SCALE * (largest_depth / parameters.scene_radius_ratio);
    let focal = 0.5 * (camera.fx + camera.fy) as f32;
    let square = EDGE_DEVIATION as f32 * MAX_SIZE as f32 * largest_depth / focal;
    match shape {
        Shape::Isotropic => of_scene,
        Shape::Anisotropic => of_scene.max(square),
    }
}

/// False for each Gaussian that is nearly transparent, too large or not finite.
pub(super) fn worth_keeping(map: &GaussianMap, max_scale: f32) -> Vec<bool> {
    let min_logit = logit(MIN_OPACITY);
    let max_log_scale = max_scale.ln();
    let is_worth_keeping = |i: usize| {
        let scale = map.log_scales[i].iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let view = map.view_colours.get(i).map_or(&[][..], |view| view.coefficients);
        let mut values = map.means[i].iter().chain(&map.colours[i]).chain(view.as_flattened());
        let is_visible = map.opacity_logits[i] >= min_logit && scale <= max_log_scale;
        is_visible && values.all(|v| v.is_finite())
    };
    (0..map.len()).map(is_worth_keeping).collect()
}

/// Marks the Gaussians that do not lie on a surface that a camera sees at `depth`, 0 where there is
/// none, or lie nearer to the depth that stands in for it.
pub(super) fn outside_surface(
    map: &GaussianMap,
    camera: &Camera<f64>,
    camera_from_world: Pose<f64>,
    [depth, instead]: [&Image<f32>; 2],
) -> Vec<bool> {
    let is_on_surface = |mean: &[f32; 3]| {
        let point = camera_from_world * Vec3::from_array(mean.map(f64::from));
        let (u, v) = camera.project(point);
        if point.z <= 0.0 || !camera.contains(u, v, 0.0) {
            return false;
        }
        let [surface, instead] =
            [depth, instead].map(|depth| f64::from(depth.at(0, u as usize, v as usize)));
        let distance = (point.z - surface).abs();
        let is_nearest = instead <= 0.0 || distance < (point.z - instead).abs();
        surface > 0.0 && distance <= SURFACE_TOLERANCE * surface && is_nearest
    };
    map.means.iter().map(|mean| !is_on_surface(mean)).collect()
}

/// Ratio of a Gaussian's depth to that of the surface behind it below which a camera sees through it.
const MAX_TRANSPARENT_RATIO: f64 = 0.95;
/// Cameras that must see through a Gaussian for it to be removed.
const MIN_VOTES_AGAINST: u32 = 2;

/// For every Gaussian, the number of cameras that see it on a surface, and of those that see through it.
pub(super) struct SurfaceVotes {
    on_surface: Vec<u32>,
    against: Vec<u32>,
}

impl SurfaceVotes {
    pub(super) fn new(count: usize) -> Self {
        Self { on_surface: vec![0; count], against: vec![0; count] }
    }

    /// Adds those of a camera that sees surfaces at `depth`, 0 where there is none.
    pub(super) fn add(
        &mut self,
        map: &GaussianMap,
        (camera, camera_from_world, depth): (&Camera<f64>, Pose<f64>, &Image<f32>),
    ) {
        let votes = self.on_surface.iter_mut().zip(&mut self.against);
        for (mean, (on_surface, against)) in map.means.iter().zip(votes) {
            let point = camera_from_world * Vec3::from_array(mean.map(f64::from));
            let (u, v) = camera.project(point);
            if point.z <= 0.0 || !camera.contains(u, v, 0.0) {
                continue;
            }
            let surface = f64::from(depth.at(0, u as usize, v as usize));
            let is_transparent = point.z < MAX_TRANSPARENT_RATIO * surface;
            let is_on_surface = !is_transparent && point.z <= (1.0 + SURFACE_TOLERANCE) * surface;
            *against += u32::from(is_transparent);
            *on_surface += u32::from(is_on_surface);
        }
    }

    /// False for each Gaussian that enough cameras see through, and more than see it on a surface.
    pub(super) fn keep(&self) -> Vec<bool> {
        let votes = self.on_surface.iter().zip(&self.against);
        votes.map(|(on, against)| *against < MIN_VOTES_AGAINST || against <= on).collect()
    }
}

/// Adds a ball for every marked pixel.
pub(super) fn push_balls(
    map: &mut GaussianMap,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
    wanted: &[bool],
) {
    for pixel in (0..wanted.len()).filter(|pixel| wanted[*pixel]) {
        if let Some(ball) = ball(map.activation, parameters, source, pixel) {
            map.push(ball);
        }
    }
}

/// A ball of about a pixel's size; `None` without depth or radiance.
pub(super) fn ball(
    activation: ColourActivation,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
    pixel: usize,
) -> Option<Gaussian<f32>> {
    let (point, radiance) = source.surface_point(pixel)?;
    let focal = 0.5 * (source.camera.fx + source.camera.fy);
    let log_scale = (parameters.initial_scale * source.depth.data[pixel] / focal as f32).ln();
    Some(Gaussian {
        mean: (source.world_from_depth * point).cast::<f32>().to_array(),
        log_scale: [log_scale; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity_logit: logit(parameters.initial_opacity),
        colour: activation.colour(radiance),
    })
}

impl SourceFrame<'_> {
    /// The surface that is seen at the pose of the depth picture.
    pub(super) fn surface<'a>(&'a self, render: &'a Render) -> SurfaceView<'a> {
        let camera_from_world = self.world_from_depth.inverse();
        SurfaceView { camera: self.camera, camera_from_world, render }
    }

    /// Point of the surface at a pixel, in the camera when the depth picture was taken, and its
    /// radiance.
    pub(super) fn surface_point(&self, pixel: usize) -> Option<(Vec3<f64>, [f32; 3])> {
        let z = self.depth.data[pixel];
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        let point = self.camera.unproject(u, v, f64::from(z));
        let radiance = (z > 0.0).then(|| radiance_of_point(self, self.colour_from_depth * point));
        Some((point, radiance??))
    }
}

/// Radiance of a point in the camera at mid-exposure, from the picture; `None` outside of it.
pub(super) fn radiance_of_point(source: &SourceFrame<'_>, point: Vec3<f64>) -> Option<[f32; 3]> {
    let colour = &source.observation.colour;
    let (u, v) = project_rolling(source.camera, source.velocity, source.readout, point)?;
    if !source.camera.contains(u, v, 0.0) {
        return None;
    }
    let inside = |x: f64, size: usize| x.clamp(0.5, size as f64 - 0.5001) as f32;
    let tap = colour.tap(inside(u, colour.width), inside(v, colour.height))?;
    let picture: [f32; 3] = std::array::from_fn(|c| tap.sample(colour.plane(c)).0);
    let Some(tone) = &source.tone else { return Some(picture) };
    let pixel = v as usize * colour.width + u as usize;
    let vignetting = tone.vignetting.map_or(1.0, |all| all[pixel]);
    let gains = tone.tone.gains().map(|gain| gain * vignetting);
    // Values 0 and 1 are clipped: stay half a code value of 8 bits inside.
    let unclipped = |v: f32| v.clamp(1.0 / 512.0, 1.0 - 1.0 / 512.0);
    Some(std::array::from_fn(|c| tone.curve.inverse(c, unclipped(picture[c])) / gains[c]))
}

pub(super) fn logit(share: f32) -> f32 {
    (share / (1.0 - share)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Camera<f64> = Camera { width: 9, height: 9, fx: 9.0, fy: 9.0, cx: 4.5, cy: 4.5 };

    /// True if a ball at depth 2 stays, for cameras at the origin that see surfaces at some depths.
    fn stays(surfaces: &[f32]) -> bool {
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Linear);
        map.push(Gaussian {
            mean: [0.0, 0.0, 2.0],
            log_scale: [-3.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: 1.0,
            colour: [0.5; 3],
        });
        let mut votes = SurfaceVotes::new(1);
        for surface in surfaces {
            let mut depth = Image::new(9, 9, 1);
            depth.data.fill(*surface);
            votes.add(&map, (&CAMERA, Pose::identity(), &depth));
        }
        votes.keep()[0]
    }

    #[test]
    fn what_more_cameras_see_through_than_see_is_removed() {
        assert!(stays(&[]) && stays(&[3.0]) && stays(&[3.0, 3.0, 2.0, 2.03]));
        assert!(!stays(&[3.0, 3.0, 2.0]) && !stays(&[3.0, 3.0]));
        // Nothing is known there, and it is hidden.
        assert!(stays(&[0.0, 0.0]) && stays(&[1.0, 1.0]));
    }
}
