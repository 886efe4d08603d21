//! Points and directions, as many at a time as one instruction holds.

use super::Transform;
use super::block::Row;
use i2slam_compute::simd::{Lanes, Mask};
use i2slam_geometry::Vec3;
use pulp::Simd;

/// A point or direction for each lane.
#[derive(Clone, Copy)]
pub(super) struct Points<S: Simd> {
    pub(super) x: Lanes<S>,
    pub(super) y: Lanes<S>,
    pub(super) z: Lanes<S>,
}

impl<S: Simd> Points<S> {
    #[inline(always)]
    pub(super) fn splat(simd: S, point: Vec3<f32>) -> Self {
        Self {
            x: Lanes::splat(simd, point.x),
            y: Lanes::splat(simd, point.y),
            z: Lanes::splat(simd, point.z),
        }
    }

    #[inline(always)]
    pub(super) fn load_group(simd: S, rows: &[Row; 3], group: usize) -> Self {
        Self {
            x: Lanes::load_group(simd, &rows[0], group),
            y: Lanes::load_group(simd, &rows[1], group),
            z: Lanes::load_group(simd, &rows[2], group),
        }
    }

    #[inline(always)]
    pub(super) fn store_group(self, rows: &mut [Row; 3], group: usize) {
        self.x.store_group(&mut rows[0], group);
        self.y.store_group(&mut rows[1], group);
        self.z.store_group(&mut rows[2], group);
    }

    #[inline(always)]
    pub(super) fn to_array(self) -> [Lanes<S>; 3] {
        [self.x, self.y, self.z]
    }

    #[inline(always)]
    pub(super) fn scaled(self, factor: Lanes<S>) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    /// `self · factor + other`.
    #[inline(always)]
    pub(super) fn mul_add(self, factor: Lanes<S>, other: Self) -> Self {
        Self {
            x: self.x.mul_add(factor, other.x),
            y: self.y.mul_add(factor, other.y),
            z: self.z.mul_add(factor, other.z),
        }
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> Lanes<S> {
        self.x.mul_add(other.x, self.y.mul_add(other.y, self.z * other.z))
    }

    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub(super) fn select(mask: Mask<S>, yes: Self, no: Self) -> Self {
        Self {
            x: mask.select(yes.x, no.x),
            y: mask.select(yes.y, no.y),
            z: mask.select(yes.z, no.z),
        }
    }
}

impl Transform {
    /// Row `row` of the rotation, for each lane.
    #[inline(always)]
    pub(super) fn row<S: Simd>(&self, simd: S, row: usize) -> Points<S> {
        Points::splat(simd, Vec3::from_array(self.rotation.rows[row]))
    }

    #[inline(always)]
    pub(super) fn apply_lanes<S: Simd>(&self, simd: S, points: Points<S>) -> Points<S> {
        let translation = Points::splat(simd, self.translation);
        Points {
            x: self.row(simd, 0).dot(points) + translation.x,
            y: self.row(simd, 1).dot(points) + translation.y,
            z: self.row(simd, 2).dot(points) + translation.z,
        }
    }
}
