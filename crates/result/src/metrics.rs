//! `metrics.json`: the measurements of a run.

use i2slam::{FrameEstimate, Reconstruction, UnitOfLength, Warning};
use serde::{Deserialize, Serialize};

/// The measurements of a run; `None` is what could not be measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Metrics {
    /// Version of the program.
    pub version: String,
    /// Name of the preset.
    pub preset: String,
    /// Seed of the run.
    pub seed: u64,
    /// Whether the run reached the end of its frames.
    pub complete: bool,
    /// Whether the result is not what was asked for, though complete.
    pub degraded: bool,
    /// Why it is degraded, a sentence each.
    pub degraded_because: Vec<String>,
    /// True if the frames are photographs in any order, whose time stamps tell nothing.
    pub unordered: bool,
    /// Frames processed.
    pub frames: usize,
    /// Frames whose pose was found.
    pub tracked: usize,
    /// Frames left out: unreadable images.
    pub skipped: usize,
    /// Keyframes.
    pub keyframes: usize,
    /// Gaussians in the final map.
    pub gaussians: usize,
    /// Wall time of the run [s], from the first frame to the finished map.
    pub seconds: f64,
    /// `seconds` over `frames` [s].
    pub seconds_per_frame: f64,
    /// Wall time of tracking per frame [s].
    pub tracking_seconds_per_frame: f64,
    /// Wall time of mapping per frame [s].
    pub mapping_seconds_per_frame: f64,
    /// Peak memory [bytes], where the system reports it.
    pub peak_memory_bytes: Option<u64>,
    /// Median over frames of the blur length [px]; `None` where the motion of none was estimated.
    pub blur_length_px_median: Option<f64>,
    /// Largest blur length [px].
    pub blur_length_px_max: Option<f64>,
    /// Mean PSNR of the predicted, blurred picture against the input [dB].
    pub psnr_blurred_db: Option<f64>,
    /// Frames in `psnr_blurred_db`.
    pub psnr_blurred_frames: usize,
    /// Whether the trajectory error is after alignment with scale, as of colour alone.
    pub ate_scale_aligned: bool,
    /// Absolute trajectory error against the ground truth, RMSE of camera centres after rigid
    /// alignment, or with scale [m].
    pub ate_rmse_m: Option<f64>,
    /// Mean of the absolute trajectory error [m].
    pub ate_mean_m: Option<f64>,
    /// Poses in the trajectory error.
    pub ate_poses: usize,
    /// Frames that have a true pose and no estimated one: the trajectory error leaves them out.
    pub ate_frames_without_pose: usize,
    /// Mean PSNR of sharp renders against the true sharp pictures [dB].
    pub psnr_sharp_db: Option<f64>,
    /// Mean SSIM of sharp renders against the true sharp pictures.
    pub ssim_sharp: Option<f64>,
    /// Frames in `psnr_sharp_db` and `ssim_sharp`.
    pub sharp_frames: usize,
    /// Mean PSNR of the pictures taken against the true sharp pictures, same frames [dB].
    pub psnr_taken_db: Option<f64>,
    /// Frames among them that are blurred over more than 2 px.
    pub frames_over_2px: usize,
    /// `psnr_sharp_db` of these frames [dB].
    pub psnr_sharp_over_2px_db: Option<f64>,
    /// `psnr_taken_db` of these frames [dB].
    pub psnr_taken_over_2px_db: Option<f64>,
    /// Root mean square error of log2 radiance against the true one, after one gain for the whole
    /// sequence [stops].
    pub hdr_log2_rmse_stops: Option<f64>,
    /// PSNR of μ-law compressed radiance after the same gain [dB].
    pub hdr_mu_law_psnr_db: Option<f64>,
    /// Frames in `hdr_log2_rmse_stops` and `hdr_mu_law_psnr_db`.
    pub hdr_frames: usize,
    /// Time from the first to the last row, given or estimated [s]; 0 for a global shutter.
    pub rolling_shutter_readout_s: f64,
    /// Time from the time stamps of depth pictures to when they were taken, as estimated \[s\].
    pub depth_delay_s: f64,
    /// Displacement of depth to the right and down against the colour pictures, as estimated \[px\].
    pub depth_shift_px: [f64; 2],
    /// Share of the light that reaches the corners of a picture, over that at its centre, as found; 1
    /// where none was found.
    pub vignetting_corner: Option<f64>,
    /// Pearson correlation of recovered and true log exposure.
    pub log_exposure_correlation: Option<f64>,
    /// Horizontal focal length at the processed size [px].
    pub focal_length_px: f64,
    /// Horizontal field of view [degrees].
    pub horizontal_fov_deg: f64,
    /// Source of the intrinsics, in words.
    pub camera_source: Option<String>,
    /// Initial focal length, where it was then estimated from the pictures [px].
    pub focal_length_assumed_px: Option<f64>,
    /// Relative standard deviation of the estimated focal length.
    pub focal_length_deviation: Option<f64>,
    /// Radial distortion `k1 k2` (OpenCV) that was estimated from the pictures and removed.
    pub lens_distortion: Option<[f64; 2]>,
    /// Unit of length of poses, map and depth: `metre`, that of given `keyframes`, or `unknown` of colour alone.
    pub unit_of_length: UnitOfLength,
    /// Value of depth pictures that was taken for one metre, where nothing gives it.
    pub depth_scale_assumed: Option<f64>,
    /// Frames of the input, those without a pose included.
    pub frames_given: usize,
    /// Warnings in the order of the run.
    pub warnings: Vec<Warning>,
}

impl Metrics {
    /// Marks the result as degraded by these sentences, if there are any.
    pub fn degrade(&mut self, because: impl IntoIterator<Item = String>) {
        self.degraded_because.extend(because);
        self.degraded = !self.degraded_because.is_empty();
    }

    /// The measurements that need no ground truth and no renders; `seconds` is that of tracking
    /// and mapping.
    pub fn of(reconstruction: &Reconstruction) -> Self {
        let frames = &reconstruction.frames;
        let count = |keep: fn(&FrameEstimate) -> bool| frames.iter().filter(|f| keep(f)).count();
        let sum = |of: fn(&FrameEstimate) -> f64| frames.iter().map(of).sum::<f64>();
        let tracking = sum(|f| f.tracking_seconds);
        let mapping = sum(|f| f.mapping_seconds);
        let per_frame = 1.0 / frames.len().max(1) as f64;
        let refined = frames.iter().filter(|f| f.refined);
        let mut blur: Vec<f64> = refined.map(|f| f.blur_length).collect();
        blur.sort_by(f64::total_cmp);
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            preset: reconstruction.config.preset.clone(),
            seed: reconstruction.config.seed,
            complete: true,
            frames: frames.len(),
            frames_given: frames.len(),
            tracked: count(|f| f.tracked),
            keyframes: count(|f| f.keyframe),
            gaussians: reconstruction.map.gaussians(),
            seconds: tracking + mapping,
            seconds_per_frame: (tracking + mapping) * per_frame,
            tracking_seconds_per_frame: tracking * per_frame,
            mapping_seconds_per_frame: mapping * per_frame,
            blur_length_px_median: blur.get(blur.len() / 2).copied(),
            blur_length_px_max: blur.last().copied(),
            vignetting_corner: vignetting_corner(reconstruction),
            rolling_shutter_readout_s: reconstruction.rolling_shutter_readout,
            focal_length_px: reconstruction.camera.fx,
            horizontal_fov_deg: reconstruction.camera.horizontal_field_of_view().to_degrees(),
            unit_of_length: reconstruction.unit_of_length,
            ..Self::default()
        }
    }
}

/// None where it was not looked for.
fn vignetting_corner(reconstruction: &Reconstruction) -> Option<f64> {
    let formation = &reconstruction.config.formation;
    let looked_for = formation.vignetting && formation.tone;
    looked_for.then(|| f64::from(reconstruction.vignetting.corner()))
}
