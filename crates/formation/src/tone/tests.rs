use super::{
    CameraResponse, CurveGradient, FrameTone, NODES, NodeSpacing, StartCurve, WhiteBalanceModel,
};
use i2slam_check::{assert_close, assert_gradient, noise};

const SPACINGS: [NodeSpacing; 4] = [
    NodeSpacing::Uniform,
    NodeSpacing::Power(2.2),
    NodeSpacing::Power(0.5),
    NodeSpacing::Power(f64::INFINITY),
];
const STARTS: [StartCurve; 3] = [StartCurve::Srgb, StartCurve::Identity, StartCurve::Shoulder];

/// The start curve with noise of `size` on the nodes.
fn bent(curves: usize, spacing: NodeSpacing, size: f64, seed: u64) -> CameraResponse<f64> {
    let mut response = CameraResponse::new(curves, StartCurve::Srgb, spacing);
    let noise = noise(seed, curves * NODES);
    response.nodes.iter_mut().flatten().zip(noise).for_each(|(node, n)| *node += size * n);
    response
}

#[test]
fn an_untouched_response_is_its_start_curve() {
    for spacing in SPACINGS {
        for start in STARTS {
            let response = CameraResponse::<f64>::new(3, start, spacing);
            let curve = response.curve();
            for i in 0..NODES {
                let x = spacing.position(i);
                assert!((curve.evaluate(2, x) - start.evaluate(x)).abs() < 1e-12, "{spacing:?}");
            }
        }
    }
}

#[test]
fn any_nodes_give_a_monotone_curve_with_fixed_ends() {
    for (spacing, seed) in SPACINGS.into_iter().zip(1..) {
        for size in [0.0, 0.01, 1.0, 100.0] {
            let curve = bent(3, spacing, size, seed).curve();
            for channel in 0..3 {
                let values = curve.values(channel);
                assert_eq!((values[0], values[NODES - 1]), (0.0, 1.0));
                assert!(values.windows(2).all(|w| w[0] <= w[1]));
                let looked_up: Vec<f64> =
                    (-50..1100).map(|i| curve.evaluate(channel, f64::from(i) * 1e-3)).collect();
                assert!(looked_up.windows(2).all(|w| w[0] <= w[1] + 1e-13));
            }
        }
    }
}

#[test]
fn nodes_without_any_rise_give_even_steps() {
    for slope in [0.0, -1.0] {
        let mut response = CameraResponse::<f64>::new(1, StartCurve::Srgb, NodeSpacing::Uniform);
        response.nodes[0] = (0..NODES).map(|i| 0.5 + slope * i as f64).collect();
        let curve = response.curve();
        assert!((curve.evaluate(0, 0.4) - 0.4).abs() < 1e-12);
        let mut d_curve = CurveGradient::zero(&curve);
        d_curve.values[0].fill(1.0);
        assert!(response.pull_back(&d_curve)[0].iter().all(|v| *v == 0.0));
    }
}

#[test]
fn offset_and_positive_scale_of_the_nodes_change_nothing() {
    let response = bent(1, NodeSpacing::Power(2.2), 0.05, 4);
    let mut other = response.clone();
    other.nodes[0].iter_mut().for_each(|g| *g = 3.5 * *g - 0.8);
    assert_close("gauge", other.curve().values(0), response.curve().values(0), 1e-12);
}

#[test]
fn lookup_meets_linear_interpolation_everywhere() {
    for spacing in SPACINGS {
        let curve = bent(1, spacing, 0.02, 6).curve();
        let (x, y) = (curve.positions(), curve.values(0));
        for probe in noise(8, 4000).iter().map(|n| n.abs().powi(3)).chain(x.to_vec()) {
            let right = x.partition_point(|&p| p < probe).clamp(1, NODES - 1);
            let share = (probe - x[right - 1]) / (x[right] - x[right - 1]);
            let expected = y[right - 1] + share * (y[right] - y[right - 1]);
            assert!((curve.evaluate(0, probe) - expected).abs() < 1e-12, "{spacing:?} {probe}");
        }
    }
}

#[test]
fn single_precision_follows_double() {
    for spacing in SPACINGS {
        let wide = bent(3, spacing, 0.02, 6);
        let mut narrow = CameraResponse::<f32>::new(3, StartCurve::Srgb, spacing);
        for (to, from) in narrow.nodes.iter_mut().flatten().zip(wide.nodes.iter().flatten()) {
            *to = *from as f32;
        }
        let (wide, narrow) = (wide.curve(), narrow.curve());
        for x in noise(2, 2000).iter().map(|n| 1.5 * n.abs().powi(2)) {
            let d = wide.evaluate(1, x) - f64::from(narrow.evaluate(1, x as f32));
            assert!(d.abs() < 2e-5, "{spacing:?} {x} {d}");
        }
    }
}

#[test]
fn leaky_branches_meet_the_curve() {
    let curve = bent(1, NodeSpacing::Uniform, 0.0, 1).curve();
    assert!((curve.evaluate(0, -2.0) + 0.02).abs() < 1e-15);
    assert!((curve.evaluate(0, 4.0) - (1.0 + 0.01 - 0.005)).abs() < 1e-15);
    for at in [0.0, 1.0] {
        let jump = curve.evaluate(0, at + 1e-12) - curve.evaluate(0, at - 1e-12);
        assert!(jump.abs() < 1e-9);
    }
}

#[test]
fn slope_agrees_with_differences_on_all_branches() {
    let curve = bent(1, NodeSpacing::Power(2.2), 0.0, 1).curve();
    // Inside [0, 1] in small steps, away from the nodes, whose two sides differ.
    let inside = [0.010_05, 0.2, 0.7].map(|x| (x, 1e-7));
    let outside = [-3.0, -0.01, 1.01, 3.0, 50.0].map(|x: f64| (x, 1e-3 * x.abs()));
    for (x, step) in inside.into_iter().chain(outside) {
        assert_gradient("slope", &[x], &[curve.slope(0, x)], step, 1e-6, |x| {
            curve.evaluate(0, x[0])
        });
    }
}

#[test]
fn inverse_undoes_the_curve() {
    for spacing in SPACINGS {
        let curve = CameraResponse::<f64>::new(3, StartCurve::Srgb, spacing).curve();
        for i in 0..=1000 {
            let y = f64::from(i) / 1000.0;
            let x = curve.inverse(1, y);
            assert!((curve.evaluate(1, x) - y).abs() < 1e-12, "{spacing:?} {y}");
        }
        assert_eq!((curve.inverse(0, -3.0), curve.inverse(0, 7.0)), (0.0, 1.0));
        assert!(curve.inverse(0, f64::NAN).is_nan());
    }
}

#[test]
fn inverse_of_a_level_part_is_its_left_end() {
    let mut response = CameraResponse::<f64>::new(1, StartCurve::Identity, NodeSpacing::Uniform);
    response.nodes[0][200..].fill(1.0);
    let curve = response.curve();
    assert!((curve.inverse(0, 1.0) - 200.0 / 255.0).abs() < 1e-12);
}

#[test]
fn node_gradient_agrees_with_differences() {
    for (spacing, seed) in SPACINGS.into_iter().zip(1..) {
        // Without the shift: every step rises. With it: one step falls and stays the lowest.
        for lowest in [0.0, 0.3] {
            let mut response = CameraResponse::<f64>::new(2, StartCurve::Identity, spacing);
            let even = |i: usize| i as f64 / 255.0 + 1e-4 * noise(seed, NODES)[i];
            for nodes in &mut response.nodes {
                *nodes = (0..NODES).map(even).collect();
                nodes[71..].iter_mut().for_each(|g| *g -= lowest);
            }
            check_node_gradient(&response, seed);
        }
    }
}

fn check_node_gradient(response: &CameraResponse<f64>, seed: u64) {
    let weights = noise(seed + 50, 2 * NODES);
    let d_curve = CurveGradient { values: weights.chunks(NODES).map(<[f64]>::to_vec).collect() };
    let gradient = response.pull_back(&d_curve).concat();
    assert_gradient("nodes", &response.nodes.concat(), &gradient, 1e-5, 1e-6, |x| {
        let mut moved = response.clone();
        moved.nodes = x.chunks(NODES).map(<[f64]>::to_vec).collect();
        let curve = moved.curve();
        let values = curve.values(0).iter().chain(curve.values(1));
        values.zip(&weights).map(|(v, w)| v * w).sum()
    });
}

#[test]
fn gains_multiply_exposure_and_white_balance() {
    let tone =
        FrameTone { log_exposure: 2.0_f64.ln(), log_white_balance: [3.0_f64.ln(), 0.0, 0.0] };
    assert_close("gains", &tone.gains(), &[6.0, 2.0, 2.0], 1e-14);
    assert_eq!(FrameTone::<f64>::default().gains(), [1.0; 3]);
    assert_eq!(FrameTone::from_array(tone.to_array()), tone);
}

#[test]
fn white_balance_models_project() {
    let mut per_channel = [1.0, 2.0, 4.0];
    WhiteBalanceModel::PerChannel.project_gradient(&mut per_channel);
    assert_eq!(per_channel, [1.0, 0.0, 4.0]);
    let mut one_gain = [1.0, 2.0, 4.0];
    WhiteBalanceModel::OneGain.project_gradient(&mut one_gain);
    assert_eq!(one_gain, [7.0; 3]);
    WhiteBalanceModel::Fixed.project_gradient(&mut one_gain);
    assert_eq!(one_gain, [0.0; 3]);
}

#[test]
fn poison_is_passed_on_without_panic() {
    for spacing in SPACINGS.into_iter().chain([NodeSpacing::Power(f64::NAN)]) {
        let mut response = bent(3, spacing, 0.1, 3);
        let clean = response.curve();
        assert!(clean.evaluate(0, f64::NAN).is_nan());
        assert_eq!(clean.evaluate(0, f64::INFINITY), 1.01);
        assert_eq!(clean.evaluate(0, f64::NEG_INFINITY), f64::NEG_INFINITY);
        response.nodes[1][17] = f64::NAN;
        response.nodes[2][200] = f64::INFINITY;
        let curve = response.curve();
        assert!(curve.evaluate(1, 0.5).is_nan());
        assert!(!curve.evaluate(0, 0.5).is_nan(), "the other curves stay clean");
        assert!(!curve.inverse(0, 0.5).is_nan());
        curve.inverse(1, 0.5);
        assert_eq!(response.pull_back(&CurveGradient::zero(&curve)).len(), 3);
    }
}

#[test]
fn start_curves_meet_known_values() {
    let srgb = StartCurve::Srgb;
    assert!((srgb.evaluate(0.001) - 0.012_92).abs() < 1e-12);
    assert!((srgb.evaluate(0.5) - 0.735_356_983).abs() < 1e-8);
    assert!((srgb.evaluate(0.003_130_8) - srgb.evaluate(0.003_130_81)).abs() < 1e-6);
    assert!((StartCurve::Shoulder.evaluate(0.1) - srgb.evaluate(0.5 / 1.4)).abs() < 1e-12);
}

#[test]
fn power_spacing_puts_the_nodes_evenly_in_display_space() {
    let spacing = NodeSpacing::Power(2.2);
    let display: Vec<f64> = (0..NODES).map(|i| spacing.position(i).powf(1.0 / 2.2)).collect();
    let even: Vec<f64> = (0..NODES).map(|i| i as f64 / 255.0).collect();
    assert_close("display values", &display, &even, 1e-12);
    assert!(spacing.position(1) < 1e-5 && NodeSpacing::Uniform.position(51) == 0.2);
}

#[test]
fn linear_values_of_each_channel_are_raised_to_its_power() {
    let response = CameraResponse::<f64>::new(3, StartCurve::Shoulder, NodeSpacing::Power(2.2));
    let powers = [0.96, 1.0, 1.05];
    let (before, after) = (response.curve(), response.raised_by_channel(&powers).curve());
    for (channel, power) in powers.into_iter().enumerate() {
        for value in [0.03, 0.1, 0.3, 0.6, 0.9, 0.99] {
            let due = power * before.inverse(channel, value).ln();
            let found = after.inverse(channel, value).ln();
            assert!((found - due).abs() < 1e-3, "{channel} {value}: {found} {due}");
        }
    }
}
