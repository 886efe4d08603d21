//! Where a ray of a virtual camera lands on the surface that the sharp render shows.

use super::blocks::{Block, larger};
use super::surface::{Facet, Surface};
use super::views::Line;
use i2slam_geometry::Real;

/// At most this many samples along a line.
const STEPS: usize = 32;

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
/// time. The first sample that lies on the surface (within 0.6 of a step) is what the
/// virtual camera sees, refined by [`land`]; samples in front of the surface are empty space, and
/// those behind it are hidden from the sharp render. If the walk ends hidden, the virtual camera
/// sees background that the sharp render does not show: it takes the background beside the
/// occluder, on the side that is closer.
pub(super) fn search<T: Real>(surface: &Surface<T>, line: &Line<T>, bounds: Block<T>, own: T) -> T {
    let speed = (line.ex * line.ex + line.ey * line.ey).sqrt();
    let range = bounds.nearest - bounds.farthest;
    let length = (speed * range).to_f64();
    if !(length > 0.5) {
        return land(surface, line, own);
    }
    let steps = length.min(STEPS as f64 - 1.0) as usize + 1;
    let step = range / T::of(steps as f64);
    let tolerance = step * T::of(0.6);
    let mut in_front = None;
    let mut occluder = bounds.nearest;
    for k in 0..=steps {
        let w = bounds.nearest - step * T::of(k as f64);
        let seen = sample(surface, line, w);
        if (seen - w).abs() <= tolerance {
            return land(surface, line, w).max(w - step).min(w + step);
        }
        if seen < w {
            in_front = Some((k, w));
        } else {
            occluder = seen;
        }
    }
    let hidden_for = steps - in_front.map_or(0, |(k, _)| k);
    let background = (occluder + bounds.farthest) * T::of(0.5);
    let beyond = (1..=hidden_for.max(1))
        .map(|k| bounds.farthest - step * T::of(k as f64))
        .find(|&w| sample(surface, line, w) < background);
    beyond.or(in_front.map(|(_, w)| w)).unwrap_or(bounds.farthest)
}

#[inline(always)]
fn sample<T: Real>(surface: &Surface<T>, line: &Line<T>, w: T) -> T {
    let (x, y) = line.at(w);
    surface.facet_at(x, y).0.value
}
