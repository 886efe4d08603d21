//! How an exposure is sampled: how many virtual cameras, where, and by which route.

use super::super::virtual_camera_count;
use crate::config::{BlurModel, FormationConfig};
use i2slam_formation::Quadrature;

/// Blur [px] from which `auto` renders every virtual camera. Up to here re-projected ones, of which
/// there are nearly twice as many, come closer to the integral.
const LONG_BLUR: f64 = 40.0;

/// Blur [px] up to which three re-projected cameras weigh by Simpson's rule: the one in the middle,
/// which is read without interpolation, then has two thirds of the light.
const SHORT_BLUR: f64 = 2.25;

/// Blur [px] up to which more re-projected cameras than [`ENOUGH`] come no closer.
const MEDIUM_BLUR: f64 = 10.0;
const ENOUGH: usize = 7;

/// The margin comes in steps [px] of half a tile of the rasteriser, and ends where `auto` no longer
/// re-projects: the border of longer streaks takes the edge of the render.
const MARGIN_STEP: usize = 8;
const MAX_MARGIN: usize = 32;

/// How the average over the exposure is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlurRoute {
    /// One render per virtual camera.
    Exact,
    /// One render at mid-exposure, re-projected by its depth.
    Image,
}

impl BlurRoute {
    /// The route with a rolling shutter, which exact renders cannot show.
    pub(crate) fn with_readout(self, readout: f64) -> Self {
        if readout == 0.0 { self } else { Self::Image }
    }
}

/// How the average over an exposure is sampled and computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Virtual cameras over the exposure.
    pub virtual_cameras: usize,
    /// Where they lie within it.
    pub quadrature: Quadrature,
    /// How their average is computed.
    pub route: BlurRoute,
    /// Pixels beyond every side of the picture that the image route renders.
    pub margin: usize,
}

impl Sampling {
    /// One camera in the middle.
    pub const SHARP: Self = Self {
        virtual_cameras: 1,
        quadrature: Quadrature::Midpoints,
        route: BlurRoute::Exact,
        margin: 0,
    };

    /// What an exposure needs that draws streaks of `length` pixels and whose rows are read in
    /// `readout` exposures.
    pub fn new(formation: &FormationConfig, length: f64, readout: f64) -> Self {
        let several = views(formation, length, formation.virtual_cameras) > 1;
        let route = match formation.blur_model {
            BlurModel::Exact => BlurRoute::Exact,
            BlurModel::Image => BlurRoute::Image,
            BlurModel::Auto if reach(several, length, readout) < LONG_BLUR => BlurRoute::Image,
            BlurModel::Auto => BlurRoute::Exact,
        };
        Self::by_route(route, formation, length, readout)
    }

    /// The same by one route.
    pub fn by_route(
        route: BlurRoute,
        formation: &FormationConfig,
        length: f64,
        readout: f64,
    ) -> Self {
        // A re-projected camera costs a few hundredths of a rendered one.
        let most = match route {
            BlurRoute::Image if formation.blur_per_camera > 0.0 => {
                let most = 2 * formation.virtual_cameras.max(1) - 1;
                if length > MEDIUM_BLUR { most } else { most.min(ENOUGH) }
            }
            _ => formation.virtual_cameras,
        };
        let virtual_cameras = views(formation, length, most);
        let quadrature = match formation.quadrature {
            Quadrature::Midpoints
                if route == BlurRoute::Image && virtual_cameras == 3 && length < SHORT_BLUR =>
            {
                Quadrature::Simpson
            }
            quadrature => quadrature,
        };
        let several = virtual_cameras > 1;
        let reach = reach(several, length, readout);
        let margin = if several || reach > 0.0 { margin(reach) } else { 0 };
        match formation.blur {
            true => Self { virtual_cameras, quadrature, route, margin },
            false => Self { margin, ..Self::SHARP },
        }
    }
}

/// Virtual cameras for a blur of `length` pixels.
fn views(formation: &FormationConfig, length: f64, most: usize) -> usize {
    match formation.blur {
        true => virtual_camera_count(length, f64::from(formation.blur_per_camera), most),
        false => 1,
    }
}

/// How far [px] a point moves while the rows of a picture are read in `readout` exposures, each of
/// which draws streaks of `length` pixels if it is seen by `several` cameras.
fn reach(several: bool, length: f64, readout: f64) -> f64 {
    length * (readout.abs() + if several { 1.0 } else { 0.0 })
}

/// How far [px] virtual cameras look beyond the border for a median motion of `reach` pixels: half
/// of it to either side, a quarter more where things are nearer than the median, and the pixel
/// beside for interpolation.
fn margin(reach: f64) -> usize {
    let beyond = (0.5 * 1.25 * reach).ceil() as usize + 1;
    beyond.next_multiple_of(MARGIN_STEP).min(MAX_MARGIN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_margin_follows_the_blur() {
        assert_eq!([0.5, 10.0, 11.3, 19.9, 500.0].map(margin), [8, 8, 16, 16, 32]);
        assert_eq!(Sampling::SHARP.margin, 0);
    }

    #[test]
    fn rows_reach_farther_than_blur() {
        let formation = crate::Config::default().formation;
        let margin = |length, readout| Sampling::new(&formation, length, readout).margin;
        assert_eq!([0.0, 4.0, -30.0].map(|readout| margin(0.4, readout)), [0, 8, 16]);
        assert_eq!([0.0, 0.9, -1.1].map(|readout| margin(8.0, readout)), [8, 16, 16]);
        let route = |length, readout| Sampling::new(&formation, length, readout).route;
        assert_eq!(
            [2.9, 3.1].map(|readout| route(10.0, readout)),
            [BlurRoute::Image, BlurRoute::Exact]
        );
        assert_eq!(
            [95.0, 105.0].map(|readout| route(0.4, readout)),
            [BlurRoute::Image, BlurRoute::Exact]
        );
    }

    #[test]
    fn rows_of_different_times_are_reprojected() {
        let with = |readout| [BlurRoute::Exact, BlurRoute::Image].map(|r| r.with_readout(readout));
        assert_eq!(with(0.0), [BlurRoute::Exact, BlurRoute::Image]);
        assert_eq!(with(-0.5), [BlurRoute::Image; 2]);
    }

    #[test]
    fn only_views_that_are_looked_up_exceed_the_cap() {
        let views = |model, length| {
            let ours = crate::Config::default().formation;
            let formation = FormationConfig { blur_model: model, virtual_cameras: 5, ..ours };
            Sampling::new(&formation, length, 0.0).virtual_cameras
        };
        assert_eq!([0.4, 5.0, 10.0, 10.1].map(|b| views(BlurModel::Image, b)), [1, 5, 7, 9]);
        assert_eq!([0.4, 5.0, 10.0, 19.0].map(|b| views(BlurModel::Exact, b)), [1, 5, 5, 5]);
    }

    #[test]
    fn short_blur_weighs_by_simpsons_rule() {
        let quadrature = |route, length| {
            let formation = crate::Config::default().formation;
            Sampling::by_route(route, &formation, length, 0.0).quadrature
        };
        use Quadrature::{Midpoints, Simpson};
        let image = [1.0, 2.0, 3.0, 10.0].map(|length| quadrature(BlurRoute::Image, length));
        assert_eq!(image, [Simpson, Simpson, Midpoints, Midpoints]);
        assert_eq!(quadrature(BlurRoute::Exact, 1.0), Midpoints);
    }
}
