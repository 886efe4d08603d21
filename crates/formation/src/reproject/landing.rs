//! Where a ray of a virtual camera lands on the surface that the sharp render shows.

use super::blocks::{Block, larger};
use super::surface::{Facet, Surface};
use super::views::Line;
use i2slam_geometry::Real;

/// At most this many samples along a line.
const STEPS: u32 = 32;

/// A ray nearly along a surface is treated as if `1 - slope · e` were at least this.
const GRAZING: f64 = 0.1;

/// `1 / (1 - slope · e)`, the amplification of motion by a slanted surface, bounded.
#[inline(always)]
pub(super) fn amplification<T: Real>(slope_x: T, slope_y: T, ex: T, ey: T) -> T {
    T::one() / larger(T::one() - (slope_x * ex + slope_y * ey), T::of(GRAZING))
}

/// One step of the fixed point `w = W(q(w))`, by Newton's method: the line cut with the plane of
/// the pixel that lies at the guess. Exact when that pixel is on the same flat surface.
#[inline(always)]
pub(super) fn land<T: Real>(surface: &Surface<T>, line: &Line<T>, guess: T) -> T {
    let (x, y) = line.at(guess);
    let (facet, cx, cy) = surface.facet_at(x, y);
    cut(&facet, (line.x - cx, line.y - cy), (line.ex, line.ey))
}

/// Where a line that ends at infinity at `(from_x, from_y)` [px from the centre of the facet] and
/// moves by `(ex, ey)` per unit of inverse depth meets the facet's plane.
#[inline(always)]
pub(super) fn cut<T: Real>(facet: &Facet<T>, (from_x, from_y): (T, T), (ex, ey): (T, T)) -> T {
    let at_infinity = facet.value + facet.slope_x * from_x + facet.slope_y * from_y;
    let w = at_infinity * amplification(facet.slope_x, facet.slope_y, ex, ey);
    larger(w, T::zero())
}

/// The inverse depth seen at `moment` (-1 to 1) by a pixel whose rays land at `first` at -1, at
/// `middle` at 0 and at `last` at 1: the parabola through the three.
#[inline(always)]
pub(super) fn between<T: Real>(first: T, middle: T, last: T, moment: T) -> T {
    let half = T::of(0.5);
    let (slope, bend) = ((last - first) * half, (last + first) * half - middle);
    middle + moment * (slope + moment * bend)
}

/// The nearest surface on a line, among steps in depth.
///
/// The line is walked from the nearest inverse depth around to the farthest, at most a pixel at a
/// time. The first sample that lies on the surface (within 0.6 of a step) is what the virtual
/// camera sees, refined by [`land`]; samples in front of the surface are empty space, and those
/// behind it are hidden from the sharp render. If the walk ends hidden, the virtual camera sees
/// background that the sharp render does not show ([`Walk::beside`]), and `true` says so.
pub(super) fn search<T: Real>(
    surface: &Surface<T>,
    line: &Line<T>,
    bounds: Block<T>,
    own: T,
) -> (T, bool) {
    let (nearest, farthest) = (bounds.nearest, bounds.farthest);
    let (count, step) = Walk::steps(line.ex, line.ey, nearest, farthest);
    if count == 0 {
        return (land(surface, line, own), false);
    }
    let mut walk = Walk { nearest, farthest, step, count, in_front: None, occluder: nearest };
    for k in 0..=count {
        let w = walk.at(k);
        let seen = sample(surface, line, w);
        if Walk::meets(seen, w, step) {
            return (land(surface, line, w).max(w - step).min(w + step), false);
        }
        if seen < w {
            walk.in_front = Some(k);
        } else {
            walk.occluder = seen;
        }
    }
    (walk.beside(surface, line), true)
}

/// A walk along a line, from near to far.
pub(super) struct Walk<T> {
    pub(super) nearest: T,
    pub(super) farthest: T,
    /// Inverse depth per step.
    pub(super) step: T,
    pub(super) count: u32,
    /// The last step in front of the surface.
    pub(super) in_front: Option<u32>,
    /// Inverse depth of the last surface that hid the line.
    pub(super) occluder: T,
}

impl<T: Real> Walk<T> {
    /// Number of steps, and inverse depth per step, of a line that moves by `(ex, ey)` per unit of
    /// inverse depth. None (0) if both ends are within half a pixel.
    #[inline(always)]
    pub(super) fn steps(ex: T, ey: T, nearest: T, farthest: T) -> (u32, T) {
        let range = nearest - farthest;
        let length = (ex * ex + ey * ey).sqrt() * range;
        let far_apart = length > T::of(0.5);
        if !far_apart {
            return (0, T::zero());
        }
        let most = T::of(f64::from(STEPS - 1));
        let whole = if length < most { length } else { most };
        let count = whole.to_u32().unwrap_or(0) + 1;
        (count, range / T::of(f64::from(count)))
    }

    /// Whether a sample at `w` lies on a surface seen at `seen`.
    #[inline(always)]
    pub(super) fn meets(seen: T, w: T, step: T) -> bool {
        (seen - w).abs() <= step * T::of(0.6)
    }

    fn at(&self, k: u32) -> T {
        self.nearest - self.step * T::of(f64::from(k))
    }

    /// The background beside what hides the end of the line, on the side that is closer.
    pub(super) fn beside(&self, surface: &Surface<T>, line: &Line<T>) -> T {
        let hidden_for = self.count - self.in_front.unwrap_or(0);
        let background = (self.occluder + self.farthest) * T::of(0.5);
        let beyond = (1..=hidden_for.max(1))
            .map(|k| self.farthest - self.step * T::of(f64::from(k)))
            .find(|&w| sample(surface, line, w) < background);
        beyond.or(self.in_front.map(|k| self.at(k))).unwrap_or(self.farthest)
    }
}

#[inline(always)]
fn sample<T: Real>(surface: &Surface<T>, line: &Line<T>, w: T) -> T {
    let (x, y) = line.at(w);
    surface.facet_at(x, y).0.value
}
