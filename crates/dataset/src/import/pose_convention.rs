//! Pose conventions: direction, camera axes and quaternion order.

use super::ImportFormat;
use i2slam_geometry::{Pose, Rotation, Vec3};

/// Deviation of a file's poses from the convention of its format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseConvention {
    /// Inverted: `world_from_camera` for `camera_from_world` or vice versa.
    inverse: bool,
    /// Camera axes of OpenGL for those of OpenCV or vice versa.
    axes: bool,
    /// Quaternions w x y z for x y z w.
    pub(super) order: bool,
}

impl PoseConvention {
    /// All conventions, that of the format first, the simplest before others.
    pub(super) const ALL: [Self; 8] = [
        Self::new(false, false, false),
        Self::new(true, false, false),
        Self::new(false, true, false),
        Self::new(false, false, true),
        Self::new(true, true, false),
        Self::new(true, false, true),
        Self::new(false, true, true),
        Self::new(true, true, true),
    ];

    pub(super) const fn new(inverse: bool, axes: bool, order: bool) -> Self {
        Self { inverse, axes, order }
    }

    /// Reinterprets a pose that was read by the convention of the format.
    pub(super) fn reinterpret(
        self,
        world_from_camera: Pose<f64>,
        format: ImportFormat,
    ) -> Pose<f64> {
        let is_inverse = matches!(format, ImportFormat::Colmap | ImportFormat::Droid);
        let mut pose = if is_inverse { world_from_camera.inverse() } else { world_from_camera };
        if self.order {
            let Rotation { w, v } = pose.rotation;
            let reordered = Rotation::from_wxyz(v.x, v.y, v.z, w);
            pose.rotation = reordered.unwrap_or(pose.rotation);
        }
        if is_inverse != self.inverse {
            pose = pose.inverse();
        }
        if self.axes {
            let half_turn = Rotation { w: 0.0, v: Vec3::new(1.0, 0.0, 0.0) };
            pose.rotation = pose.rotation * half_turn;
        }
        pose
    }

    /// Description for messages.
    pub(super) fn description(self, format: ImportFormat) -> String {
        let inverse = match format {
            ImportFormat::Colmap | ImportFormat::Droid => "world_from_camera",
            ImportFormat::Nerfstudio | ImportFormat::Trajectory => "camera_from_world",
        };
        let axes = match format {
            ImportFormat::Nerfstudio => "camera axes of OpenCV (y down, z forwards)",
            _ => "camera axes of OpenGL (y up, z backwards)",
        };
        let parts = [
            (self.inverse, inverse),
            (self.axes, axes),
            (self.order, "quaternions in the order w x y z"),
        ];
        let parts: Vec<&str> = parts.into_iter().filter(|part| part.0).map(|part| part.1).collect();
        parts.join(" with ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reinterpretation_undoes_other_conventions() {
        let pose = Pose::new(Rotation::exp(Vec3::new(0.4, -0.2, 0.9)), Vec3::new(1.0, -2.0, 0.5));
        let near = |a: Pose<f64>, b: Pose<f64>| {
            let apart = a.local(b);
            assert!(apart.translation.norm() + apart.rotation.norm() < 1e-12, "{a:?} {b:?}");
        };
        for format in ImportFormat::ALL {
            near(PoseConvention::ALL[0].reinterpret(pose, format), pose);
            near(PoseConvention::new(true, false, false).reinterpret(pose.inverse(), format), pose);
        }
        // A file with w x y z, read as x y z w.
        let Rotation { w, v } = pose.rotation;
        let misread = Rotation::from_wxyz(v.z, w, v.x, v.y).expect("a rotation");
        let misread = Pose::new(misread, pose.translation);
        near(
            PoseConvention::new(false, false, true).reinterpret(misread, ImportFormat::Trajectory),
            pose,
        );
    }
}
