//! Metering of views of a reconstruction, and the exposure controller of its camera.

use super::Viewer;
use crate::reconstruction::{FrameEstimate, Map, Reconstruction};
use i2slam_formation::{AutoExposureFit, ExposureFollower, ExposureSample, Metering};
use i2slam_geometry::Pose;

/// Longer side of the renders of Gaussians that are metered [px]: a smaller one smooths them, and its
/// median is nearer to the mean.
const GAUSSIANS_SIDE: usize = 320;
/// Longer side of the renders of a hash grid [px], whose rays are samples that nothing smooths.
const HASH_GRID_SIDE: usize = 80;

/// A light meter that looks at the map, in small renders.
pub struct LightMeter<'a> {
    reconstruction: &'a Reconstruction,
    viewer: Viewer<'a>,
    /// Typical white-balance gains.
    white_balance: [f32; 3],
}

impl Reconstruction {
    /// A light meter for this map, with the white balance that is typical of the run.
    pub fn light_meter(&self) -> LightMeter<'_> {
        let (width, height) = (self.camera.width, self.camera.height);
        let longer = width.max(height).max(1);
        let most = match self.map {
            Map::Gaussians(_) => GAUSSIANS_SIDE,
            Map::HashGrid(_) => HASH_GRID_SIDE,
        };
        let size = |side: usize| (side * most.min(longer)).div_ceil(longer).max(1);
        let viewer = self.viewer_of(self.camera.resized(size(width), size(height)));
        let tone = self.typical_tone().map(|(tone, _)| tone).unwrap_or_default();
        let white_balance = tone.log_white_balance.map(f32::exp);
        LightMeter { reconstruction: self, viewer, white_balance }
    }
}

impl LightMeter<'_> {
    /// Meters the view from a world-from-camera pose; `None` where the map shows nothing.
    pub fn read(&mut self, world_from_camera: Pose<f64>) -> Option<Metering> {
        let (radiance, opacity) =
            (self.viewer.hdr(world_from_camera), self.viewer.opacity(world_from_camera));
        Metering::of(&radiance, &opacity, self.white_balance)
    }

    /// Gives a frame the exposure of a camera that looks there next, by the frame's time stamp; that of the
    /// first is settled, as of a single view. Frames before the first that shows something keep their own.
    pub fn expose(&mut self, frame: &mut FrameEstimate, camera: &mut ExposureFollower) {
        let light = self.read(frame.middle());
        if let Some(log_exposure) = camera.next(frame.timestamp, light.as_ref()) {
            frame.tone.log_exposure = log_exposure as f32;
        }
    }

    /// Time, light and exposure of the frames that were tracked; none with `tone` off. `step` hears of
    /// each frame before it is metered (frames done, of how many) and may end it by an error.
    ///
    /// # Errors
    /// Those of `step`.
    pub fn samples<E>(
        &mut self,
        mut step: impl FnMut(usize, usize) -> Result<(), E>,
    ) -> Result<Vec<ExposureSample>, E> {
        let Reconstruction { config, frames, .. } = self.reconstruction;
        let has_tone = config.formation.tone;
        let frames: Vec<&FrameEstimate> = frames.iter().filter(|f| f.tracked && has_tone).collect();
        let sample = |(done, frame): (usize, &&FrameEstimate)| {
            step(done, frames.len())?;
            Ok(ExposureSample {
                time: frame.timestamp,
                metering: self.read(frame.middle()),
                log_exposure: f64::from(frame.tone.log_exposure),
            })
        };
        frames.iter().enumerate().map(sample).collect()
    }

    /// The exposure controller that explains the exposures of the frames that were tracked by what the map
    /// shows there; `None` for a few frames, or with `tone` off. `step` as in [`samples`](Self::samples).
    ///
    /// # Errors
    /// Those of `step`.
    pub fn fit<E>(
        &mut self,
        step: impl FnMut(usize, usize) -> Result<(), E>,
    ) -> Result<Option<AutoExposureFit>, E> {
        Ok(AutoExposureFit::new(&self.samples(step)?))
    }
}

#[cfg(test)]
mod tests {
    use super::super::pose_optimization::tests::room;
    use super::*;
    use i2slam_formation::{AutoExposure, Meter};
    use i2slam_geometry::Tangent;
    use std::convert::Infallible;
    use std::f64::consts::LN_2;

    fn turned(angle: f64) -> Pose<f64> {
        Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, angle, 0.0]))
    }

    /// A room that is four stops brighter on the right, and 60 frames of a camera that looks from one side to the
    /// other, more than twice, and follows the median at once.
    fn exposed_room() -> Reconstruction {
        let mut room = room();
        let Map::Gaussians(map) = &mut room.map else { panic!("a map of Gaussians") };
        for (mean, colour) in map.means.iter().zip(&mut map.colours) {
            colour.iter_mut().for_each(|c| *c += 1.4 * mean[0].signum());
        }
        let poses: Vec<_> = (0..60).map(|i| turned(0.3 * (f64::from(i) * 0.25).sin())).collect();
        let mut meter = room.light_meter();
        let lights: Vec<_> = poses.iter().map(|pose| meter.read(*pose).expect("a view")).collect();
        drop(meter);
        let frames = poses.iter().zip(lights).enumerate().map(|(i, (pose, light))| {
            let mut frame = room.virtual_frame(i, *pose);
            frame.timestamp = i as f64 / 30.0;
            frame.tone.log_exposure = -light.get(Meter::Median) as f32;
            frame
        });
        room.frames = frames.collect::<Vec<_>>();
        room
    }

    fn fit(room: &Reconstruction) -> Option<AutoExposureFit> {
        let Ok(fit) = room.light_meter().fit(|_, _| Ok::<(), Infallible>(()));
        fit
    }

    #[test]
    fn the_camera_of_a_run_is_found_and_exposes_views() {
        let mut room = exposed_room();
        // A frame that was lost tells nothing.
        (room.frames[20].tracked, room.frames[20].tone.log_exposure) = (false, 50.0);
        let found = fit(&room).and_then(|fit| fit.better_than_constant()).expect("a controller");
        assert_eq!(found.meter, Meter::Median);
        assert!(found.time_constant < 0.5 / 30.0, "{found:?}");
        assert!((found.slope + 1.0).abs() < 0.02, "{found:?}");
        let mut meter = room.light_meter();
        // Settled, views that the frames had are exposed as they were.
        for frame in [&room.frames[5], &room.frames[33]] {
            let mut view = room.virtual_frame(0, frame.middle());
            meter.expose(&mut view, &mut found.follow());
            assert!((view.tone.log_exposure - frame.tone.log_exposure).abs() < 0.05);
            assert_eq!(view.tone.log_white_balance, frame.tone.log_white_balance);
        }
    }

    #[test]
    fn exposure_follows_a_flight_without_a_jump() {
        let room = exposed_room();
        let found = fit(&room).expect("enough frames").controller;
        let largest_step = |time_constant: f64| {
            let (mut meter, camera) = (room.light_meter(), AutoExposure { time_constant, ..found });
            let mut camera = camera.follow();
            let exposures: Vec<f32> = (0..=60)
                .map(|i| {
                    let pose = turned(-0.25 + 0.5 * f64::from(i) / 60.0);
                    let mut frame = room.virtual_frame(i as usize, pose);
                    frame.timestamp = f64::from(i) / 30.0;
                    meter.expose(&mut frame, &mut camera);
                    frame.tone.log_exposure
                })
                .collect();
            assert!(exposures[0] - exposures[60] > 2.0 * LN_2 as f32, "{exposures:?}");
            exposures.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f32::max)
        };
        // The median goes from one side of the room to the other at once; the low pass does not.
        let (at_once, smooth) = (largest_step(0.0), largest_step(0.3));
        assert!(at_once > 0.4 && smooth < 0.4 * at_once, "{at_once} {smooth}");
    }

    #[test]
    fn a_view_of_nothing_keeps_its_exposure() {
        let room = exposed_room();
        let found = fit(&room).expect("enough frames").controller;
        let mut meter = room.light_meter();
        let mut away = room.virtual_frame(0, turned(3.0));
        let before = away.tone;
        meter.expose(&mut away, &mut found.follow());
        assert_eq!(away.tone, before);
    }

    #[test]
    fn a_run_without_tone_has_no_controller() {
        let mut room = exposed_room();
        assert!(fit(&room).is_some());
        room.config.formation.tone = false;
        assert_eq!(fit(&room), None);
        room.frames.clear();
        assert_eq!(fit(&room), None);
    }

    #[test]
    fn metering_ends_when_it_is_told_to() {
        let room = exposed_room();
        let ended = room.light_meter().fit(|done, _| if done == 3 { Err(done) } else { Ok(()) });
        assert_eq!(ended, Err(3));
    }

    #[test]
    fn large_pictures_are_metered_in_small_renders() {
        let mut room = room();
        let small = room.light_meter().read(Pose::identity()).expect("a view");
        room.camera = room.camera.resized(1920, 1440);
        let meter = room.light_meter();
        assert_eq!((meter.viewer.camera.width, meter.viewer.camera.height), (320, 240));
        let large = room.light_meter().read(Pose::identity()).expect("a view");
        for meter in Meter::ALL {
            assert!((small.get(meter) - large.get(meter)).abs() < 0.05, "{meter:?}");
        }
        assert_eq!(room.light_meter().read(turned(3.0)), None);
    }
}
