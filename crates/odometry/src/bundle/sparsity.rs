//! Sparsity of the reduced camera system, and the order of poses that keeps its profile narrow.

use super::{Bundle, GLOBALS};
use i2slam_compute::reverse_cuthill_mckee;

/// Free poses from which on reordering pays.
const MIN_REORDERED_POSES: usize = 64;

/// An index; bundles have fewer than 2³² landmarks and observations.
pub(super) type Index = u32;

/// The free poses of a bundle as blocks of unknowns, and their couplings by landmarks.
pub(super) struct BlockSparsity {
    /// Block of every pose; `None` for fixed ones.
    pub(super) blocks: Vec<Option<usize>>,
    /// Pose of every block.
    pub(super) poses: Vec<usize>,
    /// Block and observation index of every free observation of each landmark, in order of blocks.
    pub(super) landmark_observations: Vec<Vec<(Index, Index)>>,
    /// Landmarks of every block, with the place of the observation in `cameras`.
    pub(super) block_observations: Vec<Vec<(Index, Index)>>,
    /// The first block that every block shares a landmark with.
    pub(super) first: Vec<usize>,
}

impl BlockSparsity {
    pub(super) fn new(bundle: &Bundle) -> Self {
        let free: Vec<usize> = (0..bundle.poses.len()).filter(|p| !bundle.fixed[*p]).collect();
        let natural = Self::with_order(bundle, free);
        if natural.poses.len() < MIN_REORDERED_POSES {
            return natural;
        }
        let mut adjacency = block_adjacency(&natural.landmark_observations, natural.poses.len());
        for [a, b] in natural.coupled_blocks(bundle) {
            adjacency[a].push(b);
            adjacency[b].push(a);
        }
        let order = reverse_cuthill_mckee(&adjacency);
        let narrow =
            Self::with_order(bundle, order.into_iter().map(|b| natural.poses[b]).collect());
        if narrow.block_count() < natural.block_count() { narrow } else { natural }
    }

    fn with_order(bundle: &Bundle, poses: Vec<usize>) -> Self {
        let mut blocks = vec![None; bundle.poses.len()];
        poses.iter().enumerate().for_each(|(block, pose)| blocks[*pose] = Some(block));
        let mut block_observations = vec![Vec::new(); poses.len()];
        let mut first: Vec<usize> = (0..poses.len()).collect();
        let mut landmark_observations = Vec::with_capacity(bundle.observations.len());
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
                block_observations[block].push((landmark as Index, k as Index));
                first[block] = first[block].min(least);
            }
            landmark_observations.push(of);
        }
        let mut out = Self { blocks, poses, landmark_observations, block_observations, first };
        for [a, b] in out.coupled_blocks(bundle) {
            out.first[a.max(b)] = out.first[a.max(b)].min(a.min(b));
        }
        out
    }

    /// Pairs of free blocks coupled by a relative pose.
    fn coupled_blocks(&self, bundle: &Bundle) -> Vec<[usize; 2]> {
        let pairs = bundle.relative_poses.iter();
        pairs.filter_map(|f| Some([self.blocks[f.first]?, self.blocks[f.second]?])).collect()
    }

    /// Column of the first entry of every row of the reduced camera system: six rows a block, then
    /// the global parameters, whose rows are full.
    pub(super) fn first_columns(&self, globals: usize) -> Vec<usize> {
        let rows = self.first.iter().flat_map(|block| [6 * block; 6]);
        rows.chain([0; GLOBALS].into_iter().take(globals)).collect()
    }

    /// Number of stored blocks.
    pub(super) fn block_count(&self) -> usize {
        self.first.iter().enumerate().map(|(block, first)| block + 1 - first).sum()
    }
}

/// Adjacency of blocks, each with the first of every landmark: enough for the ordering.
fn block_adjacency(
    landmark_observations: &[Vec<(Index, Index)>],
    blocks: usize,
) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); blocks];
    let mut pairs: Vec<(Index, Index)> = Vec::new();
    let mut most = 1 << 16;
    for of in landmark_observations {
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
