//! Response, vignetting, white balance and motion during exposures, from comparisons of keyframes.

use super::Session;
use crate::mapping::{
    FoundTone, LensVignetting, Timing, compare_blurred_keyframes, compare_keyframes,
    find_exposure_motions, find_tone, finds_response,
};

impl Session {
    /// Finds response, vignetting and whether white balance is constant anew, from all keyframes.
    pub(super) fn calibrate_light(&mut self) {
        let has_vignetting = self.config.formation.vignetting && self.config.formation.tone;
        let has_response = finds_response(&self.config) && self.mapper.gaussians() > 0;
        if !(has_vignetting || has_response) {
            return;
        }
        let lens = self.state.lens_vignetting();
        let (mapper, _, mut context) = self.mapping();
        let compared = compare_keyframes(mapper, &context);
        let mut tone = FoundTone::default();
        if has_response {
            let blurred = compare_blurred_keyframes(mapper, &context);
            tone = find_tone(mapper, &mut context, (&compared, &blurred), lens);
        }
        let found = has_vignetting.then(|| LensVignetting::find(&context, &compared)).flatten();
        if let Some(found) = found {
            self.state.vignetting = found;
        }
        self.state.has_found_response |= tone.has_response;
        self.state.channel_powers = tone.channel_powers.unwrap_or(self.state.channel_powers);
        let was_constant = self.state.has_constant_white_balance;
        self.state.has_constant_white_balance = tone.has_constant_white_balance.or(was_constant);
    }

    /// Finds the motion during the exposures of keyframes anew, as far as their pictures tell it. That of
    /// photographs was found without a map.
    pub(super) fn find_motions(&mut self) {
        let is_stepped = self.config.parameters.frames.motion_rotation_rate > 0.0;
        let is_video = self.source.is_some() && !self.is_unordered;
        let is_comparable = finds_response(&self.config) && self.mapper.gaussians() > 0;
        if !(self.config.formation.blur && is_stepped && is_video && is_comparable) {
            return;
        }
        let lens = self.state.lens_vignetting();
        let timing = Timing { readout: self.tracker.readout.seconds, frame_rate: self.frame_rate };
        let (mapper, _, mut context) = self.mapping();
        for keyframe in find_exposure_motions(mapper, &mut context, lens, timing) {
            self.state.keyframes[keyframe].has_found_motion = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::posed_tests::{posed_on_path, unfinished};
    use super::*;
    use i2slam_formation::CentreVelocity;
    use i2slam_geometry::Tangent;

    /// Motions of all keyframes during their exposures.
    fn motions(session: &Session) -> Vec<Tangent<f64>> {
        session.frames().iter().map(|f| CentreVelocity::from(f.shutter).velocity).collect()
    }

    fn distance(a: Tangent<f64>, b: Tangent<f64>) -> f64 {
        a.plus(b.scaled(-1.0)).to_array().into_iter().map(f64::abs).fold(0.0, f64::max)
    }

    #[test]
    fn a_motion_that_was_found_is_neither_stepped_nor_aligned() {
        let mut session = unfinished(true, 0.0);
        session.state.keyframes[1].has_found_motion = true;
        session.state.frames[1].blur_length = 7.0;
        let before = motions(&session);
        let (mapper, tracker, mut context) = session.mapping();
        mapper.refine_all(&mut context, (0..12, 12), &mut |_| true);
        tracker.relocalize(mapper, &mut context);
        let after = motions(&session);
        let moved: Vec<bool> =
            before.iter().zip(&after).map(|(a, b)| distance(*a, *b) > 1e-9).collect();
        assert_eq!(moved[1..], [false, true, true]);
        assert_eq!(session.frames()[1].blur_length, 7.0);
        // A keyframe that is replaced has a motion of its own.
        session.add_keyframe(posed_on_path(2, true)).expect("a keyframe of that size");
        assert!(session.state.keyframes.iter().all(|keyframe| !keyframe.has_found_motion));
    }

    #[test]
    fn motions_are_not_sought_without_blur_or_of_photographs() {
        for is_unordered in [false, true] {
            let mut session = unfinished(true, 0.0);
            session.set_unordered(is_unordered);
            session.config.formation.blur = is_unordered;
            let before = motions(&session);
            session.find_motions();
            assert_eq!(motions(&session), before);
        }
    }
}
