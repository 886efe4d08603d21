//! Picture values whose blend shows what the map shows.
//!
//! Viewers of splats blend picture values. The map blends linear radiance, and the picture is formed
//! afterwards: a pixel of which a bright window covers half is burnt out there and grey here. So the
//! colours are those whose blend comes nearest to the program's own pictures. With the weight `w_pi`
//! of Gaussian i at pixel p (α times transmittance), its sum `o_p` over i and the picture `s_p`,
//!
//! ```text
//! Σ_i w_pi c_i = o_p s_p,   c_i in [0, 1]
//! c_i ← c_i + Σ_p w_pi (o_p s_p - Σ_j w_pj c_j) / (ε + Σ_p w_pi)
//! ```
//!
//! one step for each picture: the simultaneous algebraic reconstruction technique (Andersen & Kak
//! 1984), started from the display colour of each Gaussian alone.

use super::splat::{Display, Splat, splats};
use i2slam::geometry::{Image, Pose};
use i2slam::radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, MapGradient, RasterSettings, Rasterizer, Shape,
};
use i2slam::radiance::{RadianceMap, Render, RenderCotangent, View};
use i2slam::{FrameEstimate, Reconstruction};
use rayon::prelude::*;

/// Pictures that count, at most: evenly spaced among the frames.
const MAX_PICTURES: usize = 16;
/// `ε` [px]: Gaussians that are hardly seen keep their colour.
const MIN_PIXELS: f32 = 0.2;
/// Least opacity of pixels that count: holes are filled in pictures, not in blends.
const OPAQUE: f32 = 0.9;

/// The Gaussians of a reconstruction for viewers that blend picture values, in the
/// world of a file.
pub(crate) fn picture_splats(
    reconstruction: &Reconstruction,
    map: &GaussianMap<f32>,
    file_from_world: Pose<f64>,
) -> Vec<Splat> {
    let tone = reconstruction.typical_tone();
    let is_formed = tone.is_some();
    let mut splats = splats(map, &Display::Formed(tone), file_from_world);
    if is_formed && !splats.is_empty() {
        fit(&mut splats, reconstruction, file_from_world);
    }
    splats
}

fn fit(splats: &mut [Splat], reconstruction: &Reconstruction, file_from_world: Pose<f64>) {
    let mut viewer = reconstruction.viewer();
    let mut blend = Blend::new(splats);
    for frame in evenly_spaced(&reconstruction.frames, MAX_PICTURES) {
        let pose = frame.middle();
        let picture = viewer.sharp(&reconstruction.virtual_frame(frame.index, pose));
        let world_from_camera = file_from_world * pose;
        let view = View { camera: reconstruction.camera, world_from_camera };
        blend.step(splats, &view, &picture);
    }
}

/// At most so many of the frames that have a pose.
pub(super) fn evenly_spaced(frames: &[FrameEstimate], most: usize) -> Vec<&FrameEstimate> {
    let tracked: Vec<_> = frames.iter().filter(|frame| frame.tracked).collect();
    let count = tracked.len().min(most);
    (0..count).map(|k| tracked[(2 * k + 1) * tracked.len() / (2 * count)]).collect()
}

/// Splats as viewers blend them.
struct Blend {
    /// With linear colours, those seen from the last view.
    map: GaussianMap<f32>,
    rasterizer: Rasterizer,
    render: Render,
    gradient: MapGradient,
    cotangent: RenderCotangent,
}

impl Blend {
    fn new(splats: &[Splat]) -> Self {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Linear);
        for &Splat { mean, colour, opacity_logit, log_scale, rotation, .. } in splats {
            map.push(Gaussian { mean, log_scale, rotation, opacity_logit, colour });
        }
        Self {
            gradient: MapGradient::new(&map),
            map,
            rasterizer: Rasterizer::new(RasterSettings::default()),
            render: Render::default(),
            cotangent: RenderCotangent::default(),
        }
    }

    /// Draws the splats from a view.
    fn draw(&mut self, splats: &[Splat], view: &View<f64>) {
        let origin = view.world_from_camera.translation;
        let seen = splats.par_iter().map(|splat| splat.colour_from(origin));
        seen.collect_into_vec(&mut self.map.colours);
        self.map.render(&mut self.rasterizer, &view.cast(), &mut self.render);
    }

    /// Changes colours towards those that show a picture.
    fn step(&mut self, splats: &mut [Splat], view: &View<f64>, picture: &Image<f32>) {
        self.draw(splats, view);
        let pixels = self.render.opacity.data.len();
        let opacity = |at: usize| self.render.opacity.data[at % pixels];
        let counts = |at: usize| f32::from(u8::from(opacity(at) >= OPAQUE));
        let drawn = &self.render.radiance.data;
        let residual = |at: usize| opacity(at) * picture.data[at].clamp(0.0, 1.0) - drawn[at];
        let Image { width, height, channels, .. } = self.render.radiance;
        let with = |data: Vec<f32>| Image { data, width, height, channels };
        let residuals = with((0..3 * pixels).map(|at| counts(at) * residual(at)).collect());
        let weights = with((0..3 * pixels).map(counts).collect());
        let changes = self.sums_over_pixels(view, residuals);
        let weights = self.sums_over_pixels(view, weights);
        splats.par_iter_mut().zip(changes.par_iter().zip(&weights)).for_each(
            |(splat, (change, weight))| {
                splat.shift(std::array::from_fn(|c| change[c] / (MIN_PIXELS + weight[c])));
            },
        );
    }

    /// `Σ_p w_pi x_p` for each Gaussian.
    fn sums_over_pixels(&mut self, view: &View<f64>, x: Image<f32>) -> Vec<[f32; 3]> {
        self.cotangent.radiance = x;
        self.gradient.reset(&self.map);
        let (view, gradient) = (view.cast(), Some(&mut self.gradient));
        self.map.pull_back(&mut self.rasterizer, &view, &self.cotangent, gradient);
        self.gradient.colours.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::formation::{CameraResponse, NodeSpacing, StartCurve, Vignetting};
    use i2slam::geometry::Rotation;
    use i2slam::geometry::{Camera, Tangent, Vec3};
    use i2slam::{Config, Map, UnitOfLength};

    /// A wall of large Gaussians, each four pixels wide, half dark and half a hundred times brighter.
    fn wall() -> Reconstruction {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        for (row, column) in (-12..12).flat_map(|row| (-12..12).map(move |column| (row, column))) {
            let bright = (row + column) % 3 == 0;
            map.push(Gaussian {
                mean: [0.1 * column as f32, 0.1 * row as f32, 1.0],
                log_scale: [-2.8, -2.8, -6.0],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 1.0,
                colour: [if bright { 2.0 } else { -2.6 }; 3],
            });
        }
        let config = Config::default();
        let camera = Camera { width: 48, height: 32, fx: 40.0, fy: 40.0, cx: 24.0, cy: 16.0 };
        let mut wall = Reconstruction {
            responses: vec![CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2))],
            config,
            camera,
            frames: Vec::new(),
            online_trajectory: Vec::new(),
            map: Map::Gaussians(map),
            vignetting: Vignetting::default(),
            rolling_shutter_readout: 0.0,
            unit_of_length: UnitOfLength::Metre,
        };
        wall.frames = (0..20_i32)
            .map(|i| {
                let angle = 0.01 * f64::from(i);
                let tangent = Tangent::from_array([0.01 * f64::from(i), 0.0, 0.0, 0.0, angle, 0.0]);
                wall.virtual_frame(i as usize, Pose::identity().retract(tangent))
            })
            .collect();
        wall
    }

    /// Largest root-mean-square difference to the program's own pictures, from views between those
    /// that count.
    fn difference(splats: &[Splat], wall: &Reconstruction, file_from_world: Pose<f64>) -> f64 {
        let (mut viewer, mut blend, mut worst) = (wall.viewer(), Blend::new(splats), 0.0_f64);
        for frame in [&wall.frames[3], &wall.frames[13]] {
            let picture = viewer.sharp(frame);
            let world_from_camera = file_from_world * frame.middle();
            blend.draw(splats, &View { camera: wall.camera, world_from_camera });
            let pairs = picture.data.iter().zip(&blend.render.radiance.data);
            let sum: f64 = pairs.map(|(a, b)| f64::from(a.min(1.0) - b).powi(2)).sum();
            worst = worst.max((sum / picture.data.len() as f64).sqrt());
        }
        worst
    }

    #[test]
    fn blended_colours_show_the_programs_own_pictures() {
        let wall = wall();
        let Map::Gaussians(map) = &wall.map else { panic!("Gaussians") };
        let turn = Rotation::exp(Vec3::new(0.3, -0.4, 1.1));
        let moved = Pose::new(turn, Vec3::new(0.5, -1.0, 2.0));
        let alone = splats(map, &Display::Formed(wall.typical_tone()), moved);
        let fitted = picture_splats(&wall, map, moved);
        let (before, after) = (difference(&alone, &wall, moved), difference(&fitted, &wall, moved));
        assert!(before > 0.05 && after < 0.4 * before, "{before:.4} {after:.4}");
        let in_range = |splat: &Splat| splat.colour.iter().all(|c| (0.0..=1.0).contains(c));
        assert!(fitted.iter().all(in_range));
    }

    #[test]
    fn without_tone_colours_stay() {
        let mut wall = wall();
        wall.config.formation.tone = false;
        let Map::Gaussians(map) = &wall.map else { panic!("Gaussians") };
        let alone = splats(map, &Display::Formed(None), Pose::identity());
        assert_eq!(picture_splats(&wall, map, Pose::identity()), alone);
    }
}
