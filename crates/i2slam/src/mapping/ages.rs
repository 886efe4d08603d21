//! How many optimiser steps each Gaussian has taken.

use i2slam_radiance::gaussian::MapGradient;

/// Steps per Gaussian.
#[derive(Default)]
pub(super) struct Ages {
    steps: Vec<u32>,
    now: Vec<u32>,
}

impl Ages {
    /// Counts a step; the ages of the Gaussians that take it, 0 for the others. `only_seen` leaves
    /// out those without a gradient, which would otherwise go on with the momentum of pictures
    /// that do not show them.
    pub(super) fn advance(&mut self, gradient: &MapGradient, only_seen: bool) -> &[u32] {
        let count = gradient.opacity_logits.len();
        self.steps.resize(count, 0);
        self.now.clear();
        let colours = gradient.colours.iter().zip(&gradient.means).zip(&gradient.opacity_logits);
        let seen = colours.map(|((colour, mean), &opacity)| {
            opacity != 0.0 || colour.iter().chain(mean).any(|&g| g != 0.0)
        });
        self.now.extend(self.steps.iter_mut().zip(seen).map(|(steps, seen)| {
            let moves = seen || !only_seen;
            *steps += u32::from(moves);
            if moves { *steps } else { 0 }
        }));
        &self.now
    }

    pub(super) fn retain(&mut self, keep: &[bool]) {
        self.steps.resize(keep.len(), 0);
        let mut kept = keep.iter();
        self.steps.retain(|_| kept.next().is_some_and(|&k| k));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_seen_grows_older() {
        let mut ages = Ages::default();
        let mut gradient = MapGradient::new(3);
        gradient.colours[1][2] = 0.5;
        assert_eq!(ages.advance(&gradient, true), [0, 1, 0]);
        assert_eq!(ages.advance(&gradient, false), [1, 2, 1]);
        ages.retain(&[false, true, true]);
        gradient.reset(2);
        gradient.opacity_logits[0] = -1.0;
        assert_eq!(ages.advance(&gradient, true), [3, 0]);
    }
}
