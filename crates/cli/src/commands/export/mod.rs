//! `i2slam export`: a result in the format of another program.

mod arguments;
mod format_parser;
mod page;
mod place;

pub(crate) use arguments::Export;

use crate::console::{counted, print, print_status};
use crate::failure::Failure;
use crate::interrupt;
use crate::messages::{note_displaced, note_edited_trajectory, note_saved_parts};
use crate::progress::Progress;
use crate::result_folder::refuse_non_results;
use crate::taken_pictures::{covered_pictures, sequence_of};
use arguments::{COLMAP, FolderFormat, Format, NERFSTUDIO};
use i2slam::FrameEstimate;
use i2slam::geometry::StampedPose;
use i2slam_result::export::video::Video;
use i2slam_result::export::{
    Axes, ExportError, LoadTaken, MARK, Scene, Up, Watch, colmap, compressed_ply, csv, glb, mesh,
    nerfstudio, ply, tum, video,
};
use i2slam_result::{FrameFiles, UnitOfLength, load_metrics};
use i2slam_storage::{OutputFolder, write_file};
use std::path::Path;

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::Storage(error) => error.into(),
            ExportError::Cancelled => Self::Interrupted,
            error => Self::Failed(error.to_string()),
        }
    }
}

pub(crate) fn export(arguments: &Export) -> Result<(), Failure> {
    let (selection, views) = (arguments.selection()?, arguments.views()?);
    place::check(arguments)?;
    arguments.machine.use_threads()?;
    note_saved_parts(&i2slam_storage::recover(&arguments.result));
    refuse_non_results(&arguments.result)?;
    interrupt::listen_for("\nending the export, of which nothing is kept; once more ends at once");
    let reconstruction = i2slam_result::load(&arguments.result)?;
    note_edited_trajectory(&arguments.result, &reconstruction);
    let metrics = load_metrics(&arguments.result).unwrap_or_default();
    let files = FrameFiles::load(&arguments.result)?;
    let scene = Scene::new(reconstruction, &selection)?.with_files(files, metrics.unordered);
    let progress = Progress::new(scene.frames(), arguments.machine.quiet);
    let watch = Watch {
        progress: &|name, done, total| progress.step(name, done, total),
        cancellation: interrupt::cancellation(),
    };
    let previous = place::keep_previous(arguments)?;
    let written = write(arguments, &scene, views.as_deref(), &watch);
    progress.clear();
    let what = with_unit(&written?, arguments.format, (scene.unit(), metrics.depth_scale_assumed));
    print(&format!("{what}, in {}", arguments.out.display()));
    if let Some(previous) = previous.filter(|_| !arguments.machine.quiet) {
        print_status(&format!("the earlier export is in {}", previous.display()));
    }
    let is_cut = [Format::Ply, Format::CompressedPly, Format::Glb, Format::Html, Format::Mesh];
    let can_be_cut = is_cut.contains(&arguments.format);
    if arguments.machine.quiet {
        return Ok(());
    }
    if let Some(bounds) = scene.bounds().filter(|_| can_be_cut && selection.crop.is_none()) {
        let numbers = box_numbers(bounds);
        print_status(&format!(
            "98 % of the Gaussians along each axis lie in --crop \"{numbers}\", which leaves out the others"
        ));
    }
    if selection.up != Up::Kept {
        print_status(&levelled(&scene, selection.up));
    }
    Ok(())
}

/// Description of the levelling.
fn levelled(scene: &Scene, up: Up) -> String {
    let degrees = scene.levelling().to_degrees();
    let ground = match scene.ground() {
        Some(height) => {
            let unit = if scene.unit() == UnitOfLength::Metre { " m" } else { "" };
            format!("its ground, {:.2}{unit} below the origin of the result, is at zero", -height)
        }
        None => "no ground was found, the origin is that of the result".into(),
    };
    let by = match (scene.has_map(), up) {
        (false, Up::Estimated) => " by the cameras alone, as the map is empty",
        _ => "",
    };
    format!("the world is levelled{by}, by {degrees:.1} degrees, and {ground}; --up keep leaves it")
}

/// Numbers of a box, rounded outward to a thousandth or less of its longest edge.
fn box_numbers(bounds: [f64; 6]) -> String {
    let longest = (0..3).map(|k| bounds[k + 3] - bounds[k]).fold(f64::MIN_POSITIVE, f64::max);
    let digits = (3.0 - longest.log10().floor()).clamp(0.0, 9.0) as usize;
    let unit = 10_f64.powi(digits as i32);
    let outward = |k: usize| match k < 3 {
        true => (bounds[k] * unit).floor() / unit,
        false => (bounds[k] * unit).ceil() / unit,
    };
    [0, 1, 2, 3, 4, 5].map(|k| format!("{:.digits$}", outward(k))).join(" ")
}

/// Triangles above which larger voxels are advised: some 20 MB.
const MANY_TRIANGLES: usize = 1_000_000;

/// Writes the file or folder; says what is in it.
fn write(
    arguments: &Export,
    scene: &Scene,
    views: Option<&[StampedPose]>,
    watch: &Watch<'_>,
) -> Result<String, Failure> {
    let out = &arguments.out;
    match arguments.format {
        Format::Colmap => write_folder(arguments, scene, COLMAP, |folder, taken| {
            colmap::write(scene, folder, taken, watch)
        }),
        Format::Nerfstudio => write_folder(arguments, scene, NERFSTUDIO, |folder, taken| {
            nerfstudio::write(scene, folder, taken, watch)
        }),
        Format::Ply => {
            let splats = scene.splats_for_viewers(Axes::YDown)?;
            write_file(out, |file| ply::write(file, &splats, Some(&mark("ply"))))?;
            Ok(counted(splats.len(), "Gaussian"))
        }
        Format::Html => page::write(arguments, scene),
        Format::CompressedPly => {
            let splats = scene.splats_for_viewers(Axes::YDown)?;
            write_file(out, |file| compressed_ply::write(file, &splats, &mark("compressed-ply")))?;
            Ok(counted(splats.len(), "Gaussian"))
        }
        Format::Glb => {
            let splats = scene.splats_for_viewers(Axes::YUp)?;
            write_file(out, |file| glb::write(file, &splats, arguments.linear, &mark("glb")))?;
            Ok(counted(splats.len(), "Gaussian"))
        }
        Format::Mesh => write_mesh(arguments, scene, watch),
        Format::Video => {
            let video = video::write(scene, out, views, &mark("video"), watch)?;
            Ok(described(&video))
        }
        Format::Tum => {
            write_text(out, &tum(scene, &mark("tum")))?;
            Ok(counted(scene.frames(), "pose"))
        }
        Format::Csv => {
            write_text(out, &csv(scene))?;
            Ok(counted(scene.frames(), "frame"))
        }
    }
}

/// Contents of a video.
fn described(video: &Video) -> String {
    let length = format!("{}, {:.1} s", counted(video.pictures, "picture"), video.seconds);
    let Some(fit) = video.exposure else { return format!("{length}, at one exposure") };
    let [error, constant] = [fit.error, fit.constant_error].map(|e| e / std::f64::consts::LN_2);
    let meter = fit.controller.meter.name();
    format!(
        "{length}, exposure follows the {meter} as the camera's did (typical error {error:.2} stops; of one \
         exposure for all {constant:.2})"
    )
}

/// Writes pictures and points as a folder; says how many there are.
fn write_folder(
    arguments: &Export,
    scene: &Scene,
    format: FolderFormat,
    content: impl FnOnce(&OutputFolder, &mut LoadTaken<'_>) -> Result<usize, ExportError>,
) -> Result<String, Failure> {
    let missing = "the pictures are the map's alone, without detail of those taken";
    let sequence = match scene.has_detail_of_pictures() {
        true => sequence_of(&arguments.result, missing),
        false => None,
    };
    let mut load = sequence.as_ref().map(covered_pictures);
    let mut taken = |frame: &FrameEstimate| load.as_mut().and_then(|load| load(frame));
    let mut folder = OutputFolder::replace(&arguments.out, place::claim(arguments, format))?;
    let points = content(&folder, &mut taken)?;
    note_displaced(&folder.commit_or_save()?);
    Ok(format!("{} and {}", counted(scene.frames(), "picture"), counted(points, "point")))
}

fn write_mesh(arguments: &Export, scene: &Scene, watch: &Watch<'_>) -> Result<String, Failure> {
    let (mesh, voxel) = mesh::build(scene, arguments.voxel, watch)?;
    let (out, mark) = (&arguments.out, mark("mesh"));
    let is_ply = out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ply"));
    write_file(out, |file| match is_ply {
        true => mesh::write_ply(file, &mesh, scene, &mark),
        false => mesh::write_glb(file, &mesh, scene, &mark),
    })?;
    let count = mesh.triangles();
    let advice = match count > MANY_TRIANGLES {
        true => format!(" (--voxel {:.4} gives a quarter of them)", 2.0 * voxel),
        false => String::new(),
    };
    Ok(format!("{}, voxels of {voxel:.4}{advice}", counted(count, "triangle")))
}

fn write_text(out: &Path, text: &str) -> Result<(), Failure> {
    Ok(write_file(out, |file| file.write_all(text.as_bytes()))?)
}

/// The line in a file by which it is known as an export.
fn mark(format: &str) -> String {
    format!("{MARK} --format {format}, version {}", env!("CARGO_PKG_VERSION"))
}

fn with_unit(
    what: &str,
    format: Format,
    (unit, depth_scale_assumed): (UnitOfLength, Option<f64>),
) -> String {
    match (unit, depth_scale_assumed) {
        _ if format == Format::Video => what.to_owned(),
        (UnitOfLength::Metre, None) => format!("{what}, in metres"),
        (UnitOfLength::Metre, Some(scale)) => {
            format!("{what}, in metres if {scale} in the depth pictures is one, as was assumed")
        }
        (UnitOfLength::Keyframes, _) => {
            format!("{what}, in the unit of length of the keyframes given")
        }
        (UnitOfLength::Unknown, _) => {
            format!("{what}, in a unit of length that pictures alone do not tell")
        }
    }
}
