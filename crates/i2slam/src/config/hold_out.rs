//! Frames that are held out of a map.

use super::MappingConfig;
use std::collections::BTreeMap;

/// Decides once for every frame whether it is held out: one that is delivered again keeps the
/// decision, and takes no part in the count. The default holds none out.
#[derive(Clone, Debug, Default)]
pub(crate) struct HoldOut {
    mapping: Option<MappingConfig>,
    /// By the index of frames.
    decided: BTreeMap<usize, bool>,
}

impl HoldOut {
    /// As these settings say, before the first frame.
    pub(crate) fn new(mapping: &MappingConfig) -> Self {
        Self { mapping: Some(mapping.clone()), decided: BTreeMap::new() }
    }

    /// True if the frame with this index is held out.
    pub(crate) fn holds_out(&mut self, index: usize) -> bool {
        let number = self.decided.len();
        let mapping = self.mapping.as_ref();
        let decide = || mapping.is_some_and(|mapping| mapping.holds_out(number, index));
        *self.decided.entry(index).or_insert_with(decide)
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
            indices.iter().copied().filter(|i| hold_out.holds_out(*i)).collect()
        };
        assert_eq!(held_out(&[0, 2, 4, 6, 8]), [6]);
        // Again and out of order, and others later.
        assert_eq!(held_out(&[6, 4, 2, 0]), [6]);
        assert_eq!(held_out(&[5, 7, 6]), [7, 6]);
        assert_eq!(hold_out.frames(), 7);
        (mapping.hold_out, mapping.hold_out_frames) = (0, vec![0, 5]);
        let mut named = HoldOut::new(&mapping);
        let held_out = (0..8).filter(|i| named.holds_out(*i)).collect::<Vec<_>>();
        assert_eq!(held_out, [0, 5]);
    }
}
