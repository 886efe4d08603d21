//! Small loose pieces of a mesh, of which no surface is made.

use super::Mesh;

/// Least triangles of a piece.
const MIN_TRIANGLES: usize = 100;

/// The mesh without pieces of few triangles, and without the vertices that these alone had.
pub(super) fn without_specks(mesh: &Mesh) -> Mesh {
    let mut pieces = Pieces((0..mesh.positions.len()).collect());
    for &[a, b, c] in &mesh.triangles {
        pieces.join(a as usize, b as usize);
        pieces.join(a as usize, c as usize);
    }
    let mut counts = vec![0_usize; mesh.positions.len()];
    for triangle in &mesh.triangles {
        counts[pieces.root(triangle[0] as usize)] += 1;
    }
    let mut kept = Mesh::default();
    let mut places = vec![u32::MAX; mesh.positions.len()];
    for triangle in &mesh.triangles {
        if counts[pieces.root(triangle[0] as usize)] < MIN_TRIANGLES {
            continue;
        }
        let moved = triangle.map(|vertex| {
            let place = &mut places[vertex as usize];
            if *place == u32::MAX {
                *place = kept.positions.len() as u32;
                kept.positions.push(mesh.positions[vertex as usize]);
                kept.colours.push(mesh.colours[vertex as usize]);
            }
            *place
        });
        kept.triangles.push(moved);
    }
    kept
}

/// Pieces of connected vertices: each vertex points to another of its piece, the root to itself.
struct Pieces(Vec<usize>);

impl Pieces {
    fn root(&mut self, mut vertex: usize) -> usize {
        while self.0[vertex] != vertex {
            self.0[vertex] = self.0[self.0[vertex]];
            vertex = self.0[vertex];
        }
        vertex
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}
