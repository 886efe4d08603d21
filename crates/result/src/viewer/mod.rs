//! `viewer.html`: the map in 3D on one page without external files, for a browser with WebGL 2.
//!
//! Gaussians are blended in linear light, in half floats; exposure, white balance and response come
//! after, as in image formation. The page holds the map [quantised](quantise), at most
//! [`MAX_FRAMES`](scene::MAX_FRAMES) frames with their tone and the pictures taken, and the program
//! under `page/`, which is our own.

mod quantise;
mod scene;
#[cfg(test)]
mod tests;

use crate::FrameFiles;
use crate::export::level::{LEVEL_UP, Up, level, up_of_frames};
use crate::html::{escape, fill, jpeg_address};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use i2slam::geometry::{Image, Vec3};
use i2slam::radiance::gaussian::ColourActivation;
use i2slam::{FrameEstimate, Map, Reconstruction};
use quantise::QuantisedMap;
use scene::Scene;

/// Name of the page in a result folder.
pub const VIEWER_FILE: &str = "viewer.html";

/// Largest map of a page: 4 million Gaussians make 96 MB, which telephones still open.
const MAX_GAUSSIANS: usize = 4_000_000;

/// Longest side of an embedded picture [px].
const MAX_SIDE: usize = 640;

/// Quality of embedded JPEG pictures, of 100.
const QUALITY: u8 = 75;

/// Why a map has no viewer page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoViewer {
    /// The map is a hash grid.
    #[error("a hash grid has no Gaussians to draw in a browser")]
    HashGrid,
    /// The map shows nothing.
    #[error("the map is empty")]
    Empty,
    /// The map has more than 4 million Gaussians.
    #[error("{0} Gaussians are too many for a page: the most are {MAX_GAUSSIANS}")]
    TooLarge(usize),
}

/// What a page shows.
#[derive(Clone, Copy, Debug)]
pub struct ViewerPage<'a> {
    /// Name of the sequence.
    pub title: &'a str,
    /// Map, camera and responses.
    pub reconstruction: &'a Reconstruction,
    /// The frames, of which those with a pose are shown.
    pub frames: &'a [FrameEstimate],
    /// Files of the pictures taken, by which frames are called.
    pub files: &'a FrameFiles,
    /// Direction against gravity, in the world.
    pub up: Vec3<f64>,
    /// What made the page, named in its head.
    pub generator: &'a str,
}

impl<'a> ViewerPage<'a> {
    /// The page of a whole result; the vertical is estimated.
    pub fn of(title: &'a str, reconstruction: &'a Reconstruction, files: &'a FrameFiles) -> Self {
        let page = Self::of_run(title, reconstruction, files);
        // A hash grid has no page, and its surfaces take long to find.
        if let Map::HashGrid(_) = reconstruction.map {
            return page;
        }
        Self { up: level(reconstruction, Up::Estimated).0.inverse().rotate(LEVEL_UP), ..page }
    }

    /// The page of a run that goes on; cameras alone say where up is.
    pub fn of_run(
        title: &'a str,
        reconstruction: &'a Reconstruction,
        files: &'a FrameFiles,
    ) -> Self {
        let up = up_of_frames(&reconstruction.frames).unwrap_or(LEVEL_UP);
        let generator = concat!("i2slam ", env!("CARGO_PKG_VERSION"));
        Self { title, reconstruction, frames: &reconstruction.frames, files, up, generator }
    }

    /// The text of the page. `taken` loads the picture of a frame (planes R, G, B in `[0, 1]`); a
    /// frame without one is shown without.
    pub fn html(
        &self,
        mut taken: impl FnMut(&FrameEstimate) -> Option<Image<f32>>,
    ) -> Result<String, NoViewer> {
        let (quantised, activation) = self.quantised()?;
        if quantised.count == 0 {
            return Err(NoViewer::Empty);
        }
        let picture = |frame: &FrameEstimate| match taken(frame) {
            Some(picture) => jpeg_address(&within(picture, MAX_SIDE), QUALITY),
            None => String::new(),
        };
        let scene = Scene::new(self, &quantised, activation, picture);
        Ok(self.filled(&scene, &quantised, ""))
    }

    /// The page, whose map may be empty still, without pictures. It asks `update?after=VERSION` beside
    /// it every second, and expects JSON: `version`, `status` (words for the user), `ended`, `latest`
    /// (the last frame in the map, or null) and `state`, an [update](Self::update) if there is a version
    /// after that, else null.
    ///
    /// # Errors
    /// A map that a page cannot show.
    pub fn live_html(&self) -> Result<String, NoViewer> {
        let (quantised, activation) = self.quantised()?;
        let scene = Scene::new(self, &quantised, activation, |_| String::new());
        Ok(self.filled(&scene, &quantised, LIVE))
    }

    /// JSON with scene and map, for a [page that is open](Self::live_html).
    ///
    /// # Errors
    /// A map that a page cannot show.
    pub fn update(&self) -> Result<String, NoViewer> {
        let (quantised, activation) = self.quantised()?;
        let scene = Scene::new(self, &quantised, activation, |_| String::new());
        let map = STANDARD.encode(&quantised.bytes);
        Ok(format!(r#"{{"scene":{},"map":"{map}"}}"#, scene.json()))
    }

    fn quantised(&self) -> Result<(QuantisedMap, ColourActivation), NoViewer> {
        match &self.reconstruction.map {
            Map::HashGrid(_) => Err(NoViewer::HashGrid),
            Map::Gaussians(map) if map.len() > MAX_GAUSSIANS => Err(NoViewer::TooLarge(map.len())),
            Map::Gaussians(map) => Ok((quantise::quantised(map), map.activation)),
        }
    }

    /// The page with a program beside those that every page has.
    fn filled(&self, scene: &Scene, map: &QuantisedMap, live: &str) -> String {
        let mut values = vec![
            ("title", escape(self.title)),
            ("scene", scene.json()),
            ("map", STANDARD.encode(&map.bytes)),
            ("generator", escape(self.generator)),
            ("live.js", live.to_owned()),
        ];
        values.extend(PARTS.map(|(key, text)| (key, text.to_owned())));
        fill(include_str!("page/page.html"), &values)
    }
}

/// Program of a page that follows a run.
const LIVE: &str = include_str!("page/live.js");

/// Style, programs and shaders of the page.
const PARTS: [(&str, &str); 14] = [
    ("style", include_str!("page/viewer.css")),
    ("screen.vert", include_str!("page/screen.vert")),
    ("splat.vert", include_str!("page/splat.vert")),
    ("splat.frag", include_str!("page/splat.frag")),
    ("halve.frag", include_str!("page/halve.frag")),
    ("copy.frag", include_str!("page/copy.frag")),
    ("tone.frag", include_str!("page/tone.frag")),
    ("line.vert", include_str!("page/line.vert")),
    ("line.frag", include_str!("page/line.frag")),
    ("map.js", include_str!("page/map.js")),
    ("algebra.js", include_str!("page/algebra.js")),
    ("renderer.js", include_str!("page/renderer.js")),
    ("navigation.js", include_str!("page/navigation.js")),
    ("interface.js", include_str!("page/interface.js")),
];

/// A picture with sides of at most `most` [px].
fn within(picture: Image<f32>, most: usize) -> Image<f32> {
    let longest = picture.width.max(picture.height);
    if longest <= most {
        return picture;
    }
    let side = |length: usize| (length * most).div_ceil(longest).max(1);
    picture.resized_by_area(side(picture.width), side(picture.height))
}
