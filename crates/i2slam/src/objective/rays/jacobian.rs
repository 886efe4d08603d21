//! How the colours of a frame depend on its motion.

use super::{RayObjective, RayRender, RayView};
use crate::objective::Tone;
use i2slam_compute::Random;
use i2slam_formation::{CurveGradient, Formation, FrameToneGradient};
use i2slam_radiance::hashgrid::HashGridMap;

/// A symmetric matrix over start (ρ, φ) and end (ρ, φ).
pub type ShutterGram = [[f64; 12]; 12];

impl RayObjective {
    /// `JᵀJ / m` of the `m` colour values of the pixels of `view`, `J` being their derivative by
    /// both poses: of the photometric error, because what the camera saw does not depend on them.
    pub fn gram(
        &mut self,
        map: &HashGridMap,
        view: &RayView<'_>,
        random: &mut Random,
    ) -> ShutterGram {
        self.draw(std::slice::from_ref(view), random);
        self.renderer.keep_slopes(true);
        self.renderer.render(&map.field, &map.occupancy, &self.rays, &mut self.renders);
        self.average(view, &(0..self.rays.len()));
        self.slopes(view);
        let mut gram = [[0.0; 12]; 12];
        for channel in 0..3 {
            self.seed(view, channel);
            let by_rays = Some(&mut self.ray_gradients);
            self.renderer.pull_back(&map.field, &self.rays, &self.cotangents, None, by_rays);
            for i in 0..view.pixels.len() {
                let row = self.row(view, i);
                for (entries, a) in gram.iter_mut().zip(row) {
                    entries.iter_mut().zip(row).for_each(|(entry, b)| *entry += a * b);
                }
            }
        }
        let values = (3 * view.pixels.len()).max(1) as f64;
        gram.map(|row| row.map(|entry| entry / values))
    }

    /// `d_hdr`: the slope of every picture value by its own radiance; channels do not mix.
    fn slopes(&mut self, view: &RayView<'_>) {
        self.d_picture.reset(view.pixels.len(), 1, 3);
        self.d_picture.data.fill(1.0);
        let Some(Tone { frame, curve }) = &view.variables.tone else {
            self.d_hdr.clone_from(&self.d_picture);
            return;
        };
        Formation::new(frame, curve).pull_back(
            &self.hdr,
            &self.d_picture,
            &mut self.d_hdr,
            &mut FrameToneGradient::default(),
            &mut CurveGradient::zero(curve),
        );
    }

    /// Cotangents of one channel of every pixel.
    fn seed(&mut self, view: &RayView<'_>, channel: usize) {
        let (times, stride) = (view.times(), view.rays_per_pixel());
        let slopes = self.d_hdr.plane(channel);
        self.cotangents.clear();
        self.cotangents.resize(self.rays.len(), RayRender::default());
        for (rays, slope) in self.cotangents.chunks_mut(stride).zip(slopes) {
            rays[..times].iter_mut().for_each(|r| r.radiance[channel] = slope / times as f32);
        }
    }

    /// The derivative of one value by both poses.
    fn row(&self, view: &RayView<'_>, i: usize) -> [f64; 12] {
        let stride = view.rays_per_pixel();
        let rays = i * stride..(i + 1) * stride;
        let each = rays.map(|ray| self.ray_to_shutter(view, view.pixels[i], ray));
        each.fold(Default::default(), |a: i2slam_formation::ShutterTangent<f64>, b| a.plus(b))
            .to_array()
    }
}
