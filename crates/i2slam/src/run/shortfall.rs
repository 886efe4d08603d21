//! Shortfalls: reasons for which the result of a run is not what was asked for.

use super::{PoseSource, RunOptions, RunOutcome};
use crate::config::{MappingConfig, TrackingMethod};
use crate::reconstruction::FrameEstimate;

/// Part of the frames or photographs that has to be tracked, one in so many: a map of fewer lacks most of
/// what was filmed.
const TRACKED_ONE_IN: usize = 2;

/// A sentence if too few frames were tracked, and one if the map is empty.
pub(super) fn of_result(outcome: &RunOutcome, options: &RunOptions) -> Vec<String> {
    let frames = &outcome.reconstruction.frames;
    let keyframes_alone = matches!(options.poses, PoseSource::FrontEnd { .. })
        && options.config.tracking.method == TrackingMethod::Adam;
    let given = match outcome.complete && !keyframes_alone {
        true => outcome.frames_given,
        false => frames.len(),
    };
    let is_empty = outcome.reconstruction.map.is_empty();
    let empty = is_empty.then(|| "the map is empty: there is nothing to render".to_owned());
    too_few_tracked(outcome, given).into_iter().chain(empty).collect()
}

fn too_few_tracked(outcome: &RunOutcome, given: usize) -> Option<String> {
    let frames = &outcome.reconstruction.frames;
    let tracked = frames.iter().filter(|f| f.tracked).count();
    let given = (given, outcome.is_unordered);
    if !is_too_few(tracked, given.0) {
        return None;
    }
    let is_lost =
        |index: usize| frames.iter().any(|f: &FrameEstimate| f.index == index && !f.tracked);
    let mut warnings = outcome.warnings.iter();
    let cause = match warnings.find(|w| w.frame.is_some_and(is_lost)) {
        Some(warning) => format!(": {warning}"),
        None if outcome.frames_skipped > 0 => {
            format!(": {} could not be used", outcome.frames_skipped)
        }
        None => String::new(),
    };
    let found = if outcome.is_unordered { "placed" } else { "tracked" };
    Some(format!("{} {found}{cause}", of_frames(tracked, given)))
}

/// A sentence if visual odometry found poses of too few of the frames that were `given`: their number, and
/// true if they are photographs.
pub(super) fn of_path(posed: usize, given: (usize, bool)) -> Option<String> {
    let few = is_too_few(posed, given.0);
    few.then(|| format!("{} given a pose by visual odometry", of_frames(posed, given)))
}

/// A sentence if frames should have been held out, and none was; `count` are those that could be,
/// frames or keyframes by `item`.
pub(super) fn of_holding_out(
    mapping: &MappingConfig,
    (count, item): (usize, &str),
) -> Option<String> {
    let is_none = mapping.hold_out > 0
        && mapping.hold_out_frames.is_empty()
        && !(0..count).any(|number| mapping.holds_out(number, number));
    let plural = if count == 1 { "" } else { "s" };
    is_none.then(|| {
        format!(
            "no {item} was held out: mapping.hold_out = {} of {count} {item}{plural}",
            mapping.hold_out
        )
    })
}

/// A sentence if the readout of a rolling shutter was to be found, and no frame showed one.
pub(super) fn of_readout(is_missing: bool) -> Option<String> {
    is_missing.then(|| {
        "no readout of a rolling shutter was found: no frame shows it \
         (input.optimise_rolling_shutter)"
            .to_owned()
    })
}

fn is_too_few(found: usize, given: usize) -> bool {
    found * TRACKED_ONE_IN < given
}

fn of_frames(found: usize, (given, is_unordered): (usize, bool)) -> String {
    let noun = if is_unordered { "photograph" } else { "frame" };
    let verb = if given == 1 { " was" } else { "s were" };
    format!("{found} of {given} {noun}{verb}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::reconstruction::{Map, Reconstruction, UnitOfLength};
    use crate::warning::Warning;
    use i2slam_formation::{ShutterPoses, Vignetting};
    use i2slam_geometry::{Camera, Pose};

    /// A complete run on `tracked` frames and on frames that were not, with an empty map.
    fn outcome(tracked: usize, lost: usize) -> RunOutcome {
        let still = ShutterPoses::still(Pose::identity());
        let frame = |index: usize| FrameEstimate {
            tracked: index < tracked,
            ..FrameEstimate::at_pose(index, 0.0, still)
        };
        let camera = Camera { width: 8, height: 8, fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0 };
        RunOutcome {
            reconstruction: Reconstruction {
                config: Config::default(),
                camera,
                online_trajectory: Vec::new(),
                frames: (0..tracked + lost).map(frame).collect(),
                map: Map::default(),
                responses: Vec::new(),
                vignetting: Vignetting::default(),
                rolling_shutter_readout: 0.0,
                unit_of_length: UnitOfLength::Metre,
            },
            frames_given: tracked + lost,
            is_unordered: false,
            frames_skipped: 0,
            seconds: 0.0,
            complete: true,
            problem: None,
            shortfalls: Vec::new(),
            camera: None,
            camera_source: String::new(),
            undistorted: None,
            warnings: vec![
                Warning::of_frame(0, "it is blue"),
                Warning::of_frame(tracked, "it has no depth"),
            ],
        }
    }

    #[test]
    fn half_of_the_frames_have_to_be_tracked() {
        let options = RunOptions::with_depth();
        let empty = "the map is empty: there is nothing to render".to_owned();
        assert_eq!(of_result(&outcome(10, 10), &options), std::slice::from_ref(&empty));
        let few = "9 of 20 frames were tracked: frame 9: it has no depth".to_owned();
        assert_eq!(of_result(&outcome(9, 11), &options), [few, empty]);
        // Frames that were left out count as well, but not those that a cancelled run never saw.
        let unread = RunOutcome { frames_given: 40, frames_skipped: 37, ..outcome(3, 0) };
        let sentences = of_result(&unread, &options);
        assert_eq!(sentences[0], "3 of 40 frames were tracked: 37 could not be used");
        let cancelled = RunOutcome { complete: false, ..unread };
        assert_eq!(of_result(&cancelled, &options).len(), 1);
    }

    #[test]
    fn half_of_the_photographs_have_to_be_tracked() {
        let photographs =
            |tracked, lost| RunOutcome { is_unordered: true, ..outcome(tracked, lost) };
        let options = RunOptions::with_depth();
        assert_eq!(of_result(&photographs(3, 3), &options).len(), 1);
        let few = "2 of 6 photographs were placed: frame 2: it has no depth";
        assert_eq!(of_result(&photographs(2, 4), &options)[0], few);
        let mut named = photographs(2, 4);
        named.shortfalls = of_result(&named, &options);
        let named = named.with_frame_names(|index| format!("{index}, {index}.png"));
        let few = "2 of 6 photographs were placed: frame 2, 2.png: it has no depth";
        assert_eq!(named.shortfalls[0], few);
        assert_eq!(named.warnings[1].text, "frame 2, 2.png: it has no depth");
    }

    #[test]
    fn first_order_tracking_of_a_video_is_measured_by_its_keyframes() {
        let keyframes = || RunOutcome { frames_given: 90, ..outcome(8, 0) };
        let mut options = RunOptions::colour_alone();
        assert_eq!(of_result(&keyframes(), &options).len(), 2);
        options.config.tracking.method = TrackingMethod::Adam;
        assert_eq!(of_result(&keyframes(), &options).len(), 1);
        assert!(of_path(45, (90, false)).is_none());
        let words = "44 of 90 frames were given a pose by visual odometry";
        assert_eq!(of_path(44, (90, false)).as_deref(), Some(words));
    }

    #[test]
    fn frames_to_be_held_out_have_to_be_there() {
        let mut mapping = Config::default().mapping;
        assert_eq!(of_holding_out(&mapping, (3, "frame")), None);
        mapping.hold_out = 3;
        assert_eq!(of_holding_out(&mapping, (4, "frame")), None);
        let words = "no frame was held out: mapping.hold_out = 3 of 3 frames";
        assert_eq!(of_holding_out(&mapping, (3, "frame")).as_deref(), Some(words));
    }
}
