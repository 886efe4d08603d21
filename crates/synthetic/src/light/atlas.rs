//! Irradiance on a grid over every surface.

use crate::rgb::{Rgb, mix};
use crate::scene::{Scene, Surface};

/// Largest number of texels along a side of a surface.
const MAX_SIDE_TEXELS: f32 = 1024.0;

/// The grid of one surface.
#[derive(Clone, Copy)]
pub(super) struct Patch {
    pub(super) first: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

/// Irradiance for every texel of every surface.
pub(super) struct Atlas {
    pub(super) patches: Vec<Patch>,
    pub(super) values: Vec<Rgb>,
}

impl Atlas {
    /// A black atlas with texels of about `texel` [m].
    pub(super) fn new(scene: &Scene, texel: f32) -> Self {
        let mut first = 0;
        let patches = scene.surfaces.iter().map(|surface| {
            let (extent, least) = (surface.shape.extent(), surface.shape.least_texels());
            let side = |axis: usize| {
                (extent[axis] / texel).ceil().clamp(least[axis], MAX_SIDE_TEXELS) as usize
            };
            let [width, height] = [0, 1].map(side);
            let patch = Patch { first, width, height };
            first += width * height;
            patch
        });
        let patches = patches.collect();
        Self { patches, values: vec![[0.0; 3]; first] }
    }

    /// The value at `(s, t)` of a surface.
    #[inline]
    pub(super) fn sample(&self, surface: usize, st: [f32; 2]) -> Rgb {
        let Patch { first, width, height } = self.patches[surface];
        let x = (st[0] * width as f32 - 0.5).clamp(0.0, (width - 1) as f32);
        let y = (st[1] * height as f32 - 0.5).clamp(0.0, (height - 1) as f32);
        let (i, j) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
        let (du, dv) = (x - i as f32, y - j as f32);
        let row = &self.values[first + j * width + i..];
        let top = mix(row[0], row[1], du);
        mix(top, mix(row[width], row[width + 1], du), dv)
    }

    /// The value of the texel at `(s, t)` of a surface.
    #[inline]
    pub(super) fn nearest(&self, surface: usize, st: [f32; 2]) -> Rgb {
        let Patch { first, width, height } = self.patches[surface];
        let column = ((st[0] * width as f32) as usize).min(width - 1);
        let row = ((st[1] * height as f32) as usize).min(height - 1);
        self.values[first + row * width + column]
    }

    /// Fills every texel from its surface, its `(s, t)` and its number, in parallel.
    pub(super) fn fill(
        &mut self,
        scene: &Scene,
        value: impl Fn(&Surface, usize, [f32; 2], [usize; 2]) -> Rgb + Sync,
    ) {
        use rayon::prelude::*;
        let mut parts = Vec::new();
        let mut rest = self.values.as_mut_slice();
        for (index, patch) in self.patches.iter().enumerate() {
            for row in 0..patch.height {
                let (head, tail) = rest.split_at_mut(patch.width);
                parts.push((index, row, head));
                rest = tail;
            }
        }
        let patches = &self.patches;
        parts.into_par_iter().with_min_len(8).for_each(|(index, row, texels)| {
            let (surface, patch) = (&scene.surfaces[index], patches[index]);
            for (column, texel) in texels.iter_mut().enumerate() {
                let s = (column as f32 + 0.5) / patch.width as f32;
                let t = (row as f32 + 0.5) / patch.height as f32;
                *texel = value(surface, index, [s, t], [column, row]);
            }
        });
    }

    /// Averages over squares of `2 radius + 1` texels of the same surface.
    pub(super) fn smooth(&mut self, radius: usize) {
        for patch in &self.patches {
            let part = &mut self.values[patch.first..patch.first + patch.width * patch.height];
            let from = part.to_vec();
            for j in 0..patch.height {
                for i in 0..patch.width {
                    let (mut sum, mut count) = ([0.0; 3], 0.0);
                    for y in j.saturating_sub(radius)..(j + radius + 1).min(patch.height) {
                        for x in i.saturating_sub(radius)..(i + radius + 1).min(patch.width) {
                            sum = crate::rgb::plus(sum, from[y * patch.width + x]);
                            count += 1.0;
                        }
                    }
                    part[j * patch.width + i] = crate::rgb::scale(sum, 1.0 / count);
                }
            }
        }
    }
}
