//! Named sets of values: the paper's, SplaTAM's where the paper follows it, and our own.

use super::*;
use i2slam_dataset::DepthPairing;

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

const RGB_PRESETS: [&str; 3] = ["default-rgb", "paper-rgb", "paper-rgb-s"];

impl Default for Config {
    fn default() -> Self {
        default()
    }
}

impl Config {
    /// The preset called `name`, one of [`PRESET_NAMES`].
    pub fn preset(name: &str) -> Result<Self, ConfigError> {
        if !PRESET_NAMES.contains(&name) {
            return Err(ConfigError::UnknownPreset { name: name.to_owned() });
        }
        let mut config = match name.strip_suffix("-s").unwrap_or(name) {
            "paper-tum" => paper_tum(),
            "paper-scannet" => paper_scannet(),
            "paper-synthetic" => paper_synthetic(),
            "default-rgb" => default_rgb(),
            "paper-rgb" => paper_rgb(),
            _ => default(),
        };
        if name.ends_with("-s") {
            config.shorten();
        }
        config.preset = name.to_owned();
        config.parameters = Parameters::of_preset(name);
        Ok(config)
    }

    /// The preset `default-rgb`, for colour alone.
    pub fn default_rgb() -> Self {
        default_rgb()
    }

    /// Whether the preset is for colour alone: keyframes come with poses, and may lack depth.
    pub fn is_rgb(&self) -> bool {
        RGB_PRESETS.contains(&self.preset.as_str())
    }

    /// Rule by which the preset gives depth pictures to colour pictures: SplaTAM's for the paper's.
    pub fn depth_pairing(&self) -> DepthPairing {
        if self.preset.starts_with("paper-") {
            DepthPairing::Nearest
        } else {
            DepthPairing::OneToOne
        }
    }

    /// Leaves a fifth of the steps (the paper's "-S"), rounded up.
    fn shorten(&mut self) {
        let (tracking, mapping, field) =
            (&mut self.tracking, &mut self.mapping, &mut self.hashgrid);
        let counts = match self.map.kind {
            MapKind::Gaussian => {
                [&mut tracking.iterations, &mut mapping.iterations, &mut mapping.first_iterations]
            }
            MapKind::HashGrid => {
                [&mut field.iterations, &mut field.first_iterations, &mut field.final_iterations]
            }
        };
        counts.into_iter().for_each(|count| *count = count.div_ceil(5));
    }
}

/// The best result that we know at a usable speed.
fn default() -> Config {
    Config {
        preset: "default".to_owned(),
        parameters: Parameters::of_preset("default"),
        ..default_rgb()
    }
}

/// Settings that our presets share.
fn ours() -> Config {
    let paper = paper_scannet();
    Config {
        preset: "default".to_owned(),
        input: InputConfig { crop_border: 0, minimum_gap: 0.0, ..paper.input },
        formation: FormationConfig {
            vignetting: true,
            quadrature: Quadrature::Midpoints,
            blur_per_camera: 1.5,
            blur_model: BlurModel::Auto,
            white_balance: WhiteBalanceModel::PerChannel,
            response_scope: ResponseScope::Sequence,
            response_start: StartCurve::Shoulder,
            ..paper.formation
        },
        tracking: TrackingConfig {
            method: TrackingMethod::SecondOrder,
            iterations: 0,
            ..paper.tracking
        },
        mapping: MappingConfig {
            iterations: 15,
            first_iterations: 60,
            final_iterations: 4000,
            window: 10,
            keyframe_interval: 4,
            keyframe_motion: 0.004,
            fill_depth: true,
            ..paper.mapping
        },
        map: MapConfig { isotropic: false, view_dependent: true, ..paper.map },
        parameters: Parameters::of_preset("default"),
        ..paper
    }
}

/// SplaTAM's configuration of ScanNet with the paper's module.
fn paper_scannet() -> Config {
    Config {
        preset: "paper-scannet".to_owned(),
        seed: 0,
        memory: 4.0,
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
            vignetting: false,
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
        map: MapConfig {
            kind: MapKind::Gaussian,
            isotropic: true,
            view_dependent: false,
            capacity: 2_000_000,
        },
        hashgrid: HashGridConfig {
            bound: 0.0,
            log2_table: 17,
            finest_cell: 0.005,
            rays: 4096,
            iterations: 10,
            first_iterations: 200,
            final_iterations: 300,
        },
        keyframed: KeyframedConfig {
            reach: 4.0,
            preconditioning: Preconditioning::Picture,
            refine_imported: false,
        },
        tracking: TrackingConfig {
            method: TrackingMethod::Adam,
            iterations: 100,
            trajectory_weight: 1e6,
        },
        mapping: MappingConfig {
            interval: 1,
            iterations: 30,
            seconds_per_frame: 0.0,
            first_iterations: 30,
            final_iterations: 0,
            hold_out: 0,
            hold_out_frames: Vec::new(),
            window: 10,
            keyframe_interval: 5,
            keyframe_motion: 0.0,
            depth_weight: 1.0,
            fill_depth: false,
        },
        parameters: Parameters::of_preset("paper-scannet"),
    }
}

/// SplaTAM's configuration of TUM RGB-D with the paper's module.
fn paper_tum() -> Config {
    let mut config = paper_scannet();
    config.input.crop_border = 8;
    config.tracking.iterations = 200;
    config.mapping.window = 20;
    config.formation.white_balance = WhiteBalanceModel::PerChannel;
    config
}

/// The paper's synthetic scenes: monochrome gain and response, every fifth frame mapped.
fn paper_synthetic() -> Config {
    let mut config = paper_scannet();
    config.input.crop_border = 0;
    config.formation.response_curves = 1;
    config.tracking.iterations = 200;
    config.tracking.trajectory_weight = 1e4;
    config.mapping.interval = 5;
    config.mapping.window = 24;
    config
}

/// The paper's appendix A for colour alone; what it leaves open as in torch-ngp and NeRF-SLAM, whose
/// mapping ends after 25 000 steps.
fn paper_rgb() -> Config {
    let mut config = paper_scannet();
    (config.input.crop_border, config.input.minimum_gap) = (0, 0.0);
    config.formation.white_balance = WhiteBalanceModel::PerChannel;
    config.map.kind = MapKind::HashGrid;
    config.hashgrid = HashGridConfig {
        log2_table: 19,
        finest_cell: 1.0 / 1024.0,
        iterations: 100,
        first_iterations: 1000,
        final_iterations: 20_000,
        ..config.hashgrid
    };
    config
}

/// The best result that we know for colour alone at a usable speed.
fn default_rgb() -> Config {
    let mut config = Config {
        preset: "default-rgb".to_owned(),
        parameters: Parameters::of_preset("default-rgb"),
        ..ours()
    };
    config.hashgrid = HashGridConfig {
        log2_table: 17,
        finest_cell: 0.015,
        rays: 512,
        iterations: 10,
        first_iterations: 150,
        final_iterations: 700,
        ..config.hashgrid
    };
    config.keyframed.preconditioning = Preconditioning::Pose;
    config.keyframed.refine_imported = true;
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
            let is_paper = config.depth_pairing() == DepthPairing::Nearest;
            assert_eq!(is_paper, !["default", "default-rgb"].contains(&name), "{name}");
            config.validate().expect(name);
        }
        assert!(
            Config::preset("paper-rgb").expect("known").is_rgb() && !Config::default().is_rgb()
        );
    }

    #[test]
    fn the_short_variants_take_a_fifth_of_the_steps() {
        let config = Config::preset("paper-synthetic-s").expect("known");
        assert_eq!((config.tracking.iterations, config.mapping.iterations), (40, 6));
        let config = Config::preset("paper-rgb-s").expect("known");
        assert_eq!(
            (config.hashgrid.first_iterations, config.hashgrid.final_iterations),
            (200, 4000)
        );
        assert_eq!((config.tracking.iterations, config.mapping.iterations), (100, 30));
    }

    #[test]
    fn gaussians_are_fitted_to_as_many_keyframes_as_steps_allow() {
        let config = Config::default();
        let fitted = |keyframes, frames| config.fitted_keyframes(keyframes, frames);
        assert_eq!([fitted(17, 66), fitted(60, 2000), fitted(900, 2000)], [66, 800, 900]);
        let steps = [1, 10, 66, 240, 800, 900].map(|count| config.mapping.final_steps(count));
        assert_eq!(steps, [25, 250, 400, 1200, 4000, 4000]);
        let quick = MappingConfig { final_iterations: 50, ..config.mapping.clone() };
        assert_eq!([10, 80].map(|count| quick.final_steps(count)), [50, 50]);
        let mut field = Config::default();
        field.map.kind = MapKind::HashGrid;
        let paper = Config::preset("paper-scannet").expect("known");
        assert_eq!([&field, &paper].map(|config| config.fitted_keyframes(17, 66)), [17; 2]);
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let message = Config::preset("fast").expect_err("unknown").to_string();
        assert!(message.contains("fast") && message.contains("paper-scannet"));
        assert!(Config::preset("default-s").is_err() && Config::preset("default-rgb-s").is_err());
    }
}
