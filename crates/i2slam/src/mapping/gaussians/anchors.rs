//! Frames that brought the Gaussians, with which these move when poses are corrected.

use super::optimizer::GaussianOptimizer;
use i2slam_geometry::{Pose, Rotation, Vec3};
use i2slam_radiance::gaussian::GaussianMap;
use std::collections::{BTreeMap, BTreeSet};

/// Index of the frame that brought each Gaussian of a map.
#[derive(Clone, Debug, Default)]
pub(super) struct Anchors(Vec<usize>);

impl Anchors {
    /// Anchors the Gaussians that were appended to a map of `count` ones to a frame.
    pub(super) fn extend_to(&mut self, count: usize, frame: usize) {
        self.0.resize(count, frame);
    }

    /// Appends Gaussians anchored as these ones.
    pub(super) fn inherit(&mut self, parents: &[usize]) {
        let anchors: Vec<usize> = parents.iter().map(|&parent| self.0[parent]).collect();
        self.0.extend(anchors);
    }

    /// Drops the anchors of removed Gaussians.
    pub(super) fn retain(&mut self, keep: &[bool]) {
        let mut kept = keep.iter();
        self.0.retain(|_| kept.next().is_some_and(|&kept| kept));
    }

    /// Mask of the Gaussians whose frame is not one of `frames`.
    pub(super) fn outside(&self, frames: &BTreeSet<usize>) -> Vec<bool> {
        self.0.iter().map(|frame| !frames.contains(frame)).collect()
    }

    /// Changes every colour by `change`, of the place of its frame and the colour. `places` has the
    /// indices of frames; others count as the first.
    pub(super) fn change_colours(
        &self,
        places: &BTreeMap<usize, usize>,
        map: &mut GaussianMap,
        change: &dyn Fn(usize, [f32; 3]) -> [f32; 3],
    ) {
        for (colour, frame) in map.colours.iter_mut().zip(&self.0) {
            *colour = change(places.get(frame).copied().unwrap_or(0), *colour);
        }
    }

    /// Moves every Gaussian by the motion of its frame in the world, with the moments of its
    /// optimiser; those of other frames stay.
    pub(super) fn apply_motions(
        &self,
        motions: &BTreeMap<usize, Pose<f64>>,
        map: &mut GaussianMap,
        optimizer: &mut GaussianOptimizer,
    ) {
        for (gaussian, frame) in self.0.iter().enumerate() {
            let Some(motion) = motions.get(frame) else { continue };
            let mean = Vec3::from_array(map.means[gaussian]).cast::<f64>();
            map.means[gaussian] = (*motion * mean).cast::<f32>().to_array();
            let rotation: Rotation<f32> = motion.rotation.cast();
            let product = left_product(rotation);
            let quaternion = map.rotations[gaussian];
            map.rotations[gaussian] =
                product.map(|row| row.iter().zip(quaternion).map(|(p, q)| p * q).sum());
            map.view_colours.rotate(gaussian, rotation);
            optimizer.rotate(gaussian, &rotation.matrix().rows, &product);
        }
    }
}

/// Matrix `L` of a quaternion `p`, w, x, y, z: `p q = L q`.
fn left_product(rotation: Rotation<f32>) -> [[f32; 4]; 4] {
    let (w, [x, y, z]) = (rotation.w, rotation.v.to_array());
    [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_radiance::gaussian::{ColourActivation, Gaussian, Shape};

    #[test]
    fn colours_change_by_the_frame_that_brought_them() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        for x in 0..3 {
            map.push(Gaussian {
                mean: [x as f32, 0.0, 1.0],
                log_scale: [-3.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 1.0,
                colour: [x as f32, 0.5, -0.5],
            });
        }
        let mut anchors = Anchors::default();
        anchors.extend_to(1, 4);
        anchors.extend_to(2, 9);
        anchors.extend_to(3, 5);
        // The index of the second is unknown.
        let places = BTreeMap::from([(4, 1), (5, 2)]);
        let change = |place: usize, colour: [f32; 3]| colour.map(|c| 2.0 * c + place as f32);
        anchors.change_colours(&places, &mut map, &change);
        assert_eq!(map.colours, [[1.0, 2.0, 0.0], [2.0, 1.0, -1.0], [6.0, 3.0, 1.0]]);
    }

    #[test]
    fn gaussians_move_with_their_frame_alone() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        let own = Rotation::exp(Vec3::new(0.3, -0.2, 0.5));
        for x in 0..3 {
            map.push(Gaussian {
                mean: [x as f32, 1.0, 2.0],
                log_scale: [-3.0; 3],
                rotation: [own.w, own.v.x, own.v.y, own.v.z],
                opacity_logit: 0.0,
                colour: [0.5; 3],
            });
        }
        let mut anchors = Anchors::default();
        anchors.extend_to(1, 4);
        anchors.extend_to(3, 7);
        assert_eq!(anchors.outside(&BTreeSet::from([4, 9])), [false, true, true]);
        anchors.retain(&[true, false, true]);
        map.retain(&[true, false, true]);
        let before = map.clone();
        let motion = Pose::new(Rotation::exp(Vec3::new(0.0, 0.7, 0.1)), Vec3::new(0.1, -0.2, 0.3));
        let mut optimizer = GaussianOptimizer::new();
        anchors.apply_motions(&BTreeMap::from([(7, motion)]), &mut map, &mut optimizer);
        assert_eq!((map.means[0], map.rotations[0]), (before.means[0], before.rotations[0]));
        let mean = motion * Vec3::new(2.0, 1.0, 2.0);
        let off = Vec3::from_array(map.means[1]).cast::<f64>() - mean;
        assert!(off.norm() < 1e-6);
        let [w, x, y, z] = map.rotations[1].map(f64::from);
        let turned = Rotation::from_wxyz(w, x, y, z).expect("a rotation");
        let due = motion.rotation.matrix() * own.cast::<f64>().matrix();
        let found = turned.matrix();
        let differences = found.rows.as_flattened().iter().zip(due.rows.as_flattened());
        assert!(differences.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-6);
    }
}
