//! Pose graph of similarities (Strasdat, Montiel and Davison 2010).

use i2slam_compute::SkylineMatrix;
use i2slam_compute::reverse_cuthill_mckee;
use i2slam_geometry::{Mat3, Similarity, right_jacobian_inverse};

const MAX_STEPS: usize = 20;
/// Relative decrease of the cost at which the iteration has converged.
const MIN_RELATIVE_DECREASE: f64 = 1e-6;
const MAX_DAMPING: f64 = 1e6;

/// Measured relative transform of two nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseGraphEdge {
    pub(crate) first: usize,
    pub(crate) second: usize,
    /// The second node in the first: `first⁻¹ second`.
    pub(crate) measured: Similarity<f64>,
    /// Weight of the squared error.
    pub(crate) weight: f64,
}

/// Derivative of seven numbers by seven.
type NodeJacobian = [[f64; 7]; 7];

/// Moves all nodes but the first so that `Σ weight ‖coordinates(measured⁻¹ first⁻¹ second)‖²` is
/// least; lengths count in `unit`.
pub(crate) fn optimize_pose_graph(
    places: &mut Vec<Similarity<f64>>,
    edges: &[PoseGraphEdge],
    unit: f64,
) {
    let variable_order = variable_order(places.len(), edges);
    let (mut damping, mut cost) = (1e-6, total_cost(places, edges, unit));
    for _ in 0..MAX_STEPS {
        let moved = levenberg_marquardt_step(places, edges, unit, &variable_order, damping);
        let next = moved.as_ref().map_or(f64::INFINITY, |m| total_cost(m, edges, unit));
        match moved {
            Some(moved) if next < cost => {
                let gained = cost - next;
                (*places, damping) = (moved, damping * 0.2);
                if gained < MIN_RELATIVE_DECREASE * cost {
                    break;
                }
                cost = next;
            }
            _ => damping *= 10.0,
        }
        if damping > MAX_DAMPING {
            break;
        }
    }
}

/// Block of every node, none for the first, in an order that keeps the matrix narrow.
fn variable_order(count: usize, edges: &[PoseGraphEdge]) -> Vec<Option<usize>> {
    let mut neighbours = vec![Vec::new(); count.saturating_sub(1)];
    for edge in edges.iter().filter(|e| e.first > 0 && e.second > 0) {
        neighbours[edge.first - 1].push(edge.second - 1);
        neighbours[edge.second - 1].push(edge.first - 1);
    }
    for of in &mut neighbours {
        of.sort_unstable();
        of.dedup();
    }
    let mut out = vec![None; count];
    let blocks = reverse_cuthill_mckee(&neighbours);
    blocks.into_iter().enumerate().for_each(|(block, place)| out[place + 1] = Some(block));
    out
}

fn edge_error(places: &[Similarity<f64>], edge: &PoseGraphEdge) -> Similarity<f64> {
    let between = places[edge.first].inverse().compose(&places[edge.second]);
    edge.measured.inverse().compose(&between)
}

/// Weight of each of an edge's seven errors.
fn edge_weights(edge: &PoseGraphEdge, unit: f64) -> [f64; 7] {
    std::array::from_fn(|i| if i < 3 { edge.weight / (unit * unit) } else { edge.weight })
}

fn total_cost(places: &[Similarity<f64>], edges: &[PoseGraphEdge], unit: f64) -> f64 {
    let of = |edge: &PoseGraphEdge| -> f64 {
        let chart = edge_error(places, edge).coordinates();
        chart.iter().zip(edge_weights(edge, unit)).map(|(e, w)| w * e * e).sum()
    };
    edges.iter().map(of).sum()
}

/// Derivatives of an edge's seven errors by the tangents of its two nodes.
fn edge_jacobians(places: &[Similarity<f64>], edge: &PoseGraphEdge) -> [NodeJacobian; 2] {
    let error = edge_error(places, edge);
    let between = places[edge.first].inverse().compose(&places[edge.second]);
    let inverse = right_jacobian_inverse(error.rotation.log());
    let mut out = [[[0.0; 7]; 7]; 2];
    // The second place moves the error as a retraction does.
    write_block(&mut out[1], 0, 0, &error.rotation.matrix().scaled(error.scale));
    write_block(&mut out[1], 3, 3, &inverse);
    out[1][6][6] = 1.0;
    // The first: D ← Exp(-φ) e^-σ (D - ρ), and then measured⁻¹ D.
    let measured = edge.measured.inverse();
    let turned = measured.rotation.matrix().scaled(measured.scale);
    write_block(&mut out[0], 0, 0, &turned.scaled(-1.0));
    write_block(&mut out[0], 0, 3, &(turned * Mat3::skew(between.translation)));
    let along = turned * between.translation;
    [along.x, along.y, along.z].iter().enumerate().for_each(|(i, v)| out[0][i][6] = -v);
    write_block(&mut out[0], 3, 3, &(inverse * between.rotation.inverse().matrix()).scaled(-1.0));
    out[0][6][6] = -1.0;
    out
}

fn write_block(block: &mut NodeJacobian, row: usize, column: usize, values: &Mat3<f64>) {
    for (i, from) in values.rows.iter().enumerate() {
        block[row + i][column..column + 3].copy_from_slice(from);
    }
}

/// The nodes after a Levenberg-Marquardt step.
fn levenberg_marquardt_step(
    places: &[Similarity<f64>],
    edges: &[PoseGraphEdge],
    unit: f64,
    variable_order: &[Option<usize>],
    damping: f64,
) -> Option<Vec<Similarity<f64>>> {
    let blocks = places.len().saturating_sub(1);
    let mut first: Vec<usize> = (0..blocks).collect();
    for edge in edges {
        let (Some(a), Some(b)) = (variable_order[edge.first], variable_order[edge.second]) else {
            continue;
        };
        first[a.max(b)] = first[a.max(b)].min(a.min(b));
    }
    let mut matrix = SkylineMatrix::new(first.iter().flat_map(|b| [7 * b; 7]).collect());
    let (mut right, mut diagonal) = (vec![0.0; 7 * blocks], vec![1e-9; 7 * blocks]);
    for edge in edges {
        let chart = edge_error(places, edge).coordinates();
        let weights = edge_weights(edge, unit);
        let ends = [variable_order[edge.first], variable_order[edge.second]];
        let slopes = edge_jacobians(places, edge);
        let product = |a: &NodeJacobian, i: usize, b: &NodeJacobian, j: usize| -> f64 {
            (0..7).map(|k| weights[k] * a[k][i] * b[k][j]).sum()
        };
        for (p, (a, block)) in slopes.iter().zip(ends).enumerate() {
            let Some(block) = block else { continue };
            for i in 0..7 {
                right[7 * block + i] -=
                    (0..7).map(|k| weights[k] * a[k][i] * chart[k]).sum::<f64>();
                diagonal[7 * block + i] += damping * product(a, i, a, i);
                (0..=i).for_each(|j| matrix.add(7 * block + i, 7 * block + j, product(a, i, a, j)));
                let Some(other) = ends[1 - p].filter(|other| *other < block) else { continue };
                let b = &slopes[1 - p];
                (0..7).for_each(|j| matrix.add(7 * block + i, 7 * other + j, product(a, i, b, j)));
            }
        }
    }
    diagonal.iter().enumerate().for_each(|(i, v)| matrix.add(i, i, *v));
    if !matrix.solve(&mut right) {
        return None;
    }
    let moved = |(place, block): (&Similarity<f64>, &Option<usize>)| {
        block.map_or(*place, |b| place.retract(&std::array::from_fn(|i| right[7 * b + i])))
    };
    Some(places.iter().zip(variable_order).map(moved).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};
    use i2slam_geometry::{Pose, Rotation, Vec3};

    fn place(seed: u64) -> Similarity<f64> {
        let n = noise(seed, 7);
        let rotation = Rotation::exp(Vec3::new(n[0], n[1], n[2]));
        Similarity { scale: 1.0 + 0.3 * n[6], rotation, translation: Vec3::new(n[3], n[4], n[5]) }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let places = [place(1), place(2)];
        let edge = PoseGraphEdge { first: 0, second: 1, measured: place(3), weight: 1.0 };
        let found = edge_jacobians(&places, &edge);
        for row in 0..7 {
            let f = |x: &[f64]| {
                let part = |k: usize| places[k].retract(&std::array::from_fn(|i| x[7 * k + i]));
                edge_error(&[part(0), part(1)], &edge).coordinates()[row]
            };
            let gradient = [found[0][row], found[1][row]].concat();
            assert_gradient("edge", &[0.0; 14], &gradient, 1e-4, 1e-6, f);
        }
    }

    /// A ring whose steps are each a little too long and turn a little too far.
    #[test]
    fn a_ring_that_does_not_close_is_closed() {
        let count = 60;
        let turn = std::f64::consts::TAU / f64::from(count);
        let step = |turn: f64, scale: f64| Similarity {
            scale,
            rotation: Rotation::exp(Vec3::new(0.0, turn, 0.0)),
            translation: Vec3::new(0.0, 0.0, 0.1),
        };
        let (true_step, drifted) = (step(turn, 1.0), step(1.02 * turn, 1.005));
        let ring = |step: &Similarity<f64>| {
            let mut places = vec![Similarity::from_pose(Pose::identity(), 1.0)];
            (1..count as usize).for_each(|i| places.push(places[i - 1].compose(step)));
            places
        };
        let (truth, mut places) = (ring(&true_step), ring(&drifted));
        let neighbours = (1..count as usize).map(|i| (i - 1, i, drifted, 1.0));
        let closing = (count as usize - 1, 0, true_step, 100.0);
        let edges: Vec<PoseGraphEdge> = neighbours
            .chain([closing])
            .map(|(first, second, measured, weight)| PoseGraphEdge {
                first,
                second,
                measured,
                weight,
            })
            .collect();
        let off = |places: &[Similarity<f64>]| {
            let far = |(a, b): (&Similarity<f64>, &Similarity<f64>)| {
                (a.translation - b.translation).norm()
            };
            places.iter().zip(&truth).map(far).fold(0.0, f64::max)
        };
        let before = off(&places);
        optimize_pose_graph(&mut places, &edges, 1.0);
        assert!(before > 0.3 && off(&places) < 0.15 * before, "{before} {}", off(&places));
    }
}
