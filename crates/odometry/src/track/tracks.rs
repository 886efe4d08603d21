//! Tracks: observations of scene points over frames.

use crate::multiview::whitening::Whitening;
use crate::track::thumbnail::KeyframeImage;
use std::sync::Arc;

/// Observation of a point in one frame. Long recordings have millions, so that they are packed:
/// positions as they were measured and corrections in single precision, their sum in double.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Observation {
    /// Index of the frame.
    pub(crate) frame: usize,
    raw: [f32; 2],
    correction: [f32; 2],
    whitening: Whitening,
    /// Inverse depth and its deviation; zero where none was measured.
    depth: [f32; 2],
    /// Not explained by the point's landmark.
    pub(crate) is_outlier: bool,
}

/// Values of an observation that rest on the map so far: correction, reading of depth, and whether its
/// landmark explains it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ObservationEstimate {
    correction: [f32; 2],
    depth: [f32; 2],
    is_outlier: bool,
}

/// An inverse depth measured by a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DepthReading {
    /// `1/z` along the optical axis, in units of the poses.
    pub(crate) inverse: f64,
    /// Standard deviation, in the same unit.
    pub(crate) sigma: f64,
}

impl Observation {
    /// Position and its standard deviation [px], in all directions.
    pub(crate) fn new(frame: usize, at: [f64; 2], sigma: f64) -> Self {
        Self::whitened(frame, at, Whitening::isotropic(sigma))
    }

    /// Position [px] and its deviation.
    pub(crate) fn whitened(frame: usize, at: [f64; 2], whitening: Whitening) -> Self {
        let (raw, correction, depth) = (at.map(|v| v as f32), [0.0; 2], [0.0; 2]);
        let new = Self { frame, raw, correction, whitening, depth, is_outlier: false };
        new.moved_to(at)
    }

    /// Image position as measured [px].
    pub(crate) fn raw(&self) -> [f64; 2] {
        self.raw.map(f64::from)
    }

    /// Position corrected for lens distortion and rolling shutter [px].
    pub(crate) fn at(&self) -> [f64; 2] {
        std::array::from_fn(|i| f64::from(self.raw[i]) + f64::from(self.correction[i]))
    }

    /// Deviation of the position.
    pub(crate) fn whitening(&self) -> &Whitening {
        &self.whitening
    }

    /// Standard deviation [px] in the root mean square over all directions.
    pub(crate) fn sigma(&self) -> f64 {
        self.whitening.sigma()
    }

    /// Inverse depth measured by a sensor.
    pub(crate) fn depth(&self) -> Option<DepthReading> {
        let [inverse, sigma] = self.depth.map(f64::from);
        (inverse != 0.0).then_some(DepthReading { inverse, sigma })
    }

    /// The observation with another corrected position.
    pub(crate) fn moved_to(self, at: [f64; 2]) -> Self {
        let raw = self.raw();
        Self { correction: std::array::from_fn(|i| (at[i] - raw[i]) as f32), ..self }
    }

    /// The observation with another standard deviation [px], in all directions.
    pub(crate) fn with_sigma(self, sigma: f64) -> Self {
        Self { whitening: Whitening::isotropic(sigma), ..self }
    }

    /// The observation with a further, independent error.
    pub(crate) fn with_added_error(self, of: &Whitening) -> Self {
        Self { whitening: self.whitening.plus(of), ..self }
    }

    /// The observation with a measured depth, or without.
    pub(crate) fn with_depth(self, depth: Option<DepthReading>) -> Self {
        let packed = depth.map(|d| [d.inverse as f32, d.sigma as f32]);
        Self { depth: packed.unwrap_or_default(), ..self }
    }
}

/// Observations of one point, in order of frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    pub(crate) observations: Vec<Observation>,
}

impl Track {
    /// The observation in a frame.
    pub(crate) fn observation_in(&self, frame: usize) -> Option<&Observation> {
        let i = self.observations.partition_point(|o| o.frame < frame);
        self.observations.get(i).filter(|o| o.frame == frame)
    }

    /// The observation in a frame, to be changed.
    pub(crate) fn observation_in_mut(&mut self, frame: usize) -> Option<&mut Observation> {
        let i = self.observations.partition_point(|o| o.frame < frame);
        self.observations.get_mut(i).filter(|o| o.frame == frame)
    }

    /// Adds an observation; false if the frame has one already.
    pub(crate) fn insert(&mut self, observation: Observation) -> bool {
        let i = self.observations.partition_point(|o| o.frame < observation.frame);
        let is_new = self.observations.get(i).is_none_or(|o| o.frame != observation.frame);
        if is_new {
            self.observations.insert(i, observation);
        }
        is_new
    }
}

/// All tracks of a sequence, and its keyframes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracks {
    pub(crate) tracks: Vec<Track>,
    /// Keyframes, in order.
    pub(crate) keyframes: Vec<usize>,
    /// Their pictures, in order.
    pub(crate) keyframe_images: Vec<Arc<KeyframeImage>>,
    /// Number of frames.
    pub(crate) frames: usize,
}

impl Tracks {
    /// Makes the last frame a keyframe where there is only one.
    pub(crate) fn with_two_keyframes(mut self) -> Self {
        if self.keyframes.len() == 1 && self.frames > 1 {
            self.keyframes.push(self.frames - 1);
        }
        self
    }

    /// Estimates of all observations, in order.
    pub(crate) fn estimates(&self) -> Vec<ObservationEstimate> {
        let count = self.tracks.iter().map(|track| track.observations.len()).sum();
        let mut out = Vec::with_capacity(count);
        for Observation { correction, depth, is_outlier, .. } in
            self.tracks.iter().flat_map(|track| &track.observations)
        {
            out.push(ObservationEstimate {
                correction: *correction,
                depth: *depth,
                is_outlier: *is_outlier,
            });
        }
        out
    }

    /// Replaces the estimates of all observations, in order.
    pub(crate) fn set_estimates(&mut self, estimates: Vec<ObservationEstimate>) {
        let observations = self.tracks.iter_mut().flat_map(|track| &mut track.observations);
        for (o, ObservationEstimate { correction, depth, is_outlier }) in
            observations.zip(estimates)
        {
            *o = Observation { correction, depth, is_outlier, ..*o };
        }
    }

    /// Leaves the tracks as they were measured.
    pub(crate) fn drop_estimates(&mut self) {
        for o in self.tracks.iter_mut().flat_map(|track| &mut track.observations) {
            *o = Observation::whitened(o.frame, o.raw(), o.whitening);
        }
    }

    /// Makes a frame with its picture a keyframe, unless it is the last one already.
    pub(crate) fn add_keyframe(&mut self, image: &Arc<KeyframeImage>, frame: usize) {
        if self.keyframes.last() != Some(&frame) {
            self.keyframes.push(frame);
            self.keyframe_images.push(KeyframeImage::of_frame(image, frame));
        }
    }

    /// Makes frames keyframes, too, given by their pictures in order.
    pub(crate) fn with_keyframes<'a>(
        mut self,
        images: impl Iterator<Item = &'a Arc<KeyframeImage>>,
    ) -> Self {
        let is_new =
            |image: &&Arc<KeyframeImage>| self.keyframes.binary_search(&image.frame).is_err();
        let new: Vec<_> = images.filter(is_new).cloned().collect();
        self.keyframe_images.extend(new);
        self.keyframe_images.sort_by_key(|image| image.frame);
        self.keyframes = self.keyframe_images.iter().map(|image| image.frame).collect();
        self
    }

    /// Makes the last keyframe a frame between keyframes.
    pub(crate) fn drop_last_keyframe(&mut self) {
        self.keyframes.pop();
        self.keyframe_images.pop();
    }

    /// The tracks reduced to observations in keyframes.
    pub(crate) fn keyframes_only(&self) -> Self {
        let mut is_keyframe = vec![false; self.frames];
        self.keyframes.iter().for_each(|f| is_keyframe[*f] = true);
        let reduced = |track: &Track| {
            let kept = track.observations.iter().filter(|o| is_keyframe[o.frame]);
            Track { observations: kept.copied().collect() }
        };
        let (keyframes, keyframe_images) = (self.keyframes.clone(), self.keyframe_images.clone());
        Self {
            tracks: self.tracks.iter().map(reduced).collect(),
            keyframes,
            keyframe_images,
            frames: self.frames,
        }
    }

    /// Tracks of every frame.
    pub(crate) fn tracks_by_frame(&self) -> Vec<Vec<usize>> {
        let mut counts = vec![0; self.frames];
        let observations = self.tracks.iter().flat_map(|track| &track.observations);
        observations.for_each(|o| counts[o.frame] += 1);
        let mut out: Vec<Vec<usize>> = counts.into_iter().map(Vec::with_capacity).collect();
        for (index, track) in self.tracks.iter().enumerate() {
            track.observations.iter().for_each(|o| out[o.frame].push(index));
        }
        out
    }
}

/// The last frame up to one that repeats no other.
pub(crate) fn repeated_frame(is_repeat: &[bool], frame: usize) -> usize {
    let is_own = |frame: &usize| !is_repeat.get(*frame).copied().unwrap_or(false);
    (0..=frame).rev().find(is_own).unwrap_or(frame)
}

/// Positions in two frames of the points that both observe.
pub(crate) fn shared_positions(
    tracks: &[Track],
    by_frame: &[Vec<usize>],
    first: usize,
    second: usize,
) -> Vec<([f64; 2], [f64; 2])> {
    let both = |i: &usize| {
        let track = &tracks[*i];
        Some((track.observation_in(first)?, track.observation_in(second)?))
    };
    by_frame[first].iter().filter_map(both).map(|(a, b)| (a.at(), b.at())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_are_dropped_and_set_again() {
        let at = |frame: usize| [20.0 + frame as f64, 30.0];
        let mut observation = Observation::new(3, at(3), 0.3).moved_to([24.5, 29.0]);
        observation = observation.with_depth(Some(DepthReading { inverse: 0.5, sigma: 0.01 }));
        observation.is_outlier = true;
        let track = Track { observations: vec![Observation::new(2, at(2), 0.3), observation] };
        let mut tracks = Tracks { tracks: vec![track], ..Tracks::default() };
        let estimates = tracks.estimates();
        tracks.drop_estimates();
        assert_eq!(tracks.tracks[0].observations, [2, 3].map(|f| Observation::new(f, at(f), 0.3)));
        tracks.set_estimates(estimates);
        assert_eq!(tracks.tracks[0].observations[1], observation);
    }

    #[test]
    fn a_repeated_picture_stands_for_the_frame_that_it_repeats() {
        let is_repeat = [false, false, true, true, false, true];
        assert_eq!([0, 3, 5].map(|frame| repeated_frame(&is_repeat, frame)), [0, 1, 4]);
    }
}
