//! Sequential reading of keyframe pictures.

use super::PictureError;
use i2slam_dataset::Frame;
use std::collections::BTreeMap;

/// Keyframes whose pictures stay cached for later ones: the reach of dense depth.
const CACHED: usize = 16;

/// Reads the picture of every keyframe once and in order, because going back in a video means to
/// decode it again.
pub(super) struct PictureReader<L> {
    load: L,
    /// Position of each keyframe in the sequence.
    positions: Vec<usize>,
    /// Number of keyframes read so far.
    read: usize,
    pictures: BTreeMap<usize, Result<Frame, PictureError>>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> PictureReader<L> {
    /// A reader of the keyframes at `positions`; `load` reads the picture at a position.
    pub(super) fn new(positions: Vec<usize>, load: L) -> Self {
        Self { load, positions, read: 0, pictures: BTreeMap::new() }
    }

    /// The picture of a keyframe, if readable and still cached.
    pub(super) fn picture(&mut self, keyframe: usize) -> Option<&Frame> {
        self.read_up_to(keyframe);
        self.pictures.get(&keyframe)?.as_ref().ok()
    }

    /// The picture of the next keyframe; drops those out of reach from the cache.
    pub(super) fn next(&mut self, keyframe: usize) -> Result<Frame, PictureError> {
        self.read_up_to(keyframe);
        self.pictures.retain(|k, _| *k + CACHED >= keyframe);
        match self.pictures.get(&keyframe) {
            Some(Ok(picture)) => Ok(picture.clone()),
            _ => {
                self.pictures.remove(&keyframe).unwrap_or_else(|| Err("it was read before".into()))
            }
        }
    }

    fn read_up_to(&mut self, keyframe: usize) {
        while self.read <= keyframe && self.read < self.positions.len() {
            self.pictures.insert(self.read, (self.load)(self.positions[self.read]));
            self.read += 1;
        }
    }
}
