//! Geometric verification: the pose of a keyframe in the map around another one.
//!
//! RANSAC over descriptor matches gives a pose. Most points of the old keyframe must be found where
//! it predicts them, with their patches, in nearly all regions of the picture: a poster that hangs
//! on two walls does not pass.

use crate::multiview::landmark::{Landmark, Match, registration_error, warp_between_views};
use crate::multiview::pnp::{solve_pnp, solve_pnp_ransac};
use crate::relocalize::descriptor::DescribedPoints;
use crate::sfm_state::SfmState;
use crate::track::patch::AffineWarp;
use crate::track::point_search::{AnchorPatch, position_whitening};
use crate::track::pyramid::Pyramid;
use crate::track::thumbnail::KeyframeImage;
use crate::track::tracks::Observation;
use i2slam_compute::median;
use i2slam_geometry::Pose;

/// Standard deviation of descriptor matches [px of the kept picture].
const DESCRIPTOR_SIGMA: f64 = 1.5;
/// Residual of a match that agrees with the pose [standard deviations].
const MAX_MATCH_ERROR: f64 = 3.0;
/// Points of the old keyframe that are searched.
const MAX_SEARCHED_POINTS: usize = 200;
/// Correlation with the old patch, and distance from the predicted position [px].
const MIN_PATCH_CORRELATION: f32 = 0.75;
const MAX_SEARCH_DISTANCE: f32 = 4.0;
/// Distance from the edge within which points are not searched [px].
const BORDER: f64 = 8.0;
/// Points that must be found, and their ratio of those searched.
const MIN_VERIFIED_POINTS: usize = 20;
const MIN_VERIFIED_RATIO: f64 = 0.45;
/// Cells of the picture per side; a cell with enough points is verified if enough of them are
/// found. Places that only look alike differ in whole regions.
const CELLS_PER_SIDE: usize = 4;
const MIN_POINTS_PER_CELL: usize = 4;
const MIN_VERIFIED_RATIO_PER_CELL: f64 = 0.3;
const MIN_VERIFIED_CELLS: usize = 5;
const MIN_VERIFIED_CELL_RATIO: f64 = 0.7;
/// Points with a depth in both maps needed for the ratio of scales.
const MIN_SCALE_POINTS: usize = 8;

/// A keyframe localised in the map around another one.
#[derive(Clone, Debug)]
pub(crate) struct Relocalization {
    /// Its pose in the map of the other keyframe.
    pub(crate) world_from_camera: Pose<f64>,
    /// Ratio of lengths in the other map to those in the keyframe's own one, if it has a pose.
    pub(crate) scale: Option<f64>,
    /// Observations of the other keyframe's tracks in this one.
    pub(crate) observations: Vec<(usize, Observation)>,
}

/// A track of the old keyframe, its landmark and its observation there.
type KnownLandmark<'a> = (usize, &'a Landmark, &'a Observation);

/// Localises `new` by the landmarks of `old`, a keyframe with a pose.
pub(crate) fn match_and_verify(
    state: &SfmState,
    new: &KeyframeImage,
    old: &KeyframeImage,
) -> Option<Relocalization> {
    let comparison = KeyframeComparison::new(state, new, old)?;
    let (tracks, observations) = comparison.match_descriptors();
    let known = |(_, j): &(usize, usize)| comparison.known[*j].1;
    let matches: Vec<Match<'_>> = tracks.iter().map(known).zip(&observations).collect();
    let pose = solve_pnp_ransac(&state.camera, comparison.old_pose, &matches)?;
    let observations = comparison.verify_pose(pose)?;
    let exact: Vec<Match<'_>> =
        observations.iter().filter_map(|(t, o)| Some((state.landmarks[*t].as_ref()?, o))).collect();
    let found = solve_pnp(&state.camera, pose, &exact, state.noise_scale)?;
    if found.inliers < MIN_VERIFIED_POINTS {
        return None;
    }
    let pose = found.world_from_camera;
    let both = tracks.iter().zip(&matches).map(|((track, _), m)| (*track, *m));
    let scale = relative_scale(state, new.frame, &pose, both);
    Some(Relocalization { world_from_camera: pose, scale, observations })
}

/// Observations of the tracks of `old` in `new`, if the known poses of both pass verification.
pub(crate) fn verify_known_pose(
    state: &SfmState,
    new: &KeyframeImage,
    old: &KeyframeImage,
) -> Option<Vec<(usize, Observation)>> {
    KeyframeComparison::new(state, new, old)?.verify_pose(state.poses[new.frame]?)
}

/// Two keyframes, the old one with a pose.
struct KeyframeComparison<'a> {
    state: &'a SfmState,
    new: &'a KeyframeImage,
    old: &'a KeyframeImage,
    old_pose: Pose<f64>,
    new_pyramid: Pyramid,
    old_pyramid: Pyramid,
    /// Landmarks of the old one.
    known: Vec<KnownLandmark<'a>>,
}

impl<'a> KeyframeComparison<'a> {
    fn new(state: &'a SfmState, new: &'a KeyframeImage, old: &'a KeyframeImage) -> Option<Self> {
        let known = |(track, o): (usize, &'a Observation)| {
            let landmark = state.landmarks[track].as_ref()?;
            (!o.is_outlier).then_some((track, landmark, o))
        };
        Some(Self {
            state,
            new,
            old,
            old_pose: state.poses[old.frame]?,
            new_pyramid: new.pyramid(),
            old_pyramid: old.pyramid(),
            known: state.observations_in(old.frame).filter_map(known).collect(),
        })
    }

    /// Descriptor matches: (new track, index of the known landmark), and their new observations.
    fn match_descriptors(&self) -> (Vec<(usize, usize)>, Vec<Observation>) {
        let (new, old) = (self.new, self.old);
        let at = |o: &Observation, image: &KeyframeImage| o.raw().map(|v| v / image.scale);
        let seen: Vec<(usize, &Observation)> =
            self.state.observations_in(new.frame).filter(|(_, o)| !o.is_outlier).collect();
        let here: Vec<[f64; 2]> = seen.iter().map(|(_, o)| at(o, new)).collect();
        let there: Vec<[f64; 2]> = self.known.iter().map(|(_, _, o)| at(o, old)).collect();
        let here = DescribedPoints::new(&self.new_pyramid, &here);
        let pairs = here.matches(&DescribedPoints::new(&self.old_pyramid, &there));
        let sigma = DESCRIPTOR_SIGMA * new.scale;
        let rough = |(i, _): &(usize, usize)| seen[*i].1.with_sigma(sigma);
        let observations = pairs.iter().map(rough).collect();
        (pairs.into_iter().map(|(i, j)| (seen[i].0, j)).collect(), observations)
    }

    /// The old one's points observed in the new one, if enough are where `pose` predicts them.
    fn verify_pose(&self, pose: Pose<f64>) -> Option<Vec<(usize, Observation)>> {
        let camera = &self.state.camera;
        let visible: Vec<(KnownLandmark<'_>, [f64; 2])> = self
            .known
            .iter()
            .filter_map(|k| Some((*k, k.1.image_position(camera, &pose)?)))
            .filter(|(_, at)| camera.contains(at[0], at[1], BORDER * self.new.scale))
            .collect();
        let step = visible.len().div_ceil(MAX_SEARCHED_POINTS).max(1);
        let visible: Vec<_> = visible.into_iter().step_by(step).collect();
        let find =
            |(known, at): &(KnownLandmark<'_>, [f64; 2])| self.search_landmark(known, *at, &pose);
        let found: Vec<Option<(usize, Observation)>> = visible.iter().map(find).collect();
        // Points searched and points found in every cell.
        let mut cells = [[0_usize; 2]; CELLS_PER_SIDE * CELLS_PER_SIDE];
        for ((_, at), found) in visible.iter().zip(&found) {
            let part = |v: f64, size: usize| (v * CELLS_PER_SIDE as f64 / size as f64) as usize;
            let (column, row) = (part(at[0], camera.width), part(at[1], camera.height));
            let cell = &mut cells
                [row.min(CELLS_PER_SIDE - 1) * CELLS_PER_SIDE + column.min(CELLS_PER_SIDE - 1)];
            cell[0] += 1;
            cell[1] += usize::from(found.is_some());
        }
        let populated = cells.iter().filter(|c| c[0] >= MIN_POINTS_PER_CELL);
        let shown =
            populated.clone().filter(|c| c[1] as f64 >= MIN_VERIFIED_RATIO_PER_CELL * c[0] as f64);
        let (populated, shown) = (populated.count(), shown.count());
        let observations: Vec<(usize, Observation)> = found.into_iter().flatten().collect();
        let enough = observations.len() >= MIN_VERIFIED_POINTS
            && observations.len() as f64 >= MIN_VERIFIED_RATIO * visible.len() as f64
            && shown >= MIN_VERIFIED_CELLS
            && shown as f64 >= MIN_VERIFIED_CELL_RATIO * populated as f64;
        enough.then_some(observations)
    }

    /// Searches for a point of the old one in the new one around `at`.
    fn search_landmark(
        &self,
        (track, landmark, shown): &KnownLandmark<'_>,
        at: [f64; 2],
        pose: &Pose<f64>,
    ) -> Option<(usize, Observation)> {
        let (new, scale) = (self.new, self.new.scale);
        let rows = rolling_shutter_offset(self.state, new.frame, at);
        let centre = std::array::from_fn(|i| ((at[i] + rows[i]) / scale) as f32);
        let matrix = warp_between_views(&self.state.camera, landmark, &self.old_pose, pose)?;
        let in_old = shown.raw().map(|v| (v / self.old.scale) as f32);
        let anchor = AnchorPatch::new(&self.old_pyramid, in_old)?;
        let found = anchor.align(&self.new_pyramid, AffineWarp { matrix, centre }, 1)?;
        let moved = (found.warp.centre[0] - centre[0]).hypot(found.warp.centre[1] - centre[1]);
        let is_there = found.correlation > MIN_PATCH_CORRELATION && moved < MAX_SEARCH_DISTANCE;
        let at = found.warp.centre.map(|v| f64::from(v) * scale);
        let observation = Observation::whitened(
            new.frame,
            at,
            position_whitening(&found, scale).plus(&shown.whitening().mapped(found.warp.matrix)),
        )
        .moved_to(std::array::from_fn(|i| at[i] - rows[i]));
        is_there.then_some((*track, observation))
    }
}

/// Correction for the rolling shutter near a position of a frame [px].
fn rolling_shutter_offset(state: &SfmState, frame: usize, at: [f64; 2]) -> [f64; 2] {
    let far = |o: &Observation| (o.at()[0] - at[0]).powi(2) + (o.at()[1] - at[1]).powi(2);
    let near = state.observations_in(frame).min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    near.map_or([0.0; 2], |(_, o)| [o.raw()[0] - o.at()[0], o.raw()[1] - o.at()[1]])
}

/// Median ratio of depths in the old map to those in the new one, over points that have both.
fn relative_scale<'a>(
    state: &SfmState,
    frame: usize,
    pose: &Pose<f64>,
    matches: impl Iterator<Item = (usize, Match<'a>)>,
) -> Option<f64> {
    let own = state.poses[frame]?;
    let ratio = |(track, m): (usize, Match<'a>)| {
        let here = (own.inverse() * state.landmarks[track]?.position()).z;
        let there = (pose.inverse() * m.0.position()).z;
        let agrees = registration_error(&state.camera, pose, &m, 1.0) < MAX_MATCH_ERROR;
        (agrees && here > 0.0 && there > 0.0).then_some(there / here)
    };
    let mut ratios: Vec<f64> = matches.filter_map(ratio).collect();
    if ratios.len() < MIN_SCALE_POINTS { None } else { median(&mut ratios) }
}
