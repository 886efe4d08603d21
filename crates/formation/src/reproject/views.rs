//! Virtual cameras relative to the sharp render: the line of a pixel's ray in that render.

use super::ReprojectionGradient;
use super::surface::steep;
use crate::shutter::{
    CentreVelocity, Quadrature, ShutterPoses, ShutterTangent, VirtualCamera, row_place,
};
use i2slam_geometry::{Camera, Mat3, Real, Tangent, Vec3};

/// A virtual camera that is not the middle of the exposure.
///
/// A pixel `p` of it sees, in the frame of the sharp render, the points `X(w)` at inverse depth
/// `w = 1/z`. With `(a, b, 1) ~ R K⁻¹ p` they lie at
///
/// ```text
/// X/z = (a + (t_x - a t_z) w,  b + (t_y - b t_z) w,  1)
/// ```
///
/// a straight line in the image, walked evenly in `w`: `q(w) = q_∞ + e w`.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<T> {
    /// Moment of the exposure of the middle row: 0 to 1, beyond where rows are read in turn.
    u: T,
    /// Place of its row, from the top edge (-½) to the bottom edge (½); 0 if it serves all rows.
    place: T,
    /// Moment measured from the middle, in units of that of the last view: -1 to 1.
    pub(super) moment: T,
    /// Share of the exposure.
    pub(super) weight: T,
    /// Bends of inverse depth up to this [1/m] move too little to be searched.
    pub(super) steep: T,
    /// `R K⁻¹`: pixel to ray in the frame of the sharp render.
    ray_from_pixel: Mat3<T>,
    /// `R = R_mᵀ R_v`.
    rotation: Mat3<T>,
    /// `t = R_mᵀ (t_v - t_m)` [m].
    translation: Vec3<T>,
}

/// A pixel's line in the sharp render, `q(w) = (x, y) + (e_x, e_y) w` [px], w in 1/m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<T> {
    /// End of the ray at infinity [px].
    pub(super) x: T,
    pub(super) y: T,
    /// Motion per unit of inverse depth [px m].
    pub(super) ex: T,
    pub(super) ey: T,
}

impl<T: Real> Line<T> {
    /// The position at inverse depth `w` [px].
    #[inline(always)]
    pub(super) fn at(&self, w: T) -> (T, T) {
        (self.x + self.ex * w, self.y + self.ey * w)
    }
}

impl<T: Real> View<T> {
    fn new(
        camera: &Camera<f64>,
        shutter: &ShutterPoses<f64>,
        virtual_camera: &VirtualCamera<f64>,
        last: f64,
        place: f64,
    ) -> Self {
        let relative = shutter.middle().inverse() * virtual_camera.world_from_camera;
        let rotation = relative.rotation.matrix();
        Self {
            u: T::of(virtual_camera.u),
            place: T::of(place),
            moment: T::of((virtual_camera.u - 0.5) / last),
            weight: T::of(virtual_camera.weight),
            steep: T::infinity(),
            ray_from_pixel: cast(&(rotation * ray_from_pixel(camera))),
            rotation: cast(&rotation),
            translation: relative.translation.cast(),
        }
    }

    /// `(a, b)`: normalised image coordinates of the ray of the pixel at (`x`, `y`) [px].
    #[inline(always)]
    pub(super) fn direction(&self, x: T, y: T) -> (T, T) {
        let r = &self.ray_from_pixel.rows;
        let [rx, ry, rz] = [
            r[0][0] * x + (r[0][1] * y + r[0][2]),
            r[1][0] * x + (r[1][1] * y + r[1][2]),
            r[2][0] * x + (r[2][1] * y + r[2][2]),
        ];
        let scale = T::one() / rz;
        (rx * scale, ry * scale)
    }

    /// The line of the ray with direction `(a, b)`.
    #[inline(always)]
    pub(super) fn line(&self, camera: &Camera<T>, (a, b): (T, T)) -> Line<T> {
        let t = self.translation;
        Line {
            x: camera.fx * a + camera.cx,
            y: camera.fy * b + camera.cy,
            ex: camera.fx * (t.x - a * t.z),
            ey: camera.fy * (t.y - b * t.z),
        }
    }

    /// The largest motion per unit of inverse depth at the image's corners [px m].
    fn parallax(&self, camera: &Camera<T>) -> T {
        self.over_corners(camera, |line, _| (line.ex * line.ex + line.ey * line.ey).sqrt())
    }

    /// See [`Views::reach`].
    fn reach(&self, camera: &Camera<T>, nearest: T) -> T {
        self.over_corners(camera, |line, (x, y)| {
            let distance = |w: T| (line.at(w).0 - x).hypot(line.at(w).1 - y);
            distance(T::zero()).max(distance(nearest))
        })
    }

    fn over_corners(&self, camera: &Camera<T>, measure: impl Fn(Line<T>, (T, T)) -> T) -> T {
        let (w, h) = (T::of(camera.width as f64), T::of(camera.height as f64));
        let corners = [(T::zero(), T::zero()), (w, T::zero()), (T::zero(), h), (w, h)];
        corners.iter().fold(T::zero(), |most, &(x, y)| {
            most.max(measure(self.line(camera, self.direction(x, y)), (x, y)))
        })
    }

    /// The six sums' share of one pixel: the cotangent of `(t, ψ)`, where ψ turns `R` on the left,
    /// from the cotangent `(gx, gy)` of `X/z` at inverse depth `w`.
    #[inline(always)]
    pub(super) fn share(&self, (a, b): (T, T), w: T, gx: T, gy: T) -> [T; 6] {
        let one = T::one();
        let along = one - self.translation.z * w;
        let (ga, gb) = (gx * along, gy * along);
        [
            gx * w,
            gy * w,
            -(a * gx + b * gy) * w,
            -(a * b * ga + (one + b * b) * gb),
            (one + a * a) * ga + a * b * gb,
            a * gb - b * ga,
        ]
    }
}

/// All virtual cameras of one exposure.
#[derive(Clone, Debug)]
pub(super) struct Views<T> {
    /// Those that are not in the middle, in order of time: one set for all rows, or, where rows
    /// are read in turn, one for each row after another.
    moving: Vec<View<T>>,
    /// Size of a set.
    count: usize,
    /// True if every row of the picture has a set of its own.
    pub(super) rolling: bool,
    /// Rows of the render above the picture.
    margin: usize,
    /// Share of the exposure that the sharp render itself stands for.
    pub(super) still_weight: T,
}

impl<T: Real> Default for Views<T> {
    fn default() -> Self {
        Self { moving: Vec::new(), count: 0, rolling: false, margin: 0, still_weight: T::one() }
    }
}

impl<T: Real> Views<T> {
    /// Moving views of one row.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The moving views of row `y` of the render, in order of time.
    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[View<T>] {
        let from = if self.rolling { (y - self.margin) * self.count } else { 0 };
        &self.moving[from..from + self.count]
    }

    /// Index of the first sum of the views of row `row`, and the number of sums of `rows` rows;
    /// rows of the picture.
    pub(super) fn sums(&self, row: usize, rows: usize) -> (usize, usize) {
        if self.rolling { (row * self.count, rows * self.count) } else { (0, self.count) }
    }

    /// For a render by `camera`, which ends `margin` pixels beyond the picture. Computed in `f64`,
    /// kept in `T`; keeps its allocation. A `readout` [exposures] that is zero
    /// or not finite is a global shutter.
    pub(super) fn update(
        &mut self,
        (camera, margin): (&Camera<T>, usize),
        shutter: &ShutterPoses<f64>,
        readout: f64,
        cameras: usize,
        quadrature: Quadrature,
    ) {
        self.moving.clear();
        self.still_weight = T::zero();
        self.rolling = readout != 0.0 && readout.is_finite();
        self.margin = margin;
        let cameras = || shutter.each_virtual_camera(cameras, quadrature);
        let wide = camera.cast();
        if self.rolling {
            let height = camera.height - 2 * margin;
            for place in (0..height).map(|row| row_place(row, height)) {
                for virtual_camera in cameras() {
                    let u = virtual_camera.u + readout * place;
                    let pose = shutter.at(u);
                    let moved = VirtualCamera { u, world_from_camera: pose, ..virtual_camera };
                    self.moving.push(View::new(&wide, shutter, &moved, 1.0, place));
                }
            }
            self.count = cameras().count();
        } else {
            let last = cameras().next_back().map_or(1.0, |c| c.u) - 0.5;
            for virtual_camera in cameras() {
                if (virtual_camera.u - 0.5).abs() < 1e-9 {
                    self.still_weight += T::of(virtual_camera.weight);
                } else {
                    self.moving.push(View::new(&wide, shutter, &virtual_camera, last, 0.0));
                }
            }
            self.count = self.moving.len();
        }
        for view in &mut self.moving {
            view.steep = steep(view.parallax(camera));
        }
    }

    /// The largest motion per unit of inverse depth at the image's corners, over all views [px m].
    pub(super) fn largest_parallax(&self, camera: &Camera<T>) -> T {
        self.moving.iter().fold(T::zero(), |most, view| most.max(view.parallax(camera)))
    }

    /// Largest distance from a corner of the image to the place that it sees, at inverse depths
    /// up to `nearest`, over all views [px].
    pub(super) fn reach(&self, camera: &Camera<T>, nearest: T) -> T {
        self.moving.iter().fold(T::zero(), |most, view| most.max(view.reach(camera, nearest)))
    }

    /// Carries the six sums of every moving view to the two shutter poses and the readout.
    ///
    /// `R` and `t` are those of `middle⁻¹ · virtual`: tangents `(ρ_v, φ_v)` of the virtual camera
    /// and `(ρ_m, φ_m)` of the middle change them by `ψ = R φ_v - φ_m` and `δt = R ρ_v - ρ_m + t ×
    /// φ_m`; the middle itself moves with both shutter poses. The readout moves a row's moments by
    /// `∂u/∂readout = place`, and with `u` a camera moves by `(R(u)ᵀ (t_e - t_s), ω)`.
    pub(super) fn pull_back(
        &self,
        shutter: &ShutterPoses<f64>,
        sums: &[[f64; 6]],
    ) -> ReprojectionGradient {
        let (mut total, mut d_readout) = (ShutterTangent::zero(), 0.0);
        let mut d_middle = Tangent::zero();
        let CentreVelocity { velocity, .. } = CentreVelocity::from(*shutter);
        for (view, sum) in self.moving.iter().zip(sums) {
            let d_t = Vec3::new(sum[0], sum[1], sum[2]);
            let d_psi = Vec3::new(sum[3], sum[4], sum[5]);
            let transposed = cast::<T, f64>(&view.rotation).transpose();
            let d_view = Tangent { translation: transposed * d_t, rotation: transposed * d_psi };
            total = total.plus(shutter.pull_back(view.u.to_f64(), d_view));
            let speed = transposed * velocity.translation;
            d_readout += view.place.to_f64()
                * (d_view.translation.dot(speed) + d_view.rotation.dot(velocity.rotation));
            let turned = d_t.cross(view.translation.cast());
            d_middle = d_middle.plus(Tangent { translation: -d_t, rotation: turned - d_psi });
        }
        let shutter = total.plus(shutter.pull_back(0.5, d_middle));
        ReprojectionGradient { shutter, readout: d_readout }
    }
}

fn ray_from_pixel(camera: &Camera<f64>) -> Mat3<f64> {
    Mat3 {
        rows: [
            [1.0 / camera.fx, 0.0, -camera.cx / camera.fx],
            [0.0, 1.0 / camera.fy, -camera.cy / camera.fy],
            [0.0, 0.0, 1.0],
        ],
    }
}

fn cast<T: Real, U: Real>(m: &Mat3<T>) -> Mat3<U> {
    Mat3 { rows: m.rows.map(|row| row.map(|v| U::of(v.to_f64()))) }
}
