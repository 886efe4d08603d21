//! The page that says what a sequence is, and its camera file.

use crate::exposure::ShutterRule;
use crate::spec::Spec;
use i2slam_geometry::Camera;

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

/// The camera file, with the conventions in words.
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

/// The page beside the data.
pub(crate) fn readme(spec: &Spec, rule: &ShutterRule, s: &Summary) -> String {
    let c = &spec.camera;
    let crf = spec.exposure.response.formula();
    format!(
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
        frames = s.frames,
        rate = c.frame_rate,
        w = c.width,
        h = c.height,
        fov = c.field_of_view,
        texel = spec.light.texel,
        stops = spec.light.window_stops,
        smoothing = spec.exposure.smoothing,
        auto = spec.exposure.automatic,
        a = rule.a,
        b = rule.b,
        readout = c.readout,
        sub = c.sub_frames,
        read = spec.noise.read,
        shot = spec.noise.shot,
        period = spec.white_balance.period,
        drift = spec.white_balance.drift,
        depth = if spec.depth.kinect {
            "noise, steps and holes of a first-generation Kinect"
        } else {
            "exact"
        },
        every = spec.output.hdr_every,
        path = s.path_metres,
        rot0 = s.rotation_rate[0],
        rot1 = s.rotation_rate[1],
        ev0 = s.exposure_values[0],
        ev1 = s.exposure_values[1],
        range = s.exposure_values[1] - s.exposure_values[0],
        sv0 = s.shutter[0],
        sv1 = s.shutter[1],
        bl0 = s.blur[0],
        bl1 = s.blur[1],
        bl2 = s.blur[2],
        d0 = s.depth[0],
        d1 = s.depth[1],
        d2 = s.depth[2],
    )
}
