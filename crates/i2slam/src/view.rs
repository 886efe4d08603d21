//! Pictures of a reconstruction.

use crate::mapping::raster_settings;
use crate::objective::{
    BlurRoute, Exposure, FrameObjective, FrameVariables, Sampling, SceneMap, Tone,
};
use crate::reconstruction::{FrameEstimate, Map, Reconstruction};
use i2slam_formation::{ResponseCurve, ShutterPoses};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::Render;

/// Opacity below which a pixel has no depth.
const SOLID: f32 = 0.5;

/// Renders a reconstruction; owns the buffers.
pub struct Viewer<'a> {
    reconstruction: &'a Reconstruction,
    pub(crate) camera: Camera<f64>,
    scene: Box<dyn Scene + 'a>,
}

/// A map that can be looked at.
trait Scene {
    /// Whether its elements have pixel velocities.
    fn moves(&self) -> bool;
    fn render(&mut self, world_from_camera: Pose<f64>) -> &Render;
    fn predict(&mut self, variables: &FrameVariables<'_>) -> &Image<f32>;
}

impl<M: SceneMap> Scene for (&M, FrameObjective<M>) {
    fn moves(&self) -> bool {
        M::MOVES
    }

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
                Box::new((map, FrameObjective::new(own, raster_settings(&self.config))))
            }
            Map::HashGrid(map) => Box::new((map.as_ref(), FrameObjective::new(own, map.march))),
        };
        Viewer { reconstruction: self, camera, scene }
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
        let sampling = self.sampling(frame);
        let (shutter, readout) = (frame.shutter, frame.readout);
        self.form(frame, Exposure { shutter, sampling, readout, depth_pose: None })
    }

    /// Linear radiance seen from a world-from-camera pose (picture values with `tone` off).
    pub fn hdr(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.scene.render(world_from_camera).radiance.clone()
    }

    /// Depth seen from a world-from-camera pose [m]; 0 where the map is not opaque.
    pub fn depth(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.scene.render(world_from_camera).surface(SOLID)
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
        let route = BlurRoute::Exact.able(frame.readout, self.scene.moves());
        Sampling::by_route(route, formation, frame.blur_length, frame.readout)
    }

    fn sharp_from(&mut self, frame: &FrameEstimate, pose: Pose<f64>) -> Image<f32> {
        let (shutter, sampling) = (ShutterPoses::still(pose), Sampling::SHARP);
        self.form(frame, Exposure { shutter, sampling, readout: 0.0, depth_pose: None })
    }

    /// The picture of an exposure with the frame's tone.
    fn form(&mut self, frame: &FrameEstimate, exposure: Exposure) -> Image<f32> {
        let curve: Option<ResponseCurve<f32>> = self
            .reconstruction
            .config
            .formation
            .tone
            .then(|| self.reconstruction.responses[frame.response].curve());
        let tone = curve.as_ref().map(|curve| Tone { frame: frame.tone, curve });
        self.scene.predict(&FrameVariables { exposure, tone }).clone()
    }
}

#[cfg(test)]
mod tests;
