//! Presets of the RGB system: NeRF-SLAM in the form of torch-ngp, with the paper's module.

use super::*;

/// The paper's appendix A (RGB-SLAM); what it leaves open as in torch-ngp and NeRF-SLAM, whose
/// mapping ends after 25 000 steps.
pub(super) fn paper() -> Config {
    let base = paper_scannet();
    Config {
        preset: "paper-rgb".to_owned(),
        input: InputConfig { crop_border: 0, minimum_gap: 0.0, ..base.input },
        formation: FormationConfig {
            white_balance: WhiteBalanceModel::PerChannel,
            ..base.formation
        },
        map: MapConfig { kind: MapKind::HashGrid, ..base.map },
        hashgrid: HashGridConfig {
            margin: 1.0,
            levels: 16,
            log2_table: 19,
            finest_cell: 1.0 / 1024.0,
            step_min: 0.004,
            iterations: 100,
            first_iterations: 1000,
            final_iterations: 20_000,
            image_weight: 1.0,
            ..base.hashgrid
        },
        keyframed: keyframed(),
        mapping: MappingConfig { ..base.mapping },
        ..base
    }
}

/// A fifth of the steps.
pub(super) fn shorten(config: &mut Config) {
    let steps = &mut config.hashgrid;
    for count in [&mut steps.iterations, &mut steps.first_iterations, &mut steps.final_iterations] {
        *count = count.div_ceil(5);
    }
}

/// The paper's camera rate, CamP's damping, DROID-SLAM's warm-up, NeRF-SLAM's scale of scenes.
pub(super) fn keyframed() -> KeyframedConfig {
    KeyframedConfig {
        first_keyframes: 8,
        reach: 4.0,
        camera_rate: 1e-4,
        pose_delay: 0,
        preconditioning: Preconditioning::Picture,
        preconditioning_damping: 0.1,
        preconditioning_interval: 100,
        trajectory_weight: 1.0,
        refine_imported: false,
        initial_split: 0.1,
        depth_outlier: 0.0,
        coarse_steps: 0,
        surface_depth_weight: 1.0,
        surface_depth_left: 1.0,
        surface_camera_rate: 1e-4,
        surface_steps: 1.0,
        surface_samples: 0,
        surface_detail: 1.0,
        surface_cell: 0.0,
        surface_growth: 0.0,
        surface_searches: 0,
    }
}

/// The best result that we know at a sensible speed.
pub(super) fn ours() -> Config {
    let (paper, ours) = (paper(), super::ours());
    Config {
        preset: "default-rgb".to_owned(),
        formation: ours.formation,
        hashgrid: HashGridConfig {
            levels: 8,
            log2_table: 17,
            finest_cell: 0.015,
            moment_jitter: 0.0,
            hidden_width: 32,
            occupancy_cells: 96,
            shell: 0.1,
            step: 1.0 / 40.0,
            step_min: 0.02,
            rays: 512,
            iterations: 10,
            first_iterations: 150,
            final_iterations: 700,
            ..paper.hashgrid
        },
        keyframed: KeyframedConfig {
            camera_rate: 1e-3,
            preconditioning: Preconditioning::Pose,
            pose_delay: 100,
            preconditioning_interval: 16,
            refine_imported: true,
            initial_split: 0.5,
            depth_outlier: 3.0,
            coarse_steps: 400,
            surface_depth_weight: 0.002,
            surface_depth_left: 0.05,
            surface_steps: 10.0,
            surface_samples: 50_000,
            surface_detail: 2.0,
            surface_cell: 0.5,
            surface_growth: 1.7,
            surface_searches: 2,
            ..paper.keyframed
        },
        map: ours.map,
        tracking: ours.tracking,
        mapping: MappingConfig {
            window: paper.mapping.window,
            iterations: 30,
            final_iterations: 400,
            depth_weight: 0.3,
            ..ours.mapping
        },
        ..paper
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_rates_are_those_of_its_appendix() {
        let config = paper();
        assert_eq!(
            (config.keyframed.camera_rate, config.parameters.frames.exposure_rate),
            (1e-4, 1e-4)
        );
        assert_eq!((config.hashgrid.rate, config.formation.virtual_cameras), (1e-2, 5));
        assert_eq!(config.keyframed.preconditioning, Preconditioning::Picture);
        assert_eq!(config.map.kind, MapKind::HashGrid);
    }

    #[test]
    fn the_short_variant_takes_a_fifth_of_the_steps() {
        let [long, short] =
            ["paper-rgb", "paper-rgb-s"].map(|name| Config::preset(name).expect(name));
        let steps = |c: &Config| [c.hashgrid.first_iterations, c.hashgrid.final_iterations];
        assert_eq!(steps(&long).map(|n| n / 5), steps(&short));
        assert!(long.is_rgb() && short.is_rgb() && !Config::default().is_rgb());
        assert!(Config::preset("default-rgb-s").is_err());
    }
}
