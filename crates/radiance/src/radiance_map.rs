//! The trait of all maps, with views, renders and their cotangents.

use crate::{MotionGradient, ShutterMotion};
use i2slam_geometry::{Camera, Image, Pose, Real, Tangent};

/// A camera and its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View<T> {
    /// The pinhole camera.
    pub camera: Camera<T>,
    /// Camera-to-world pose.
    pub world_from_camera: Pose<T>,
}

impl<T: Real> View<T> {
    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> View<U> {
        View { camera: self.camera.cast(), world_from_camera: self.world_from_camera.cast() }
    }
}

/// Rendered radiance, depth and opacity: the sums of equations 3 and 4 of the paper over the
/// contributions `i` in order of depth, with opacity `α_i` and `T_i = Π_{j<i} (1 - α_j)`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Render<T = f32> {
    /// Linear radiance `Σ c_i α_i T_i`, three planes R, G, B.
    pub radiance: Image<T>,
    /// `Σ z_i α_i T_i` \[m\], one plane. Not divided by the opacity.
    pub depth: Image<T>,
    /// `Σ α_i T_i` in `[0, 1]`, one plane.
    pub opacity: Image<T>,
}

impl<T: Real> Render<T> {
    /// A black picture of nothing.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            radiance: Image::new(width, height, 3),
            depth: Image::new(width, height, 1),
            opacity: Image::new(width, height, 1),
        }
    }

    /// Depth of the visible surface \[m\], `depth / opacity`; 0 under an opacity of `least`.
    pub fn surface(&self, least: T) -> Image<T> {
        let mut out = Image::default();
        self.write_surface(least, &mut out);
        out
    }

    /// [`surface`](Self::surface) into `out`, whose allocation is reused.
    pub fn write_surface(&self, least: T, out: &mut Image<T>) {
        out.reset(self.depth.width, self.depth.height, 1);
        let pixels = self.depth.data.iter().zip(&self.opacity.data);
        for (surface, (&depth, &opacity)) in out.data.iter_mut().zip(pixels) {
            *surface = if opacity >= least { depth / opacity } else { T::zero() };
        }
    }

    /// Brings the planes to the size of a view, keeping allocation and unspecified values.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        for (image, channels) in
            [(&mut self.radiance, 3), (&mut self.depth, 1), (&mut self.opacity, 1)]
        {
            (image.width, image.height, image.channels) = (width, height, channels);
            image.data.resize(width * height * channels, T::zero());
        }
    }
}

/// `∂L/∂` of each number of a [`Render`]. An image with no data stands for zeros.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderCotangent<T = f32> {
    /// `∂L/∂radiance`, three planes or none.
    pub radiance: Image<T>,
    /// `∂L/∂depth` (of the sum, not of depth over opacity), one plane or none.
    pub depth: Image<T>,
    /// `∂L/∂opacity`, one plane or none.
    pub opacity: Image<T>,
}

impl<T: Real> RenderCotangent<T> {
    /// `[r, g, b, depth, opacity]` at a pixel.
    pub(crate) fn at(&self, column: usize, row: usize) -> [T; 5] {
        let one = |image: &Image<T>, channel: usize| {
            if image.data.is_empty() { T::zero() } else { image.at(channel, column, row) }
        };
        [
            one(&self.radiance, 0),
            one(&self.radiance, 1),
            one(&self.radiance, 2),
            one(&self.depth, 0),
            one(&self.opacity, 0),
        ]
    }

    /// The planes `[r, g, b, depth, opacity]`, of the size of the view; `None` stands for zeros.
    pub(crate) fn planes(&self, width: usize, height: usize) -> [Option<&[T]>; 5] {
        let plane = |image: &'_ Image<T>, channels: usize| {
            let fits = (image.width, image.height, image.channels) == (width, height, channels);
            assert!(image.data.is_empty() || fits, "cotangent and view differ in size");
            !image.data.is_empty()
        };
        let colour = plane(&self.radiance, 3);
        let of = |present: bool, image, channel| present.then(|| Image::plane(image, channel));
        [
            of(colour, &self.radiance, 0),
            of(colour, &self.radiance, 1),
            of(colour, &self.radiance, 2),
            of(plane(&self.depth, 1), &self.depth, 0),
            of(plane(&self.opacity, 1), &self.opacity, 0),
        ]
    }
}

/// A map of linear radiance that can be rendered from any pose and differentiated.
///
/// Buffers of a render belong to a renderer: one exposure draws several views, each with a renderer
/// of its own, and pulls back through all of them.
pub trait RadianceMap {
    /// Settings of a renderer.
    type Settings: Clone;
    /// Draws a view, and keeps what `pull_back` needs.
    type Renderer;
    /// Derivatives by the parameters of the map.
    type Gradient;

    /// True if [`render_moving`](Self::render_moving) is implemented.
    const RENDERS_MOTION: bool;

    /// A renderer that has drawn nothing yet.
    fn renderer(settings: &Self::Settings) -> Self::Renderer;

    /// Writes what `view` shows into `out`, whose allocation is reused.
    fn render(&self, renderer: &mut Self::Renderer, view: &View<f32>, out: &mut Render);

    /// Pulls `∂L/∂render` back through the last [`render`](Self::render), which was of this view.
    /// Adds `∂L/∂map` to `gradient` if given; returns `∂L/∂ξ` for `world_from_camera.retract(ξ)`.
    fn pull_back(
        &self,
        renderer: &mut Self::Renderer,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut Self::Gradient>,
    ) -> Tangent<f64>;

    /// Writes the average over the moments of a camera in motion, at `view` at mid-exposure. A map
    /// that does not [render motion](Self::RENDERS_MOTION) draws the view at mid-exposure.
    ///
    /// `mask` marks the tiles to draw, of [`TILE`](crate::gaussian::TILE) pixels, row by row, partial
    /// ones at the right and lower edge included; the others are black. `None` draws all. With
    /// `still`, only elements that its last picture shows are drawn, which must be of this map and
    /// cover the marked tiles.
    ///
    /// # Panics
    /// If `mask` has another size than the picture has tiles, or `still` drew a map of another size.
    fn render_moving(
        &self,
        renderer: &mut Self::Renderer,
        view: &View<f32>,
        _motion: &ShutterMotion,
        _mask: Option<&[bool]>,
        _still: Option<&Self::Renderer>,
        out: &mut Render,
    ) {
        self.render(renderer, view, out);
    }

    /// Pulls back through the last [`render_moving`](Self::render_moving).
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
