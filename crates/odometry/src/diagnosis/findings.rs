//! Wrong input: all checks of a sequence, and what follows for the result.

use crate::diagnosis::frozen::{frozen_runs, runs};
use crate::diagnosis::motion::{Motion, length};
use crate::diagnosis::moving_object::moving_parts;
use crate::diagnosis::order::shuffled_ranges;
use crate::diagnosis::pictures::PictureChecks;
use crate::result::Reconstruction;
use crate::sfm_state::SfmState;
use crate::warning::Warning;

/// Runs of frozen frames that are told one by one; more are told together.
const MAX_LISTED_RUNS: usize = 3;

/// Wrong input that was found.
pub(crate) struct Findings {
    warnings: Vec<Warning>,
    frozen: Vec<[usize; 2]>,
}

/// Looks for wrong input in a finished reconstruction.
pub(crate) fn diagnose(state: &SfmState, pictures: &PictureChecks) -> Findings {
    let (motion, width) = (Motion::new(state), state.camera.width);
    let between = |from: usize, to: usize| motion.step(from, to).map(|step| length(&step));
    let frozen = frozen_runs(&pictures.is_repeat, width, between);
    let mut frames = state.posed_frames();
    frames.retain(|frame| !pictures.is_repeat[*frame]);
    let step = |from: usize, to: usize| motion.step(from, to).unwrap_or_default();
    let blank = runs(&pictures.is_blank).into_iter().map(|frames| Warning::BlankFrames { frames });
    // Photographs have no order that could be wrong.
    let shuffled = match state.photographs.is_some() {
        true => Vec::new(),
        false => shuffled_ranges(&frames, width, step),
    };
    let shuffled = shuffled.into_iter();
    let moving = moving_parts(state).into_iter();
    let warnings = blank
        .chain(frozen_warnings(&frozen))
        .chain(shuffled.map(|frames| Warning::ShuffledFrames { frames }))
        .chain(moving.map(|part| Warning::MovingObject { frames: part.frames, share: part.share }))
        .chain(pictures.depth_warnings(state.is_metric()))
        .collect();
    Findings { warnings, frozen }
}

fn frozen_warnings(frozen: &[[usize; 2]]) -> Vec<Warning> {
    let count = |runs: &[[usize; 2]]| runs.iter().map(|[first, last]| last + 1 - first).sum();
    let told = |runs: &[[usize; 2]]| Warning::FrozenFrames {
        frames: [runs[0][0], runs[runs.len() - 1][1]],
        count: count(runs),
    };
    let each = if frozen.len() > MAX_LISTED_RUNS { frozen.len() } else { 1 };
    frozen.chunks(each).map(told).collect()
}

impl Findings {
    /// The result with the warnings, and without poses of frozen frames: they show where the camera
    /// was before.
    pub(crate) fn applied_to(self, mut found: Reconstruction) -> Reconstruction {
        let is_frozen = |frame: usize| self.frozen.iter().any(|[a, b]| (*a..=*b).contains(&frame));
        found.keyframes.retain(|keyframe| !is_frozen(keyframe.index));
        let poses = found.poses.iter_mut().enumerate();
        poses.filter(|(frame, _)| is_frozen(*frame)).for_each(|(_, pose)| *pose = None);
        for (frame, deviation) in found.deviations.iter_mut().enumerate() {
            *deviation = deviation.filter(|_| !is_frozen(frame));
            let is_doubtful = self
                .warnings
                .iter()
                .filter_map(|w| w.frames())
                .any(|[a, b]| (a..=b).contains(&frame));
            if let Some(known) = deviation {
                known.converged &= !is_doubtful;
            }
        }
        // One cause is enough.
        let is_told = |[first, last]: [usize; 2]| {
            let blank = self.warnings.iter().filter(|w| matches!(w, Warning::BlankFrames { .. }));
            blank.filter_map(|w| w.frames()).any(|[a, b]| a <= first && last <= b)
        };
        found.warnings.retain(|warning| match warning {
            Warning::UntrackableFrames { frames } => !is_told(*frames),
            _ => true,
        });
        found.warnings.extend(self.warnings);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_short_freezes_are_told_together() {
        let run = |first: usize| [first, first];
        let few = frozen_warnings(&[[3, 5], run(9)]);
        assert_eq!(few[0], Warning::FrozenFrames { frames: [3, 5], count: 3 });
        assert!(few.len() == 2 && few[0].to_string().starts_with("frames 3 to 5 repeat"));
        let many: Vec<[usize; 2]> = (0..9).map(|i| run(5 * i)).collect();
        let told = frozen_warnings(&many);
        assert_eq!(told, [Warning::FrozenFrames { frames: [0, 40], count: 9 }]);
        assert!(told[0].to_string().starts_with("9 of the frames 0 to 40 repeat"), "{}", told[0]);
    }
}
