//! The files of a sequence, in the TUM layout: images, lists, `camera.json` and a README.

use crate::error::SyntheticError;
use crate::sensor::ShutterRule;
use crate::spec::{GlossSpec, LensSpec, NoiseSpec, Spec, WhiteBalanceSpec};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_storage::{Claim, OutputFolder};
use std::io::{self, Cursor};
use std::path::Path;

/// Names in the folder of a sequence, whether it is rendered or degraded.
const NAMES: &[&str] = &[
    "rgb.txt",
    "depth.txt",
    "groundtruth.txt",
    "groundtruth_shutter.txt",
    "exposure.csv",
    "camera.json",
    "README.md",
    "spec.toml",
    "source.csv",
    "vignetting.json",
    "rgb",
    "depth",
    "sharp",
    "hdr",
];

/// Opens the folder of a sequence; an earlier one is replaced only if `overwrite`.
pub(crate) fn output_folder(
    out: &Path,
    command: &str,
    overwrite: bool,
) -> Result<OutputFolder, SyntheticError> {
    Ok(OutputFolder::replace(out, Claim { command, names: NAMES, overwrite })?)
}

/// Writes encoded bytes.
pub(crate) fn write_bytes(
    folder: &OutputFolder,
    relative: &str,
    bytes: io::Result<Vec<u8>>,
) -> Result<(), SyntheticError> {
    Ok(folder.write(relative, |out| out.write_all(&bytes?))?)
}

/// Writes `rgb.txt` or `depth.txt`, a line for every numbered frame with its stamp [s].
pub(crate) fn write_list(
    folder: &OutputFolder,
    kind: &str,
    about: &str,
    stamps: impl IntoIterator<Item = (usize, f64)>,
) -> Result<(), SyntheticError> {
    let mut text = format!("# {about}\n# timestamp filename\n");
    for (number, stamp) in stamps {
        text.push_str(&format!("{stamp:.6} {kind}/{number:06}.png\n"));
    }
    Ok(folder.write_text(&format!("{kind}.txt"), &text)?)
}

/// `tx ty tz qx qy qz qw`.
pub(crate) fn pose_numbers(pose: &Pose<f64>) -> String {
    let (t, q) = (pose.translation, pose.rotation);
    format!("{:.7} {:.7} {:.7} {:.9} {:.9} {:.9} {:.9}", t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w)
}

/// Depth image value of one metre.
pub(crate) const DEPTH_SCALE: f64 = 5000.0;

/// An 8-bit RGB PNG of a picture in `[0, 1]`.
pub(crate) fn write_picture(picture: &Image<f32>) -> io::Result<Vec<u8>> {
    let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
    let planes = [0, 1, 2].map(|channel| picture.plane(channel));
    let pixels = (0..picture.pixels()).flat_map(|i| planes.map(|plane| byte(plane[i])));
    let bytes: Vec<u8> = pixels.collect();
    write_png(picture, png::ColorType::Rgb, png::BitDepth::Eight, &bytes)
}

/// A 16-bit grey PNG of depth in metres; values beyond 16 bits become 0.
pub(crate) fn write_depth(depth: &Image<f32>) -> io::Result<Vec<u8>> {
    let units = depth.plane(0).iter().map(|&metres| {
        let unit = (f64::from(metres) * DEPTH_SCALE).round_ties_even();
        if unit > 0.0 && unit <= f64::from(u16::MAX) { unit as u16 } else { 0 }
    });
    let bytes: Vec<u8> = units.flat_map(u16::to_be_bytes).collect();
    write_png(depth, png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes)
}

fn write_png(
    image: &Image<f32>,
    colour: png::ColorType,
    bits: png::BitDepth,
    bytes: &[u8],
) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, image.width as u32, image.height as u32);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(out)
}

/// A half-float linear RGB OpenEXR of radiance (Rec. 709 primaries).
pub(crate) fn write_radiance(radiance: &Image<f32>) -> io::Result<Vec<u8>> {
    use exr::prelude::{Compression, Encoding, SpecificChannels, Vec2, WritableImage, f16};
    let (width, height) = (radiance.width, radiance.height);
    let planes = [0, 1, 2].map(|channel| radiance.plane(channel));
    let pixels = SpecificChannels::rgb(|at: Vec2<usize>| {
        let [r, g, b] = planes.map(|plane| f16::from_f32(plane[at.y() * width + at.x()]));
        (r, g, b)
    });
    let mut bytes = Cursor::new(Vec::new());
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    exr::prelude::Image::from_encoded_channels((width, height), encoding, pixels)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(io::Error::other)?;
    Ok(bytes.into_inner())
}

/// Figures of a finished sequence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Number of frames.
    pub frames: usize,
    /// Length of the path [m].
    pub path_metres: f64,
    /// Median and largest rate of rotation between frames [degrees/s].
    pub rotation_rate: [f64; 2],
    /// Smallest and largest exposure value [stops].
    pub exposure_values: [f64; 2],
    /// Smallest and largest open share of the frame interval.
    pub shutter: [f64; 2],
    /// Median, 90th percentile and largest of the frames' median blur [px].
    pub blur: [f64; 3],
    /// Smallest, median and largest depth over all frames' medians [m].
    pub depth: [f64; 3],
}

/// Contents of `camera.json`, with its conventions.
pub(crate) fn camera_json(camera: &Camera<f64>, spec: &Spec, rule: &ShutterRule) -> String {
    let [w, h] = [camera.width, camera.height];
    let (fps, fov) = (spec.camera.frame_rate, spec.camera.field_of_view);
    let (cx_integer, cy_integer) = (camera.cx - 0.5, camera.cy - 0.5);
    let crf = spec.exposure.response.formula();
    format!(
        r#"{{
  "width": {w},
  "height": {h},
  "fx": {},
  "fy": {},
  "cx": {},
  "cy": {},
  "fps": {fps},
  "depth_scale": 5000.0,
  "pixel_centre": 0.5,
  "distortion": [0, 0, 0, 0, 0],
  "hfov_deg": {fov},
  "convention": {{
    "pixel_centres": "integer + 0.5: pixel (column i, row j) is sampled at (i+0.5, j+0.5); u = fx*X/Z + cx",
    "cx_integer": {cx_integer},
    "cy_integer": {cy_integer},
    "camera_axes": "OpenCV: x right, y down, z forward",
    "poses": "world_from_camera, metres, world z up",
    "depth": "z-depth (not ray distance) at the pixel centre, mid-exposure, uint16 = round(5000*z), 0 = invalid",
    "timestamp": "mid-exposure"
  }},
  "crf": "{crf}, x = dt*wb*H",
  "shutter": "SV_i = a*2**EV_i + b (fraction of the frame interval), box shutter centred on the timestamp",
  "shutter_a": {},
  "shutter_b": {},
  "readout": {}
}}
"#,
        camera.fx, camera.fy, camera.cx, camera.cy, rule.a, rule.b, spec.camera.readout
    )
}

/// Contents of the sequence's README.
pub(crate) fn readme(spec: &Spec, rule: &ShutterRule, s: &Summary) -> String {
    let c = &spec.camera;
    let crf = spec.exposure.response.formula();
    let (frames, rate, w, h) = (s.frames, c.frame_rate, c.width, c.height);
    let (fov, readout, sub) = (c.field_of_view, c.readout, c.sub_frames);
    let (texel, stops) = (spec.light.texel, spec.light.window_stops);
    let (smoothing, auto) = (spec.exposure.smoothing, spec.exposure.automatic);
    let ShutterRule { a, b } = rule;
    let NoiseSpec { read, shot } = spec.noise;
    let WhiteBalanceSpec { drift, period } = spec.white_balance;
    let kinect = "noise, steps and holes of a first-generation Kinect";
    let depth = if spec.depth.kinect { kinect } else { "exact" };
    let (every, path) = (spec.output.hdr_every, s.path_metres);
    let ([rot0, rot1], [ev0, ev1]) = (s.rotation_rate, s.exposure_values);
    let ([sv0, sv1], [bl0, bl1, bl2], [d0, d1, d2]) = (s.shutter, s.blur, s.depth);
    let range = ev1 - ev0;
    let text = format!(
        "# Synthetic RGB-D sequence with motion blur, exposure changes and a camera response\n\n\
         {frames} frames at {rate} fps (time stamps i/{rate} s = mid-exposure), {w}x{h}, horizontal field of view \
         {fov} degrees, pinhole, no distortion (camera.json). Made by `i2slam synth` from spec.toml: the same file \
         and version give the same bytes.\n\n\
         ## Formation\n\n\
         - H: linear radiance (Rec. 709 primaries) of a procedural room: Lambertian surfaces, light computed once \
         on a grid (area lights, sun, {texel} m spacing, three reflections). The outside's mean is {stops} stops \
         above the room's median radiance.\n\
         - raw EV_i = log2(CRF^-1(0.5) / median(Y_i)), Y = 0.2126 R + 0.7152 G + 0.0722 B of the sharp frame; \
         EV_i = EV_(i-1) + (raw_i - EV_(i-1))/{smoothing}, EV_0 = raw_0. Automatic: {auto}.\n\
         - dt_i = 2^EV_i.\n\
         - Shutter share of the frame interval SV_i = a 2^EV_i + b with a = {a:.6}, b = {b:.6}; box shutter, centred \
         on the time stamp; rows read over {readout} of the frame interval.\n\
         - B_i: average of radiance at {sub} instants over the shutter, each with its own place in the pixel.\n\
         - rgb: {crf}, x = dt wb B with noise of variance {read}^2 + {shot} x; sharp: the same of H at mid-exposure, \
         without noise, without rolling shutter.\n\
         - White balance: red 2^(d sin(2 pi t/{period})), green 1, blue 2^(-d sin(2 pi t/{period})), d = {drift} stops.\n\
         - Depth: {depth}.\n\
         - dt scales brightness independently of SV, as in the paper: a longer shutter does not by itself brighten \
         the frame.\n\n\
         ## Files\n\n\
         rgb/ (blurred), depth/ (uint16, 5000 = 1 m, z-depth at the pixel centre at mid-exposure, 0 = invalid), \
         sharp/, hdr/ (half-float linear sharp radiance, every {every} frame(s), 0 = none), rgb.txt, depth.txt, \
         groundtruth.txt (world_from_camera, OpenCV axes, mid-exposure), groundtruth_shutter.txt (poses at shutter \
         open and close of the middle row), exposure.csv (blur_px_median: median distance in pixels between the \
         places of a point at shutter open and close), camera.json, spec.toml.\n\n\
         ## Figures\n\n\
         | | |\n|---|---|\n\
         | path | {path:.3} m |\n\
         | rotation, median / largest | {rot0:.1} / {rot1:.1} degrees/s |\n\
         | exposure value | {ev0:.3} to {ev1:.3} ({range:.2} stops) |\n\
         | shutter share | {sv0:.3} to {sv1:.3} |\n\
         | blur, median / 90 % / largest | {bl0:.2} / {bl1:.2} / {bl2:.2} px |\n\
         | median depth, smallest / middle / largest | {d0:.2} / {d1:.2} / {d2:.2} m |\n",
    );
    text + &gloss_lines(spec) + &lens_lines(spec)
}

/// The part of the README on the lens; empty without vignetting.
fn lens_lines(spec: &Spec) -> String {
    if spec.lens == LensSpec::default() {
        return String::new();
    }
    let [a, b, c] = spec.lens.vignetting;
    format!(
        "\n## Lens\n\nrgb and sharp, not hdr, are multiplied by v(r) = 1 + {a} r^2 + {b} r^4 + {c} r^6 in linear \
         light before noise and response; r: distance from the middle of the picture over half its diagonal. v(1) = \
         {:.3}. exposure.csv repeats the coefficients in every line.\n",
        1.0 + a + b + c
    )
}

/// The part of the README on gloss; empty of a matt room.
fn gloss_lines(spec: &Spec) -> String {
    let GlossSpec { polish, spread, mirror } = spec.gloss;
    if polish == 0.0 && !mirror {
        return String::new();
    }
    let mirror = if mirror { "one, whose depth is that of its surface" } else { "none" };
    format!(
        "\n## Gloss\n\nRadiance (1 - F) L + F times the mean radiance from about the mirror direction, F = F0 + \
         (1 - F0)(1 - cos)^5 with F0 = {polish} on floor, furniture and glazes, deviation {spread} degrees \
         (floor: twice). Mirror: {mirror}.\n"
    )
}
