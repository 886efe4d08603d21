//! From sums over pixels to the parameters and the pose, in groups of one vector, on all threads.
//!
//! Only Gaussians that touched a tile are visited. With `B = J A` and `A = W R S`, the covariance
//! in the image is `B Bᵀ` plus the low-pass; a turn of the camera by `φ` moves the columns of `A`
//! by `-φ ×` themselves. The covariance of a ball does not turn, so that only `J` is left of it.

use super::cpu_backward_group::Group;
use super::stages::Frame;
use super::{CHUNK, Chunk, MotionFrame, Splat};
use crate::gaussian::bin::Bins;
use crate::gaussian::gradient::GradientRows;
use crate::gaussian::rasterize::{MotionSlot, Slot};
use crate::gaussian::{GaussianMap, MapGradient, Shape, sort};
use i2slam_compute::simd::MAX_LANES;
use pulp::{Arch, Simd, WithSimd};

/// The splats of the last render with the sums over their pixels.
pub(crate) struct Footprints<'a> {
    pub(crate) arch: Arch,
    pub(crate) map: &'a GaussianMap,
    pub(crate) frame: Frame,
    pub(crate) splats: &'a [Splat],
    pub(crate) chunks: &'a [Chunk],
    pub(crate) bins: &'a Bins,
    pub(crate) slots: &'a [Slot],
    /// When the camera moves.
    pub(crate) moving: Option<(&'a MotionFrame, &'a [MotionSlot])>,
}

/// What a chunk of Gaussians, or all, adds to the poses.
#[derive(Clone, Copy, Default)]
pub(crate) struct PoseSums {
    /// `∂L/∂(ρ, φ)` of the view's pose.
    pub(crate) middle: [f64; 6],
    /// The same of the poses at both ends of the exposure.
    pub(crate) ends: [[f64; 6]; 2],
    /// `∂L/∂readout`.
    pub(crate) readout: f64,
}

impl PoseSums {
    pub(crate) fn add(&mut self, other: &Self) {
        for k in 0..6 {
            self.middle[k] += other.middle[k];
            (0..2).for_each(|end| self.ends[end][k] += other.ends[end][k]);
        }
        self.readout += other.readout;
    }
}

impl Footprints<'_> {
    /// Pull the sums back to the map and, one sum per chunk, to the pose.
    ///
    /// # Panics
    /// If `map_gradient` is not of the map's size.
    pub(crate) fn pull_back(
        &self,
        map_gradient: Option<&mut MapGradient>,
        pose_sums: &mut [PoseSums],
    ) {
        let rows = map_gradient.map(|gradient| {
            assert_eq!(gradient.len(), self.map.len(), "gradient and map differ in size");
            gradient.rows()
        });
        self.split_chunks(0, rows, pose_sums);
    }

    /// Chunks from `first` on, whose rows and sums these are, halved until one is left.
    fn split_chunks(
        &self,
        first: usize,
        rows: Option<GradientRows<'_, f32>>,
        pose_sums: &mut [PoseSums],
    ) {
        match pose_sums {
            [] => {}
            [sum] => *sum = self.pull_back_chunk(first, rows),
            _ => {
                let middle = pose_sums.len() / 2;
                let (left_sums, right_sums) = pose_sums.split_at_mut(middle);
                let (left, right) = rows.map(|rows| rows.split_at(middle * CHUNK)).unzip();
                rayon::join(
                    || self.split_chunks(first, left, left_sums),
                    || self.split_chunks(first + middle, right, right_sums),
                );
            }
        }
    }

    /// The first slots of a group of visible Gaussians. They lie all over the memory; here nothing
    /// depends on one of them before all are asked for.
    #[inline(always)]
    fn first_slots(&self, items: &[u64]) -> [Slot; MAX_LANES] {
        let first = |item: &u64| {
            let index = sort::index(*item);
            let mut places = self.bins.places_of(index, &self.splats[index]);
            places.next().map_or_else(Slot::default, |at| self.slots[at])
        };
        std::array::from_fn(|i| items.get(i).map_or_else(Slot::default, first))
    }

    fn pull_back_chunk(&self, chunk: usize, rows: Option<GradientRows<'_, f32>>) -> PoseSums {
        let footprints = self;
        match (self.map.shape, rows.is_some()) {
            (Shape::Isotropic, false) => {
                self.arch.dispatch(PullBack::<false, false> { footprints, chunk, rows })
            }
            (Shape::Isotropic, true) => {
                self.arch.dispatch(PullBack::<false, true> { footprints, chunk, rows })
            }
            (Shape::Anisotropic, false) => {
                self.arch.dispatch(PullBack::<true, false> { footprints, chunk, rows })
            }
            (Shape::Anisotropic, true) => {
                self.arch.dispatch(PullBack::<true, true> { footprints, chunk, rows })
            }
        }
    }
}

/// The way back of one chunk; gives its part of the poses' gradients. Without `MAP` there are no
/// rows.
struct PullBack<'a, const ANISOTROPIC: bool, const MAP: bool> {
    footprints: &'a Footprints<'a>,
    chunk: usize,
    rows: Option<GradientRows<'a, f32>>,
}

impl<const ANISOTROPIC: bool, const MAP: bool> WithSimd for PullBack<'_, ANISOTROPIC, MAP> {
    type Output = PoseSums;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> PoseSums {
        let Footprints { map, frame, splats, chunks, bins, slots, moving, .. } = self.footprints;
        let motion = moving.map(|(motion, _)| motion);
        let mut sums = PoseSums::default();
        let mut group = Group::default();
        for items in chunks[self.chunk].visible.chunks(S::F32_LANES) {
            let firsts = self.footprints.first_slots(items);
            for (place, item) in items.iter().enumerate() {
                let index = sort::index(*item);
                let (splat, mut sum) = (&splats[index], Slot::default());
                sum.add(&firsts[place]);
                for at in bins.places_of(index, splat).skip(1) {
                    sum.add(&slots[at]);
                }
                group.load(place, map, index, splat, &sum);
                if let Some((_, slots)) = moving {
                    let mut sum = MotionSlot::default();
                    for at in bins.places_of(index, splat) {
                        sum.add(&slots[at]);
                    }
                    group.load_motion(place, &sum);
                    sums.readout += f64::from(sum.readout);
                }
            }
            group.pull_back::<S, ANISOTROPIC, MAP>(simd, frame, motion);
            for (place, item) in items.iter().enumerate() {
                for k in 0..6 {
                    sums.middle[k] += f64::from(group.pose[k][place]);
                    for end in 0..2 {
                        sums.ends[end][k] += f64::from(group.ends[end][k][place]);
                    }
                }
                if let Some(rows) = &mut self.rows {
                    let row = sort::index(*item) - self.chunk * CHUNK;
                    rows.add(row, &group.gradient(place), group.weight[place] > 0.0);
                }
            }
        }
        sums
    }
}
