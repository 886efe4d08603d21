//! Spacing of the nodes, and fast search for the segment of a linear value.
//!
//! Even spacing is one multiplication. Any other spacing goes through a table of bins whose width
//! grows with the linear value (the leading bits of its float), fine enough that the segment of a
//! bin's left end is nearly always the answer, however close to black the nodes lie.

use super::{NODES, Segment};
use i2slam_geometry::Real;

/// Bits of the mantissa that tell bins apart: 64 bins for each octave.
const MANTISSA_BITS: u32 = 6;
/// Octaves below 1 that have bins; the first bin takes what is darker.
const OCTAVES: u32 = 40;
const BINS: usize = (OCTAVES << MANTISSA_BITS) as usize + 1;
const SHIFT: u32 = f32::MANTISSA_DIGITS - 1 - MANTISSA_BITS;
/// Leading bits of the first bin's right end, `2^-OCTAVES`.
const FIRST: u32 = (127 - OCTAVES) << MANTISSA_BITS;
const LAST: usize = NODES - 2;

/// Bin of a linear value in [0, 1].
#[inline(always)]
fn bin<T: Real>(x: T) -> usize {
    let leading = (x.to_f64() as f32).to_bits() >> SHIFT;
    ((leading + 1).saturating_sub(FIRST) as usize).min(BINS - 1)
}

/// Left end of a bin.
fn left_end(bin: usize) -> f64 {
    match bin as u32 {
        0 => 0.0,
        bin => f64::from(f32::from_bits((FIRST + bin - 1) << SHIFT)),
    }
}

/// Node positions and how to find one's way among them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Grid<T> {
    /// Positions of the nodes, from 0 to 1.
    pub(crate) positions: Vec<T>,
    /// The segment at the left end of each bin; empty for even spacing.
    bins: Vec<u8>,
}

impl<T: Real> Grid<T> {
    pub(crate) fn new(spacing: NodeSpacing) -> Self {
        let positions: Vec<T> = (0..NODES).map(|i| T::of(spacing.position(i))).collect();
        let bins = match spacing {
            NodeSpacing::Uniform => Vec::new(),
            NodeSpacing::Power(_) => bins(&positions),
        };
        Self { positions, bins }
    }

    /// The table, unless the spacing is even.
    pub(crate) fn binned(&self) -> Option<Binned<'_>> {
        <&[u8; BINS]>::try_from(self.bins.as_slice()).ok().map(Binned)
    }
}

fn bins<T: Real>(positions: &[T]) -> Vec<u8> {
    let mut segment = 0;
    (0..BINS)
        .map(|bin| {
            let left = T::of(left_end(bin));
            while segment < LAST && positions[segment + 1] <= left {
                segment += 1;
            }
            segment as u8
        })
        .collect()
}

/// Finds the segment of `x` in [0, 1]. At a node either neighbour may come back: both agree
/// there. NaN finds some segment.
pub(crate) trait Locate<T> {
    fn locate(&self, segments: &[Segment<T>], x: T) -> usize;
}

/// Even spacing.
pub(crate) struct Even;

impl<T: Real> Locate<T> for Even {
    #[inline(always)]
    fn locate(&self, _: &[Segment<T>], x: T) -> usize {
        ((x.to_f64() * (NODES - 1) as f64) as usize).min(LAST)
    }
}

/// Any spacing: a bin, then the few nodes inside it.
pub(crate) struct Binned<'a>(&'a [u8; BINS]);

impl<T: Real> Locate<T> for Binned<'_> {
    #[inline(always)]
    fn locate(&self, segments: &[Segment<T>], x: T) -> usize {
        let mut segment = usize::from(self.0[bin(x)]);
        while segment < LAST && x >= segments[segment + 1].start {
            segment += 1;
        }
        // Rounding to single precision may have led to the next bin.
        while segment > 0 && x < segments[segment].start {
            segment -= 1;
        }
        segment
    }
}

/// Spacing of the 256 nodes over the domain [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum NodeSpacing {
    /// Node `i` at `i/255` (the paper). The darkest 5 % of sRGB code values share one segment.
    #[default]
    Uniform,
    /// Node `i` at `(i/255)^p`, with `p` in [1/8, 12] (held to that range; NaN is 1).
    /// `Power(2.2)` puts the nodes evenly in display space.
    Power(f64),
}

impl NodeSpacing {
    /// Position of node `i` on the axis of linear values.
    pub fn position(&self, i: usize) -> f64 {
        let even = i as f64 / (NODES - 1) as f64;
        match self {
            Self::Power(_) => even.powf(self.exponent()),
            Self::Uniform => even,
        }
    }

    /// `p` of the positions `(i/255)^p`.
    pub fn exponent(&self) -> f64 {
        match *self {
            Self::Power(p) if !p.is_nan() => p.clamp(0.125, 12.0),
            _ => 1.0,
        }
    }
}
