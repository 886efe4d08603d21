//! Figures of a result's `map.ply` as viewers draw it, against the depth of its sequence.

use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::geometry::{Image, Rotation, Vec3};
use i2slam_eval::splats::{Pinholes, Splat, SurfaceDistance, pinholes};
use i2slam_result::RunInput;
use std::collections::HashMap;
use std::path::Path;

/// Frames whose pinholes are counted, evenly spread.
const PINHOLE_FRAMES: usize = 8;
/// Relative distance from the surface beyond which a Gaussian lies elsewhere.
const MAX_DISTANCE: f64 = 0.02;

/// Anything that can go wrong, in one line.
pub(crate) type Failure = Box<dyn std::error::Error>;

/// Figures of a map of Gaussians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplatFigures {
    /// Share of the surface through which more than half of the light passes.
    pub(crate) pinholes: f64,
    /// Share of it through which it passes where Gaussians at all depths count.
    pub(crate) see_through: f64,
    /// Share of the Gaussians farther than 2 % of the depth from the surface.
    pub(crate) off_surface: f64,
}

/// Figures of a result; `None` without Gaussians or true depth.
pub(crate) fn of_result(result: &Path) -> Result<Option<SplatFigures>, Failure> {
    let (ply, input) = (result.join("map.ply"), RunInput::load(result)?);
    let Some(input) = input.filter(|_| ply.is_file()) else { return Ok(None) };
    let splats = read_splats(&std::fs::read(&ply)?)
        .map_err(|reason| format!("{}: {reason}", ply.display()))?;
    let reconstruction = i2slam_result::load(result)?;
    let options = OpenOptions { colour_only: false, ..input.options };
    let sequence = Sequence::open(&input.dataset, &options)?;
    let mut viewer = reconstruction.viewer();
    let frames: Vec<_> = reconstruction.frames.iter().filter(|frame| frame.tracked).collect();
    let spacing = frames.len().div_ceil(PINHOLE_FRAMES).max(1);
    let mut total = Pinholes::default();
    let mut distance = SurfaceDistance::new(splats.len());
    for (number, frame) in frames.into_iter().enumerate() {
        let position = sequence.entries.iter().position(|entry| entry.index == frame.index);
        let Some(position) = position else { continue };
        let Some(depth) = sequence.load(position)?.depth else { continue };
        let drawn = viewer.depth(frame.depth_pose());
        let Some(depth) = in_unit_of(&drawn, &depth.image) else { continue };
        distance.add_frame(&splats, &reconstruction.camera, frame.depth_pose(), &depth);
        if number % spacing == 0 {
            total += pinholes(&splats, &reconstruction.camera, frame.depth_pose(), &depth)?;
        }
    }
    let off_surface = distance.share_beyond(MAX_DISTANCE).filter(|_| total.surface > 0);
    Ok(off_surface.map(|off_surface| SplatFigures {
        pinholes: total.open as f64 / total.surface as f64,
        see_through: total.see_through as f64 / total.surface as f64,
        off_surface,
    }))
}

/// True depth in the unit of the map, by the median ratio; `None` where the map is not seen, or
/// pictures differ in size.
fn in_unit_of(drawn: &Image<f32>, truth: &Image<f32>) -> Option<Image<f32>> {
    let pairs = drawn.data.iter().zip(&truth.data).filter(|(d, t)| **d > 0.0 && **t > 0.0);
    let mut ratios: Vec<f32> = pairs.map(|(drawn, truth)| drawn / truth).collect();
    if ratios.is_empty() || drawn.data.len() != truth.data.len() {
        return None;
    }
    let middle = ratios.len() / 2;
    let ratio = *ratios.select_nth_unstable_by(middle, f32::total_cmp).1;
    Some(Image { data: truth.data.iter().map(|z| z * ratio).collect(), ..truth.clone() })
}

/// Reads a binary little-endian PLY of Gaussians in the layout of Kerbl et al. 2023, whose properties
/// may come in any order.
fn read_splats(bytes: &[u8]) -> Result<Vec<Splat>, String> {
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|window| window == END);
    let start = end.ok_or("has no header of a PLY file")? + END.len();
    let header = String::from_utf8_lossy(&bytes[..start]);
    if !header.contains("format binary_little_endian 1.0") {
        return Err("is not a binary little-endian PLY".to_owned());
    }
    let names = header.lines().filter_map(|line| line.strip_prefix("property float "));
    let columns: HashMap<&str, usize> = names.enumerate().map(|(i, name)| (name, i)).collect();
    let column = |name: &str| columns.get(name).copied().ok_or(format!("has no property {name}"));
    let group = |names: [&str; 3]| -> Result<[usize; 3], String> {
        Ok([column(names[0])?, column(names[1])?, column(names[2])?])
    };
    let (mean, scale) = (group(["x", "y", "z"])?, group(["scale_0", "scale_1", "scale_2"])?);
    let (w, v) = (column("rot_0")?, group(["rot_1", "rot_2", "rot_3"])?);
    let opacity = column("opacity")?;
    let rows = bytes[start..].chunks_exact(4 * columns.len());
    rows.map(|row| {
        let value = |column: usize| {
            let four = &row[4 * column..4 * column + 4];
            f64::from(f32::from_le_bytes([four[0], four[1], four[2], four[3]]))
        };
        let [x, y, z] = v.map(value);
        let rotation = Rotation::from_wxyz(value(w), x, y, z);
        Ok(Splat {
            mean: Vec3::from_array(mean.map(value)),
            scale: scale.map(|column| value(column).exp()),
            rotation: rotation.ok_or("has a rotation that is zero")?,
            opacity: (1.0 / (1.0 + (-value(opacity)).exp())) as f32,
        })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn properties_are_found_by_name() {
        let names = [
            "scale_0", "scale_1", "scale_2", "x", "y", "z", "opacity", "rot_0", "rot_1", "rot_2",
            "rot_3",
        ];
        let mut file = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n".to_vec();
        for name in names {
            file.extend(format!("property float {name}\n").bytes());
        }
        file.extend(b"end_header\n");
        let row: [f32; 11] = [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 0.0, 0.0, 0.0, 0.0, 2.0];
        file.extend(row.iter().flat_map(|value| value.to_le_bytes()));
        let splats = read_splats(&file).expect("a file of splats");
        assert_eq!(splats.len(), 1);
        assert_eq!(splats[0].mean.to_array(), [4.0, 5.0, 6.0]);
        assert_eq!((splats[0].scale[0], splats[0].opacity), (1.0, 0.5));
        assert!((splats[0].rotation.matrix()[(0, 0)] + 1.0).abs() < 1e-12);
        let lost = String::from_utf8_lossy(&file).replace("rot_3", "rot_4");
        assert_eq!(read_splats(lost.as_bytes()).unwrap_err(), "has no property rot_3");
        assert!(read_splats(b"ply\n").unwrap_err().contains("no header"));
    }

    #[test]
    fn truth_is_scaled_to_the_map() {
        let picture = |data: [f32; 4]| Image { data: data.into(), ..Image::new(2, 2, 1) };
        let (drawn, truth) = (picture([0.0, 1.0, 1.5, 9.0]), picture([1.0, 2.0, 3.0, 4.0]));
        let scaled = in_unit_of(&drawn, &truth).expect("pixels of both");
        assert_eq!(scaled.data, [0.5, 1.0, 1.5, 2.0]);
        assert!(in_unit_of(&picture([0.0; 4]), &truth).is_none());
    }
}
