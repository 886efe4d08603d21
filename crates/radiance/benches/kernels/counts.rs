//! Operations and bytes of each stage, counted from the source of the kernels.
//!
//! Operations: additions, subtractions, multiplications, divisions, roots, minima, maxima and
//! comparisons of numbers count one, a multiply-add two; selections and integer operations count
//! nothing. Every lane of a vector counts, whether its pixel is inside of the ellipse or not,
//! because the machine computes it. Bytes: every array that a stage reads or writes, once per
//! access of an item; what stays in the first-level cache (the pixels of a tile) counts once per
//! tile.

use i2slam_radiance::gaussian::Work;
use i2slam_radiance::hashgrid::FieldSettings;

/// Pixels of a row of a tile, and of a tile.
const ROW: usize = 16;
const TILE: usize = ROW * ROW;

/// Operations and bytes of one stage.
#[derive(Clone, Copy)]
pub(crate) struct Count {
    pub(crate) operations: f64,
    pub(crate) bytes: f64,
}

fn count(operations: usize, bytes: usize) -> Count {
    Count { operations: operations as f64, bytes: bytes as f64 }
}

/// An isotropic Gaussian's mean, scales, opacity and colour; its footprint.
const PARAMETERS: usize = 40;
const FOOTPRINT: usize = 64;

/// `project/cpu_forward.rs`. To the camera 18, 1/z and x/z 3, range 4, Jacobian 4, standard
/// deviation 20, covariance 10, opacity 40, colours 63, inverse 7, centre 4, checks 19, extents
/// and box 26, exponents 3.
pub(crate) fn project(work: &Work) -> Count {
    count(221 * work.gaussians, (PARAMETERS + FOOTPRINT) * work.gaussians)
}

/// `sort.rs`: smallest and largest key, load, unload; per pass of three, one reading for the
/// counts and one reading and writing.
pub(crate) fn sort(work: &Work) -> Count {
    count(0, (3 * 16 + 3 * 24) * work.visible)
}

/// `bin.rs`: two readings of items and footprints; per pair an entry and a place. Rows of an
/// ellipse: 30 per footprint, 33 per pair.
pub(crate) fn bin(work: &Work) -> Count {
    let bytes = 2 * (8 + FOOTPRINT) * work.visible + 12 * work.pairs;
    count(30 * work.visible + 33 * work.pairs, bytes)
}

/// `rasterize/cpu_forward.rs`: offset 1, exponent and its power of two 18, limits 3, weight and
/// transmittance 2, depth 4, four planes 8; row 4. Per tile its five planes, written and copied out.
pub(crate) fn blend(work: &Work) -> Count {
    let bytes = (8 + FOOTPRINT) * work.visited + 3 * 5 * 4 * TILE * work.tiles;
    count(40 * ROW * work.rows, bytes)
}

/// `rasterize/cpu_backward.rs`: as forward up to the transmittance 28, light from the pixel 12 and
/// from behind 6, derivative of opacity 2, thirteen sums 26; per pair thirteen sums over 16 lanes. Per
/// tile five planes of the picture and five of the cotangent.
pub(crate) fn blend_back(work: &Work) -> Count {
    let bytes = (8 + FOOTPRINT + 52) * work.visited + 10 * 4 * TILE * work.tiles;
    count(74 * ROW * work.rows + 13 * 15 * work.visited, bytes)
}

/// `project/cpu_backward.rs`: sums 13 per pair; stages 50, conic 3, centre 6, covariance 9, ball
/// 20, mean 35, pose 18, world 15, appearance 30. The gradient's 14 numbers are read and written.
pub(crate) fn project_back(work: &Work) -> Count {
    let bytes = (PARAMETERS + FOOTPRINT + 8 + 113) * work.visible + 56 * work.pairs;
    count(13 * work.pairs + 186 * work.visible, bytes)
}

/// Operations of a sample of a hash-grid field, forward and back to the field. Of its networks
/// only those of its widths count, not those of the padding.
pub(crate) struct FieldCount {
    pub(crate) forward: f64,
    pub(crate) backward: f64,
}

/// `hashgrid/encoding`, `network`, `render`. A level: corners 15, seven interpolations of 3 per
/// feature; back: weights 15, eight corners of 2 per feature. Networks: two per weight, and back
/// three times that, because they are run forward again. Five exponentials of 16; blend 12, undone
/// 30.
pub(crate) fn field(settings: &FieldSettings) -> FieldCount {
    let (width, geometry) = (settings.hidden_width, settings.geometry_features);
    let (levels, features) = (settings.levels, settings.features);
    let density = (levels * features + 1 + geometry) * width;
    let colour = (16 + geometry + width + 3) * width;
    let networks = 2 * (density + colour);
    FieldCount {
        forward: (levels * (15 + 21 * features) + networks + 5 * 16 + 12) as f64,
        backward: (levels * (15 + 15 + 16 * features) + 3 * networks + 4 * 16 + 30) as f64,
    }
}
