//! Which cameras share landmarks, and in which order they take least room.

use super::{Bundle, GLOBALS};
use i2slam_compute::reverse_cuthill_mckee;

/// With fewer free poses than this their order is that of the bundle.
const MIN_REORDERED_POSES: usize = 64;

/// Places in a list that never has more than four thousand million entries.
pub(super) type Index = u32;

/// The free poses of a bundle as blocks of unknowns, and where landmarks couple them. It is the
/// same as long as nobody adds sights.
pub(super) struct BlockSparsity {
    /// Block of every pose; `None` for fixed ones.
    pub(super) blocks: Vec<Option<usize>>,
    /// Pose of every block.
    pub(super) poses: Vec<usize>,
    /// For every landmark the block and the place of each sight by a free pose, in order of blocks.
    pub(super) cameras: Vec<Vec<(Index, Index)>>,
    /// For every block its landmarks, and the place in `cameras` of each.
    pub(super) seen: Vec<Vec<(Index, Index)>>,
    /// The first block that every block shares a landmark with.
    pub(super) first: Vec<usize>,
}

impl BlockSparsity {
    pub(super) fn new(bundle: &Bundle) -> Self {
        let free: Vec<usize> = (0..bundle.poses.len()).filter(|p| !bundle.fixed[*p]).collect();
        let natural = Self::of(bundle, free);
        if natural.poses.len() < MIN_REORDERED_POSES {
            return natural;
        }
        let order = reverse_cuthill_mckee(&neighbours(&natural.cameras, natural.poses.len()));
        let narrow = Self::of(bundle, order.into_iter().map(|b| natural.poses[b]).collect());
        if narrow.entries() < natural.entries() { narrow } else { natural }
    }

    fn of(bundle: &Bundle, poses: Vec<usize>) -> Self {
        let mut blocks = vec![None; bundle.poses.len()];
        poses.iter().enumerate().for_each(|(block, pose)| blocks[*pose] = Some(block));
        let mut seen = vec![Vec::new(); poses.len()];
        let mut first: Vec<usize> = (0..poses.len()).collect();
        let mut cameras = Vec::with_capacity(bundle.observations.len());
        for (landmark, observations) in bundle.observations.iter().enumerate() {
            let place = |(i, s): (usize, &super::BundleObservation)| {
                Some((blocks[s.pose]? as Index, i as Index))
            };
            let mut of: Vec<(Index, Index)> =
                observations.iter().enumerate().filter_map(place).collect();
            of.sort_unstable();
            let least = of.first().map_or(0, |c| c.0 as usize);
            for (k, (block, _)) in of.iter().enumerate() {
                let block = *block as usize;
                seen[block].push((landmark as Index, k as Index));
                first[block] = first[block].min(least);
            }
            cameras.push(of);
        }
        Self { blocks, poses, cameras, seen, first }
    }

    /// Column of the first entry of every row of the cameras' system: six rows a block, then
    /// those of the camera's own unknowns, which everything is coupled with.
    pub(super) fn first_columns(&self, globals: usize) -> Vec<usize> {
        let rows = self.first.iter().flat_map(|block| [6 * block; 6]);
        rows.chain([0; GLOBALS].into_iter().take(globals)).collect()
    }

    /// Blocks that the cameras' system keeps.
    pub(super) fn entries(&self) -> usize {
        self.first.iter().enumerate().map(|(block, first)| block + 1 - first).sum()
    }
}

/// Blocks next to every block: each is joined with the first one of every landmark that it sees,
/// which is enough to tell what lies near.
fn neighbours(cameras: &[Vec<(Index, Index)>], blocks: usize) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); blocks];
    let mut pairs: Vec<(Index, Index)> = Vec::new();
    let mut most = 1 << 16;
    for of in cameras {
        let Some(((first, _), rest)) = of.split_first() else { continue };
        pairs.extend(rest.iter().flat_map(|(block, _)| [(*first, *block), (*block, *first)]));
        if pairs.len() > most {
            pairs.sort_unstable();
            pairs.dedup();
            most = most.max(2 * pairs.len());
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs.into_iter().for_each(|(a, b)| out[a as usize].push(b as usize));
    out
}
