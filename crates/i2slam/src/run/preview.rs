//! A map while frames come, for those who follow the run. That of the result is made after the last
//! frame, with the final poses.

use super::RunOptions;
use super::camera::is_focal_length_changed;
use super::driver::new_session;
use super::input::KEYFRAMES;
use super::observer::{Observer, RunContext};
use crate::config::{HoldOut, MapKind, TrackingMethod};
use crate::session::OnlineMapping;
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::Camera;
use i2slam_odometry::{FrameUpdate, FrontEnd};
use std::sync::{Arc, Mutex};

/// Frames of a file that wait for the map at most.
const MAX_WAITING: usize = 8;

/// Maps frames beside a front end, which it never changes.
pub(super) struct MapPreview<'a> {
    sequence: &'a Sequence,
    options: &'a RunOptions,
    context: &'a RunContext,
    mapping: OnlineMapping,
    /// Of the pictures that are mapped.
    camera: Camera<f64>,
    /// Held while a frame is tracked.
    tracking: Arc<Mutex<()>>,
}

impl<'a> MapPreview<'a> {
    /// Of frames in the size and with the mask of `sequence`; none if nobody follows the map, if it is no
    /// map of Gaussians that a front end gives the poses of, or if these are known after the last frame
    /// alone, as with depth of a camera that is guessed.
    pub(super) fn start(
        (sequence, has_depth): (&'a Sequence, bool),
        options: &'a RunOptions,
        context: &'a RunContext,
    ) -> Option<Self> {
        Self::is_wanted((sequence, has_depth), options, context).then(|| {
            let (camera, tracking) = (sequence.camera, Arc::<Mutex<()>>::default());
            let mapping = mapping((sequence, camera), (options, context), &tracking);
            Self { sequence, options, context, mapping, camera, tracking }
        })
    }

    /// True if there is one.
    pub(super) fn is_wanted(
        (sequence, has_depth): (&Sequence, bool),
        options: &RunOptions,
        context: &RunContext,
    ) -> bool {
        let config = &options.config;
        let is_late = options.poses.uses_depth() && has_depth && sequence.camera_is_guess;
        context.observer.follows_map()
            && !is_late
            && config.tracking.method == TrackingMethod::SecondOrder
            && config.map.kind == MapKind::Gaussian
    }

    /// Lock that the map waits for between two steps.
    pub(super) fn tracking(&self) -> Arc<Mutex<()>> {
        Arc::clone(&self.tracking)
    }

    /// Takes the last frame of the front end, in the size that is mapped.
    pub(super) fn add(&mut self, front_end: &FrontEnd, update: &FrameUpdate, picture: Frame) {
        let camera = front_end.camera().resized(self.camera.width, self.camera.height);
        if is_focal_length_changed(self.camera.fx, camera.fx) {
            self.camera = camera;
            let anew =
                mapping((self.sequence, camera), (self.options, self.context), &self.tracking);
            let outdated = std::mem::replace(&mut self.mapping, anew);
            // Its thread ends after its present step, which may wait for the end of this call.
            std::thread::spawn(move || drop(outdated));
        }
        self.mapping.add_frame(front_end, update, picture);
    }

    /// [`add`](Self::add) of a frame of the sequence as it was tracked; waits while many wait for the
    /// map.
    pub(super) fn add_from_file(
        &mut self,
        front_end: &FrontEnd,
        update: &FrameUpdate,
        tracked: &Frame,
    ) {
        let is_one_size = tracked.colour.width == self.camera.width;
        let place = self.sequence.entries.iter().position(|entry| entry.index == tracked.index);
        let mapped = match (is_one_size, place) {
            (true, _) => Ok(tracked.clone()),
            (false, Some(place)) => self.sequence.load(place),
            (false, None) => return,
        };
        // One that cannot be read is told where the result is made.
        let Ok(mapped) = mapped else { return };
        self.add(front_end, update, mapped);
        self.mapping.wait_for_map(MAX_WAITING);
    }
}

/// A map without frames that shows itself to the observer.
fn mapping(
    (sequence, camera): (&Sequence, Camera<f64>),
    (options, context): (&RunOptions, &RunContext),
    tracking: &Arc<Mutex<()>>,
) -> OnlineMapping {
    let source = ((camera, sequence.frame_rate), sequence);
    let session = new_session(&KEYFRAMES, options, context, source);
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    let on_mapped = Box::new(move |_: &_, current: &dyn Fn() -> _| observer.map(current));
    let mut mapping = OnlineMapping::new(session, Arc::clone(tracking), on_mapped);
    // By colour alone keyframes alone are mapped, which the front end makes of frames that are not held out,
    // as far as it can.
    if !options.poses.uses_depth() {
        mapping.set_hold_out(HoldOut::default());
    }
    mapping
}
