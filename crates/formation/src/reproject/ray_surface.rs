//! Intersection of a virtual camera's rays with the surface of the sharp render, one by one or
//! sixteen at a time: the latter takes the same samples in the same order, without a branch per
//! pixel.

use super::band::Scene;
use super::sampling::{LANES, Lines};
use super::surface::{Block, larger};
use super::surface::{Facet, Surface};
use super::views::Line;
use i2slam_compute::simd::{Column, clamp_or_zero, floor_and_fraction};
use i2slam_geometry::{Camera, Real};

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
pub(super) fn intersect<T: Real>(surface: &Surface<T>, line: &Line<T>, guess: T) -> T {
    let (x, y) = line.at(guess);
    let (facet, cx, cy) = surface.facet_at(x, y);
    intersect_facet(&facet, (line.x - cx, line.y - cy), (line.ex, line.ey))
}

/// Inverse depth at which a line meets the plane of a facet; the line ends at infinity at `(from_x,
/// from_y)` [px from the centre of the facet] and moves by `(ex, ey)` per unit of inverse depth.
#[inline(always)]
pub(super) fn intersect_facet<T: Real>(
    facet: &Facet<T>,
    (from_x, from_y): (T, T),
    (ex, ey): (T, T),
) -> T {
    let at_infinity = facet.value + facet.slope_x * from_x + facet.slope_y * from_y;
    let w = at_infinity * amplification(facet.slope_x, facet.slope_y, ex, ey);
    larger(w, T::zero())
}

/// The inverse depth seen at `moment` (-1 to 1) by a pixel whose rays land at `first` at -1, at
/// `middle` at 0 and at `last` at 1: the parabola through the three.
#[inline(always)]
pub(super) fn interpolate_in_time<T: Real>(first: T, middle: T, last: T, moment: T) -> T {
    let half = T::of(0.5);
    let (slope, bend) = ((last - first) * half, (last + first) * half - middle);
    middle + moment * (slope + moment * bend)
}

/// The nearest surface on a line, among steps in depth.
///
/// The line is walked from the nearest inverse depth around to the farthest, at most a pixel at a
/// time. The first sample that lies on the surface (within 0.6 of a step) is what the virtual
/// camera sees, refined by [`intersect`]; samples in front of the surface are empty space, and those
/// behind it are hidden from the sharp render. If the walk ends hidden, the virtual camera sees
/// background that the sharp render does not show ([`RayWalk::background_beside`]), and `true` says so.
pub(super) fn search<T: Real>(
    surface: &Surface<T>,
    line: &Line<T>,
    bounds: Block<T>,
    own: T,
) -> (T, bool) {
    let (nearest, farthest) = (bounds.nearest, bounds.farthest);
    let (count, step) = RayWalk::steps(line.ex, line.ey, nearest, farthest);
    if count == 0 {
        return (intersect(surface, line, own), false);
    }
    let mut walk = RayWalk { nearest, farthest, step, count, in_front: None, occluder: nearest };
    for k in 0..=count {
        let w = walk.at(k);
        let seen = sample(surface, line, w);
        if RayWalk::on_surface(seen, w, step) {
            return (intersect(surface, line, w).max(w - step).min(w + step), false);
        }
        if seen < w {
            walk.in_front = Some(k);
        } else {
            walk.occluder = seen;
        }
    }
    (walk.background_beside(surface, line), true)
}

/// A walk along a line, from near to far.
pub(super) struct RayWalk<T> {
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

impl<T: Real> RayWalk<T> {
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

    /// True if a sample at inverse depth `w` lies on a surface at `seen`.
    #[inline(always)]
    pub(super) fn on_surface(seen: T, w: T, step: T) -> bool {
        (seen - w).abs() <= step * T::of(0.6)
    }

    fn at(&self, k: u32) -> T {
        self.nearest - self.step * T::of(f64::from(k))
    }

    /// The background beside what hides the end of the line, on the side that is closer.
    pub(super) fn background_beside(&self, surface: &Surface<T>, line: &Line<T>) -> T {
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

/// The pixels that `lines` pass at inverse depths `w`, and how far their ends at infinity are from
/// those pixels' centres.
#[inline(always)]
fn pixels(camera: &Camera<f32>, lines: &Lines, w: &Column) -> ([u32; LANES], Column, Column) {
    let width = camera.width as u32;
    let (most_x, most_y) = ((camera.width - 1) as f32, (camera.height - 1) as f32);
    let (mut index, mut from_x, mut from_y) = ([0; LANES], [0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        let (column, _) =
            floor_and_fraction(clamp_or_zero(lines.x[i] + lines.ex[i] * w[i], most_x));
        let (row, _) = floor_and_fraction(clamp_or_zero(lines.y[i] + lines.ey[i] * w[i], most_y));
        index[i] = row * width + column;
        from_x[i] = lines.x[i] - (column as f32 + 0.5);
        from_y[i] = lines.y[i] - (row as f32 + 0.5);
    }
    (index, from_x, from_y)
}

/// [`intersect`] for sixteen pixels.
#[inline(always)]
pub(super) fn intersect_lanes(scene: &Scene, lines: &Lines, guess: &Column) -> Column {
    let (index, from_x, from_y) = pixels(&scene.camera, lines, guess);
    let facets = scene.surface.facets_at(&index);
    let (mut value, mut slope_x, mut slope_y) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        let facet = facets[i];
        (value[i], slope_x[i], slope_y[i]) = (facet.value, facet.slope_x, facet.slope_y);
    }
    let mut w = [0.0; LANES];
    for i in 0..LANES {
        let facet = Facet { value: value[i], slope_x: slope_x[i], slope_y: slope_y[i], bend: 0.0 };
        w[i] = intersect_facet(&facet, (from_x[i], from_y[i]), (lines.ex[i], lines.ey[i]));
    }
    w
}

/// The bounds of inverse depth around sixteen pixels, for those that are near a visible step.
pub(super) struct DepthEdges {
    pub(super) any: bool,
    /// The largest bends around; 0 where there is no visible step.
    bend: Column,
    nearest: Column,
    farthest: Column,
}

impl DepthEdges {
    /// For the pixels from column `x` on in row `y`.
    #[inline(always)]
    pub(super) fn around(scene: &Scene, x: usize, y: usize) -> Self {
        let zero = [0.0; LANES];
        let mut steps = Self { any: false, bend: zero, nearest: zero, farthest: zero };
        for i in 0..LANES.min(scene.camera.width - x) {
            if let Some(bounds) = scene.surface.blocks.search_bounds(x + i, y) {
                (steps.any, steps.bend[i]) = (true, bounds.bend);
                (steps.nearest[i], steps.farthest[i]) = (bounds.nearest, bounds.farthest);
            }
        }
        steps
    }

    /// Those that a view shows for which bends up to `steep` are none, if there are any.
    #[inline(always)]
    pub(super) fn shown(&self, steep: f32) -> Option<VisibleEdges<'_>> {
        let (mut near_step, mut any) = ([false; LANES], false);
        for i in 0..LANES {
            near_step[i] = self.bend[i] > steep;
            any |= near_step[i];
        }
        any.then_some(VisibleEdges { steps: self, near_step })
    }
}

/// The steps that one view shows.
pub(super) struct VisibleEdges<'a> {
    steps: &'a DepthEdges,
    near_step: [bool; LANES],
}

impl VisibleEdges<'_> {
    /// Replaces the inverse depths `w` of pixels near a step by those of the nearest surface on
    /// their lines, and returns at which of them the line ends hidden.
    #[inline(always)]
    pub(super) fn search(
        &self,
        scene: &Scene,
        lines: &Lines,
        own: &Column,
        w: &mut Column,
    ) -> [bool; LANES] {
        let mut walks = RayWalks::new(self, lines);
        walks.run(scene, lines);
        let mut guess = *own;
        for i in 0..LANES {
            guess[i] = if walks.at[i] > NOWHERE { walks.at[i] } else { own[i] };
        }
        let landed = intersect_lanes(scene, lines, &guess);
        for i in 0..LANES {
            let step = walks.step[i];
            let near = landed[i].max(walks.at[i] - step).min(walks.at[i] + step);
            let found = if walks.at[i] > NOWHERE { near } else { landed[i] };
            w[i] = if self.near_step[i] { found } else { w[i] };
        }
        let mut hidden = [false; LANES];
        for i in 0..LANES {
            hidden[i] = (walks.count[i] > 0) & (walks.at[i] == NOWHERE);
        }
        for i in 0..LANES {
            if hidden[i] {
                w[i] = walks.hidden(i).background_beside(&scene.surface, &lines.line(i));
            }
        }
        hidden
    }
}

/// Less than any inverse depth, also one rounded to below 0.
const NOWHERE: f32 = f32::NEG_INFINITY;

/// Sixteen walks from near to far; see [`RayWalk`].
struct RayWalks {
    nearest: Column,
    farthest: Column,
    step: Column,
    /// Number of steps; 0 where there is nothing to walk.
    count: [u32; LANES],
    /// Inverse depth of the hit; [`NOWHERE`] without one.
    at: Column,
    /// The last step in front of the surface; -1 where there was none.
    in_front: Column,
    occluder: Column,
}

impl RayWalks {
    #[inline(always)]
    fn new(VisibleEdges { steps, near_step }: &VisibleEdges<'_>, lines: &Lines) -> Self {
        let mut walks = Self {
            nearest: steps.nearest,
            farthest: steps.farthest,
            step: [0.0; LANES],
            count: [0; LANES],
            at: [NOWHERE; LANES],
            in_front: [-1.0; LANES],
            occluder: steps.nearest,
        };
        for i in 0..LANES {
            let (count, step) =
                RayWalk::steps(lines.ex[i], lines.ey[i], steps.nearest[i], steps.farthest[i]);
            (walks.count[i], walks.step[i]) = (if near_step[i] { count } else { 0 }, step);
        }
        walks
    }

    #[inline(always)]
    fn run(&mut self, scene: &Scene, lines: &Lines) {
        let Self { nearest, step, at, in_front, occluder, .. } = self;
        // One past the last step of each, 0 where there is none any more. Largest whole numbers are
        // found in a few instructions, largest fractions one by one.
        let mut end = [0; LANES];
        for i in 0..LANES {
            end[i] = if self.count[i] > 0 { self.count[i] + 1 } else { 0 };
        }
        let mut k = 0;
        while end.iter().fold(0, |most: u32, &end| most.max(end)) > k {
            let (mut w, place) = ([0.0; LANES], k as f32);
            for i in 0..LANES {
                w[i] = nearest[i] - step[i] * place;
            }
            let seen = scene.surface.values_at(&pixels(&scene.camera, lines, &w).0);
            for i in 0..LANES {
                let walking = k < end[i];
                let met = walking & RayWalk::on_surface(seen[i], w[i], step[i]);
                let before = seen[i] < w[i];
                at[i] = if met { w[i] } else { at[i] };
                in_front[i] = if walking & !met & before { place } else { in_front[i] };
                occluder[i] = if walking & !met & !before { seen[i] } else { occluder[i] };
                end[i] = if met { 0 } else { end[i] };
            }
            k += 1;
        }
    }

    /// The walk of one pixel that ended hidden.
    fn hidden(&self, i: usize) -> RayWalk<f32> {
        RayWalk {
            nearest: self.nearest[i],
            farthest: self.farthest[i],
            step: self.step[i],
            count: self.count[i],
            in_front: (self.in_front[i] >= 0.0).then_some(self.in_front[i] as u32),
            occluder: self.occluder[i],
        }
    }
}
