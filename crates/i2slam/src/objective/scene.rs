//! What frames are formed from: any map that can be drawn from a pose and differentiated.

use i2slam_geometry::Tangent;
use i2slam_radiance::gaussian::{
    GaussianMap, MapGradient, MotionGradient, RasterSettings, Rasterizer, ShutterMotion,
};
use i2slam_radiance::hashgrid::{FieldGradient, FieldRenderer, HashGridMap};
use i2slam_radiance::{Render, RenderCotangent, View};

/// A radiance map as a frame's objective needs it. One exposure draws several views, each with a
/// renderer of its own, and pulls back through all of them.
pub trait SceneMap {
    /// What a renderer has to know beside the map.
    type Settings: Clone;
    /// Draws a view, and keeps what the way back needs.
    type Renderer;
    /// Derivatives by the parameters of the map.
    type Gradient;

    /// Whether the elements of the map have pixel velocities of their own.
    const MOVES: bool;

    /// A renderer that has drawn nothing yet.
    fn renderer(settings: &Self::Settings) -> Self::Renderer;

    /// Write what `view` shows into `out`, whose allocation is reused.
    fn render(&self, renderer: &mut Self::Renderer, view: &View<f32>, out: &mut Render);

    /// Pull `∂L/∂render` of the last [`render`](Self::render), which must have been of this view,
    /// back: adds `∂L/∂map` to `gradient` when it is given, and returns `∂L/∂ξ` for the pose
    /// `world_from_camera.retract(ξ)`.
    fn pull_back(
        &self,
        renderer: &mut Self::Renderer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut Self::Gradient>,
    ) -> Tangent<f64>;

    /// Write the average of what `view` shows while the camera moves (see
    /// [`Rasterizer::render_moving`]), of the wanted tiles and of what another renderer showed of
    /// the map last (see [`Rasterizer::render_moving_shown_by`]), or of all. Exposures never ask
    /// this of a map that does not [move](Self::MOVES), which shows the view as it stands still.
    fn render_moving(
        &self,
        renderer: &mut Self::Renderer,
        view: &View<f32>,
        _motion: &ShutterMotion,
        _wanted: Option<(&[bool], &Self::Renderer)>,
        out: &mut Render,
    ) {
        self.render(renderer, view, out);
    }

    /// Pull back through the last [`render_moving`](Self::render_moving).
    fn pull_back_moving(
        &self,
        renderer: &mut Self::Renderer,
        view: &View<f32>,
        _motion: &ShutterMotion,
        cotangent: &RenderCotangent,
        gradient: Option<&mut Self::Gradient>,
    ) -> MotionGradient {
        let pose = self.pull_back(renderer, view, cotangent, gradient);
        MotionGradient { pose, velocity: Tangent::zero(), readout: 0.0 }
    }
}

impl SceneMap for GaussianMap {
    type Settings = RasterSettings;
    type Renderer = Rasterizer;
    type Gradient = MapGradient;

    const MOVES: bool = true;

    fn renderer(settings: &RasterSettings) -> Rasterizer {
        Rasterizer::new(*settings)
    }

    fn render(&self, renderer: &mut Rasterizer, view: &View<f32>, out: &mut Render) {
        renderer.render(self, view, out);
    }

    fn pull_back(
        &self,
        renderer: &mut Rasterizer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        renderer.pull_back(self, view, cotangent, gradient)
    }

    fn render_moving(
        &self,
        renderer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        wanted: Option<(&[bool], &Rasterizer)>,
        out: &mut Render,
    ) {
        match wanted {
            None => renderer.render_moving(self, view, motion, None, out),
            Some((wanted, other)) => {
                renderer.render_moving_shown_by(other, self, view, motion, wanted, out);
            }
        }
    }

    fn pull_back_moving(
        &self,
        renderer: &mut Rasterizer,
        view: &View<f32>,
        motion: &ShutterMotion,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> MotionGradient {
        renderer.pull_back_moving(self, view, motion, cotangent, gradient)
    }
}

impl SceneMap for HashGridMap {
    type Settings = i2slam_radiance::hashgrid::MarchSettings;
    type Renderer = FieldRenderer;
    type Gradient = FieldGradient;

    const MOVES: bool = false;

    fn renderer(settings: &Self::Settings) -> FieldRenderer {
        FieldRenderer::new(*settings)
    }

    fn render(&self, renderer: &mut FieldRenderer, view: &View<f32>, out: &mut Render) {
        renderer.render_view(&self.field, &self.occupancy, view, out);
    }

    fn pull_back(
        &self,
        renderer: &mut FieldRenderer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut FieldGradient>,
    ) -> Tangent<f64> {
        renderer.pull_back_view(&self.field, &self.occupancy, view, cotangent, gradient)
    }
}
