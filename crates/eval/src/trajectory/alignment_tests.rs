use super::*;

fn cloud(seed: u64, extent: [f64; 3]) -> Vec<Vec3<f64>> {
    let n = i2slam_check::noise(seed, 60);
    n.chunks(3).map(|c| Vec3::new(c[0] * extent[0], c[1] * extent[1], c[2] * extent[2])).collect()
}

fn example(scale: f64) -> Similarity<f64> {
    Similarity {
        scale,
        rotation: Rotation::exp(Vec3::new(1.4, -2.0, 0.9)),
        translation: Vec3::new(30.0, -2.0, 0.5),
    }
}

fn cost(fit: &Similarity<f64>, source: &[Vec3<f64>], target: &[Vec3<f64>]) -> f64 {
    source.iter().zip(target).map(|(&s, &t)| (fit.apply(s) - t).norm_squared()).sum()
}

#[test]
fn recovers_an_exact_similarity() {
    for (extent, kind) in [([1.0, 1.0, 1.0], "volume"), ([2.0, 1.0, 0.0], "plane")] {
        let source = cloud(1, extent);
        for (alignment, scale) in [(Alignment::Se3, 1.0), (Alignment::Sim3, 0.37)] {
            let truth = example(scale);
            let target: Vec<_> = source.iter().map(|&p| truth.apply(p)).collect();
            let fit = align(&source, &target, alignment).unwrap();
            assert!((fit.scale - scale).abs() < 1e-13, "{kind} {fit:?}");
            assert!((fit.rotation.inverse() * truth.rotation).log().norm() < 1e-13, "{kind}");
            assert!(cost(&fit, &source, &target) < 1e-24, "{kind}");
        }
    }
}

#[test]
fn rigid_fit_does_not_absorb_scale() {
    let source = cloud(2, [1.0; 3]);
    let target: Vec<_> = source.iter().map(|&p| example(2.0).apply(p)).collect();
    let fit = align(&source, &target, Alignment::Se3).unwrap();
    assert_eq!(fit.scale, 1.0);
    assert!(cost(&fit, &source, &target) > 1.0);
}

#[test]
fn a_mirrored_cloud_gets_a_rotation_and_the_best_one() {
    let source = cloud(3, [1.0, 0.8, 0.5]);
    let target: Vec<_> = source.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
    let fit = align(&source, &target, Alignment::Sim3).unwrap();
    assert!((fit.rotation.matrix().determinant() - 1.0).abs() < 1e-12);
    let best = cost(&fit, &source, &target);
    assert!(best > 0.1, "no rotation undoes a mirror");
    assert_optimal(&fit, &source, &target);
}

#[test]
fn noisy_fit_is_a_minimum() {
    let source = cloud(4, [1.0; 3]);
    let noise = cloud(5, [0.1; 3]);
    let target: Vec<_> =
        source.iter().zip(&noise).map(|(&p, &n)| example(1.7).apply(p) + n).collect();
    assert_optimal(&align(&source, &target, Alignment::Sim3).unwrap(), &source, &target);
}

/// No small step in any of the seven directions lowers the cost, nor does any of a thousand
/// rotations spread over the whole group.
fn assert_optimal(fit: &Similarity<f64>, source: &[Vec3<f64>], target: &[Vec3<f64>]) {
    let best = cost(fit, source, target);
    for direction in 0..7 {
        for step in [-1e-3, 1e-3] {
            let mut d = [0.0; 7];
            d[direction] = step;
            let moved = Similarity {
                scale: fit.scale * (1.0 + d[6]),
                rotation: Rotation::exp(Vec3::new(d[0], d[1], d[2])) * fit.rotation,
                translation: fit.translation + Vec3::new(d[3], d[4], d[5]),
            };
            assert!(cost(&moved, source, target) > best, "direction {direction} step {step}");
        }
    }
    let centre = |points: &[Vec3<f64>]| {
        points.iter().fold(Vec3::zero(), |s, &p| s + p * (points.len() as f64).recip())
    };
    for turn in i2slam_check::noise(6, 3000).chunks(3) {
        let rotation = Rotation::exp(Vec3::new(turn[0], turn[1], turn[2]) * 3.2);
        let translation = centre(target) - rotation.rotate(centre(source)) * fit.scale;
        let other = Similarity { scale: fit.scale, rotation, translation };
        assert!(cost(&other, source, target) >= best);
    }
}

#[test]
fn a_line_is_laid_on_its_line() {
    let source = cloud(7, [1.0, 0.0, 0.0]);
    for turn in [[0.2, 0.4, -0.9], [0.0, 0.0, std::f64::consts::PI], [0.0; 3]] {
        let rotation = Rotation::exp(Vec3::from_array(turn));
        let target: Vec<_> = source.iter().map(|&p| rotation.rotate(p)).collect();
        let fit = align(&source, &target, Alignment::Se3).unwrap();
        assert!(cost(&fit, &source, &target) < 1e-20, "{turn:?}");
    }
}

#[test]
fn degenerate_input_is_an_error() {
    let (spread, still) = (cloud(8, [1.0; 3]), vec![Vec3::new(3.0, 4.0, 5.0); 20]);
    let coincident = |r| matches!(r, Err(EvalError::Coincident { .. }));
    assert!(coincident(align(&still, &spread, Alignment::Se3)));
    assert!(coincident(align(&spread, &still, Alignment::Sim3)));
    let poisoned = vec![Vec3::new(f64::NAN, 0.0, 0.0); 20];
    let bad = align(&spread, &poisoned, Alignment::Se3);
    assert!(matches!(bad, Err(EvalError::NotFinite { .. })));
    let uneven = align(&spread, &still[1..], Alignment::Se3);
    assert!(matches!(uneven, Err(EvalError::ShapeMismatch { .. })));
    assert!(matches!(align(&[], &[], Alignment::Se3), Err(EvalError::TooFew { .. })));
}

#[test]
fn uncorrelated_points_are_an_error() {
    let x = |s: f64| Vec3::new(s, 0.0, 0.0);
    let (source, target) = ([x(1.0), x(1.0), x(-1.0), x(-1.0)], [x(1.0), x(-1.0), x(1.0), x(-1.0)]);
    assert_eq!(align(&source, &target, Alignment::Se3), Err(EvalError::Uncorrelated));
}
