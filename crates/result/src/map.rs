//! The map as a file, lossless: `map.i2slam`.

use crate::archive::{Archive, Array};
use i2slam::Map;
use i2slam::radiance::gaussian::{ColourActivation, Cone, GaussianMap, Shape, TERMS, ViewColours};
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
    let mut arrays = vec![
        array("mean", 3, map.means.concat()),
        array("log_scale", 3, map.log_scales.concat()),
        array("rotation", 4, map.rotations.concat()),
        array("opacity_logit", 1, map.opacity_logits.clone()),
        array("colour", 3, map.colours.concat()),
    ];
    if !map.view_colours.is_empty() {
        let terms = |i| map.view_colours.get(i).map_or(0, |view| view.coefficients.len());
        let cones = map.view_colours.iter().map(|(_, view)| view.cone);
        let cones = cones.flat_map(|Cone { rotation: [w, x, y, z], spread }| [w, x, y, z, spread]);
        arrays.extend([
            array("view_colour_terms", 1, (0..map.len()).map(|i| terms(i) as f32).collect()),
            array("view_colour_cone", 5, cones.collect()),
            array("view_colour", 3, map.view_colours.coefficients().concat()),
        ]);
    }
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
        view_colours: read_view_colours(&mut archive)?,
    };
    let lengths =
        [map.log_scales.len(), map.rotations.len(), map.opacity_logits.len(), map.colours.len()];
    if lengths.iter().any(|&n| n != map.means.len()) || map.view_colours.end() > map.means.len() {
        return Err("has arrays of different length".to_owned());
    }
    Ok(map)
}

/// The view colours of a map, none if the file does not mention them.
fn read_view_colours(archive: &mut Archive<MapMeta>) -> Result<ViewColours, String> {
    let mut colours = ViewColours::default();
    if archive.arrays.iter().all(|array| array.name != "view_colour_terms") {
        return Ok(colours);
    }
    let counts = archive.take("view_colour_terms", 1)?;
    let mut cones = rows::<5>(archive.take("view_colour_cone", 5)?).into_iter();
    let coefficients: Vec<[f32; 3]> = rows(archive.take("view_colour", 3)?);
    let mut rest = coefficients.as_slice();
    for (gaussian, &count) in counts.iter().enumerate().filter(|(_, count)| **count != 0.0) {
        let known = TERMS[1..].iter().find(|terms| **terms as f32 == count);
        let terms =
            *known.ok_or_else(|| format!("gives a view colour {count} terms, not 2, 5 or 9"))?;
        let cone = cones.next().filter(|cone| cone.iter().all(|v| v.is_finite()) && cone[4] > 0.0);
        let ([w, x, y, z, spread], (own, others)) =
            cone.zip(rest.split_at_checked(terms)).ok_or("has damaged view colours")?;
        colours.push(gaussian, Cone { rotation: [w, x, y, z], spread }, own);
        rest = others;
    }
    let all = rest.is_empty() && cones.next().is_none();
    all.then_some(colours).ok_or_else(|| "has more view colours than it tells".to_owned())
}

fn rows<const N: usize>(values: Vec<f32>) -> Vec<[f32; N]> {
    let row = |chunk: &[f32]| std::array::from_fn(|i| chunk[i]);
    values.chunks_exact(N).map(row).collect()
}
