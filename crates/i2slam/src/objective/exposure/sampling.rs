//! Sampling of an exposure: blur length, number and weights of virtual cameras, blur method.

use crate::config::{BlurModel, FormationConfig};
use i2slam_compute::median;
use i2slam_formation::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image};

/// Blur from which [`BlurModel::Auto`] renders every virtual camera [px]. Below, re-projected ones,
/// of which there are nearly twice as many, come closer to the integral.
const MIN_EXACT_BLUR: f64 = 40.0;

/// Blur below which three re-projected cameras are weighted by Simpson's rule [px]: the middle one,
/// which is not interpolated, then has two thirds of the light.
const MAX_SIMPSON_BLUR: f64 = 2.25;

/// Blur up to which this many re-projected cameras suffice [px]: more come no closer.
const MEDIUM_BLUR: f64 = 10.0;
const MEDIUM_BLUR_CAMERAS: usize = 7;

/// Distance of the pixels whose blur is measured [px].
const BLUR_GRID_STEP: usize = 8;

/// Step and maximum of the margin [px]: half a tile of the rasteriser, and about what
/// [`MIN_EXACT_BLUR`] needs. Beyond, the edge of the render is repeated.
const MARGIN_STEP: usize = 8;
const MAX_MARGIN: usize = 32;

/// Method that computes the average over an exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlurMethod {
    /// One render per virtual camera.
    Exact,
    /// One render at mid-exposure, re-projected by its depth.
    Reprojected,
}

impl BlurMethod {
    /// This method, or re-projection where a rolling shutter needs it.
    pub(crate) fn supporting_readout(self, readout: f64) -> Self {
        if readout == 0.0 { self } else { Self::Reprojected }
    }
}

/// Virtual cameras of an exposure, and the method that averages them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Virtual cameras over the exposure.
    pub virtual_cameras: usize,
    /// Their times and weights.
    pub quadrature: Quadrature,
    /// Method that averages them.
    pub method: BlurMethod,
    /// Pixels that a re-projected render extends beyond every side of the picture.
    pub margin: usize,
}

impl Sampling {
    /// One camera at mid-exposure.
    pub const SINGLE_CAMERA: Self = Self {
        virtual_cameras: 1,
        quadrature: Quadrature::Midpoints,
        method: BlurMethod::Exact,
        margin: 0,
    };

    /// Sampling for a blur of `length` pixels and a readout of `readout` exposures.
    pub fn new(formation: &FormationConfig, length: f64, readout: f64) -> Self {
        let several = camera_count(formation, length, formation.virtual_cameras) > 1;
        let method = match formation.blur_model {
            BlurModel::Exact => BlurMethod::Exact,
            BlurModel::Image => BlurMethod::Reprojected,
            BlurModel::Auto if image_motion(several, length, readout) < MIN_EXACT_BLUR => {
                BlurMethod::Reprojected
            }
            BlurModel::Auto => BlurMethod::Exact,
        };
        Self::with_method(method, formation, length, readout)
    }

    /// [`new`](Self::new) with the method given.
    pub fn with_method(
        method: BlurMethod,
        formation: &FormationConfig,
        length: f64,
        readout: f64,
    ) -> Self {
        // A re-projected camera costs a few hundredths of a rendered one.
        let max_cameras = match method {
            BlurMethod::Reprojected if formation.blur_per_camera > 0.0 => {
                let max = 2 * formation.virtual_cameras.max(1) - 1;
                if length > MEDIUM_BLUR { max } else { max.min(MEDIUM_BLUR_CAMERAS) }
            }
            _ => formation.virtual_cameras,
        };
        let virtual_cameras = camera_count(formation, length, max_cameras);
        let quadrature = match formation.quadrature {
            Quadrature::Midpoints
                if method == BlurMethod::Reprojected
                    && virtual_cameras == 3
                    && length < MAX_SIMPSON_BLUR =>
            {
                Quadrature::Simpson
            }
            quadrature => quadrature,
        };
        let several = virtual_cameras > 1;
        let motion = image_motion(several, length, readout);
        let margin = if several || motion > 0.0 { margin(motion) } else { 0 };
        match formation.blur {
            true => Self { virtual_cameras, quadrature, method, margin },
            false => Self { margin, ..Self::SINGLE_CAMERA },
        }
    }
}

fn camera_count(formation: &FormationConfig, length: f64, max: usize) -> usize {
    match formation.blur {
        true => virtual_camera_count(length, f64::from(formation.blur_per_camera), max),
        false => 1,
    }
}

/// Largest image motion between two virtual cameras [px], for a blur of `length` pixels (which
/// counts with `several` cameras) and a readout of `readout` exposures.
fn image_motion(several: bool, length: f64, readout: f64) -> f64 {
    length * (readout.abs() + if several { 1.0 } else { 0.0 })
}

/// Margin for a median image `motion` [px]: half of it to either side, a quarter more for points
/// nearer than the median, and a pixel for interpolation.
fn margin(motion: f64) -> usize {
    let beyond = (0.5 * 1.25 * motion).ceil() as usize + 1;
    beyond.next_multiple_of(MARGIN_STEP).min(MAX_MARGIN)
}

/// Blur length [px]: median distance between a point's projections at shutter open and close, over
/// a grid of pixels with depth; 0 without depth.
pub fn blur_length(camera: &Camera<f64>, shutter: &ShutterPoses<f64>, depth: &Image<f32>) -> f64 {
    blur_length_at(camera, shutter, |column, row| f64::from(depth.at(0, column, row)))
}

/// [`blur_length`] with depth given as a function of column and row [m].
pub fn blur_length_at(
    camera: &Camera<f64>,
    shutter: &ShutterPoses<f64>,
    depth: impl Fn(usize, usize) -> f64,
) -> f64 {
    let middle = shutter.middle();
    let open_from_middle = shutter.start.inverse() * middle;
    let close_from_middle = shutter.end.inverse() * middle;
    let mut lengths = Vec::new();
    for row in (BLUR_GRID_STEP / 2..camera.height).step_by(BLUR_GRID_STEP) {
        for column in (BLUR_GRID_STEP / 2..camera.width).step_by(BLUR_GRID_STEP) {
            let z = depth(column, row);
            if z <= 0.0 {
                continue;
            }
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let point = camera.unproject(u, v, z);
            let (open, close) = (open_from_middle * point, close_from_middle * point);
            if open.z > 1e-3 && close.z > 1e-3 {
                let (a, b) = (camera.project(open), camera.project(close));
                lengths.push((a.0 - b.0).hypot(a.1 - b.1));
            }
        }
    }
    median(&mut lengths).unwrap_or(0.0)
}

/// Number of virtual cameras for a blur of `length` pixels: one below half a pixel, then about one
/// for every `per_camera` pixels, at most `max`. Odd, so that one camera is at mid-exposure, where
/// depth is mostly taken. `max` where `per_camera` is 0.
pub fn virtual_camera_count(length: f64, per_camera: f64, max: usize) -> usize {
    if per_camera <= 0.0 {
        return max;
    }
    if length < 0.5 {
        return 1;
    }
    (1 + 2 * (0.5 * length / per_camera).ceil() as usize).min(max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Pose, Rotation, Vec3};

    #[test]
    fn the_margin_follows_the_motion() {
        assert_eq!([0.5, 10.0, 11.3, 19.9, 500.0].map(margin), [8, 8, 16, 16, 32]);
        assert_eq!(Sampling::SINGLE_CAMERA.margin, 0);
    }

    #[test]
    fn margin_and_method_follow_the_readout() {
        let formation = crate::Config::default().formation;
        let margin = |length, readout| Sampling::new(&formation, length, readout).margin;
        assert_eq!([0.0, 4.0, -30.0].map(|readout| margin(0.4, readout)), [0, 8, 16]);
        assert_eq!([0.0, 0.9, -1.1].map(|readout| margin(8.0, readout)), [8, 16, 16]);
        let method = |length, readout| Sampling::new(&formation, length, readout).method;
        assert_eq!(
            [2.9, 3.1].map(|readout| method(10.0, readout)),
            [BlurMethod::Reprojected, BlurMethod::Exact]
        );
        assert_eq!(
            [95.0, 105.0].map(|readout| method(0.4, readout)),
            [BlurMethod::Reprojected, BlurMethod::Exact]
        );
        assert_eq!(BlurMethod::Exact.supporting_readout(0.0), BlurMethod::Exact);
        assert_eq!(BlurMethod::Exact.supporting_readout(-0.5), BlurMethod::Reprojected);
    }

    #[test]
    fn only_reprojected_cameras_exceed_the_maximum() {
        let views = |model, length| {
            let ours = crate::Config::default().formation;
            let formation = FormationConfig { blur_model: model, virtual_cameras: 5, ..ours };
            Sampling::new(&formation, length, 0.0).virtual_cameras
        };
        assert_eq!([0.4, 5.0, 10.0, 10.1].map(|b| views(BlurModel::Image, b)), [1, 5, 7, 9]);
        assert_eq!([0.4, 5.0, 10.0, 19.0].map(|b| views(BlurModel::Exact, b)), [1, 5, 5, 5]);
    }

    #[test]
    fn short_blur_is_weighted_by_simpsons_rule() {
        let quadrature = |method, length| {
            let formation = crate::Config::default().formation;
            Sampling::with_method(method, &formation, length, 0.0).quadrature
        };
        use Quadrature::{Midpoints, Simpson};
        let image = [1.0, 2.0, 3.0, 10.0].map(|length| quadrature(BlurMethod::Reprojected, length));
        assert_eq!(image, [Simpson, Simpson, Midpoints, Midpoints]);
        assert_eq!(quadrature(BlurMethod::Exact, 1.0), Midpoints);
    }

    #[test]
    fn a_turning_camera_draws_focal_length_times_angle() {
        let camera = Camera { width: 64, height: 48, fx: 200.0, fy: 200.0, cx: 32.0, cy: 24.0 };
        let turned = |a: f64| Pose::new(Rotation::exp(Vec3::new(0.0, a, 0.0)), Vec3::zero());
        let shutter = ShutterPoses { start: turned(-0.005), end: turned(0.005) };
        let mut depth = Image::new(64, 48, 1);
        depth.data.fill(2.0);
        assert!((blur_length(&camera, &shutter, &depth) - 2.0).abs() < 0.05);
        assert_eq!(blur_length(&camera, &shutter, &Image::new(64, 48, 1)), 0.0);
    }

    #[test]
    fn a_still_frame_needs_one_camera() {
        let count = |length| virtual_camera_count(length, 1.5, 5);
        assert_eq!([0.2, 1.4, 3.1, 40.0].map(count), [1, 3, 5, 5]);
        assert_eq!(virtual_camera_count(0.0, 0.0, 5), 5);
    }
}
