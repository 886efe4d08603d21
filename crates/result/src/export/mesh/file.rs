//! Meshes as PLY and as binary glTF.

use super::super::axes::Axes;
use super::super::gltf::Buffers;
use super::super::scene::Scene;
use super::Mesh;
use crate::pictures::byte;
use i2slam::geometry::{Pose, Vec3};
use serde_json::json;
use std::io::{self, Write};

/// Writes binary PLY with normals and 8-bit colours, y down as all PLY files of this project.
pub fn write_ply(out: &mut dyn Write, mesh: &Mesh, scene: &Scene, comment: &str) -> io::Result<()> {
    let (positions, normals) = moved(mesh, scene.file_from_world(Axes::YDown));
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment {comment}")?;
    writeln!(out, "element vertex {}", positions.len())?;
    for property in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(out, "property float {property}")?;
    }
    for property in ["red", "green", "blue"] {
        writeln!(out, "property uchar {property}")?;
    }
    writeln!(out, "element face {}", mesh.triangles.len())?;
    writeln!(out, "property list uchar int vertex_indices\nend_header")?;
    for ((position, normal), colour) in positions.iter().zip(&normals).zip(&mesh.colours) {
        for value in position.iter().chain(normal) {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(&colour.map(byte))?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for vertex in triangle {
            out.write_all(&vertex.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Writes binary glTF without lighting (`KHR_materials_unlit`): colours hold the light of the scene.
pub fn write_glb(
    out: &mut dyn Write,
    mesh: &Mesh,
    scene: &Scene,
    generator: &str,
) -> io::Result<()> {
    let (positions, normals) = moved(mesh, scene.file_from_world(Axes::YUp));
    // Vertex colours of glTF are linear.
    let colours: Vec<[u16; 4]> = mesh
        .colours
        .iter()
        .map(|&[r, g, b]| [linear(r), linear(g), linear(b), 1.0])
        .map(|colour| colour.map(|v| (v * f32::from(u16::MAX)).round() as u16))
        .collect();
    let mut buffers = Buffers::default();
    let attributes = json!({
        "POSITION": buffers.positions(&positions),
        "NORMAL": buffers.floats(&normals),
        "COLOR_0": buffers.shorts(&colours),
    });
    let indices = buffers.indices(&mesh.triangles);
    let description = json!({
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "materials": [{
            "extensions": { "KHR_materials_unlit": {} },
            "pbrMetallicRoughness": { "metallicFactor": 0.0 },
        }],
        "meshes": [{ "primitives": [{
            "attributes": attributes,
            "indices": indices,
            "material": 0,
            "mode": 4,
        }] }],
    });
    buffers.write(out, generator, description)
}

type Rows = Vec<[f32; 3]>;

/// Positions and normals in the world of a file.
fn moved(mesh: &Mesh, file_from_world: Pose<f64>) -> (Rows, Rows) {
    let row = |v: Vec3<f64>| v.to_array().map(|v| v as f32);
    let positions = mesh.positions.iter().map(|&p| row(file_from_world * p)).collect();
    let normals = normals(mesh).into_iter().map(|n| row(file_from_world.rotation.rotate(n)));
    (positions, normals.collect())
}

/// Unit normals of the vertices: means over their triangles, weighted by area.
fn normals(mesh: &Mesh) -> Vec<Vec3<f64>> {
    let mut sums = vec![Vec3::zero(); mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
        let normal = (b - a).cross(c - a);
        for &vertex in triangle {
            sums[vertex as usize] += normal;
        }
    }
    // A vertex of triangles without area gets any direction.
    let unit = |sum: Vec3<f64>| {
        let norm = sum.norm();
        if norm > 0.0 { sum * norm.recip() } else { Vec3::new(0.0, 0.0, 1.0) }
    };
    sums.into_iter().map(unit).collect()
}

/// The linear value of an sRGB value.
fn linear(value: f32) -> f32 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
