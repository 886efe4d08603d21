//! Bounds of the standard deviations of flat Gaussians.

use i2slam_radiance::gaussian::GaussianMap;

/// Least standard deviation along any axis, in pixels of the nearest keyframe that saw the Gaussian: a
/// camera that comes nearer still sees no gaps in between (3D smoothing filter of Mip-Splatting, Yu et
/// al. 2024, as a bound on what is stored).
const MIN_DEVIATION: f32 = 0.3;
/// Largest growth of the standard deviation that a Gaussian came with. Where few views look, or all
/// are blurred, nothing else keeps it from spreading over its neighbours.
const MAX_GROWTH: f32 = 1.5;

/// Logarithms of the least standard deviation of a Gaussian, and of the largest along each axis
/// [ln m].
#[derive(Clone, Copy, Debug)]
struct Bounds {
    least: f32,
    most: [f32; 3],
}

/// Bounds of the standard deviations of every Gaussian; none of balls.
#[derive(Clone, Debug, Default)]
pub(super) struct ScaleBounds(Vec<Bounds>);

impl ScaleBounds {
    /// Adds those of a new Gaussian with such log deviations, where a pixel is so wide [m].
    pub(super) fn push(&mut self, pixel: f32, log_scale: [f32; 3]) {
        let least = (MIN_DEVIATION * pixel).ln();
        let most = log_scale.map(|scale| (scale + MAX_GROWTH.ln()).max(least));
        self.0.push(Bounds { least, most });
    }

    /// Lowers the least deviation to that of a camera in which a pixel is so wide [m].
    pub(super) fn see(&mut self, index: usize, pixel: f32) {
        let least = &mut self.0[index].least;
        *least = least.min((MIN_DEVIATION * pixel).ln());
    }

    /// Width of a pixel of the nearest keyframe that saw the Gaussian [m]; none of balls.
    pub(super) fn pixel_width(&self, index: usize) -> Option<f32> {
        Some(self.0.get(index)?.least.exp() / MIN_DEVIATION)
    }

    /// A standard deviation in pixels of the nearest keyframe that saw the Gaussian.
    pub(super) fn in_pixels(&self, index: usize, log_scale: f32) -> f32 {
        MIN_DEVIATION * (log_scale - self.0[index].least).exp()
    }

    /// Adds those of a part of a Gaussian, whose deviation along an axis is a share of the whole's; the
    /// whole becomes a part likewise.
    pub(super) fn split(&mut self, index: usize, axis: usize, share: f32) {
        let Bounds { least, most } = &mut self.0[index];
        most[axis] = (most[axis] + share.ln()).max(*least);
        self.0.push(self.0[index]);
    }

    /// Drops those of removed Gaussians.
    pub(super) fn retain(&mut self, keep: &[bool]) {
        let mut kept = keep.iter();
        self.0.retain(|_| kept.next().is_none_or(|kept| *kept));
    }

    /// Widens the bounds to what the map has, after Gaussians were merged.
    pub(super) fn include(&mut self, map: &GaussianMap) {
        for (Bounds { most, .. }, scale) in self.0.iter_mut().zip(&map.log_scales) {
            (0..3).for_each(|axis| most[axis] = most[axis].max(scale[axis]));
        }
    }

    /// Moves the scales of a map within their bounds.
    pub(super) fn clamp(&self, map: &mut GaussianMap) {
        for (scale, Bounds { least, most }) in map.log_scales.iter_mut().zip(&self.0) {
            (0..3).for_each(|axis| scale[axis] = scale[axis].clamp(*least, most[axis]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::gaussian::{ColourActivation, Gaussian, Shape};

    #[test]
    fn sizes_stay_between_a_pixel_of_the_nearest_frame_and_what_they_were() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        let mut bounds = ScaleBounds::default();
        let log_scale = [0.04_f32, 0.02, 0.003].map(f32::ln);
        let (mean, rotation) = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
        map.push(Gaussian { mean, log_scale, rotation, opacity_logit: 0.0, colour: [0.0; 3] });
        bounds.push(0.02, log_scale);
        let mut clamped = |bounds: &ScaleBounds, scale: f32| {
            map.log_scales[0] = [scale.ln(); 3];
            bounds.clamp(&mut map);
            map.log_scales[0].map(f32::exp)
        };
        let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(close(clamped(&bounds, 1.0), [0.06, 0.03, 0.006]));
        assert!(close(clamped(&bounds, 1e-4), [0.006; 3]));
        // From farther away nothing changes, from nearer the least falls.
        bounds.see(0, 0.05);
        bounds.see(0, 0.01);
        assert!((bounds.pixel_width(0).unwrap() - 0.01).abs() < 1e-6);
        assert!(close(clamped(&bounds, 1e-4), [0.003; 3]));
        bounds.split(0, 0, 0.5);
        assert!(close(clamped(&bounds, 1.0), [0.03, 0.03, 0.006]));
    }
}
