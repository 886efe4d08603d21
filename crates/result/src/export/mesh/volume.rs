//! A truncated signed distance field in sparse blocks (Curless and Levoy 1996; blocks after Niessner et
//! al. 2013).

use i2slam::geometry::{Camera, Image, Pose, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Voxels along an edge of a block.
pub(super) const SIDE: usize = 8;
/// Voxels of a block.
pub(super) const VOXELS: usize = SIDE * SIDE * SIDE;
/// Distance at which the field is cut off [voxels].
const TRUNCATION: f64 = 4.0;
/// Most blocks: 2 GB.
const MAX_BLOCKS: usize = 250_000;
/// Least cosine between a surface and the line of sight: below, it is an edge, or seen too flat.
const MIN_COSINE: f64 = 0.15;

/// Place of a block, in blocks.
pub(super) type BlockPlace = [i32; 3];

/// 8 x 8 x 8 voxels, x fastest.
pub(super) struct Block {
    pub(super) place: BlockPlace,
    /// Signed distance to the surface over the truncation distance: 1 in the open, negative behind it.
    pub(super) distance: [f32; VOXELS],
    /// Sum of weights; 0 where nothing is known.
    pub(super) weight: [f32; VOXELS],
    /// Mean colour; 65535 is 1.
    pub(super) colour: Vec<[u16; 3]>,
    /// Sum of the weights of colours, which count near the surface alone.
    colour_weight: [f32; VOXELS],
}

/// The field.
pub(super) struct Volume {
    /// Edge of a voxel [m].
    pub(super) voxel: f64,
    pub(super) blocks: Vec<Block>,
    places: HashMap<BlockPlace, usize>,
    /// Most blocks.
    pub(super) max_blocks: usize,
}

/// A depth picture with colours.
pub(super) struct DepthView<'a> {
    pub(super) camera: &'a Camera<f64>,
    pub(super) world_from_camera: Pose<f64>,
    /// Along the optical axis [m], 0 where there is none.
    pub(super) depth: &'a Image<f32>,
    pub(super) colour: &'a Image<f32>,
}

impl Volume {
    pub(super) fn new(voxel: f64) -> Self {
        Self { voxel, blocks: Vec::new(), places: HashMap::new(), max_blocks: MAX_BLOCKS }
    }

    /// The number of a block.
    pub(super) fn block(&self, place: BlockPlace) -> Option<usize> {
        self.places.get(&place).copied()
    }

    /// Adds a picture; false if the scene has too many voxels.
    pub(super) fn add(&mut self, view: &DepthView<'_>) -> bool {
        let cosines = cosines(view);
        if !self.allocate(view, &cosines) {
            return false;
        }
        let (voxel, camera_from_world) = (self.voxel, view.world_from_camera.inverse());
        self.blocks.par_iter_mut().for_each(|block| {
            let corner = Vec3::from_array(block.place.map(f64::from)) * (voxel * SIDE as f64);
            if is_in_view(view.camera, camera_from_world * corner, voxel) {
                block.add(view, &cosines, camera_from_world, voxel);
            }
        });
        true
    }

    /// Makes room around the surfaces of a picture; false if that takes too much.
    fn allocate(&mut self, view: &DepthView<'_>, cosines: &[f64]) -> bool {
        let (band, block) = (TRUNCATION * self.voxel, self.voxel * SIDE as f64);
        for (pixel, _) in cosines.iter().enumerate().filter(|(_, cosine)| **cosine > 0.0) {
            let (column, row) = (pixel % view.depth.width, pixel / view.depth.width);
            let z = f64::from(view.depth.data[pixel]);
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = view.camera.unproject(u, v, 1.0);
            let reach = band / ray.norm();
            for step in -2..=2 {
                let depth = z + reach * f64::from(step) / 2.0;
                let point = view.world_from_camera * (ray * depth);
                let place = point.to_array().map(|v| (v / block).floor() as i32);
                if !self.places.contains_key(&place) {
                    self.places.insert(place, self.blocks.len());
                    self.blocks.push(Block::new(place));
                }
            }
            if self.blocks.len() > self.max_blocks {
                return false;
            }
        }
        true
    }
}

impl Block {
    fn new(place: BlockPlace) -> Self {
        let colour = vec![[0; 3]; VOXELS];
        let none = [0.0; VOXELS];
        Self { place, distance: [1.0; VOXELS], weight: none, colour, colour_weight: none }
    }

    fn add(
        &mut self,
        view: &DepthView<'_>,
        cosines: &[f64],
        camera_from_world: Pose<f64>,
        voxel: f64,
    ) {
        let first = self.place.map(|p| f64::from(p) * SIDE as f64);
        for i in 0..VOXELS {
            let [x, y, z] = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)].map(|v| v as f64);
            let at = Vec3::new(first[0] + x, first[1] + y, first[2] + z) * voxel;
            let local = camera_from_world * at;
            if local.z <= 0.0 {
                continue;
            }
            let (u, v) = view.camera.project(local);
            if !view.camera.contains(u, v, 0.0) {
                continue;
            }
            let pixel = v as usize * view.depth.width + u as usize;
            if cosines[pixel] <= 0.0 {
                continue;
            }
            let ray = local.norm() / local.z;
            let gap = (f64::from(view.depth.data[pixel]) - local.z) * ray / (TRUNCATION * voxel);
            // The distance to the plane of the surface, not along the line of sight. That one bounds
            // how far behind the surface is known, which may end soon where it is seen flat.
            let distance = gap * cosines[pixel];
            if gap > -1.0 {
                let weight = cosines[pixel] / local.norm_squared();
                self.average(i, (distance.min(1.0) as f32, weight as f32), view, pixel);
            }
        }
    }

    /// Weighted means of distance and, near the surface, colour.
    fn average(
        &mut self,
        i: usize,
        (distance, weight): (f32, f32),
        view: &DepthView<'_>,
        pixel: usize,
    ) {
        let sum = self.weight[i] + weight;
        self.distance[i] += weight / sum * (distance - self.distance[i]);
        self.weight[i] = sum;
        if distance < 1.0 {
            let sum = self.colour_weight[i] + weight;
            let share = weight / sum;
            self.colour_weight[i] = sum;
            for (c, mean) in self.colour[i].iter_mut().enumerate() {
                let new = view.colour.plane(c)[pixel].clamp(0.0, 1.0) * f32::from(u16::MAX);
                let before = f32::from(*mean);
                *mean = (before + share * (new - before)).round() as u16;
            }
        }
    }
}

/// Whether a block whose first corner lies at `corner` in the camera may be seen.
fn is_in_view(camera: &Camera<f64>, corner: Vec3<f64>, voxel: f64) -> bool {
    let reach = voxel * SIDE as f64 * 3.0_f64.sqrt();
    let margin = reach * camera.fx.max(camera.fy);
    if corner.z < -reach {
        return false;
    }
    if corner.z < 2.0 * reach {
        return true;
    }
    let (u, v) = camera.project(corner);
    let margin = margin / (corner.z - reach) * 2.0;
    camera.contains(u, v, -margin)
}

/// Cosines between surface normals and lines of sight; 0 where there is no depth, at edges, and where
/// the surface is seen too flat.
fn cosines(view: &DepthView<'_>) -> Vec<f64> {
    let (width, height) = (view.depth.width, view.depth.height);
    let point = |column: usize, row: usize| {
        let z = f64::from(view.depth.at(0, column, row));
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        (z > 0.0).then(|| view.camera.unproject(u, v, z))
    };
    let cosine = |pixel: usize| {
        let (column, row) = (pixel % width, pixel / width);
        let here = point(column, row)?;
        let (left, right) = (column.saturating_sub(1), (column + 1).min(width - 1));
        let (above, below) = (row.saturating_sub(1), (row + 1).min(height - 1));
        let across = point(right, row)? - point(left, row)?;
        let along = point(column, below)? - point(column, above)?;
        let normal = across.cross(along);
        let cosine = normal.dot(here).abs() / (normal.norm() * here.norm());
        (cosine > MIN_COSINE).then_some(cosine)
    };
    (0..width * height).into_par_iter().map(|pixel| cosine(pixel).unwrap_or(0.0)).collect()
}
