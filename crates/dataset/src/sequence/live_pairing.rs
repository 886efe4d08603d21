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
    /// Whether no more comes.
    pub(super) colour_has_ended: bool,
    pub(super) depth_has_ended: bool,
}

/// A colour picture that waits no longer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Paired<C, D> {
    pub(super) colour: (f64, C),
    pub(super) depth: Option<(f64, D)>,
    /// Whether it is a frame: not where [`DepthPairing::Nearest`] finds no depth.
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

    /// Whether what comes does not change the depth of the colour picture that has waited longest.
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
