//! Objective of one frame: forms its picture from the map, compares, and differentiates.

use super::Observation;
use super::exposure::{Exposure, ExposureRenderer};
use super::losses::{ImageLoss, depth_error, depth_gradient, image_loss};
use super::ssim::Ssim;
use i2slam_formation::{CurveGradient, Formation, FrameToneGradient, ShutterTangent};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::RadianceMap;
use i2slam_radiance::Render;
use std::sync::Arc;

/// Variables of a frame that are optimised beside the map.
#[derive(Clone, Copy, Debug)]
pub struct FrameVariables<'a> {
    /// Motion while the shutter is open.
    pub exposure: Exposure,
    /// Exposure, white balance and response; `None` forms pictures without tone.
    pub tone: Option<Formation<'a>>,
}

impl<'a> FrameVariables<'a> {
    /// These with the vignetting of other pixels.
    pub(super) fn with_vignetting<'b>(&self, vignetting: Option<&'b [f32]>) -> FrameVariables<'b>
    where
        'a: 'b,
    {
        let tone = self.tone.map(|tone| Formation { vignetting, ..tone });
        FrameVariables { exposure: self.exposure, tone }
    }

    /// Pulls `d_picture` back through the tone: writes `d_hdr` and the derivatives by tone and
    /// response.
    pub(super) fn pull_back_tone(
        &self,
        hdr: &Image<f32>,
        d_picture: &Image<f32>,
        d_hdr: &mut Image<f32>,
        evaluation: &mut Evaluation,
    ) {
        let Some(formation) = &self.tone else {
            d_hdr.clone_from(d_picture);
            return;
        };
        let mut d_curve = CurveGradient::zero(formation.curve);
        formation.pull_back(hdr, d_picture, d_hdr, &mut evaluation.tone, &mut d_curve);
        evaluation.curve = Some(d_curve);
    }
}

/// Writes the picture formed from linear radiance; without tone, the radiance itself.
pub(crate) fn form_picture(
    tone: Option<&Formation<'_>>,
    hdr: &Image<f32>,
    picture: &mut Image<f32>,
) {
    match tone {
        Some(formation) => formation.form(hdr, picture),
        None => picture.clone_from(hdr),
    }
}

/// Value and derivatives of a frame's objective.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// The weighted sum of image and depth terms.
    pub total: f64,
    /// Mean absolute difference of the pictures over the compared pixels.
    pub image: f64,
    /// Mean absolute difference of depth over the compared pixels [m].
    pub depth: f64,
    /// Number of compared pixels.
    pub pixels: usize,
    /// Derivative by start and end pose.
    pub shutter: ShutterTangent<f64>,
    /// Derivative by the readout [per exposure]; 0 with [`BlurMethod::Exact`](super::BlurMethod).
    pub readout: f64,
    /// Derivative by exposure and white balance.
    pub tone: FrameToneGradient<f32>,
    /// Derivative by the nodes of the response curve, where there is one.
    pub curve: Option<CurveGradient<f32>>,
}

/// Renders, forms and compares frames; owns the buffers.
pub struct FrameObjective<M: RadianceMap> {
    renderer: ExposureRenderer<M>,
    picture: Image<f32>,
    d_picture: Image<f32>,
    d_hdr: Image<f32>,
    d_depth: Image<f32>,
    ssim: Ssim,
    mask: Vec<bool>,
    valid_mask: Option<Arc<Image<bool>>>,
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
            ssim: Ssim::default(),
            mask: Vec::new(),
            valid_mask: None,
        }
    }

    /// Restricts the image term to pixels that the camera recorded: undistortion leaves a border
    /// without.
    pub fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.valid_mask = Some(valid_mask);
    }

    /// Radiance, depth and opacity seen from one pose.
    pub fn render(&mut self, map: &M, pose: Pose<f64>) -> &Render {
        self.renderer.render(map, pose)
    }

    /// The picture predicted for a frame.
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
        depth_gradient(depths, observation, &self.mask, weights.1, &mut self.d_depth);
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
        (loss, depth_weight): (ImageLoss, f32),
        d_map: &mut M::Gradient,
    ) -> Evaluation {
        self.forward(map, variables);
        self.mask.clear();
        self.mask.extend(observation.depth.data.iter().map(|&d| d > 0.0));
        let pixels = self.mask.iter().filter(|&&m| m).count();
        let (best, depth_error) = self.best_depth(observation);
        self.fill_unrecorded(observation);
        let (image_total, image) = image_loss(
            &self.picture,
            &observation.colour,
            observation.ssim_reference(),
            loss,
            &mut self.ssim,
            &mut self.d_picture,
        );
        self.clear_unrecorded();
        let weight = depth_weight / pixels.max(1) as f32;
        let depths = self.renderer.depth(best);
        depth_gradient(depths, observation, &self.mask, weight, &mut self.d_depth);
        let mut evaluation = self.backward(map, variables, best, Some(d_map));
        evaluation.depth = depth_error / pixels.max(1) as f64;
        evaluation.total = image_total + f64::from(depth_weight) * evaluation.depth;
        evaluation.image = image;
        evaluation.pixels = pixels;
        evaluation
    }

    /// Sets pixels that the camera did not record to their observed values, so that they have no
    /// residual.
    fn fill_unrecorded(&mut self, observation: &Observation) {
        let Some(valid_mask) = &self.valid_mask else { return };
        for channel in 0..self.picture.channels {
            let observed = observation.colour.plane(channel);
            let picture = self.picture.plane_mut(channel).iter_mut().zip(observed);
            for ((p, &o), _) in picture.zip(&valid_mask.data).filter(|(_, c)| !**c) {
                *p = o;
            }
        }
    }

    /// Clears the gradient of pixels that the camera did not record.
    fn clear_unrecorded(&mut self) {
        let Some(valid_mask) = &self.valid_mask else { return };
        for channel in 0..self.d_picture.channels {
            let gradient = self.d_picture.plane_mut(channel).iter_mut();
            gradient.zip(&valid_mask.data).filter(|(_, c)| !**c).for_each(|(g, _)| *g = 0.0);
        }
    }

    /// Averages radiance over the exposure and forms the picture.
    fn forward(&mut self, map: &M, variables: &FrameVariables<'_>) {
        self.renderer.forward(map, &variables.exposure);
        form_picture(variables.tone.as_ref(), &self.renderer.hdr, &mut self.picture);
    }

    /// The render whose depth fits best over the mask, and its error (eq. 14).
    fn best_depth(&self, observation: &Observation) -> (usize, f64) {
        let error = |j: usize| {
            let depth = self.renderer.depth(j);
            (j, depth_error(depth, observation, &self.mask))
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

    /// Pulls `d_picture` and `d_depth` back to poses, tone and map.
    fn backward(
        &mut self,
        map: &M,
        variables: &FrameVariables<'_>,
        best: usize,
        d_map: Option<&mut M::Gradient>,
    ) -> Evaluation {
        let mut evaluation = Evaluation::default();
        let hdr = &self.renderer.hdr;
        variables.pull_back_tone(hdr, &self.d_picture, &mut self.d_hdr, &mut evaluation);
        let depth = (best, &mut self.d_depth);
        (evaluation.shutter, evaluation.readout) =
            self.renderer.backward(map, &variables.exposure, &self.d_hdr, depth, d_map);
        evaluation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objective::{BlurMethod, PixelLoss, Sampling};
    use i2slam_check::{central_differences, noise, relative_error};
    use i2slam_formation::{
        CameraResponse, FrameTone, NodeSpacing, Quadrature, ShutterPoses, StartCurve, Vignetting,
    };
    use i2slam_geometry::Tangent;
    use i2slam_radiance::View;
    use i2slam_radiance::gaussian::{
        ColourActivation, Gaussian, GaussianMap, MapGradient, RasterSettings, Rasterizer, Shape,
    };

    const LOSS: ImageLoss = ImageLoss { pixel: PixelLoss::Absolute, ssim_share: 0.2, weight: 0.5 };

    const CAMERA: Camera<f32> =
        Camera { width: 32, height: 24, fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };

    /// Broad, overlapping Gaussians, so that pictures are smooth, at depths so far apart that no
    /// rotation of the test changes their order.
    fn map() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
        let random = noise(5, 60 * 7);
        for (i, n) in random.chunks_exact(7).enumerate() {
            let n: Vec<f32> = n.iter().map(|&v| v as f32).collect();
            map.push(Gaussian {
                mean: [1.2 * n[0], 0.9 * n[1], 2.0 + 0.03 * i as f32],
                log_scale: [-1.6; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: n[3],
                colour: [-1.5 + 0.5 * n[4], -1.5 + 0.5 * n[5], -1.5 + 0.5 * n[6]],
            });
        }
        map
    }

    /// Far from every prediction, so that no difference changes its sign.
    fn observation() -> Observation {
        let (mut colour, mut depth) = (Image::new(32, 24, 3), Image::new(32, 24, 1));
        colour.data.fill(0.95);
        depth.data.fill(4.0);
        Observation::new(colour, depth)
    }

    fn smooth() -> RasterSettings {
        RasterSettings { alpha_min: 1e-7, transmittance_min: 0.0, ..RasterSettings::default() }
    }

    /// Start pose, end pose, log exposure and log white balance as one vector.
    fn evaluate(
        x: &[f64],
        (method, readout): (BlurMethod, f64),
        depth_pose: bool,
        mapping: bool,
    ) -> Evaluation {
        let curve =
            CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
        let lens = Vignetting { coefficients: [-0.3, -0.1, 0.0] }.at_pixels(&CAMERA);
        let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| x[from + i]));
        let base = ShutterPoses {
            start: Pose::identity(),
            end: Pose::identity()
                .retract(Tangent::from_array([0.02, -0.03, 0.01, 0.02, 0.03, -0.01])),
        };
        let shutter =
            ShutterPoses { start: base.start.retract(part(0)), end: base.end.retract(part(6)) };
        let tone = FrameTone {
            log_exposure: x[12] as f32,
            log_white_balance: [x[13] as f32, x[14] as f32, x[15] as f32],
        };
        let lead = Tangent::from_array([0.03, -0.02, 0.04, 0.05, -0.04, 0.03]);
        let variables = FrameVariables {
            exposure: Exposure {
                shutter,
                sampling: Sampling {
                    virtual_cameras: 3,
                    quadrature: Quadrature::Midpoints,
                    method,
                    margin: 4,
                },
                readout: readout + x.get(16).unwrap_or(&0.0),
                depth_pose: depth_pose.then(|| shutter.middle().retract(lead)),
            },
            tone: Some(Formation { tone, curve: &curve, vignetting: Some(&lens) }),
        };
        let mut objective = FrameObjective::new(CAMERA, smooth());
        let mut d_map = MapGradient::new(&map());
        if mapping {
            objective.map(&map(), &observation(), &variables, (LOSS, 1.0), &mut d_map)
        } else {
            objective.track(&map(), &observation(), &variables, 0.0, (0.5, 1.0))
        }
    }

    #[test]
    fn gradients_agree_with_differences_of_the_objective() {
        // Re-projection holds the depth that it looks up by fixed.
        let routes = [
            ((BlurMethod::Exact, 0.0), 5e-3),
            ((BlurMethod::Reprojected, 0.0), 0.1),
            ((BlurMethod::Reprojected, 0.8), 0.1),
        ];
        for (method, tolerance) in routes {
            for (depth_pose, mapping) in
                [(false, false), (true, false), (false, true), (true, true)]
            {
                check_gradient(method, tolerance, depth_pose, mapping);
            }
        }
    }

    fn check_gradient(method: (BlurMethod, f64), tolerance: f64, depth_pose: bool, mapping: bool) {
        let x = [0.0; 17];
        let evaluation = evaluate(&x, method, depth_pose, mapping);
        assert!(evaluation.pixels > 500);
        let mut analytic = evaluation.shutter.to_array().to_vec();
        analytic.extend(evaluation.tone.to_array().map(f64::from));
        analytic.push(evaluation.readout);
        let numeric =
            central_differences(&x, 2e-3, |x| evaluate(x, method, depth_pose, mapping).total);
        let groups = [0..3, 3..6, 6..9, 9..12, 12..16, 16..17];
        for group in groups.into_iter().take(if method.1 == 0.0 { 5 } else { 6 }) {
            let error = relative_error(&analytic[group.clone()], &numeric[group.clone()]);
            assert!(error < tolerance, "{method:?} {depth_pose} {mapping} {group:?} {error}");
        }
    }

    /// Re-projection is at the rows' times where the rasteriser of moving maps is.
    #[test]
    fn a_rolling_shutter_is_reprojected_as_it_is_rendered() {
        let curve =
            CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2)).curve();
        let shutter = ShutterPoses {
            start: Pose::identity(),
            end: Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.06, 0.08, -0.02])),
        };
        let mut objective = FrameObjective::new(CAMERA, smooth());
        let tone = Formation { tone: FrameTone::default(), curve: &curve, vignetting: None };
        let exposure = |method, readout| {
            let sampling = Sampling {
                virtual_cameras: 9,
                quadrature: Quadrature::Midpoints,
                method,
                margin: 8,
            };
            Exposure { shutter, sampling, readout, depth_pose: None }
        };
        let mut predict = |method, readout| {
            let variables =
                FrameVariables { exposure: exposure(method, readout), tone: Some(tone) };
            objective.predict(&map(), &variables).clone()
        };
        let error = |a: &Image<f32>, b: &Image<f32>| {
            let places = (0..24).flat_map(|row| (0..32).map(move |column| (row, column)));
            let square =
                |(row, column)| f64::from(a.at(1, column, row) - b.at(1, column, row)).powi(2);
            (places.map(square).sum::<f64>() / 768.0).sqrt()
        };
        let global = predict(BlurMethod::Exact, 0.0);
        let image = predict(BlurMethod::Reprojected, 1.0);
        assert_eq!(predict(BlurMethod::Exact, 1.0), image);
        let view = View { camera: CAMERA, world_from_camera: shutter.middle().cast() };
        let (mut moved, mut picture) = (Render::default(), Image::default());
        let motion = exposure(BlurMethod::Reprojected, 1.0).motion();
        let mut rasterizer = Rasterizer::new(smooth());
        map().render_moving(&mut rasterizer, &view, &motion, None, None, &mut moved);
        form_picture(Some(&tone), &moved.radiance, &mut picture);
        let (off, rolled) = (error(&picture, &image), error(&picture, &global));
        assert!(off < 0.2 * rolled, "rolling: {off} {rolled}");
    }

    #[test]
    fn unrecorded_pixels_do_not_count() {
        let valid_mask =
            Arc::new(Image { width: 32, height: 24, channels: 1, data: vec![false; 768] });
        let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Uniform).curve();
        let variables = FrameVariables {
            exposure: Exposure {
                shutter: ShutterPoses::still(Pose::identity()),
                sampling: Sampling::SINGLE_CAMERA,
                readout: 0.0,
                depth_pose: None,
            },
            tone: Some(Formation { tone: FrameTone::default(), curve: &curve, vignetting: None }),
        };
        let mut objective = FrameObjective::new(CAMERA, smooth());
        objective.set_valid_mask(valid_mask);
        let mut d_map = MapGradient::new(&map());
        objective.map(&map(), &observation(), &variables, (LOSS, 0.0), &mut d_map);
        assert!(d_map.colours.iter().flatten().all(|&g| g == 0.0));
    }
}
