//! Gaussians of four pixels radius, and cotangents of noise.

use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, RenderCotangent, Shape, View,
};

/// A picture of `width x height` with a horizontal field of view of 63 degrees.
pub(crate) fn view(width: usize, height: usize) -> View<f32> {
    let (w, h) = (width as f32, height as f32);
    let focal = 0.8125 * w;
    let camera = Camera { width, height, fx: focal, fy: focal, cx: 0.5 * w, cy: 0.5 * h };
    View { camera, world_from_camera: Pose::identity() }
}

/// Numbers in 0 to 1 (Knuth's linear congruence, upper bits).
fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    }
}

/// `count` balls all over the picture at depths of 1 to 4 m, with a standard deviation of 1.33 px
/// in the image and an opacity of 0.36.
pub(crate) fn map(count: usize, view: &View<f32>) -> GaussianMap {
    let (camera, mut noise) = (view.camera, noise(3));
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    for _ in 0..count {
        let z = 1.0 + 3.0 * noise();
        let (u, v) = (noise() * camera.width as f32, noise() * camera.height as f32);
        let sigma = (1.33_f32 * 1.33 - 0.3).sqrt() * z / camera.fx;
        map.push(Gaussian {
            mean: camera.unproject(u, v, z).to_array(),
            log_scale: [sigma.ln(); 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: -0.58,
            colour: [-noise(), -noise(), -noise()],
        });
    }
    map
}

/// A cotangent of noise for every plane.
pub(crate) fn cotangent(view: &View<f32>) -> RenderCotangent {
    let (width, height, mut noise) = (view.camera.width, view.camera.height, noise(5));
    let mut image = |channels: usize| {
        let data = (0..width * height * channels).map(|_| noise() - 0.5).collect();
        Image { width, height, channels, data }
    };
    RenderCotangent { radiance: image(3), depth: image(1), opacity: image(1) }
}
