//! Densification and pruning of Gaussians (SplaTAM's rules).

use crate::config::GaussianParameters;
use crate::keyframes::project_rolling;
use crate::objective::Observation;
use i2slam_compute::median;
use i2slam_formation::Formation;
use i2slam_geometry::{Camera, Image, Pose, Tangent, Vec3};
use i2slam_radiance::gaussian::{Gaussian, GaussianMap, Render};
use std::sync::Arc;

/// Rendered opacity below which a pixel receives a new Gaussian (SplaTAM).
const MAX_OPEN_OPACITY: f32 = 0.5;
/// Depth error, in medians of a frame, above which a surface in front of the map is new (SplaTAM).
const MAX_DEPTH_ERROR: f32 = 50.0;
/// Opacity below which a Gaussian is removed (SplaTAM).
const MIN_OPACITY: f32 = 0.005;
/// Standard deviation over the scene's radius above which a Gaussian is removed (SplaTAM).
const MAX_SCALE: f32 = 0.1;

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

/// Adds one Gaussian per pixel.
pub(super) fn seed_map(
    map: &mut GaussianMap,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
) {
    let every: Vec<usize> = (0..source.observation.depth.data.len()).collect();
    push_gaussians(map, parameters, source, &every);
}

/// Adds Gaussians at pixels of low opacity or far in front of the rendered surface.
pub(super) fn add_gaussians(
    map: &mut GaussianMap,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
    render: &Render,
) {
    let observed = &source.observation.depth.data;
    let errors: Vec<f32> = render
        .depth
        .data
        .iter()
        .zip(observed)
        .map(|(r, &o)| if o > 0.0 { (r - o).abs() } else { 0.0 })
        .collect();
    let limit = MAX_DEPTH_ERROR * median_depth_error(source.observation, &errors);
    let unexplained: Vec<usize> = (0..observed.len())
        .filter(|&i| {
            let open = render.opacity.data[i] < MAX_OPEN_OPACITY;
            let in_front = render.depth.data[i] > observed[i] && errors[i] > limit;
            open || in_front
        })
        .collect();
    push_gaussians(map, parameters, source, &unexplained);
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

/// Removes Gaussians nearly transparent, too large or not finite; returns the mask of the rest.
pub(super) fn prune(map: &mut GaussianMap, scene_radius: f32) -> Vec<bool> {
    let min_logit = logit(MIN_OPACITY);
    let max_log_scale = (MAX_SCALE * scene_radius).ln();
    let keep: Vec<bool> = (0..map.len())
        .map(|i| {
            let scale = map.log_scales[i].iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let finite = map.means[i].iter().chain(&map.colours[i]).all(|v| v.is_finite());
            finite && map.opacity_logits[i] >= min_logit && scale <= max_log_scale
        })
        .collect();
    if keep.contains(&false) {
        map.retain(&keep);
    }
    keep
}

fn push_gaussians(
    map: &mut GaussianMap,
    parameters: &GaussianParameters,
    source: &SourceFrame<'_>,
    pixels: &[usize],
) {
    let focal = 0.5 * (source.camera.fx + source.camera.fy);
    let opacity_logit = logit(parameters.initial_opacity);
    for &pixel in pixels {
        let z = source.depth.data[pixel];
        if z <= 0.0 {
            continue;
        }
        let (column, row) = (pixel % source.camera.width, pixel / source.camera.width);
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        let point = source.camera.unproject(u, v, f64::from(z));
        let Some(radiance) = radiance_of_point(source, source.colour_from_depth * point) else {
            continue;
        };
        let mean = (source.world_from_depth * point).cast::<f32>().to_array();
        let log_scale = (parameters.initial_scale * z / focal as f32).ln();
        map.push(Gaussian {
            mean,
            log_scale: [log_scale; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit,
            colour: map.activation.colour(radiance),
        });
    }
}

/// Radiance of a point in the camera at mid-exposure, from the picture; `None` outside of it.
fn radiance_of_point(source: &SourceFrame<'_>, point: Vec3<f64>) -> Option<[f32; 3]> {
    let colour = &source.observation.colour;
    let (u, v) = project_rolling(source.camera, source.velocity, source.readout, point)?;
    if !source.camera.contains(u, v, 0.0) {
        return None;
    }
    let inside = |x: f64, size: usize| x.clamp(0.5, size as f64 - 0.5001) as f32;
    let tap = colour.tap(inside(u, colour.width), inside(v, colour.height))?;
    let picture: [f32; 3] = std::array::from_fn(|c| tap.sample(colour.plane(c)).0);
    let Some(tone) = &source.tone else { return Some(picture) };
    let gains = tone.tone.gains();
    // Values 0 and 1 are clipped: stay half a code value of 8 bits inside.
    let unclipped = |v: f32| v.clamp(1.0 / 512.0, 1.0 - 1.0 / 512.0);
    Some(std::array::from_fn(|c| tone.curve.inverse(c, unclipped(picture[c])) / gains[c]))
}

pub(super) fn logit(share: f32) -> f32 {
    (share / (1.0 - share)).ln()
}
