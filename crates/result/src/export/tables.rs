//! The path as text: TUM format, and a table with everything about the frames.

use super::axes::Axes;
use super::scene::Scene;
use crate::frame_files::FILE_COLUMN;
use crate::tables::trajectory;
use i2slam::geometry::StampedPose;
use std::fmt::Write;

/// Beginning of the first line of the table of [`csv`], behind which `file` stands.
pub const CSV_COLUMNS: &str = "index,timestamp,tx,ty,tz,qx,qy,qz,qw,exposure,white_balance_r,\
                               white_balance_g,white_balance_b,blur_length_px,keyframe,held_out";

/// Line of a path whose world is not that of its result.
pub const LEVELLED: &str = "# in the levelled world of exports (--up keep: in that of the result)";

/// Poses at mid-exposure in the TUM format, `timestamp tx ty tz qx qy qz qw`, world from camera; the
/// first line has a mark and the unit of length, the second one says where the world is levelled.
pub fn tum(scene: &Scene, mark: &str) -> String {
    let poses: Vec<StampedPose> = scene
        .frames
        .iter()
        .map(|frame| StampedPose {
            timestamp: frame.timestamp,
            world_from_camera: scene.pose(frame, Axes::YDown),
        })
        .collect();
    let text = trajectory(&poses, scene.unit());
    let text = text.replacen("at mid-exposure", &format!("at mid-exposure, {mark}"), 1);
    match scene.is_levelled() {
        true => text.replacen('\n', &format!("\n{LEVELLED}\n"), 1),
        false => text,
    }
}

/// One row per frame: position in the stream, time [s], pose at mid-exposure (world from camera),
/// exposure relative to the first frame, gains of white balance, blur length [px] (both empty of
/// frames that are not refined), flags, and file of the picture taken.
pub fn csv(scene: &Scene) -> String {
    let mut text = format!("{CSV_COLUMNS},{FILE_COLUMN}\n");
    for frame in &scene.frames {
        let pose = scene.pose(frame, Axes::YDown);
        let (t, q) = (pose.translation, pose.rotation);
        let refined = |value: String| if frame.refined { value } else { String::new() };
        let [exposure, red, green, blue] =
            frame.tone.to_array().map(|log| refined(log.exp().to_string()));
        let blur = refined(format!("{:.3}", frame.blur_length));
        let (keyframe, held_out) = (u8::from(frame.keyframe), u8::from(frame.held_out));
        let (place, time) = (frame.index, frame.timestamp);
        // Writing to a string cannot fail.
        writeln!(
            text,
            "{place},{time},{:.9},{:.9},{:.9},{:.9},{:.9},{:.9},{:.9},{exposure},{red},{green},{blue},\
             {blur},{keyframe},{held_out},{}",
            t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w, scene.files.cell(place)
        )
        .ok();
    }
    text
}
