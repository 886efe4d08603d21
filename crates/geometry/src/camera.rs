//! The pinhole camera.
//!
//! Camera axes are OpenCV's: x right, y down, z forward. Pixel (column `i`, row `j`) covers
//! `[i, i+1) x [j, j+1)` and is sampled at its centre `(i + 0.5, j + 0.5)`: an image keeps its
//! principal point under scaling, `c' = s c`. Intrinsics given for pixel centres at integers
//! (OpenCV, TUM) enter with 0.5 added to `cx` and `cy`.

use crate::{Real, Vec3};

/// Pinhole intrinsics of an undistorted image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera<T> {
    /// Image width [px].
    pub width: usize,
    /// Image height [px].
    pub height: usize,
    /// Focal length along a row [px].
    pub fx: T,
    /// Focal length along a column [px].
    pub fy: T,
    /// Principal point, horizontal [px], measured from the left edge of the first pixel.
    pub cx: T,
    /// Principal point, vertical [px], measured from the top edge of the first pixel.
    pub cy: T,
}

impl<T: Real> Camera<T> {
    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// The image position `(u, v)` of a point in the camera frame. `z` must not be zero.
    pub fn project(&self, point_in_camera: Vec3<T>) -> (T, T) {
        let p = point_in_camera;
        (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy)
    }

    /// The point at depth `z` (along the optical axis, not along the ray) seen at `(u, v)`.
    pub fn unproject(&self, u: T, v: T, z: T) -> Vec3<T> {
        Vec3::new((u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z)
    }

    /// The centre of pixel (`column`, `row`) in image coordinates.
    pub fn pixel_centre(column: usize, row: usize) -> (T, T) {
        (T::of(column as f64 + 0.5), T::of(row as f64 + 0.5))
    }

    /// Horizontal field of view [rad].
    pub fn horizontal_field_of_view(&self) -> f64 {
        let [fx, cx] = [self.fx, self.cx].map(Real::to_f64);
        (cx / fx).atan() + ((self.width as f64 - cx) / fx).atan()
    }

    /// The camera of the image resized to `width x height`.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let sx = T::of(width as f64 / self.width as f64);
        let sy = T::of(height as f64 / self.height as f64);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
        }
    }

    /// The camera of the image with `border` pixels removed on every side.
    pub fn cropped(&self, border: usize) -> Self {
        Self {
            width: self.width.saturating_sub(border.saturating_mul(2)),
            height: self.height.saturating_sub(border.saturating_mul(2)),
            cx: self.cx - T::of(border as f64),
            cy: self.cy - T::of(border as f64),
            ..*self
        }
    }

    /// The camera of the image with `margin` pixels more on every side.
    pub fn widened(&self, margin: usize) -> Self {
        Self {
            width: self.width + 2 * margin,
            height: self.height + 2 * margin,
            cx: self.cx + T::of(margin as f64),
            cy: self.cy + T::of(margin as f64),
            ..*self
        }
    }

    /// Whether `(u, v)` lies inside the image, at least `border` pixels from its edge.
    pub fn contains(&self, u: T, v: T, border: T) -> bool {
        u >= border
            && v >= border
            && u < T::of(self.width as f64) - border
            && v < T::of(self.height as f64) - border
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> Camera<U> {
        Camera {
            width: self.width,
            height: self.height,
            fx: U::of(self.fx.to_f64()),
            fy: U::of(self.fy.to_f64()),
            cx: U::of(self.cx.to_f64()),
            cy: U::of(self.cy.to_f64()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_right_angle_is_twice_the_focal_length_wide() {
        let camera = Camera { width: 200, height: 100, fx: 100.0, fy: 100.0, cx: 100.0, cy: 50.0 };
        assert!((camera.horizontal_field_of_view().to_degrees() - 90.0).abs() < 1e-12);
        let shifted = Camera { cx: 0.0, ..camera };
        assert!((shifted.horizontal_field_of_view() - 2.0_f64.atan()).abs() < 1e-12);
    }

    fn example() -> Camera<f64> {
        Camera { width: 640, height: 480, fx: 517.3, fy: 516.5, cx: 319.1, cy: 255.8 }
    }

    #[test]
    fn unproject_inverts_project() {
        let p = Vec3::new(0.3, -0.2, 1.7);
        let (u, v) = example().project(p);
        assert!((example().unproject(u, v, p.z) - p).norm() < 1e-12);
    }

    #[test]
    fn a_margin_shifts_image_positions_and_is_cropped_again() {
        let p = Vec3::new(0.3, -0.2, 1.7);
        let (u, v) = example().project(p);
        assert_eq!(example().widened(8).project(p), (u + 8.0, v + 8.0));
        assert_eq!(example().widened(8).cropped(8), example());
        let nothing = example().cropped(usize::MAX);
        assert_eq!((nothing.width, nothing.height), (0, 0));
    }

    #[test]
    fn resizing_scales_image_positions() {
        let p = Vec3::new(0.3, -0.2, 1.7);
        let (u, v) = example().project(p);
        let (us, vs) = example().resized(320, 240).project(p);
        assert!((us * 2.0 - u).abs() < 1e-12 && (vs * 2.0 - v).abs() < 1e-12);
    }
}
