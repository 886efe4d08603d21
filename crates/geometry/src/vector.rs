//! Three-vectors and 3x3 matrices, generic over the scalar.

use crate::Real;
use std::ops::{Add, AddAssign, Index, IndexMut, Mul, Neg, Sub};

/// A column of three numbers: a point or a direction; variable names give the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec3<T> {
    /// First component (right, in a camera frame).
    pub x: T,
    /// Second component (down, in a camera frame).
    pub y: T,
    /// Third component (forward, in a camera frame).
    pub z: T,
}

impl<T: Real> Vec3<T> {
    /// A vector from its components.
    pub fn new(x: T, y: T, z: T) -> Self {
        Self { x, y, z }
    }

    /// The zero vector.
    pub fn zero() -> Self {
        Self::new(T::zero(), T::zero(), T::zero())
    }

    /// From an array `[x, y, z]`.
    pub fn from_array([x, y, z]: [T; 3]) -> Self {
        Self { x, y, z }
    }

    /// As an array `[x, y, z]`.
    pub fn to_array(self) -> [T; 3] {
        [self.x, self.y, self.z]
    }

    /// Inner product.
    pub fn dot(self, other: Self) -> T {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product `self × other`.
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Squared Euclidean length.
    pub fn norm_squared(self) -> T {
        self.dot(self)
    }

    /// Euclidean length.
    pub fn norm(self) -> T {
        self.norm_squared().sqrt()
    }

    /// Linear interpolation `(1 - u) self + u other`.
    pub fn lerp(self, other: Self, u: T) -> Self {
        self * (T::one() - u) + other * u
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(self) -> Vec3<U> {
        Vec3::new(U::of(self.x.to_f64()), U::of(self.y.to_f64()), U::of(self.z.to_f64()))
    }

    /// Whether no component is NaN or infinite.
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.z.is_finite()
    }
}

impl<T: Real> Add for Vec3<T> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl<T: Real> AddAssign for Vec3<T> {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<T: Real> Sub for Vec3<T> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl<T: Real> Neg for Vec3<T> {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl<T: Real> Mul<T> for Vec3<T> {
    type Output = Self;
    fn mul(self, s: T) -> Self {
        Self::new(self.x * s, self.y * s, self.z * s)
    }
}

/// A 3x3 matrix, row-major: `m.rows[row][column]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mat3<T> {
    /// The rows.
    pub rows: [[T; 3]; 3],
}

impl<T: Real> Mat3<T> {
    /// `a bᵀ`.
    pub fn outer(a: Vec3<T>, b: Vec3<T>) -> Self {
        Self { rows: a.to_array().map(|x| (b * x).to_array()) }
    }

    /// The identity.
    pub fn identity() -> Self {
        Self::diagonal(Vec3::new(T::one(), T::one(), T::one()))
    }

    /// The zero matrix.
    pub fn zero() -> Self {
        Self { rows: [[T::zero(); 3]; 3] }
    }

    /// A diagonal matrix.
    pub fn diagonal(d: Vec3<T>) -> Self {
        let o = T::zero();
        Self { rows: [[d.x, o, o], [o, d.y, o], [o, o, d.z]] }
    }

    /// The cross-product matrix `[v]×`, with `[v]× w = v × w`.
    pub fn skew(v: Vec3<T>) -> Self {
        let o = T::zero();
        Self { rows: [[o, -v.z, v.y], [v.z, o, -v.x], [-v.y, v.x, o]] }
    }

    /// The transposed matrix.
    pub fn transpose(&self) -> Self {
        let m = &self.rows;
        Self {
            rows: [
                [m[0][0], m[1][0], m[2][0]],
                [m[0][1], m[1][1], m[2][1]],
                [m[0][2], m[1][2], m[2][2]],
            ],
        }
    }

    /// The matrix with every entry multiplied by `s`.
    pub fn scaled(&self, s: T) -> Self {
        Self { rows: self.rows.map(|row| row.map(|v| v * s)) }
    }

    /// The determinant.
    pub fn determinant(&self) -> T {
        let [a, b, c] = self.rows.map(Vec3::from_array);
        a.dot(b.cross(c))
    }
}

impl<T: Real> Add for Mat3<T> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        let mut sum = self;
        for r in 0..3 {
            for c in 0..3 {
                sum.rows[r][c] += o.rows[r][c];
            }
        }
        sum
    }
}

impl<T: Real> Mul<Vec3<T>> for Mat3<T> {
    type Output = Vec3<T>;
    fn mul(self, v: Vec3<T>) -> Vec3<T> {
        let [a, b, c] = self.rows.map(Vec3::from_array);
        Vec3::new(a.dot(v), b.dot(v), c.dot(v))
    }
}

impl<T: Real> Mul for Mat3<T> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        let columns = o.transpose().rows.map(Vec3::from_array);
        Self { rows: self.rows.map(|row| columns.map(|c| Vec3::from_array(row).dot(c))) }
    }
}

impl<T> Index<(usize, usize)> for Mat3<T> {
    type Output = T;
    fn index(&self, (row, column): (usize, usize)) -> &T {
        &self.rows[row][column]
    }
}

impl<T> IndexMut<(usize, usize)> for Mat3<T> {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut T {
        &mut self.rows[row][column]
    }
}
