//! Rendering of a sequence from a specification.

use crate::camera_path::CameraPath;
use crate::depth_noise::KinectNoise;
use crate::error::SyntheticError;
use crate::lens::behind_lens;
use crate::light::{LitScene, compute_light};
use crate::render::{self, Shutter};
use crate::scene::furnished_room;
use crate::sensor::{AutoExposure, ShutterRule, raw_exposure_value};
use crate::sensor::{Sensor, white_balance_at};
use crate::spec::{LensSpec, Spec};
use crate::write::{
    Summary, camera_json, output_folder, pose_numbers, readme, write_bytes, write_depth,
    write_list, write_picture, write_radiance,
};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_storage::OutputFolder;
use std::path::Path;

/// Progress of the rendering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The room is built and its light computed.
    Lighting,
    /// Number of finished sharp frames.
    Sharp(usize),
    /// Number of finished blurred frames.
    Blurred(usize),
}

/// Ground truth of a frame after the sharp pass.
struct FrameTruth {
    stamp: f64,
    exposure_value: f64,
    world_from_camera: Pose<f64>,
    depth: Image<f32>,
    median_depth: f64,
}

/// Scene, camera and path of a run.
struct Renderer<'a> {
    spec: &'a Spec,
    camera: Camera<f64>,
    path: CameraPath,
    lit: LitScene,
    folder: OutputFolder,
}

/// Renders a sequence into a folder, which appears when it is complete; an earlier sequence is
/// replaced only if `overwrite`. `progress` receives every finished stage and returns whether to
/// continue.
pub fn synthesise(
    spec: &Spec,
    out: &Path,
    overwrite: bool,
    progress: &mut dyn FnMut(Stage) -> bool,
) -> Result<Summary, SyntheticError> {
    spec.validate()?;
    spec.validate_memory()?;
    let folder = output_folder(out, "i2slam synth", overwrite)?;
    folder.write_text("spec.toml", &spec.record())?;
    let go_on = |on: bool| if on { Ok(()) } else { Err(SyntheticError::Interrupted) };
    go_on(progress(Stage::Lighting))?;
    let lit = compute_light(furnished_room(spec), spec);
    let camera = camera(spec);
    let path = CameraPath::new(spec, lit.scene.desk, camera.fx);
    let mut studio = Renderer { spec, camera, path, lit, folder };
    let mut automatic = AutoExposure::default();
    let mut frames = Vec::new();
    for index in 0..spec.camera.frames {
        frames.push(studio.sharp_frame(index, &mut automatic)?);
        go_on(progress(Stage::Sharp(index + 1)))?;
    }
    let values: Vec<f64> = frames.iter().map(|f| f.exposure_value).collect();
    let rule = ShutterRule::new(&values, &spec.exposure);
    let mut blurs = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        blurs.push(studio.blurred_frame(index, frame, &rule)?);
        go_on(progress(Stage::Blurred(index + 1)))?;
    }
    let summary = studio.finish(&frames, &rule, &blurs)?;
    studio.folder.commit_or_save()?;
    Ok(summary)
}

fn camera(spec: &Spec) -> Camera<f64> {
    let (width, height) = (spec.camera.width, spec.camera.height);
    let f = 0.5 * width as f64 / (0.5 * spec.camera.field_of_view.to_radians()).tan();
    let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
    Camera { width, height, fx: f, fy: f, cx, cy }
}

impl Renderer<'_> {
    fn sensor(&self, frame: f64, exposure_value: f64) -> Sensor {
        Sensor {
            exposure: exposure_value.exp2(),
            white_balance: white_balance_at(&self.spec.white_balance, frame),
            response: self.spec.exposure.response,
        }
    }

    /// Renders the sharp image, radiance and depth of a frame; returns its exposure.
    fn sharp_frame(
        &self,
        index: usize,
        automatic: &mut AutoExposure,
    ) -> Result<FrameTruth, SyntheticError> {
        let spec = self.spec;
        let stamp = index as f64 / spec.camera.frame_rate;
        let pose = self.path.world_from_camera(stamp);
        let radiance = render::sharp(&self.lit, &self.camera, pose, spec.camera.sharp_samples);
        let depth = render::depth(&self.lit, &self.camera, pose, spec.depth.maximum);
        let seen = behind_lens(&radiance, &spec.lens);
        let raw = raw_exposure_value(&seen, spec.exposure.response);
        let exposure_value = automatic.next(raw, &spec.exposure);
        let name = |folder: &str, kind: &str| format!("{folder}/{index:06}.{kind}");
        if spec.output.sharp {
            // As renders are: without what the lens takes away.
            let picture = self.sensor(stamp, exposure_value).picture(&radiance);
            write_bytes(&self.folder, &name("sharp", "png"), write_picture(&picture))?;
        }
        if spec.output.hdr_every > 0 && index.is_multiple_of(spec.output.hdr_every) {
            write_bytes(&self.folder, &name("hdr", "exr"), write_radiance(&radiance))?;
        }
        let kinect = || KinectNoise::default().apply(&depth, spec.seed, index);
        let measured = spec.depth.kinect.then(kinect);
        write_bytes(
            &self.folder,
            &name("depth", "png"),
            write_depth(measured.as_ref().unwrap_or(&depth)),
        )?;
        let median_depth = median(depth.data.iter().map(|&z| f64::from(z)).filter(|&z| z > 0.0));
        let small = depth.resized_by_nearest(depth.width.min(80), depth.height.min(60));
        let world_from_camera = pose;
        Ok(FrameTruth { stamp, exposure_value, world_from_camera, depth: small, median_depth })
    }

    /// Renders the blurred image of a frame; returns the median length of its blur [px].
    fn blurred_frame(
        &self,
        index: usize,
        frame: &FrameTruth,
        rule: &ShutterRule,
    ) -> Result<f64, SyntheticError> {
        let shutter = self.shutter(frame, rule);
        let samples = self.spec.camera.sub_frames;
        let radiance = render::exposed(&self.lit, &self.camera, &self.path, shutter, samples);
        let sensor = self.sensor(frame.stamp, frame.exposure_value);
        let seen = behind_lens(&radiance, &self.spec.lens);
        let picture = sensor.noisy_picture(&seen, &self.spec.noise, self.spec.seed, index);
        write_bytes(&self.folder, &format!("rgb/{index:06}.png"), write_picture(&picture))?;
        Ok(self.blur_length(frame, shutter))
    }

    fn shutter(&self, frame: &FrameTruth, rule: &ShutterRule) -> Shutter {
        let interval = self.spec.camera.frame_rate.recip();
        let share = rule.share(frame.exposure_value);
        let readout = self.spec.camera.readout * interval;
        Shutter { stamp: frame.stamp, open: share * interval, readout }
    }

    /// Poses at shutter open and close of the middle row.
    fn shutter_poses(&self, shutter: Shutter) -> [Pose<f64>; 2] {
        [-0.5, 0.5].map(|u| self.path.world_from_camera(shutter.stamp + u * shutter.open))
    }

    /// Median distance between a point's places at shutter open and close [px].
    fn blur_length(&self, frame: &FrameTruth, shutter: Shutter) -> f64 {
        let ends = self.shutter_poses(shutter).map(|end| end.inverse() * frame.world_from_camera);
        let small = self.camera.resized(frame.depth.width, frame.depth.height);
        let lengths = (0..frame.depth.pixels()).filter_map(|i| {
            let (u, v) = Camera::pixel_centre(i % frame.depth.width, i / frame.depth.width);
            let z = f64::from(frame.depth.data[i]);
            let point = (z > 0.0).then(|| small.unproject(u, v, z))?;
            let [a, b] = ends.map(|end| end * point);
            let seen = a.z > 0.0 && b.z > 0.0;
            let ((ua, va), (ub, vb)) = (self.camera.project(a), self.camera.project(b));
            seen.then(|| (ua - ub).hypot(va - vb))
        });
        median(lengths)
    }

    /// Writes lists, ground truth and the README.
    fn finish(
        &self,
        frames: &[FrameTruth],
        rule: &ShutterRule,
        blurs: &[f64],
    ) -> Result<Summary, SyntheticError> {
        let stamps = || frames.iter().map(|frame| frame.stamp).enumerate();
        write_list(&self.folder, "rgb", "colour images (motion-blurred)", stamps())?;
        let about = "depth maps (z-depth at mid-exposure, 5000 = 1 m, 0 = invalid)";
        write_list(&self.folder, "depth", about, stamps())?;
        self.write_truth(frames, rule, blurs)?;
        let summary = self.summary(frames, rule, blurs);
        self.folder.write_text("camera.json", &camera_json(&self.camera, self.spec, rule))?;
        self.folder.write_text("README.md", &readme(self.spec, rule, &summary))?;
        Ok(summary)
    }

    fn write_truth(
        &self,
        frames: &[FrameTruth],
        rule: &ShutterRule,
        blurs: &[f64],
    ) -> Result<(), SyntheticError> {
        let mut middle = String::from(
            "# ground truth camera poses at mid-exposure, world_from_camera, OpenCV camera axes \
             (x right, y down, z forward), metres\n# timestamp tx ty tz qx qy qz qw\n",
        );
        let mut ends = String::from(
            "# poses at shutter open and shutter close, world_from_camera, OpenCV axes\n# timestamp \
             tx0 ty0 tz0 qx0 qy0 qz0 qw0 tx1 ty1 tz1 qx1 qy1 qz1 qw1\n",
        );
        let (names, coefficients) = vignetting_cells(self.spec);
        let mut table = format!(
            "frame,timestamp,ev,dt,shutter_fraction,shutter_seconds,blur_px_median,wb_r,wb_g,wb_b{names}\n",
        );
        for (i, frame) in frames.iter().enumerate() {
            let (stamp, ev) = (frame.stamp, frame.exposure_value);
            let shutter = self.shutter(frame, rule);
            let [start, end] = self.shutter_poses(shutter);
            middle.push_str(&format!("{stamp:.6} {}\n", pose_numbers(&frame.world_from_camera)));
            let pair = [pose_numbers(&start), pose_numbers(&end)].join(" ");
            ends.push_str(&format!("{stamp:.6} {pair}\n"));
            let [r, g, b] = white_balance_at(&self.spec.white_balance, stamp);
            table.push_str(&format!(
                "{i},{stamp:.6},{ev:.6},{:.6},{:.6},{:.8},{:.3},{r:.6},{g:.6},{b:.6}{coefficients}\n",
                ev.exp2(),
                rule.share(ev),
                shutter.open,
                blurs[i]
            ));
        }
        self.folder.write_text("groundtruth.txt", &middle)?;
        self.folder.write_text("groundtruth_shutter.txt", &ends)?;
        Ok(self.folder.write_text("exposure.csv", &table)?)
    }

    fn summary(&self, frames: &[FrameTruth], rule: &ShutterRule, blurs: &[f64]) -> Summary {
        let steps = frames.windows(2).map(|w| w[0].world_from_camera.local(w[1].world_from_camera));
        let steps: Vec<_> = steps.collect();
        let rate = self.spec.camera.frame_rate;
        let turns = || steps.iter().map(|s| s.rotation.norm().to_degrees() * rate);
        let ends = |values: Vec<f64>| {
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            [least, values.iter().copied().fold(f64::NEG_INFINITY, f64::max)]
        };
        let exposure_values = ends(frames.iter().map(|f| f.exposure_value).collect());
        let depths = ends(frames.iter().map(|f| f.median_depth).collect());
        let depth = || frames.iter().map(|f| f.median_depth);
        Summary {
            frames: frames.len(),
            path_metres: steps.iter().map(|s| s.translation.norm()).sum(),
            rotation_rate: [median(turns()), turns().fold(0.0, f64::max)],
            exposure_values,
            shutter: exposure_values.map(|ev| rule.share(ev)),
            blur: [0.5, 0.9, 1.0].map(|share| quantile(blurs.iter().copied(), share)),
            depth: [depths[0], median(depth()), depths[1]],
        }
    }
}

/// Names and values of the columns of vignetting, each with a comma before it; none of a lens
/// without.
fn vignetting_cells(spec: &Spec) -> (String, String) {
    if spec.lens == LensSpec::default() {
        return (String::new(), String::new());
    }
    let [a, b, c] = spec.lens.vignetting;
    (",vignetting_a,vignetting_b,vignetting_c".into(), format!(",{a:.6},{b:.6},{c:.6}"))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(values, 0.5)
}

/// Quantile of the values; 0 if there are none.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}
