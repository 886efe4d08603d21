//! Bounding volume hierarchy of the surfaces (surface area heuristic, Wald 2007).

use super::shape::by_component;
use super::{Hit, Ray, Shape, Surface, Vec3};

/// Largest number of surfaces in a leaf.
const LEAF: usize = 3;
/// Split positions tried per axis.
const BINS: usize = 12;
/// Below this level nodes are split in halves, which bounds the depth of the tree.
const BALANCED: usize = 40;
/// Capacity of the traversal stack: [`BALANCED`] levels and as many as halving can add.
const STACK: usize = BALANCED + 24;

struct Node {
    low: Vec3,
    high: Vec3,
    /// First surface of a leaf, or the right child; the left child follows its parent.
    first: u32,
    /// Surfaces of a leaf; 0 for an inner node.
    count: u32,
}

/// Bounding volume hierarchy.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    /// Surfaces in the order of the leaves.
    order: Vec<u32>,
    /// Their shapes, close together.
    shapes: Vec<Shape>,
}

struct Item {
    low: Vec3,
    high: Vec3,
    centre: [f32; 3],
    index: u32,
}

fn union(items: &[Item]) -> (Vec3, Vec3) {
    let far = Vec3::new(f32::INFINITY, f32::INFINITY, f32::INFINITY);
    items.iter().fold((far, -far), |(low, high), item| {
        (by_component(low, item.low, f32::min), by_component(high, item.high, f32::max))
    })
}

fn area(items: &[Item]) -> f32 {
    let (low, high) = union(items);
    let d = high - low;
    d.x * d.y + d.y * d.z + d.z * d.x
}

impl Bvh {
    /// A tree over the surfaces.
    pub(crate) fn new(surfaces: &[Surface]) -> Self {
        let items = surfaces.iter().enumerate().map(|(index, surface)| {
            let [low, high] = surface.shape.bounds();
            let margin = Vec3::new(1e-4, 1e-4, 1e-4);
            let centre = ((low + high) * 0.5).to_array();
            Item { low: low - margin, high: high + margin, centre, index: index as u32 }
        });
        let mut items: Vec<Item> = items.collect();
        let mut tree = Self { nodes: Vec::new(), order: Vec::new(), shapes: Vec::new() };
        tree.grow(&mut items, 0);
        tree.shapes = tree.order.iter().map(|&i| surfaces[i as usize].shape).collect();
        tree
    }

    fn grow(&mut self, items: &mut [Item], level: usize) {
        let (low, high) = union(items);
        let here = self.nodes.len();
        let cut = match items.len() {
            0..=LEAF => None,
            count if level >= BALANCED => Some(count / 2),
            _ => best_split(items),
        };
        let first = self.order.len() as u32;
        let count = if cut.is_none() { items.len() as u32 } else { 0 };
        self.nodes.push(Node { low, high, first, count });
        let Some(at) = cut else {
            self.order.extend(items.iter().map(|item| item.index));
            return;
        };
        let (left, right) = items.split_at_mut(at);
        self.grow(left, level + 1);
        self.nodes[here].first = self.nodes.len() as u32;
        self.grow(right, level + 1);
    }

    /// The nearest surface of a leaf before `to`.
    #[inline]
    fn intersect_leaf(&self, node: &Node, ray: &Ray, to: f32) -> Option<Hit> {
        let (mut best, mut to) = (None, to);
        let first = node.first as usize;
        for place in first..first + node.count as usize {
            if let Some((t, st)) = self.shapes[place].intersect(ray, to) {
                to = t;
                best = Some(Hit { t, surface: self.order[place] as usize, st });
            }
        }
        best
    }

    /// The first surface along the ray.
    #[inline]
    pub(crate) fn first_hit(&self, ray: &Ray) -> Option<Hit> {
        let inverse = ray.direction.to_array().map(f32::recip);
        let inverse = Vec3::from_array(inverse);
        let (mut best, mut to) = (None, ray.to);
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut depth = 0;
        let mut index = 0;
        entry(&self.nodes[0], ray, inverse, to)?;
        loop {
            let node = &self.nodes[index];
            if node.count == 0 {
                let (left, right) = (index + 1, node.first as usize);
                let enter_left = entry(&self.nodes[left], ray, inverse, to);
                let enter_right = entry(&self.nodes[right], ray, inverse, to);
                match (enter_left, enter_right) {
                    (Some(a), Some(b)) => {
                        let (near, far, later) =
                            if a <= b { (left, right, b) } else { (right, left, a) };
                        stack[depth] = (far as u32, later);
                        depth += 1;
                        index = near;
                        continue;
                    }
                    (Some(_), None) => {
                        index = left;
                        continue;
                    }
                    (None, Some(_)) => {
                        index = right;
                        continue;
                    }
                    (None, None) => {}
                }
            } else {
                best = self.intersect_leaf(node, ray, to).or(best);
                to = best.map_or(to, |hit| hit.t);
            }
            loop {
                if depth == 0 {
                    return best;
                }
                depth -= 1;
                let (next, enter) = stack[depth];
                if enter < to {
                    index = next as usize;
                    break;
                }
            }
        }
    }
}

/// Minimum and maximum, one instruction each because NaN is not handled.
#[inline]
fn sorted(a: f32, b: f32) -> (f32, f32) {
    if a < b { (a, b) } else { (b, a) }
}

/// Ray parameter at which the node is entered; `None` if not before `to`.
#[inline]
fn entry(node: &Node, ray: &Ray, inverse: Vec3, to: f32) -> Option<f32> {
    let (x0, x1) =
        sorted((node.low.x - ray.origin.x) * inverse.x, (node.high.x - ray.origin.x) * inverse.x);
    let (y0, y1) =
        sorted((node.low.y - ray.origin.y) * inverse.y, (node.high.y - ray.origin.y) * inverse.y);
    let (z0, z1) =
        sorted((node.low.z - ray.origin.z) * inverse.z, (node.high.z - ray.origin.z) * inverse.z);
    let enter = sorted(sorted(x0, y0).1, sorted(z0, ray.from).1).1;
    let leave = sorted(sorted(x1, y1).0, sorted(z1, to).0).0;
    (enter <= leave).then_some(enter)
}

/// Finds the cheapest split, sorts the items along its axis and returns its index.
fn best_split(items: &mut [Item]) -> Option<usize> {
    let count = items.len();
    let whole = area(items) * count as f32;
    let (mut best, mut cost) = (None, whole);
    for axis in 0..3 {
        items.sort_by(|a, b| a.centre[axis].total_cmp(&b.centre[axis]));
        for bin in 1..BINS {
            let at = (count * bin / BINS).clamp(1, count - 1);
            let (left, right) = items.split_at(at);
            let here = area(left) * at as f32 + area(right) * (count - at) as f32;
            if here < cost {
                (best, cost) = (Some((axis, at)), here);
            }
        }
    }
    let (axis, at) = best.or((count > 4 * LEAF).then_some((0, count / 2)))?;
    items.sort_by(|a, b| a.centre[axis].total_cmp(&b.centre[axis]));
    Some(at)
}

#[cfg(test)]
mod tests {
    use crate::rng::{between32, stream};
    use crate::scene::{Ray, Vec3, furnished_room};
    use crate::spec::Spec;

    #[test]
    fn the_tree_agrees_with_brute_force() {
        let scene = furnished_room(&Spec::default());
        let mut random = stream(3, 0, 0);
        let mut met = 0;
        for _ in 0..400 {
            let mut draw = |size: f32| between32(&mut random, -size, size);
            let direction = Vec3::new(draw(1.0), draw(1.0), draw(1.0));
            let origin = Vec3::new(draw(1.0), draw(1.0), 1.4);
            let ray = Ray { origin, direction, from: 1e-4, to: 1e9 };
            let found = scene.first_hit(&ray);
            let all = scene.surfaces.iter().filter_map(|s| s.shape.intersect(&ray, 1e9));
            let nearest = all.map(|(t, _)| t).fold(f32::INFINITY, f32::min);
            assert_eq!(found.map_or(f32::INFINITY, |hit| hit.t), nearest);
            met += usize::from(found.is_some());
        }
        assert_eq!(met, 400, "the room is closed");
    }
}
