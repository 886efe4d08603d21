//! Vignetting that a lens adds to a sequence.

use super::Degradation;
use crate::lens::Falloff;

/// Vignetting of a degradation: half of the loss grows with r², half with r⁴.
pub(super) fn falloff(what: &Degradation) -> Option<Falloff> {
    let half_loss = 0.5 * (1.0 - what.vignetting?);
    Some(Falloff { coefficients: [-half_loss, -half_loss, 0.0] })
}

/// `vignetting.json`: the truth.
pub(super) fn json(lens: &Falloff) -> String {
    let [a, b, c] = lens.coefficients.map(|v| v + 0.0);
    format!("{{\n  \"a\": {a},\n  \"b\": {b},\n  \"c\": {c},\n  \"corner\": {}\n}}\n", lens.at(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Camera, Image};

    const CAMERA: Camera<f64> =
        Camera { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 20.0, cy: 15.0 };

    #[test]
    fn light_falls_to_the_corners_before_the_response() {
        let what = Degradation { vignetting: Some(0.5), ..Degradation::default() };
        let grey = Image { data: vec![0.6; 3600], ..Image::new(40, 30, 3) };
        let picture = what.degrade_colour(&grey, &CAMERA, 0);
        let linear = |value: f32| what.response.invert(value, 1);
        let share = |column, row| linear(picture.at(1, column, row)) / linear(0.6);
        assert!((share(20, 15) - 1.0).abs() < 2e-3, "{}", share(20, 15));
        // The centre of the corner pixel: r = 0.9667.
        let r2 = (19.5_f32.powi(2) + 14.5_f32.powi(2)) / 625.0;
        let expected = 1.0 - 0.25 * (r2 + r2 * r2);
        for (column, row) in [(0, 0), (39, 0), (0, 29), (39, 29)] {
            assert!((share(column, row) - expected).abs() < 2e-3, "{}", share(column, row));
        }
        let json = json(&falloff(&what).expect("vignetting"));
        assert!(json.contains("\"corner\": 0.5") && json.contains("\"a\": -0.25"), "{json}");
        assert_eq!(Degradation::default().degrade_colour(&grey, &CAMERA, 0), grey);
    }
}
