//! Corrections of poses and depth after their frames were mapped, which the map follows.

use super::Session;
use super::posed::estimated_observation;
use super::state::SessionState;
use crate::keyframes::EstimatedDepth;
use i2slam_geometry::{Image, Pose};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

impl Session {
    /// Corrects poses `world_from_camera` at mid-exposure by the index of their frames, in the world
    /// that keyframes come in (that of the session where frames are tracked against the map), as an
    /// adjustment of all keyframes or the closing of a loop finds them.
    /// The motion during exposures stays; what a frame brought into a map of Gaussians moves with it,
    /// and overlaps are reconciled by the steps to come. The gauge stays: the world is where the camera
    /// of the first keyframe was when it came. Frames without a new pose, and poses that are not
    /// finite, stay.
    pub fn correct(&mut self, poses: &BTreeMap<usize, Pose<f64>>) {
        let mut motions = BTreeMap::new();
        for estimate in &mut self.state.frames {
            let Some(pose) = poses.get(&estimate.index).filter(|pose| pose.is_finite()) else {
                continue;
            };
            let mut now = *pose;
            if let Some(source) = &mut self.source {
                now = source.place_in_world(now);
                source.correct(estimate.index, now);
            }
            let was = estimate.middle();
            if was != now {
                estimate.shutter = estimate.shutter.with_middle(now);
                motions.insert(estimate.index, now * was.inverse());
            }
        }
        if !motions.is_empty() {
            let (mapper, _, context) = self.mapping();
            mapper.correct(&context, &motions);
        }
    }

    /// Replaces the depth of a keyframe, as later ones find it. Gaussians that lie where it was
    /// `contradicted` \[depth, 0 elsewhere\] leave the map, which grows where they were seen. Does
    /// nothing for a frame that is no keyframe in the map.
    pub(super) fn revise_depth(
        &mut self,
        index: usize,
        depth: EstimatedDepth,
        contradicted: &Image<f32>,
    ) {
        let SessionState { frames, keyframes, scratch, .. } = &mut self.state;
        let keyframe = keyframes.iter_mut().find(|keyframe| frames[keyframe.frame].index == index);
        let Some(keyframe) = keyframe else { return };
        let colour = Arc::clone(&keyframe.observation.get().colour);
        keyframe.observation = scratch.insert(estimated_observation(colour, depth));
        let keyframe = keyframe.clone();
        let (mapper, _, mut context) = self.mapping();
        mapper.replace_surface(&mut context, &keyframe, contradicted);
    }

    /// Removes frames, by their index, and the Gaussians that they brought into the map.
    pub(super) fn forget(&mut self, frames: &BTreeSet<usize>) {
        self.mapper.forget(frames);
        let is_kept: Vec<bool> =
            self.state.frames.iter().map(|frame| !frames.contains(&frame.index)).collect();
        let keyframes = &mut self.state.keyframes;
        keyframes.retain(|keyframe| is_kept[keyframe.frame]);
        for keyframe in keyframes {
            keyframe.frame = is_kept[..keyframe.frame].iter().filter(|kept| **kept).count();
        }
        self.state.frames.retain(|frame| !frames.contains(&frame.index));
    }
}
