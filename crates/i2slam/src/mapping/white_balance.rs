//! Change of white balance from frame to frame, by surface points that keyframes see.
//!
//! Two keyframes differ in ln (red/green) by
//!
//! ```text
//! r = h_red(y₁) - h_red(y₂) - h_green(y₁) + h_green(y₂)
//! ```
//!
//! at their common points, with `h` the logarithm of the linear value of a picture value `y`; exposure and
//! vignetting cancel. Those of all keyframes are found by least squares, as [gains](super::frame_gains) are,
//! twice: `a` from the first and `b` from the second half of the points of each pair, in the order of rows,
//! both relative to their means; ln (blue/green) likewise. What `a` and `b` agree on is a change of white
//! balance, half of what they differ by is the error of their mean:
//!
//! ```text
//! change² = mean(a b)        error² = mean((a - b)²) / 4
//! ```

use super::frame_gains::{Difference, solve_differences};
use super::response::{COMPARED, log_linear};
use super::surface_pairs::{ComparedViews, SamplePair};
use i2slam_formation::ResponseCurve;
use std::collections::BTreeMap;

/// Change of white balance over its error from which on it counts as one: gloss and coloured shadows bend
/// both halves alike.
const MIN_CHANGE: f64 = 1.5;
/// Keyframes from which on a constant white balance can be told.
const MIN_FRAMES: usize = 6;
const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

/// True if the compared keyframes have one white balance, as far as their pictures tell; `None` where they
/// do not.
pub(super) fn is_white_balance_constant(
    compared: &[ComparedViews],
    curve: &ResponseCurve<f32>,
    gauge_frame: usize,
) -> Option<bool> {
    let changes = [RED, BLUE].map(|channel| Changes::new(compared, curve, channel, gauge_frame));
    let frames = changes.iter().map(|changes| changes.0.len()).min()?;
    let mean = |of: fn(&Changes) -> f64| 0.5 * changes.iter().map(of).sum::<f64>();
    let [change, error] = [mean(Changes::square), mean(Changes::squared_error)];
    (frames >= MIN_FRAMES).then(|| change < MIN_CHANGE.powi(2) * error)
}

/// Logarithms of a channel over green in frames, around their means, by either half of the points.
struct Changes(Vec<[f64; 2]>);

impl Changes {
    fn new(
        compared: &[ComparedViews],
        curve: &ResponseCurve<f32>,
        channel: usize,
        gauge_frame: usize,
    ) -> Self {
        let of_half = |half: usize| -> BTreeMap<usize, f64> {
            let difference = |views: &ComparedViews| {
                let (first, second) = views.points.split_at(views.points.len() / 2);
                let points = if half == 0 { first } else { second };
                let of_points = points.iter().filter_map(|pair| contrast(pair, curve, channel));
                Difference::median(views.frames, of_points.collect())
            };
            let differences: Vec<Difference> = compared.iter().filter_map(difference).collect();
            solve_differences(&differences, gauge_frame, |_| 0.0)
        };
        let [first, second] = [0, 1].map(of_half);
        let both = first.iter().filter_map(|(frame, a)| Some([*a, *second.get(frame)?]));
        let both: Vec<[f64; 2]> = both.collect();
        let mean = |half: usize| both.iter().map(|v| v[half]).sum::<f64>() / both.len() as f64;
        let means = [mean(0), mean(1)];
        Self(both.iter().map(|v| [v[0] - means[0], v[1] - means[1]]).collect())
    }

    /// Square of the change that both halves agree on.
    fn square(&self) -> f64 {
        self.0.iter().map(|[a, b]| a * b).sum::<f64>() / self.0.len() as f64
    }

    /// Square of the error of the halves' mean.
    fn squared_error(&self) -> f64 {
        self.0.iter().map(|[a, b]| 0.25 * (a - b).powi(2)).sum::<f64>() / self.0.len() as f64
    }
}

/// Difference of ln (channel/green) between the two pictures of a point; `None` where one is badly exposed.
fn contrast(pair: &SamplePair, curve: &ResponseCurve<f32>, channel: usize) -> Option<f64> {
    let channels = [channel, GREEN];
    let is_exposed = |value: f32| (COMPARED[0]..=COMPARED[1]).contains(&value);
    let are_exposed = pair.iter().all(|s| channels.iter().all(|&c| is_exposed(s.values[c])));
    are_exposed.then(|| {
        let log =
            |picture: usize, c: usize| log_linear(curve, c, f64::from(pair[picture].values[c]));
        log(0, channel) - log(1, channel) - log(0, GREEN) + log(1, GREEN)
    })
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{Gains, compared_views, curve};
    use super::*;
    use i2slam_formation::Vignetting;

    fn views(count: usize, stops: f32, red: f32) -> Vec<ComparedViews> {
        let lens = Vignetting { coefficients: [-0.3, 0.0, 0.0] };
        compared_views(count, &lens, Gains { stops, red })
    }

    #[test]
    fn a_change_of_white_balance_is_told_from_exposure() {
        for stops in [0.0, 1.2] {
            assert_eq!(is_white_balance_constant(&views(7, stops, 0.0), &curve(), 0), Some(true));
            for red in [0.03, 0.1] {
                let compared = views(7, stops, red);
                assert_eq!(is_white_balance_constant(&compared, &curve(), 0), Some(false));
                let found = Changes::new(&compared, &curve(), RED, 0).square().sqrt();
                // The deviation of seven cosines.
                let due = 0.74 * f64::from(red);
                assert!((found / due - 1.0).abs() < 0.15, "{stops} {red}: {found} {due}");
            }
        }
    }

    #[test]
    fn few_frames_tell_nothing() {
        assert_eq!(is_white_balance_constant(&views(5, 0.3, 0.1), &curve(), 0), None);
        let mut apart = views(7, 0.3, 0.1);
        apart.iter_mut().for_each(|views| views.points.truncate(60));
        assert_eq!(is_white_balance_constant(&apart, &curve(), 0), None);
        assert_eq!(is_white_balance_constant(&[], &curve(), 0), None);
    }
}
