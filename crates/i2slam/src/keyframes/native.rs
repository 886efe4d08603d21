//! Keyframes that our own monocular front end finds poses for, from the pictures alone.

use super::reader::Reader;
use super::rows::RowMotion;
use super::{EstimatedDepth, KeyframeSource, PictureError, PosedKeyframe};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_monocular::{
    DenseDepth, DenseDepths, FrameStatus, FrontEnd, Keyframe, Reconstruction, View,
};
use thiserror::Error;

pub use i2slam_monocular::{
    Failure as NativeFailure, Intrinsics, Reconstruction as NativeReconstruction,
};

/// Median depth of the landmarks in the unit of length that is delivered: about that of a room in
/// metres, for which the settings of maps are made.
const MEDIAN_DEPTH: f64 = 2.0;

/// A depth counts if its standard deviation is at most this share of it.
const TRUSTED: f64 = 0.3;

/// Factor of the deviations that are delivered: the depth loss is a mean over the few pixels that
/// have a depth, which would outweigh the picture.
const SPARSE: f64 = 10.0;

/// Least standard deviation of a depth as a share of it: that of the landmarks leaves the poses out,
/// and a pixel shows more than a point.
const LEAST_DEVIATION: f64 = 0.1;

/// A picture of a sequence.
#[derive(Clone, Debug)]
pub struct SequencePicture {
    /// Its number in the sequence.
    pub index: usize,
    /// Its stamp [s].
    pub timestamp: f64,
    /// R, G, B in [0, 1].
    pub colour: Image<f32>,
}

/// Why there are no keyframes.
#[derive(Debug, Error)]
pub enum NativeError {
    /// No path of the camera was found.
    #[error("{failure}{}", first_refusal(.refused))]
    NoPath {
        /// Why.
        failure: NativeFailure,
        /// Pictures that could not be used: place in the sequence, reason.
        refused: Vec<(usize, PictureError)>,
    },
    /// The caller had enough of it.
    #[error("ended before the path of the camera was found")]
    Ended,
}

fn first_refusal(refused: &[(usize, PictureError)]) -> String {
    refused.first().map_or_else(String::new, |(index, why)| {
        format!(" ({} pictures could not be used, the first, {index}: {why})", refused.len())
    })
}

/// Keyframes of a sequence of pictures, posed by [`FrontEnd`]; the unit of length is arbitrary, half
/// the median depth of the landmarks.
pub struct Native<L> {
    reconstruction: Reconstruction,
    dense: Option<DenseDepths>,
    reader: Reader<L>,
    /// Place in the sequence of every picture that the front end accepted.
    places: Vec<usize>,
    refused: Vec<(usize, PictureError)>,
    next: usize,
}

impl<L: FnMut(usize) -> Result<SequencePicture, PictureError>> Native<L> {
    /// Looks for the path of the camera through `count` pictures. `load` gives the picture at a
    /// place; it is asked for all of them in order, and then for those of the keyframes again, in
    /// order. `has_enough` is asked before each picture and once more after them.
    ///
    /// # Errors
    ///
    /// Why no path was found. Pictures that cannot be read are [left out](Self::refused).
    pub fn find(
        intrinsics: Intrinsics,
        count: usize,
        mut load: L,
        has_enough: impl Fn() -> bool,
    ) -> Result<Self, NativeError> {
        let mut front_end = FrontEnd::new(intrinsics);
        let (mut places, mut refused) = (Vec::new(), Vec::new());
        for place in 0..count {
            if has_enough() {
                return Err(NativeError::Ended);
            }
            let pushed = load(place).and_then(|picture| {
                front_end.push(&picture.colour, picture.timestamp).map_err(PictureError::from)
            });
            match pushed {
                Ok(_) => places.push(place),
                Err(why) => refused.push((place, why)),
            }
        }
        if has_enough() {
            return Err(NativeError::Ended);
        }
        match front_end.finish() {
            Ok(reconstruction) => {
                let reader = Reader::new(places_of(&reconstruction, &places), load);
                Ok(Self { reconstruction, dense: None, reader, places, refused, next: 0 })
            }
            Err(failure) => Err(NativeError::NoPath { failure, refused }),
        }
    }

    /// The same with other pictures of the same places, of `size` [px]: the front end gains by larger
    /// ones than a map is made of. Of a lens that was found, those that are freed of it, as the camera
    /// and the landmarks are.
    #[must_use]
    pub fn with_pictures<R>(self, (width, height): (usize, usize), load: R) -> Native<R>
    where
        R: FnMut(usize) -> Result<SequencePicture, PictureError>,
    {
        let Self { reconstruction, dense, places, refused, next, .. } = self;
        let reconstruction = reconstruction.resized(width, height);
        let reader = Reader::new(places_of(&reconstruction, &places), load);
        Native { reconstruction, dense, reader, places, refused, next }
    }

    /// The same with the depth of most pixels of a keyframe, in place of that of its landmarks alone.
    #[must_use]
    pub fn with_dense_depth(mut self) -> Self {
        let view = |keyframe: &Keyframe| View {
            world_from_camera: keyframe.world_from_camera,
            landmarks: keyframe.depths.iter().map(|d| d.depth).collect(),
        };
        let views = self.reconstruction.keyframes.iter().map(view).collect();
        self.dense = Some(DenseDepths::new(self.reconstruction.camera, views));
        self
    }

    /// The frames that have a pose and are no keyframes, in order, without depth; `load` gives the
    /// picture at a place.
    pub fn between<R: FnMut(usize) -> Result<SequencePicture, PictureError>>(
        &self,
        mut load: R,
    ) -> impl ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>> + use<L, R> {
        let found = &self.reconstruction;
        let is_keyframe = |frame: usize| found.keyframes.iter().any(|k| k.index == frame);
        let frames: Vec<(usize, Pose<f64>)> = (0..found.frames.len())
            .filter(|frame| !is_keyframe(*frame))
            .filter_map(|frame| Some((*self.places.get(frame)?, pose_of(found, frame)?)))
            .collect();
        frames.into_iter().map(move |(place, world_from_camera)| {
            let SequencePicture { index, timestamp, colour } = load(place)?;
            let (before, depth) = (None, None);
            Ok(PosedKeyframe { index, timestamp, colour, world_from_camera, before, depth })
        })
    }

    /// The whole path, and what there is to warn of.
    pub fn reconstruction(&self) -> &Reconstruction {
        &self.reconstruction
    }

    /// Where in the sequence a frame of the [reconstruction](Self::reconstruction) is.
    pub fn place(&self, frame: usize) -> Option<usize> {
        self.places.get(frame).copied()
    }

    /// Pictures that could not be used: place in the sequence, reason.
    pub fn refused(&self) -> &[(usize, PictureError)] {
        &self.refused
    }

    /// Number of keyframes, taken or not.
    pub fn len(&self) -> usize {
        self.reconstruction.keyframes.len()
    }

    /// Whether there is no keyframe.
    pub fn is_empty(&self) -> bool {
        self.reconstruction.keyframes.is_empty()
    }
}

impl<L: FnMut(usize) -> Result<SequencePicture, PictureError>> KeyframeSource for Native<L> {
    fn camera(&self) -> &Camera<f64> {
        &self.reconstruction.camera
    }

    fn readout(&self) -> f64 {
        self.reconstruction.rolling_shutter_readout
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let (number, found) = (self.next, &self.reconstruction);
        let keyframe = found.keyframes.get(number)?;
        self.next += 1;
        let SequencePicture { index, colour, .. } = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        let dense = self.dense.as_mut().and_then(|dense| {
            let mut picture = |k: usize| {
                let colour = &self.reader.picture(k)?.colour;
                Some(match RowMotion::of(found, found.keyframes.get(k)?) {
                    Some(rows) => rows.undone(&found.camera, colour),
                    None => colour.clone(),
                })
            };
            dense.of(number, &mut picture)
        });
        Some(Ok(PosedKeyframe {
            index,
            timestamp: keyframe.timestamp,
            before: before(found, keyframe.index),
            depth: Some(depth(dense, keyframe, colour.width, colour.height)),
            colour,
            world_from_camera: scaled(keyframe.world_from_camera),
        }))
    }
}

/// Where in the sequence each keyframe is.
fn places_of(found: &Reconstruction, places: &[usize]) -> Vec<usize> {
    found.keyframes.iter().filter_map(|keyframe| places.get(keyframe.index).copied()).collect()
}

/// A pose in the unit of length that is delivered.
fn scaled(pose: Pose<f64>) -> Pose<f64> {
    Pose { translation: pose.translation * MEDIAN_DEPTH, ..pose }
}

/// The pose of a frame, if it has one.
fn pose_of(found: &Reconstruction, frame: usize) -> Option<Pose<f64>> {
    match found.frames.get(frame)? {
        FrameStatus::Posed { world_from_camera, .. } => Some(scaled(*world_from_camera)),
        FrameStatus::Lost => None,
    }
}

/// Stamp and pose of the frame before one.
fn before(found: &Reconstruction, frame: usize) -> Option<(f64, Pose<f64>)> {
    let before = frame.checked_sub(1)?;
    Some((*found.timestamps.get(before)?, pose_of(found, before)?))
}

/// What is known of a keyframe's depth: dense depth, with the landmarks where it is missing in more than
/// half the picture.
fn depth(
    dense: Option<DenseDepth>,
    keyframe: &Keyframe,
    width: usize,
    height: usize,
) -> EstimatedDepth {
    let mut out = sparse_depth(keyframe, width, height);
    let Some(dense) = dense.map(dense_depth) else { return out };
    if 2 * dense.depth.data.iter().filter(|z| **z > 0.0).count() > width * height {
        return dense;
    }
    for (pixel, z) in dense.depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        out.depth.data[pixel] = *z;
        if let (Some(to), Some(from)) = (&mut out.variance, &dense.variance) {
            to.data[pixel] = from.data[pixel];
        }
    }
    out
}

/// Dense depth in the unit of length that is delivered.
fn dense_depth(found: DenseDepth) -> EstimatedDepth {
    let DenseDepth { mut depth, mut variance } = found;
    let scale = MEDIAN_DEPTH as f32;
    depth.data.iter_mut().for_each(|d| *d *= scale);
    variance.data.iter_mut().for_each(|v| *v *= scale * scale);
    EstimatedDepth { depth, variance: Some(variance) }
}

/// The landmarks of a keyframe as images, zero between them; of several in one pixel the nearest,
/// which hides the others.
fn sparse_depth(keyframe: &Keyframe, width: usize, height: usize) -> EstimatedDepth {
    let (mut depth, mut variance) = (Image::new(width, height, 1), Image::new(width, height, 1));
    for point in &keyframe.depths {
        let [u, v] = point.at;
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && point.variance.sqrt() <= TRUSTED * point.depth {
            let pixel = v as usize * width + u as usize;
            let (here, known) = ((MEDIAN_DEPTH * point.depth) as f32, depth.data[pixel]);
            if known > 0.0 && known <= here {
                continue;
            }
            depth.data[pixel] = here;
            let deviation = point.variance.sqrt().hypot(LEAST_DEVIATION * point.depth);
            variance.data[pixel] = (SPARSE * MEDIAN_DEPTH * deviation).powi(2) as f32;
        }
    }
    EstimatedDepth { depth, variance: Some(variance) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall with a step in depth, seen from `place` tenths to the right.
    fn picture(camera: &Camera<f64>, place: usize) -> Image<f32> {
        let mut out = Image::new(camera.width, camera.height, 3);
        let pixels = camera.pixels();
        for i in 0..pixels {
            let (u, v) = Camera::pixel_centre(i % camera.width, i / camera.width);
            let ray = camera.unproject(u, v, 1.0);
            let at = |z: f64| (ray.x * z + 0.06 * place as f64, ray.y * z);
            let near = at(2.0);
            let (x, y) = if near.1 > 0.1 { near } else { at(3.5) };
            let wave = |a: f64, b: f64| (a * x + b * y).sin();
            let value = 0.5 + 0.12 * (wave(13.0, 5.0) + wave(-6.0, 17.0) + wave(23.0, -19.0));
            (0..3).for_each(|c| out.data[c * pixels + i] = value as f32);
        }
        out
    }

    fn stamped(camera: &Camera<f64>, place: usize, timestamp: f64) -> SequencePicture {
        SequencePicture { index: 2 * place, timestamp, colour: picture(camera, place) }
    }

    fn camera() -> Camera<f64> {
        Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 }
    }

    #[test]
    fn pictures_become_keyframes_with_poses_and_sparse_depth() {
        let camera = camera();
        let load = |place: usize| match place {
            3 => Err("damaged".into()),
            _ => Ok(stamped(&camera, place, place as f64 / 30.0)),
        };
        let mut native =
            Native::find(Intrinsics::Known(camera), 14, load, || false).expect("a path");
        assert_eq!(native.camera(), &camera);
        assert!(matches!(native.refused(), [(3, why)] if why.to_string() == "damaged"));
        let count = native.len();
        let mut places = Vec::new();
        while let Some(keyframe) = native.next_keyframe() {
            let keyframe = keyframe.expect("keyframes can be read again");
            let place = keyframe.index / 2;
            assert_eq!(keyframe.colour, picture(&camera, place));
            let depth = keyframe.depth.expect("sparse depth");
            let variance = depth.variance.expect("with variance");
            let known = depth.depth.data.iter().zip(&variance.data).filter(|(d, _)| **d > 0.0);
            assert!(known.clone().count() > 20 && known.clone().all(|(_, v)| *v > 0.0));
            places.push(place);
        }
        assert!(places.len() == count && count > 2 && !places.contains(&3), "{places:?}");
        assert!(places.is_sorted() && native.reconstruction().trajectory().len() == 13);
    }

    #[test]
    fn dense_depth_and_the_frames_between_are_there_too() {
        let camera = camera();
        let load = |place: usize| Ok(stamped(&camera, place, place as f64 / 30.0));
        let found = Native::find(Intrinsics::Known(camera), 14, load, || false).expect("a path");
        let between: Vec<PosedKeyframe> =
            found.between(load).map(|frame| frame.expect("read again")).collect();
        let mut native = found.with_dense_depth();
        let (mut known, mut indices) = (0, Vec::new());
        while let Some(keyframe) = native.next_keyframe() {
            let keyframe = keyframe.expect("keyframes can be read again");
            assert_eq!(keyframe.before.is_some(), keyframe.index > 0);
            let depth = keyframe.depth.expect("depth");
            known += depth.depth.data.iter().filter(|d| **d > 0.0).count();
            indices.push(keyframe.index);
        }
        assert!(2 * known > indices.len() * camera.pixels(), "{known} of {}", indices.len());
        assert!(between.iter().all(|frame| frame.depth.is_none()));
        indices.extend(between.iter().map(|frame| frame.index));
        indices.sort_unstable();
        assert!(indices.into_iter().eq((0..14).map(|place| 2 * place)));
    }

    /// Poses found in large pictures go with the depth of small ones, whose camera is as much smaller.
    #[test]
    fn pictures_may_be_smaller_than_those_that_the_path_was_found_in() {
        let (camera, small) = (camera(), camera().resized(80, 60));
        let load = |place: usize| Ok(stamped(&camera, place, place as f64 / 30.0));
        let found = Native::find(Intrinsics::Known(camera), 14, load, || false).expect("a path");
        let reduced = move |place: usize| {
            let of = stamped(&camera, place, place as f64 / 30.0);
            Ok(SequencePicture { colour: of.colour.resized_by_area(80, 60), ..of })
        };
        let mut native = found.with_pictures((80, 60), reduced).with_dense_depth();
        assert_eq!(*native.camera(), small);
        let (mut near, mut all) = (0, 0);
        while let Some(keyframe) = native.next_keyframe() {
            let keyframe = keyframe.expect("keyframes can be read again");
            assert_eq!((keyframe.colour.width, keyframe.colour.height), (80, 60));
            let depth = keyframe.depth.expect("depth").depth;
            // The rows below the step are as near to those above as 2 to 3.5.
            let (above, below) = depth.data.split_at(80 * 30);
            let mean = |z: &[f32]| {
                let known: Vec<f32> = z.iter().copied().filter(|z| *z > 0.0).collect();
                known.iter().sum::<f32>() / known.len().max(1) as f32
            };
            near += usize::from((mean(below) / mean(above) - 2.0 / 3.5).abs() < 0.06);
            all += 1;
        }
        assert!(all > 2 && near == all, "{near} of {all}");
    }

    #[test]
    fn pictures_are_read_in_their_order_and_those_of_keyframes_once_more() {
        let camera = camera();
        let places = std::cell::RefCell::new(Vec::new());
        let load = |place: usize| {
            places.borrow_mut().push(place);
            Ok(stamped(&camera, place, place as f64 / 30.0))
        };
        let found = Native::find(Intrinsics::Known(camera), 30, load, || false).expect("a path");
        let mut native = found.with_dense_depth();
        assert!(places.take().into_iter().eq(0..30));
        while let Some(keyframe) = native.next_keyframe() {
            keyframe.expect("keyframes can be read again");
        }
        let again = places.take();
        let rising = again.windows(2).all(|pair| pair[0] < pair[1]);
        assert!(rising && again.len() == native.len() && again.len() > 5, "{again:?}");
    }

    #[test]
    fn who_has_enough_gets_no_path() {
        let camera = camera();
        let asked = std::cell::Cell::new(0);
        let load = |place: usize| {
            asked.set(asked.get() + 1);
            Ok(stamped(&camera, place, place as f64 / 30.0))
        };
        let found = Native::find(Intrinsics::Known(camera), 30, load, || asked.get() == 12);
        assert!(matches!(found.err(), Some(NativeError::Ended)));
        assert_eq!(asked.get(), 12);
    }

    #[test]
    fn of_two_landmarks_in_a_pixel_the_nearer_is_seen() {
        let point =
            |depth: f64| i2slam_monocular::SparseDepth { at: [2.5, 1.5], depth, variance: 1e-6 };
        for depths in [[1.0, 2.0], [2.0, 1.0]] {
            let keyframe = Keyframe {
                index: 0,
                timestamp: 0.0,
                world_from_camera: Pose::identity(),
                depths: depths.map(point).to_vec(),
            };
            let depth = sparse_depth(&keyframe, 4, 3).depth;
            assert_eq!(depth.at(0, 2, 1), MEDIAN_DEPTH as f32);
        }
    }

    #[test]
    fn without_a_path_the_reason_names_the_pictures_that_were_refused() {
        let camera = camera();
        let load = |place: usize| match place {
            0..2 => Ok(stamped(&camera, place, place as f64)),
            _ => Err("damaged".into()),
        };
        let found = Native::find(Intrinsics::Known(camera), 5, load, || false);
        let message = found.err().expect("two pictures show no path").to_string();
        assert!(message.contains("2 pictures are too few"), "{message}");
        assert!(message.contains("3 pictures could not be used, the first, 2: damaged"));
    }
}
