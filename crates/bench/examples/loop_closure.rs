//! A loop closed while frames come, by colour alone: what it does to the picture of the map.
//!
//! `cargo run --release -p i2slam-bench --example loop_closure -- SEQUENCE OUT.png` maps the frames of
//! a known camera as they come, with and without loop closure, and compares both maps, as they are when
//! the last frame has come, with the pictures of the last frames and with those of the first half that
//! are nearest to them. OUT.png shows one of each: as taken, without and with loop closure.

use i2slam::dataset::Sequence;
use i2slam::geometry::Image;
use i2slam::{Config, FrameEstimate, OnlineSession, Reconstruction, RunOptions};
use i2slam_eval::image::psnr;
use i2slam_result::write_picture;
use std::fs::File;
use std::path::Path;

/// Frames compared on either side of the seam.
const COMPARED: usize = 8;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out] = arguments.as_slice() else {
        return Err("usage: loop_closure SEQUENCE OUT.png".into());
    };
    let sequence = RunOptions::colour_alone().open_sequence(Path::new(folder))?;
    let (open, closed) = std::thread::scope(|scope| {
        let open = scope.spawn(|| map(&sequence, false));
        let closed = map(&sequence, true);
        (open.join(), closed)
    });
    let open = open.map_err(|_| "mapping without loop closure ended by a panic")??;
    let closed = closed?;
    let (first, last) = sides_of_seam(&closed).ok_or("too few frames in the map")?;
    let mut panels = Vec::new();
    for (name, indices) in [("first", first), ("last", last)] {
        let [mut without, mut with] = [Vec::new(), Vec::new()];
        for index in &indices {
            let Some(pictures) = predicted(&open, *index).zip(predicted(&closed, *index)) else {
                continue;
            };
            let taken = picture(&sequence, *index)?;
            without.push(psnr(&pictures.0, &taken)?);
            with.push(psnr(&pictures.1, &taken)?);
            if without.len() == 1 {
                panels.extend([taken, pictures.0, pictures.1]);
            }
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        println!(
            "{name} frames {indices:?}: {:.2} dB without loop closure, {:.2} with",
            mean(&without),
            mean(&with)
        );
    }
    write_picture(&mut File::create(out)?, &rows_of_three(&panels))?;
    Ok(())
}

/// The map when the last frame has come.
fn map(sequence: &Sequence, closes_loops: bool) -> Result<Reconstruction, Failure> {
    let config = Config::default_rgb();
    let mut session = OnlineSession::new(config, sequence.camera, sequence.frame_rate);
    if !closes_loops {
        session = session.without_loop_closure();
    }
    for frame in sequence.stream() {
        let update = session.push(frame?)?;
        session.wait_for_map(0);
        if update.is_loop_closed {
            let moved = update.corrections.len();
            println!("frame {}: a loop is closed, {moved} earlier frames move", update.index);
        }
    }
    Ok(session.reconstruction())
}

/// Indices of the frames of the first half that are nearest to the last one, and of the last frames.
fn sides_of_seam(map: &Reconstruction) -> Option<(Vec<usize>, Vec<usize>)> {
    let end = map.frames.last()?.middle();
    let far = |frame: &FrameEstimate| {
        let off = end.local(frame.middle());
        off.translation.norm() + off.rotation.norm()
    };
    let mut early: Vec<&FrameEstimate> = map.frames[..map.frames.len() / 2].iter().collect();
    early.sort_by(|a, b| far(a).total_cmp(&far(b)));
    let first = early.iter().take(COMPARED).map(|frame| frame.index).collect();
    let last = map.frames.iter().rev().take(COMPARED).map(|frame| frame.index).collect();
    Some((first, last))
}

/// A frame as the map predicts it.
fn predicted(map: &Reconstruction, index: usize) -> Option<Image<f32>> {
    let frame = map.frames.iter().find(|frame| frame.index == index)?;
    Some(map.viewer().blurred(frame))
}

fn picture(sequence: &Sequence, index: usize) -> Result<Image<f32>, Failure> {
    let place = sequence.entries.binary_search_by_key(&index, |entry| entry.index);
    let place = place.map_err(|_| format!("no frame {index}"))?;
    Ok(Image::clone(&*sequence.load(place)?.colour))
}

/// Pictures of one size, three in a row.
fn rows_of_three(pictures: &[Image<f32>]) -> Image<f32> {
    let [width, height] = pictures.first().map_or([0, 0], |p| [p.width, p.height]);
    let rows = pictures.len() / 3;
    Image::from_fn(3 * width, rows * height, 3, |channel, column, row| {
        pictures[3 * (row / height) + column / width].at(channel, column % width, row % height)
    })
}
