//! Removal of Gaussians that pictures hardly show.
//!
//! With its opacity `α` at a pixel and the transmittance `T` of what lies before it, a Gaussian makes the
//! share `α T` of the pixel. Its contribution to a picture is the sum over pixels, `Σ α T` [px]: the
//! derivative of the sum of a picture by the radiance of the Gaussian. One that is covered by others, or
//! faint, contributes next to nothing to any picture.
//!
//! The limit is the contribution `m` with which a contrast of `δ` explains as much squared error, `m δ²`, as
//! `p` numbers do that are fitted to independent errors of the size `e`: `m = p (e/δ)²`. It is an estimate:
//! a faint Gaussian explains less, one that several pictures show more. Together those that go make at most
//! a small share of all light: of pictures of few pixels many Gaussians make a little each.

use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::gaussian::{
    ColourActivation, GaussianMap, MapGradient, RasterSettings, Rasterizer, ViewColours,
};
use i2slam_radiance::{RadianceMap, Render, RenderCotangent, View};

/// Frames between keyframes that are asked, too, for each keyframe: what they alone show must stay.
const FRAMES_PER_KEYFRAME: usize = 2;
/// Numbers of a Gaussian: centre, three deviations, rotation, opacity and colour.
const PARAMETERS: f32 = 14.0;
/// Difference of a Gaussian from what lies behind it; white is 1.
const CONTRAST: f32 = 0.2;
/// Contribution from which on a Gaussian stays, however large errors are [px].
const SUFFICIENT_CONTRIBUTION: f32 = 0.5;
/// Of the contributions of all Gaussians to all pictures, the most that is removed.
const MAX_REMOVED_SHARE: f64 = 0.005;

/// Of frames between keyframes those that are asked, evenly spread up to the last one.
pub(super) fn spread_frames<T>(frames: &[T], keyframes: usize) -> impl Iterator<Item = &T> {
    let count = frames.len().min(FRAMES_PER_KEYFRAME * keyframes);
    (1..=count).map(move |number| &frames[number * frames.len() / count - 1])
}

/// Mean squared difference of predictions and pictures.
#[derive(Clone, Copy, Default)]
pub(super) struct PredictionError {
    squares: f64,
    values: usize,
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
        let pixels = picture.width * picture.height;
        let values = prediction.data.iter().zip(&picture.data).enumerate();
        for (_, (a, b)) in values.filter(|(value, _)| is_valid(value % pixels)) {
            self.squares += f64::from(a - b).powi(2);
            self.values += 1;
        }
    }

    fn mean_square(self) -> f32 {
        (self.squares / self.values.max(1) as f64) as f32
    }
}

/// Contributions of every Gaussian to a number of pictures.
pub(super) struct Contributions {
    /// The map with linear colours, whose derivative is the contribution.
    map: GaussianMap,
    rasterizer: Rasterizer,
    render: Render,
    gradient: MapGradient,
    /// To the picture that shows a Gaussian best [px].
    largest: Vec<f32>,
    /// To all pictures together [px].
    sum: Vec<f64>,
}

impl Contributions {
    /// Before the first picture.
    pub(super) fn new(map: &GaussianMap) -> Self {
        let (activation, colours) = (ColourActivation::Linear, vec![[0.0; 3]; map.len()]);
        let view_colours = ViewColours::default();
        Self {
            map: GaussianMap { activation, colours, view_colours, ..map.clone() },
            rasterizer: Rasterizer::new(RasterSettings::default()),
            render: Render::default(),
            gradient: MapGradient::default(),
            largest: vec![0.0; map.len()],
            sum: vec![0.0; map.len()],
        }
    }

    /// Takes the picture of a camera into account, without the pixels outside of the mask.
    pub(super) fn add(
        &mut self,
        camera: &Camera<f64>,
        world_from_camera: Pose<f64>,
        mask: Option<&Image<bool>>,
    ) {
        let view = View { camera: camera.cast(), world_from_camera: world_from_camera.cast() };
        self.map.render(&mut self.rasterizer, &view, &mut self.render);
        let mut radiance = Image::new(camera.width, camera.height, 3);
        for (pixel, value) in radiance.plane_mut(0).iter_mut().enumerate() {
            *value = if mask.is_none_or(|mask| mask.data[pixel]) { 1.0 } else { 0.0 };
        }
        let cotangent = RenderCotangent { radiance, ..RenderCotangent::default() };
        self.gradient.reset(&self.map);
        let gradient = Some(&mut self.gradient);
        self.map.pull_back(&mut self.rasterizer, &view, &cotangent, gradient);
        let found = self.largest.iter_mut().zip(&mut self.sum);
        for ((largest, sum), [contribution, ..]) in found.zip(&self.gradient.colours) {
            *largest = largest.max(*contribution);
            *sum += f64::from(*contribution);
        }
    }

    /// False for each Gaussian whose largest contribution is below the limit for an error of predictions,
    /// smallest ones first as long as their share of all light is small.
    pub(super) fn keep(&self, error: PredictionError) -> Vec<bool> {
        let limit = PARAMETERS * error.mean_square() / (CONTRAST * CONTRAST);
        let limit = if limit.is_finite() { limit.min(SUFFICIENT_CONTRIBUTION) } else { 0.0 };
        let mut keep = vec![true; self.largest.len()];
        let mut below = Vec::from_iter((0..keep.len()).filter(|&id| self.largest[id] < limit));
        below.sort_by(|&a, &b| self.largest[a].total_cmp(&self.largest[b]));
        let mut remaining = MAX_REMOVED_SHARE * self.sum.iter().sum::<f64>();
        for id in below {
            remaining -= self.sum[id];
            if remaining < 0.0 {
                break;
            }
            keep[id] = false;
        }
        keep
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::Vec3;
    use i2slam_radiance::gaussian::{Gaussian, Shape};

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

    /// A screen at 4 m, a ball behind it, one beside it, and a faint one.
    fn scene() -> GaussianMap {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        map.push(ball(1.0, 4.0, 0.6, 9.0));
        map.push(ball(2.0, 8.0, 0.2, 9.0));
        map.push(ball(-1.5, 4.0, 0.25, 0.0));
        map.push(ball(-0.5, 4.0, 0.25, -5.0));
        map
    }

    fn camera() -> Camera<f64> {
        let (focal, half) = (SIDE as f64, 0.5 * SIDE as f64);
        Camera { width: SIDE, height: SIDE, fx: focal, fy: focal, cx: half, cy: half }
    }

    fn contributions(places: &[f64]) -> Contributions {
        let mut contributions = Contributions::new(&scene());
        for x in places {
            let translation = Vec3::new(*x, 0.0, 0.0);
            contributions.add(&camera(), Pose { translation, ..Pose::identity() }, None);
        }
        contributions
    }

    /// A constant error of predictions.
    fn error(size: f32) -> PredictionError {
        let mut error = PredictionError::default();
        let picture = |value: f32| Image { data: vec![value; 12], ..Image::new(2, 2, 3) };
        error.add(&picture(0.5 + size), &picture(0.5), None);
        error
    }

    #[test]
    fn contributions_are_sums_over_pixels() {
        let found = contributions(&[0.0]).largest;
        // Half opaque, 2 px wide and widened by 0.3 px².
        let due = 0.5 * std::f32::consts::TAU * (2.0_f32.powi(2) + 0.3);
        assert!((found[2] / due - 1.0).abs() < 0.03, "{found:?} {due}");
        // What is fainter than 1/255 is not drawn.
        assert!((0.05..2.0 * due / 5.0_f32.exp()).contains(&found[3]), "{found:?}");
        assert!(found[1] < 0.3 && found[0] > 100.0, "{found:?}");
    }

    #[test]
    fn what_any_picture_shows_is_kept() {
        assert_eq!(contributions(&[0.0]).keep(error(0.03)), [true, false, true, false]);
        // From the side the ball shows behind the screen.
        let aside = contributions(&[0.0, 2.4]);
        assert_eq!(aside.keep(error(0.03)), [true, true, true, false]);
        assert_eq!(aside.keep(error(0.01)), [true; 4]);
        // However large the error is, or unknown.
        assert_eq!(contributions(&[0.0]).keep(error(0.5)), [true, false, true, false]);
        assert_eq!(contributions(&[0.0]).keep(error(f32::NAN)), [true; 4]);
    }

    #[test]
    fn what_many_small_gaussians_make_together_is_kept() {
        // A wall of faint balls, each of which makes less than a fifth of a pixel.
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        for place in 0..SIDE * SIDE {
            let (column, row) = (place % SIDE, place / SIDE);
            let centre = |at: usize| 4.0 * ((at as f32 + 0.5) / SIDE as f32 - 0.5);
            let mut ball = ball(centre(column), 4.0, 0.01, -2.3);
            ball.mean[1] = centre(row);
            map.push(ball);
        }
        let mut contributions = Contributions::new(&map);
        contributions.add(&camera(), Pose::identity(), None);
        assert!(contributions.largest.iter().all(|largest| (0.01..0.2).contains(largest)));
        let kept = contributions.keep(error(0.1)).iter().filter(|keep| **keep).count();
        assert!((0.98..1.0).contains(&(kept as f64 / map.len() as f64)), "{kept}");
    }

    #[test]
    fn pixels_outside_of_the_mask_do_not_count() {
        let mut error = PredictionError::default();
        let picture = Image::new(2, 1, 3);
        let prediction = Image { data: vec![0.1, 9.0, 0.1, 9.0, 0.1, 9.0], ..Image::new(2, 1, 3) };
        let mask = Image { data: vec![true, false], ..Image::new(2, 1, 1) };
        error.add(&prediction, &picture, Some(&mask));
        assert!((error.mean_square() - 0.01).abs() < 1e-6);
        let mut contributions = Contributions::new(&scene());
        let right = Image {
            data: (0..SIDE * SIDE).map(|p| p % SIDE >= SIDE / 2).collect(),
            ..Image::new(SIDE, SIDE, 1)
        };
        contributions.add(&camera(), Pose::identity(), Some(&right));
        let found = contributions.largest;
        assert!(found[0] > 100.0 && found[2] < 0.01, "{found:?}");
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
