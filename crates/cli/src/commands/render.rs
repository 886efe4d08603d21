//! `i2slam render`: renders a saved result from its own poses or from others.

use super::views::read_views;
use crate::arguments::{Machine, existing_path, frame_range, numbers};
use crate::console::{counted, print, print_status};
use crate::failure::Failure;
use crate::interrupt;
use crate::messages::{note_displaced, note_edited_trajectory, note_saved_parts};
use crate::progress::Progress;
use crate::result_folder::refuse_non_results;
use clap::Args;
use i2slam::geometry::{Image, Pose, Rotation, Vec3};
use i2slam::{FrameEstimate, Reconstruction, Viewer};
use i2slam_result::{RenderKind, save_render};
use i2slam_storage::{Claim, OutputFolder};
use std::ops::Range;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(crate) struct Render {
    /// Result folder of a run
    pub(crate) result: PathBuf,
    /// Only frames A to B-1, numbered as in frames.csv
    #[arg(long, value_name = "A..B", value_parser = frame_range, conflicts_with_all = ["pose", "poses"])]
    pub(crate) frames: Option<Range<usize>>,
    /// A pose of your own, world from camera as in trajectory.txt, exposed as the camera would have done it
    #[arg(
        long,
        value_name = "\"tx ty tz qx qy qz qw\"",
        allow_hyphen_values = true,
        conflicts_with = "poses"
    )]
    pub(crate) pose: Option<String>,
    /// Poses of your own, a file in the TUM format, exposed as along the way at these times
    #[arg(long, value_name = "FILE", value_parser = existing_path())]
    pub(crate) poses: Option<PathBuf>,
    /// Kinds: sharp, blurred, hdr, depth, opacity [default: all that apply]
    #[arg(long, value_name = "KINDS", value_delimiter = ',')]
    pub(crate) kinds: Option<Vec<String>>,
    /// Folder for the pictures, with their poses [default: renders/ of the result, views/ for poses
    /// of your own, numbered after those that are there]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Refused: the pictures have the size of those that the map was made of
    #[arg(long, hide = true, value_name = "N", value_parser = refuse_size)]
    pub(crate) size: Option<String>,
    /// Replace what was drawn into the folder given by --out before; other files in it stay
    #[arg(long, requires = "out")]
    pub(crate) overwrite: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

pub(crate) fn render(arguments: &Render) -> Result<(), Failure> {
    arguments.machine.use_threads()?;
    let own_poses = arguments.pose.is_some() || arguments.poses.is_some();
    let kinds = kinds(arguments, own_poses)?;
    let pose = arguments.pose.as_deref().map(parse_pose).transpose()?;
    note_saved_parts(&i2slam_storage::recover(&arguments.result));
    refuse_non_results(&arguments.result)?;
    // Locked before it is read, so that no other command replaces it meanwhile.
    let mut pictures = Pictures::open(arguments, own_poses)?;
    let reconstruction = i2slam_result::load(&arguments.result)?;
    if reconstruction.map.is_empty() {
        return Err(Failure::Failed(
            "the map of the result is empty: there is nothing to draw".into(),
        ));
    }
    note_edited_trajectory(&arguments.result, &reconstruction);
    let mut frames = pictures.numbered(frames(arguments, pose, &reconstruction)?);
    interrupt::listen();
    let progress = Progress::new(frames.len(), arguments.machine.quiet);
    if own_poses && kinds.contains(&RenderKind::Sharp) {
        expose(&mut frames, &reconstruction, &progress)?;
    }
    let mut viewer = reconstruction.viewer();
    let (mut done, mut empty, mut seen) = (0, 0, 0.0);
    for frame in &frames {
        let mut is_empty = true;
        for &kind in &kinds {
            let image = picture(&mut viewer, kind, frame);
            is_empty &= image.data.iter().all(|value| *value == 0.0);
            save_render(&pictures.folder, pictures.parent, kind, frame.index, &image)?;
        }
        done += 1;
        empty += usize::from(is_empty);
        if own_poses {
            seen += seen_share(&viewer.opacity(frame.middle()));
        }
        progress.step("rendering", done, frames.len());
        if interrupt::requested() {
            break;
        }
    }
    progress.clear();
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let (done_frames, names) = (counted(done, "frame"), names.join(", "));
    pictures.write_poses(&frames[..done])?;
    let path = pictures.place(done < frames.len())?;
    print(&format!("{done_frames}, {names}, in {}", path.display()));
    if own_poses {
        warn_of_unseen(done, empty, seen);
    }
    if done < frames.len() { Err(Failure::Interrupted) } else { Ok(()) }
}

/// Share of a picture that shows the map.
fn seen_share(opacity: &Image<f32>) -> f64 {
    let seen = opacity.data.iter().filter(|opacity| **opacity >= 0.5).count();
    seen as f64 / opacity.data.len().max(1) as f64
}

/// Warns where `done` views of one's own hardly show the map: `empty` of them show nothing, and `seen` is the sum
/// of the [shares](seen_share) of all.
fn warn_of_unseen(done: usize, empty: usize, seen: f64) {
    let share = seen / done.max(1) as f64;
    let found = match empty {
        0 if share < MIN_SEEN_SHARE => {
            format!("the pictures show the map in only {:.0} % of their pixels", 100.0 * share)
        }
        0 => return,
        _ => format!("the map shows nothing from {empty} of {done} poses"),
    };
    print_status(&format!(
        "warning: {found}: poses are expected as world from camera, in world and unit of the result's \
         trajectory.txt"
    ));
}

/// Gives views of one's own the exposures that the camera would have chosen there, where the run's frames
/// tell how: settled for a single pose, along the way for poses whose times rise.
fn expose(
    frames: &mut [FrameEstimate],
    reconstruction: &Reconstruction,
    progress: &Progress,
) -> Result<(), Failure> {
    let mut meter = reconstruction.light_meter();
    let fit = meter.fit(|done, total| {
        progress.step("metering", done, total);
        if interrupt::requested() { Err(Failure::Interrupted) } else { Ok(()) }
    })?;
    let Some(camera) = fit.and_then(|fit| fit.better_than_constant()) else { return Ok(()) };
    let (mut way, mut last) = (camera.follow(), f64::NEG_INFINITY);
    for frame in frames {
        if frame.timestamp <= last {
            way = camera.follow();
        }
        last = frame.timestamp;
        meter.expose(frame, &mut way);
    }
    Ok(())
}

/// Share of the pixels of views of one's own that show the map, below which their poses are doubted.
const MIN_SEEN_SHARE: f64 = 0.5;

/// File with the poses of rendered pictures.
const POSES: &str = "poses.txt";

/// First line of that file.
const POSES_HEADER: &str =
    "# i2slam render: number of the picture, tx ty tz qx qy qz qw, world from camera";

/// Names in a folder of pictures.
const NAMES: &[&str] = &[POSES, "sharp", "blurred", "hdr", "depth", "opacity"];

/// Folder of the pictures.
struct Pictures {
    /// The named folder, or the result.
    folder: OutputFolder,
    /// The place of the pictures in it.
    parent: &'static str,
    /// Path of the pictures.
    path: PathBuf,
    /// Whether a list of poses is written: pictures of the result's own frames need none.
    has_poses: bool,
}

impl Pictures {
    /// Opens the named folder, which must be new, or else the result.
    fn open(arguments: &Render, own_poses: bool) -> Result<Self, Failure> {
        if let Some(out) = &arguments.out {
            let overwrite = arguments.overwrite;
            let claim = Claim { command: "i2slam render", names: NAMES, overwrite };
            let folder = OutputFolder::replace(out, claim)?;
            return Ok(Self { folder, parent: "", path: out.clone(), has_poses: true });
        }
        let parent = if own_poses { "views" } else { "renders" };
        let folder = OutputFolder::extend(&arguments.result, "i2slam render", &[parent])?;
        let path = arguments.result.join(parent);
        Ok(Self { folder, parent, path, has_poses: own_poses })
    }

    /// Numbers views after those that are there.
    fn numbered(&self, mut frames: Vec<FrameEstimate>) -> Vec<FrameEstimate> {
        if self.parent == "views" {
            let first = next_number(&self.path);
            frames.iter_mut().for_each(|frame| frame.index += first);
        }
        frames
    }

    /// Puts the pictures in place; returns their folder. A part of a set goes beside an earlier one.
    fn place(&mut self, is_part: bool) -> Result<PathBuf, Failure> {
        if is_part && self.parent.is_empty() && self.folder.has_earlier_result() {
            return Ok(self.folder.commit_beside("partial")?);
        }
        note_displaced(&self.folder.commit_or_save()?);
        Ok(self.path.clone())
    }

    /// Writes the list of poses, after those of earlier views.
    fn write_poses(&mut self, frames: &[FrameEstimate]) -> Result<(), Failure> {
        if !self.has_poses {
            return Ok(());
        }
        let (file, name) = match self.parent {
            "" => (None, POSES.to_owned()),
            parent => (Some(self.path.join(POSES)), format!("{parent}/{POSES}")),
        };
        let earlier = file.and_then(|file| i2slam_storage::read_text(&file).ok());
        let mut text = earlier.unwrap_or_else(|| format!("{POSES_HEADER}\n"));
        for frame in frames {
            let Pose { rotation: q, translation: t } = frame.middle();
            text += &format!(
                "{} {} {} {} {} {} {} {}\n",
                frame.index, t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w
            );
        }
        Ok(self.folder.write_text(&name, &text)?)
    }
}

/// The number after the highest of the pictures `KIND/NNNNNN.EXTENSION` in a folder.
fn next_number(folder: &Path) -> usize {
    let kinds = RenderKind::ALL.map(|kind| std::fs::read_dir(folder.join(kind.name())));
    let entries = kinds.into_iter().flatten().flatten().flatten();
    let number = |entry: std::fs::DirEntry| entry.path().file_stem()?.to_str()?.parse().ok();
    entries.filter_map(number).max().map_or(0, |last: usize| last + 1)
}

fn picture(viewer: &mut Viewer<'_>, kind: RenderKind, frame: &FrameEstimate) -> Image<f32> {
    match kind {
        RenderKind::Sharp => viewer.sharp(frame),
        RenderKind::Blurred => viewer.blurred(frame),
        RenderKind::Hdr => viewer.hdr(frame.middle()),
        RenderKind::Depth => viewer.depth(frame.middle()),
        RenderKind::Opacity => viewer.opacity(frame.middle()),
    }
}

/// Kinds asked for; by default all, without blur for single poses, which do not move.
fn kinds(arguments: &Render, own_poses: bool) -> Result<Vec<RenderKind>, Failure> {
    let Some(names) = &arguments.kinds else {
        let still = |kind: &RenderKind| !own_poses || *kind != RenderKind::Blurred;
        return Ok(RenderKind::ALL.into_iter().filter(still).collect());
    };
    let kinds: Result<Vec<_>, Failure> = names.iter().map(|name| kind(name.trim())).collect();
    let kinds = kinds?;
    if own_poses && kinds.contains(&RenderKind::Blurred) {
        return Err(Failure::usage(
            "a pose of your own has no motion to blur: leave out `blurred`",
        ));
    }
    Ok(kinds)
}

/// Answers those who look for a size.
fn refuse_size(_: &str) -> Result<String, &'static str> {
    Err("render has no size: its pictures are as large as those that the map was made of, which \
         `i2slam run --max-side N` decides")
}

fn kind(name: &str) -> Result<RenderKind, Failure> {
    RenderKind::from_name(name).ok_or_else(|| {
        let known = RenderKind::ALL.map(RenderKind::name).join(", ");
        Failure::Usage(format!("no kind of picture is called `{name}`: choose of {known}"))
    })
}

fn frames(
    arguments: &Render,
    pose: Option<Pose<f64>>,
    reconstruction: &Reconstruction,
) -> Result<Vec<FrameEstimate>, Failure> {
    if let Some(pose) = pose {
        return Ok(vec![reconstruction.virtual_frame(0, pose)]);
    }
    if let Some(file) = &arguments.poses {
        let poses = read_views(file)?.into_iter().enumerate();
        return Ok(poses
            .map(|(i, pose)| FrameEstimate {
                timestamp: pose.timestamp,
                ..reconstruction.virtual_frame(i, pose.world_from_camera)
            })
            .collect());
    }
    let mut frames = reconstruction.frames.clone();
    if let Some(range) = &arguments.frames {
        frames.retain(|frame| range.contains(&frame.index));
        if frames.is_empty() {
            let (start, end) = (range.start, range.end);
            return Err(Failure::Usage(format!("the result has no frame in {start}..{end}")));
        }
    }
    Ok(frames)
}

fn parse_pose(text: &str) -> Result<Pose<f64>, Failure> {
    let wrong = |why: &str| Failure::Usage(format!("`{text}` is no pose: {why}"));
    let expected = "expected seven numbers, all finite, as in trajectory.txt: tx ty tz qx qy qz qw";
    let [x, y, z, qx, qy, qz, qw] = numbers::<7>(text).ok_or_else(|| wrong(expected))?;
    let rotation = Rotation::from_wxyz(qw, qx, qy, qz);
    let rotation = rotation.ok_or_else(|| wrong("its quaternion qx qy qz qw has no length"))?;
    Ok(Pose::new(rotation, Vec3::new(x, y, z)))
}
