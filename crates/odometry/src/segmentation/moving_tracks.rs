//! Tracks of large moving objects, found before there is a map and left out of it.
//!
//! A map that is built with them bends to a compromise between two motions, in which neither is
//! an outlier. Between many pairs of pictures (see `relative_motion`) a point of an object deviates
//! from the motion of most of the picture again and again.

use crate::segmentation::picture_share::{moving_share, persistent_parts};
use crate::segmentation::relative_motion::{SharedPoint, deviating_points};
use crate::sfm_state::SfmState;
use crate::track::tracks::Track;
use i2slam_geometry::Image;
use rayon::prelude::*;
use std::sync::Arc;

/// Distances of the frames that are compared, and step between the first frames of pairs, counted in
/// frames with observations: those that repeat another have none.
const FRAME_GAPS: [usize; 3] = [2, 4, 8];
const STEP: usize = 2;
/// Ratio of a track's pairs in which it deviates from which on it may be of an object.
const MIN_DEVIATING_RATIO: f64 = 0.4;
/// Frames, or pairs of them, whose points are counted together.
const FRAMES_AT_ONCE: usize = 256;
/// Nearest points that decide about one: outliers are scattered, objects are not.
const NEIGHBOURS: usize = 5;
/// Blocks of a picture, across and down, of which each is as its nearest point.
const BLOCKS: [usize; 2] = [40, 30];

/// Moves the tracks of large moving objects from those of the map to
/// [`SfmState::moving_tracks`], and drops the depth of objects; returns whether there are any.
pub(crate) fn leave_out_moving_objects(state: &mut SfmState) -> bool {
    let observed: Vec<usize> =
        (0..state.tracks.frames).filter(|frame| !state.by_frame[*frame].is_empty()).collect();
    let is_moving = smoothed(state, &deviating_tracks(state, &observed));
    let share = |frame: usize| {
        let points = state.observations_in(frame).map(|(track, o)| (o.raw(), is_moving[track]));
        (frame, moving_share(&state.camera, points))
    };
    let parts = persistent_parts(&observed.into_iter().map(share).collect::<Vec<_>>());
    let is_inside = |track: &Track| {
        let inside =
            |frame: usize| parts.iter().any(|p| (p.frames[0]..=p.frames[1]).contains(&frame));
        track.observations.iter().any(|o| inside(o.frame))
    };
    let is_left_out: Vec<bool> = (state.tracks.tracks.iter().zip(&is_moving))
        .map(|(track, is_moving)| *is_moving && is_inside(track))
        .collect();
    if !is_left_out.contains(&true) {
        return false;
    }
    drop_depth(state, &is_left_out);
    let all = std::mem::take(&mut state.tracks.tracks).into_iter().zip(is_left_out);
    let (moving, rest): (Vec<_>, Vec<_>) = all.partition(|(_, is_left_out)| *is_left_out);
    let tracks = |part: Vec<(Track, bool)>| part.into_iter().map(|(track, _)| track).collect();
    state.moving_tracks = Arc::new(tracks(moving));
    state.tracks.tracks = tracks(rest);
    state.by_frame = Arc::new(state.tracks.tracks_by_frame());
    state.landmarks = vec![None; state.tracks.tracks.len()];
    true
}

/// Whether tracks deviate from the motion of most of the picture, in pairs of the `observed` frames;
/// `None` if they are in no pair.
fn deviating_tracks(state: &SfmState, observed: &[usize]) -> Vec<Option<bool>> {
    let of_gap = |gap: usize| observed.iter().zip(observed.iter().skip(gap)).step_by(STEP);
    let pairs: Vec<(usize, usize)> =
        FRAME_GAPS.into_iter().flat_map(of_gap).map(|(a, b)| (*a, *b)).collect();
    let votes = |(first, second): &(usize, usize)| -> Vec<(usize, bool)> {
        if state.progress.is_cancelled() {
            return Vec::new();
        }
        let both = |track: &usize| {
            let seen = &state.tracks.tracks[*track];
            Some((*track, (seen.observation_in(*first)?, seen.observation_in(*second)?)))
        };
        let (tracks, shared): (Vec<usize>, Vec<SharedPoint<'_>>) =
            state.by_frame[*first].iter().filter_map(both).unzip();
        let deviating = deviating_points(&state.camera, &shared);
        tracks.into_iter().zip(deviating).filter_map(|(track, d)| Some((track, d?))).collect()
    };
    let mut counts = vec![[0_u32; 2]; state.tracks.tracks.len()];
    for part in pairs.chunks(FRAMES_AT_ONCE) {
        let votes: Vec<Vec<(usize, bool)>> = part.par_iter().map(votes).collect();
        for (track, deviates) in votes.into_iter().flatten() {
            counts[track][0] += 1;
            counts[track][1] += u32::from(deviates);
        }
    }
    let decided = |[pairs, deviating]: &[u32; 2]| {
        (*pairs > 0).then(|| f64::from(*deviating) > MIN_DEVIATING_RATIO * f64::from(*pairs))
    };
    counts.iter().map(decided).collect()
}

/// Whether most points around a track, over all of its frames, are among those that deviate.
fn smoothed(state: &SfmState, deviates: &[Option<bool>]) -> Vec<bool> {
    let in_frame = |frame: usize| -> Vec<(usize, i32)> {
        let decided =
            state.observations_in(frame).filter_map(|(t, o)| Some((o.raw(), deviates[t]?)));
        let decided: Vec<([f64; 2], bool)> = decided.collect();
        let sum = |at: [f64; 2]| {
            let mut near: Vec<(f64, bool)> =
                decided.iter().map(|(other, d)| (square_distance(at, *other), *d)).collect();
            let count = NEIGHBOURS.min(near.len());
            if count < near.len() {
                near.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0));
            }
            near[..count].iter().map(|(_, d)| if *d { 1 } else { -1 }).sum()
        };
        state.observations_in(frame).map(|(track, o)| (track, sum(o.raw()))).collect()
    };
    let mut all = vec![0; deviates.len()];
    let frames: Vec<usize> = (0..state.tracks.frames).collect();
    for part in frames.chunks(FRAMES_AT_ONCE) {
        let sums: Vec<Vec<(usize, i32)>> = part.par_iter().copied().map(in_frame).collect();
        sums.into_iter().flatten().for_each(|(track, sum)| all[track] += sum);
    }
    all.into_iter().map(|sum| sum > 0).collect()
}

fn square_distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

/// Drops depth where the nearest point is of an object, in depth pictures and in readings.
fn drop_depth(state: &mut SfmState, is_left_out: &[bool]) {
    let blocks: Vec<Image<bool>> = (0..state.depth_maps.len())
        .into_par_iter()
        .map(|frame| moving_blocks(state, frame, is_left_out))
        .collect();
    let maps = Arc::make_mut(&mut state.depth_maps);
    for (map, blocks) in maps.iter_mut().zip(&blocks) {
        if let Some(map) = map.as_mut().filter(|_| blocks.data.contains(&true)) {
            map.clear(blocks);
        }
    }
    let [width, height] = [state.camera.width, state.camera.height].map(|side| side as f64);
    for o in state.tracks.tracks.iter_mut().flat_map(|track| &mut track.observations) {
        let Some(blocks) = blocks.get(o.frame) else { continue };
        let place = |at: f64, side: f64, count: usize| {
            ((at / side * count as f64).max(0.0) as usize).min(count - 1)
        };
        let (column, row) =
            (place(o.raw()[0], width, BLOCKS[0]), place(o.raw()[1], height, BLOCKS[1]));
        *o = o.with_depth(o.depth().filter(|_| !blocks.at(0, column, row)));
    }
}

/// Blocks of a picture whose nearest point is of an object, and those beside them.
fn moving_blocks(state: &SfmState, frame: usize, is_left_out: &[bool]) -> Image<bool> {
    let points: Vec<([f64; 2], bool)> =
        state.observations_in(frame).map(|(track, o)| (o.raw(), is_left_out[track])).collect();
    let camera = &state.camera;
    let nearest = |column: usize, row: usize| {
        let at = [
            (column as f64 + 0.5) / BLOCKS[0] as f64 * camera.width as f64,
            (row as f64 + 0.5) / BLOCKS[1] as f64 * camera.height as f64,
        ];
        let by_distance = |a: &&([f64; 2], bool), b: &&([f64; 2], bool)| {
            square_distance(a.0, at).total_cmp(&square_distance(b.0, at))
        };
        points.iter().min_by(by_distance).is_some_and(|(_, is_moving)| *is_moving)
    };
    let own = Image::from_fn(BLOCKS[0], BLOCKS[1], 1, |_, column, row| nearest(column, row));
    Image::from_fn(BLOCKS[0], BLOCKS[1], 1, |_, column, row| {
        let columns = column.saturating_sub(1)..(column + 2).min(BLOCKS[0]);
        let mut around = columns
            .flat_map(|c| (row.saturating_sub(1)..(row + 2).min(BLOCKS[1])).map(move |r| (c, r)));
        around.any(|(c, r)| own.at(0, c, r))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::depth_map::{DepthMap, DepthPicture};
    use crate::fixtures::{self, camera};
    use crate::track::tracks::{DepthReading, Observation};
    use i2slam_check::noise;
    use i2slam_geometry::{Pose, Rotation, Vec3};
    use i2slam_storage::ScratchStore;

    const FRAMES: usize = 26;
    /// Points of the object: a third of those in a picture.
    const OBJECT_POINTS: usize = 100;

    fn path(frame: usize) -> Pose<f64> {
        let s = frame as f64;
        let turn = Vec3::new(0.02 * (0.5 * s).sin(), 0.015 * s, 0.01 * (0.3 * s).cos());
        Pose::new(Rotation::exp(turn), Vec3::new(0.03 * s, 0.04 * (0.4 * s).sin(), 0.01 * s))
    }

    /// A point of the object in the camera of a frame: a bent patch over a fifth of the picture,
    /// which follows a path of its own.
    fn of_object(n: &[f64], frame: usize) -> Vec3<f64> {
        let s = frame as f64;
        let (u, v) = (120.0 + 4.0 * s + 62.0 * n[0], 120.0 + 40.0 * (0.3 * s).sin() + 62.0 * n[1]);
        camera().unproject(u, v, 0.9 + 0.1 * n[0] * n[0])
    }

    /// Tracks of the room, followed by those of the object, `with_depth` or not.
    fn state(has_object: bool, with_depth: bool) -> (SfmState, usize) {
        let inverse = |point: Vec3<f64>| {
            with_depth.then(|| DepthReading { inverse: point.z.recip(), sigma: 0.01 })
        };
        let observed = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(point);
            let at = [u + 0.2 * n[0], v + 0.2 * n[1]];
            let o = Observation::new(frame, at, 0.3).with_depth(inverse(point));
            camera().contains(at[0], at[1], 1.0).then_some(o)
        };
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            observed(path(frame).inverse() * point, frame, n).map(|o| o.at())
        };
        let mut state = fixtures::state((FRAMES, 24, 4), [155.0, 115.0], path, observe);
        for (track, landmark) in state.tracks.tracks.iter_mut().zip(&state.landmarks) {
            for o in &mut track.observations {
                let there = landmark.map(|known| path(o.frame).inverse() * known.position());
                *o = o.with_depth(there.and_then(inverse));
            }
        }
        let room = state.tracks.tracks.len();
        for i in 0..if has_object { OBJECT_POINTS } else { 0 } {
            let (n, errors) = (noise(7000 + i as u64, 2), noise(9000 + i as u64, 2 * FRAMES));
            let seen = |frame| observed(of_object(&n, frame), frame, &errors[2 * frame..]);
            let observations = (0..FRAMES).filter_map(seen).collect();
            state.tracks.tracks.push(Track { observations });
        }
        let near = Image { data: vec![1.0; 320 * 240], ..Image::new(320, 240, 1) };
        let map = DepthMap::new(
            &DepthPicture { depth: &near, timestamp: 0.0 },
            &ScratchStore::in_memory(),
        );
        let maps = if with_depth { vec![Some(map); FRAMES] } else { Vec::new() };
        state.depth_maps = Arc::new(maps);
        state.by_frame = Arc::new(state.tracks.tracks_by_frame());
        (state, room)
    }

    #[test]
    fn an_object_is_left_out_and_the_room_is_not() {
        for with_depth in [true, false] {
            let (mut state, room) = state(true, with_depth);
            assert!(leave_out_moving_objects(&mut state));
            let lost = room.saturating_sub(state.tracks.tracks.len());
            let found = state.moving_tracks.len() - lost;
            assert!(10 * found >= 9 * OBJECT_POINTS, "{found} of the object");
            // Points that the object is drawn over move beside it.
            assert!(10 * lost < room, "{lost} of {room}");
            assert_eq!(state.landmarks.len(), state.tracks.tracks.len());
            // Frames near the ends show less of the room than of the object.
            for map in state.depth_maps.iter().take(FRAMES - 8).skip(8).flatten() {
                let readings = map.readings();
                let depth = readings.depth();
                let share = depth.data.iter().filter(|z| **z == 0.0).count() as f64
                    / depth.data.len() as f64;
                assert!((0.15..0.45).contains(&share), "{share} of the depth is dropped");
            }
        }
    }

    /// Every second frame repeats the one before or behind, and has no observations.
    #[test]
    fn an_object_is_left_out_of_material_at_twice_its_rate() {
        for offset in [0, 1] {
            let (mut state, _) = state(true, false);
            for o in state.tracks.tracks.iter_mut().flat_map(|track| &mut track.observations) {
                o.frame = 2 * o.frame + offset;
            }
            state.tracks.frames = 2 * FRAMES;
            state.by_frame = Arc::new(state.tracks.tracks_by_frame());
            assert!(leave_out_moving_objects(&mut state), "observations at 2 i + {offset}");
            assert!(10 * state.moving_tracks.len() >= 9 * OBJECT_POINTS);
        }
    }

    #[test]
    fn nothing_is_left_out_of_a_room_alone() {
        for with_depth in [true, false] {
            let (mut state, room) = state(false, with_depth);
            assert!(!leave_out_moving_objects(&mut state));
            assert_eq!(state.tracks.tracks.len(), room);
            assert!(state.moving_tracks.is_empty());
        }
    }
}
