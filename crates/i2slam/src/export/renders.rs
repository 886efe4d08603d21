//! `renders/`: pictures of every frame.

use super::map::typical_tone;
use super::pictures::{write_depth, write_picture, write_radiance};
use super::{ExportError, ResultFolder, Storage};
use crate::reconstruction::{Convergence, FrameEstimate, Losses, Reconstruction};
use i2slam_formation::{FrameTone, ShutterPoses};
use i2slam_geometry::{Image, Pose, Tangent};
use std::fs;
use std::path::{Path, PathBuf};

/// What is drawn of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderKind {
    /// Seen from mid-exposure, with the frame's own exposure, white balance and response.
    Sharp,
    /// What formation predicts for the picture taken.
    Blurred,
    /// Linear radiance.
    Hdr,
    /// Depth along the optical axis.
    Depth,
}

impl RenderKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Sharp, Self::Blurred, Self::Hdr, Self::Depth];

    /// Name of the kind and of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sharp => "sharp",
            Self::Blurred => "blurred",
            Self::Hdr => "hdr",
            Self::Depth => "depth",
        }
    }

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// File name under `renders/`: kind, then position in the associated stream.
    pub fn file(self, index: usize) -> String {
        let extension = if self == Self::Hdr { "exr" } else { "png" };
        format!("{}/{index:06}.{extension}", self.name())
    }
}

/// Write one picture as `<below>/<kind>/NNNNNN.png` (or `.exr`); `below` is `renders` in a result
/// folder and may be empty.
pub fn save_render<S: Storage>(
    folder: &ResultFolder<S>,
    below: &str,
    kind: RenderKind,
    index: usize,
    image: &Image<f32>,
) -> Result<(), ExportError> {
    let file = kind.file(index);
    let relative = if below.is_empty() { file } else { format!("{below}/{file}") };
    folder.write(&relative, |out| match kind {
        RenderKind::Sharp | RenderKind::Blurred => write_picture(out, image),
        RenderKind::Hdr => write_radiance(out, image),
        RenderKind::Depth => write_depth(out, image),
    })
}

/// Folders of a result that hold pictures by kind: of the run, at optimised poses, at poses of
/// the user's.
const PICTURES: [&str; 3] = ["renders/optimised", "renders", "views"];

/// The pictures that a run, its evaluation and `i2slam render` left in a result folder.
pub(super) fn pictures(result: &Path) -> Vec<PathBuf> {
    let kinds = |below| RenderKind::ALL.into_iter().map(move |kind| (result.join(below), kind));
    PICTURES.into_iter().flat_map(kinds).flat_map(|(below, kind)| of_kind(&below, kind)).collect()
}

fn of_kind(below: &Path, kind: RenderKind) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(below.join(kind.name())) else { return Vec::new() };
    let ours = |path: &PathBuf| {
        let stem = path.file_stem().and_then(|s| s.to_str()).and_then(|s| s.parse().ok());
        stem.is_some_and(|index| path.ends_with(kind.file(index)))
    };
    entries.flatten().map(|entry| entry.path()).filter(ours).collect()
}

/// Delete the pictures that an earlier run left under `renders/` and `views/` of a result folder,
/// and nothing else, so that pictures of two runs do not mix.
pub fn remove_renders(result: &Path) -> Result<(), ExportError> {
    for path in pictures(result) {
        fs::remove_file(&path).map_err(|source| ExportError::Write { path, source })?;
    }
    for below in PICTURES.map(|below| result.join(below)) {
        // A folder that holds something else stays.
        RenderKind::ALL.iter().for_each(|k| drop(fs::remove_dir(below.join(k.name()))));
        fs::remove_dir(below).ok();
    }
    Ok(())
}

impl Reconstruction {
    /// A frame that was never taken: a camera standing still at `world_from_camera`, with the
    /// median exposure and white balance of the run and the response of its middle frame.
    pub fn imagined_frame(&self, index: usize, world_from_camera: Pose<f64>) -> FrameEstimate {
        let tone = typical_tone(self).map_or_else(FrameTone::default, |(tone, _)| tone);
        let response = self.frames.get(self.frames.len() / 2).map_or(0, |f| f.response);
        FrameEstimate {
            index,
            timestamp: 0.0,
            shutter: ShutterPoses::still(world_from_camera),
            readout: 0.0,
            depth_lead: Tangent::zero(),
            tone,
            response,
            keyframe: false,
            held_out: false,
            tracked: true,
            losses: Losses::default(),
            convergence: Convergence::default(),
            blur_length: 0.0,
            tracking_seconds: 0.0,
            mapping_seconds: 0.0,
            gaussians: self.map.gaussians(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::storage::tests::Scratch;

    #[test]
    fn only_pictures_of_a_run_are_removed() {
        let scratch = Scratch::new("renders");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        let image = Image::new(8, 6, 3);
        for kind in RenderKind::ALL {
            save_render(&folder, "renders", kind, 12, &image).expect("room");
        }
        for below in ["renders/optimised", "views"] {
            save_render(&folder, below, RenderKind::Sharp, 3, &image).expect("room");
        }
        folder.write_text("renders/sharp/notes.txt", "mine").expect("room");
        folder.write_text("renders/sharp/7.png", "mine").expect("room");
        assert!(scratch.0.join("renders/hdr/000012.exr").exists());
        remove_renders(&scratch.0).expect("removal");
        assert!(!scratch.0.join("renders/hdr/000012.exr").exists());
        assert!(!scratch.0.join("renders/sharp/000012.png").exists());
        assert!(!scratch.0.join("renders/optimised").exists() && !scratch.0.join("views").exists());
        assert!(scratch.0.join("renders/sharp/notes.txt").exists());
        assert!(scratch.0.join("renders/sharp/7.png").exists());
    }

    #[test]
    fn kinds_have_names() {
        for kind in RenderKind::ALL {
            assert_eq!(RenderKind::from_name(kind.name()), Some(kind));
        }
        assert_eq!(RenderKind::from_name("sharpest"), None);
    }
}
