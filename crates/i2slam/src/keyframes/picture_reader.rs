//! Pictures of keyframes, read in the order in which they were taken.

use super::PictureError;
use i2slam_dataset::Frame;
use std::collections::BTreeMap;

/// Number of keyframes whose pictures stay for those that come after them: as far as dense depth
/// looks back.
const KEPT: usize = 16;

/// Reads the picture of every keyframe once and in order, whoever asks for it first: to go back in
/// a video means to decode it anew.
pub(super) struct Reader<L> {
    load: L,
    /// Where in the sequence each keyframe is.
    places: Vec<usize>,
    /// Number of keyframes that were read.
    read: usize,
    pictures: BTreeMap<usize, Result<Frame, PictureError>>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> Reader<L> {
    /// `load` gives the picture at a place.
    pub(super) fn new(places: Vec<usize>, load: L) -> Self {
        Self { load, places, read: 0, pictures: BTreeMap::new() }
    }

    /// The picture of a keyframe, if it can be read and is not long past.
    pub(super) fn picture(&mut self, keyframe: usize) -> Option<&Frame> {
        self.read_up_to(keyframe);
        self.pictures.get(&keyframe)?.as_ref().ok()
    }

    /// The picture of the next keyframe, or why it has none; those long past are forgotten.
    pub(super) fn next(&mut self, keyframe: usize) -> Result<Frame, PictureError> {
        self.read_up_to(keyframe);
        self.pictures.retain(|k, _| *k + KEPT >= keyframe);
        match self.pictures.get(&keyframe) {
            Some(Ok(picture)) => Ok(picture.clone()),
            _ => {
                self.pictures.remove(&keyframe).unwrap_or_else(|| Err("it was read before".into()))
            }
        }
    }

    fn read_up_to(&mut self, keyframe: usize) {
        while self.read <= keyframe && self.read < self.places.len() {
            self.pictures.insert(self.read, (self.load)(self.places[self.read]));
            self.read += 1;
        }
    }
}
