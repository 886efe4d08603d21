//! Parameters of the method: values that presets differ in and that are not settings.
//!
//! Values that all presets share are constants beside the code that uses them.

use crate::objective::PixelLoss;

/// Learning rates, start values and schedules of a preset; files hold only the preset's name.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Exposure, white balance, response and poses of frames.
    pub frames: FrameParameters,
    /// Tracking.
    pub tracking: TrackingParameters,
    /// Maps of Gaussians.
    pub gaussians: GaussianParameters,
    /// Radiance fields.
    pub field: FieldParameters,
    /// Keyframes that come with poses.
    pub keyframed: KeyframedParameters,
}

/// Parameters of what is optimised per frame, and of the camera response.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameParameters {
    /// Spacing of the response's 256 nodes: 1 is uniform, 2.2 is even in display space.
    pub response_node_power: f32,
    /// Weight of the prior that ties the response to its start curve.
    /// Above 0 the response is also found from pictures, where all frames share one.
    pub response_prior: f32,
    /// Learning rate while tracking: of the logarithms of exposure and white balance, and of
    /// response nodes in steps of a straight curve (1 / 255).
    pub tracking_rate: f32,
    /// Learning rate of log exposure while mapping.
    pub exposure_rate: f32,
    /// Learning rate of log white balance while mapping.
    pub white_balance_rate: f32,
    /// Learning rate of response nodes while mapping, in steps of a straight curve (1 / 255).
    pub response_rate: f32,
    /// Gaussians: learning rate of the rotation during the exposure of keyframes that come with
    /// poses [rad].
    pub motion_rotation_rate: f32,
    /// Gaussians: that of the translation [m].
    pub motion_translation_rate: f32,
    /// Keep the poses of keyframes at mid-exposure as their source gave them; otherwise first-order
    /// steps with a field and localisation in the map move them.
    pub keeps_middle: bool,
}

/// Parameters of tracking.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingParameters {
    /// First order: learning rate of rotations [rad].
    pub rotation_rate: f32,
    /// First order: learning rate of translations [m].
    pub translation_rate: f32,
    /// Second order: align to the last keyframe's measured depth as well as to the rendered map.
    pub keyframe_depth: bool,
    /// Second order: weight of normalised image residuals against normalised depth residuals.
    pub image_weight: f32,
}

/// Parameters of maps of Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussianParameters {
    /// Loss of single pixels.
    pub pixel_loss: PixelLoss,
    /// Standard deviation of a new Gaussian, in pixels of the frame that adds it.
    pub initial_scale: f32,
    /// Opacity of a new Gaussian.
    pub initial_opacity: f32,
    /// Learning rate of means [m].
    pub mean_rate: f32,
    /// Learning rate of colours (log radiance, or picture values without tone).
    pub colour_rate: f32,
    /// Learning rate of log scales.
    pub scale_rate: f32,
    /// Learning rate of the quaternions of flat Gaussians.
    pub rotation_rate: f32,
    /// Largest depth of the first frame over the scene's radius.
    pub scene_radius_ratio: f32,
    /// Step only the Gaussians that a keyframe shows, each with its own count of steps.
    pub selective_adam: bool,
    /// Reset Adam's moments before every mapping round.
    pub reset_adam: bool,
}

/// Parameters of radiance fields in a hash grid.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldParameters {
    /// Half edge of the cube over the largest distance in a frame, the farthest 1 % left out.
    pub margin: f32,
    /// Grids from coarse to fine.
    pub levels: usize,
    /// Units of a hidden layer.
    pub hidden_width: usize,
    /// Occupancy cells along an edge of the cube.
    pub occupancy_cells: u32,
    /// Half thickness of the sampled shell around a surface over the surface's depth.
    pub shell: f32,
    /// Distance of samples over their distance from the camera.
    pub step: f32,
    /// Smallest distance of samples [m].
    pub step_min: f32,
    /// Random share of a virtual camera's part of the exposure: 0 takes the middle of the part.
    pub moment_jitter: f32,
    /// λ_img, a mean over pixels.
    pub image_weight: f32,
}

/// Parameters of the joint refinement of keyframes that come with poses. Those that begin with
/// `surface` apply where keyframes have estimated depth in most pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframedParameters {
    /// Keyframes that are awaited before a field starts.
    pub first_keyframes: usize,
    /// Start and end pose of a new keyframe: distance over the motion in one frame interval.
    pub initial_split: f32,
    /// Learning rate of start and end poses: lengths and rad, or with `Preconditioning::Picture`
    /// the root mean square change of the picture. Falls tenfold after the last keyframe.
    pub camera_rate: f32,
    /// Steps of a new field before poses move.
    pub pose_delay: usize,
    /// Steps of a keyframe from one preconditioner to the next; the first ones come sooner.
    pub preconditioning_interval: usize,
    /// Scale c of Cauchy's loss c² ln(1 + r² / (c² σ²)) of estimated depth [standard deviations];
    /// 0 is the square r² / σ².
    pub depth_outlier: f32,
    /// Steps during which the finer half of the grids is opened, one after another.
    pub coarse_steps: usize,
    /// λ_depth: a mean of (d − d̂)² over the depth's variance.
    pub surface_depth_weight: f32,
    /// Share of `surface_depth_weight` at the last step: pictures resolve edges better than depth.
    pub surface_depth_left: f32,
    /// Factor of `hashgrid.final_iterations`: a step takes a tenth of the time.
    pub surface_steps: f32,
    /// Most samples of a step, about; 0 for any. The fog that a field begins as takes many.
    pub surface_samples: usize,
    /// Factor by which cells and distances of samples are finer.
    pub surface_detail: f32,
    /// Largest edge of a cell of the finest grid, in pixels at the median depth; 0 for any.
    pub surface_cell: f32,
    /// Largest ratio of the cells of neighbouring grids; 0 for any.
    pub surface_growth: f32,
    /// Times during the steps after the last keyframe that all keyframes are located again.
    pub surface_searches: usize,
}

/// The paper's appendix A on SplaTAM's configuration of ScanNet; radiance fields as torch-ngp.
const PAPER: Parameters = Parameters {
    frames: FrameParameters {
        response_node_power: 1.0,  // the paper: uniform
        response_prior: 0.0,       // open
        tracking_rate: 1e-2,       // the paper; that it steps logarithms is our reading
        exposure_rate: 1e-2,       // the paper
        white_balance_rate: 1e-2,  // the paper
        response_rate: 1e-2,       // the paper
        motion_rotation_rate: 0.0, // SplaTAM: poses are fixed while mapping
        motion_translation_rate: 0.0,
        keeps_middle: false,
    },
    tracking: TrackingParameters {
        // SplaTAM's, twice: a rotation vector is twice the imaginary part of its quaternion.
        rotation_rate: 2.0 * 5e-4,
        translation_rate: 5e-4, // SplaTAM
        keyframe_depth: true,
        image_weight: 0.15,
    },
    gaussians: GaussianParameters {
        pixel_loss: PixelLoss::Absolute, // SplaTAM
        initial_scale: 1.0,              // SplaTAM
        initial_opacity: 0.5,            // SplaTAM: logit 0
        mean_rate: 1e-4,                 // SplaTAM
        colour_rate: 2.5e-3,             // SplaTAM
        scale_rate: 1e-3,                // SplaTAM
        rotation_rate: 1e-3,             // SplaTAM
        scene_radius_ratio: 3.0,
        selective_adam: false,
        reset_adam: true,
    },
    field: FieldParameters {
        margin: 1.1,
        levels: 16,           // torch-ngp
        hidden_width: 64,     // torch-ngp
        occupancy_cells: 128, // torch-ngp
        shell: 0.03,          // a few times the noise of a depth sensor
        step: 1.0 / 128.0,    // torch-ngp
        step_min: 0.005,
        moment_jitter: 1.0, // long streaks have no gaps
        image_weight: 2.0,  // 0.5, as of Gaussians, lets the depth's noise into the picture
    },
    keyframed: KeyframedParameters {
        first_keyframes: 8, // DROID-SLAM's warm-up, after which NeRF-SLAM's mapping starts
        initial_split: 0.1, // the paper
        camera_rate: 1e-4,  // the paper
        pose_delay: 0,      // open
        preconditioning_interval: 100, // open; CamP: once, for a field that is trained
        depth_outlier: 0.0, // NeRF-SLAM
        coarse_steps: 0,    // torch-ngp
        surface_depth_weight: 1.0, // NeRF-SLAM
        surface_depth_left: 1.0,
        surface_steps: 1.0,
        surface_samples: 0,
        surface_detail: 1.0,
        surface_cell: 0.0,
        surface_growth: 0.0,
        surface_searches: 0,
    },
};

/// SplaTAM's configuration of TUM RGB-D.
const PAPER_TUM: Parameters = Parameters {
    tracking: TrackingParameters {
        rotation_rate: 2.0 * 2e-3,
        translation_rate: 2e-3,
        ..PAPER.tracking
    },
    gaussians: GaussianParameters { scene_radius_ratio: 2.0, ..PAPER.gaussians },
    ..PAPER
};

/// The paper's synthetic scenes: a slow camera.
const PAPER_SYNTHETIC: Parameters = Parameters {
    tracking: TrackingParameters {
        rotation_rate: 2.0 * 5e-5,
        translation_rate: 5e-5,
        ..PAPER.tracking
    },
    ..PAPER
};

/// The paper's appendix A for colour alone, on torch-ngp.
const PAPER_RGB: Parameters = Parameters {
    frames: FrameParameters {
        tracking_rate: 1e-4,
        exposure_rate: 1e-4,
        white_balance_rate: 1e-4,
        response_rate: 1e-4,
        ..PAPER.frames
    },
    field: FieldParameters { margin: 1.0, step_min: 0.004, image_weight: 1.0, ..PAPER.field },
    ..PAPER
};

/// Ours for frames that are tracked against the map, chosen by measurement (docs/experiments).
const DEFAULT: Parameters = Parameters {
    frames: FrameParameters {
        response_node_power: 2.5, // dense in the shadows
        response_prior: 1e-3,     // weak, ties the gauge
        tracking_rate: 5e-3,
        exposure_rate: 5e-3,
        // Slow: tracking has found it, and every step of Adam moves it by the rate.
        white_balance_rate: 5e-4,
        response_rate: 0.05,
        ..PAPER.frames
    },
    gaussians: GaussianParameters {
        pixel_loss: PixelLoss::PseudoHuber, // nearer to the pictures
        initial_scale: 0.5,                 // sharper
        initial_opacity: 0.8,
        mean_rate: 2e-4,
        colour_rate: 1.5e-2,
        scale_rate: 5e-3,
        selective_adam: true,
        reset_adam: false,
        ..PAPER.gaussians
    },
    ..PAPER
};

/// Ours for keyframes that come with poses, chosen by measurement (docs/experiments).
const DEFAULT_RGB: Parameters = Parameters {
    frames: FrameParameters {
        white_balance_rate: 5e-3,
        motion_rotation_rate: 1e-4,
        motion_translation_rate: 2e-4,
        keeps_middle: true, // a step of Adam is as long at the optimum as far from it
        ..DEFAULT.frames
    },
    tracking: TrackingParameters { keyframe_depth: false, ..DEFAULT.tracking },
    // Few steps: faster ones come nearer to the optimum.
    gaussians: GaussianParameters {
        colour_rate: 3e-2,
        scale_rate: 1.5e-2,
        rotation_rate: 1e-2,
        ..DEFAULT.gaussians
    },
    field: FieldParameters {
        levels: 8,
        hidden_width: 32,
        occupancy_cells: 96,
        shell: 0.1, // wide: depth is estimated
        step: 1.0 / 40.0,
        step_min: 0.02,
        moment_jitter: 0.0,
        ..PAPER_RGB.field
    },
    keyframed: KeyframedParameters {
        initial_split: 0.5, // a shutter that is open for half the interval
        camera_rate: 1e-3,  // fewer steps than the paper's
        pose_delay: 100,    // an untrained field says nothing about poses
        preconditioning_interval: 16,
        depth_outlier: 3.0,
        coarse_steps: 400, // coarse to fine, as BARF and BAD-NeRF
        surface_depth_weight: 0.002,
        surface_depth_left: 0.05,
        surface_steps: 10.0,
        surface_samples: 50_000,
        surface_detail: 2.0,
        surface_cell: 0.5,
        surface_growth: 1.7,
        surface_searches: 2,
        ..PAPER.keyframed
    },
};

impl Default for Parameters {
    fn default() -> Self {
        DEFAULT_RGB
    }
}

impl Parameters {
    /// Ours for frames that are tracked against the map.
    pub(crate) fn tracked() -> Self {
        DEFAULT
    }

    /// Those of the preset called `name`; of `default` if there is none.
    pub(super) fn of_preset(name: &str) -> Self {
        match name.strip_suffix("-s").unwrap_or(name) {
            "paper-scannet" => PAPER,
            "paper-tum" => PAPER_TUM,
            "paper-synthetic" => PAPER_SYNTHETIC,
            "paper-rgb" => PAPER_RGB,
            _ => DEFAULT_RGB,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_keep_their_published_rates() {
        let rates = |name: &str| {
            let Parameters { frames, tracking, gaussians, field, keyframed } =
                Parameters::of_preset(name);
            let poses = (tracking.rotation_rate, tracking.translation_rate, keyframed.camera_rate);
            let frames = (frames.tracking_rate, frames.exposure_rate, frames.white_balance_rate);
            (poses, frames, gaussians.mean_rate, gaussians.scene_radius_ratio, field.levels)
        };
        let paper = (1e-2, 1e-2, 1e-2);
        assert_eq!(rates("paper-scannet"), ((1e-3, 5e-4, 1e-4), paper, 1e-4, 3.0, 16));
        assert_eq!(rates("paper-tum-s"), ((4e-3, 2e-3, 1e-4), paper, 1e-4, 2.0, 16));
        assert_eq!(rates("paper-synthetic"), ((1e-4, 5e-5, 1e-4), paper, 1e-4, 3.0, 16));
        let paper_rgb = ((1e-3, 5e-4, 1e-4), (1e-4, 1e-4, 1e-4), 1e-4, 3.0, 16);
        assert_eq!(rates("paper-rgb"), paper_rgb);
        let ours = ((1e-3, 5e-4, 1e-3), (5e-3, 5e-3, 5e-3), 2e-4, 3.0, 8);
        assert_eq!([rates("default"), rates("default-rgb")], [ours, ours]);
    }
}
