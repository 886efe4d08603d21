//! Surface points with the pictures that see them, sampled from the depth of the map.
//!
//! Every picture is divided into cells. The first point that an earlier picture brought and that lies on
//! the surface of this one fills the cell where it is seen; every other cell brings a new point. Points are
//! thus spread evenly, and a picture has one observation in a cell at most.

use i2slam::geometry::{Camera, Image, Pose, Vec3};

/// Cells across a picture.
const CELLS: usize = 100;
/// Largest difference between a point's depth and that of the surface, as a share of it: the rest
/// is hidden behind the surface.
const HIDDEN: f64 = 0.01;
/// Least opacity of a pixel that brings a point.
const MIN_OPACITY: f32 = 0.9;
/// Largest difference to the depth of neighbouring pixels, as a share of it: edges bring no points.
const EDGE: f32 = 0.02;

/// A point of the map's surface.
pub(crate) struct SeedPoint {
    /// Place in the world of the result [m].
    pub(crate) position: Vec3<f64>,
    /// Colour in the picture that brought it.
    pub(crate) colour: [u8; 3],
    /// Pictures that see it, with the number of the observation in each.
    pub(crate) track: Vec<(usize, usize)>,
}

/// A point in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Observation {
    /// Column and row [px]; the centre of the first pixel is at 0.5.
    pub(crate) at: (f64, f64),
    /// Number of the point.
    pub(crate) point: usize,
}

/// What one picture shows.
pub(crate) struct View<'a> {
    pub(crate) pose: Pose<f64>,
    pub(crate) picture: &'a Image<f32>,
    /// Depth of the surface [m], 0 where there is none.
    pub(crate) depth: &'a Image<f32>,
    pub(crate) opacity: &'a Image<f32>,
}

/// The points of a scene, and where pictures see them.
pub(crate) struct SeedPoints {
    camera: Camera<f64>,
    /// Side of a cell [px].
    cell: usize,
    pub(crate) points: Vec<SeedPoint>,
    /// Observations of each picture.
    pub(crate) observations: Vec<Vec<Observation>>,
}

impl SeedPoints {
    pub(crate) fn new(camera: Camera<f64>) -> Self {
        let cell = (camera.width / CELLS).max(1);
        Self { camera, cell, points: Vec::new(), observations: Vec::new() }
    }

    /// Adds a picture.
    pub(crate) fn add(&mut self, view: &View<'_>) {
        let (camera, cell) = (self.camera, self.cell);
        let columns = camera.width.div_ceil(cell);
        let mut filled = vec![false; columns * camera.height.div_ceil(cell)];
        let mut seen = Vec::new();
        let camera_from_world = view.pose.inverse();
        for (point, SeedPoint { position, .. }) in self.points.iter().enumerate() {
            let local = camera_from_world * *position;
            let Some(at) = seen_at(&camera, view.depth, local) else { continue };
            let place = &mut filled[at.1 as usize / cell * columns + at.0 as usize / cell];
            if !std::mem::replace(place, true) {
                seen.push(Observation { at, point });
            }
        }
        for empty in (0..filled.len()).filter(|&i| !filled[i]) {
            let (column, row) =
                (empty % columns * cell + cell / 2, empty / columns * cell + cell / 2);
            let Some(z) = surface_at(view, column, row) else { continue };
            let at = Camera::<f64>::pixel_centre(column, row);
            let position = view.pose * camera.unproject(at.0, at.1, z);
            let colour = |c| crate::pictures::byte(view.picture.at(c, column, row));
            let colour = std::array::from_fn(colour);
            seen.push(Observation { at, point: self.points.len() });
            self.points.push(SeedPoint { position, colour, track: Vec::new() });
        }
        let image = self.observations.len();
        for (number, observation) in seen.iter().enumerate() {
            self.points[observation.point].track.push((image, number));
        }
        self.observations.push(seen);
    }
}

/// Where a point in the camera is seen; none if it is outside or hidden.
fn seen_at(camera: &Camera<f64>, depth: &Image<f32>, local: Vec3<f64>) -> Option<(f64, f64)> {
    if local.z <= 0.0 {
        return None;
    }
    let (u, v) = camera.project(local);
    if !camera.contains(u, v, 0.5) {
        return None;
    }
    let surface = f64::from(depth.at(0, u as usize, v as usize));
    ((surface - local.z).abs() < HIDDEN * local.z).then_some((u, v))
}

/// Depth of a pixel that is opaque and no edge [m].
fn surface_at(view: &View<'_>, column: usize, row: usize) -> Option<f64> {
    let (width, height) = (view.depth.width, view.depth.height);
    if column == 0 || row == 0 || column + 1 >= width || row + 1 >= height {
        return None;
    }
    let z = view.depth.at(0, column, row);
    let near = [(column - 1, row), (column + 1, row), (column, row - 1), (column, row + 1)];
    let is_plain = near.iter().all(|&(u, v)| (view.depth.at(0, u, v) - z).abs() < EDGE * z);
    let is_opaque = view.opacity.at(0, column, row) >= MIN_OPACITY;
    (z > 0.0 && is_plain && is_opaque).then(|| f64::from(z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::geometry::Rotation;

    const SIZE: (usize, usize) = (200, 120);

    fn camera() -> Camera<f64> {
        Camera { width: SIZE.0, height: SIZE.1, fx: 150.0, fy: 150.0, cx: 100.0, cy: 60.0 }
    }

    fn plane(value: f32, channels: usize) -> Image<f32> {
        Image {
            width: SIZE.0,
            height: SIZE.1,
            channels,
            data: vec![value; SIZE.0 * SIZE.1 * channels],
        }
    }

    /// A wall 2 m before the world, seen by a camera that stepped to the right by `x` [m].
    fn see(points: &mut SeedPoints, x: f64, depth: &Image<f32>) {
        let pose = Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0));
        let (picture, opacity) = (plane(0.5, 3), plane(1.0, 1));
        points.add(&View { pose, picture: &picture, depth, opacity: &opacity });
    }

    #[test]
    fn points_are_seen_again_and_only_new_places_bring_new_ones() {
        let mut points = SeedPoints::new(camera());
        let wall = plane(2.0, 1);
        see(&mut points, 0.0, &wall);
        let first = points.points.len();
        assert!(first > 5000 && points.observations[0].len() == first, "{first}");
        // A step of 20 px: a tenth of the picture is new.
        see(&mut points, 20.0 * 2.0 / 150.0, &wall);
        let new = points.points.len() - first;
        assert!((500..700).contains(&new), "{new} of {first}");
        assert!(points.observations[1].len() > first * 9 / 10);
        let camera = camera();
        for (image, x) in [(0, 0.0), (1, 20.0 * 2.0 / 150.0)] {
            for (number, observation) in points.observations[image].iter().enumerate() {
                let point = &points.points[observation.point];
                let (u, v) = camera.project(point.position - Vec3::new(x, 0.0, 0.0));
                assert!((u - observation.at.0).abs() < 1e-9 && (v - observation.at.1).abs() < 1e-9);
                assert!(point.track.contains(&(image, number)));
                assert_eq!(point.colour, [128; 3]);
            }
        }
    }

    #[test]
    fn hidden_points_edges_and_holes_are_left_out() {
        let mut points = SeedPoints::new(camera());
        see(&mut points, 0.0, &plane(2.0, 1));
        let first = points.points.len();
        // Something stands before the wall now: none of its points is seen.
        see(&mut points, 0.0, &plane(1.0, 1));
        assert!(points.observations[1].iter().all(|o| o.point >= first));
        let mut edges = SeedPoints::new(camera());
        let fence = Image::from_fn(SIZE.0, SIZE.1, 1, |_, u, _| if u % 2 == 0 { 1.0 } else { 2.0 });
        see(&mut edges, 0.0, &fence);
        see(&mut edges, 0.0, &plane(0.0, 1));
        assert!(edges.points.is_empty());
    }
}
