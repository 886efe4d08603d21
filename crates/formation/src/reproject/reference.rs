//! The readable lane: the same equations pixel by pixel, in `f32` or `f64`.

use super::band::Scene;
use super::ray_surface::{amplification, interpolate_in_time, intersect, search};
use super::upsample::{KERNEL, TAPS, neighbours};
use super::views::{Line, View};
use super::{ReprojectionGradient, TILE};
use crate::shutter::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image, Real};

/// [`Reprojection`](super::Reprojection) in plain code, for any scalar.
#[derive(Clone, Debug)]
pub struct ReferenceReprojection<T> {
    scene: Scene<T>,
    radiance: Image<T>,
}

/// One sample of the sharp render: position in the fine grid, held inside it.
struct Tap<T> {
    column: usize,
    row: usize,
    across: T,
    down: T,
    free_x: bool,
    free_y: bool,
}

impl<T: Real> ReferenceReprojection<T> {
    /// Takes the sharp `radiance` (3 planes) and `depth` (1 plane [m], 0 = unknown) as seen from
    /// `shutter.middle()` by `camera` with any margin; `readout` [exposures]: see
    /// [`Reprojection::blur`](super::Reprojection::blur).
    pub fn new(
        camera: &Camera<T>,
        shutter: &ShutterPoses<f64>,
        readout: f64,
        virtual_cameras: usize,
        quadrature: Quadrature,
        radiance: &Image<T>,
        depth: &Image<T>,
    ) -> Self {
        let mut scene = Scene::default();
        let plan = (virtual_cameras, quadrature);
        scene.set_views(camera, shutter, readout, plan, radiance.width);
        scene.set_depth(depth);
        Self { scene, radiance: radiance.clone() }
    }

    /// The average of what the virtual cameras see.
    pub fn blur(&self) -> Image<T> {
        let frame = self.scene.picture_camera();
        let mut blurred = Image::default();
        self.radiance.crop_into(self.scene.margin, &mut blurred);
        blurred.data.iter_mut().for_each(|v| *v *= self.scene.views.still_weight);
        self.for_each_tap(|view, (x, y), _, tap| {
            for channel in 0..3 {
                let value = self.corners(&tap).map(|(c, r)| self.fine(channel, c, r));
                let top = value[0] + (value[1] - value[0]) * tap.across;
                let bottom = value[2] + (value[3] - value[2]) * tap.across;
                let index = (channel * frame.height + y - self.scene.margin) * frame.width + x
                    - self.scene.margin;
                blurred.data[index] += view.1.weight * (top + (bottom - top) * tap.down);
            }
        });
        blurred
    }

    /// See [`Reprojection::uncovered`](super::Reprojection::uncovered).
    pub fn uncovered(&self) -> Vec<T> {
        let frame = self.scene.picture_camera();
        let columns = frame.width.div_ceil(TILE);
        let mut shares = vec![T::zero(); columns * frame.height.div_ceil(TILE)];
        let area = T::of((TILE * TILE) as f64);
        for y in 0..frame.height {
            for x in 0..frame.width {
                for view in self.scene.views.row(y + self.scene.margin) {
                    if self.lands(view, x + self.scene.margin, y + self.scene.margin).1 {
                        shares[y / TILE * columns + x / TILE] += view.weight / area;
                    }
                }
            }
        }
        shares
    }

    /// The cotangents of the sharp render, of the readout, and of the shutter poses relative to the
    /// middle.
    pub fn pull_back(&self, d_blurred: &Image<T>) -> (Image<T>, ReprojectionGradient) {
        let mut d_radiance = Image::default();
        d_blurred.embed_into(self.scene.margin, &mut d_radiance);
        d_radiance.data.iter_mut().for_each(|v| *v *= self.scene.views.still_weight);
        let height = d_blurred.height;
        let mut sums = vec![[0.0; 6]; self.scene.views.sums(0, height).1];
        self.for_each_tap(|(k, view), (x, y), w, tap| {
            let (mut gx, mut gy) = (T::zero(), T::zero());
            for channel in 0..3 {
                let d = d_blurred.at(channel, x - self.scene.margin, y - self.scene.margin)
                    * view.weight;
                let [a, b, c, e] = self.corners(&tap).map(|(c, r)| self.fine(channel, c, r));
                gx += d * ((b - a) * (T::one() - tap.down) + (e - c) * tap.down);
                gy += d * ((c - a) * (T::one() - tap.across) + (e - b) * tap.across);
                self.scatter(&mut d_radiance, channel, &tap, d);
            }
            let two = T::of(2.0);
            let free = |g: T, free: bool| if free { g * two } else { T::zero() };
            let g = (free(gx, tap.free_x), free(gy, tap.free_y));
            let share = self.share(view, (x, y), w, g);
            sums[self.scene.views.sums(y - self.scene.margin, height).0 + k]
                .iter_mut()
                .zip(share)
                .for_each(|(sum, s)| *sum += s.to_f64());
        });
        (d_radiance, self.scene.views.pull_back(&self.scene.shutter, &sums))
    }

    /// Visits every tap of every pixel of the picture, by its place in the render.
    fn for_each_tap(&self, mut visit: impl FnMut((usize, &View<T>), (usize, usize), T, Tap<T>)) {
        for y in self.scene.margin..self.scene.camera.height - self.scene.margin {
            for x in self.scene.margin..self.scene.camera.width - self.scene.margin {
                for (k, view) in self.scene.views.row(y).iter().enumerate() {
                    let (w, _) = self.lands(view, x, y);
                    let tap = self.tap(self.line(view, x, y).at(w));
                    visit((k, view), (x, y), w, tap);
                }
            }
        }
    }

    fn line(&self, view: &View<T>, x: usize, y: usize) -> Line<T> {
        let (px, py) = Camera::pixel_centre(x, y);
        view.line(&self.scene.camera, view.direction(px, py))
    }

    /// The inverse depth that a pixel sees, and whether the render hides it.
    fn lands(&self, view: &View<T>, x: usize, y: usize) -> (T, bool) {
        let own = self.scene.surface.row(y)[x];
        let bounds = self.scene.surface.blocks.search_bounds(x, y);
        if let Some(bounds) = bounds.filter(|bounds| bounds.bend > view.steep) {
            return search(&self.scene.surface, &self.line(view, x, y), bounds, own);
        }
        let intersect_from =
            |view, guess| intersect(&self.scene.surface, &self.line(view, x, y), guess);
        if self.scene.views.rolling {
            return (intersect_from(view, intersect_from(view, own)), false);
        }
        let row = self.scene.views.row(y);
        let at_end = |end: usize| intersect_from(&row[end], own);
        (interpolate_in_time(at_end(0), own, at_end(row.len() - 1), view.moment), false)
    }

    /// The cotangent of the view's pose from that of the position [per px].
    fn share(&self, view: &View<T>, (x, y): (usize, usize), w: T, (gx, gy): (T, T)) -> [T; 6] {
        let (px, py) = Camera::pixel_centre(x, y);
        let direction = view.direction(px, py);
        let line = view.line(&self.scene.camera, direction);
        let facet = self.scene.surface.facets(y)[x];
        let smooth = self.scene.surface.blocks.search_bounds(x, y).is_none();
        let slope = |s: T| if smooth { s } else { T::zero() };
        let (slope_x, slope_y) = (slope(facet.slope_x), slope(facet.slope_y));
        let along =
            (gx * line.ex + gy * line.ey) * amplification(slope_x, slope_y, line.ex, line.ey);
        let gx = (gx + slope_x * along) * self.scene.camera.fx;
        let gy = (gy + slope_y * along) * self.scene.camera.fy;
        view.share(direction, w, gx, gy)
    }

    fn tap(&self, (x, y): (T, T)) -> Tap<T> {
        let hold = |position: T, size: usize| {
            let most = T::of((2 * size - 2) as f64);
            let fine = T::of(2.0) * position - T::one();
            let held = fine.max(T::zero()).min(most);
            let index = held.to_usize().unwrap_or(0);
            (index, held - T::of(index as f64), fine >= T::zero() && fine <= most)
        };
        let (column, across, free_x) = hold(x, self.scene.camera.width);
        let (row, down, free_y) = hold(y, self.scene.camera.height);
        Tap { column, row, across, down, free_x, free_y }
    }

    fn corners(&self, tap: &Tap<T>) -> [(usize, usize); 4] {
        let (c, r) = (tap.column, tap.row);
        [(c, r), (c + 1, r), (c, r + 1), (c + 1, r + 1)]
    }

    /// The pixels and weights along one axis that sample `index` of the fine grid is made of.
    fn made_of(&self, index: usize, size: usize) -> [(usize, T); TAPS] {
        let pixels = neighbours(index / 2, size);
        let mut weights = KERNEL.map(|w| T::of(f64::from(w)));
        if index.is_multiple_of(2) {
            weights = [T::zero(); TAPS];
            weights[2] = T::one();
        }
        std::array::from_fn(|k| (pixels[k], weights[k]))
    }

    fn fine(&self, channel: usize, column: usize, row: usize) -> T {
        let columns = self.made_of(column, self.scene.camera.width);
        let mut sum = T::zero();
        for (r, by_row) in self.made_of(row, self.scene.camera.height) {
            for (c, by_column) in columns {
                sum += by_row * by_column * self.radiance.at(channel, c, r);
            }
        }
        sum
    }

    fn scatter(&self, d_radiance: &mut Image<T>, channel: usize, tap: &Tap<T>, d: T) {
        let (width, height) = (self.scene.camera.width, self.scene.camera.height);
        for (i, (column, row)) in self.corners(tap).into_iter().enumerate() {
            let across = if i % 2 == 0 { T::one() - tap.across } else { tap.across };
            let down = if i < 2 { T::one() - tap.down } else { tap.down };
            for (r, by_row) in self.made_of(row, height) {
                for (c, by_column) in self.made_of(column, width) {
                    d_radiance.data[(channel * height + r) * width + c] +=
                        d * across * down * by_row * by_column;
                }
            }
        }
    }
}
