//! The ground of a scene: the lowest large level surface.

use i2slam::geometry::Vec3;

/// A small piece of a surface as a camera sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Place in the world.
    pub place: Vec3<f64>,
    /// Unit normal towards the camera.
    pub normal: Vec3<f64>,
    /// Area, up to one factor for all pieces.
    pub area: f64,
    /// Distance along the camera's axis.
    pub depth: f64,
}

/// Largest angle between a level surface's normal and the vertical [degrees].
const MAX_SLOPE: f64 = 12.0;
/// Half the range of heights that is one surface, as a share of the median depth.
const THICKNESS: f64 = 0.015;
/// Least area of the ground, as a share of that of the largest level surface.
const MIN_AREA: f64 = 0.2;
/// Least share of the patches that are level.
const MIN_SHARE: f64 = 0.02;

/// Height of the ground along `up`, a unit vector: of the lowest level surface that has a fifth of the area
/// of the largest one, such as the table where no floor was seen. `None` where hardly anything is level.
pub(super) fn ground(patches: &[Patch], up: Vec3<f64>) -> Option<f64> {
    let least = MAX_SLOPE.to_radians().cos();
    let level = patches.iter().filter(|patch| patch.normal.dot(up) > least);
    let mut level: Vec<(f64, f64)> = level.map(|patch| (patch.place.dot(up), patch.area)).collect();
    if (level.len() as f64) < MIN_SHARE.mul_add(patches.len() as f64, 1.0) {
        return None;
    }
    level.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut depths: Vec<f64> = patches.iter().map(|patch| patch.depth).collect();
    let middle = depths.len() / 2;
    let thickness = 2.0 * THICKNESS * *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
    let slabs: Vec<(usize, usize, f64)> = (0..level.len())
        .scan((0, 0.0), |(end, area), first| {
            while *end < level.len() && level[*end].0 <= level[first].0 + thickness {
                *area += level[*end].1;
                *end += 1;
            }
            let slab = (first, *end, *area);
            *area -= level[first].1;
            Some(slab)
        })
        .collect();
    let largest = slabs.iter().map(|slab| slab.2).fold(0.0, f64::max);
    let lowest = slabs.iter().position(|slab| slab.2 >= MIN_AREA * largest)?;
    // The first slab that is large enough still holds mostly what lies below the surface: the fullest of
    // those that overlap with it is on it.
    let overlapping = slabs[lowest..].iter().take_while(|slab| slab.0 < slabs[lowest].1);
    let (first, end, _) = overlapping.max_by(|a, b| a.2.total_cmp(&b.2))?;
    Some(level[(first + end) / 2].0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: Vec3<f64> = Vec3 { x: 0.0, y: -1.0, z: 0.0 };

    /// Patches of a level surface at a height, with noise of a hundredth.
    fn surface(height: f64, count: usize, area: f64) -> Vec<Patch> {
        let patch = |i: usize| Patch {
            place: Vec3::new(
                0.1 * i as f64,
                -height + 0.01 * ((7 * i % 11) as f64 / 5.0 - 1.0),
                2.0,
            ),
            normal: UP,
            area,
            depth: 2.0,
        };
        (0..count).map(patch).collect()
    }

    #[test]
    fn the_floor_is_lower_than_the_table_and_what_is_mirrored_below_it_is_none() {
        let (floor, table, mirrored) =
            (surface(-1.2, 100, 3.0), surface(-0.4, 300, 1.0), surface(-2.0, 10, 3.0));
        let wall = Patch { normal: Vec3::new(0.0, 0.0, -1.0), ..surface(-3.0, 1, 1.0)[0] };
        let ceiling = Patch { normal: -UP, ..surface(-3.0, 1, 1.0)[0] };
        let all = [floor, table.clone(), mirrored, vec![wall; 900], vec![ceiling; 200]].concat();
        let found = ground(&all, UP).expect("a floor");
        assert!((found + 1.2).abs() < 0.01, "{found}");
        let found = ground(&[table, vec![wall; 900]].concat(), UP).expect("a table");
        assert!((found + 0.4).abs() < 0.01, "{found}");
        assert_eq!(ground(&vec![wall; 900], UP), None);
        assert_eq!(ground(&[], UP), None);
    }
}
