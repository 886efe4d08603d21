//! One frame through map and formation: forward, loss, and the way back.

use super::{Observation, depth, photometric::image_loss};
use i2slam_formation::{
    CurveGradient, Formation, FrameTone, FrameToneGradient, Quadrature, ResponseCurve,
    ShutterPoses, ShutterTangent, VirtualCamera, accumulate, scale_into,
};
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use i2slam_radiance::gaussian::{
    GaussianMap, MapGradient, RasterSettings, Rasterizer, Render, RenderCotangent, View,
};
use std::sync::Arc;

/// What of a frame is optimised, beside the map.
#[derive(Clone, Copy, Debug)]
pub struct FrameVariables<'a> {
    /// World-from-camera at shutter open and close.
    pub shutter: ShutterPoses<f64>,
    /// Exposure, white balance and response; `None` forms pictures without tone.
    pub tone: Option<Tone<'a>>,
    /// Virtual cameras over the exposure.
    pub virtual_cameras: usize,
    /// Where they lie within it.
    pub quadrature: Quadrature,
    /// Where the camera was when the depth picture was taken, if that is known; otherwise depth
    /// is compared at the virtual camera that fits best (eq. 14).
    pub depth_pose: Option<Pose<f64>>,
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
    fn form(&self, hdr: &Image<f32>, picture: &mut Image<f32>) {
        match &self.tone {
            Some(tone) => Formation::new(&tone.frame, tone.curve).form(hdr, picture),
            None => Formation::identity().form(hdr, picture),
        }
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
    /// By exposure and white balance.
    pub tone: FrameToneGradient<f32>,
    /// By the nodes of the response curve, where there is one.
    pub curve: Option<CurveGradient<f32>>,
}

/// Renders, forms and compares frames; owns every buffer that this takes.
pub struct FrameObjective {
    camera: Camera<f32>,
    settings: RasterSettings,
    rasterizers: Vec<Rasterizer>,
    renders: Vec<Render>,
    hdr: Image<f32>,
    picture: Image<f32>,
    d_picture: Image<f32>,
    d_hdr: Image<f32>,
    d_depth: Image<f32>,
    no_depth: Image<f32>,
    cotangent: RenderCotangent<f32>,
    mask: Vec<bool>,
    covered: Option<Arc<Image<bool>>>,
}

impl FrameObjective {
    /// An objective for pictures of `camera`.
    pub fn new(camera: Camera<f32>, settings: RasterSettings) -> Self {
        let zeros = Image::new(camera.width, camera.height, 1);
        Self {
            camera,
            settings,
            rasterizers: Vec::new(),
            renders: Vec::new(),
            hdr: Image::default(),
            picture: Image::default(),
            d_picture: Image::default(),
            d_hdr: Image::default(),
            d_depth: Image::default(),
            no_depth: zeros.clone(),
            cotangent: RenderCotangent {
                radiance: Image::default(),
                depth: zeros.clone(),
                opacity: zeros,
            },
            mask: Vec::new(),
            covered: None,
        }
    }

    /// Restricts the image term to pixels that the camera recorded (undistortion leaves a border
    /// that it did not).
    pub fn set_covered(&mut self, covered: Arc<Image<bool>>) {
        self.covered = Some(covered);
    }

    /// The view of one pose.
    pub fn view(&self, pose: Pose<f64>) -> View<f32> {
        View { camera: self.camera, world_from_camera: pose.cast() }
    }

    /// Radiance, depth and opacity seen from one pose.
    pub fn render(&mut self, map: &GaussianMap, pose: Pose<f64>) -> &Render {
        self.reserve(1);
        let view = self.view(pose);
        self.rasterizers[0].render(map, &view, &mut self.renders[0]);
        &self.renders[0]
    }

    /// The picture that formation predicts for a frame.
    pub fn predict(&mut self, map: &GaussianMap, variables: &FrameVariables<'_>) -> &Image<f32> {
        self.forward(map, variables);
        &self.picture
    }

    /// SplaTAM's tracking objective through formation: sums over the pixels whose opacity at
    /// mid-exposure exceeds `silhouette` and that have a depth reading.
    pub fn track(
        &mut self,
        map: &GaussianMap,
        observation: &Observation,
        variables: &FrameVariables<'_>,
        silhouette: f32,
        weights: (f32, f32),
    ) -> Evaluation {
        let cameras = self.forward(map, variables);
        let middle = &self.renders[cameras.len() / 2];
        self.mask.clear();
        self.mask.extend(
            middle
                .opacity
                .data
                .iter()
                .zip(&observation.depth.data)
                .map(|(&opacity, &depth)| opacity > silhouette && depth > 0.0),
        );
        let pixels = self.mask.iter().filter(|&&m| m).count();
        let (best, depth_error) = self.best_depth(observation, variables, cameras.len());
        let image_error = self.masked_image_loss(observation, weights.0);
        let depths = &self.renders[best].depth;
        depth::gradient(depths, &observation.depth, &self.mask, weights.1, &mut self.d_depth);
        let mut evaluation = self.backward(map, variables, &cameras, best, None);
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
        map: &GaussianMap,
        observation: &Observation,
        variables: &FrameVariables<'_>,
        ssim_share: f32,
        weights: (f32, f32),
        d_map: &mut MapGradient,
    ) -> Evaluation {
        let cameras = self.forward(map, variables);
        self.mask.clear();
        self.mask.extend(observation.depth.data.iter().map(|&d| d > 0.0));
        let pixels = self.mask.iter().filter(|&&m| m).count();
        let (best, depth_error) = self.best_depth(observation, variables, cameras.len());
        self.believe_uncovered(observation);
        let (image_total, image) = image_loss(
            &self.picture,
            &observation.colour,
            observation.similarity(),
            ssim_share,
            weights.0,
            &mut self.d_picture,
        );
        self.silence_uncovered();
        let depth_weight = weights.1 / pixels.max(1) as f32;
        let depths = &self.renders[best].depth;
        depth::gradient(depths, &observation.depth, &self.mask, depth_weight, &mut self.d_depth);
        let mut evaluation = self.backward(map, variables, &cameras, best, Some(d_map));
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

    fn reserve(&mut self, count: usize) {
        while self.rasterizers.len() < count {
            self.rasterizers.push(Rasterizer::new(self.settings));
            self.renders.push(Render::default());
        }
    }

    /// Renders every virtual camera, averages and forms.
    fn forward(
        &mut self,
        map: &GaussianMap,
        variables: &FrameVariables<'_>,
    ) -> Vec<VirtualCamera<f64>> {
        let cameras =
            variables.shutter.virtual_cameras(variables.virtual_cameras, variables.quadrature);
        self.reserve(cameras.len());
        self.hdr.reset(self.camera.width, self.camera.height, 3);
        for (j, camera) in cameras.iter().enumerate() {
            let view = self.view(camera.world_from_camera);
            self.rasterizers[j].render(map, &view, &mut self.renders[j]);
            accumulate(&mut self.hdr, camera.weight as f32, &self.renders[j].radiance);
        }
        if let Some(pose) = variables.depth_pose {
            let j = cameras.len();
            self.reserve(j + 1);
            let view = self.view(pose);
            self.rasterizers[j].render(map, &view, &mut self.renders[j]);
        }
        variables.form(&self.hdr, &mut self.picture);
        cameras
    }

    /// The camera at which depth is compared, and its error over the mask: the depth picture's
    /// own, or the virtual camera with the smallest error (eq. 14).
    fn best_depth(
        &self,
        observation: &Observation,
        variables: &FrameVariables<'_>,
        cameras: usize,
    ) -> (usize, f64) {
        let choice = match variables.depth_pose {
            Some(_) => cameras..cameras + 1,
            None => 0..cameras,
        };
        choice
            .map(|j| {
                let depth = &self.renders[j].depth;
                (j, depth::absolute_error(depth, &observation.depth, &self.mask))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, 0.0))
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

    /// From `d_picture` and `d_depth` back to poses, tone and map. Blur is linear in the renders,
    /// so every virtual camera receives the same image cotangent, times its weight.
    fn backward(
        &mut self,
        map: &GaussianMap,
        variables: &FrameVariables<'_>,
        cameras: &[VirtualCamera<f64>],
        depth_camera: usize,
        mut d_map: Option<&mut MapGradient>,
    ) -> Evaluation {
        let mut evaluation = Evaluation::default();
        self.pull_back_tone(variables, &mut evaluation);
        for (j, camera) in cameras.iter().enumerate() {
            let view = self.view(camera.world_from_camera);
            scale_into(&self.d_hdr, camera.weight as f32, &mut self.cotangent.radiance);
            let depth = if j == depth_camera { &mut self.d_depth } else { &mut self.no_depth };
            std::mem::swap(&mut self.cotangent.depth, depth);
            let d_pose =
                self.rasterizers[j].pull_back(map, &view, &self.cotangent, d_map.as_deref_mut());
            let depth = if j == depth_camera { &mut self.d_depth } else { &mut self.no_depth };
            std::mem::swap(&mut self.cotangent.depth, depth);
            let d_shutter = variables.shutter.pull_back(camera.u, d_pose);
            evaluation.shutter = evaluation.shutter.plus(d_shutter);
        }
        if let Some(pose) = variables.depth_pose {
            let d_pose = self.pull_back_depth_camera(map, pose, cameras.len(), d_map);
            // The depth picture's pose moves with the middle of the exposure.
            let d_shutter = variables.shutter.pull_back(0.5, d_pose);
            evaluation.shutter = evaluation.shutter.plus(d_shutter);
        }
        evaluation
    }

    fn pull_back_depth_camera(
        &mut self,
        map: &GaussianMap,
        pose: Pose<f64>,
        index: usize,
        d_map: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        let view = self.view(pose);
        self.cotangent.radiance.reset(self.camera.width, self.camera.height, 3);
        std::mem::swap(&mut self.cotangent.depth, &mut self.d_depth);
        let d_pose = self.rasterizers[index].pull_back(map, &view, &self.cotangent, d_map);
        std::mem::swap(&mut self.cotangent.depth, &mut self.d_depth);
        d_pose
    }

    fn pull_back_tone(&mut self, variables: &FrameVariables<'_>, evaluation: &mut Evaluation) {
        let Some(tone) = &variables.tone else {
            self.d_hdr.clone_from(&self.d_picture);
            return;
        };
        let mut d_curve = CurveGradient::zero(tone.curve);
        Formation::new(&tone.frame, tone.curve).pull_back(
            &self.hdr,
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
