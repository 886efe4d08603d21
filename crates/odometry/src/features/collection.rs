//! Photographs: pictures that show one scene from places too far apart for tracking, in any order.

use super::aliked::Features;
use super::matching::match_features;
use super::rotation_averaging::{RelativeRotation, average_rotations};
use super::verification::{MatchedPair, match_pair, position_sigma};
use crate::progress::{Progress, Stage};
use crate::track::pyramid::Pyramid;
use crate::track::thumbnail::KeyframeImage;
use crate::track::tracks::{Observation, Track};
use i2slam_compute::median;
use i2slam_geometry::{Camera, Pose, Rotation, Vec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// Points that are tracked into a picture of a film, at least, and their ratio to those seen in the picture
/// before: less is rare (up to 5 %) even in films of a camera that turns fast, at half their rate.
const MIN_TRACKED_POINTS: usize = 24;
const MIN_TRACKED_SHARE: f64 = 0.3;
/// Share of pictures with fewer tracked points beyond which all are photographs: shuffled frames of films with
/// much overlap have 0.27 and more, films up to 0.05.
const MIN_BREAK_SHARE: f64 = 0.2;
/// Pictures whose features can still be found.
const MAX_RECENT_PICTURES: usize = 8;
/// Pictures after which a film is known to be one.
const MAX_UNDECIDED_PICTURES: usize = 60;
/// Pictures of which each is compared with every other one; with more of them, each is compared with so
/// many that have most matches among the features of most contrast (Wu 2013).
const MAX_EXHAUSTIVE: usize = 40;
const MAX_CANDIDATES: usize = 20;
const COMPARED_FEATURES: usize = 300;
/// Pairs that are matched between two reports of progress.
const REPORTED_PAIRS: usize = 8;
/// Angle between the rotation of a pair and that of the orientations of all, at most, and angle between the
/// axes of two pictures beyond which they show no surface both [rad].
const MAX_CONTRADICTION: f64 = 0.6;
const MAX_AXIS_ANGLE: f64 = 1.4;
/// Distance of matches from the epipolar lines of approximate poses, at most, over the median of all: four
/// standard deviations of normally distributed ones.
const MAX_DISTANCE_OVER_MEDIAN: f64 = 6.0;

/// A picture with its features.
#[derive(Clone, Debug)]
struct View {
    image: Arc<KeyframeImage>,
    features: Arc<Features>,
}

/// Two photographs whose features were matched.
#[derive(Clone, Debug)]
pub(crate) struct PhotographPair {
    /// Frames.
    pub(crate) first: usize,
    pub(crate) second: usize,
    /// Matches, as indices of features of both, whether or not they agree on a relative pose.
    pub(crate) matches: Vec<(usize, usize)>,
    /// Rotation and direction of the translation, where enough matches agree on one.
    pub(crate) second_from_first: Option<Pose<f64>>,
}

/// A feature of a photograph.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhotographFeature {
    /// Position as the lens shows it [px].
    pub(crate) at: [f64; 2],
    /// Index of the track that it belongs to.
    pub(crate) track: Option<usize>,
}

/// Photographs matched with each other.
#[derive(Clone, Debug)]
pub(crate) struct MatchedPhotographs {
    /// Frames of all pairs that were compared, the lower one first.
    pub(crate) compared: Arc<Vec<[usize; 2]>>,
    /// Those whose matches count.
    pub(crate) pairs: Vec<PhotographPair>,
    /// Features of every frame.
    pub(crate) features: BTreeMap<usize, Vec<PhotographFeature>>,
    /// Frames whose pose was found to be wrong once.
    pub(crate) registered_anew: BTreeSet<usize>,
}

/// Leaves out what contradicts approximate poses, `world_from_camera` of every view: pairs whose relative
/// rotation is another, and matches that lie off their epipolar lines by far more than most.
fn consistent_with_poses(
    camera: &Camera<f64>,
    (features, poses): (&[&Features], &[Option<Pose<f64>>]),
    mut matched: Vec<((usize, usize), MatchedPair)>,
) -> Vec<((usize, usize), MatchedPair)> {
    let relative = |(a, b): (usize, usize)| Some(poses[b]?.inverse() * poses[a]?);
    let of_pair = |(a, b): (usize, usize)| [features[a], features[b]];
    let angle = |(pair, found): &((usize, usize), MatchedPair)| {
        let verified = found.verified.as_ref()?.second_from_first;
        Some((relative(*pair)?.rotation.inverse() * verified.rotation).log().norm())
    };
    matched.retain(|(pair, _)| relative(*pair).is_none_or(|pose| is_facing(pose.rotation)));
    let is_near = |pair: &_| angle(pair).is_none_or(|angle| angle < MAX_CONTRADICTION);
    matched.retain(is_near);
    let distances = |(pair, found): &((usize, usize), MatchedPair)| {
        Some(found.distances_from(camera, of_pair(*pair), &relative(*pair)?))
    };
    let mut distances: Vec<f64> = matched.iter().filter_map(distances).flatten().collect();
    let Some(usual) = median(&mut distances) else { return matched };
    for (pair, found) in &mut matched {
        if let Some(pose) = relative(*pair) {
            found.keep_near(camera, of_pair(*pair), (&pose, MAX_DISTANCE_OVER_MEDIAN * usual));
        }
    }
    matched
}

/// True if the axes of two pictures, one turned against the other, are such that they may show one surface.
fn is_facing(between: Rotation<f64>) -> bool {
    between.rotate(Vec3::new(0.0, 0.0, 1.0)).z > MAX_AXIS_ANGLE.cos()
}

/// Pictures at which tracking broke off, on both sides, as long as they may be photographs.
#[derive(Clone, Debug, Default)]
pub(crate) struct PhotoCollection {
    views: BTreeMap<usize, View>,
    /// The last pictures, of which features may be wanted.
    recent: VecDeque<(usize, Arc<Pyramid>)>,
    breaks: usize,
    pictures: usize,
    is_film: bool,
}

impl PhotoCollection {
    /// Adds the picture of a frame that repeats no other, by the numbers of points that are `tracked` into it,
    /// those found again after they were hidden included, and of points `seen_before`, in the last picture.
    pub(crate) fn add(
        &mut self,
        frame: usize,
        picture: &Arc<Pyramid>,
        [tracked, seen_before]: [usize; 2],
    ) {
        if self.is_film {
            return;
        }
        self.pictures += 1;
        self.recent.push_back((frame, Arc::clone(picture)));
        if self.recent.len() > MAX_RECENT_PICTURES {
            self.recent.pop_front();
        }
        let is_broken = tracked < MIN_TRACKED_POINTS
            || (tracked as f64) < MIN_TRACKED_SHARE * seen_before as f64;
        let is_break = self.pictures > 1 && is_broken;
        self.breaks += usize::from(is_break);
        let wanted = match (self.is_unordered(), is_break) {
            (true, _) => self.recent.len(),
            (false, true) => 2,
            (false, false) => 0,
        };
        for (frame, pyramid) in self.recent.iter().rev().take(wanted) {
            self.views.entry(*frame).or_insert_with(|| View::new(pyramid, *frame));
        }
        // Features take a megabyte a picture.
        if self.pictures >= MAX_UNDECIDED_PICTURES && !self.is_unordered() {
            *self = Self { is_film: true, ..Self::default() };
        }
    }

    /// True if the pictures are photographs rather than frames of a film.
    pub(crate) fn is_unordered(&self) -> bool {
        !self.is_film && self.breaks as f64 > MIN_BREAK_SHARE * self.pictures as f64
    }

    /// The pictures in small, in order.
    pub(crate) fn images(&self) -> impl Iterator<Item = &Arc<KeyframeImage>> {
        self.views.values().map(|view| &view.image)
    }

    /// Matches the features of all photographs, and verifies them by relative poses, near `approximate` ones
    /// of the frames where these are known; also the points that features of at least two show, whose indices
    /// begin at `first_track`.
    pub(crate) fn match_all(
        &self,
        camera: &Camera<f64>,
        approximate: &[Option<Pose<f64>>],
        first_track: usize,
        progress: &Progress,
    ) -> (MatchedPhotographs, Vec<Track>) {
        let frames: Vec<usize> = self.views.keys().copied().collect();
        let features: Vec<&Features> = self.views.values().map(|v| v.features.as_ref()).collect();
        let compared = compared_pairs(&features);
        let pose = |frame: &usize| approximate.get(*frame).copied().flatten();
        let poses: Vec<Option<Pose<f64>>> = frames.iter().map(pose).collect();
        let matched = |&(a, b): &(usize, usize)| match progress.is_cancelled() {
            true => None,
            false => {
                let between = poses[a].zip(poses[b]).map(|(a, b)| b.inverse() * a);
                Some(((a, b), match_pair(camera, [features[a], features[b]], between)))
            }
        };
        let mut all: Vec<((usize, usize), MatchedPair)> = Vec::with_capacity(compared.len());
        for (chunk, pairs) in compared.chunks(REPORTED_PAIRS).enumerate() {
            progress.report(Stage::Matching, chunk * REPORTED_PAIRS, compared.len());
            all.par_extend(pairs.par_iter().filter_map(matched));
        }
        let matched = match approximate {
            [] => without_contradictions(features.len(), all),
            _ => consistent_with_poses(camera, (&features, &poses), all),
        };
        let (tracks, track_of) = joined(&frames, &features, &matched, position_sigma(camera));
        let pair = |((a, b), pair): ((usize, usize), MatchedPair)| PhotographPair {
            first: frames[a],
            second: frames[b],
            matches: pair.distinct.iter().map(|m| (m.first, m.second)).collect(),
            second_from_first: pair.verified.map(|verified| verified.second_from_first),
        };
        let of_view = |(view, features): (usize, &&Features)| {
            let feature = |(at, track): (&[f64; 2], &Option<usize>)| PhotographFeature {
                at: *at,
                track: track.map(|track| first_track + track),
            };
            let all = features.positions.iter().zip(&track_of[view]).map(feature).collect();
            (frames[view], all)
        };
        let features = features.iter().enumerate().map(of_view).collect();
        let pairs = matched.into_iter().map(pair).collect();
        let compared = compared.iter().map(|&(a, b)| [frames[a], frames[b]]).collect();
        let (compared, registered_anew) = (Arc::new(compared), BTreeSet::new());
        (MatchedPhotographs { compared, pairs, features, registered_anew }, tracks)
    }
}

impl View {
    fn new(pyramid: &Pyramid, frame: usize) -> Self {
        Self {
            image: Arc::new(KeyframeImage::new(pyramid, frame)),
            features: Arc::new(Features::new(pyramid.finest())),
        }
    }
}

/// Pairs of pictures whose features are matched.
fn compared_pairs(features: &[&Features]) -> Vec<(usize, usize)> {
    let all = (0..features.len()).flat_map(|a| (a + 1..features.len()).map(move |b| (a, b)));
    if features.len() <= MAX_EXHAUSTIVE {
        return all.collect();
    }
    let strongest: Vec<Features> =
        features.iter().map(|f| f.strongest_of_smaller(COMPARED_FEATURES)).collect();
    let all: Vec<(usize, usize)> = all.collect();
    let alike =
        |&(a, b): &(usize, usize)| match_features(&strongest[a], &strongest[b]).distinct.len();
    let counts: Vec<usize> = all.par_iter().map(alike).collect();
    let mut of_view: Vec<Vec<(usize, usize)>> = vec![Vec::new(); features.len()];
    for (pair, &(a, b)) in all.iter().enumerate() {
        [a, b].iter().for_each(|view| of_view[*view].push((counts[pair], pair)));
    }
    let mut chosen: Vec<usize> = Vec::new();
    for mut pairs in of_view {
        pairs.sort_by(|x, y| y.0.cmp(&x.0).then(x.1.cmp(&y.1)));
        chosen.extend(pairs.iter().take(MAX_CANDIDATES).map(|(_, pair)| *pair));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen.into_iter().map(|pair| all[pair]).collect()
}

/// The pairs without those that contradict the orientations of all, or that look in opposite directions.
fn without_contradictions(
    count: usize,
    matched: Vec<((usize, usize), MatchedPair)>,
) -> Vec<((usize, usize), MatchedPair)> {
    let rotation = |((first, second), pair): &((usize, usize), MatchedPair)| {
        let verified = pair.verified.as_ref()?;
        let second_from_first = verified.second_from_first.rotation;
        // Repeated patterns give many pairs of few matches.
        let weight = (verified.matches.len() as f64).powi(2);
        Some(RelativeRotation { first: *first, second: *second, second_from_first, weight })
    };
    let rotations: Vec<RelativeRotation> = matched.iter().filter_map(rotation).collect();
    let found = average_rotations(count, &rotations);
    let is_possible = |pair: &((usize, usize), MatchedPair)| {
        let [(part, first), (other, second)] = [found[pair.0.0], found[pair.0.1]];
        let between = second * first.inverse();
        let agrees = rotation(pair).is_none_or(|own| {
            (between.inverse() * own.second_from_first).log().norm() < MAX_CONTRADICTION
        });
        part != other || (is_facing(between) && agrees)
    };
    let kept: Vec<bool> = matched.iter().map(is_possible).collect();
    matched.into_iter().zip(kept).filter(|(_, kept)| *kept).map(|(pair, _)| pair).collect()
}

/// Tracks of the features that verified matches join, where no picture shows two of them, and the track of
/// every feature.
fn joined(
    frames: &[usize],
    features: &[&Features],
    matched: &[((usize, usize), MatchedPair)],
    sigma: f64,
) -> (Vec<Track>, Vec<Vec<Option<usize>>>) {
    let mut first = vec![0; features.len() + 1];
    (0..features.len()).for_each(|view| first[view + 1] = first[view] + features[view].len());
    let mut sets = DisjointSets((0..first[features.len()]).collect());
    for ((a, b), pair) in matched {
        for m in pair.verified.iter().flat_map(|verified| &verified.matches) {
            sets.join(first[*a] + m.first, first[*b] + m.second);
        }
    }
    let mut points: BTreeMap<usize, Vec<(usize, usize)>> = BTreeMap::new();
    for (view, of_view) in features.iter().enumerate() {
        for i in 0..of_view.len() {
            points.entry(sets.root(first[view] + i)).or_default().push((view, i));
        }
    }
    let is_one_point = |shown: &Vec<(usize, usize)>| {
        shown.len() > 1 && shown.windows(2).all(|pair| pair[0].0 != pair[1].0)
    };
    let mut track_of: Vec<Vec<Option<usize>>> =
        features.iter().map(|of_view| vec![None; of_view.len()]).collect();
    let mut tracks = Vec::new();
    for shown in points.into_values().filter(is_one_point) {
        let observe = |&(view, i): &(usize, usize)| {
            Observation::new(frames[view], features[view].positions[i], sigma)
        };
        shown.iter().for_each(|&(view, i)| track_of[view][i] = Some(tracks.len()));
        tracks.push(Track { observations: shown.iter().map(observe).collect() });
    }
    (tracks, track_of)
}

/// Disjoint sets by their parents.
struct DisjointSets(Vec<usize>);

impl DisjointSets {
    fn root(&mut self, mut of: usize) -> usize {
        while self.0[of] != of {
            self.0[of] = self.0[self.0[of]];
            of = self.0[of];
        }
        of
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::moved_blobs;

    /// Points tracked and seen before, as in frames in random order, in a fast film, and in one cut twice.
    #[test]
    fn pictures_that_lose_most_points_again_and_again_are_photographs() {
        let shuffled = [
            [264, 410],
            [231, 420],
            [110, 390],
            [69, 400],
            [26, 380],
            [39, 300],
            [90, 330],
            [83, 350],
            [289, 400],
            [357, 420],
        ];
        let fast = [
            [546, 700],
            [464, 690],
            [240, 500],
            [134, 330],
            [194, 280],
            [171, 320],
            [114, 360],
            [202, 300],
            [276, 350],
            [399, 450],
        ];
        let cut = [
            [300, 400],
            [0, 400],
            [310, 400],
            [320, 400],
            [330, 400],
            [300, 400],
            [0, 400],
            [310, 400],
            [320, 400],
            [330, 400],
        ];
        let picture = Arc::new(Pyramid::new(&moved_blobs(0.0)));
        for (points, expected) in [(shuffled, true), (fast, false), (cut, false)] {
            let mut collection = PhotoCollection::default();
            collection.add(0, &picture, [0, 0]);
            (1..).zip(points).for_each(|(frame, points)| collection.add(frame, &picture, points));
            assert_eq!(collection.is_unordered(), expected, "{points:?}");
        }
    }
}
