//! Maps fitted to recorded frames, and pictures of them.

use i2slam::dataset::{Frame, OpenOptions, Sequence};
use i2slam::formation::{Formation, ShutterPoses};
use i2slam::geometry::{Image, Pose};
use i2slam::objective::{
    BlurMethod, Exposure, FrameObjective, FrameVariables, Sampling, blur_length,
};
use i2slam::radiance::gaussian::{GaussianMap, RasterSettings};
use i2slam::{Config, FrameEstimate, Map, Reconstruction, Session};
use std::error::Error;
use std::path::Path;

/// A reconstruction and what draws it.
pub(crate) struct Fitted {
    pub(crate) scene: Reconstruction,
    pub(crate) frames: Vec<Frame>,
    pub(crate) map: GaussianMap,
    pub(crate) objective: FrameObjective<GaussianMap>,
}

impl Fitted {
    /// The default preset on half of the demo clip.
    pub(crate) fn demo() -> Result<Self, Box<dyn Error>> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../cli/assets/demo"));
        let config = Config::default();
        let options =
            OpenOptions { minimum_gap: config.input.minimum_gap, ..OpenOptions::default() };
        let sequence = Sequence::open(folder, &options)?;
        let frames = sequence.stream().take(30).collect::<Result<Vec<_>, _>>()?;
        let mut session = Session::tracking(config, sequence.camera, sequence.frame_rate);
        for frame in &frames {
            session.track(frame)?;
        }
        session.finish(&mut |_, _| true);
        let scene = session.reconstruction();
        let settings = RasterSettings::default();
        let objective = FrameObjective::new(scene.camera.cast(), settings);
        let Map::Gaussians(map) = scene.map.clone() else { return Err("no Gaussians".into()) };
        Ok(Self { scene, frames, map, objective })
    }

    /// Depth seen from a pose [m], 0 where the map is not opaque.
    pub(crate) fn depth(&mut self, pose: Pose<f64>) -> Image<f32> {
        self.scene.viewer().depth(pose)
    }

    /// Sampling of a blur of `length` px by the default preset, by `method`.
    pub(crate) fn sampling(&self, length: f64, method: BlurMethod) -> Sampling {
        Sampling::with_method(method, &self.scene.config.formation, length, 0.0)
    }

    /// The picture of an exposure, with a frame's tone.
    pub(crate) fn predict(
        &mut self,
        frame: &FrameEstimate,
        shutter: ShutterPoses<f64>,
        sampling: Sampling,
    ) -> Image<f32> {
        let curve = self.scene.responses[frame.response].curve();
        let tone = Some(Formation { tone: frame.tone, curve: &curve, vignetting: None });
        let variables = FrameVariables {
            exposure: Exposure { shutter, sampling, readout: 0.0, depth_pose: None },
            tone,
        };
        self.objective.predict(&self.map, &variables).clone()
    }

    /// An exposure around `pose` whose motion along `direction` draws streaks of `length` px.
    pub(crate) fn exposure(
        &self,
        pose: Pose<f64>,
        depth: &Image<f32>,
        direction: [f64; 6],
        length: f64,
    ) -> ShutterPoses<f64> {
        let along = |scale: f64| {
            let half = i2slam::geometry::Tangent::from_array(direction).scaled(0.5 * scale);
            ShutterPoses { start: pose.retract(half.scaled(-1.0)), end: pose.retract(half) }
        };
        let mut scale = 1e-3;
        for _ in 0..3 {
            let drawn = blur_length(&self.scene.camera, &along(scale), depth);
            scale *= length / drawn.max(1e-9);
        }
        along(scale)
    }
}

/// PSNR [dB] of pictures in `[0, 1]`, all pixels and channels.
pub(crate) fn psnr(a: &Image<f32>, b: &Image<f32>) -> f64 {
    let square = |(a, b): (&f32, &f32)| f64::from(a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2);
    let sum: f64 = a.data.iter().zip(&b.data).map(square).sum();
    -10.0 * (sum / a.data.len() as f64).max(1e-12).log10()
}
