//! Following points from picture to picture.
//!
//! A point is looked for with its look in the last frame, coarse to fine, and then with its look
//! in the keyframe in which it was found sharp (its anchor), which does not drift. Both allow for
//! gain and bias. A point that a blurred frame hides is looked for again in the next ones.

use crate::corners::find_corners;
use crate::patch::{Found, RADIUS, Template, Warp};
use crate::pyramid::Pyramid;
use crate::shift::find_shift;
use crate::tracks::{Observation, Track, Tracks};
use i2slam_compute::median;
use i2slam_geometry::Image;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Cells of a picture, each with a point of its own if it shows a corner.
const CELLS: f32 = 800.0;
/// Levels on which a point's anchor is compared.
const ANCHOR_LEVELS: usize = 3;
/// Frames in a row in which a point may be hidden.
const HIDDEN: usize = 3;
/// A point followed forth and back must end this near to its start [px].
const ROUND_TRIP: f32 = 1.2;
/// Least correlation with the last frame, and with the anchor.
const LEAST_CORRELATION: f32 = 0.6;
const LEAST_ANCHOR_CORRELATION: f32 = 0.7;
/// Correlation below which a keyframe gives a point a new anchor.
const AGED_CORRELATION: f32 = 0.85;
/// Standard deviation of a position where a point looks as in its anchor (twice that without),
/// and what is added for each unit of correlation that is missing [px].
const SIGMA: f64 = 0.4;
const SIGMA_UNLIKE: f64 = 1.5;
/// What the anchor may move a position that the last frame gave [px].
const ANCHOR_REACH: f32 = 3.0;
/// A keyframe is due when points have moved by this share of the picture's width, ...
const KEYFRAME_MOTION: f32 = 0.03;
/// ... or when this share of those of the last one is left.
const KEYFRAME_OVERLAP: f32 = 0.7;
/// ... or after so many frames in which they have moved by this share of the width at least.
const KEYFRAME_INTERVAL: usize = 8;
const SLOW_MOTION: f32 = 0.006;
/// Frames before a keyframe in which points that begin there are looked for, too.
const BACKWARD: usize = 16;
/// A keyframe waits for a frame of this share of the usual sharpness, for so many frames.
const SHARP_ENOUGH: f32 = 0.85;
const LONGEST_WAIT: usize = 3;
/// Pictures this unlike their predecessor begin another scene.
const CUT_CORRELATION: f32 = 0.3;

/// How a point looked when it was found.
#[derive(Clone, Debug)]
struct Anchor {
    templates: Vec<Template<8>>,
}

/// A point that is being followed.
#[derive(Clone, Debug)]
struct Point {
    track: usize,
    warp: Warp,
    anchor: Anchor,
    /// Frames since it was last seen.
    hidden: usize,
    /// Position in the last keyframe.
    at_keyframe: Option<[f32; 2]>,
    correlation: f32,
}

/// A point found again.
#[derive(Clone, Copy, Debug)]
struct Sight {
    warp: Warp,
    correlation: f32,
    sigma: f64,
}

/// What the tracker says of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Followed {
    /// Points found again.
    pub(crate) points: usize,
    /// Median move since the last frame [px].
    pub(crate) motion: f32,
    /// The frame begins another scene.
    pub(crate) is_cut: bool,
    /// The frame was chosen as keyframe.
    pub(crate) is_keyframe: bool,
}

/// Points followed through a sequence.
#[derive(Debug, Default)]
pub(crate) struct Tracker {
    tracks: Tracks,
    points: Vec<Point>,
    /// The last frames, the newest at the back, each with its move since the one before [px].
    recent: VecDeque<(Pyramid, [f32; 2])>,
    sharpness: Vec<f32>,
    /// Points that the last keyframe had.
    keyframe_points: usize,
    /// Frames for which a keyframe has been due.
    due: usize,
}

impl Tracker {
    /// Follows all points into the next picture.
    pub(crate) fn follow(&mut self, picture: &Image<f32>) -> Followed {
        let frame = self.tracks.frames;
        let next = Pyramid::new(picture);
        let mut said = Followed { points: 0, motion: 0.0, is_cut: false, is_keyframe: frame == 0 };
        let shift = self.find_again(&next, frame, &mut said);
        self.sharpness.push(sharpness(next.finest()));
        said.is_keyframe = frame == 0 || said.is_cut || self.keyframe_is_due(next.finest().width);
        if said.is_keyframe {
            self.begin_keyframe(&next, frame, shift);
        }
        self.tracks.frames += 1;
        self.recent.push_back((next, shift));
        if self.recent.len() > BACKWARD {
            self.recent.pop_front();
        }
        said
    }

    /// All tracks so far.
    pub(crate) fn finish(self) -> Tracks {
        self.tracks
    }

    /// Follows all points; returns the move of the whole picture [px].
    fn find_again(&mut self, next: &Pyramid, frame: usize, said: &mut Followed) -> [f32; 2] {
        let Some((last, _)) = self.recent.back() else { return [0.0; 2] };
        let shift = find_shift(last.coarsest().0, next.coarsest().0);
        let scale = last.coarsest().1;
        let by = shift.by.map(|v| v * scale);
        let sights: Vec<Option<Sight>> =
            self.points.par_iter().map(|p| find(p, last, next, by)).collect();
        let mut motions = Vec::new();
        for (point, sight) in self.points.iter_mut().zip(&sights) {
            let Some(sight) = sight else {
                point.hidden += 1;
                let c = point.warp.centre;
                point.warp.centre = [c[0] + by[0], c[1] + by[1]];
                continue;
            };
            let (from, to) = (point.warp.centre, sight.warp.centre);
            motions.push((to[0] - from[0]).hypot(to[1] - from[1]));
            (point.warp, point.correlation, point.hidden) = (sight.warp, sight.correlation, 0);
            let observation = sight.observation(frame);
            self.tracks.tracks[point.track].observations.push(observation);
        }
        let found = motions.len();
        let is_cut = shift.correlation < CUT_CORRELATION && 3 * found < self.points.len();
        self.points.retain(|p| p.hidden <= crate::knob("HIDDEN", 3.0) as usize && !is_cut);
        *said = Followed {
            points: found,
            motion: median(&mut motions).unwrap_or(0.0),
            is_cut,
            is_keyframe: false,
        };
        if is_cut {
            self.recent.clear();
        }
        by
    }

    /// Whether enough has changed, and the picture is sharp enough to start points in.
    fn keyframe_is_due(&mut self, width: usize) -> bool {
        let seen = |p: &&Point| p.hidden == 0;
        let moved = |p: &Point| {
            p.at_keyframe.map(|k| (p.warp.centre[0] - k[0]).hypot(p.warp.centre[1] - k[1]))
        };
        let mut motions: Vec<f32> = self.points.iter().filter(seen).filter_map(moved).collect();
        let overlap = motions.len() as f32 / self.keyframe_points.max(1) as f32;
        let motion = median(&mut motions).unwrap_or(f32::INFINITY);
        let width = width as f32;
        let last = self.tracks.keyframes.last().copied().unwrap_or(0);
        let late = self.tracks.frames >= last + KEYFRAME_INTERVAL && motion > SLOW_MOTION * width;
        if motion < KEYFRAME_MOTION * width && overlap > KEYFRAME_OVERLAP && !late {
            self.due = 0;
            return false;
        }
        self.due += 1;
        let recent = self.sharpness.len().saturating_sub(15);
        let usual = median(&mut self.sharpness[recent..].to_vec()).unwrap_or(0.0);
        let now = self.sharpness.last().copied().unwrap_or(0.0);
        now >= SHARP_ENOUGH * usual || self.due > LONGEST_WAIT
    }

    /// Gives aged points a new anchor and starts new points where there are none.
    fn begin_keyframe(&mut self, next: &Pyramid, frame: usize, shift: [f32; 2]) {
        self.due = 0;
        self.tracks.keyframes.push(frame);
        for point in &mut self.points {
            if point.hidden == 0 && point.correlation < crate::knob("AGED", 0.85) as f32 {
                if let Some(anchor) = Anchor::new(next, point.warp.centre) {
                    (point.anchor, point.warp) = (anchor, Warp::at(point.warp.centre));
                }
            }
        }
        let taken: Vec<[f32; 2]> = self.points.iter().map(|p| p.warp.centre).collect();
        let image = next.finest();
        let corners = find_corners(image, cell_size(image), RADIUS + 2, &taken);
        let started: Vec<Option<(Point, Track)>> =
            corners.par_iter().map(|at| self.start(next, *at, frame, shift)).collect();
        for (mut point, track) in started.into_iter().flatten() {
            point.track = self.tracks.tracks.len();
            self.points.push(point);
            self.tracks.tracks.push(track);
        }
        for point in &mut self.points {
            point.at_keyframe = (point.hidden == 0).then_some(point.warp.centre);
        }
        self.keyframe_points = self.points.iter().filter(|p| p.hidden == 0).count();
    }
}

impl Tracker {
    /// A point that begins in `next`, with its sights in the frames before.
    fn start(
        &self,
        next: &Pyramid,
        at: [f32; 2],
        frame: usize,
        shift: [f32; 2],
    ) -> Option<(Point, Track)> {
        let anchor = Anchor::new(next, at)?;
        let (warp, at_keyframe) = (Warp::at(at), None);
        let point = Point { track: 0, warp, anchor, hidden: 0, at_keyframe, correlation: 1.0 };
        let mut observations = vec![Observation::new(frame, at.map(f64::from), SIGMA)];
        let (mut back, mut here, mut by) = (point.clone(), next, shift);
        for (i, (before, shift)) in self.recent.iter().rev().enumerate() {
            let Some(sight) = find(&back, here, before, by.map(|v| -v)) else { break };
            observations.push(sight.observation(frame - 1 - i));
            back.warp = sight.warp;
            (here, by) = (before, *shift);
        }
        observations.reverse();
        Some((point, Track { observations }))
    }
}

impl Sight {
    fn observation(&self, frame: usize) -> Observation {
        Observation::new(frame, self.warp.centre.map(f64::from), self.sigma)
    }
}

impl Anchor {
    fn new(pyramid: &Pyramid, at: [f32; 2]) -> Option<Self> {
        let levels = pyramid.levels.iter().take(ANCHOR_LEVELS).enumerate();
        let template = |(l, image): (usize, &Image<f32>)| {
            Template::new(image, at.map(|v| v / (1_usize << l) as f32))
        };
        let templates: Option<Vec<_>> = levels.map(template).collect();
        templates.map(|templates| Self { templates })
    }

    /// Looks for the anchor from `start` on, from level `from` down to the finest.
    fn find(&self, next: &Pyramid, start: Warp, from: usize) -> Option<Found> {
        let mut warp = start;
        let mut found = None;
        for level in (0..=from.min(self.templates.len() - 1)).rev() {
            let scale = (1_usize << level) as f32;
            let there =
                self.templates[level].align(&next.levels[level], warp.scaled(1.0 / scale))?;
            warp = there.warp.scaled(scale);
            found = Some(there);
        }
        found
    }
}

/// Finds a point in the next picture: by its last look, then by its anchor.
fn find(point: &Point, last: &Pyramid, next: &Pyramid, shift: [f32; 2]) -> Option<Sight> {
    let from = point.warp.centre;
    let guess = [from[0] + shift[0], from[1] + shift[1]];
    let seen = point.hidden == 0;
    let near = if seen { by_last_look(last, next, from, guess) } else { None };
    let (start, level) = match near {
        Some(found) => (found.warp.centre, 1),
        None => (guess, ANCHOR_LEVELS - 1),
    };
    let anchored = point.anchor.find(next, Warp { centre: start, ..point.warp }, level);
    let anchored = anchored.filter(|f| {
        let moved = (f.warp.centre[0] - start[0]).hypot(f.warp.centre[1] - start[1]);
        f.correlation > LEAST_ANCHOR_CORRELATION && (near.is_none() || moved < ANCHOR_REACH)
    });
    let border = 3.0;
    let image = next.finest();
    let inside = |w: &Warp| {
        let [x, y] = w.centre;
        x >= border
            && y >= border
            && x < image.width as f32 - border
            && y < image.height as f32 - border
    };
    let sight = match (anchored, near) {
        (Some(f), _) => Sight {
            warp: f.warp,
            correlation: f.correlation,
            sigma: SIGMA + crate::knob("UNLIKE", 1.5) * f64::from(1.0 - f.correlation),
        },
        (None, Some(f)) if f.correlation < crate::knob("NOF2F", 0.8) as f32 => Sight {
            warp: Warp { centre: f.warp.centre, ..point.warp },
            correlation: 0.5,
            sigma: 2.0 * SIGMA + crate::knob("UNLIKE", 1.5) * f64::from(1.0 - f.correlation),
        },
        _ => return None,
    };
    inside(&sight.warp).then_some(sight)
}

/// Coarse to fine with the look in the last frame, and back again.
fn by_last_look(last: &Pyramid, next: &Pyramid, from: [f32; 2], guess: [f32; 2]) -> Option<Found> {
    let mut at = guess;
    let mut found = None;
    for level in (0..last.levels.len()).rev() {
        let scale = (1_usize << level) as f32;
        let template = Template::<4>::new(&last.levels[level], from.map(|v| v / scale));
        let aligned =
            template.and_then(|t| t.align(&next.levels[level], Warp::at(at.map(|v| v / scale))));
        match aligned {
            Some(f) => {
                at = f.warp.centre.map(|v| v * scale);
                found = Some(f);
            }
            // Coarse levels may show nothing of a small point.
            None if level >= 2 => {}
            None => return None,
        }
    }
    let found = found.filter(|f| f.correlation > LEAST_CORRELATION)?;
    let back = Template::<4>::new(next.finest(), at)?.align(last.finest(), Warp::at(from))?;
    let error = (back.warp.centre[0] - from[0]).hypot(back.warp.centre[1] - from[1]);
    (error < ROUND_TRIP).then_some(found)
}

/// Side of the cells of which each gets one point [px]: some 600 points a picture.
fn cell_size(image: &Image<f32>) -> usize {
    (((image.width * image.height) as f32 / CELLS).sqrt() as usize).max(8)
}

/// Mean difference of neighbours, relative to the mean brightness: blur lowers it, exposure hardly.
fn sharpness(image: &Image<f32>) -> f32 {
    let differences: f32 = image
        .data
        .chunks_exact(image.width)
        .map(|row| row.windows(2).map(|p| (p[1] - p[0]).abs()).sum::<f32>())
        .sum();
    differences / image.data.iter().sum::<f32>().max(1e-6)
}
