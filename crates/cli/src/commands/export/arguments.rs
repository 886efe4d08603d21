//! Arguments of `i2slam export`.

use super::super::views::read_views;
use super::format_parser::FormatParser;
use crate::arguments::{Machine, existing_path, numbers};
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use i2slam::geometry::{StampedPose, Vec3};
use i2slam_result::export::{CropBox, Selection, Up, colmap, nerfstudio};
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Export {
    /// Result folder of a run
    pub(crate) result: PathBuf,
    /// Format of the export
    #[arg(long, value_name = "FORMAT", ignore_case = true, value_parser = FormatParser)]
    pub(crate) format: Format,
    /// The file to write, or the folder
    #[arg(short, long, value_name = "PATH")]
    pub(crate) out: PathBuf,
    /// Replace an earlier export in the same format; nothing else is ever replaced
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Only Gaussians in this box of the levelled world: x to the right, y down, z forward, seen
    /// from the first camera
    #[arg(long, value_name = "\"x0 y0 z0 x1 y1 z1\"", allow_hyphen_values = true)]
    pub(crate) crop: Option<String>,
    /// Only Gaussians of at least this opacity, 0 to 1
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    pub(crate) min_opacity: Option<f32>,
    /// Only Gaussians that at least so many frames see: what one or two frames show is the least certain
    #[arg(long, value_name = "N")]
    pub(crate) min_views: Option<usize>,
    /// Which way is up: `estimate` from cameras and surfaces, `keep` the world of the result, or a
    /// direction in that world
    #[arg(long, value_name = "\"x y z\"", default_value = "estimate", allow_hyphen_values = true)]
    pub(crate) up: String,
    /// Size of the voxels of a mesh [m, or the unit of the result] [default: that of a pixel at the
    /// median depth]
    #[arg(long, value_name = "SIZE", allow_negative_numbers = true)]
    pub(crate) voxel: Option<f64>,
    /// Colours as linear radiance, not as a picture: colmap, nerfstudio, ply, glb
    #[arg(long)]
    pub(crate) linear: bool,
    /// One exposure for all pictures of a video, not those that the camera would have chosen
    #[arg(long)]
    pub(crate) constant_exposure: bool,
    /// Views that a video flies through at their times, a file in the TUM format in the world of the result
    /// [default: the smoothed path of the run]
    #[arg(long, value_name = "FILE", value_parser = existing_path())]
    pub(crate) poses: Option<PathBuf>,
    /// Keyframes alone, not all frames
    #[arg(long)]
    pub(crate) keyframes: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// Formats of exports.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    /// COLMAP model with sharp pictures, masks and points, a folder
    Colmap,
    /// Pictures, masks and points with transforms.json, a folder
    Nerfstudio,
    /// Gaussians for splat viewers, one file
    Ply,
    /// Gaussians in a quarter of the bytes or less, PlayCanvas' format, one file .compressed.ply
    CompressedPly,
    /// Gaussians as glTF (KHR_gaussian_splatting), one file
    Glb,
    /// Triangles of the surface with colours, one file .ply or .glb
    Mesh,
    /// Flight along the smoothed path of the camera, one file .mp4, made by ffmpeg
    Video,
    /// The map in 3D for a browser, with the pictures as filmed, one page that needs nothing else
    Html,
    /// Camera path, one line per frame: time, position, quaternion
    Tum,
    /// Camera path with exposure and white balance, a table
    Csv,
}

/// A format of folders.
#[derive(Clone, Copy)]
pub(super) struct FolderFormat {
    /// Command in the manifest: an export replaces those of its own format only.
    pub(super) command: &'static str,
    /// First parts of the paths in it.
    pub(super) names: &'static [&'static str],
}

pub(super) const COLMAP: FolderFormat =
    FolderFormat { command: "i2slam export --format colmap", names: colmap::NAMES };
pub(super) const NERFSTUDIO: FolderFormat =
    FolderFormat { command: "i2slam export --format nerfstudio", names: nerfstudio::NAMES };

impl Format {
    /// Endings of its file; none for a folder or any.
    pub(super) fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Ply => &["ply"],
            Self::Html => &["html", "htm"],
            Self::CompressedPly => &["compressed.ply"],
            Self::Glb => &["glb"],
            Self::Mesh => &["ply", "glb"],
            Self::Video => &["mp4"],
            Self::Colmap | Self::Nerfstudio | Self::Tum | Self::Csv => &[],
        }
    }

    /// Its folder; none for a file.
    pub(super) fn folder(self) -> Option<FolderFormat> {
        match self {
            Self::Colmap => Some(COLMAP),
            Self::Nerfstudio => Some(NERFSTUDIO),
            _ => None,
        }
    }

    /// Name on the command line.
    pub(super) fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }
}

impl Export {
    /// The selection that the flags describe.
    pub(super) fn selection(&self) -> Result<Selection, Failure> {
        let min_opacity = self.min_opacity.unwrap_or(0.0);
        if !(0.0..=1.0).contains(&min_opacity) {
            let message = format!("--min-opacity {min_opacity}: expected a number from 0 to 1");
            return Err(Failure::Usage(message));
        }
        let crop = self.crop.as_deref().map(parse_crop).transpose()?;
        self.check_flags_of_formats()?;
        let (up, min_views) = (parse_up(&self.up)?, self.min_views.unwrap_or(0));
        let Self { linear, keyframes, constant_exposure, .. } = *self;
        Ok(Selection { crop, min_opacity, min_views, up, linear, keyframes, constant_exposure })
    }

    /// The views to fly through.
    pub(super) fn views(&self) -> Result<Option<Vec<StampedPose>>, Failure> {
        let Some(file) = &self.poses else { return Ok(None) };
        let views = read_views(file)?;
        let rises = views.windows(2).all(|pair| pair[0].timestamp < pair[1].timestamp);
        match views.len() >= 2 && rises {
            true => Ok(Some(views)),
            false => Err(Failure::Usage(format!(
                "--poses {}: expected at least two poses, at different times",
                file.display()
            ))),
        }
    }

    /// Refuses flags that the format has no use for.
    fn check_flags_of_formats(&self) -> Result<(), Failure> {
        let format = self.format;
        let is_cut = self.crop.is_some() || self.min_opacity.is_some() || self.min_views.is_some();
        if is_cut && matches!(format, Format::Tum | Format::Csv) {
            let name = format.name();
            return Err(Failure::Usage(format!(
                "--crop, --min-opacity and --min-views cut the map; {name} holds the path alone"
            )));
        }
        let is_linear_possible = !matches!(
            format,
            Format::CompressedPly
                | Format::Mesh
                | Format::Video
                | Format::Html
                | Format::Tum
                | Format::Csv
        );
        if self.linear && !is_linear_possible {
            let name = format.name();
            return Err(Failure::Usage(format!(
                "--linear is for colmap, nerfstudio, ply and glb, not for {name}"
            )));
        }
        let is_map_alone = matches!(format, Format::Ply | Format::CompressedPly | Format::Glb);
        if self.keyframes && is_map_alone && self.min_views.is_none() {
            let name = format.name();
            return Err(Failure::Usage(format!(
                "--keyframes chooses among frames; {name} holds the map alone"
            )));
        }
        if self.constant_exposure && format != Format::Video {
            return Err(Failure::Usage("--constant-exposure is for --format video".to_owned()));
        }
        if self.poses.is_some() && format != Format::Video {
            return Err(Failure::Usage("--poses is for --format video".to_owned()));
        }
        match self.voxel {
            None => Ok(()),
            Some(_) if format != Format::Mesh => {
                Err(Failure::Usage("--voxel is for --format mesh".to_owned()))
            }
            Some(size) if size.is_finite() && size > 0.0 => Ok(()),
            Some(size) => {
                Err(Failure::Usage(format!("--voxel {size}: expected a size above zero")))
            }
        }
    }
}

fn parse_crop(text: &str) -> Result<CropBox, Failure> {
    let refuse = |why: &str| Failure::Usage(format!("--crop \"{text}\": {why}"));
    let [x0, y0, z0, x1, y1, z1] = numbers::<6>(text)
        .ok_or_else(|| refuse("expected six numbers, the least and the largest x y z"))?;
    let (least, most) = ([x0, y0, z0], [x1, y1, z1]);
    let is_box = least.iter().zip(&most).all(|(a, b)| a < b);
    let why = "holds nothing: each of the last three numbers must be larger than that of the first";
    if is_box { Ok(CropBox { least, most }) } else { Err(refuse(why)) }
}

fn parse_up(text: &str) -> Result<Up, Failure> {
    match text.trim() {
        "estimate" => return Ok(Up::Estimated),
        "keep" => return Ok(Up::Kept),
        _ => {}
    }
    let direction = numbers::<3>(text).map(Vec3::from_array).filter(|v| v.norm() > 0.0);
    direction.map(Up::Given).ok_or_else(|| {
        Failure::Usage(format!(
            "--up \"{text}\": expected `estimate`, `keep`, or a direction as in \"0 -1 0.2\""
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_directions_are_checked() {
        let crop = parse_crop("-1, -2 0  1 2 3.5").expect("a box");
        assert_eq!((crop.least, crop.most), ([-1.0, -2.0, 0.0], [1.0, 2.0, 3.5]));
        for wrong in ["0 0 0 1 1", "0 0 0 1 1 x", "0 0 0 1 1 0", "1 0 0 0 1 1", "0 0 0 1 1 inf"] {
            assert!(matches!(parse_crop(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
        let up = Vec3::new(0.0, -1.0, 0.5);
        assert!(matches!(parse_up("0 -1 .5"), Ok(Up::Given(v)) if v == up));
        assert!(matches!(parse_up("keep"), Ok(Up::Kept)));
        for wrong in ["0 0 0", "up", "1 2", "nan 0 1"] {
            assert!(matches!(parse_up(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
    }
}
