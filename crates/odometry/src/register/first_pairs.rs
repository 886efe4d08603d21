//! Maps of photographs from several first pairs, of which the best one is kept.
//!
//! Which photographs come first decides where patterns that repeat are taken for each other: such a
//! photograph gets a wrong pose, and later ones are placed by it. In a map with fewer of them more
//! observations agree.

use super::initialization::{InitialPair, begin_with, initial_pairs, leave_out_depth};
use super::missing_matches::drop_contradicted;
use super::registration::{adjust_globally, register_keyframes};
use crate::error::OdometryError;
use crate::progress::Stage;
use crate::sfm_state::SfmState;
use rayon::prelude::*;
use std::sync::Mutex;

/// Maps beside the first one that are tried.
const MORE_MAPS: usize = 3;
/// Times that photographs which the map contradicts are left out, and placed anew without what misled them.
const MAX_CORRECTIONS: usize = 3;
/// Share of the observations that a map of all photographs does not explain, by a landmark where they are, up to
/// which no other is tried. Measured 0.04 where all photographs were right, and 0.29 to 0.48 on five sets of which
/// one was right.
const MAX_UNEXPLAINED: f64 = 0.1;

/// Registers all photographs that can be, from the first pair with which most observations agree in the end.
///
/// # Errors
///
/// Reason why no pair gives a map.
pub(crate) fn register_photographs(
    state: &mut SfmState,
    adjust_focal: bool,
) -> Result<(), OdometryError> {
    leave_out_depth(state);
    let pairs = initial_pairs(state, 0..state.tracks.keyframes.len())?;
    let order = disjoint_first(&pairs.iter().map(InitialPair::frames).collect::<Vec<_>>());
    let mut order = order.into_iter().map(|place| &pairs[place]);
    let first = order.find_map(|pair| map_from(state, pair, adjust_focal));
    let first = first.ok_or(OdometryError::NoConsistentMotion)?;
    let best = match is_beyond_doubt(&first) || state.progress.is_cancelled() {
        true => first,
        false => {
            let others: Vec<&InitialPair> = order.take(MORE_MAPS).collect();
            let quiet = SfmState { progress: state.progress.without_listener(), ..state.clone() };
            let tried = Mutex::new(0);
            state.progress.report(Stage::FirstPairs, 0, others.len());
            let try_pair = |pair: &&InitialPair| {
                let map = map_from(&quiet, pair, adjust_focal);
                // Reports come in the order of their counts.
                if let Ok(mut tried) = tried.lock() {
                    *tried += 1;
                    state.progress.report(Stage::FirstPairs, *tried, others.len());
                }
                map
            };
            let others: Vec<SfmState> = others.par_iter().filter_map(try_pair).collect();
            best_of(std::iter::once(first).chain(others).collect())
                .ok_or(OdometryError::NoConsistentMotion)?
        }
    };
    *state = SfmState { progress: state.progress.clone(), ..best };
    Ok(())
}

/// The map of all photographs that can be registered from a pair on; `None` if it begins none.
fn map_from(state: &SfmState, pair: &InitialPair, adjust_focal: bool) -> Option<SfmState> {
    let mut map = state.clone();
    if !begin_with(&mut map, pair) {
        return None;
    }
    register_keyframes(&mut map, adjust_focal, usize::MAX);
    adjust_globally(&mut map, adjust_focal);
    for _ in 0..MAX_CORRECTIONS {
        if map.progress.is_cancelled() || drop_contradicted(&mut map) == 0 {
            break;
        }
        adjust_globally(&mut map, adjust_focal);
        register_keyframes(&mut map, adjust_focal, usize::MAX);
        adjust_globally(&mut map, adjust_focal);
    }
    Some(map)
}

/// The map with which most observations agree, the first of equal ones.
fn best_of(mut maps: Vec<SfmState>) -> Option<SfmState> {
    // A map with larger residuals allows larger ones.
    let scale = maps.iter().map(|map| map.noise_scale).min_by(f64::total_cmp)?;
    let mut score = |map: &mut SfmState| {
        let own = std::mem::replace(&mut map.noise_scale, scale);
        let agreeing = agreeing(map);
        map.noise_scale = own;
        agreeing
    };
    let scores: Vec<usize> = maps.iter_mut().map(&mut score).collect();
    let best = (0..maps.len()).rev().max_by_key(|place| scores[*place])?;
    Some(maps.swap_remove(best))
}

/// Number of observations that agree with a map.
fn agreeing(map: &SfmState) -> usize {
    map.posed_frames().iter().map(|frame| map.count_inliers(*frame)).sum()
}

/// True if a map has all photographs and explains nearly all of their observations.
fn is_beyond_doubt(map: &SfmState) -> bool {
    let posed = map.posed_frames();
    let all: usize = posed.iter().map(|frame| map.observations_in(*frame).count()).sum();
    let is_complete = map.tracks.keyframes.iter().all(|frame| map.poses[*frame].is_some());
    is_complete && agreeing(map) as f64 >= (1.0 - MAX_UNEXPLAINED) * all as f64
}

/// Places of pairs, those that share a photograph with an earlier one last.
fn disjoint_first(pairs: &[[usize; 2]]) -> Vec<usize> {
    let (mut apart, mut others) = (Vec::<usize>::new(), Vec::new());
    for (place, frames) in pairs.iter().enumerate() {
        let shares = |known: &usize| pairs[*known].iter().any(|frame| frames.contains(frame));
        match apart.iter().any(shares) {
            true => others.push(place),
            false => apart.push(place),
        }
    }
    apart.extend(others);
    apart
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, state};
    use i2slam_geometry::{Pose, Rotation, Vec3};

    #[test]
    fn the_map_with_which_most_observations_agree_is_kept() {
        let pose = |i: usize| Pose::new(Rotation::identity(), Vec3::new(0.05 * i as f64, 0.0, 0.0));
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let seen = pose(frame).inverse() * point;
            (seen.z > 0.0).then(|| camera().project(seen).into())
        };
        let right = state((6, 12, 1), [60.0, 40.0], pose, observe);
        let mut wrong = right.clone();
        wrong.poses[3] = Some(pose(3) * Pose::new(Rotation::identity(), Vec3::new(0.2, 0.0, 0.0)));
        assert!(agreeing(&wrong) < agreeing(&right) && is_beyond_doubt(&right));
        assert!(!is_beyond_doubt(&wrong));
        // A wider tolerance of its own does not help the wrong one.
        wrong.noise_scale = 1000.0;
        let kept = best_of(vec![wrong.clone(), right.clone(), wrong]).expect("one of three");
        assert_eq!(kept.poses, right.poses);
        assert!(best_of(Vec::new()).is_none());
        let mut incomplete = right;
        incomplete.poses[5] = None;
        assert!(!is_beyond_doubt(&incomplete));
    }

    #[test]
    fn pairs_that_share_a_photograph_come_last() {
        let pairs = [[0, 1], [1, 2], [4, 3], [0, 3], [5, 6]];
        assert_eq!(disjoint_first(&pairs), [0, 2, 4, 1, 3]);
        assert!(disjoint_first(&[]).is_empty());
    }
}
