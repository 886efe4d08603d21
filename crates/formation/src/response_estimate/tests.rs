use super::*;
use crate::tone::{CameraResponse, NODES, NodeSpacing};
use i2slam_check::{assert_gradient, noise};

/// `(x / (1 + x))^(1/2.2)`: a shoulder that never ends.
fn reinhard(x: f64) -> f64 {
    (x / (1.0 + x)).powf(1.0 / 2.2)
}

fn log_reinhard(y: f64) -> f64 {
    (y.powf(2.2) / (1.0 - y.powf(2.2))).ln()
}

/// Points of several surfaces in pairs of pictures whose exposures differ by `stops` at most, values
/// in 8 bits with noise, one in twenty of something else.
fn groups(response: impl Fn(f64) -> f64, stops: f64) -> Vec<Vec<ValuePair>> {
    let pair = |index: u64| {
        let gains = noise(index + 100, 2).into_iter().map(|n| (0.5 * stops * n).exp2());
        let gains: Vec<f64> = gains.collect();
        let radiance = noise(2 * index + 1, 400);
        let errors = noise(2 * index + 2, 1200);
        let point = |i: usize| {
            let x = (7.0 * radiance[i] - 2.0).exp2();
            let other = if i.is_multiple_of(20) { x * (2.0 * errors[800 + i]).exp2() } else { x };
            let shown = |x: f64, error: f64| {
                (255.0 * (response(x) + 0.004 * error)).round().clamp(0.0, 255.0) / 255.0
            };
            let values = [shown(gains[0] * x, errors[i]), shown(gains[1] * other, errors[400 + i])];
            ValuePair { values, deviations: [0.004; 2], log_vignetting: 0.0 }
        };
        let exposed = |point: &ValuePair| point.values.iter().all(|v| (0.08..0.985).contains(v));
        (0..400).map(point).filter(exposed).collect()
    };
    (0..24).map(pair).collect()
}

/// Largest difference of `ln x` to a true curve over picture values, after the best scale and offset.
fn error(found: &LogResponse, due: impl Fn(f64) -> f64) -> f64 {
    let values: Vec<f64> = (10..=97).map(|v| f64::from(v) / 100.0).collect();
    let (a, b): (Vec<f64>, Vec<f64>) =
        values.iter().map(|&y| (found.log_linear(y), due(y))).unzip();
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(&a), mean(&b));
    let products: f64 = a.iter().zip(&b).map(|(a, b)| (a - ma) * (b - mb)).sum();
    let scale = products / a.iter().map(|a| (a - ma).powi(2)).sum::<f64>();
    a.iter().zip(&b).map(|(a, b)| ((a - ma) * scale - (b - mb)).abs()).fold(0.0, f64::max)
}

#[test]
fn pictures_of_different_exposure_tell_the_shape() {
    let pairs = groups(reinhard, 2.0);
    for start in [StartCurve::Shoulder, StartCurve::Srgb] {
        let found = estimate(&pairs, 1.0, start).expect("points").response;
        let before = LogResponse::new(&log_slopes(start), [0.0; COUNT]);
        let [found_error, before_error] = [&found, &before].map(|curve| error(curve, log_reinhard));
        assert!(found_error < 0.15 && before_error > 0.5, "{found_error} {before_error}");
        let [found, before] =
            [&found, &before].map(|c| deviation_by_curve(&pairs, c).expect("points"));
        assert!(found < 1.1 && before > 1.1 * found, "{found} {before}");
    }
}

#[test]
fn equal_exposures_tell_nothing() {
    let pairs = groups(reinhard, 0.0);
    let found = estimate(&pairs, 1.0, StartCurve::Shoulder).expect("points").response;
    let before = LogResponse::new(&log_slopes(StartCurve::Shoulder), [0.0; COUNT]);
    let [found, before] = [&found, &before].map(|c| deviation_by_curve(&pairs, c).expect("points"));
    assert!(before < 1.03 * found, "{found} {before}");
}

#[test]
fn points_that_do_not_belong_together_tell_nothing() {
    let value = |n: f64| 0.5 + 0.4 * n;
    let group = |seed: u64| {
        let noise = noise(seed, 800);
        let pair = |i: usize| ValuePair {
            values: [value(noise[2 * i]), value(0.5 * noise[2 * i] + 0.5 * noise[2 * i + 1])],
            deviations: [0.004; 2],
            log_vignetting: 0.0,
        };
        (0..400).map(pair).collect()
    };
    let pairs: Vec<Vec<ValuePair>> = (1..25).map(group).collect();
    let before = LogResponse::new(&log_slopes(StartCurve::Shoulder), [0.0; COUNT]);
    if let Some(found) = estimate(&pairs, 6.0, StartCurve::Shoulder) {
        let found = found.response;
        let most = found.offsets().iter().fold(0.0, |most: f64, d| most.max(d.abs()));
        let [found, before] =
            [&found, &before].map(|c| deviation_by_curve(&pairs, c).expect("points"));
        assert!(most < 1.5 && found > 0.5 * before, "{most} {found} {before}");
    }
}

#[test]
fn the_curve_of_the_start_is_found_again() {
    let start = StartCurve::Shoulder;
    let found = estimate(&groups(|x| start.evaluate(0.2 * x.min(5.0)), 2.0), 1.0, start);
    let found = found.expect("points").response;
    let before = LogResponse::new(&log_slopes(start), [0.0; COUNT]);
    assert!(error(&found, |y| before.log_linear(y)) < 0.1, "{:?}", found.offsets());
}

#[test]
fn too_few_points_tell_nothing() {
    let few: Vec<Vec<ValuePair>> = groups(reinhard, 2.0).into_iter().take(1).collect();
    assert_eq!(estimate(&few, 1.0, StartCurve::Shoulder), None);
    assert_eq!(estimate(&[], 1.0, StartCurve::Shoulder), None);
}

#[test]
fn the_power_of_the_vignetting_does_not_bend_the_response() {
    let behind_lens = |power: f64| -> Vec<Vec<ValuePair>> {
        let mut pairs = groups(reinhard, 2.0);
        let points = pairs.iter_mut().enumerate().flat_map(|(g, group)| {
            group
                .iter_mut()
                .enumerate()
                .map(move |(i, point)| (noise((1000 * g + i) as u64, 1)[0], point))
        });
        for (log_vignetting, point) in points {
            // The second picture shows the point as much brighter.
            let log = log_reinhard(point.values[1].min(0.999)) - 0.5 * log_vignetting;
            point.values[1] = (255.0 * reinhard(log.exp())).round() / 255.0;
            point.log_vignetting = 0.5 * power * log_vignetting;
        }
        pairs.iter_mut().for_each(|group| group.retain(|p| (0.08..0.985).contains(&p.values[1])));
        pairs
    };
    let found = [0.86, 1.0, 1.16].map(|power| {
        (power, estimate(&behind_lens(power), 1.0, StartCurve::Shoulder).expect("points"))
    });
    let [_, (_, due), _] = &found;
    assert!(error(&due.response, log_reinhard) < 0.15);
    for (power, found) in &found {
        let apart = error(&found.response, |y| due.response.log_linear(y));
        let product = power * found.vignetting_power / due.vignetting_power;
        assert!(apart < 0.01 && (product - 1.0).abs() < 0.01, "{power}: {apart} {product}");
    }
}

/// Points of a scene that gets darker, few of them in the dark, with noise other than claimed.
fn dark_groups(response: impl Fn(f64) -> f64, noise_of_value: f64) -> Vec<Vec<ValuePair>> {
    let pair = |index: u64| {
        let gain = (0.2 * index as f64 - 2.4).exp2();
        let (radiance, errors) = (noise(3 * index + 1, 600), noise(3 * index + 2, 1200));
        let point = |i: usize| {
            let x = (3.0 * radiance[i] - 3.5).exp2();
            // Of two evenly spread errors each.
            let error = |k: usize| noise_of_value * (errors[k] + errors[(k + 600) % 1200]);
            let shown = |x: f64, e: f64| (response(x) + e).clamp(1.0 / 255.0, 1.0);
            ValuePair {
                values: [shown(x, error(i)), shown(gain * x, error(599 - i))],
                deviations: [0.01; 2],
                log_vignetting: 0.0,
            }
        };
        (0..600).map(point).filter(|p| p.values.iter().all(|v| *v < 0.985)).collect()
    };
    (0..24).map(pair).collect()
}

/// The dark end of a response, given its inverse with the power of the start curve.
fn assert_dark_end(response: impl Fn(f64) -> f64, log_response: impl Fn(f64) -> f64) {
    for noise_of_value in [0.0001, 0.001, 0.01, 0.025] {
        let points = dark_groups(&response, noise_of_value);
        let found = estimate(&points, 1.0, StartCurve::Shoulder).expect("points").response;
        // The first value is darker than all that count.
        for (y, most) in [(0.04, 0.4), (0.06, 0.25), (0.08, 0.25), (0.12, 0.25), (0.2, 0.25)] {
            let of_found = found.log_linear(y) - found.log_linear(0.5);
            let due = log_response(y) - log_response(0.5);
            let apart = (of_found - due) / 2.0_f64.ln();
            assert!(apart.abs() < most, "{noise_of_value} {y}: {apart} stops");
        }
    }
}

#[test]
fn noise_does_not_bend_the_dark_end() {
    let start = StartCurve::Shoulder;
    let curve = LogResponse::new(&log_slopes(start), [0.0; COUNT]);
    assert_dark_end(|x| start.evaluate(x.min(1.0)), |y| curve.log_linear(y));
    let range = |log: &dyn Fn(f64) -> f64| log(TIED[1]) - log(TIED[0]);
    let power = range(&|y| curve.log_linear(y)) / range(&log_reinhard);
    assert_dark_end(reinhard, |y| power * log_reinhard(y));
}

#[test]
fn slopes_of_the_curve_agree_with_differences() {
    let start = log_slopes(StartCurve::Shoulder);
    let at: Vec<f64> = noise(5, COUNT).iter().map(|n| 0.3 * n).collect();
    let curve = |x: &[f64]| LogResponse::new(&start, std::array::from_fn(|k| x[k]));
    let values = [0.213, 0.871];
    let [first, second] = values.map(|y| curve(&at).by_knots(y));
    let slopes: Vec<f64> = (0..COUNT).map(|k| first[k] - second[k]).collect();
    let difference = |x: &[f64]| {
        let [first, second] = values.map(|y| curve(x).log_linear(y));
        first - second
    };
    assert_gradient("difference", &at, &slopes, 1e-5, 1e-6, difference);
}

#[test]
fn a_camera_response_has_the_curve() {
    let found = estimate(&groups(reinhard, 2.0), 1.0, StartCurve::Shoulder);
    let found = found.expect("points").response;
    for power in [0.8, 1.0, 1.1] {
        let response: CameraResponse<f64> =
            found.camera_response(3, StartCurve::Shoulder).raised(power);
        let curve = response.curve();
        assert!(matches!(response.spacing(), NodeSpacing::Power(p) if (0.8..=9.0).contains(&p)));
        let offset = curve.inverse(0, 0.5).ln() - power * found.log_linear(0.5);
        for value in 6..=98 {
            let y = f64::from(value) / 100.0;
            let log = curve.inverse(2, y).ln() - offset;
            assert!((log - power * found.log_linear(y)).abs() < 0.03, "{power} {y} {log}");
        }
        assert_eq!(response.initial().len(), NODES);
    }
}
