//! Updates of the occupancy grid.

use super::*;
use i2slam_geometry::Vec3;

fn renderer() -> FieldRenderer {
    FieldRenderer::new(MarchSettings::cube(1.5))
}

/// A field of density 1 everywhere is not emptied although it is below the threshold.
#[test]
fn an_untrained_field_stays_occupied() {
    let field = HashGridField::<f32>::new(settings(), 1).expect("settings in range");
    let mut occupancy = Occupancy::new(OccupancySettings { resolution: 8, ..Default::default() });
    assert_eq!(occupancy.occupied_share(), 1.0);
    (0..3).for_each(|_| occupancy.refresh(&field, &mut renderer(), 1));
    assert_eq!((occupancy.occupied_share(), occupancy.updates()), (1.0, 3));
}

/// After the full updates only a part of the cells is looked at; the others keep what they had.
#[test]
fn later_looks_are_partial_and_forget_slowly() {
    let dense = field(settings(), 4).cast::<f32>();
    let grid = OccupancySettings { resolution: 8, full_updates: 1, ..Default::default() };
    let mut occupancy = Occupancy::new(grid);
    occupancy.refresh(&dense, &mut renderer(), 1);
    let before = occupancy.densities().to_vec();
    // Hidden units that are all silent: density 1 everywhere.
    let mut empty = dense.clone();
    empty.parameters_mut()[1].fill(-1.0);
    empty.parameters_mut()[0].fill(10.0);
    occupancy.refresh(&empty, &mut renderer(), 1);
    let kept = occupancy.densities().iter().zip(&before).filter(|(a, b)| a == b).count();
    assert!(kept > before.len() / 4 && kept < before.len(), "{kept} of {}", before.len());
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let field = field(settings(), 4).cast::<f32>();
    let look = |seed: u64| {
        let grid = OccupancySettings { resolution: 8, full_updates: 1, ..Default::default() };
        let mut occupancy = Occupancy::new(grid);
        (0..4).for_each(|_| occupancy.refresh(&field, &mut renderer(), seed));
        occupancy
    };
    assert!(look(1) == look(1) && look(1) != look(2));
}

#[test]
fn cells_are_taken_as_given() {
    let grid = OccupancySettings { resolution: 4, ..Default::default() };
    let there = |p: Vec3<f32>| p.x > 1.0;
    let occupancy = Occupancy::of_cells([1.0, 0.0, 0.0], 2.0, grid, there);
    assert_eq!(occupancy.occupied_share(), 0.5);
    assert!(occupancy.is_occupied([0.9, 0.1, 0.1]) && !occupancy.is_occupied([0.4, 0.1, 0.1]));
}

/// A wall at 1 m is held around its depth and nowhere else, also after it was saved.
#[test]
fn cells_around_a_depth_are_held() {
    let field = HashGridField::<f32>::new(settings(), 1).expect("settings in range");
    let [x, y, z] = settings().centre.map(|c| c as f32);
    let origin = Vec3::new(x, y, z);
    let ray = Ray { origin, direction: Vec3::new(0.0, 0.0, 2.0), offset: 0.5 };
    let grid = OccupancySettings { resolution: 60, ..Default::default() };
    let mut occupancy = Occupancy::empty(grid);
    assert_eq!(occupancy.occupied_share(), 0.0);
    occupancy.mark_cells(&field, &ray, 0.45, 0.55);
    let march = MarchSettings { step_min: 0.01, step_max: 0.01, ..MarchSettings::cube(1.5) };
    let samples = occupancy.samples(&field, &march, &ray);
    let depths: Vec<f32> = samples.iter().map(|s| 2.0 * s.depth).collect();
    let size = 2.0 * settings().bound as f32 / 60.0;
    assert!(depths.len() > 15 && depths.iter().all(|d| (d - 1.0).abs() < 0.1 + size), "{depths:?}");
    let saved = HashGridMap { field, occupancy, march };
    assert_eq!(HashGridMap::from_bytes(&saved.to_bytes()), Ok(saved));
}

/// Every place of a ray that crosses cells at their corners is held, and no cell beside it.
#[test]
fn no_crossed_cell_is_missed() {
    let field = HashGridField::<f32>::new(settings(), 1).expect("settings in range");
    let (low, size) =
        (settings().centre.map(|c| (c - settings().bound) as f32), 2.0 * settings().bound as f32);
    let grid = OccupancySettings { resolution: 40, ..Default::default() };
    let mut random = i2slam_compute::Random::new(5);
    for _ in 0..20 {
        let mut within = || {
            Vec3::from_array(std::array::from_fn(|k| {
                low[k] + size * (0.1 + 0.8 * random.uniform() as f32)
            }))
        };
        let (from, to) = (within(), within());
        let ray = Ray { origin: from, direction: to - from, offset: 0.0 };
        let mut occupancy = Occupancy::empty(grid);
        occupancy.mark_cells(&field, &ray, 0.0, 1.0);
        let cells: std::collections::BTreeSet<[u32; 3]> = (0..=100_000)
            .map(|i| {
                let place = (ray.origin + ray.direction * (i as f32 / 100_000.0)).to_array();
                let unit = std::array::from_fn(|k| (place[k] - low[k]) / size);
                assert!(occupancy.is_occupied(unit), "{unit:?}");
                unit.map(|x| (x * 40.0) as u32)
            })
            .collect();
        let held = (occupancy.occupied_share() * 64_000.0).round() as usize;
        assert!(held.abs_diff(cells.len()) <= 1, "{held} of {}", cells.len());
    }
    let share = |origin: Vec3<f32>, direction: Vec3<f32>| {
        let mut occupancy = Occupancy::empty(grid);
        let ray = Ray { origin, direction, offset: 0.0 };
        occupancy.mark_cells(&field, &ray, 0.0, f32::INFINITY);
        occupancy.occupied_share()
    };
    let far = Vec3::new(1e6, low[1] + 0.5 * size, 0.0);
    assert!(share(far, Vec3::new(-1.0, 0.0, 0.0)) > 0.0);
    assert_eq!(share(Vec3::new(f32::MAX, 0.0, 0.0), Vec3::new(f32::NAN, 1.0, 0.0)), 0.0);
}

/// Cells outside of others are never occupied; cells that come in are sampled at once.
#[test]
fn looks_occupy_no_cell_that_is_not_allowed() {
    let field = HashGridField::<f32>::zeros(settings()).expect("settings in range");
    let grid = OccupancySettings { resolution: 6, ..Default::default() };
    let (centre, bound) = (settings().centre, settings().bound);
    let up_to = |share: f64| {
        let far = centre[0] + (2.0 * share - 1.0) * bound;
        Occupancy::of_cells(centre, bound, grid, |p| f64::from(p.x) < far)
    };
    let mut occupancy = Occupancy::new(grid);
    occupancy.restrict_to(&up_to(0.5));
    assert_eq!(occupancy.occupied_share(), 0.5);
    occupancy.refresh(&field, &mut renderer(), 1);
    assert_eq!(occupancy.occupied_share(), 0.5);
    assert_eq!(occupancy.densities().iter().filter(|d| **d == 1.0).count(), 108);
    occupancy.restrict_to(&up_to(1.0 / 3.0));
    assert_eq!(occupancy.occupied_share(), 1.0 / 3.0);
    occupancy.restrict_to(&up_to(1.0));
    assert_eq!(occupancy.occupied_share(), 1.0);
}

/// Reopened cells stay for the given number of updates, and only where allowed.
#[test]
fn reopened_cells_stay_for_some_looks() {
    let mut field = field(settings(), 4).cast::<f32>();
    field.parameters_mut()[1].iter_mut().for_each(|weight| *weight *= 8.0);
    let grid = OccupancySettings { resolution: 6, decay: 0.5, ..Default::default() };
    let (centre, bound) = (settings().centre, settings().bound);
    let half = Occupancy::of_cells(centre, bound, grid, |p| f64::from(p.x) < centre[0]);
    let mut occupancy = Occupancy::new(grid);
    occupancy.restrict_to(&half);
    let look = |occupancy: &mut Occupancy, times: usize| {
        (0..times).for_each(|_| occupancy.refresh(&field, &mut renderer(), 1));
        occupancy.occupied_share()
    };
    let settled = look(&mut occupancy, 12);
    assert!(settled > 0.0 && settled < 0.5, "{settled}");
    let emptied = occupancy.clone();
    occupancy.reopen(3);
    assert_eq!(occupancy.occupied_share(), 0.5);
    assert_eq!(look(&mut occupancy, 3), 0.5);
    assert!(look(&mut occupancy, 12) < 0.5);

    // Along a ray through the middle of all six cells of a row, of which three are allowed.
    let size = bound as f32 / 3.0;
    let unit = |column: usize, row: usize| {
        [column, row % 6, row / 6].map(|index| (index as f32 + 0.5) / 6.0)
    };
    let row = (0..36)
        .find(|&row| (0..3).any(|column| !emptied.is_occupied(unit(column, row))))
        .expect("a row with an empty cell");
    let [_, y, z] = [0, row % 6, row / 6].map(|index| (index as f32 - 2.5) * size);
    let middle = Vec3::from_array(centre.map(|c| c as f32));
    let ray = Ray {
        origin: middle + Vec3::new(-2.0 * bound as f32, y, z),
        direction: Vec3::new(1.0, 0.0, 0.0),
        offset: 0.0,
    };
    let mut occupancy = emptied.clone();
    occupancy.reopen_along(&field, &ray, 3);
    let open = |occupancy: &Occupancy| -> Vec<bool> {
        (0..6).map(|column| occupancy.is_occupied(unit(column, row))).collect()
    };
    assert_eq!(open(&occupancy), [true, true, true, false, false, false]);
    let opened = (occupancy.occupied_share() - emptied.occupied_share()) * 216.0;
    assert!(opened > 0.5 && opened < 3.5, "{opened}");
    look(&mut occupancy, 3);
    assert_eq!(open(&occupancy), [true, true, true, false, false, false]);
    look(&mut occupancy, 12);
    assert_ne!(open(&occupancy), [true, true, true, false, false, false]);
}
