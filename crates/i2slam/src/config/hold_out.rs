//! Frames that are held out of a map.

use super::MappingConfig;
use std::collections::BTreeMap;

/// Frames that are held out, each decided once: one that is delivered again keeps the decision, and takes
/// no part in the count. The default holds none out.
#[derive(Clone, Debug, Default)]
pub(crate) struct HoldOut {
    mapping: Option<MappingConfig>,
    /// By the index of frames.
    decided: BTreeMap<usize, bool>,
}

impl HoldOut {
    /// No frame so far, of those that settings hold out.
    pub(crate) fn new(mapping: &MappingConfig) -> Self {
        Self { mapping: Some(mapping.clone()), decided: BTreeMap::new() }
    }

    /// Frames with these indices, whether they can be read or not.
    pub(crate) fn of_frames(mapping: &MappingConfig, indices: impl Iterator<Item = usize>) -> Self {
        let mut all = Self::new(mapping);
        indices.for_each(|index| _ = all.decide(index));
        all
    }

    /// True if the frame with this index is held out, or would be as the next one.
    pub(crate) fn is_held_out(&self, index: usize) -> bool {
        let (number, mapping) = (self.decided.len(), self.mapping.as_ref());
        let is_due = || mapping.is_some_and(|mapping| mapping.holds_out(number, index));
        self.decided.get(&index).copied().unwrap_or_else(is_due)
    }

    /// Counts the frame with this index; true if it is held out.
    pub(crate) fn decide(&mut self, index: usize) -> bool {
        let is_held_out = self.is_held_out(index);
        self.decided.insert(index, is_held_out);
        is_held_out
    }

    /// Number of frames so far, those held out included.
    pub(crate) fn frames(&self) -> usize {
        self.decided.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_frame_keeps_its_decision() {
        let mut mapping = Config::default().mapping;
        mapping.hold_out = 3;
        let mut hold_out = HoldOut::new(&mapping);
        let mut held_out = |indices: &[usize]| -> Vec<usize> {
            indices.iter().copied().filter(|i| hold_out.decide(*i)).collect()
        };
        assert_eq!(held_out(&[0, 2, 4, 6, 8]), [6]);
        // Again and out of order, and others later.
        assert_eq!(held_out(&[6, 4, 2, 0]), [6]);
        assert_eq!(held_out(&[5, 7, 6]), [7, 6]);
        assert_eq!(hold_out.frames(), 7);
        (mapping.hold_out, mapping.hold_out_frames) = (0, vec![0, 5]);
        let mut named = HoldOut::new(&mapping);
        let held_out = (0..8).filter(|i| named.decide(*i)).collect::<Vec<_>>();
        assert_eq!(held_out, [0, 5]);
        assert!(!(0..8).any(|i| HoldOut::default().decide(i)));
    }

    /// Asking alone does not count.
    #[test]
    fn frames_of_a_sequence_are_decided_at_once() {
        let mut mapping = Config::default().mapping;
        mapping.hold_out = 2;
        let all = HoldOut::of_frames(&mapping, [3, 5, 7, 9, 11].into_iter());
        assert_eq!([3, 5, 7, 9, 11].map(|i| all.is_held_out(i)), [false, false, true, false, true]);
        let next = HoldOut::of_frames(&mapping, [3, 5].into_iter());
        assert!(next.is_held_out(8) && next.is_held_out(9) && next.frames() == 2);
    }
}
