//! From the recorded pixel grid to the delivered one: lens, crop, scale.
//!
//! Colour: lens removed by bilinear sampling at full resolution, then averaged over the area of
//! each delivered pixel. The average is taken of the values as recorded (display space), as the
//! systems compared with do; averaging light would need the camera response, which is unknown
//! here. Depth: each delivered pixel takes the recorded pixel its centre falls into, so that no
//! surface is invented between two depths.
//!
//! Colour and depth may have been recorded by cameras of different size and focal length at one
//! place; frames are delivered on the grid of one of them.

use crate::area::AreaMap;
use crate::distortion::Distortion;
use i2slam_geometry::{Camera, Image};

/// In the depth lookup: the pixel was not recorded.
const OUTSIDE: u32 = u32::MAX;

/// Bilinear sampling of four neighbours, the top left one at `index`.
#[derive(Clone, Copy, Debug)]
struct Tap {
    index: u32,
    /// Weight of the right column, of the lower row, in `[0, 1]`.
    right: f32,
    lower: f32,
}

/// The cameras of a sequence as recorded, sizes at least 2x2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Recorded {
    pub(crate) colour: Camera<f64>,
    pub(crate) depth: Camera<f64>,
    /// The one of them whose pixels are delivered, after crop and scale.
    pub(crate) grid: Camera<f64>,
}

impl Recorded {
    /// The same cameras if they had recorded frames of another size.
    pub(crate) fn resized(&self, (width, height): (usize, usize)) -> Self {
        let resized = |camera: &Camera<f64>| camera.resized(width, height);
        Self {
            colour: resized(&self.colour),
            depth: resized(&self.depth),
            grid: resized(&self.grid),
        }
    }
}

/// Precomputed maps from recorded to delivered frames.
#[derive(Clone, Debug)]
pub(crate) struct Resampler {
    colour_size: (usize, usize),
    depth_size: (usize, usize),
    border: usize,
    /// Per pixel of the cropped frame; `None` for a lens without distortion.
    taps: Option<Vec<Tap>>,
    /// Straight to the delivered frame, where colour is not on the delivered grid.
    areas: Option<AreaMap>,
    /// Per pixel of the delivered frame: place in the recorded frame, or [`OUTSIDE`].
    depth_lookup: Vec<u32>,
    cropped: (usize, usize),
    /// The pinhole camera of the delivered frames.
    pub(crate) camera: Camera<f64>,
    /// 1 plane, true where the recorded picture covers the delivered pixel; `None`: everywhere.
    pub(crate) covered: Option<Image<bool>>,
    /// The smallest border that removes every pixel not covered [px recorded].
    pub(crate) full_cover_border: usize,
}

impl Resampler {
    /// Maps for the recording cameras, their lens, a border [px of the grid] and a delivered size.
    pub(crate) fn new(
        recorded: &Recorded,
        lens: &Distortion,
        border: usize,
        delivered: (usize, usize),
    ) -> Self {
        let cropped = recorded.grid.cropped(border);
        let size = |camera: &Camera<f64>| (camera.width, camera.height);
        let mut resampler = Self {
            colour_size: size(&recorded.colour),
            depth_size: size(&recorded.depth),
            border,
            taps: None,
            areas: None,
            depth_lookup: Vec::new(),
            cropped: (cropped.width, cropped.height),
            camera: cropped.resized(delivered.0, delivered.1),
            covered: None,
            full_cover_border: border,
        };
        resampler.depth_lookup = resampler.depth_map(recorded, lens);
        if !lens.is_none() {
            resampler.taps = Some(resampler.colour_map(recorded, lens));
        } else if recorded.colour != recorded.grid {
            resampler.areas = Some(resampler.area_map(recorded));
        }
        resampler
    }

    /// Pixels removed on every side [px of the grid].
    pub(crate) fn border(&self) -> usize {
        self.border
    }

    /// The same maps for other cameras of these sizes, and their lens.
    pub(crate) fn with_camera(&self, recorded: &Recorded, lens: &Distortion) -> Self {
        Self::new(recorded, lens, self.border, (self.camera.width, self.camera.height))
    }

    fn area_map(&mut self, recorded: &Recorded) -> AreaMap {
        let map = AreaMap::new(&recorded.colour, &self.camera);
        self.covered = map.covered();
        let step = self.cropped.0 as f64 / self.camera.width as f64;
        self.full_cover_border += (map.uncovered_border() as f64 * step).ceil() as usize;
        map
    }

    fn colour_map(&mut self, recorded: &Recorded, lens: &Distortion) -> Vec<Tap> {
        let (width, height) = self.cropped;
        let (grid, colour) = (&recorded.grid, &recorded.colour);
        let mut outside = Image::<f32>::new(width, height, 1);
        let mut taps = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let (i, j) = (column + self.border, row + self.border);
                let (u, v) = through_lens(grid, lens, colour, i as f64 + 0.5, j as f64 + 0.5);
                if pixel_at(colour, u, v) == OUTSIDE {
                    outside.data[row * width + column] = 1.0;
                    let edge = i.min(j).min(grid.width - 1 - i).min(grid.height - 1 - j);
                    self.full_cover_border = self.full_cover_border.max(edge + 1);
                }
                taps.push(tap_at(colour, u, v));
            }
        }
        if outside.data.contains(&1.0) {
            let share = outside.resized_by_area(self.camera.width, self.camera.height);
            self.covered = Some(Image {
                width: share.width,
                height: share.height,
                channels: 1,
                data: share.data.iter().map(|&s| s == 0.0).collect(),
            });
        }
        taps
    }

    fn depth_map(&self, recorded: &Recorded, lens: &Distortion) -> Vec<u32> {
        let (width, height) = (self.camera.width, self.camera.height);
        let step_x = self.cropped.0 as f64 / width as f64;
        let step_y = self.cropped.1 as f64 / height as f64;
        let border = self.border as f64;
        let mut lookup = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let u = (column as f64 + 0.5) * step_x + border;
                let v = (row as f64 + 0.5) * step_y + border;
                let (u, v) = through_lens(&recorded.grid, lens, &recorded.depth, u, v);
                lookup.push(pixel_at(&recorded.depth, u, v));
            }
        }
        lookup
    }

    /// The delivered colour of a recorded picture. Where the lens reaches beyond the recorded
    /// picture its edge is repeated.
    pub(crate) fn colour(&self, recorded: &Image<f32>) -> Image<f32> {
        if let Some(areas) = &self.areas {
            return areas.apply(recorded);
        }
        let cropped = match &self.taps {
            Some(taps) => sample(recorded, taps, self.cropped),
            None if self.border > 0 => crop(recorded, self.border, self.cropped),
            None => recorded.clone(),
        };
        let (width, height) = (self.camera.width, self.camera.height);
        if (width, height) == self.cropped {
            cropped
        } else if (2 * width, 2 * height) == self.cropped {
            halved(&cropped)
        } else {
            cropped.resized_by_area(width, height)
        }
    }

    /// The delivered depth [m] of a recorded depth image: values over `scale`, 0 where invalid,
    /// not recorded, or beyond `max_depth`.
    pub(crate) fn depth(&self, recorded: &Image<u16>, scale: f64, max_depth: f64) -> Image<f32> {
        self.depth_values(recorded, |raw| {
            let z = f64::from(raw) / scale;
            if z <= max_depth { z as f32 } else { 0.0 }
        })
    }

    /// `of` the recorded value that every delivered pixel takes from an image with the pixels of
    /// depth; 0 where nothing was recorded.
    pub(crate) fn depth_values<T: Copy>(
        &self,
        recorded: &Image<T>,
        of: impl Fn(T) -> f32,
    ) -> Image<f32> {
        let value = |&place: &u32| match place {
            OUTSIDE => 0.0,
            place => of(recorded.data[place as usize]),
        };
        Image {
            width: self.camera.width,
            height: self.camera.height,
            channels: 1,
            data: self.depth_lookup.iter().map(value).collect(),
        }
    }

    /// Width and height of the recorded colour and depth images [px].
    pub(crate) fn recorded_sizes(&self) -> ((usize, usize), (usize, usize)) {
        (self.colour_size, self.depth_size)
    }
}

/// Where the lens of camera `to` puts what the pinhole `from` at its place sees at `(u, v)`.
fn through_lens(
    from: &Camera<f64>,
    lens: &Distortion,
    to: &Camera<f64>,
    u: f64,
    v: f64,
) -> (f64, f64) {
    if lens.is_none() && from == to {
        return (u, v);
    }
    let (x, y) = lens.distort((u - from.cx) / from.fx, (v - from.cy) / from.fy);
    (to.fx * x + to.cx, to.fy * y + to.cy)
}

/// The pixel that `(u, v)` falls into.
fn pixel_at(camera: &Camera<f64>, u: f64, v: f64) -> u32 {
    if camera.contains(u, v, 0.0) {
        (v as usize * camera.width + u as usize) as u32
    } else {
        OUTSIDE
    }
}

/// Bilinear weights at `(u, v)`, moved to the nearest edge where it lies beyond.
fn tap_at(camera: &Camera<f64>, u: f64, v: f64) -> Tap {
    let split = |position: f64, size: usize| {
        let centred = (position - 0.5).clamp(0.0, (size - 1) as f64);
        let first = (centred as usize).min(size - 2);
        (first, (centred - first as f64) as f32)
    };
    let ((column, right), (row, lower)) = (split(u, camera.width), split(v, camera.height));
    Tap { index: (row * camera.width + column) as u32, right, lower }
}

fn sample(image: &Image<f32>, taps: &[Tap], size: (usize, usize)) -> Image<f32> {
    let mut out = Image::new(size.0, size.1, image.channels);
    for channel in 0..image.channels {
        let plane = image.plane(channel);
        for (value, tap) in out.plane_mut(channel).iter_mut().zip(taps) {
            let i = tap.index as usize;
            let (upper, lower) = (&plane[i..i + 2], &plane[i + image.width..i + image.width + 2]);
            let a = upper[0] + tap.right * (upper[1] - upper[0]);
            let b = lower[0] + tap.right * (lower[1] - lower[0]);
            *value = a + tap.lower * (b - a);
        }
    }
    out
}

fn crop(image: &Image<f32>, border: usize, size: (usize, usize)) -> Image<f32> {
    let mut data = Vec::with_capacity(size.0 * size.1 * image.channels);
    for channel in 0..image.channels {
        let rows = image.plane(channel).chunks_exact(image.width);
        for row in rows.skip(border).take(size.1) {
            data.extend_from_slice(&row[border..border + size.0]);
        }
    }
    Image { width: size.0, height: size.1, channels: image.channels, data }
}

/// Area average for exactly half the size.
fn halved(image: &Image<f32>) -> Image<f32> {
    let mut out = Image::new(image.width / 2, image.height / 2, image.channels);
    let rows = image.data.chunks_exact(2 * image.width);
    for (out, rows) in out.data.chunks_exact_mut(image.width / 2).zip(rows) {
        let (upper, lower) = rows.split_at(image.width);
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (value, (a, b)) in out.iter_mut().zip(pairs) {
            *value = 0.25 * ((a[0] + a[1]) + (b[0] + b[1]));
        }
    }
    out
}

#[cfg(test)]
mod tests;
