//! The presets: the paper's numbers, SplaTAM's where the paper follows it, and our own.
//!
//! Sources: the paper's appendix A (RGBD-SLAM) and SplaTAM's published configurations. A rate of
//! a rotation is twice SplaTAM's, because SplaTAM steps a quaternion and a rotation vector is
//! twice as long as the quaternion's imaginary part.

mod rgb;

use super::*;

/// The names that [`Config::preset`] knows, default first.
pub const PRESET_NAMES: [&str; 10] = [
    "default",
    "paper-tum",
    "paper-tum-s",
    "paper-scannet",
    "paper-scannet-s",
    "paper-synthetic",
    "paper-synthetic-s",
    "default-rgb",
    "paper-rgb",
    "paper-rgb-s",
];

/// Those for keyframes that come with poses.
const RGB_PRESETS: [&str; 3] = ["default-rgb", "paper-rgb", "paper-rgb-s"];

/// A named set of values.
pub type Preset = Config;

impl Default for Config {
    fn default() -> Self {
        ours()
    }
}

impl Config {
    /// The preset called `name`, one of [`PRESET_NAMES`].
    pub fn preset(name: &str) -> Result<Preset, ConfigError> {
        let base = name.strip_suffix("-s").unwrap_or(name);
        let mut config = match base {
            "default" if base == name => ours(),
            "paper-tum" => paper_tum(),
            "paper-scannet" => paper_scannet(),
            "paper-synthetic" => paper_synthetic(),
            "default-rgb" if base == name => rgb::ours(),
            "paper-rgb" => rgb::paper(),
            _ => return Err(ConfigError::UnknownPreset { name: name.to_owned() }),
        };
        if base != name && base == "paper-rgb" {
            rgb::shorten(&mut config);
        } else if base != name {
            config.tracking.iterations = config.tracking.iterations.div_ceil(5);
            config.mapping.iterations = config.mapping.iterations.div_ceil(5);
            config.mapping.first_iterations = config.mapping.first_iterations.div_ceil(5);
        }
        config.preset = name.to_owned();
        config.parameters = Parameters::of_preset(name);
        Ok(config)
    }

    /// Settings for colour alone on 3D Gaussians: the preset `default-rgb`.
    pub fn default_rgb() -> Self {
        rgb::ours()
    }

    /// Whether these settings started from a preset for keyframes that come with poses, of which
    /// depth may be unknown.
    pub fn is_rgb(&self) -> bool {
        RGB_PRESETS.contains(&self.preset.as_str())
    }
}

/// Interactive speed and the best result we know.
fn ours() -> Config {
    let paper = paper_scannet();
    Config {
        preset: "default".to_owned(),
        seed: 0,
        input: InputConfig {
            crop_border: 0,
            minimum_gap: 0.0,
            depth_stamps: false,
            depth_delay: 0.0,
            rolling_shutter_readout: 0.0,
            optimise_rolling_shutter: false,
        },
        formation: FormationConfig {
            quadrature: Quadrature::Midpoints,
            blur_per_camera: 1.5,
            blur_model: BlurModel::Auto,
            white_balance: WhiteBalanceModel::PerChannel,
            response_scope: ResponseScope::Sequence,
            response_start: StartCurve::Shoulder,
            ..paper.formation
        },
        map: paper.map,
        hashgrid: paper.hashgrid,
        keyframed: paper.keyframed,
        tracking: TrackingConfig {
            method: TrackingMethod::SecondOrder,
            iterations: 0,
            ..paper.tracking
        },
        mapping: MappingConfig {
            iterations: 8,
            first_iterations: 60,
            window: 8,
            keyframe_interval: 4,
            keyframe_motion: 0.004,
            final_iterations: 200,
            fill_depth: true,
            ..paper.mapping
        },
        parameters: Parameters::of_preset("default"),
    }
}

/// SplaTAM's ScanNet configuration with the paper's module.
fn paper_scannet() -> Config {
    Config {
        preset: "paper-scannet".to_owned(),
        seed: 0,
        input: InputConfig {
            crop_border: 12,
            minimum_gap: 1.0 / 32.0,
            depth_stamps: false,
            depth_delay: 0.0,
            rolling_shutter_readout: 0.0,
            optimise_rolling_shutter: false,
        },
        formation: FormationConfig {
            blur: true,
            tone: true,
            trajectory_loss: true,
            virtual_cameras: 5,
            quadrature: Quadrature::Endpoints,
            blur_per_camera: 0.0,
            blur_model: BlurModel::Exact,
            white_balance: WhiteBalanceModel::OneGain,
            response_scope: ResponseScope::Frame,
            response_curves: 3,
            response_start: StartCurve::Srgb,
        },
        map: MapConfig { kind: MapKind::Gaussian, isotropic: true, capacity: 2_000_000 },
        hashgrid: hashgrid(),
        keyframed: rgb::keyframed(),
        tracking: TrackingConfig {
            method: TrackingMethod::Adam,
            iterations: 100,
            trajectory_weight: 1e6,
        },
        mapping: MappingConfig {
            interval: 1,
            iterations: 30,
            seconds_per_frame: 0.0,
            beside_tracking: false,
            first_iterations: 30,
            final_iterations: 0,
            hold_out: 0,
            window: 10,
            keyframe_interval: 5,
            keyframe_motion: 0.0,
            depth_weight: 1.0,
            fill_depth: false,
        },
        parameters: Parameters::of_preset("paper-scannet"),
    }
}

/// A field for a room: torch-ngp's, with a smaller table.
fn hashgrid() -> HashGridConfig {
    HashGridConfig {
        bound: 0.0,
        margin: 1.1,
        levels: 16,
        log2_table: 17,
        finest_cell: 0.005,
        moment_jitter: 1.0,
        hidden_width: 64,
        occupancy_cells: 128,
        shell: 0.03,
        step: 1.0 / 128.0,
        step_min: 0.005,
        rays: 4096,
        iterations: 10,
        first_iterations: 200,
        final_iterations: 300,
        rate: 1e-2,
        image_weight: 2.0,
        depth_weight: 1.0,
    }
}

/// SplaTAM's TUM configuration with the paper's module.
fn paper_tum() -> Config {
    let mut config = paper_scannet();
    config.preset = "paper-tum".to_owned();
    config.input.crop_border = 8;
    config.tracking.iterations = 200;
    config.mapping.window = 20;
    config.formation.white_balance = WhiteBalanceModel::PerChannel;
    config
}

/// The paper's synthetic set: monochrome gain and response, slow camera, mapping every 5 frames.
fn paper_synthetic() -> Config {
    let mut config = paper_scannet();
    config.preset = "paper-synthetic".to_owned();
    config.input.crop_border = 0;
    config.formation.response_curves = 1;
    config.tracking.iterations = 200;
    config.tracking.trajectory_weight = 1e4;
    config.mapping.interval = 5;
    config.mapping.window = 24;
    config
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_gives_a_valid_preset() {
        for name in PRESET_NAMES {
            let config = Config::preset(name).expect(name);
            assert_eq!(config.preset, name);
            config.validate().expect(name);
        }
    }

    #[test]
    fn the_short_variants_take_a_fifth_of_the_steps() {
        let config = Config::preset("paper-synthetic-s").expect("known");
        assert_eq!((config.tracking.iterations, config.mapping.iterations), (40, 6));
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let message = Config::preset("fast").expect_err("unknown").to_string();
        assert!(message.contains("fast") && message.contains("paper-scannet"));
        assert!(Config::preset("default-s").is_err());
    }
}
