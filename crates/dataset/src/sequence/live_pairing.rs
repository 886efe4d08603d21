//! Depth of a stream, given to colour pictures while both come.

use crate::DepthPairing;
use crate::formats::{AssociationRules, associate};
use i2slam_geometry::nearest_stamp;
use std::collections::VecDeque;

/// Colour pictures that wait for their depth, and depth that may be theirs, by their time stamps [s],
/// increasing.
#[derive(Debug)]
pub(super) struct LivePairing<C, D> {
    rules: AssociationRules,
    has_depth: bool,
    colour: VecDeque<(f64, C)>,
    depth: VecDeque<(f64, D)>,
    /// Stamp of the last colour picture that waits no longer [s].
    before: Option<f64>,
    /// True once the track has ended.
    pub(super) colour_has_ended: bool,
    pub(super) depth_has_ended: bool,
}

/// A colour picture that waits no longer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Paired<C, D> {
    pub(super) colour: (f64, C),
    pub(super) depth: Option<(f64, D)>,
    /// True for a frame; false where [`DepthPairing::Nearest`] finds no depth.
    pub(super) is_frame: bool,
}

impl<C, D: Clone> LivePairing<C, D> {
    pub(super) fn new(rules: AssociationRules, has_depth: bool) -> Self {
        let (colour, depth) = (VecDeque::new(), VecDeque::new());
        let (colour_has_ended, depth_has_ended) = (false, !has_depth);
        Self { rules, has_depth, colour, depth, before: None, colour_has_ended, depth_has_ended }
    }

    /// Adds a picture. Stamps that are missing or not increasing are extrapolated by an interval [s].
    pub(super) fn push_colour(&mut self, own: Option<f64>, picture: C, interval: f64) {
        let last = self.colour.back().map(|(stamp, _)| *stamp).or(self.before);
        self.colour.push_back((increasing(own, last, interval), picture));
    }

    /// As [`push_colour`](Self::push_colour).
    pub(super) fn push_depth(&mut self, own: Option<f64>, picture: D, interval: f64) {
        let last = self.depth.back().map(|(stamp, _)| *stamp);
        self.depth.push_back((increasing(own, last, interval), picture));
    }

    /// Number of colour pictures that wait.
    pub(super) fn waiting(&self) -> usize {
        self.colour.len()
    }

    /// The next colour picture, if its depth is known: as [`associate`] gives it in the whole stream.
    /// With `gives_up` as if no more depth came.
    pub(super) fn next(&mut self, gives_up: bool) -> Option<Paired<C, D>> {
        let stamp = self.colour.front()?.0;
        if !self.knows_depth(stamp, gives_up) {
            return None;
        }
        let colour: Vec<f64> =
            self.before.into_iter().chain(self.colour.iter().map(|(stamp, _)| *stamp)).collect();
        let depth: Vec<f64> = self.depth.iter().map(|(stamp, _)| *stamp).collect();
        let depth = Some(depth.as_slice()).filter(|_| self.has_depth);
        let found = associate(&colour, depth, None, self.rules);
        let place = usize::from(self.before.is_some());
        let pair = found.pairs.iter().find(|(i, _)| *i == place);
        let depth = pair.and_then(|(_, j)| self.depth.get((*j)?).cloned());
        let is_frame = pair.is_some();
        // Later pictures are no nearer to depth before the last one up to this stamp.
        while self.depth.get(1).is_some_and(|(next, _)| *next <= stamp) {
            self.depth.pop_front();
        }
        self.before = Some(stamp);
        Some(Paired { colour: self.colour.pop_front()?, depth, is_frame })
    }

    /// True if later pictures cannot change the depth of the first colour picture that waits.
    fn knows_depth(&self, stamp: f64, gives_up: bool) -> bool {
        let last = self.depth.back().map_or(f64::NEG_INFINITY, |(stamp, _)| *stamp);
        if last < stamp && !self.depth_has_ended && !gives_up {
            return false;
        }
        let stamps: Vec<f64> = self.depth.iter().map(|(stamp, _)| *stamp).collect();
        let Some(nearest) = nearest_stamp(&stamps, stamp, self.rules.tolerance) else {
            return true;
        };
        // It may be nearer to the colour picture that comes next.
        let newest = self.colour.back().map_or(stamp, |(stamp, _)| *stamp);
        self.rules.pairing == DepthPairing::Nearest
            || stamps[nearest] <= newest
            || gives_up
            || self.colour_has_ended
    }
}

fn increasing(own: Option<f64>, last: Option<f64>, interval: f64) -> f64 {
    let usual = last.map_or(0.0, |last| last + interval);
    own.filter(|own| last.is_none_or(|last| *own > last)).unwrap_or(usual)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_compute::Random;

    const RULES: AssociationRules =
        AssociationRules { pairing: DepthPairing::OneToOne, tolerance: 0.08, minimum_gap: 0.0 };

    /// Partners that pictures get when both tracks come in order of time, and what waits then.
    fn paired_live(
        colour: &[f64],
        depth: &[f64],
        rules: AssociationRules,
    ) -> Vec<(usize, Option<usize>)> {
        let mut pairing = LivePairing::new(rules, true);
        let mut found = Vec::new();
        let (mut i, mut j) = (0, 0);
        let mut take = |pairing: &mut LivePairing<usize, usize>| {
            while let Some(Paired { colour, depth, is_frame }) = pairing.next(false) {
                found.extend(is_frame.then_some((colour.1, depth.map(|(_, j)| j))));
            }
        };
        while i < colour.len() || j < depth.len() {
            if j == depth.len() || i < colour.len() && colour[i] <= depth[j] {
                pairing.push_colour(Some(colour[i]), i, 0.1);
                i += 1;
            } else {
                pairing.push_depth(Some(depth[j]), j, 0.1);
                j += 1;
            }
            take(&mut pairing);
        }
        (pairing.colour_has_ended, pairing.depth_has_ended) = (true, true);
        take(&mut pairing);
        assert_eq!(pairing.waiting(), 0);
        found
    }

    fn stamps(random: &mut Random, count: usize, interval: f64) -> Vec<f64> {
        let mut time = random.uniform() * 0.2;
        let next = |_| {
            time += interval * (0.2 + 1.6 * random.uniform());
            time
        };
        (0..count).map(next).collect()
    }

    #[test]
    fn pairs_are_those_of_the_whole_stream() {
        let mut random = Random::new(7);
        for case in 0..200 {
            let intervals = [0.02, 0.033, 0.1][case % 3];
            let colour = stamps(&mut random, 30, 0.033);
            let depth = stamps(&mut random, 20, intervals);
            for pairing in [DepthPairing::OneToOne, DepthPairing::Nearest] {
                let rules = AssociationRules { pairing, ..RULES };
                let whole = associate(&colour, Some(&depth), None, rules).pairs;
                assert_eq!(paired_live(&colour, &depth, rules), whole, "{case}");
            }
        }
    }

    #[test]
    fn a_picture_waits_for_depth_that_may_be_its_own_alone() {
        let mut pairing = LivePairing::new(RULES, true);
        pairing.push_colour(Some(0.0), 'a', 0.1);
        assert_eq!(pairing.next(false), None, "depth may come");
        pairing.push_depth(Some(0.0), 0, 0.1);
        assert_eq!(pairing.next(false).and_then(|p| p.depth), Some((0.0, 0)));
        pairing.push_colour(Some(0.1), 'b', 0.1);
        pairing.push_depth(Some(0.12), 1, 0.1);
        assert_eq!(pairing.next(false), None, "the next picture may be nearer");
        pairing.push_colour(Some(0.13), 'c', 0.1);
        assert_eq!(pairing.next(false).map(|p| (p.colour.1, p.depth)), Some(('b', None)));
        assert_eq!(pairing.next(false), None, "depth may come");
        assert_eq!(pairing.next(true).and_then(|p| p.depth), Some((0.12, 1)), "given up");
        pairing.push_colour(None, 'd', 0.1);
        pairing.push_depth(Some(1.0), 2, 0.1);
        let last = pairing.next(false).expect("far from depth");
        assert!((last.colour.0 - 0.23).abs() < 1e-12 && last.depth.is_none() && last.is_frame);
    }

    #[test]
    fn without_a_depth_track_nothing_waits() {
        for pairing in [DepthPairing::OneToOne, DepthPairing::Nearest] {
            let mut pairing =
                LivePairing::<_, ()>::new(AssociationRules { pairing, ..RULES }, false);
            pairing.push_colour(Some(0.0), 'a', 0.1);
            assert!(pairing.next(false).is_some_and(|p| p.is_frame && p.depth.is_none()));
        }
    }
}
