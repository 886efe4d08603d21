//! Pictures of a reconstruction.

mod pose_optimization;

pub use pose_optimization::OptimisedPose;

use crate::objective::{BlurRoute, Exposure, FrameObjective, FrameVariables, Sampling, Tone, form};
use crate::reconstruction::{FrameEstimate, Map, Reconstruction};
use i2slam_formation::ResponseCurve;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::RadianceMap;
use i2slam_radiance::Render;
use i2slam_radiance::gaussian::RasterSettings;

/// Opacity below which a pixel has no depth.
const MIN_SURFACE_OPACITY: f32 = 0.5;

/// Renders a reconstruction; owns the buffers.
pub struct Viewer<'a> {
    reconstruction: &'a Reconstruction,
    pub(crate) camera: Camera<f64>,
    scene: Box<dyn Scene + 'a>,
    /// What was looked at last without blur, and from where: most pictures of a frame are made of
    /// it.
    seen: Option<(Pose<f64>, Render)>,
}

/// A map that can be looked at.
trait Scene {
    fn render(&mut self, world_from_camera: Pose<f64>) -> &Render;
    fn predict(&mut self, variables: &FrameVariables<'_>) -> &Image<f32>;
}

impl<M: RadianceMap> Scene for (&M, FrameObjective<M>) {
    fn render(&mut self, world_from_camera: Pose<f64>) -> &Render {
        self.1.render(self.0, world_from_camera)
    }

    fn predict(&mut self, variables: &FrameVariables<'_>) -> &Image<f32> {
        self.1.predict(self.0, variables)
    }
}

impl Reconstruction {
    /// A viewer of this reconstruction.
    pub fn viewer(&self) -> Viewer<'_> {
        self.viewer_by(self.camera)
    }

    fn viewer_by(&self, camera: Camera<f64>) -> Viewer<'_> {
        let own = camera.cast();
        let scene: Box<dyn Scene> = match &self.map {
            Map::Gaussians(map) => {
                Box::new((map, FrameObjective::new(own, RasterSettings::default())))
            }
            Map::HashGrid(map) => Box::new((map.as_ref(), FrameObjective::new(own, map.march))),
        };
        Viewer { reconstruction: self, camera, scene, seen: None }
    }
}

impl<'a> Viewer<'a> {
    /// A viewer of the same with pictures of another size.
    pub(crate) fn resized(&self, (width, height): (usize, usize)) -> Viewer<'a> {
        self.reconstruction.viewer_by(self.camera.resized(width, height))
    }
}

impl Viewer<'_> {
    /// The frame without motion blur: seen from mid-exposure, formed with the frame's own
    /// exposure, white balance and response. Three planes, in `[0, 1]` but for the leaky clip.
    pub fn sharp(&mut self, frame: &FrameEstimate) -> Image<f32> {
        self.sharp_from(frame, frame.middle())
    }

    /// What formation predicts for the frame, motion blur included.
    pub fn blurred(&mut self, frame: &FrameEstimate) -> Image<f32> {
        let (sampling, curve) = (self.sampling(frame), self.curve(frame));
        let (shutter, readout) = (frame.shutter, frame.readout);
        let exposure = Exposure { shutter, sampling, readout, depth_pose: None };
        let tone = curve.as_ref().map(|curve| Tone { frame: frame.tone, curve });
        self.scene.predict(&FrameVariables { exposure, tone }).clone()
    }

    /// Linear radiance seen from a world-from-camera pose (picture values with `tone` off).
    pub fn hdr(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.look(world_from_camera).radiance.clone()
    }

    /// Depth seen from a world-from-camera pose [m]; 0 where the map is not opaque.
    pub fn depth(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.look(world_from_camera).surface(MIN_SURFACE_OPACITY)
    }

    /// The frame's sharp picture from another pose, cut to `[0, 1]`.
    pub(crate) fn seen_from(&mut self, frame: &FrameEstimate, pose: Pose<f64>) -> Image<f32> {
        let mut picture = self.sharp_from(frame, pose);
        picture.data.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        picture
    }

    /// Mean focal length of the renders [px].
    pub(crate) fn focal_length(&self) -> f64 {
        0.5 * (self.camera.fx + self.camera.fy)
    }

    /// How a frame is sampled by renders of their own where rows are read at once.
    fn sampling(&self, frame: &FrameEstimate) -> Sampling {
        let formation = &self.reconstruction.config.formation;
        let route = BlurRoute::Exact.with_readout(frame.readout);
        Sampling::by_route(route, formation, frame.blur_length, frame.readout)
    }

    /// The map as it is seen from a world-from-camera pose.
    fn look(&mut self, world_from_camera: Pose<f64>) -> &Render {
        let seen = self.seen.take().filter(|(from, _)| *from == world_from_camera);
        let seen = seen
            .unwrap_or_else(|| (world_from_camera, self.scene.render(world_from_camera).clone()));
        &self.seen.insert(seen).1
    }

    fn sharp_from(&mut self, frame: &FrameEstimate, pose: Pose<f64>) -> Image<f32> {
        let curve = self.curve(frame);
        let tone = curve.as_ref().map(|curve| Tone { frame: frame.tone, curve });
        let mut picture = Image::default();
        form(tone.as_ref(), &self.look(pose).radiance, &mut picture);
        picture
    }

    /// The response that a frame's picture was bent by; none without tone.
    fn curve(&self, frame: &FrameEstimate) -> Option<ResponseCurve<f32>> {
        let Reconstruction { config, responses, .. } = self.reconstruction;
        config.formation.tone.then(|| responses[frame.response].curve())
    }
}

#[cfg(test)]
mod tests;
