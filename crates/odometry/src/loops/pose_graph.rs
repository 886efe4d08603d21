//! Pose graph of similarities (Strasdat, Montiel and Davison 2010), or of rigid motions where lengths
//! are measured.

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

/// Lengths in a pose graph.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GraphLengths {
    /// Length whose error counts as much as one of a radian.
    pub(crate) unit: f64,
    /// Whether lengths are measured: nodes keep their scale, and errors of scale do not count.
    pub(crate) is_metric: bool,
}

/// Derivative of seven numbers by seven.
type NodeJacobian = [[f64; 7]; 7];

/// Moves all nodes but the first so that `Σ weight ‖coordinates(measured⁻¹ first⁻¹ second)‖²` is
/// least.
pub(crate) fn optimize_pose_graph(
    places: &mut Vec<Similarity<f64>>,
    edges: &[PoseGraphEdge],
    lengths: GraphLengths,
) {
    let variable_order = variable_order(places.len(), edges);
    let (mut damping, mut cost) = (1e-6, total_cost(places, edges, lengths));
    for _ in 0..MAX_STEPS {
        let moved = levenberg_marquardt_step(places, edges, lengths, &variable_order, damping);
        let next = moved.as_ref().map_or(f64::INFINITY, |m| total_cost(m, edges, lengths));
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
fn edge_weights(edge: &PoseGraphEdge, lengths: GraphLengths) -> [f64; 7] {
    let GraphLengths { unit, is_metric } = lengths;
    std::array::from_fn(|i| match i {
        0..3 => edge.weight / (unit * unit),
        6 if is_metric => 0.0,
        _ => edge.weight,
    })
}

fn total_cost(places: &[Similarity<f64>], edges: &[PoseGraphEdge], lengths: GraphLengths) -> f64 {
    let of = |edge: &PoseGraphEdge| -> f64 {
        let chart = edge_error(places, edge).coordinates();
        chart.iter().zip(edge_weights(edge, lengths)).map(|(e, w)| w * e * e).sum()
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
    lengths: GraphLengths,
    variable_order: &[Option<usize>],
    damping: f64,
) -> Option<Vec<Similarity<f64>>> {
    // The scale is the last number of a tangent.
    let free = if lengths.is_metric { 6 } else { 7 };
    let blocks = places.len().saturating_sub(1);
    let mut first: Vec<usize> = (0..blocks).collect();
    for edge in edges {
        let (Some(a), Some(b)) = (variable_order[edge.first], variable_order[edge.second]) else {
            continue;
        };
        first[a.max(b)] = first[a.max(b)].min(a.min(b));
    }
    let mut matrix = SkylineMatrix::new(
        first.iter().flat_map(|b| std::iter::repeat_n(free * b, free)).collect(),
    );
    let (mut right, mut diagonal) = (vec![0.0; free * blocks], vec![1e-9; free * blocks]);
    for edge in edges {
        let chart = edge_error(places, edge).coordinates();
        let weights = edge_weights(edge, lengths);
        let ends = [variable_order[edge.first], variable_order[edge.second]];
        let slopes = edge_jacobians(places, edge);
        let product = |a: &NodeJacobian, i: usize, b: &NodeJacobian, j: usize| -> f64 {
            (0..7).map(|k| weights[k] * a[k][i] * b[k][j]).sum()
        };
        for (p, (a, block)) in slopes.iter().zip(ends).enumerate() {
            let Some(block) = block else { continue };
            for i in 0..free {
                let row = free * block + i;
                right[row] -= (0..7).map(|k| weights[k] * a[k][i] * chart[k]).sum::<f64>();
                diagonal[row] += damping * product(a, i, a, i);
                (0..=i).for_each(|j| matrix.add(row, free * block + j, product(a, i, a, j)));
                let Some(other) = ends[1 - p].filter(|other| *other < block) else { continue };
                let b = &slopes[1 - p];
                (0..free).for_each(|j| matrix.add(row, free * other + j, product(a, i, b, j)));
            }
        }
    }
    diagonal.iter().enumerate().for_each(|(i, v)| matrix.add(i, i, *v));
    if !matrix.solve(&mut right) {
        return None;
    }
    let moved = |(place, block): (&Similarity<f64>, &Option<usize>)| {
        let step = |b: usize, i: usize| if i < free { right[free * b + i] } else { 0.0 };
        block.map_or(*place, |b| place.retract(&std::array::from_fn(|i| step(b, i))))
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

    /// Steps of a ring [rad, 0.1 ahead each], and nodes after so many of them.
    const STEPS: usize = 60;

    fn step(turn: f64, scale: f64) -> Similarity<f64> {
        let turn = turn * std::f64::consts::TAU / STEPS as f64;
        let rotation = Rotation::exp(Vec3::new(0.0, turn, 0.0));
        Similarity { scale, rotation, translation: Vec3::new(0.0, 0.0, 0.1) }
    }

    fn ring(step: &Similarity<f64>) -> Vec<Similarity<f64>> {
        let mut places = vec![Similarity::from_pose(Pose::identity(), 1.0)];
        (1..STEPS).for_each(|i| places.push(places[i - 1].compose(step)));
        places
    }

    /// The ring of `drifted` steps after its end was seen a true step before its begin.
    fn closed(drifted: &Similarity<f64>, closing: Similarity<f64>, is_metric: bool) -> [f64; 2] {
        let edge = |first: usize, second: usize, measured: Similarity<f64>, weight: f64| {
            PoseGraphEdge { first, second, measured, weight }
        };
        let mut edges: Vec<PoseGraphEdge> =
            (1..STEPS).map(|i| edge(i - 1, i, *drifted, 1.0)).collect();
        edges.push(edge(STEPS - 1, 0, closing, 100.0));
        let (truth, mut places) = (ring(&step(1.0, 1.0)), ring(drifted));
        let off = |places: &[Similarity<f64>]| {
            let far = |(a, b): (&Similarity<f64>, &Similarity<f64>)| {
                (a.translation - b.translation).norm()
            };
            places.iter().zip(&truth).map(far).fold(0.0, f64::max)
        };
        let before = off(&places);
        optimize_pose_graph(&mut places, &edges, GraphLengths { unit: 1.0, is_metric });
        assert!(!is_metric || places.iter().all(|place| place.scale == 1.0));
        [before, off(&places)]
    }

    /// A ring whose steps are each a little too long and turn a little too far.
    #[test]
    fn a_ring_that_does_not_close_is_closed() {
        let [before, after] = closed(&step(1.02, 1.005), step(1.0, 1.0), false);
        assert!(before > 0.3 && after < 0.15 * before, "{before} {after}");
    }

    /// Where lengths are measured, a wrong scale of the closing edge changes nothing.
    #[test]
    fn a_metric_ring_is_closed_without_a_change_of_scale() {
        let [before, after] = closed(&step(1.03, 1.0), step(1.0, 1.0), true);
        assert!(before > 0.1 && after < 0.15 * before, "{before} {after}");
        let wrong = closed(&step(1.03, 1.0), step(1.0, 1.2), true);
        let free = closed(&step(1.03, 1.0), step(1.0, 1.2), false);
        assert!((wrong[1] - after).abs() < 1e-6 && free[1] > 2.0 * after, "{wrong:?} {free:?}");
    }
}
