//! Orders of unknowns that leave little room between those that are coupled.

use std::collections::VecDeque;

/// An order in which neighbours lie near each other (Cuthill and McKee 1969,
/// reversed): breadth first, from the end of every chain, those with few neighbours first.
pub(crate) fn narrow_order(neighbours: &[Vec<usize>]) -> Vec<usize> {
    let blocks = neighbours.len();
    let mut by_degree: Vec<usize> = (0..blocks).collect();
    by_degree.sort_by_key(|b| neighbours[*b].len());
    let mut is_placed = vec![false; blocks];
    let mut order = Vec::with_capacity(blocks);
    for begin in by_degree {
        if is_placed[begin] {
            continue;
        }
        let reached = breadth_first(neighbours, begin, &is_placed);
        let end = reached.last().copied().unwrap_or(begin);
        let component = breadth_first(neighbours, end, &is_placed);
        component.iter().for_each(|b| is_placed[*b] = true);
        order.extend(component);
    }
    order.reverse();
    order
}

fn breadth_first(neighbours: &[Vec<usize>], begin: usize, is_placed: &[bool]) -> Vec<usize> {
    let mut is_reached = is_placed.to_vec();
    let mut queue = VecDeque::from([begin]);
    let mut order = Vec::new();
    is_reached[begin] = true;
    while let Some(block) = queue.pop_front() {
        order.push(block);
        let mut next: Vec<usize> =
            neighbours[block].iter().copied().filter(|b| !is_reached[*b]).collect();
        next.sort_by_key(|b| (neighbours[*b].len(), *b));
        next.iter().for_each(|b| is_reached[*b] = true);
        queue.extend(next);
    }
    order
}
