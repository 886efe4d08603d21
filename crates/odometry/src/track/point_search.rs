//! Search for one point in the next picture.
//!
//! A point is followed by its patch in the last frame and then aligned with that of the keyframe in
//! which it began (its anchor), which does not drift, the sharper of both blurred like the other.
//! Where the anchor does not match, the position from the last frame is kept without an observation.

use crate::multiview::whitening::Whitening;
use crate::track::motion_blur::EqualBlur;
use crate::track::patch::{AffineWarp, PatchMatch, PatchTemplate};
use crate::track::pyramid::Pyramid;
use crate::track::tracks::Observation;
use i2slam_geometry::Image;

/// Pyramid levels on which a point's anchor is compared.
const ANCHOR_LEVELS: usize = 3;
/// Largest distance from its start of a point followed forth and back [px].
const MAX_ROUND_TRIP_ERROR: f32 = 1.2;
/// Smallest correlation with the last frame, and with the anchor.
const MIN_CORRELATION: f32 = 0.6;
pub(crate) const MIN_ANCHOR_CORRELATION: f32 = 0.7;
/// Standard deviation of a position over that which its patch claims for independent noise of all pixels:
/// interpolation between pixels averages up to half of the noise out of what is compared (1.5 in the mean over
/// all places), and what else differs between two pictures is correlated from pixel to pixel.
const SIGMA_PER_FORMAL: f64 = 2.0;
/// Least standard deviation of a position [px].
const MIN_POSITION_SIGMA: f64 = 0.05;
/// Correlation that noise leaves between two pictures of a point, for positions that nothing was aligned with.
const USUAL_CORRELATION: f32 = 0.98;
/// Largest correction of the followed position by the anchor [px].
const MAX_ANCHOR_CORRECTION: f32 = 3.0;
/// Distance from the edge within which points are not searched [px].
const BORDER: f32 = 3.0;

/// Patch of a point in its first keyframe, on several levels.
#[derive(Clone, Debug)]
pub(crate) struct AnchorPatch {
    templates: Vec<PatchTemplate<8>>,
    at: [f32; 2],
}

/// A point followed from the last frame, before its anchor is compared.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FollowedPoint {
    /// Match of the patch from the last frame.
    pub(crate) found: Option<PatchMatch>,
    /// Position moved with the whole picture.
    guess: [f32; 2],
}

impl FollowedPoint {
    /// A point that was not followed, around a position where it may be.
    pub(crate) fn not_followed(guess: [f32; 2]) -> Self {
        Self { found: None, guess }
    }
}

/// Outcome of the search for a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackOutcome {
    /// Assumed position; moved with the whole picture if the point was not found.
    pub(crate) warp: AffineWarp,
    /// Whether it was found, by its anchor or at least from the last frame.
    pub(crate) is_followed: bool,
    /// Match of the anchor: only with one it is a measurement.
    pub(crate) anchored: Option<PatchMatch>,
}

impl TrackOutcome {
    /// The measurement, if there is one.
    pub(crate) fn observation(&self, frame: usize) -> Option<Observation> {
        let at = self.warp.centre.map(f64::from);
        self.anchored.map(|found| Observation::whitened(frame, at, position_whitening(&found, 1.0)))
    }

    /// Correlation with the anchor, where that matches.
    pub(crate) fn correlation(&self) -> Option<f32> {
        self.anchored.map(|found| found.correlation)
    }
}

/// Deviation of a position that was found in a picture whose pixels have a width of `scale` [px].
pub(crate) fn position_whitening(found: &PatchMatch, scale: f64) -> Whitening {
    whitening(found.covariance, scale)
}

/// Deviation of the position of a patch in its own picture.
pub(crate) fn anchor_whitening(template: &PatchTemplate<8>, scale: f64) -> Whitening {
    let here = AffineWarp::translation([0.0; 2]);
    whitening(template.covariance(&here, USUAL_CORRELATION), scale)
}

fn whitening(formal: [f64; 3], scale: f64) -> Whitening {
    let [xx, xy, yy] = formal.map(|v| SIGMA_PER_FORMAL * SIGMA_PER_FORMAL * v);
    let least = MIN_POSITION_SIGMA * MIN_POSITION_SIGMA;
    Whitening::of_covariance([xx + least, xy, yy + least].map(|v| v * scale * scale))
}

impl AnchorPatch {
    /// The anchor at a position; `None` without texture.
    pub(crate) fn new(pyramid: &Pyramid, at: [f32; 2]) -> Option<Self> {
        let levels = pyramid.levels.iter().take(ANCHOR_LEVELS).enumerate();
        let template = |(l, image): (usize, &Image<f32>)| {
            PatchTemplate::new(image, at.map(|v| v / (1_usize << l) as f32))
        };
        let templates: Option<Vec<_>> = levels.map(template).collect();
        templates.map(|templates| Self { templates, at })
    }

    /// Deviation of its position in its own picture.
    pub(crate) fn whitening(&self) -> Whitening {
        anchor_whitening(&self.templates[0], 1.0)
    }

    /// Aligns the anchor from `start` on, from level `from` down to the finest.
    pub(crate) fn align(
        &self,
        next: &Pyramid,
        start: AffineWarp,
        from: usize,
    ) -> Option<PatchMatch> {
        let mut warp = start;
        let mut found = None;
        for level in (0..=from.min(self.templates.len() - 1)).rev() {
            let scale = (1_usize << level) as f32;
            let template = &self.templates[level];
            let there = template.align(&next.levels[level], warp.scaled(1.0 / scale))?;
            warp = there.warp.scaled(scale);
            found = Some(there);
        }
        found
    }
}

/// Follows a point that was at `warp` in the last picture (a real position if `is_followed`), where
/// the whole picture has moved by `shift` [px].
pub(crate) fn follow_point(
    warp: AffineWarp,
    is_followed: bool,
    [last, next]: [&Pyramid; 2],
    shift: [f32; 2],
) -> FollowedPoint {
    let guess = [warp.centre[0] + shift[0], warp.centre[1] + shift[1]];
    let search = || follow_from_last_frame(last, next, warp.centre, guess);
    FollowedPoint { found: is_followed.then(search).flatten(), guess }
}

/// Searches for the anchor of a point that was at `warp` in the last picture, in the next one, both
/// with `equal` blur.
pub(crate) fn search_point(
    anchor: &AnchorPatch,
    warp: AffineWarp,
    followed: &FollowedPoint,
    next: &Pyramid,
    equal: &EqualBlur,
) -> TrackOutcome {
    let (near, guess) = (followed.found, followed.guess);
    let blurred = match equal {
        EqualBlur::First(picture) => AnchorPatch::new(picture, anchor.at),
        EqualBlur::AsTheyAre | EqualBlur::Second(_) => None,
    };
    let anchor = blurred.as_ref().unwrap_or(anchor);
    let next = if let EqualBlur::Second(picture) = equal { picture } else { next };
    let (start, level) = match near {
        Some(found) => (found.warp.centre, 1),
        None => (guess, ANCHOR_LEVELS - 1),
    };
    let start = AffineWarp { centre: start, ..warp };
    let reached = |f: &PatchMatch| {
        near.is_none() || distance(f.warp.centre, start.centre) < MAX_ANCHOR_CORRECTION
    };
    let anchored = anchor.align(next, start, level).filter(|f| {
        f.correlation > MIN_ANCHOR_CORRELATION && reached(f) && is_inside(next, f.warp.centre)
    });
    let (warp, is_followed) = match (anchored, near) {
        (Some(f), _) => (f.warp, true),
        (None, Some(_)) if is_inside(next, start.centre) => (start, true),
        _ => (AffineWarp { centre: guess, ..warp }, false),
    };
    TrackOutcome { warp, is_followed, anchored }
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn is_inside(next: &Pyramid, [x, y]: [f32; 2]) -> bool {
    let image = next.finest();
    let most = [image.width as f32 - BORDER, image.height as f32 - BORDER];
    x >= BORDER && y >= BORDER && x < most[0] && y < most[1]
}

/// Follows a point from the last frame coarse to fine, and checks it back again.
fn follow_from_last_frame(
    last: &Pyramid,
    next: &Pyramid,
    from: [f32; 2],
    guess: [f32; 2],
) -> Option<PatchMatch> {
    let mut at = guess;
    let mut found = None;
    for level in (0..last.levels.len()).rev() {
        let scale = (1_usize << level) as f32;
        let template = PatchTemplate::<4>::new(&last.levels[level], from.map(|v| v / scale));
        let start = AffineWarp::translation(at.map(|v| v / scale));
        match template.and_then(|t| t.align(&next.levels[level], start)) {
            Some(f) => {
                at = f.warp.centre.map(|v| v * scale);
                found = Some(f);
            }
            // Coarse levels may show nothing of a small point.
            None if level >= 2 => {}
            None => return None,
        }
    }
    let found = found.filter(|f| f.correlation > MIN_CORRELATION)?;
    let back = PatchTemplate::<4>::new(next.finest(), at)?
        .align(last.finest(), AffineWarp::translation(from))?;
    (distance(back.warp.centre, from) < MAX_ROUND_TRIP_ERROR).then_some(found)
}
