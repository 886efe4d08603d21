//! What of the camera the pictures tell, and how well.

use crate::bundle::Covariance;
use crate::grow::{adjust_all, refine};
use crate::scene::Scene;

/// A lens counts if pictures of a camera without one would seem to have as much in one of a hundred
/// cases: the 99th percentile of a sum of two squared normal numbers.
const SIGNIFICANT: f64 = 9.21;
/// With a lens the focal length must be known to this relative deviation, or be no more than so many
/// times less certain than without: with more, pinhole pictures of a camera that moved along a line were
/// given lenses, and focal lengths that were off by 5 and by 50 percent.
const CERTAIN: f64 = 0.005;
const LESS_CERTAIN: f64 = 1.5;

/// The keyframes alone, their camera let go once more, with its covariance.
pub(crate) fn released(scene: &Scene) -> (Scene, Option<Covariance>) {
    let keyframes: Vec<usize> =
        scene.tracks.keyframes.iter().copied().filter(|f| scene.poses[*f].is_some()).collect();
    let mut freed = scene.clone();
    for frame in 0..freed.poses.len() {
        if !keyframes.contains(&frame) {
            freed.poses[frame] = None;
        }
    }
    adjust_all(&mut freed, true);
    let covariance = freed.bundle(&keyframes, true).0.camera_covariance();
    (freed, covariance)
}

/// Gives up a lens that the pictures do not determine, so that it would make focal length and path worse:
/// one that is not told from none, one that leaves the focal length far less certain than without it
/// (where a camera moves along a line, the two make up for each other), and one of pictures whose rows
/// were read in turn, which bends what a turning camera sees much as a lens does. Returns whether it was
/// given up.
pub(crate) fn give_up_doubtful_lens(scene: &mut Scene, readout: f64) -> bool {
    if !scene.finds_lens || scene.lens == [0.0; 2] {
        return false;
    }
    let mut without = scene.clone();
    without.finds_lens = false;
    without.change_lens(scene.lens.map(|v| -v));
    refine(&mut without, true);
    let (freed, with_lens) = released(scene);
    let (_, alone) = released(&without);
    let is_told = readout == 0.0
        && with_lens.is_some_and(|with_lens| {
            is_significant(freed.lens, &with_lens) && leaves_focal_length(&with_lens, alone)
        });
    if !is_told {
        *scene = without;
    }
    !is_told
}

/// Whether the focal length stays about as certain beside a lens as `alone`.
fn leaves_focal_length(with_lens: &Covariance, alone: Option<Covariance>) -> bool {
    let deviation = |covariance: &Covariance| covariance[0][0].sqrt();
    let found = deviation(with_lens);
    found < CERTAIN || alone.is_some_and(|alone| found < LESS_CERTAIN * deviation(&alone))
}

/// Whether two coefficients differ from zero by more than chance, `lensᵀ Σ⁻¹ lens`.
fn is_significant(lens: [f64; 2], covariance: &Covariance) -> bool {
    let [_, [_, aa, ab], [_, _, bb]] = covariance;
    let [a, b] = lens;
    let determinant = aa * bb - ab * ab;
    let square = (a * a * bb - 2.0 * a * b * ab + b * b * aa) / determinant;
    determinant > 0.0 && square > SIGNIFICANT
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lens_must_leave_the_focal_length_certain() {
        let of = |deviation: f64| {
            let mut covariance = [[0.0; 3]; 3];
            covariance[0][0] = deviation * deviation;
            covariance
        };
        assert!(leaves_focal_length(&of(0.012), Some(of(0.01))));
        assert!(leaves_focal_length(&of(0.004), Some(of(0.001))));
        assert!(!leaves_focal_length(&of(0.012), Some(of(0.005))));
        assert!(!leaves_focal_length(&of(0.012), None));
    }

    #[test]
    fn a_lens_counts_by_its_own_covariance() {
        // Along (1, -1) hardly anything is known, along (1, 1) much.
        let covariance = [[1.0, 0.0, 0.0], [0.0, 1.01, -0.99], [0.0, -0.99, 1.01]];
        assert!(is_significant([0.4, 0.4], &covariance));
        assert!(!is_significant([0.4, -0.4], &covariance));
        assert!(!is_significant([0.0, 0.0], &covariance));
        assert!(!is_significant([0.4, 0.4], &[[0.0; 3]; 3]));
    }
}
