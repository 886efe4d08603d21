//! One frame through map and formation: forward, loss, and the way back.

use super::exposure::{Exposure, ExposureRenderer};
use super::{
    Observation, depth,
    photometric::{Similarity, image_loss},
};
use i2slam_formation::{
    CurveGradient, Formation, FrameTone, FrameToneGradient, ResponseCurve, ShutterTangent,
};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::RadianceMap;
use i2slam_radiance::Render;
use std::sync::Arc;

/// What of a frame is optimised, beside the map.
#[derive(Clone, Copy, Debug)]
pub struct FrameVariables<'a> {
    /// How the camera moves while the shutter is open.
    pub exposure: Exposure,
    /// Exposure, white balance and response; `None` forms pictures without tone.
    pub tone: Option<Tone<'a>>,
}

/// The tone mapping of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Tone<'a> {
    /// Exposure and white balance.
    pub frame: FrameTone<f32>,
    /// Camera response.
    pub curve: &'a ResponseCurve<f32>,
}

impl FrameVariables<'_> {
    pub(super) fn form(&self, hdr: &Image<f32>, picture: &mut Image<f32>) {
        form(self.tone.as_ref(), hdr, picture);
    }
}

/// Writes the picture that linear radiance becomes.
pub(crate) fn form(tone: Option<&Tone<'_>>, hdr: &Image<f32>, picture: &mut Image<f32>) {
    match tone {
        Some(tone) => Formation::new(&tone.frame, tone.curve).form(hdr, picture),
        None => Formation::identity().form(hdr, picture),
    }
}

/// Value and derivatives of a frame's objective.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// The weighted sum of image and depth terms.
    pub total: f64,
    /// Mean absolute difference of the pictures over the pixels that count.
    pub image: f64,
    /// Mean absolute difference of depth over the pixels that count [m].
    pub depth: f64,
    /// Pixels that count.
    pub pixels: usize,
    /// By start and end pose.
    pub shutter: ShutterTangent<f64>,
    /// By the readout [per exposure]; 0 on a route that does not roll.
    pub readout: f64,
    /// By exposure and white balance.
    pub tone: FrameToneGradient<f32>,
    /// By the nodes of the response curve, where there is one.
    pub curve: Option<CurveGradient<f32>>,
}

/// Renders, forms and compares frames; owns every buffer that this takes.
pub struct FrameObjective<M: RadianceMap> {
    renderer: ExposureRenderer<M>,
    picture: Image<f32>,
    d_picture: Image<f32>,
    d_hdr: Image<f32>,
    d_depth: Image<f32>,
    similarity: Similarity,
    mask: Vec<bool>,
    covered: Option<Arc<Image<bool>>>,
}

impl<M: RadianceMap> FrameObjective<M> {
    /// An objective for pictures of `camera`.
    pub fn new(camera: Camera<f32>, settings: M::Settings) -> Self {
        Self {
            renderer: ExposureRenderer::new(camera, settings),
            picture: Image::default(),
            d_picture: Image::default(),
            d_hdr: Image::default(),
            d_depth: Image::default(),
            similarity: Similarity::default(),
            mask: Vec::new(),
            covered: None,
        }
    }

    /// Restricts the image term to pixels that the camera recorded (undistortion leaves a border
    /// that it did not).
    pub fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.covered = Some(covered);
    }

    /// Radiance, depth and opacity seen from one pose.
    pub fn render(&mut self, map: &M, pose: Pose<f64>) -> &Render {
        self.renderer.render(map, pose)
    }

    /// The picture that formation predicts for a frame.
    pub fn predict(&mut self, map: &M, variables: &FrameVariables<'_>) -> &Image<f32> {
        self.forward(map, variables);
        &self.picture
    }

    /// SplaTAM's tracking objective through formation: sums over the pixels whose opacity at
    /// mid-exposure exceeds `silhouette` and that have a depth reading.
    pub fn track(
        &mut self,
        map: &M,
        observation: &Observation,
        variables: &FrameVariables<'_>,
        silhouette: f32,
        weights: (f32, f32),
    ) -> Evaluation {
        self.forward(map, variables);
        let opacity = self.renderer.opacity().data.iter();
        let inside = |(&opacity, &depth): (&f32, &f32)| opacity > silhouette && depth > 0.0;
        self.mask.clear();
        self.mask.extend(opacity.zip(&observation.depth.data).map(inside));
        let pixels = self.mask.iter().filter(|&&m| m).count();
        let (best, depth_error) = self.best_depth(observation);
        let image_error = self.masked_image_loss(observation, weights.0);
        let depths = self.renderer.depth(best);
        depth::gradient(depths, observation, &self.mask, weights.1, &mut self.d_depth);
        let mut evaluation = self.backward(map, variables, best, None);
        evaluation.total = f64::from(weights.0) * image_error + f64::from(weights.1) * depth_error;
        evaluation.image = image_error / (3 * pixels).max(1) as f64;
        evaluation.depth = depth_error / pixels.max(1) as f64;
        evaluation.pixels = pixels;
        evaluation
    }

    /// SplaTAM's mapping objective through formation: means over the whole picture (image) and
    /// over the pixels with a depth reading (depth). Adds the map's derivative to `d_map`.
    pub fn map(
        &mut self,
        map: &M,
        observation: &Observation,
        variables: &FrameVariables<'_>,
        ssim_share: f32,
        weights: (f32, f32),
        d_map: &mut M::Gradient,
    ) -> Evaluation {
        self.forward(map, variables);
        self.mask.clear();
        self.mask.extend(observation.depth.data.iter().map(|&d| d > 0.0));
        let pixels = self.mask.iter().filter(|&&m| m).count();
        let (best, depth_error) = self.best_depth(observation);
        self.believe_uncovered(observation);
        let (image_total, image) = image_loss(
            &self.picture,
            &observation.colour,
            observation.similarity(),
            ssim_share,
            weights.0,
            &mut self.similarity,
            &mut self.d_picture,
        );
        self.silence_uncovered();
        let depth_weight = weights.1 / pixels.max(1) as f32;
        let depths = self.renderer.depth(best);
        depth::gradient(depths, observation, &self.mask, depth_weight, &mut self.d_depth);
        let mut evaluation = self.backward(map, variables, best, Some(d_map));
        evaluation.depth = depth_error / pixels.max(1) as f64;
        evaluation.total = image_total + f64::from(weights.1) * evaluation.depth;
        evaluation.image = image;
        evaluation.pixels = pixels;
        evaluation
    }

    /// Where the camera recorded nothing, the prediction is taken for the observation.
    fn believe_uncovered(&mut self, observation: &Observation) {
        let Some(covered) = &self.covered else { return };
        for channel in 0..self.picture.channels {
            let observed = observation.colour.plane(channel);
            let picture = self.picture.plane_mut(channel).iter_mut().zip(observed);
            for ((p, &o), _) in picture.zip(&covered.data).filter(|(_, c)| !**c) {
                *p = o;
            }
        }
    }

    fn silence_uncovered(&mut self) {
        let Some(covered) = &self.covered else { return };
        for channel in 0..self.d_picture.channels {
            let gradient = self.d_picture.plane_mut(channel).iter_mut();
            gradient.zip(&covered.data).filter(|(_, c)| !**c).for_each(|(g, _)| *g = 0.0);
        }
    }

    /// Averages radiance over the exposure and forms.
    fn forward(&mut self, map: &M, variables: &FrameVariables<'_>) {
        self.renderer.forward(map, &variables.exposure);
        variables.form(&self.renderer.hdr, &mut self.picture);
    }

    /// The render whose depth is compared, and its error over the mask (eq. 14).
    fn best_depth(&self, observation: &Observation) -> (usize, f64) {
        let error = |j: usize| {
            let depth = self.renderer.depth(j);
            (j, depth::absolute_error(depth, observation, &self.mask))
        };
        let best = self.renderer.depths().map(error).min_by(|a, b| a.1.total_cmp(&b.1));
        best.unwrap_or((0, 0.0))
    }

    /// `Σ |C - Ĉ|` over masked pixels and channels; writes `weight` times its derivative.
    fn masked_image_loss(&mut self, observation: &Observation, weight: f32) -> f64 {
        let picture = &self.picture;
        self.d_picture.reset(picture.width, picture.height, picture.channels);
        let pixels = picture.pixels();
        let mut sum = 0.0;
        for channel in 0..picture.channels {
            let planes = picture.plane(channel).iter().zip(observation.colour.plane(channel));
            let gradient = &mut self.d_picture.data[channel * pixels..(channel + 1) * pixels];
            for (((p, o), g), &inside) in planes.zip(gradient).zip(&self.mask) {
                let difference = p - o;
                if inside && difference != 0.0 {
                    sum += f64::from(difference.abs());
                    *g = weight.copysign(difference);
                }
            }
        }
        sum
    }

    /// From `d_picture` and `d_depth` back to poses, tone and map.
    fn backward(
        &mut self,
        map: &M,
        variables: &FrameVariables<'_>,
        best: usize,
        d_map: Option<&mut M::Gradient>,
    ) -> Evaluation {
        let mut evaluation = Evaluation::default();
        self.pull_back_tone(variables, &mut evaluation);
        let depth = (best, &mut self.d_depth);
        (evaluation.shutter, evaluation.readout) =
            self.renderer.backward(map, &variables.exposure, &self.d_hdr, depth, d_map);
        evaluation
    }

    fn pull_back_tone(&mut self, variables: &FrameVariables<'_>, evaluation: &mut Evaluation) {
        let Some(tone) = &variables.tone else {
            self.d_hdr.clone_from(&self.d_picture);
            return;
        };
        let mut d_curve = CurveGradient::zero(tone.curve);
        Formation::new(&tone.frame, tone.curve).pull_back(
            &self.renderer.hdr,
            &self.d_picture,
            &mut self.d_hdr,
            &mut evaluation.tone,
            &mut d_curve,
        );
        evaluation.curve = Some(d_curve);
    }
}

#[cfg(test)]
mod tests;
