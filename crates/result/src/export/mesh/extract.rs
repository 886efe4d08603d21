//! The surface of a signed distance field as triangles: marching cubes.

use super::Mesh;
use super::cases::{CORNERS, Cases, EDGES};
use super::volume::{SIDE, VOXELS, Volume};
use i2slam::geometry::Vec3;
use std::collections::HashMap;

/// Largest difference of the field along a crossed edge: beside a surface neighbours differ by
/// 1 / truncation, by √3 of it at most; more is a jump from behind one surface to the open before another.
const MAX_STEP: f32 = 0.6;

/// A voxel: number of the block, place in it.
type Voxel = (usize, usize);

/// The surface where the field is zero and known at all corners of a cube.
pub(super) fn surface(volume: &Volume) -> Mesh {
    let mut extraction =
        Extraction { volume, cases: Cases::new(), vertices: HashMap::new(), mesh: Mesh::default() };
    for block in 0..volume.blocks.len() {
        extraction.block(block);
    }
    extraction.mesh
}

struct Extraction<'a> {
    volume: &'a Volume,
    cases: Cases,
    /// Vertices on edges: a voxel and an axis.
    vertices: HashMap<(Voxel, usize), u32>,
    mesh: Mesh,
}

impl Extraction<'_> {
    fn block(&mut self, block: usize) {
        let place = self.volume.blocks[block].place;
        // The block itself and those behind its far faces.
        let neighbours: [Option<usize>; CORNERS] = std::array::from_fn(|corner| {
            let offset = offset(corner).map(|v| v as i32);
            self.volume.block(std::array::from_fn(|axis| place[axis] + offset[axis]))
        });
        for cell in 0..VOXELS {
            let [x, y, z] = [cell % SIDE, cell / SIDE % SIDE, cell / (SIDE * SIDE)];
            let corners: [Option<Voxel>; CORNERS] = std::array::from_fn(|corner| {
                let [dx, dy, dz] = offset(corner);
                let at = [x + dx, y + dy, z + dz];
                let beyond = at.map(|v| v / SIDE);
                let block = neighbours[beyond[0] | beyond[1] << 1 | beyond[2] << 2]?;
                let [x, y, z] = at.map(|v| v % SIDE);
                let voxel = x + SIDE * (y + SIDE * z);
                (self.volume.blocks[block].weight[voxel] > 0.0).then_some((block, voxel))
            });
            self.cube(corners);
        }
    }

    fn cube(&mut self, corners: [Option<Voxel>; CORNERS]) {
        let mut known = [(0, 0); CORNERS];
        for (known, corner) in known.iter_mut().zip(corners) {
            let Some(corner) = corner else { return };
            *known = corner;
        }
        let case = (0..CORNERS).filter(|&i| self.distance(known[i]) < 0.0);
        let case = case.fold(0, |case, i| case | 1 << i);
        let is_jump = |&edge: &usize| {
            let (corner, axis) = EDGES[edge];
            let (a, b) = (self.distance(known[corner]), self.distance(known[corner | 1 << axis]));
            (a < 0.0) != (b < 0.0) && (a - b).abs() > MAX_STEP
        };
        if (0..EDGES.len()).any(|edge| is_jump(&edge)) {
            return;
        }
        for i in 0..self.cases.triangles(case).len() {
            let edges = self.cases.triangles(case)[i];
            let triangle = edges.map(|edge| self.vertex(&known, edge));
            self.mesh.triangles.push(triangle);
        }
    }

    fn distance(&self, (block, voxel): Voxel) -> f32 {
        self.volume.blocks[block].distance[voxel]
    }

    /// The vertex on an edge, made when it is first met.
    fn vertex(&mut self, corners: &[Voxel; CORNERS], edge: usize) -> u32 {
        let (corner, axis) = EDGES[edge];
        let (from, to) = (corners[corner], corners[corner | 1 << axis]);
        let next = self.mesh.positions.len() as u32;
        let vertex = *self.vertices.entry((from, axis)).or_insert(next);
        if vertex == next {
            let (a, b) = (self.distance(from), self.distance(to));
            let share = f64::from(a / (a - b)).clamp(0.0, 1.0);
            let (start, mut step) = (self.position(from), [0.0; 3]);
            step[axis] = share * self.volume.voxel;
            self.mesh.positions.push(start + Vec3::from_array(step));
            let colour = |(block, voxel): Voxel| self.volume.blocks[block].colour[voxel];
            let (near, far) = (colour(from), colour(to));
            let mixed = |c: usize| {
                let (near, far) = (f64::from(near[c]), f64::from(far[c]));
                ((near + share * (far - near)) / f64::from(u16::MAX)) as f32
            };
            self.mesh.colours.push(std::array::from_fn(mixed));
        }
        vertex
    }

    fn position(&self, (block, voxel): Voxel) -> Vec3<f64> {
        let place = self.volume.blocks[block].place.map(|p| f64::from(p) * SIDE as f64);
        let [x, y, z] =
            [voxel % SIDE, voxel / SIDE % SIDE, voxel / (SIDE * SIDE)].map(|v| v as f64);
        Vec3::new(place[0] + x, place[1] + y, place[2] + z) * self.volume.voxel
    }
}

fn offset(corner: usize) -> [usize; 3] {
    [corner & 1, corner >> 1 & 1, corner >> 2]
}
