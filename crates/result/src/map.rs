//! The map as a file: lossless (`map.i2slam`), and in the PLY layout of viewers of 3D Gaussian
//! splatting (`map.ply`, Kerbl et al. 2023).

use crate::archive::{Archive, Array};
use i2slam::Map;
use i2slam::formation::{FrameTone, ResponseCurve};
use i2slam::radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Shape};
use i2slam::radiance::hashgrid::HashGridMap;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};

/// Header of Gaussians in `map.i2slam`.
#[derive(Serialize, Deserialize)]
struct MapMeta {
    kind: Kind,
    count: usize,
    #[serde(with = "ShapeName")]
    shape: Shape,
    #[serde(with = "ColourActivationName")]
    colour_activation: ColourActivation,
    written_by: String,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Gaussians,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Shape", rename_all = "kebab-case")]
enum ShapeName {
    Isotropic,
    Anisotropic,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "ColourActivation", rename_all = "kebab-case")]
enum ColourActivationName {
    Exponential,
    Linear,
}

/// First bytes of a hash grid in `map.i2slam`.
const HASH_GRID_MAGIC: &[u8] = b"I2FIELD\n";

/// Writes every parameter of the map, bit for bit.
pub(crate) fn write_native(out: &mut dyn Write, map: &Map) -> io::Result<()> {
    match map {
        Map::Gaussians(map) => write_gaussians(out, map),
        Map::HashGrid(map) => out.write_all(&map.to_bytes()),
    }
}

/// Reads `map.i2slam`; the error says what is wrong with the file.
pub(crate) fn read_native(bytes: &[u8]) -> Result<Map, String> {
    if bytes.starts_with(HASH_GRID_MAGIC) {
        let map = HashGridMap::from_bytes(bytes).map_err(|e| e.to_string())?;
        return Ok(Map::HashGrid(Box::new(map)));
    }
    read_gaussians(bytes).map(Map::Gaussians)
}

fn write_gaussians(out: &mut dyn Write, map: &GaussianMap<f32>) -> io::Result<()> {
    let meta = MapMeta {
        kind: Kind::Gaussians,
        count: map.len(),
        shape: map.shape,
        colour_activation: map.activation,
        written_by: concat!("i2slam ", env!("CARGO_PKG_VERSION")).to_owned(),
    };
    let array = |name: &str, columns, values| Array { name: name.to_owned(), columns, values };
    let arrays = vec![
        array("mean", 3, map.means.concat()),
        array("log_scale", 3, map.log_scales.concat()),
        array("rotation", 4, map.rotations.concat()),
        array("opacity_logit", 1, map.opacity_logits.clone()),
        array("colour", 3, map.colours.concat()),
    ];
    Archive { meta, arrays }.write(out)
}

fn read_gaussians(bytes: &[u8]) -> Result<GaussianMap<f32>, String> {
    let mut archive = Archive::<MapMeta>::read(bytes)?;
    let map = GaussianMap {
        shape: archive.meta.shape,
        activation: archive.meta.colour_activation,
        means: rows(archive.take("mean", 3)?),
        log_scales: rows(archive.take("log_scale", 3)?),
        rotations: rows(archive.take("rotation", 4)?),
        opacity_logits: archive.take("opacity_logit", 1)?,
        colours: rows(archive.take("colour", 3)?),
    };
    let lengths =
        [map.log_scales.len(), map.rotations.len(), map.opacity_logits.len(), map.colours.len()];
    if lengths.iter().any(|&n| n != map.means.len()) {
        return Err("has arrays of different length".to_owned());
    }
    Ok(map)
}

fn rows<const N: usize>(values: Vec<f32>) -> Vec<[f32; N]> {
    let row = |chunk: &[f32]| std::array::from_fn(|i| chunk[i]);
    values.chunks_exact(N).map(row).collect()
}

/// Writes Gaussians for viewers. These know neither exposure nor response: colours are formed with
/// `tone`, the [typical tone](i2slam::Reconstruction::typical_tone) of the run.
pub(crate) fn write_ply(
    out: &mut dyn Write,
    map: &GaussianMap<f32>,
    tone: Option<(FrameTone<f32>, ResponseCurve<f32>)>,
) -> io::Result<()> {
    let splats = (0..map.len()).map(|i| {
        let gaussian = Gaussian {
            mean: map.means[i],
            log_scale: map.log_scales[i],
            rotation: map.rotations[i],
            opacity_logit: map.opacity_logits[i],
            colour: map.colours[i],
        };
        splat(&gaussian, map, tone.as_ref())
    });
    write_splats(out, splats)
}

fn splat(
    gaussian: &Gaussian<f32>,
    map: &GaussianMap<f32>,
    tone: Option<&(FrameTone<f32>, ResponseCurve<f32>)>,
) -> Splat {
    let isotropic = map.shape == Shape::Isotropic;
    let log_scale = if isotropic { [gaussian.log_scale[0]; 3] } else { gaussian.log_scale };
    let norm = gaussian.rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
    let turned = !isotropic && norm.is_finite() && norm > 0.0;
    let rotation = if turned { gaussian.rotation.map(|v| v / norm) } else { [1.0, 0.0, 0.0, 0.0] };
    let colour = display_colour(map.activation.radiance(gaussian.colour), tone);
    let opacity_logit = gaussian.opacity_logit;
    Splat { mean: gaussian.mean, colour, opacity_logit, log_scale, rotation }
}

fn display_colour(
    radiance: [f32; 3],
    tone: Option<&(FrameTone<f32>, ResponseCurve<f32>)>,
) -> [f32; 3] {
    let Some((tone, curve)) = tone else {
        return radiance.map(|v| v.clamp(0.0, 1.0));
    };
    let gains = tone.gains();
    std::array::from_fn(|c| curve.evaluate(c, gains[c] * radiance[c]).clamp(0.0, 1.0))
}

/// The zeroth real spherical harmonic, `1 / (2 √π)`: colour = 0.5 + C0 · f_dc.
const HARMONIC_ZERO: f32 = 0.282_094_8;

const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
    "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

/// One Gaussian as viewers expect it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Splat {
    /// Mean in the world [m].
    mean: [f32; 3],
    /// Display colour (sRGB), 0 to 1.
    colour: [f32; 3],
    /// Logit of the opacity.
    opacity_logit: f32,
    /// Natural logarithms of the standard deviations [log m].
    log_scale: [f32; 3],
    /// World-from-Gaussian quaternion `w, x, y, z`.
    rotation: [f32; 4],
}

/// Writes binary little-endian PLY.
fn write_splats(
    out: &mut dyn Write,
    splats: impl ExactSizeIterator<Item = Splat>,
) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", splats.len())?;
    for property in PROPERTIES {
        writeln!(out, "property float {property}")?;
    }
    writeln!(out, "end_header")?;
    for splat in splats {
        let harmonics = splat.colour.map(|c| (c - 0.5) / HARMONIC_ZERO);
        let groups: [&[f32]; 6] = [
            &splat.mean,
            &[0.0; 3],
            &harmonics,
            &[splat.opacity_logit],
            &splat.log_scale,
            &splat.rotation,
        ];
        for value in groups.into_iter().flatten() {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_and_rows_agree() {
        let splat = Splat {
            mean: [1.0, 2.0, 3.0],
            colour: [0.5, 1.0, 0.0],
            opacity_logit: -0.25,
            log_scale: [-4.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let mut bytes = Vec::new();
        write_splats(&mut bytes, [splat, splat].into_iter()).expect("memory");
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
        let header = String::from_utf8_lossy(&bytes[..start]);
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 2\n"));
        let properties = header.matches("property float ").count();
        assert_eq!(bytes.len() - start, 2 * 4 * properties);
        let value = |i: usize| {
            let b = &bytes[start + 4 * i..start + 4 * i + 4];
            f32::from_le_bytes([b[0], b[1], b[2], b[3]])
        };
        assert_eq!([value(0), value(1), value(2)], [1.0, 2.0, 3.0]);
        assert_eq!(value(6), 0.0);
        assert!((value(7) - 1.772_454).abs() < 1e-5);
        assert_eq!([value(9), value(10), value(13)], [-0.25, -4.0, 1.0]);
    }
}
