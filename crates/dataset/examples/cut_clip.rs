//! Cuts consecutive frames out of a sequence into a small TUM folder without lens distortion.
//!
//! ```text
//! cargo run -p i2slam-dataset --example cut_clip -- FROM TO FIRST COUNT BORDER SCALE QUALITY
//! ```
//!
//! `FIRST` and `COUNT` are places in the associated stream without thinning, `BORDER` the pixels
//! cropped on every side after the lens is removed, `SCALE` the size after that, `QUALITY` that
//! of the colour JPEG (1 to 100; 0 writes PNG). The demo clip in `assets/demo` was cut by
//!
//! ```text
//! cargo run -p i2slam-dataset --example cut_clip -- \
//!     ../shared/data/tum_fr1_rpy_clip assets/demo 14 66 16 0.5 97
//! ```

use i2slam_dataset::{Frame, OpenOptions, Sequence};
use i2slam_dataset::{read_trajectory, write_camera, write_trajectory};
use i2slam_geometry::Image;
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Ground truth is kept this far beyond the first and the last frame [s].
const MARGIN: f64 = 0.05;

type Outcome = Result<(), Box<dyn Error>>;

struct Arguments {
    from: PathBuf,
    to: PathBuf,
    options: OpenOptions,
    quality: u8,
}

fn main() -> Outcome {
    let arguments = arguments()?;
    let sequence = Sequence::open(&arguments.from, &arguments.options)?;
    let to = &arguments.to;
    fs::create_dir_all(to.join("rgb"))?;
    fs::create_dir_all(to.join("depth"))?;
    let extension = if arguments.quality == 0 { "png" } else { "jpg" };
    let mut colours = String::from("# colour images\n# timestamp filename\n");
    let mut depths =
        String::from("# depth images, 5000 = 1 m, 0 = invalid\n# timestamp filename\n");
    for frame in sequence.stream() {
        let frame = frame?;
        let stamp = format!("{:.6}", frame.timestamp);
        write_frame(&frame, to, &stamp, &arguments, sequence.depth_scale)?;
        writeln!(colours, "{stamp} rgb/{stamp}.{extension}")?;
        writeln!(depths, "{stamp} depth/{stamp}.png")?;
    }
    fs::write(to.join("rgb.txt"), colours)?;
    fs::write(to.join("depth.txt"), depths)?;
    let rate = sequence.frame_rate.round();
    write_camera(to.join("camera.json"), &sequence.camera, sequence.depth_scale, rate)?;
    write_ground_truth(&sequence, to)
}

fn arguments() -> Result<Arguments, Box<dyn Error>> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let [from, to, first, count, border, scale, quality] = given.as_slice() else {
        return Err("expected FROM TO FIRST COUNT BORDER SCALE QUALITY".into());
    };
    let first: usize = first.parse()?;
    let options = OpenOptions {
        frames: Some(first..first + count.parse::<usize>()?),
        crop_border: border.parse()?,
        scale: scale.parse()?,
        minimum_gap: 0.0,
        ..OpenOptions::default()
    };
    Ok(Arguments { from: from.into(), to: to.into(), options, quality: quality.parse()? })
}

fn write_frame(
    frame: &Frame,
    to: &Path,
    stamp: &str,
    arguments: &Arguments,
    depth_scale: f64,
) -> Outcome {
    let colour = interleaved(&frame.colour);
    let (width, height) = (frame.colour.width, frame.colour.height);
    if arguments.quality == 0 {
        let path = to.join(format!("rgb/{stamp}.png"));
        write_png(&path, (width, height), png::ColorType::Rgb, png::BitDepth::Eight, &colour)?;
    } else {
        let path = to.join(format!("rgb/{stamp}.jpg"));
        let mut encoder = jpeg_encoder::Encoder::new_file(path, arguments.quality)?;
        encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_1_1);
        encoder.set_optimized_huffman_tables(true);
        let (width, height) = (u16::try_from(width)?, u16::try_from(height)?);
        encoder.encode(&colour, width, height, jpeg_encoder::ColorType::Rgb)?;
    }
    let raw = |&z: &f32| (f64::from(z) * depth_scale).round() as u16;
    let depth: Vec<u8> = frame.depth.data.iter().map(raw).flat_map(u16::to_be_bytes).collect();
    let path = to.join(format!("depth/{stamp}.png"));
    write_png(&path, (width, height), png::ColorType::Grayscale, png::BitDepth::Sixteen, &depth)
}

/// 8-bit R, G, B of one pixel after another.
fn interleaved(colour: &Image<f32>) -> Vec<u8> {
    let eight = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let pixel = |i: usize| (0..3).map(move |channel| eight(colour.plane(channel)[i]));
    (0..colour.pixels()).flat_map(pixel).collect()
}

fn write_png(
    path: &Path,
    (width, height): (usize, usize),
    color: png::ColorType,
    depth: png::BitDepth,
    data: &[u8],
) -> Outcome {
    let file = fs::File::create(path)?;
    let mut encoder = png::Encoder::new(file, u32::try_from(width)?, u32::try_from(height)?);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(data)?;
    writer.finish()?;
    Ok(())
}

fn write_ground_truth(sequence: &Sequence, to: &Path) -> Outcome {
    let Some(path) = &sequence.ground_truth else { return Ok(()) };
    let (Some(first), Some(last)) = (sequence.entries.first(), sequence.entries.last()) else {
        return Ok(());
    };
    let span = first.timestamp - MARGIN..=last.timestamp + MARGIN;
    let mut trajectory = read_trajectory(path)?;
    trajectory.retain(|pose| span.contains(&pose.timestamp));
    write_trajectory(to.join("groundtruth.txt"), &trajectory)?;
    Ok(())
}
