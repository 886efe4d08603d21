//! Dense depth with variance for keyframes whose poses are known.
//!
//! A keyframe is matched with a few others by plane sweep: zero-mean normalised correlation of
//! windows, independent of exposure and of a smooth response. Costs are averaged within edges of the
//! picture ([`cost_filter`]) and aggregated semi-globally; the result is refined twice with windows
//! that follow the surface, that of photographs by planes that pixels take over from each other
//! ([`patch_match`]). Depth that other keyframes contradict is dropped; variances are inflated at depth edges.
//!
//! Measured depth is averaged with the readings of neighbouring keyframes in the same way. Readings
//! that pictures contradict are left out, and plane sweep completes what the sensor does not see.

mod cost_filter;
mod depth_filter;
mod inverse_depth;
mod patch_match;
mod picture_check;
mod plane_sweep;
mod semi_global;
pub(crate) mod view_selection;

use crate::depth::registration::register_depth;
use crate::depth::sensor_model::DepthModel;
use crate::track::pyramid::Pyramid;
use depth_filter::{confirmed_readings, fuse_consistent, fuse_readings, inflate_variance_at_edges};
use i2slam_compute::{CancellationToken, median};
use i2slam_geometry::{Camera, Image, Pose};
use inverse_depth::{
    EDGE_REACH, InverseDepthEstimate, NeighbourView, estimate_inverse_depth, plane_sweep_at,
};
use patch_match::PatchMatch;
use picture_check::{add_evidence_of, agree, evidence_against};
use std::collections::BTreeMap;
use std::sync::Arc;
use view_selection::{KEYFRAMES, PHOTOGRAPHS, select_views};

/// Largest difference between the numbers of a keyframe and of those it is matched with.
pub const MAX_KEYFRAME_DISTANCE: usize = 8;
/// Largest difference between the numbers of photographs that are matched.
pub const MAX_PHOTOGRAPH_DISTANCE: usize = 40;
/// Share of pixels without a reading from which on they are estimated from pictures: less is beside
/// edges, where a sweep is less exact than the readings around.
const MAX_MISSING_SHARE: f64 = 0.05;
/// Margin of the search range around the landmarks' inverse depths, relative.
const RANGE_MARGIN: f64 = 0.5;
/// Ratio of landmarks outside the range on either side.
const OUTLIER_RATIO: f64 = 0.01;

/// Depth along the optical axis with its variance, in the unit of the poses and its square.
#[derive(Clone, Debug)]
pub struct DenseDepth {
    /// Depth.
    pub depth: Image<f32>,
    /// Its variance; 0 where the depth is unknown.
    pub variance: Image<f32>,
    /// Readings that pictures contradict, 0 elsewhere; `None` where none was compared.
    pub contradicted: Option<Image<f32>>,
}

/// The pictures of a keyframe.
#[derive(Clone, Debug)]
pub struct KeyframePictures {
    /// Planes R, G, B, or one of brightness.
    pub colour: Arc<Image<f32>>,
    /// Measured depth, if there is any.
    pub depth: Option<MeasuredDepth>,
}

/// Measured depth of a keyframe.
#[derive(Clone, Debug)]
pub struct MeasuredDepth {
    /// Depth along the optical axis, in the unit of the poses; 0 without a reading.
    pub depth: Arc<Image<f32>>,
    /// Pose of the keyframe in the camera when the depth was measured.
    pub depth_from_colour: Pose<f64>,
}

impl KeyframePictures {
    /// A keyframe without measured depth.
    pub fn colour_only(colour: Arc<Image<f32>>) -> Self {
        Self { colour, depth: None }
    }
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
    /// Keyframes that each of them was matched with.
    matched: BTreeMap<usize, Vec<usize>>,
    /// Model of the sensor, and the readings of keyframes that have some.
    depth_model: Option<DepthModel>,
    measured: BTreeMap<usize, InverseDepthEstimate>,
    /// Evidence of pictures against the readings of keyframes, see [`picture_check`].
    evidence: BTreeMap<usize, Vec<f32>>,
    cancellation: CancellationToken,
    /// Largest difference between the numbers of a keyframe and of those it is matched with.
    reach: usize,
    /// True if the keyframes are photographs in any order.
    is_unordered: bool,
}

impl DenseDepthEstimator {
    /// For keyframes of one camera, in the order in which they were taken.
    pub fn new(camera: Camera<f64>, views: Vec<PosedView>) -> Self {
        Self {
            camera,
            views,
            pictures: BTreeMap::new(),
            estimates: BTreeMap::new(),
            matched: BTreeMap::new(),
            depth_model: None,
            measured: BTreeMap::new(),
            evidence: BTreeMap::new(),
            cancellation: CancellationToken::default(),
            reach: MAX_KEYFRAME_DISTANCE,
            is_unordered: false,
        }
    }

    /// Matches photographs, which are in no order, with any others; beyond [`MAX_PHOTOGRAPH_DISTANCE`] with
    /// those whose numbers differ by less, which bounds the memory.
    #[must_use]
    pub fn with_any_order(self) -> Self {
        Self { reach: MAX_PHOTOGRAPH_DISTANCE, is_unordered: true, ..self }
    }

    /// Uses measured depth with the deviations of `model`.
    #[must_use]
    pub fn with_depth_model(self, model: Option<DepthModel>) -> Self {
        Self { depth_model: model, ..self }
    }

    /// Adds a keyframe after the others, for use while they are taken. `depth_model` is that of the
    /// sensor as known now, which readings from now on get their deviations from.
    pub fn add_view(&mut self, view: PosedView, depth_model: Option<DepthModel>) {
        self.views.push(view);
        self.depth_model = depth_model;
    }

    /// Corrects the pose of a keyframe; its depth as estimated stays, in its camera.
    pub fn set_pose(&mut self, index: usize, world_from_camera: Pose<f64>) {
        if let Some(view) = self.views.get_mut(index) {
            view.world_from_camera = world_from_camera;
        }
    }

    /// Matches no pictures once `cancellation` is cancelled: estimates are those of measured depth then, or
    /// `None`.
    #[must_use]
    pub fn with_cancellation(self, cancellation: CancellationToken) -> Self {
        Self { cancellation, ..self }
    }

    /// Estimates the depth of keyframe `index`, of one up to [`MAX_KEYFRAME_DISTANCE`] before the last
    /// one again with those that have come since. `load` gives the pictures of a keyframe, or `None`; it
    /// is called once for each while indices rise, or fall by no more.
    pub fn estimate(
        &mut self,
        index: usize,
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) -> Option<DenseDepth> {
        if index >= self.views.len() {
            return None;
        }
        let others = self.selected_views(index);
        others.iter().chain([&index]).for_each(|i| self.ensure_pictures(*i, load));
        // Keyframes that have come since may see it with more parallax.
        if self.matched.get(&index).is_some_and(|matched| *matched != others) {
            self.estimates.remove(&index);
        }
        let readings = self.fused_readings(index, &others);
        let swept = self.fused_sweep(index, &others, load);
        let depth = match (readings, swept) {
            (Some(readings), Some(swept)) => {
                let contradicted = self.compare_with_pictures(index, &others, &readings, &swept);
                Some(completed(readings, &contradicted, &swept_depth(&swept)))
            }
            (Some(readings), None) => Some(depth_from_inverse(&readings)),
            (None, swept) => swept.as_ref().map(swept_depth),
        };
        let oldest = index.saturating_sub(2 * self.reach);
        self.estimates.retain(|i, _| *i >= oldest);
        self.matched.retain(|i, _| *i >= oldest);
        self.measured.retain(|i, _| *i >= oldest);
        self.evidence.retain(|i, _| *i >= oldest);
        self.pictures.retain(|i, _| *i + self.reach >= oldest);
        depth
    }

    /// Matches keyframe `index` with others, as [`estimate`](Self::estimate) of it and of those around it does
    /// unless it was done before. `load` as for it.
    pub fn prepare(
        &mut self,
        index: usize,
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) {
        if index < self.views.len() {
            self.ensure_estimate(index, load);
        }
    }

    /// Measured depth of a frame between keyframes, at `world_from_camera` and near keyframe `near`,
    /// averaged with that of keyframes, without readings that pictures are known to contradict; holes
    /// stay. `load` as for [`estimate`](Self::estimate). `None` without a model of the sensor.
    pub fn fuse(
        &mut self,
        world_from_camera: Pose<f64>,
        near: usize,
        measured: &MeasuredDepth,
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) -> Option<DenseDepth> {
        let own = readings(measured, &self.camera, self.depth_model.as_ref()?);
        let mut known: Vec<f64> = own
            .inverse_depth
            .data
            .iter()
            .filter(|r| **r > 0.0)
            .map(|r| 1.0 / f64::from(*r))
            .collect();
        let others = match median(&mut known) {
            Some(depth) => self.views_near(near, None, world_from_camera, depth),
            None => Vec::new(),
        };
        others.iter().for_each(|i| self.ensure_pictures(*i, load));
        let known = self.relative_to(world_from_camera, &others, &self.measured);
        let mut fused = fuse_readings(&self.camera, &own, &known);
        let none = vec![0.0; fused.inverse_depth.data.len()];
        let contradicted = self.contradicted(world_from_camera, &fused, none);
        fused.remove(&contradicted);
        Some(depth_from_inverse(&fused))
    }

    /// Inverse depth from pictures alone, confirmed by other keyframes.
    fn fused_sweep(
        &mut self,
        index: usize,
        others: &[usize],
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) -> Option<InverseDepthEstimate> {
        self.ensure_estimate(index, load)?;
        for other in others {
            self.ensure_estimate(*other, load);
        }
        if self.cancellation.is_cancelled() {
            return None;
        }
        let own = self.estimates.get(&index)?;
        let known = self.relative_to(self.pose(index), others, &self.estimates);
        Some(fuse_consistent(&self.camera, own, &known, self.is_unordered))
    }

    /// Compares the readings of a keyframe with pictures of `others`; marks those that are contradicted.
    fn compare_with_pictures(
        &mut self,
        index: usize,
        others: &[usize],
        readings: &InverseDepthEstimate,
        swept: &InverseDepthEstimate,
    ) -> Vec<bool> {
        self.evidence.remove(&index);
        let mut evidence = self.evidence_of_pictures(index, others, readings, swept);
        let confirmed = |pixel: usize| swept.is_known(pixel) && agree(readings, swept, pixel);
        let all = evidence.iter_mut().enumerate();
        all.filter(|(pixel, _)| confirmed(*pixel)).for_each(|(_, e)| *e = e.min(0.0));
        let mut out = self.contradicted(self.pose(index), readings, evidence.clone());
        out.iter_mut().enumerate().for_each(|(pixel, out)| *out &= !confirmed(pixel));
        self.evidence.insert(index, evidence);
        out
    }

    /// Evidence of pictures of `others` against the readings of a keyframe; 0 without its picture.
    fn evidence_of_pictures(
        &self,
        index: usize,
        others: &[usize],
        readings: &InverseDepthEstimate,
        swept: &InverseDepthEstimate,
    ) -> Vec<f32> {
        let Some(own) = self.picture(index) else {
            return vec![0.0; readings.inverse_depth.data.len()];
        };
        let world_from_camera = self.pose(index);
        let (views, confirmed): (Vec<NeighbourView<'_>>, Vec<Vec<bool>>) = others
            .iter()
            .filter_map(|other| {
                let (picture, measured) = (self.picture(*other)?, self.measured.get(other)?);
                let pose = self.pose(*other).inverse() * world_from_camera;
                let confirmed = confirmed_readings(&self.camera, readings, measured, &pose);
                Some(((picture, pose), confirmed))
            })
            .unzip();
        let sweep = plane_sweep_at(&self.camera, own, &views, 0, picture_check::WINDOW);
        evidence_against(&sweep, readings, swept, &confirmed)
    }

    /// Marks readings that are contradicted by evidence of their own view and of keyframes.
    fn contradicted(
        &self,
        world_from_camera: Pose<f64>,
        readings: &InverseDepthEstimate,
        mut evidence: Vec<f32>,
    ) -> Vec<bool> {
        for (index, of_keyframe) in &self.evidence {
            let Some(other) = self.measured.get(index) else { continue };
            let there = (other, self.pose(*index).inverse() * world_from_camera);
            add_evidence_of(&self.camera, readings, there, of_keyframe, &mut evidence);
        }
        let read = &readings.inverse_depth.data;
        evidence.iter().zip(read).map(|(sum, rho)| *sum > 0.0 && *rho > 0.0).collect()
    }

    /// Readings of a keyframe averaged with those of others; what they contradict is left out.
    fn fused_readings(&self, index: usize, others: &[usize]) -> Option<InverseDepthEstimate> {
        let known = self.relative_to(self.pose(index), others, &self.measured);
        let own = self.measured.get(&index)?;
        Some(fuse_readings(&self.camera, own, &known))
    }

    fn pose(&self, index: usize) -> Pose<f64> {
        self.views[index].world_from_camera
    }

    fn picture(&self, index: usize) -> Option<&Pyramid> {
        self.pictures.get(&index).and_then(Option::as_ref)
    }

    /// Pictures of other keyframes as a keyframe is matched with them.
    fn neighbour_views(&self, index: usize, others: &[usize]) -> Vec<NeighbourView<'_>> {
        let pose = self.pose(index);
        let view = |i: &usize| Some((self.picture(*i)?, self.pose(*i).inverse() * pose));
        others.iter().filter_map(view).collect()
    }

    /// Estimates of keyframes, with their poses `other_from_camera`.
    fn relative_to<'a>(
        &self,
        world_from_camera: Pose<f64>,
        others: &[usize],
        estimates: &'a BTreeMap<usize, InverseDepthEstimate>,
    ) -> Vec<(&'a InverseDepthEstimate, Pose<f64>)> {
        let relative =
            |i: &usize| Some((estimates.get(i)?, self.pose(*i).inverse() * world_from_camera));
        others.iter().filter_map(relative).collect()
    }

    /// Loads the pictures of a keyframe, unless done before.
    fn ensure_pictures(
        &mut self,
        index: usize,
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) {
        if self.pictures.contains_key(&index) {
            return;
        }
        let pictures = load(index);
        let depth = pictures.as_ref().and_then(|p| p.depth.as_ref());
        if let (Some(model), Some(depth)) = (&self.depth_model, depth) {
            self.measured.insert(index, readings(depth, &self.camera, model));
        }
        self.pictures.insert(index, pictures.map(|p| Pyramid::new(&p.colour)));
    }

    /// The keyframes to match one with.
    fn selected_views(&self, index: usize) -> Vec<usize> {
        let depth = median(&mut self.views[index].landmarks.clone()).filter(|d| *d > 0.0);
        let Some(depth) = depth else { return Vec::new() };
        self.views_near(index, Some(index), self.pose(index), depth)
    }

    /// Keyframes around number `near`, but for one, that see most of a scene at `depth` from a pose.
    fn views_near(
        &self,
        near: usize,
        except: Option<usize>,
        world_from_camera: Pose<f64>,
        depth: f64,
    ) -> Vec<usize> {
        let last = (near + self.reach + 1).min(self.views.len());
        let near = near.saturating_sub(self.reach)..last;
        let others: Vec<(usize, Pose<f64>)> =
            near.filter(|i| Some(*i) != except).map(|i| (i, self.pose(i))).collect();
        let limits = if self.is_unordered { PHOTOGRAPHS } else { KEYFRAMES };
        select_views(&self.camera, world_from_camera, &others, depth, limits)
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
        load: &mut dyn FnMut(usize) -> Option<KeyframePictures>,
    ) -> Option<()> {
        if self.estimates.contains_key(&index) {
            return Some(());
        }
        let (chosen, bounds) = (self.selected_views(index), self.inverse_depth_bounds(index)?);
        chosen.iter().chain([&index]).for_each(|i| self.ensure_pictures(*i, load));
        let others = self.neighbour_views(index, &chosen);
        if others.is_empty() {
            return None;
        }
        let picture = self.picture(index)?;
        let found =
            estimate_inverse_depth(&self.camera, picture, &others, bounds, &self.cancellation)?;
        let found = match self.is_unordered {
            true => PatchMatch::new(&self.camera, picture.finest(), &others, bounds)
                .refine(&found.inverse_depth, &self.cancellation)?,
            false => found,
        };
        self.estimates.insert(index, found);
        self.matched.insert(index, chosen);
        Some(())
    }
}

/// Inverse depths of a sensor, registered to the colour picture, with their variances.
fn readings(
    measured: &MeasuredDepth,
    camera: &Camera<f64>,
    model: &DepthModel,
) -> InverseDepthEstimate {
    let MeasuredDepth { depth, depth_from_colour } = measured;
    let mut inverse_depth = register_depth(depth, camera, model.shift, depth_from_colour);
    let mut variance = Image::new(inverse_depth.width, inverse_depth.height, 1);
    for (value, variance) in inverse_depth.data.iter_mut().zip(&mut variance.data) {
        let is_read = *value > 0.0 && value.is_finite();
        *value = if is_read { value.recip() } else { 0.0 };
        *variance = if is_read { model.sigma(f64::from(*value)).powi(2) as f32 } else { 0.0 };
    }
    InverseDepthEstimate { inverse_depth, variance }
}

/// Measured depth without contradicted readings, completed by estimated depth in their place, and
/// wherever it is missing if that is in more than [`MAX_MISSING_SHARE`].
fn completed(
    mut readings: InverseDepthEstimate,
    contradicted: &[bool],
    estimated: &DenseDepth,
) -> DenseDepth {
    let mut rejected = depth_from_inverse(&readings).depth;
    rejected.data.iter_mut().zip(contradicted).filter(|(_, is)| !**is).for_each(|(z, _)| *z = 0.0);
    let fills_holes = missing_share(&readings) > MAX_MISSING_SHARE;
    readings.remove(contradicted);
    let mut out = depth_from_inverse(&readings);
    let pixels = out.depth.data.iter_mut().zip(&mut out.variance.data).enumerate();
    let is_replaced = |pixel: usize, z: f32| z <= 0.0 && (fills_holes || contradicted[pixel]);
    for (pixel, (z, variance)) in pixels.filter(|(pixel, (z, _))| is_replaced(*pixel, **z)) {
        (*z, *variance) = (estimated.depth.data[pixel], estimated.variance.data[pixel]);
    }
    DenseDepth { contradicted: Some(rejected), ..out }
}

/// Share of pixels without inverse depth.
fn missing_share(estimate: &InverseDepthEstimate) -> f64 {
    let all = &estimate.inverse_depth.data;
    all.iter().filter(|rho| **rho <= 0.0).count() as f64 / all.len().max(1) as f64
}

/// Depth of a plane sweep: beside edges windows may have matched either surface.
fn swept_depth(swept: &InverseDepthEstimate) -> DenseDepth {
    let mut out = depth_from_inverse(swept);
    inflate_variance_at_edges(&mut out, EDGE_REACH);
    out
}

/// Depth with variance `σ_z = z² σ_ρ`, where that is small enough.
fn depth_from_inverse(estimate: &InverseDepthEstimate) -> DenseDepth {
    let (width, height) = (estimate.inverse_depth.width, estimate.inverse_depth.height);
    let image = || Image::new(width, height, 1);
    let mut out = DenseDepth { depth: image(), variance: image(), contradicted: None };
    for (pixel, rho) in estimate.inverse_depth.data.iter().enumerate() {
        if estimate.is_known(pixel) {
            let z = 1.0 / rho;
            out.depth.data[pixel] = z;
            out.variance.data[pixel] = estimate.variance.data[pixel] * z.powi(4);
        }
    }
    out
}
