//! A keyframe recognised in another one that shares no points with it.
//!
//! Points of both are matched by what is around them; random samples of four matches give poses
//! by iteration, and the best is put to the test: most points of the old keyframe must be found
//! where it says, as they looked there. One poster twice on different walls does not pass.

use crate::multiview::landmark::{Landmark, Match, reprojection_error};
use crate::multiview::pnp::{resect, resect_exactly};
use crate::relocalize::descriptor::Described;
use crate::sfm_state::Scene;
use crate::track::patch::Warp;
use crate::track::point_search::{Anchor, deviation};
use crate::track::pyramid::Pyramid;
use crate::track::thumbnail::Look;
use crate::track::tracks::Observation;
use i2slam_compute::{Random, median};
use i2slam_geometry::Pose;

/// Standard deviation of matched corners [px of the kept picture].
const DEVIATION: f64 = 1.5;
/// Hypotheses of the random search, and matches of each.
const HYPOTHESES: usize = 300;
const SAMPLE: usize = 4;
/// Residuals beyond this do not count any worse, and do not agree [standard deviations].
const TRUNCATION: f64 = 3.0;
/// Matches that must agree, and their share.
const MIN_AGREEING: usize = 12;
const MIN_SHARE: f64 = 0.25;
/// Points of the old keyframe that are looked for, at most.
const LOOKED_FOR: usize = 200;
/// Correlation with the old look, and distance from where a point should be [px].
const MIN_CORRELATION: f32 = 0.75;
const REACH: f32 = 4.0;
/// Points nearer to the edge are not looked for [px].
const BORDER: f64 = 8.0;
/// Points that must be found, and their share of those looked for.
const MIN_FOUND: usize = 20;
const MIN_FOUND_SHARE: f64 = 0.45;
/// The picture is cut into so many columns and rows. Of the cells with so many points or more, most
/// must show such a share of them: what only looks alike differs in whole regions.
const CELLS: usize = 4;
const MIN_IN_CELL: usize = 4;
const MIN_SHARE_OF_CELL: f64 = 0.3;
const MIN_CELLS: usize = 5;
const MIN_CELL_SHARE: f64 = 0.7;
/// Points with a depth in both parts without which their scales are not compared.
const MIN_DEPTHS: usize = 8;

/// A keyframe in the place of another one.
#[derive(Clone, Debug)]
pub(crate) struct Recognised {
    /// Its pose in the part of the world that the other one belongs to.
    pub(crate) world_from_camera: Pose<f64>,
    /// How many times as large lengths are there as in the keyframe's own part, if it has one.
    pub(crate) scale: Option<f64>,
    /// The other one's tracks as this one shows them.
    pub(crate) sights: Vec<(usize, Observation)>,
}

/// A track of the old keyframe, its landmark and where that keyframe shows it.
type Known<'a> = (usize, &'a Landmark, &'a Observation);

/// Looks for the place of `new` in what `old`, a keyframe with a pose, shows.
pub(crate) fn recognise(scene: &Scene, new: &Look, old: &Look) -> Option<Recognised> {
    let comparison = Comparison::new(scene, new, old)?;
    let (tracks, observations) = comparison.matched();
    let known = |(_, j): &(usize, usize)| comparison.known[*j].1;
    let matches: Vec<Match<'_>> = tracks.iter().map(known).zip(&observations).collect();
    let pose = by_samples(scene, comparison.old_pose, &matches)?;
    let sights = comparison.confirm(pose)?;
    let exact: Vec<Match<'_>> =
        sights.iter().filter_map(|(t, o)| Some((scene.landmarks[*t].as_ref()?, o))).collect();
    let found = resect(&scene.camera, pose, &exact, scene.noise)?;
    if found.agreeing < MIN_FOUND {
        return None;
    }
    let pose = found.world_from_camera;
    let both = tracks.iter().zip(&matches).map(|((track, _), m)| (*track, *m));
    let scale = scale(scene, new.frame, &pose, both);
    Some(Recognised { world_from_camera: pose, scale, sights })
}

/// The tracks of `old` as `new` shows them, if their poses agree with what both look like.
pub(crate) fn look_again(
    scene: &Scene,
    new: &Look,
    old: &Look,
) -> Option<Vec<(usize, Observation)>> {
    Comparison::new(scene, new, old)?.confirm(scene.poses[new.frame]?)
}

/// Two keyframes, the old one with a pose.
struct Comparison<'a> {
    scene: &'a Scene,
    new: &'a Look,
    old: &'a Look,
    old_pose: Pose<f64>,
    new_pyramid: Pyramid,
    old_pyramid: Pyramid,
    /// Landmarks of the old one.
    known: Vec<Known<'a>>,
}

impl<'a> Comparison<'a> {
    fn new(scene: &'a Scene, new: &'a Look, old: &'a Look) -> Option<Self> {
        let known = |(track, o): (usize, &'a Observation)| {
            let landmark = scene.landmarks[track].as_ref()?;
            (!o.is_wrong).then_some((track, landmark, o))
        };
        Some(Self {
            scene,
            new,
            old,
            old_pose: scene.poses[old.frame]?,
            new_pyramid: new.pyramid(),
            old_pyramid: old.pyramid(),
            known: scene.shown(old.frame).filter_map(known).collect(),
        })
    }

    /// Matched points by what is around them: track of the new one and place among the known, and
    /// where the new one shows them.
    fn matched(&self) -> (Vec<(usize, usize)>, Vec<Observation>) {
        let (new, old) = (self.new, self.old);
        let at = |o: &Observation, look: &Look| o.seen.map(|v| v / look.scale);
        let seen: Vec<(usize, &Observation)> =
            self.scene.shown(new.frame).filter(|(_, o)| !o.is_wrong).collect();
        let here: Vec<[f64; 2]> = seen.iter().map(|(_, o)| at(o, new)).collect();
        let there: Vec<[f64; 2]> = self.known.iter().map(|(_, _, o)| at(o, old)).collect();
        let here = Described::new(&self.new_pyramid, &here);
        let pairs = here.matches(&Described::new(&self.old_pyramid, &there));
        let sigma = DEVIATION * new.scale;
        let rough = |(i, _): &(usize, usize)| Observation { sigma, ..*seen[*i].1 };
        let observations = pairs.iter().map(rough).collect();
        (pairs.into_iter().map(|(i, j)| (seen[i].0, j)).collect(), observations)
    }

    /// The old one's points as the new one shows them, if enough of them are where `pose` says.
    fn confirm(&self, pose: Pose<f64>) -> Option<Vec<(usize, Observation)>> {
        let camera = &self.scene.camera;
        let visible: Vec<(Known<'_>, [f64; 2])> = self
            .known
            .iter()
            .filter_map(|k| Some((*k, k.1.image_position(camera, &pose)?)))
            .filter(|(_, at)| camera.contains(at[0], at[1], BORDER * self.new.scale))
            .collect();
        let step = visible.len().div_ceil(LOOKED_FOR).max(1);
        let visible: Vec<_> = visible.into_iter().step_by(step).collect();
        let find = |(known, at): &(Known<'_>, [f64; 2])| self.find(known, *at, &pose);
        let found: Vec<Option<(usize, Observation)>> = visible.iter().map(find).collect();
        // Points looked for and points found in every cell.
        let mut cells = [[0_usize; 2]; CELLS * CELLS];
        for ((_, at), found) in visible.iter().zip(&found) {
            let part = |v: f64, size: usize| (v * CELLS as f64 / size as f64) as usize;
            let (column, row) = (part(at[0], camera.width), part(at[1], camera.height));
            let cell = &mut cells[row.min(CELLS - 1) * CELLS + column.min(CELLS - 1)];
            cell[0] += 1;
            cell[1] += usize::from(found.is_some());
        }
        let populated = cells.iter().filter(|c| c[0] >= MIN_IN_CELL);
        let shown = populated.clone().filter(|c| c[1] as f64 >= MIN_SHARE_OF_CELL * c[0] as f64);
        let (populated, shown) = (populated.count(), shown.count());
        let sights: Vec<(usize, Observation)> = found.into_iter().flatten().collect();
        let enough = sights.len() >= MIN_FOUND
            && sights.len() as f64 >= MIN_FOUND_SHARE * visible.len() as f64
            && shown >= MIN_CELLS
            && shown as f64 >= MIN_CELL_SHARE * populated as f64;
        enough.then_some(sights)
    }

    /// Looks for a point of the old one in the new one, around `at`.
    fn find(
        &self,
        (track, landmark, shown): &Known<'_>,
        at: [f64; 2],
        pose: &Pose<f64>,
    ) -> Option<(usize, Observation)> {
        let (new, scale) = (self.new, self.new.scale);
        let rows = rows_moved(self.scene, new.frame, at);
        let centre = std::array::from_fn(|i| ((at[i] + rows[i]) / scale) as f32);
        let matrix = seen_from(self.scene, landmark, &self.old_pose, pose)?;
        let in_old = shown.seen.map(|v| (v / self.old.scale) as f32);
        let anchor = Anchor::new(&self.old_pyramid, in_old)?;
        let found = anchor.find(&self.new_pyramid, Warp { matrix, centre }, 1)?;
        let moved = (found.warp.centre[0] - centre[0]).hypot(found.warp.centre[1] - centre[1]);
        let is_there = found.correlation > MIN_CORRELATION && moved < REACH;
        let at = found.warp.centre.map(|v| f64::from(v) * scale);
        let mut sight = Observation::new(new.frame, at, deviation(found.correlation) * scale);
        (0..2).for_each(|i| sight.at[i] -= rows[i]);
        is_there.then_some((*track, sight))
    }
}

/// The pose that most matches agree on.
fn by_samples(scene: &Scene, start: Pose<f64>, matches: &[Match<'_>]) -> Option<Pose<f64>> {
    if matches.len() < MIN_AGREEING {
        return None;
    }
    let camera = &scene.camera;
    let mut random = Random::new(matches.len() as u64);
    let mut best: Option<(f64, Pose<f64>)> = None;
    for _ in 0..HYPOTHESES {
        let sample: Vec<Match<'_>> =
            (0..SAMPLE).map(|_| matches[random.below(matches.len())]).collect();
        let pose = resect_exactly(camera, start, &sample);
        let off = |m: &Match<'_>| reprojection_error(camera, &pose, m).min(TRUNCATION).powi(2);
        let cost: f64 = matches.iter().map(off).sum();
        if pose.is_finite() && best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, pose));
        }
    }
    let pose = best?.1;
    let agrees = |m: &&Match<'_>| reprojection_error(camera, &pose, m) < TRUNCATION;
    let agreeing: Vec<Match<'_>> = matches.iter().filter(agrees).copied().collect();
    let enough =
        agreeing.len() >= MIN_AGREEING && agreeing.len() as f64 >= MIN_SHARE * matches.len() as f64;
    enough.then(|| resect(camera, pose, &agreeing, 1.0).map(|r| r.world_from_camera)).flatten()
}

/// By how much a rolling shutter moves what a frame shows near a place [px].
fn rows_moved(scene: &Scene, frame: usize, at: [f64; 2]) -> [f64; 2] {
    let far = |o: &Observation| (o.at[0] - at[0]).powi(2) + (o.at[1] - at[1]).powi(2);
    let near = scene.shown(frame).min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    near.map_or([0.0; 2], |(_, o)| [o.seen[0] - o.at[0], o.seen[1] - o.at[1]])
}

/// How the surroundings of a landmark in one camera, taken to face it, look in another one.
fn seen_from(
    scene: &Scene,
    landmark: &Landmark,
    old: &Pose<f64>,
    new: &Pose<f64>,
) -> Option<[[f32; 2]; 2]> {
    let camera = &scene.camera;
    let in_old = old.inverse() * landmark.position();
    let (u, v) = camera.project(in_old);
    let there = |du: f64, dv: f64| {
        let p = new.inverse() * (*old * camera.unproject(u + du, v + dv, in_old.z));
        (p.z > 1e-6 * in_old.z.abs()).then(|| camera.project(p))
    };
    let (centre, right, below) = (there(0.0, 0.0)?, there(1.0, 0.0)?, there(0.0, 1.0)?);
    let slope = |a: f64, b: f64| (a - b) as f32;
    Some([
        [slope(right.0, centre.0), slope(below.0, centre.0)],
        [slope(right.1, centre.1), slope(below.1, centre.1)],
    ])
}

/// The median of depths in the old part over those in the new one, of points that have both.
fn scale<'a>(
    scene: &Scene,
    frame: usize,
    pose: &Pose<f64>,
    matches: impl Iterator<Item = (usize, Match<'a>)>,
) -> Option<f64> {
    let own = scene.poses[frame]?;
    let ratio = |(track, m): (usize, Match<'a>)| {
        let here = (own.inverse() * scene.landmarks[track]?.position()).z;
        let there = (pose.inverse() * m.0.position()).z;
        let agrees = reprojection_error(&scene.camera, pose, &m) < TRUNCATION;
        (agrees && here > 0.0 && there > 0.0).then_some(there / here)
    };
    let mut ratios: Vec<f64> = matches.filter_map(ratio).collect();
    if ratios.len() < MIN_DEPTHS { None } else { median(&mut ratios) }
}
