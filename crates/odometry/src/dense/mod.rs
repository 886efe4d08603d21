//! Dense depth with variance for keyframes whose poses are known.
//!
//! A keyframe is matched with a few others by plane sweep: zero-mean normalised correlation of
//! windows, independent of exposure and of a smooth response. Costs are aggregated semi-globally
//! and refined twice around the result with windows that follow the surface. Depth that other
//! keyframes contradict is dropped; variances are inflated at depth edges.

mod depth_filter;
mod inverse_depth;
mod plane_sweep;
mod semi_global;
mod view_selection;

use crate::track::pyramid::Pyramid;
use depth_filter::{fuse_consistent, inflate_variance_at_edges};
use i2slam_compute::{CancellationToken, median};
use i2slam_geometry::{Camera, Image, Pose};
use inverse_depth::{HALF_WINDOWS, InverseDepthEstimate, estimate_inverse_depth};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Distance of matched keyframes in their order.
const MAX_KEYFRAME_DISTANCE: usize = 8;
/// Keyframes that one is matched with, and compared with for consistency.
const MAX_VIEWS: usize = 5;
/// Margin of the search range around the landmarks' inverse depths, relative.
const RANGE_MARGIN: f64 = 0.5;
/// Ratio of landmarks outside the range on either side.
const OUTLIER_RATIO: f64 = 0.01;
/// Largest relative standard deviation of a known inverse depth.
const MAX_RELATIVE_DEVIATION: f32 = 0.1;

/// Depth along the optical axis with its variance, in the unit of the poses and its square.
#[derive(Clone, Debug)]
pub struct DenseDepth {
    /// Depth.
    pub depth: Image<f32>,
    /// Its variance; 0 where the depth is unknown.
    pub variance: Image<f32>,
}

/// A keyframe with its pose and the depths of its landmarks.
#[derive(Clone, Debug)]
pub struct PosedView {
    /// Pose at mid-exposure.
    pub world_from_camera: Pose<f64>,
    /// Depths of landmarks in it.
    pub landmarks: Vec<f64>,
}

/// Estimates dense depth of keyframes one after another; keeps only neighbouring ones in memory.
#[derive(Clone, Debug)]
pub struct DenseDepthEstimator {
    camera: Camera<f64>,
    views: Vec<PosedView>,
    pictures: BTreeMap<usize, Option<Pyramid>>,
    estimates: BTreeMap<usize, InverseDepthEstimate>,
    cancellation: CancellationToken,
}

impl DenseDepthEstimator {
    /// For keyframes of one camera, in the order in which they were taken.
    pub fn new(camera: Camera<f64>, views: Vec<PosedView>) -> Self {
        let (pictures, estimates) = (BTreeMap::new(), BTreeMap::new());
        Self { camera, views, pictures, estimates, cancellation: CancellationToken::default() }
    }

    /// Returns `None` from every estimate once `cancellation` is cancelled.
    #[must_use]
    pub fn with_cancellation(self, cancellation: CancellationToken) -> Self {
        Self { cancellation, ..self }
    }

    /// Estimates the depth of keyframe `index`. `load` gives the picture of a keyframe (planes R,
    /// G, B or one of brightness), or `None`; it is called once for each while indices rise.
    pub fn estimate(
        &mut self,
        index: usize,
        load: &mut dyn FnMut(usize) -> Option<Arc<Image<f32>>>,
    ) -> Option<DenseDepth> {
        if index >= self.views.len() {
            return None;
        }
        let others = self.selected_views(index);
        self.ensure_estimate(index, load)?;
        for other in &others {
            self.ensure_estimate(*other, load);
        }
        if self.cancellation.is_cancelled() {
            return None;
        }
        let own = self.estimates.get(&index)?;
        let inverse = |i: usize| self.views[i].world_from_camera.inverse();
        let pose = self.views[index].world_from_camera;
        let known: Vec<(&InverseDepthEstimate, Pose<f64>)> = others
            .iter()
            .filter_map(|i| Some((self.estimates.get(i)?, inverse(*i) * pose)))
            .collect();
        let kept = fuse_consistent(&self.camera, own, &known);
        let oldest = index.saturating_sub(MAX_KEYFRAME_DISTANCE);
        self.estimates.retain(|i, _| *i >= oldest);
        self.pictures.retain(|i, _| *i + MAX_KEYFRAME_DISTANCE >= oldest);
        let mut found = depth_from_inverse(&kept);
        inflate_variance_at_edges(&mut found, HALF_WINDOWS[0]);
        Some(found)
    }

    /// The keyframes to match one with.
    fn selected_views(&self, index: usize) -> Vec<usize> {
        let depth = median(&mut self.views[index].landmarks.clone()).filter(|d| *d > 0.0);
        let Some(depth) = depth else { return Vec::new() };
        let last = (index + MAX_KEYFRAME_DISTANCE + 1).min(self.views.len());
        let near = index.saturating_sub(MAX_KEYFRAME_DISTANCE)..last;
        let others: Vec<(usize, Pose<f64>)> =
            near.filter(|i| *i != index).map(|i| (i, self.views[i].world_from_camera)).collect();
        let pose = self.views[index].world_from_camera;
        view_selection::select_views(&self.camera, pose, &others, depth, MAX_VIEWS)
    }

    /// Bounds of the inverse depth, from the landmarks.
    fn inverse_depth_bounds(&self, index: usize) -> Option<[f64; 2]> {
        let mut all: Vec<f64> =
            self.views[index].landmarks.iter().filter(|d| **d > 0.0).map(|d| 1.0 / d).collect();
        all.sort_by(f64::total_cmp);
        let outside = (OUTLIER_RATIO * all.len() as f64) as usize;
        let (least, most) = (all.get(outside)?, all.get(all.len() - 1 - outside)?);
        Some([least / (1.0 + RANGE_MARGIN), most * (1.0 + RANGE_MARGIN)])
    }

    /// Estimates one keyframe alone, unless done before.
    fn ensure_estimate(
        &mut self,
        index: usize,
        load: &mut dyn FnMut(usize) -> Option<Arc<Image<f32>>>,
    ) -> Option<()> {
        if self.estimates.contains_key(&index) {
            return Some(());
        }
        let (chosen, bounds) = (self.selected_views(index), self.inverse_depth_bounds(index)?);
        for i in chosen.iter().chain([&index]) {
            self.pictures.entry(*i).or_insert_with(|| load(*i).map(|image| Pyramid::new(&image)));
        }
        let picture = |i: usize| self.pictures.get(&i).and_then(Option::as_ref);
        let pose = self.views[index].world_from_camera;
        let others: Vec<(&Pyramid, Pose<f64>)> = chosen
            .iter()
            .filter_map(|i| Some((picture(*i)?, self.views[*i].world_from_camera.inverse() * pose)))
            .collect();
        if others.is_empty() {
            return None;
        }
        let found = estimate_inverse_depth(
            &self.camera,
            picture(index)?,
            &others,
            bounds,
            &self.cancellation,
        )?;
        self.estimates.insert(index, found);
        Some(())
    }
}

/// Depth with variance `σ_z = z² σ_ρ`, where that is small enough.
fn depth_from_inverse(estimate: &InverseDepthEstimate) -> DenseDepth {
    let (width, height) = (estimate.inverse_depth.width, estimate.inverse_depth.height);
    let mut out =
        DenseDepth { depth: Image::new(width, height, 1), variance: Image::new(width, height, 1) };
    for (pixel, rho) in estimate.inverse_depth.data.iter().enumerate() {
        let variance = estimate.variance.data[pixel];
        if *rho > 0.0 && variance.sqrt() <= MAX_RELATIVE_DEVIATION * rho {
            let z = 1.0 / rho;
            out.depth.data[pixel] = z;
            out.variance.data[pixel] = variance * z.powi(4);
        }
    }
    out
}
