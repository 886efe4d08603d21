//! `renders/`: pictures of every frame.

use super::pictures::{write_depth, write_picture, write_radiance};
use super::{ExportError, Layout, ResultFolder, Storage};
use i2slam::geometry::Image;

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
        format!("{}/{index:06}.{}", self.name(), self.extension())
    }

    /// Extension of its files.
    pub fn extension(self) -> &'static str {
        if self == Self::Hdr { "exr" } else { "png" }
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

/// Those folders with the extension of their pictures.
pub(super) fn result_pictures() -> Vec<(String, &'static str)> {
    PICTURES.into_iter().flat_map(Layout::renders).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_names() {
        for kind in RenderKind::ALL {
            assert_eq!(RenderKind::from_name(kind.name()), Some(kind));
        }
        assert_eq!(RenderKind::from_name("sharpest"), None);
    }
}
