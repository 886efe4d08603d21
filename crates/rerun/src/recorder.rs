//! Recordings of runs: camera path, pictures, exposure, blur and map.

use crate::log::{Log, Row, row};
use i2slam::geometry::{Camera, Image, Rotation, Vec3};
use i2slam::{FrameEstimate, Reconstruction};
use i2slam_cli::RecordedRun;
use i2slam_result::export::splat::Splat;
use i2slam_result::export::{Axes, Scene, Selection, Up};
use re_chunk::{TimePoint, Timeline};
use re_log_types::TimeCell;
use re_sdk_types::AsComponents;
use re_sdk_types::archetypes::{
    EncodedImage, LineStrips3D, Pinhole, Points3D, Scalars, SeriesLines, TextDocument, TextLog,
    Transform3D, ViewCoordinates,
};
use re_sdk_types::components::{Color, LineStrip3D};
use re_sdk_types::datatypes::Quaternion;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Write};

/// Longer side of recorded pictures at most [px].
const MAX_SIDE: usize = 640;
/// Quality of recorded pictures, of 100.
const QUALITY: u8 = 80;
/// Points at most: more slow the viewer down.
const MAX_POINTS: usize = 500_000;
/// Frames of a part of the growing path. Parts that are complete are not written again, so that a
/// recording grows with the number of frames, not with its square.
const PART: usize = 64;

/// Writes the recording of a run.
pub(crate) fn write(run: RecordedRun<'_>, out: &mut dyn Write) -> io::Result<()> {
    let RecordedRun { title, reconstruction, files, has_times, load_picture } = run;
    let frames: Vec<&FrameEstimate> = reconstruction.frames.iter().filter(|f| f.tracked).collect();
    let mut log = Log::begin(out, title, &format!("{title}-{:016x}", fingerprint(&frames)))?;
    log.add("world", [row(TimePoint::STATIC, &[&ViewCoordinates::RDF()])])?;
    add_map(&mut log, reconstruction)?;
    let each = |part: &dyn Fn(&FrameEstimate) -> Row| -> Vec<Row> {
        frames.iter().map(|frame| part(frame)).collect()
    };
    let first = frames.first().filter(|_| has_times).map(|frame| frame.timestamp);
    add_path(&mut log, &frames, first)?;
    log.add("world/camera", each(&|frame| row(time(frame, first), &[&pose(frame)])))?;
    for (entity, values) in SCALARS {
        let scalars = |frame: &FrameEstimate| Scalars::new(values(frame));
        log.add(*entity, each(&|frame| row(time(frame, first), &[&scalars(frame)])))?;
    }
    let channels = SeriesLines::new()
        .with_names(["red", "green", "blue"])
        .with_colors([0xE0_50_50_FF, 0x50_C0_50_FF, 0x50_80_E0_FF].map(Color::from_u32));
    log.add(WHITE_BALANCE, [row(TimePoint::STATIC, &[&channels])])?;
    let keyframes = frames.iter().filter(|frame| frame.keyframe);
    let mark =
        |frame: &FrameEstimate| TextLog::new(format!("keyframe {}", files.name(frame.index)));
    let marks: Vec<Row> = keyframes.map(|frame| row(time(frame, first), &[&mark(frame)])).collect();
    log.add("keyframes", marks)?;
    let named = frames.iter().filter_map(|frame| Some((frame, files.get(frame.index)?)));
    let names = named.map(|(frame, file)| row(time(frame, first), &[&TextDocument::new(file)]));
    log.add("file", names.collect::<Vec<_>>())?;
    for frame in frames {
        let picture = load_picture(frame).and_then(|picture| jpeg(&picture));
        let pinhole = pinhole(&reconstruction.camera);
        let mut parts: Vec<&dyn AsComponents> = vec![&pinhole];
        parts.extend(picture.iter().map(|picture| -> &dyn AsComponents { picture }));
        log.add("world/camera/picture", [row(time(frame, first), &parts)])?;
    }
    log.end()
}

/// A curve over time: its entity, and its values at a frame.
type Curve = (&'static str, fn(&FrameEstimate) -> Vec<f64>);

/// Entity of the gains of red, green and blue.
const WHITE_BALANCE: &str = "white_balance";

const SCALARS: &[Curve] = &[
    ("exposure_stops", |frame| vec![f64::from(frame.tone.log_exposure) / std::f64::consts::LN_2]),
    ("blur_length_px", |frame| vec![frame.blur_length]),
    (WHITE_BALANCE, |frame| frame.tone.log_white_balance.map(|g| f64::from(g).exp()).to_vec()),
];

/// A number that other paths do not have.
fn fingerprint(frames: &[&FrameEstimate]) -> u64 {
    let mut hasher = DefaultHasher::new();
    for frame in frames {
        let position = frame.middle().translation.to_array();
        (frame.index, position.map(f64::to_bits)).hash(&mut hasher);
    }
    hasher.finish()
}

/// Number of a frame in the sequence, and time since the `first` stamp, if times are known.
fn time(frame: &FrameEstimate, first: Option<f64>) -> TimePoint {
    let number = TimePoint::default().with(Timeline::new_sequence("frame"), frame.index as i64);
    let Some(first) = first else { return number };
    let nanoseconds = (1e9 * (frame.timestamp - first)).round() as i64;
    number.with_index("time", TimeCell::from_duration_nanos(nanoseconds))
}

fn position(frame: &FrameEstimate) -> [f32; 3] {
    point(frame.middle().translation)
}

fn point(point: Vec3<f64>) -> [f32; 3] {
    point.to_array().map(|v| v as f32)
}

/// World from camera at mid-exposure.
fn pose(frame: &FrameEstimate) -> Transform3D {
    let Rotation { w, v } = frame.middle().rotation;
    let xyzw = [v.x, v.y, v.z, w].map(|v| v as f32);
    Transform3D::from_translation_rotation(position(frame), Quaternion::from_xyzw(xyzw))
}

/// Rerun, too, has the centre of the first pixel at (0.5, 0.5), and the axes of OpenCV's camera.
fn pinhole(camera: &Camera<f64>) -> Pinhole {
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|v| v as f32);
    let columns = [[fx, 0.0, 0.0], [0.0, fy, 0.0], [cx, cy, 1.0]];
    Pinhole::new(columns).with_resolution([camera.width as f32, camera.height as f32])
}

/// The picture as a JPEG file; none of an empty one.
fn jpeg(picture: &Image<f32>) -> Option<EncodedImage> {
    let (width, height) = (picture.width, picture.height);
    let scale = (MAX_SIDE as f64 / width.max(height).max(1) as f64).min(1.0);
    let size = [width, height].map(|side| ((side as f64 * scale).round() as usize).max(1));
    let picture = match scale < 1.0 {
        true => picture.resized_by_area(size[0], size[1]),
        false => picture.clone(),
    };
    let planes = [0, 1, 2].map(|channel| picture.plane(channel));
    let value = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
    let pixels: Vec<u8> =
        (0..picture.pixels()).flat_map(|i| planes.map(|plane| value(plane[i]))).collect();
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, QUALITY);
    let (width, height) = (u16::try_from(size[0]).ok()?, u16::try_from(size[1]).ok()?);
    encoder.encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb).ok()?;
    Some(EncodedImage::new(bytes).with_media_type("image/jpeg"))
}

/// The path as it grows, in parts, and as a whole; keyframes are marked on it.
fn add_path(log: &mut Log<'_>, frames: &[&FrameEstimate], first: Option<f64>) -> io::Result<()> {
    let positions: Vec<[f32; 3]> = frames.iter().map(|frame| position(frame)).collect();
    let strip =
        |points: &[[f32; 3]]| LineStrips3D::new([LineStrip3D::from_iter(points.iter().copied())]);
    log.add("world/trajectory", [row(TimePoint::STATIC, &[&strip(&positions)])])?;
    for begin in (0..frames.len()).step_by(PART) {
        let end = (begin + PART).min(frames.len());
        // A part begins at the last frame of the part before.
        let from = begin.saturating_sub(1);
        let rows = (begin..end)
            .map(|last| row(time(frames[last], first), &[&strip(&positions[from..=last])]));
        log.add(format!("world/path/{begin}"), rows.collect::<Vec<_>>())?;
    }
    let keyframes = frames.iter().filter(|frame| frame.keyframe);
    let marks = Points3D::new(keyframes.map(|frame| position(frame)));
    log.add("world/keyframes", [row(TimePoint::STATIC, &[&marks])])
}

/// The Gaussians that are rather opaque, as points with their standard deviation as radius. A map
/// without Gaussians is left out.
fn add_map(log: &mut Log<'_>, reconstruction: &Reconstruction) -> io::Result<()> {
    let selection = Selection { min_opacity: 0.5, up: Up::Kept, ..Selection::default() };
    let scene = Scene::new(reconstruction.clone(), &selection);
    let Ok(splats) = scene.and_then(|scene| scene.splats(Axes::YDown)) else { return Ok(()) };
    let every = splats.len().div_ceil(MAX_POINTS).max(1);
    let shown: Vec<&Splat> = splats.iter().step_by(every).collect();
    let colour = |splat: &Splat| {
        let [r, g, b] = splat.colour.map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8);
        Color::from_rgb(r, g, b)
    };
    let points = Points3D::new(shown.iter().map(|splat| splat.mean))
        .with_colors(shown.iter().map(|splat| colour(splat)))
        .with_radii(shown.iter().map(|splat| radius(splat)));
    log.add("world/map", [row(TimePoint::STATIC, &[&points])])
}

/// Geometric mean of the two larger standard deviations: Gaussians of surfaces are flat.
fn radius(splat: &Splat) -> f32 {
    let mut scales = splat.log_scale;
    scales.sort_by(f32::total_cmp);
    (0.5 * (scales[1] + scales[2])).exp()
}
