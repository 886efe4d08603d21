//! Triangles in a cube whose corners lie inside or outside of a surface (Lorensen and Cline 1987).
//!
//! The surface crosses the edges between an inner and an outer corner. On every face it runs around each
//! group of inner corners; both cubes of a face thus see the same lines, and the surface has no cracks.
//! The lines of all faces join to loops, which are filled with triangles.

/// Corner `i` lies at `(i & 1, i >> 1 & 1, i >> 2)`.
pub(super) const CORNERS: usize = 8;

/// Edges: the corner where each begins, and its axis.
pub(super) const EDGES: [(usize, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// Corners of the faces, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// Triangles of every case, as numbers of edges; bit `i` of a case is set if corner `i` is inside.
/// Seen from outside they turn counter-clockwise.
pub(super) struct Cases(Vec<Vec<[usize; 3]>>);

impl Cases {
    pub(super) fn new() -> Self {
        Self((0..256).map(triangles).collect())
    }

    pub(super) fn triangles(&self, case: usize) -> &[[usize; 3]] {
        &self.0[case]
    }
}

fn triangles(case: usize) -> Vec<[usize; 3]> {
    let next = successors(case);
    let mut left = next.map(|successor| successor.is_some());
    let mut triangles = Vec::new();
    while let Some(first) = left.iter().position(|&is_left| is_left) {
        let mut ring = Vec::new();
        let mut edge = first;
        while std::mem::take(&mut left[edge]) {
            ring.push(edge);
            edge = next[edge].unwrap_or(first);
        }
        triangles
            .extend((1..ring.len().saturating_sub(1)).map(|i| [ring[0], ring[i], ring[i + 1]]));
    }
    triangles
}

/// The edge that follows each crossed edge on its loop.
fn successors(case: usize) -> [Option<usize>; 12] {
    let is_inside = |corner: usize| case >> corner & 1 == 1;
    let mut next = [None; 12];
    for face in FACES {
        for start in 0..4 {
            let (here, there) = (face[start], face[(start + 1) % 4]);
            if is_inside(here) || !is_inside(there) {
                continue;
            }
            // A group of inner corners begins: the line around it ends where the group does.
            let end = (start + 1..start + 4)
                .find(|&i| is_inside(face[i % 4]) && !is_inside(face[(i + 1) % 4]));
            if let Some(end) = end {
                let last = edge_between(face[end % 4], face[(end + 1) % 4]);
                next[edge_between(here, there)] = Some(last);
            }
        }
    }
    next
}

fn edge_between(a: usize, b: usize) -> usize {
    let (first, axis) = (a.min(b), (a ^ b).trailing_zeros() as usize);
    // Every pair of neighbouring corners is an edge.
    EDGES.iter().position(|&edge| edge == (first, axis)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn middle(edge: usize) -> [f64; 3] {
        let (corner, axis) = EDGES[edge];
        let mut at = [corner & 1, corner >> 1 & 1, corner >> 2].map(|v| v as f64);
        at[axis] += 0.5;
        at
    }

    #[test]
    fn every_crossed_edge_is_on_one_loop() {
        for case in 0..256 {
            let crossed = |&&(corner, axis): &&(usize, usize)| {
                (case >> corner ^ case >> (corner | 1 << axis)) & 1 == 1
            };
            let due = EDGES.iter().filter(crossed).count();
            assert_eq!(successors(case).iter().flatten().count(), due, "{case}");
            // Loops of n edges have n - 2 triangles.
            assert!(triangles(case).len() <= due.saturating_sub(2), "{case}");
            assert_eq!(triangles(case).is_empty(), case == 0 || case == 255);
        }
    }

    #[test]
    fn triangles_face_outside() {
        for corner in 0..CORNERS {
            let [[a, b, c]] = triangles(1 << corner)[..] else { panic!("one triangle") };
            let (a, b, c) = (middle(a), middle(b), middle(c));
            let (u, v): ([f64; 3], [f64; 3]) =
                (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
            let normal =
                [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            let inside = [corner & 1, corner >> 1 & 1, corner >> 2].map(|v| v as f64);
            let out: f64 = (0..3).map(|i| normal[i] * (a[i] - inside[i])).sum();
            assert!(out > 0.0, "{corner}");
        }
    }
}
