//! Gaussians in 18 bytes each, for the page.
//!
//! Gaussians are put in order along a Morton curve and cut into chunks of [`CHUNK`]. A chunk holds
//! the bounds of its means, log-scales and colours; a Gaussian holds its place between them:
//!
//! | section | of | content, little endian |
//! |---|---|---|
//! | bounds | a chunk | 18 `f32`: lowest mean, log-scale, colour (3 each), then highest |
//! | rotation | a Gaussian | `u32`: number of the largest component in the upper 2 bits, then the others, 10 bits each |
//! | colour | a Gaussian | `u32`: R, G, B from the lowest bit on, 10 bits each |
//! | cone | a view colour | `u32`: rotation, as above |
//! | mean | a Gaussian | 3 `u16` |
//! | spread | a view colour | `u16`: from 0 to 1 |
//! | coefficients | a term of a view colour | 3 `i16`: 1 is [`COEFFICIENT_STEPS`] |
//! | log-scale | a Gaussian | 3 `u8` |
//! | opacity | a Gaussian | `u8`: from [`MIN_OPACITY`] to 1 |
//! | terms | a view colour | `u8`: their number |
//!
//! Gaussians with a view colour come first. Sections follow each other without gaps. `page/map.js`
//! reads them.

use i2slam::radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, RasterSettings, Shape, ViewColour,
};

/// Gaussians that share bounds.
pub(super) const CHUNK: usize = 256;

/// Opacity below which no renderer of ours draws a Gaussian: [`RasterSettings::alpha_min`].
pub(super) const MIN_OPACITY: f32 = 1.0 / 255.0;

/// Quantised Gaussians.
pub(super) struct QuantisedMap {
    /// Number of Gaussians: those that can be seen.
    pub(super) count: usize,
    /// View colours, and terms of all of them.
    pub(super) view_colours: usize,
    pub(super) view_terms: usize,
    /// The sections.
    pub(super) bytes: Vec<u8>,
}

/// Steps of a value of 8, 10 or 16 bits.
const STEPS_8: f32 = 255.0;
const STEPS_10: f32 = 1023.0;
const STEPS_16: f32 = 65535.0;
/// Steps of a coefficient of a view colour from 0 to 1.
const COEFFICIENT_STEPS: f32 = 2048.0;

/// The largest absolute value of a component of a unit quaternion that is not the largest.
const QUATERNION_RANGE: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// Quantises the Gaussians that can be seen: finite, and at least as opaque as [`MIN_OPACITY`].
pub(super) fn quantised(map: &GaussianMap<f32>) -> QuantisedMap {
    debug_assert_eq!(MIN_OPACITY, RasterSettings::default().alpha_min);
    let seen: Vec<Drawn<'_>> = (0..map.len()).filter_map(|i| drawable(map, i)).collect();
    let ordered = ordered(seen);
    let mut sections: [Vec<u8>; 10] = Default::default();
    for chunk in ordered.chunks(CHUNK) {
        let bounds = Bounds::of(chunk.iter().map(|drawn| &drawn.gaussian));
        sections[0].extend(bounds.values().flat_map(f32::to_le_bytes));
        for Drawn { gaussian: g, view } in chunk {
            sections[1].extend(packed_rotation(g.rotation).to_le_bytes());
            let [r, gr, b] = bounds.place(COLOUR, g.colour, STEPS_10);
            sections[2].extend((r | gr << 10 | b << 20).to_le_bytes());
            let mean = bounds.place(MEAN, g.mean, STEPS_16);
            sections[4].extend(mean.into_iter().flat_map(|v| (v as u16).to_le_bytes()));
            sections[7].extend(bounds.place(LOG_SCALE, g.log_scale, STEPS_8).map(|v| v as u8));
            let share = (opacity(g) - MIN_OPACITY) / (1.0 - MIN_OPACITY);
            sections[8].push((share * STEPS_8).round() as u8);
            if let Some(ViewColour { cone, coefficients }) = view {
                sections[3].extend(packed_rotation(cone.rotation).to_le_bytes());
                let spread = (cone.spread * STEPS_16).round() as u16;
                sections[5].extend(spread.max(1).to_le_bytes());
                let values = coefficients.as_flattened().iter();
                let steps = values.map(|v| (v * COEFFICIENT_STEPS).round() as i16);
                sections[6].extend(steps.flat_map(i16::to_le_bytes));
                sections[9].push(coefficients.len() as u8);
            }
        }
    }
    QuantisedMap {
        count: ordered.len(),
        view_colours: sections[9].len(),
        view_terms: sections[6].len() / 6,
        bytes: sections.concat(),
    }
}

/// A Gaussian that is drawn, with its view colour.
struct Drawn<'a> {
    gaussian: Gaussian<f32>,
    view: Option<ViewColour<'a, f32>>,
}

fn opacity(g: &Gaussian<f32>) -> f32 {
    (1.0 + (-g.opacity_logit).exp()).recip()
}

/// The Gaussian with three scales and a unit quaternion; `None` if it is never drawn. Only colours
/// that are logarithms depend on the view.
fn drawable(map: &GaussianMap<f32>, index: usize) -> Option<Drawn<'_>> {
    let g = map.get(index)?;
    let norm = g.rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
    let (log_scale, rotation) = match map.shape {
        Shape::Isotropic => ([g.log_scale[0]; 3], [1.0, 0.0, 0.0, 0.0]),
        Shape::Anisotropic => (g.log_scale, g.rotation.map(|v| v / norm)),
    };
    let gaussian = Gaussian { log_scale, rotation, ..g };
    let view = map.view_colours.get(index);
    let view = view.filter(|_| map.activation == ColourActivation::Exponential);
    let coefficients = view.map_or(&[][..], |view| view.coefficients).as_flattened();
    let values: [&[f32]; 5] =
        [&g.mean, &gaussian.log_scale, &gaussian.rotation, &g.colour, coefficients];
    let finite = values.into_iter().flatten().all(|v| v.is_finite());
    (finite && opacity(&g) >= MIN_OPACITY).then_some(Drawn { gaussian, view })
}

/// Orders Gaussians along a Morton curve through their bounding box, so that neighbours share a chunk;
/// those with a view colour first.
fn ordered(gaussians: Vec<Drawn<'_>>) -> Vec<Drawn<'_>> {
    let bounds = Bounds::of(gaussians.iter().map(|drawn| &drawn.gaussian));
    let key = |drawn: &Drawn<'_>| {
        let steps = ((1_u32 << MORTON_BITS) - 1) as f32;
        (drawn.view.is_none(), morton(bounds.place(MEAN, drawn.gaussian.mean, steps)))
    };
    let mut ordered = gaussians;
    ordered.sort_by_cached_key(key);
    ordered
}

/// Bits of a coordinate on the Morton curve.
const MORTON_BITS: u32 = 21;

/// Bits of three numbers, taken in turns.
fn morton(cell: [u32; 3]) -> u64 {
    (0..MORTON_BITS).fold(0, |key, bit| {
        let of = |axis: usize| u64::from(cell[axis] >> bit & 1) << (3 * bit + axis as u32);
        key | of(0) | of(1) | of(2)
    })
}

/// Groups of three numbers within [`Bounds`].
const MEAN: usize = 0;
const LOG_SCALE: usize = 3;
const COLOUR: usize = 6;

/// Lowest and highest mean, log-scale and colour.
struct Bounds {
    low: [f32; 9],
    high: [f32; 9],
}

impl Bounds {
    fn of<'a>(gaussians: impl Iterator<Item = &'a Gaussian<f32>>) -> Self {
        let mut bounds = Self { low: [f32::INFINITY; 9], high: [f32::NEG_INFINITY; 9] };
        for g in gaussians {
            let values = [g.mean, g.log_scale, g.colour].into_iter().flatten();
            for (i, value) in values.enumerate() {
                bounds.low[i] = bounds.low[i].min(value);
                bounds.high[i] = bounds.high[i].max(value);
            }
        }
        bounds
    }

    fn values(&self) -> impl Iterator<Item = f32> {
        self.low.into_iter().chain(self.high)
    }

    /// The places of three values between their bounds, from 0 to `steps`.
    fn place(&self, group: usize, values: [f32; 3], steps: f32) -> [u32; 3] {
        std::array::from_fn(|i| {
            let (low, high) = (self.low[group + i], self.high[group + i]);
            let share = if high > low { (values[i] - low) / (high - low) } else { 0.0 };
            (share * steps).round() as u32
        })
    }
}

/// A unit quaternion without its largest component, which is made positive.
fn packed_rotation(rotation: [f32; 4]) -> u32 {
    let largest =
        (1..4).fold(0, |best, i| if rotation[i].abs() > rotation[best].abs() { i } else { best });
    let sign = rotation[largest].signum();
    let others = (0..4).filter(|&i| i != largest);
    others.enumerate().fold((largest as u32) << 30, |packed, (place, i)| {
        let share = 0.5 + 0.5 * (sign * rotation[i] / QUATERNION_RANGE).clamp(-1.0, 1.0);
        packed | ((share * STEPS_10).round() as u32) << (10 * place)
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use i2slam::geometry::{Camera, Pose};
    use i2slam::radiance::gaussian::Cone;
    use i2slam::radiance::{RadianceMap, Render, View};
    use i2slam_check::noise;

    /// Reads what [`quantised`] wrote, as `page/map.js` does.
    fn restored(quantised: &QuantisedMap, activation: ColourActivation) -> GaussianMap<f32> {
        let (n, bytes) = (quantised.count, &quantised.bytes);
        let (m, terms) = (quantised.view_colours, quantised.view_terms);
        let lengths =
            [72 * n.div_ceil(CHUNK), 4 * n, 4 * n, 4 * m, 6 * n, 2 * m, 6 * terms, 3 * n, n, m];
        let mut at = 0;
        let [
            bounds,
            rotations,
            colours,
            cones,
            means,
            spreads,
            coefficients,
            scales,
            opacities,
            terms,
        ] = lengths.map(|length| {
            at += length;
            &bytes[at - length..at]
        });
        assert_eq!(at, bytes.len());
        let word = |section: &[u8], i: usize| {
            u32::from_le_bytes(section[4 * i..4 * i + 4].try_into().expect("four bytes"))
        };
        let mut map = GaussianMap::new(Shape::Anisotropic, activation);
        for i in 0..n {
            let between = |k: usize, share: f32| {
                let bound =
                    |high: usize| f32::from_bits(word(bounds, i / CHUNK * 18 + 9 * high + k));
                bound(0) + share * (bound(1) - bound(0))
            };
            let place = |k: usize| 2 * (3 * i + k);
            let half = |k: usize| u16::from_le_bytes([means[place(k)], means[place(k) + 1]]);
            let tenth = |k: usize| (word(colours, i) >> (10 * k) & 1023) as f32 / STEPS_10;
            let opacity = MIN_OPACITY + f32::from(opacities[i]) / STEPS_8 * (1.0 - MIN_OPACITY);
            map.push(Gaussian {
                mean: std::array::from_fn(|k| between(MEAN + k, f32::from(half(k)) / STEPS_16)),
                log_scale: std::array::from_fn(|k| {
                    between(LOG_SCALE + k, f32::from(scales[3 * i + k]) / STEPS_8)
                }),
                rotation: unpacked_rotation(word(rotations, i)),
                opacity_logit: (opacity / (1.0 - opacity).max(1e-6)).ln(),
                colour: std::array::from_fn(|k| between(COLOUR + k, tenth(k))),
            });
        }
        let short = |section: &[u8], i: usize| [section[2 * i], section[2 * i + 1]];
        let mut first = 0;
        for i in 0..m {
            let spread = f32::from(u16::from_le_bytes(short(spreads, i))) / STEPS_16;
            let coefficient = |row: usize| {
                std::array::from_fn(|c| {
                    let value = i16::from_le_bytes(short(coefficients, 3 * row + c));
                    f32::from(value) / COEFFICIENT_STEPS
                })
            };
            let end = first + usize::from(terms[i]);
            let rows: Vec<[f32; 3]> = (first..end).map(coefficient).collect();
            let rotation = unpacked_rotation(word(cones, i));
            map.view_colours.push(i, Cone { rotation, spread }, &rows);
            first = end;
        }
        map
    }

    fn unpacked_rotation(packed: u32) -> [f32; 4] {
        let largest = (packed >> 30) as usize;
        let mut rotation = [0.0; 4];
        for (place, i) in (0..4).filter(|&i| i != largest).enumerate() {
            let share = (packed >> (10 * place) & 1023) as f32 / STEPS_10;
            rotation[i] = (2.0 * share - 1.0) * QUATERNION_RANGE;
        }
        let rest: f32 = rotation.iter().map(|v| v * v).sum();
        rotation[largest] = (1.0 - rest).max(0.0).sqrt();
        rotation
    }

    /// A wall of flat Gaussians of all opacities and nine stops, with a few that cannot be drawn.
    pub(crate) fn wall(count: usize) -> GaussianMap<f32> {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        let noise = noise(5, 12 * count);
        for n in noise.chunks(12) {
            let n: Vec<f32> = n.iter().map(|&v| v as f32).collect();
            map.push(Gaussian {
                mean: [1.2 * n[0], 0.9 * n[1], 2.0 + 0.4 * n[2]],
                log_scale: [-3.6 + 0.5 * n[3], -3.9 + 0.5 * n[4], -6.0 + 0.5 * n[5]],
                rotation: [0.5 + n[6], n[7], n[8], n[9]],
                opacity_logit: 2.0 + 5.0 * n[10],
                colour: [3.0 * n[11], -3.0 * n[11], 1.5 * (n[0] + n[1])],
            });
        }
        for (i, n) in noise.as_chunks::<12>().0.iter().enumerate().step_by(3) {
            let n = n.map(|v| v as f32);
            let cone = Cone { rotation: [1.0, 0.2 * n[0], 0.2 * n[1], 0.0], spread: 0.3 };
            let norm = cone.rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
            let cone = Cone { rotation: cone.rotation.map(|v| v / norm), ..cone };
            let rows = [[n[3], n[4], n[5]], [n[6], n[7], n[8]]];
            map.view_colours.push(i, cone, &rows);
        }
        let last = map.get(0).expect("a Gaussian");
        map.push(Gaussian { mean: [f32::NAN; 3], ..last });
        map.push(Gaussian { opacity_logit: -6.0, ..last });
        map
    }

    fn pictures_of(map: &GaussianMap<f32>) -> Vec<f32> {
        let camera = Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };
        let view = View { camera, world_from_camera: Pose::identity() };
        let mut render = Render::new(camera.width, camera.height);
        let mut renderer = GaussianMap::renderer(&RasterSettings::default());
        map.render(&mut renderer, &view, &mut render);
        // Encoded by a power, at the exposure of the middle.
        render.radiance.data.iter().map(|v| (0.4 * v).clamp(0.0, 1.0).powf(1.0 / 2.2)).collect()
    }

    fn psnr(a: &[f32], b: &[f32]) -> f64 {
        let square = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        -10.0 * (square / a.len() as f64).log10()
    }

    #[test]
    fn pictures_stay_within_40_decibels() {
        let map = wall(6000);
        let quantised = quantised(&map);
        assert_eq!(quantised.count, map.len() - 2 - never_seen(&map));
        assert_eq!(
            quantised.bytes.len(),
            18 * quantised.count
                + 72 * quantised.count.div_ceil(CHUNK)
                + 7 * quantised.view_colours
                + 6 * quantised.view_terms
        );
        assert!(
            quantised.view_colours > 1000 && quantised.view_terms == 2 * quantised.view_colours
        );
        let restored = restored(&quantised, map.activation);
        let (before, after) = (pictures_of(&map), pictures_of(&restored));
        let level = before.iter().sum::<f32>() / before.len() as f32;
        assert!(level > 0.2 && level < 0.8, "{level}");
        let psnr = psnr(&before, &after);
        assert!(psnr > 40.0, "{psnr} dB");
        // The comparison sees a colour that is off by a tenth.
        let mut off = restored;
        off.colours.iter_mut().for_each(|c| c[1] += 0.1);
        assert!(self::psnr(&before, &pictures_of(&off)) < 40.0);
        let mut flat = map.clone();
        flat.view_colours = Default::default();
        assert!(self::psnr(&before, &pictures_of(&flat)) < 40.0);
    }

    /// Gaussians of [`wall`] that are too transparent, but for its last two.
    fn never_seen(map: &GaussianMap<f32>) -> usize {
        map.iter().take(map.len() - 2).filter(|g| opacity(g) < MIN_OPACITY).count()
    }

    #[test]
    fn balls_become_round_gaussians() {
        let mut map = wall(3);
        map.shape = Shape::Isotropic;
        let restored = restored(&quantised(&map), map.activation);
        for g in restored.iter() {
            assert_eq!(g.log_scale, [g.log_scale[0]; 3]);
            assert!(g.rotation[0] > 0.999_99, "{:?}", g.rotation);
        }
    }

    #[test]
    fn a_map_that_shows_nothing_has_no_bytes() {
        let empty = quantised(&GaussianMap::new(Shape::Isotropic, ColourActivation::Linear));
        assert_eq!((empty.count, empty.bytes.len()), (0, 0));
    }
}
