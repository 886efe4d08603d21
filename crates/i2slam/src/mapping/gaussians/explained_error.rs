//! Removal of Gaussians that explain too little of the pictures.
//!
//! A Gaussian of the opacity `α` at a pixel, behind the transmittance `T` and before what has the radiance `B`,
//! changes the pixel by `Δ = α T (c - B)`. This is a derivative of the render: by the logit `l` of the opacity
//! `o`, as `α` is proportional to `o`,
//!
//! ```text
//! Δ = ∂C/∂l / (1 - o),    S = Σ (Δ / σ)²
//! ```
//!
//! with the sum over pixels, channels and pictures, and a tolerance `σ` each; depth and opacity of a picture
//! count likewise. One backward pass for each picture estimates S: cotangents `s / σ` with independent random
//! signs `s` give a derivative whose square has the mean S (Hutchinson 1989). By Akaike's criterion (1974) the
//! `p` numbers of a Gaussian are worth it where S is above `2 p`. Of two Gaussians that cover the same, each
//! explains little while the other is there: of those below the limit half are removed in each of three passes.

use i2slam_compute::{Random, median};
use i2slam_formation::Formation;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::gaussian::{GaussianMap, MapGradient, RasterSettings, Rasterizer};
use i2slam_radiance::{RadianceMap, Render, RenderCotangent, View};

/// Frames between keyframes that are asked, too, for each keyframe: what they alone show must stay.
const FRAMES_PER_KEYFRAME: usize = 2;
/// Numbers of a Gaussian: centre, three deviations, rotation, opacity and colour.
const PARAMETERS: f32 = 14.0;
/// Explained error below which a Gaussian is not worth its numbers.
const LIMIT: f32 = 2.0 * PARAMETERS;
/// Of the Gaussians below the limit, those that are removed in a pass.
const REMOVED_SHARE: f64 = 0.5;
/// Passes, each with the estimate for what is left.
pub(super) const PRUNE_PASSES: usize = 3;
/// Tolerance of pictures, however badly they are predicted; white is 1.
const MAX_TOLERANCE: f32 = 0.05;
/// Tolerance of the depth of a surface, over the depth.
const DEPTH_TOLERANCE: f32 = 0.01;
/// Least slope of a picture by log radiance that counts: what one picture clips another may show.
const MIN_SLOPE: f32 = 0.05;
/// Seed of the random signs.
const SEED: u64 = 0x5167;

/// Of frames between keyframes those that are asked, evenly spread up to the last one.
pub(super) fn spread_frames<T>(frames: &[T], keyframes: usize) -> impl Iterator<Item = &T> {
    let count = frames.len().min(FRAMES_PER_KEYFRAME * keyframes);
    (1..=count).map(move |number| &frames[number * frames.len() / count - 1])
}

/// Errors of predicted pictures.
#[derive(Default)]
pub(super) struct PredictionError {
    /// Mean squared difference, of each picture.
    mean_squares: Vec<f32>,
}

impl PredictionError {
    /// Adds a picture; pixels outside of the mask do not count.
    pub(super) fn add(
        &mut self,
        prediction: &Image<f32>,
        picture: &Image<f32>,
        mask: Option<&Image<bool>>,
    ) {
        let is_valid = |pixel: usize| mask.is_none_or(|mask| mask.data[pixel]);
        let (mut squares, mut values) = (0.0, 0);
        let pairs = prediction.data.iter().zip(&picture.data).enumerate();
        for (_, (a, b)) in pairs.filter(|(value, _)| is_valid(value % picture.pixels())) {
            squares += f64::from(a - b).powi(2);
            values += 1;
        }
        self.mean_squares.push((squares / f64::from(values)) as f32);
    }

    /// Tolerance of pictures; white is 1. It is the root of the median over pictures, because one at a wrong
    /// pose is predicted as badly as can be; not a number without a picture.
    pub(super) fn tolerance(mut self) -> f32 {
        let deviation = median(&mut self.mean_squares).map_or(f32::NAN, f32::sqrt);
        deviation.clamp(0.0, MAX_TOLERANCE)
    }
}

/// Squared error over its variance that each Gaussian explains in a number of pictures.
pub(super) struct ExplainedError<'a> {
    map: &'a GaussianMap,
    /// Tolerance of pictures and of their opacity; white is 1.
    tolerance: f32,
    random: Random,
    rasterizer: Rasterizer,
    render: Render,
    gradient: MapGradient,
    sums: Vec<f32>,
}

impl<'a> ExplainedError<'a> {
    /// Before the first picture, with the tolerance of pictures.
    pub(super) fn new(map: &'a GaussianMap, tolerance: f32) -> Self {
        Self {
            map,
            tolerance,
            random: Random::new(SEED),
            // Where opacity is cut, no derivative by it is left.
            rasterizer: Rasterizer::new(RasterSettings { alpha_max: 1.0, ..Default::default() }),
            render: Render::default(),
            gradient: MapGradient::default(),
            sums: vec![0.0; map.len()],
        }
    }

    /// Takes the sharp picture of a camera into account, without the pixels outside of the mask.
    pub(super) fn add(
        &mut self,
        (camera, world_from_camera): (&Camera<f64>, Pose<f64>),
        tone: Option<&Formation<'_>>,
        mask: Option<&Image<bool>>,
    ) {
        let view = View { camera: camera.cast(), world_from_camera: world_from_camera.cast() };
        self.map.render(&mut self.rasterizer, &view, &mut self.render);
        let mut cotangent = self.cotangent(tone);
        if let Some(mask) = mask {
            let RenderCotangent { radiance, depth, opacity } = &mut cotangent;
            for image in [radiance, depth, opacity] {
                let pixels = image.data.iter_mut().zip(mask.data.iter().cycle());
                pixels.filter(|(_, is_valid)| !**is_valid).for_each(|(value, _)| *value = 0.0);
            }
        }
        self.gradient.reset(self.map);
        let gradient = Some(&mut self.gradient);
        self.map.pull_back(&mut self.rasterizer, &view, &cotangent, gradient);
        let found = self.gradient.opacity_logits.iter().zip(&self.map.opacity_logits);
        for (sum, (derivative, logit)) in self.sums.iter_mut().zip(found) {
            // 1 / (1 - o) = 1 + exp(l)
            *sum += (derivative * (1.0 + logit.exp())).powi(2);
        }
    }

    /// Random signs over the tolerances of picture, surface (`depth / opacity`) and opacity, by the numbers of
    /// the render.
    fn cotangent(&mut self, tone: Option<&Formation<'_>>) -> RenderCotangent {
        let Render { radiance, depth, opacity } = &self.render;
        let (width, height, pixels) = (depth.width, depth.height, depth.pixels());
        let signs = signs(&mut self.random, 5 * pixels);
        let image = |channels| Image::new(width, height, channels);
        let mut cotangent =
            RenderCotangent { radiance: image(3), depth: image(1), opacity: image(1) };
        for (i, (out, value)) in cotangent.radiance.data.iter_mut().zip(&radiance.data).enumerate()
        {
            let slope = tone.map_or(1.0, |tone| slope(tone, i / pixels, i % pixels, *value));
            *out = signs[i] * slope / self.tolerance;
        }
        for pixel in 0..pixels {
            let [of_surface, of_opacity] = [3, 4].map(|plane| signs[plane * pixels + pixel]);
            let covered = opacity.data[pixel].max(f32::MIN_POSITIVE);
            let share = of_surface / DEPTH_TOLERANCE;
            if depth.data[pixel] > 0.0 {
                cotangent.depth.data[pixel] = share / depth.data[pixel];
                cotangent.opacity.data[pixel] = -share / covered;
            }
            cotangent.opacity.data[pixel] += of_opacity / self.tolerance;
        }
        cotangent
    }

    /// False for half of the Gaussians that explain less than the limit, those that explain least.
    pub(super) fn keep(&self) -> Vec<bool> {
        let mut below = Vec::from_iter((0..self.sums.len()).filter(|&id| self.sums[id] < LIMIT));
        below.sort_by(|&a, &b| self.sums[a].total_cmp(&self.sums[b]));
        let mut keep = vec![true; self.sums.len()];
        let removed = (REMOVED_SHARE * below.len() as f64) as usize;
        below[..removed].iter().for_each(|&id| keep[id] = false);
        keep
    }
}

/// So many independent signs.
fn signs(random: &mut Random, count: usize) -> Vec<f32> {
    let words = std::iter::repeat_with(|| random.bits());
    let sign = |bits: u64, place: u32| if bits >> place & 1 == 0 { 1.0 } else { -1.0 };
    words.flat_map(|bits| (0..64).map(move |place| sign(bits, place))).take(count).collect()
}

/// Slope of the picture by radiance, at a pixel of a channel.
fn slope(tone: &Formation<'_>, channel: usize, pixel: usize, radiance: f32) -> f32 {
    let vignetting = tone.vignetting.map_or(1.0, |all| all[pixel]);
    let gain = tone.tone.gains()[channel] * vignetting;
    let value = gain * radiance;
    gain * tone.curve.slope(channel, value).max(MIN_SLOPE / value.max(MIN_SLOPE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_formation::{CameraResponse, FrameTone, NodeSpacing, StartCurve};
    use i2slam_geometry::Vec3;
    use i2slam_radiance::gaussian::{ColourActivation, Gaussian, Shape};

    const SIDE: usize = 32;

    fn ball(x: f32, z: f32, deviation: f32, opacity_logit: f32) -> Gaussian<f32> {
        Gaussian {
            mean: [x, 0.0, z],
            log_scale: [deviation.ln(); 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit,
            colour: [0.7, -0.3, 0.2],
        }
    }

    /// A screen at 4 m, a ball behind it, one beside it, one before it and a faint one before nothing.
    fn scene() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        map.push(ball(1.0, 4.0, 0.6, 9.0));
        map.push(ball(2.0, 8.0, 0.2, 9.0));
        map.push(ball(-1.5, 4.0, 0.25, 0.0));
        map.push(Gaussian { colour: [0.3, 0.0, 0.2], ..ball(0.9, 3.0, 0.1, -3.0) });
        map.push(ball(-0.5, 4.0, 0.01, -5.0));
        map
    }

    fn camera() -> Camera<f64> {
        let (focal, half) = (SIDE as f64, 0.5 * SIDE as f64);
        Camera { width: SIDE, height: SIDE, fx: focal, fy: focal, cx: half, cy: half }
    }

    fn at(x: f64) -> Pose<f64> {
        Pose { translation: Vec3::new(x, 0.0, 0.0), ..Pose::identity() }
    }

    /// The tolerance by constant errors of some predictions.
    fn tolerance(errors: &[f32]) -> f32 {
        let mut found = PredictionError::default();
        let picture = |value: f32| Image { data: vec![value; 12], ..Image::new(2, 2, 3) };
        errors.iter().for_each(|error| found.add(&picture(0.5 + error), &picture(0.5), None));
        found.tolerance()
    }

    fn kept(places: &[f64], tolerance: f32) -> Vec<bool> {
        let map = scene();
        let mut explained = ExplainedError::new(&map, tolerance);
        places.iter().for_each(|x| explained.add((&camera(), at(*x)), None, None));
        explained.keep()
    }

    fn render(map: &GaussianMap) -> Render {
        let settings = RasterSettings { alpha_max: 1.0, ..RasterSettings::default() };
        let view = View { camera: camera().cast(), world_from_camera: Pose::identity() };
        let mut render = Render::default();
        map.render(&mut Rasterizer::new(settings), &view, &mut render);
        render
    }

    /// Sum of squares of what the removal of a Gaussian changes, over the tolerances.
    fn squares_without(removed: usize, tolerance: f32) -> f32 {
        let mut map = scene();
        let before = render(&map);
        map.retain(&Vec::from_iter((0..map.len()).map(|id| id != removed)));
        let after = render(&map);
        let squares = |a: &Image<f32>, b: &Image<f32>, scale: f32| -> f32 {
            a.data.iter().zip(&b.data).map(|(a, b)| ((a - b) / scale).powi(2)).sum()
        };
        let surfaces = before.surface(0.0).data.into_iter().zip(after.surface(0.0).data);
        let both = surfaces.filter(|(a, b)| *a > 0.0 && *b > 0.0);
        squares(&before.radiance, &after.radiance, tolerance)
            + squares(&before.opacity, &after.opacity, tolerance)
            + both.map(|(a, b)| ((a - b) / (DEPTH_TOLERANCE * a)).powi(2)).sum::<f32>()
    }

    #[test]
    fn random_signs_estimate_what_a_removal_changes() {
        const PICTURES: usize = 400;
        let (map, tolerance) = (scene(), MAX_TOLERANCE);
        let mut explained = ExplainedError::new(&map, tolerance);
        (0..PICTURES).for_each(|_| explained.add((&camera(), at(0.0)), None, None));
        for gaussian in [2, 3] {
            let due = squares_without(gaussian, tolerance);
            // The mean of squares of normal variables has the deviation √(2/400) = 7 %.
            let ratio = explained.sums[gaussian] / PICTURES as f32 / due;
            assert!(due > 1.0 && (ratio - 1.0).abs() < 0.2, "{gaussian}: {ratio} of {due}");
        }
    }

    #[test]
    fn half_of_what_explains_too_little_is_removed() {
        // The ball behind the screen and the faint one explain next to nothing.
        let removed = kept(&[0.0], 0.03).iter().filter(|keep| !**keep).count();
        assert_eq!(removed, 1);
        assert!(kept(&[0.0], 0.03)[0] && kept(&[0.0], 0.03)[2]);
        // From the side the ball shows behind the screen.
        assert!(kept(&[0.0, 2.4], 0.03)[1]);
        // All stay where the error is unknown.
        assert_eq!(kept(&[0.0], tolerance(&[])), [true; 5]);
        assert_eq!(kept(&[0.0], tolerance(&[f32::NAN])), [true; 5]);
    }

    #[test]
    fn a_picture_at_a_wrong_pose_does_not_decide() {
        let found = tolerance(&[0.02, 0.4, 0.03, 0.4, 0.025]);
        assert!((found - 0.03).abs() < 1e-6, "{found}");
        assert_eq!(tolerance(&[0.4, 0.3, 0.02]), MAX_TOLERANCE);
    }

    #[test]
    fn opaque_gaussians_explain_their_pixels() {
        // Narrower than a pixel, and above the opacity at which pictures are cut.
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        map.push(ball(0.0625, 4.0, 0.001, 12.0));
        let mut explained = ExplainedError::new(&map, 0.03);
        explained.add((&camera(), at(0.0)), None, None);
        assert!(explained.sums[0] > LIMIT, "{:?}", explained.sums);
    }

    #[test]
    fn clipped_pictures_count_a_little() {
        let curve = CameraResponse::<f32>::new(3, StartCurve::Srgb, NodeSpacing::Uniform).curve();
        let of = |log_exposure: f32| {
            let tone = FrameTone { log_exposure, ..FrameTone::default() };
            slope(&Formation { tone, curve: &curve, vignetting: None }, 1, 0, 2.0) * 2.0
        };
        let [clipped, dark, shown] = [3.0, -9.0, -1.5].map(of);
        assert!(clipped >= MIN_SLOPE && clipped < 0.3 * shown, "{clipped} {shown}");
        assert!(dark > 0.0 && dark < shown, "{dark} {shown}");
    }

    #[test]
    fn pixels_outside_of_the_mask_do_not_count() {
        let mut found = PredictionError::default();
        let picture = Image::new(2, 1, 3);
        let prediction =
            Image { data: vec![0.01, 9.0, 0.01, 9.0, 0.01, 9.0], ..Image::new(2, 1, 3) };
        let mask = Image { data: vec![true, false], ..Image::new(2, 1, 1) };
        found.add(&prediction, &picture, Some(&mask));
        assert!((found.tolerance() - 0.01).abs() < 1e-6);
        let map = scene();
        let mut explained = ExplainedError::new(&map, 0.03);
        let is_right = (0..SIDE * SIDE).map(|pixel| pixel % SIDE >= SIDE / 2);
        let right = Image { data: is_right.collect(), ..Image::new(SIDE, SIDE, 1) };
        explained.add((&camera(), at(0.0)), None, Some(&right));
        assert!(explained.sums[0] > 100.0 && explained.sums[2] < 1.0, "{:?}", explained.sums);
    }

    #[test]
    fn few_frames_of_a_long_recording_are_asked() {
        let frames = Vec::from_iter(0..1000);
        let chosen: Vec<_> = spread_frames(&frames, 20).copied().collect();
        assert!(chosen.len() == 40 && chosen[39] == 999 && chosen[0] < 25, "{chosen:?}");
        assert!(chosen.windows(2).all(|pair| pair[1] - pair[0] == 25));
        assert_eq!(spread_frames(&frames[..9], 30).count(), 9);
        assert_eq!(spread_frames(&frames[..0], 3).count(), 0);
    }
}
