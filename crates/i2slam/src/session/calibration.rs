//! What comparisons of keyframes find: response, vignetting, white balance, motion during exposures.

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
