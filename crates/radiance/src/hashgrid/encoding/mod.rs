//! Multi-resolution hash encoding of positions (Müller et al. 2022), and spherical harmonics of
//! directions.
//!
//! Level `l` is a grid with `s_l + 1` cells along an edge of the unit cube,
//!
//! ```text
//! s_l = base · (finest / base)^(l / (levels - 1)) - 1
//! p   = x s_l + ½,   node = ⌊p⌋,   fraction f = p - node
//! e_l = Σ_{corner c of 8} Π_k (c_k ? f_k : 1 - f_k) table_l[index(node + c)]
//! ```
//!
//! A grid with no more nodes than the table stores each; of a finer one the nodes share entries,
//! `index = (x ⊕ 2654435761 y ⊕ 805459861 z) mod size`.

pub(crate) mod cpu;
pub(crate) mod harmonics;
mod interpolation;
pub(crate) mod reference;

use super::FieldSettings;

/// Factors of the coordinates in the hash.
pub(crate) const PRIMES: [u32; 3] = [1, 2_654_435_761, 805_459_861];

/// One grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Level {
    /// `s_l`: nodes per unit of length.
    pub(crate) scale: f64,
    pub(crate) factors: [u32; 3],
    /// True if the index is a hash.
    pub(crate) hashed: bool,
    /// Index of the level's first entry in the table.
    pub(crate) first: usize,
    /// Number of entries; a power of two where hashed.
    pub(crate) entries: usize,
}

impl Level {
    /// Index of a node, within the level.
    pub(crate) fn index(&self, node: [u32; 3]) -> usize {
        let [a, b, c] = [0, 1, 2].map(|k| node[k].wrapping_mul(self.factors[k]));
        if self.hashed { (a ^ b ^ c) as usize & (self.entries - 1) } else { (a + b + c) as usize }
    }
}

/// The grids of checked settings, from coarse to fine.
pub(crate) fn levels(settings: &FieldSettings) -> Vec<Level> {
    let (base, finest) = (f64::from(settings.base_resolution), settings.finest_resolution);
    let most = 1_usize << settings.log2_table;
    let mut first = 0;
    let mut levels = Vec::with_capacity(settings.levels);
    for l in 0..settings.levels {
        let part = l as f64 / (settings.levels - 1).max(1) as f64;
        let scale = base * (f64::from(finest) / base).powf(part) - 1.0;
        let nodes = scale.ceil() as usize + 2;
        let hashed = nodes.pow(3) > most;
        let entries = if hashed { most } else { nodes.pow(3) };
        let dense = [1, nodes as u32, (nodes * nodes) as u32];
        let factors = if hashed { PRIMES } else { dense };
        levels.push(Level { scale, factors, hashed, first, entries });
        first += entries;
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_grow_from_base_to_finest() {
        let settings = FieldSettings::cube([0.0; 3], 1.0);
        let levels = levels(&settings);
        assert_eq!(levels.len(), 16);
        assert_eq!(levels[0].scale, 15.0);
        assert!((levels[15].scale - 2047.0).abs() < 1e-6);
        assert!(!levels[0].hashed && levels[15].hashed);
        assert_eq!(levels[1].first, levels[0].entries);
        assert_eq!(levels[15].entries, 1 << 19);
    }

    #[test]
    fn every_node_of_a_dense_level_has_its_entry() {
        let settings = FieldSettings { base_resolution: 4, ..FieldSettings::cube([0.0; 3], 1.0) };
        let level = levels(&settings)[0];
        let nodes = level.factors[1];
        let mut seen = vec![false; level.entries];
        for z in 0..nodes {
            for y in 0..nodes {
                (0..nodes).for_each(|x| seen[level.index([x, y, z])] = true);
            }
        }
        assert!(seen.iter().all(|s| *s));
    }
}
