//! Gaussians as binary glTF with the extension `KHR_gaussian_splatting`, as ratified by Khronos:
//! linear scales, opacities from 0 to 1, quaternions x y z w, spherical harmonics.

use super::gltf::Buffers;
use super::splat::Splat;
use crate::pictures::byte;
use serde_json::json;
use std::io::{self, Write};

/// Writes the file; `linear` says that colours are linear. `generator` names who wrote it.
pub fn write(
    out: &mut dyn Write,
    splats: &[Splat],
    linear: bool,
    generator: &str,
) -> io::Result<()> {
    let rows = |row: fn(&Splat) -> [f32; 3]| -> Vec<[f32; 3]> { splats.iter().map(row).collect() };
    let mut buffers = Buffers::default();
    let rotations: Vec<[f32; 4]> =
        splats.iter().map(|Splat { rotation: [w, x, y, z], .. }| [*x, *y, *z, *w]).collect();
    let opacities: Vec<[f32; 1]> = splats.iter().map(|s| [s.opacity()]).collect();
    // For viewers that show points.
    let colours: Vec<[u8; 4]> = splats
        .iter()
        .map(|s| [s.colour[0], s.colour[1], s.colour[2], s.opacity()].map(byte))
        .collect();
    let harmonics: Vec<_> = splats.iter().map(Splat::harmonics).collect();
    let mut attributes = json!({
        "POSITION": buffers.positions(&rows(|s| s.mean)),
        "COLOR_0": buffers.bytes(&colours),
        "KHR_gaussian_splatting:ROTATION": buffers.floats(&rotations),
        "KHR_gaussian_splatting:SCALE": buffers.floats(&rows(|s| s.log_scale.map(f32::exp))),
        "KHR_gaussian_splatting:OPACITY": buffers.floats(&opacities),
    });
    let degrees = if splats.iter().any(|s| s.view.is_some()) { 2 } else { 0 };
    for (degree, coefficient) in (0..=degrees).flat_map(|d| (0..=2 * d).map(move |k| (d, k))) {
        let values = harmonics.iter().map(|h| h[degree * degree + coefficient]);
        let name = format!("KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{coefficient}");
        attributes[name] = json!(buffers.floats(&values.collect::<Vec<_>>()));
    }
    let colour_space = if linear { "lin_rec709_display" } else { "srgb_rec709_display" };
    let description = json!({
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "mode": 0,
            "attributes": attributes,
            "extensions": { "KHR_gaussian_splatting": {
                "kernel": "ellipse",
                "colorSpace": colour_space,
                "sortingMethod": "cameraDistance",
                "projection": "perspective",
            } },
        }] }],
    });
    buffers.write(out, generator, description)
}

#[cfg(test)]
mod tests {
    use super::super::gltf::tests::{floats, parts};
    use super::*;

    #[test]
    fn values_are_activated_as_the_extension_asks() {
        let splat = Splat {
            mean: [1.0, 2.0, 3.0],
            colour: [0.25, 0.5, 1.0],
            view: None,
            opacity_logit: 0.0,
            log_scale: [-1.0, 0.0, -2.0],
            rotation: [0.5, -0.5, 0.1, 0.7],
        };
        let mut bytes = Vec::new();
        write(&mut bytes, &[splat, splat], false, "a test").expect("memory");
        let parts = parts(&bytes);
        let primitive = &parts.0["meshes"][0]["primitives"][0];
        let extension = &primitive["extensions"]["KHR_gaussian_splatting"];
        assert_eq!(extension["colorSpace"], "srgb_rec709_display");
        let row = |name: &str, columns: usize| {
            let accessor = primitive["attributes"][name].as_u64().expect("an attribute");
            assert_eq!(parts.0["accessors"][accessor as usize]["count"], 2);
            floats(&parts, accessor as usize)[..columns].to_vec()
        };
        let khr = |name: &str, columns| row(&format!("KHR_gaussian_splatting:{name}"), columns);
        assert_eq!(row("POSITION", 3), [1.0, 2.0, 3.0]);
        assert_eq!(khr("ROTATION", 4), [-0.5, 0.1, 0.7, 0.5]);
        assert_eq!(khr("SCALE", 3), [(-1.0_f32).exp(), 1.0, (-2.0_f32).exp()]);
        assert_eq!(khr("OPACITY", 1), [0.5]);
        let harmonic = khr("SH_DEGREE_0_COEF_0", 3);
        assert!((harmonic[0] * 0.282_094_8 + 0.5 - 0.25).abs() < 1e-6 && harmonic[1] == 0.0);
    }
}
