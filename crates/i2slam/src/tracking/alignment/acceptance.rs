//! Whether an alignment ended at the right place.

use super::levenberg_marquardt::Outcome;
use super::{Frame, losses};
use crate::reconstruction::Losses;
use i2slam_compute::median;

/// Share of the frame's depth that must lie on the model.
pub(super) const MIN_OVERLAP: f64 = 0.3;
/// Frames that say what is usual, and how few of them say nothing.
const RECENT: usize = 20;
const FEW: usize = 5;
/// Times the usual loss of the picture, times that of depth, from which a place is taken for a
/// wrong one. At a right one new surfaces, glare or a jump of exposure raise one of both, up to
/// ninefold; at a wrong one both rise, twentyfold together and more.
const STRANGE: f64 = 12.0;

impl Frame<'_> {
    /// Enough of the frame lies on the model, and it fits about as well as the frames before did:
    /// a wrong pose would spoil the map.
    pub(super) fn is_believed(&self, end: &Outcome) -> bool {
        let found = losses(&end.sums);
        let by_depth = match self.observation.is_estimated() {
            true => 1.0,
            false => self.times_usual(&found, |losses| losses.depth),
        };
        let strangeness = self.times_usual(&found, |losses| losses.image) * by_depth;
        end.sums.overlap() >= MIN_OVERLAP && strangeness < STRANGE
    }

    /// A loss over its median in the last frames that were aligned, which the first was not.
    fn times_usual(&self, found: &Losses, loss: impl Fn(&Losses) -> f64) -> f64 {
        let aligned = self.context.frames.iter().skip(1).rev().filter(|f| f.tracked);
        let mut recent: Vec<f64> = aligned.take(RECENT).map(|f| loss(&f.losses)).collect();
        match median(&mut recent) {
            Some(usual) if recent.len() >= FEW && usual > 0.0 => loss(found) / usual,
            _ => 1.0,
        }
    }
}
