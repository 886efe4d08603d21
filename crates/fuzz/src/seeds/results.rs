//! Result folders of a tiny run, of Gaussians and of a hash grid.

use super::NamedSeed;
use crate::corpus::made_by;
use i2slam::radiance::hashgrid::{
    FieldSettings, HashGridField, HashGridMap, MarchSettings, Occupancy, OccupancySettings,
};
use i2slam::{Map, RunOptions, reconstruct};
use i2slam_check::TemporaryFolder;
use i2slam_result::{FrameFiles, Metrics, NAMES, RunInput, save, save_metrics};
use i2slam_storage::{Claim, OutputFolder};
use i2slam_synthetic::{Spec, synthesise};
use std::path::Path;

pub(super) fn seeds() -> Result<Vec<NamedSeed>, String> {
    let scratch = TemporaryFolder::new("fuzz-results");
    let spec = spec();
    synthesise(&spec, &scratch.join("room"), false, &mut |_| true).map_err(|e| e.to_string())?;
    let mut options = RunOptions::with_depth();
    options.config.mapping.first_iterations = 5;
    options.config.mapping.iterations = 2;
    options.config.mapping.final_iterations = 2;
    options.config.map.capacity = 300;
    let sequence = options.open_sequence(&scratch.join("room")).map_err(|e| e.to_string())?;
    let outcome = reconstruct(&sequence, &options, ()).map_err(|e| e.to_string())?;
    let mut reconstruction = outcome.reconstruction;
    let claim = Claim { command: "i2slam run", names: NAMES, overwrite: false };
    let write = |folder: &Path, reconstruction: &_| {
        let mut folder = OutputFolder::replace(folder, claim).map_err(|e| e.to_string())?;
        // The path is not that of the machine that makes the seeds.
        let input = RunInput { dataset: "/data/room".into(), options: options.open.clone() };
        let mut errors = save(&folder, reconstruction, &FrameFiles::default());
        errors.extend(input.save(&folder).err());
        errors.extend(save_metrics(&folder, &Metrics::of(reconstruction)).err());
        if let Some(error) = errors.first() {
            return Err(error.to_string());
        }
        folder.commit().map(drop).map_err(|e| e.to_string())
    };
    let gaussians = made_by("fuzz-gaussians", |folder| write(folder, &reconstruction))?;
    reconstruction.map = Map::HashGrid(Box::new(hash_grid()?));
    let field = made_by("fuzz-field", |folder| write(folder, &reconstruction))?;
    Ok(vec![("result", "gaussians", gaussians), ("result", "hash-grid", field)])
}

/// The smallest pictures.
fn spec() -> Spec {
    let mut spec = Spec::default();
    spec.camera.frames = 3;
    (spec.camera.width, spec.camera.height) = (32, 24);
    (spec.camera.sub_frames, spec.camera.sharp_samples) = (4, 1);
    spec.light.texel = 0.2;
    spec
}

/// A field of three small grids, empty but for one cell.
fn hash_grid() -> Result<HashGridMap, String> {
    let settings = FieldSettings {
        levels: 3,
        log2_table: 6,
        base_resolution: 3,
        finest_resolution: 11,
        hidden_width: 8,
        geometry_features: 5,
        ..FieldSettings::cube([0.2, -0.1, 0.4], 1.5)
    };
    let field = HashGridField::new(settings, 1).map_err(|e| e.to_string())?;
    let cells = OccupancySettings { resolution: 8, ..OccupancySettings::default() };
    let march = MarchSettings::cube(1.5);
    Ok(HashGridMap { field, occupancy: Occupancy::new(cells), march })
}
