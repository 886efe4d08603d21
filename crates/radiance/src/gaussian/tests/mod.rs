//! Tests of both lanes.

use crate::RadianceMap;
use crate::gaussian::*;
use i2slam_check::noise;
use i2slam_geometry::{Camera, Image, Pose, Rotation, Vec3};

mod gradients;
mod moving;
mod parity;
mod poison;

/// A view with an off-centre principal point and pixels that are not square, from some pose.
pub(crate) fn view(width: usize, height: usize) -> View<f64> {
    let w = width as f64;
    let camera =
        Camera { width, height, fx: 0.9 * w, fy: 0.95 * w, cx: 0.53 * w, cy: 0.48 * height as f64 };
    let rotation = Rotation::exp(Vec3::new(0.2, -0.4, 0.3));
    View { camera, world_from_camera: Pose::new(rotation, Vec3::new(0.3, -0.2, 0.1)) }
}

/// Runs `work` on 1, 2 and 5 threads, which must agree, and gives what it returns.
#[track_caller]
pub(crate) fn on_any_threads<T: PartialEq + Send>(work: impl Fn() -> T + Sync) -> T {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads").install(&work)
    };
    let one = on(1);
    assert!(one == on(2), "1 and 2 threads differ");
    assert!(one == on(5), "1 and 5 threads differ");
    one
}

/// Parameters of a random scene.
#[derive(Clone, Copy)]
pub(super) struct Recipe {
    pub(super) shape: Shape,
    pub(super) activation: ColourActivation,
    pub(super) count: usize,
    /// Standard deviations \[px\], from and to.
    pub(super) sigma: [f64; 2],
    /// Logits of the opacities, from and to.
    pub(super) logit: [f64; 2],
    /// Largest distance of centres from the image, as a part of its size.
    pub(super) margin: f64,
    pub(super) seed: u64,
    /// True if every second Gaussian shows another colour from each direction.
    pub(super) has_view_colours: bool,
}

impl Recipe {
    pub(super) fn new(shape: Shape, activation: ColourActivation) -> Self {
        let (sigma, logit) = ([0.8, 4.0], [-3.0, 3.0]);
        Self {
            shape,
            activation,
            count: 300,
            sigma,
            logit,
            margin: 0.1,
            seed: 1,
            has_view_colours: false,
        }
    }

    /// Gaussians in front of the camera, at depths from 1 to 4 m in random order and 1 mm apart.
    pub(super) fn build(&self, view: &View<f64>) -> GaussianMap<f64> {
        let camera = &view.camera;
        let mut map = GaussianMap::new(self.shape, self.activation);
        for i in 0..self.count {
            let n = noise(self.seed * 100_003 + i as u64, 16);
            let between = |[low, high]: [f64; 2], n: f64| low + (high - low) * (0.5 + 0.5 * n);
            // A permutation of the depths: 7919 is prime and no test has so many Gaussians.
            let z = 1.0 + 3.0 * ((i * 7919) % self.count) as f64 / self.count as f64;
            let at = |n: f64, size: usize| (0.5 + n * (0.5 + self.margin)) * size as f64;
            let p = camera.unproject(at(n[0], camera.width), at(n[1], camera.height), z);
            let log_scale =
                [n[2], n[3], n[4]].map(|n| (between(self.sigma, n) * z / camera.fx).ln());
            let log_scale = match self.shape {
                Shape::Isotropic => [log_scale[0]; 3],
                Shape::Anisotropic => log_scale,
            };
            let colour = match self.activation {
                ColourActivation::Exponential => [n[9], n[10], n[11]],
                ColourActivation::Linear => [n[9], n[10], n[11]].map(|n| 0.5 + 0.5 * n),
            };
            map.push(Gaussian {
                mean: (view.world_from_camera * p).to_array(),
                log_scale,
                rotation: [n[5] + 1.5, n[6], n[7], n[8]],
                opacity_logit: between(self.logit, n[12]),
                colour,
            });
        }
        if self.has_view_colours {
            let origin = view.world_from_camera.translation;
            (0..self.count).step_by(2).for_each(|i| push_view_colour(&mut map, i, origin));
        }
        map
    }
}

/// A view colour of degree 1 to 3 on a cone around about the direction from `origin`.
fn push_view_colour(map: &mut GaussianMap<f64>, gaussian: usize, origin: Vec3<f64>) {
    let n = noise(9 + gaussian as u64, 32);
    let towards = (Vec3::from_array(map.means[gaussian]) - origin).to_array();
    let [x, y, z] = [0, 1, 2].map(|k| towards[k] + 0.3 * n[27 + k]);
    let norm = (x * x + y * y + z * z).sqrt();
    // The shortest turn from the third axis.
    let rotation = Rotation::from_wxyz(norm + z, -y, x, 0.0).expect("not backwards");
    let rotation = [rotation.w, rotation.v.x, rotation.v.y, rotation.v.z];
    let rows = &n.as_chunks::<3>().0[..TERMS[1 + gaussian / 2 % 3]];
    map.view_colours.push(gaussian, Cone { rotation, spread: 0.2 }, rows);
}

/// Random cotangents of all five planes.
pub(crate) fn cotangent(width: usize, height: usize, seed: u64) -> RenderCotangent<f64> {
    let image = |channels: usize, seed: u64| Image {
        width,
        height,
        channels,
        data: noise(seed, width * height * channels),
    };
    RenderCotangent {
        radiance: image(3, seed),
        depth: image(1, seed + 1),
        opacity: image(1, seed + 2),
    }
}

/// Converts to `f32`.
pub(crate) fn single_cotangent(cotangent: &RenderCotangent<f64>) -> RenderCotangent {
    let single = |image: &Image<f64>| {
        let data = image.data.iter().map(|v| *v as f32).collect();
        Image { width: image.width, height: image.height, channels: image.channels, data }
    };
    RenderCotangent {
        radiance: single(&cotangent.radiance),
        depth: single(&cotangent.depth),
        opacity: single(&cotangent.opacity),
    }
}

/// `Σ cotangent · render`: the scalar whose gradient is pulled back.
pub(super) fn functional(render: &Render<f64>, cotangent: &RenderCotangent<f64>) -> f64 {
    let dot = |a: &Image<f64>, b: &Image<f64>| -> f64 {
        a.data.iter().zip(&b.data).map(|(a, b)| a * b).sum()
    };
    dot(&render.radiance, &cotangent.radiance)
        + dot(&render.depth, &cotangent.depth)
        + dot(&render.opacity, &cotangent.opacity)
}

/// No contribution is cut: the picture is smooth as long as the order of depths stays.
pub(super) fn smooth() -> RasterSettings {
    RasterSettings {
        alpha_max: 0.999_999,
        alpha_min: 0.0,
        transmittance_min: 0.0,
        ..RasterSettings::default()
    }
}

/// All numbers in one row.
pub(super) fn flat<const N: usize>(values: &[[f64; N]]) -> Vec<f64> {
    values.as_flattened().to_vec()
}

pub(super) fn from_flat<const N: usize>(values: &[f64]) -> Vec<[f64; N]> {
    values.as_chunks::<N>().0.to_vec()
}
