//! Gaussians in PlayCanvas' compressed PLY, 16 bytes each and 72 for every 256 of them.
//!
//! Chunks of 256 Gaussians that lie near each other hold their extremes as floats; a Gaussian holds its
//! place between them: position and logarithm of scale in 11 + 10 + 11 bits, colour and opacity in 8
//! bits each, and the three smaller parts of its quaternion in 10 bits each.

use super::splat::Splat;
use std::io::{self, Write};

/// Gaussians in a chunk.
const CHUNK: usize = 256;

const CHUNK_PROPERTIES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];

const PROPERTIES: [&str; 4] =
    ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Largest logarithm of a scale.
const MAX_LOG_SCALE: f32 = 20.0;

/// Writes the file, with a comment in its header. Gaussians come in another order, along a Z curve.
pub fn write(out: &mut dyn Write, splats: &[Splat], comment: &str) -> io::Result<()> {
    let ordered: Vec<Splat> = z_curve(splats).into_iter().map(|i| splats[i]).collect();
    let chunks: Vec<Chunk> = ordered.chunks(CHUNK).map(Chunk::of).collect();
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment {comment}")?;
    writeln!(out, "element chunk {}", chunks.len())?;
    for property in CHUNK_PROPERTIES {
        writeln!(out, "property float {property}")?;
    }
    writeln!(out, "element vertex {}", ordered.len())?;
    for property in PROPERTIES {
        writeln!(out, "property uint {property}")?;
    }
    writeln!(out, "end_header")?;
    for Range3 { least, most } in
        chunks.iter().flat_map(|chunk| [chunk.mean, chunk.scale, chunk.colour])
    {
        for value in least.into_iter().chain(most) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    for (chunk, splats) in chunks.iter().zip(ordered.chunks(CHUNK)) {
        for word in splats.iter().flat_map(|splat| chunk.pack(splat)) {
            out.write_all(&word.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Extremes of three numbers.
#[derive(Clone, Copy, Debug)]
struct Range3 {
    least: [f32; 3],
    most: [f32; 3],
}

impl Range3 {
    fn of(values: impl Iterator<Item = [f32; 3]>) -> Self {
        let empty = Self { least: [f32::INFINITY; 3], most: [f32::NEG_INFINITY; 3] };
        values.fold(empty, |range, value| Self {
            least: std::array::from_fn(|i| range.least[i].min(value[i])),
            most: std::array::from_fn(|i| range.most[i].max(value[i])),
        })
    }

    /// Places from 0 to 1 between the extremes.
    fn place(&self, value: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| {
            let width = self.most[i] - self.least[i];
            if width > 0.0 { (value[i] - self.least[i]) / width } else { 0.0 }
        })
    }
}

/// Extremes of a chunk.
struct Chunk {
    mean: Range3,
    scale: Range3,
    colour: Range3,
}

impl Chunk {
    fn of(splats: &[Splat]) -> Self {
        Self {
            mean: Range3::of(splats.iter().map(|s| s.mean)),
            scale: Range3::of(splats.iter().map(log_scale)),
            colour: Range3::of(splats.iter().map(|s| s.colour)),
        }
    }

    fn pack(&self, splat: &Splat) -> [u32; 4] {
        let [r, g, b] = self.colour.place(splat.colour).map(|v| bits(v, 8));
        // 0 and 255 would be read as logits without end.
        let opacity = bits(splat.opacity(), 8).clamp(1, 254);
        [
            pack_11_10_11(self.mean.place(splat.mean)),
            pack_rotation(splat.rotation),
            pack_11_10_11(self.scale.place(log_scale(splat))),
            r << 24 | g << 16 | b << 8 | opacity,
        ]
    }
}

fn log_scale(splat: &Splat) -> [f32; 3] {
    splat.log_scale.map(|v| v.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE))
}

/// A number from 0 to 1 in so many bits.
fn bits(value: f32, count: u32) -> u32 {
    let most = ((1_u32 << count) - 1) as f32;
    (value * most).round().clamp(0.0, most) as u32
}

fn pack_11_10_11([x, y, z]: [f32; 3]) -> u32 {
    bits(x, 11) << 21 | bits(y, 10) << 11 | bits(z, 11)
}

/// A unit quaternion w x y z: the place of its largest part in two bits, which is then made positive,
/// and the others, which lie between -√½ and √½.
fn pack_rotation(rotation: [f32; 4]) -> u32 {
    let largest =
        (0..4).fold(0, |best, i| if rotation[i].abs() > rotation[best].abs() { i } else { best });
    let sign = if rotation[largest] < 0.0 { -1.0 } else { 1.0 };
    (0..4).filter(|&i| i != largest).fold(largest as u32, |word, i| {
        word << 10 | bits(sign * rotation[i] * std::f32::consts::FRAC_1_SQRT_2 + 0.5, 10)
    })
}

/// Places of Gaussians along a Z curve: neighbours in a chunk are neighbours in space.
fn z_curve(splats: &[Splat]) -> Vec<usize> {
    let range = Range3::of(splats.iter().map(|s| s.mean));
    let code = |splat: &Splat| {
        let [x, y, z] = range.place(splat.mean).map(|v| spread(bits(v, 21)));
        x << 2 | y << 1 | z
    };
    let mut order: Vec<(u64, usize)> =
        splats.iter().enumerate().map(|(i, splat)| (code(splat), i)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

/// 21 bits with two zeros before each.
fn spread(value: u32) -> u64 {
    (0..21).fold(0, |code, bit| code | u64::from(value >> bit & 1) << (3 * bit))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splats(count: usize) -> Vec<Splat> {
        let wave = |i: usize, k: f32| (i as f32 * k).sin();
        let splat = |i: usize| {
            let q: [f32; 4] = std::array::from_fn(|c| wave(i + 7 * c, 1.7));
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            Splat {
                mean: [3.0 * wave(i, 0.1), wave(i, 0.7), 2.0 + wave(i, 0.3)],
                colour: [0.5 + 0.5 * wave(i, 0.2), 0.3, 0.5 + 0.4 * wave(i, 0.9)],
                view: None,
                opacity_logit: 9.0 * wave(i, 0.4),
                log_scale: [-4.0 + wave(i, 0.6), -5.0, -3.0 + wave(i, 1.1)],
                rotation: q.map(|v| v / norm),
            }
        };
        (0..count).map(splat).collect()
    }

    fn body(bytes: &[u8]) -> (String, Vec<[u8; 4]>) {
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
        let words = bytes[start..].chunks_exact(4).map(|b| [b[0], b[1], b[2], b[3]]);
        (String::from_utf8_lossy(&bytes[..start]).into_owned(), words.collect())
    }

    #[test]
    fn values_come_back_within_a_step() {
        let splats = splats(300);
        let mut bytes = Vec::new();
        write(&mut bytes, &splats, "a test").expect("memory");
        let (header, words) = body(&bytes);
        assert!(header.contains("comment a test\nelement chunk 2\n"));
        assert!(header.contains("element vertex 300\n"));
        assert_eq!(words.len(), 2 * 18 + 300 * 4);
        let order = z_curve(&splats);
        for (i, &from) in order.iter().enumerate() {
            let chunk: Vec<f32> =
                words[i / CHUNK * 18..][..18].iter().map(|b| f32::from_le_bytes(*b)).collect();
            let word = |k: usize| u32::from_le_bytes(words[36 + 4 * i + k]);
            let unpack = |value: u32, first: usize, axis: usize| {
                let (shift, count) = [(21, 11), (11, 10), (0, 11)][axis];
                let most = (1_u32 << count) - 1;
                let (least, largest) = (chunk[first + axis], chunk[first + 3 + axis]);
                let step = (largest - least) / most as f32;
                (least + (value >> shift & most) as f32 * step, step)
            };
            let splat = &splats[from];
            for axis in 0..3 {
                let (mean, step) = unpack(word(0), 0, axis);
                assert!((mean - splat.mean[axis]).abs() <= 0.51 * step + 1e-6);
                let (scale, step) = unpack(word(2), 6, axis);
                assert!((scale - splat.log_scale[axis]).abs() <= 0.51 * step + 1e-6);
            }
            let opacity = (word(3) & 255) as f32 / 255.0;
            assert!(
                (opacity - splat.opacity()).abs() < 1.1 / 255.0 && opacity > 0.0 && opacity < 1.0
            );
            let red = chunk[12] + (word(3) >> 24) as f32 / 255.0 * (chunk[15] - chunk[12]);
            assert!((red - splat.colour[0]).abs() < 0.5 / 255.0);
            // The same rotation: the product of both quaternions is one, or minus one.
            let cosine: f32 =
                unpack_rotation(word(1)).iter().zip(splat.rotation).map(|(a, b)| a * b).sum();
            assert!(cosine.abs() > 0.99999, "{cosine}");
        }
    }

    fn unpack_rotation(word: u32) -> [f32; 4] {
        let part = |shift: u32| ((word >> shift & 1023) as f32 / 1023.0 - 0.5) * 2.0_f32.sqrt();
        let others = [part(20), part(10), part(0)];
        let largest = (1.0 - others.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
        let place = (word >> 30) as usize;
        let mut others = others.into_iter();
        std::array::from_fn(|i| if i == place { largest } else { others.next().unwrap_or(0.0) })
    }

    #[test]
    fn neighbours_share_a_chunk() {
        let splats = splats(16 * CHUNK);
        let order = z_curve(&splats);
        let volume = |places: &[usize]| -> f32 {
            let range = Range3::of(places.iter().map(|&i| splats[i].mean));
            (0..3).map(|i| range.most[i] - range.least[i]).product()
        };
        let mean = order.chunks(CHUNK).map(volume).sum::<f32>() / 16.0;
        assert!(mean < 0.25 * volume(&order), "{mean} {}", volume(&order));
        assert_eq!(spread(0b101), 0b1_000_001);
    }
}
