//! Renders of a reconstruction.

mod hole_filling;
mod light_meter;
mod pose_optimization;
mod restoration;

pub use light_meter::LightMeter;
pub use pose_optimization::OptimisedPose;

use crate::objective::{BlurMethod, Exposure, FrameObjective, FrameVariables, Sampling};
use crate::reconstruction::{FrameEstimate, Map, Reconstruction};
use i2slam_formation::{Formation, ResponseCurve};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::RadianceMap;
use i2slam_radiance::Render;
use i2slam_radiance::gaussian::RasterSettings;

/// Least opacity of a pixel that has depth.
const MIN_DEPTH_OPACITY: f32 = 0.5;

/// Renderer of a reconstruction, with its buffers.
pub struct Viewer<'a> {
    reconstruction: &'a Reconstruction,
    camera: Camera<f64>,
    map: Box<dyn RenderMap + 'a>,
    /// Last sharp render, its holes filled, and its pose: most pictures of a frame are made from one render.
    last_render: Option<(Pose<f64>, Render)>,
}

/// Rendering of a map of any kind.
trait RenderMap {
    fn render(&mut self, world_from_camera: Pose<f64>) -> &Render;
    fn predict(&mut self, variables: &FrameVariables<'_>) -> &Image<f32>;
}

impl<M: RadianceMap> RenderMap for (&M, FrameObjective<M>) {
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
        self.viewer_of(self.camera)
    }

    fn viewer_of(&self, camera: Camera<f64>) -> Viewer<'_> {
        let own = camera.cast();
        let renderer: Box<dyn RenderMap> = match &self.map {
            Map::Gaussians(map) => {
                Box::new((map, FrameObjective::new(own, RasterSettings::default())))
            }
            Map::HashGrid(map) => Box::new((map.as_ref(), FrameObjective::new(own, map.march))),
        };
        Viewer { reconstruction: self, camera, map: renderer, last_render: None }
    }
}

impl<'a> Viewer<'a> {
    /// A viewer with pictures of another size.
    fn resized(&self, (width, height): (usize, usize)) -> Viewer<'a> {
        self.reconstruction.viewer_of(self.camera.resized(width, height))
    }
}

impl Viewer<'_> {
    /// The frame without motion blur and vignetting, at mid-exposure and with the frame's exposure, white
    /// balance and response. Three planes, in `[0, 1]` apart from the leaky clip.
    pub fn sharp(&mut self, frame: &FrameEstimate) -> Image<f32> {
        self.sharp_from(frame, frame.middle())
    }

    /// The frame as predicted by image formation, with motion blur and vignetting.
    pub fn blurred(&mut self, frame: &FrameEstimate) -> Image<f32> {
        let (sampling, curve) = (self.sampling(frame), self.curve(frame));
        let (shutter, readout) = (frame.shutter, frame.readout);
        let exposure = Exposure { shutter, sampling, readout, depth_pose: None };
        let lens = &self.reconstruction.vignetting;
        let at_pixels = (!lens.is_none()).then(|| lens.at_pixels(&self.camera.cast()));
        let vignetting = at_pixels.as_deref();
        let tone = curve.as_ref().map(|curve| Formation { tone: frame.tone, curve, vignetting });
        self.map.predict(&FrameVariables { exposure, tone }).clone()
    }

    /// Linear radiance from a world-from-camera pose; picture values with `tone` off. Small holes of the
    /// map are filled, large ones have a soft border: [`opacity`](Self::opacity) tells.
    pub fn hdr(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.render(world_from_camera).radiance.clone()
    }

    /// Opacity of the map from a world-from-camera pose, in `[0, 1]`: 0 where nothing was ever seen.
    pub fn opacity(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.render(world_from_camera).opacity.clone()
    }

    /// Depth from a world-from-camera pose [m]; 0 where the map is not opaque.
    pub fn depth(&mut self, world_from_camera: Pose<f64>) -> Image<f32> {
        self.render(world_from_camera).surface(MIN_DEPTH_OPACITY)
    }

    /// The frame's sharp picture from another pose, clamped to `[0, 1]`.
    fn sharp_clamped(&mut self, frame: &FrameEstimate, pose: Pose<f64>) -> Image<f32> {
        let mut picture = self.sharp_from(frame, pose);
        picture.data.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        picture
    }

    /// Mean focal length of the renders [px].
    fn focal_length(&self) -> f64 {
        0.5 * (self.camera.fx + self.camera.fy)
    }

    /// Sampling of a frame's exposure: exact renders for a global shutter.
    fn sampling(&self, frame: &FrameEstimate) -> Sampling {
        let formation = &self.reconstruction.config.formation;
        let method = BlurMethod::Exact.supporting_readout(frame.readout);
        Sampling::with_method(method, formation, frame.blur_length, frame.readout)
    }

    fn render(&mut self, world_from_camera: Pose<f64>) -> &Render {
        let last = self.last_render.take().filter(|(from, _)| *from == world_from_camera);
        let render = last.unwrap_or_else(|| {
            let mut render = self.map.render(world_from_camera).clone();
            render.radiance = hole_filling::filled(&render);
            (world_from_camera, render)
        });
        &self.last_render.insert(render).1
    }

    fn sharp_from(&mut self, frame: &FrameEstimate, pose: Pose<f64>) -> Image<f32> {
        let radiance = self.hdr(pose);
        self.toned(&radiance, frame)
    }

    /// Response curve of a frame; `None` with `tone` off.
    fn curve(&self, frame: &FrameEstimate) -> Option<ResponseCurve<f32>> {
        let Reconstruction { config, responses, .. } = self.reconstruction;
        config.formation.tone.then(|| responses[frame.response].curve())
    }
}

#[cfg(test)]
mod tests {
    use super::pose_optimization::tests::room;
    use super::*;
    use i2slam_formation::ShutterPoses;
    use i2slam_geometry::Tangent;

    /// The world's camera, rotated by `angle` [rad] about y.
    fn rotated(angle: f64) -> Pose<f64> {
        Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, angle, 0.0]))
    }

    /// A frame that rotates by `angle` [rad] during its exposure.
    fn turning(room: &Reconstruction, angle: f64, readout: f64) -> FrameEstimate {
        FrameEstimate {
            shutter: ShutterPoses { start: rotated(-0.5 * angle), end: rotated(0.5 * angle) },
            blur_length: angle * room.camera.fx,
            readout,
            ..room.virtual_frame(0, Pose::identity())
        }
    }

    fn difference(a: &Image<f32>, b: &Image<f32>) -> f64 {
        let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
        let sum: f64 = a.data.iter().zip(&b.data).map(square).sum();
        (sum / a.data.len() as f64).sqrt()
    }

    #[test]
    fn readout_skews_a_frame_without_blur() {
        let room = room();
        let mut viewer = room.viewer();
        // 0.36 px during the exposure, 7.2 px from the first row to the last.
        let [still, rolled] = [0.0, 20.0].map(|readout| turning(&room, 0.004, readout));
        assert_eq!(viewer.sharp(&rolled), viewer.sharp(&still));
        let [global, skewed] = [&still, &rolled].map(|frame| viewer.blurred(frame));
        assert!(difference(&global, &skewed) > 0.02);
        let (row, height) = (6, room.camera.height);
        let turned = rotated(0.08 * ((row as f64 + 0.5) / height as f64 - 0.5));
        let then = viewer.sharp_clamped(&still, turned);
        let off = |picture: &Image<f32>| {
            let columns = 8..room.camera.width - 8;
            let error = |i| f64::from(picture.at(1, i, row) - then.at(1, i, row)).abs();
            columns.map(error).sum::<f64>()
        };
        assert!(off(&skewed) < 0.3 * off(&global), "{} {}", off(&skewed), off(&global));
    }

    #[test]
    fn a_blurred_picture_takes_no_more_renders_than_configured() {
        let room = room();
        let viewer = room.viewer();
        let most = room.config.formation.virtual_cameras;
        let sampling = |readout| viewer.sampling(&turning(&room, 0.2, readout));
        let (global, rolling) = (sampling(0.0), sampling(0.5));
        assert_eq!((global.method, global.virtual_cameras), (BlurMethod::Exact, most));
        assert_eq!(rolling.method, BlurMethod::Reprojected);
        assert!(Sampling::new(&room.config.formation, 18.0, 0.0).virtual_cameras > most);
    }

    #[test]
    fn cached_renders_equal_fresh_ones() {
        let room = room();
        let mut viewer = room.viewer();
        let frame = turning(&room, 0.0, 0.0);
        let sharp = viewer.sharp(&frame);
        // Without motion both pictures are the same, but for filled holes.
        let (blurred, opacity) = (viewer.blurred(&frame), viewer.opacity(frame.middle()));
        for (pixel, opacity) in opacity.data.iter().enumerate() {
            let error = (sharp.plane(1)[pixel] - blurred.plane(1)[pixel]).abs();
            assert!(error <= 2.0 * (1.0 - opacity) + 1e-5, "{error} at {opacity}");
        }
        let here = viewer.hdr(frame.middle());
        let away = rotated(0.1);
        assert!(difference(&here, &viewer.hdr(away)) > 0.01);
        assert_eq!(viewer.hdr(away), room.viewer().hdr(away));
        assert_eq!(viewer.depth(away), room.viewer().depth(away));
        assert_eq!(viewer.sharp_clamped(&frame, away), room.viewer().sharp_clamped(&frame, away));
        assert_eq!((viewer.sharp(&frame), viewer.hdr(frame.middle())), (sharp, here));
    }
}
