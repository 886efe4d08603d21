//! Memory that the settings of a run need, estimated before anything is allocated, against that of
//! the machine.

use super::{PoseSource, RunOptions};
use crate::config::{BlurModel, Config, ConfigError, MapKind};
use crate::mapping::largest_field;
use i2slam_dataset::Sequence;
use i2slam_radiance::gaussian::Gaussian;
use i2slam_radiance::hashgrid::FieldSettings;

/// Memory that is taken as available where the system does not tell [bytes]: that of a large
/// workstation.
const USUAL_MEMORY: u64 = 64 << 30;

/// Numbers of a pixel of a keyframe: three of colour, one of depth, six means for SSIM.
const KEYFRAME_NUMBERS: u64 = 10;

/// Copies of a Gaussian: the map, its gradient, two moments, and the result.
const GAUSSIAN_COPIES: u64 = 5;

/// Bytes of a Gaussian in a picture: its projection, extent and place in the order of depth.
const SPLAT: u64 = 100;

/// Bytes of a pixel of a render: radiance, depth, opacity.
const RENDER_PIXEL: u64 = 20;

/// Samples of a ray in shells around surfaces, about; rays in fog have more.
const RAY_SAMPLES: u64 = 12;

/// Half edge of the cube of a field that is sized by what it sees, for the estimate [m].
const ROOM: f64 = 8.0;

/// Sequence as it counts for memory.
#[derive(Clone, Copy, Debug)]
struct Extent {
    /// Pixels of a frame.
    pixels: u64,
    frames: u64,
    /// Whether frames are tracked against the map, not keyframes refined with it.
    tracked: bool,
}

/// Memory that one setting decides.
#[derive(Clone, Debug, PartialEq)]
struct Need {
    key: &'static str,
    value: String,
    bytes: u64,
    /// Change that needs less.
    advice: &'static str,
}

/// Refuses settings that need more memory than the machine has; a setting out of its range is left
/// to the checks that name its range.
pub(super) fn check(options: &RunOptions, sequence: &Sequence) -> Result<(), ConfigError> {
    let camera = &sequence.camera;
    let extent = Extent {
        pixels: (camera.width as u64).saturating_mul(camera.height as u64),
        frames: sequence.len() as u64,
        tracked: options.poses == PoseSource::Map,
    };
    let available = i2slam_compute::machine_memory().unwrap_or(USUAL_MEMORY);
    check_needs(needs(&options.config, extent), available)
}

/// Refuses all `needs` together if they exceed `available` bytes, in the name of the largest.
fn check_needs(needs: Vec<Need>, available: u64) -> Result<(), ConfigError> {
    let all = needs.iter().fold(0_u64, |sum, need| sum.saturating_add(need.bytes));
    let largest = needs.into_iter().max_by_key(|need| need.bytes);
    match largest.filter(|_| all > available) {
        None => Ok(()),
        Some(Need { key, value, bytes, advice }) => Err(ConfigError::TooMuchMemory {
            place: String::new(),
            key,
            value,
            memory: format!(
                "{} of memory, the whole run {}; this machine has {}: {advice}",
                in_gigabytes(bytes),
                in_gigabytes(all),
                in_gigabytes(available)
            ),
        }),
    }
}

fn in_gigabytes(bytes: u64) -> String {
    format!("{:.1} GB", bytes as f64 * 1e-9)
}

/// The settings that decide how much memory a run needs, by the sizes that they lead to.
fn needs(config: &Config, extent: Extent) -> Vec<Need> {
    let mut needs = match config.map.kind {
        MapKind::Gaussian => vec![gaussians(config, extent)],
        MapKind::HashGrid => field(config, extent),
    };
    needs.extend(keyframes(config, extent));
    needs.push(virtual_cameras(config, extent));
    needs
}

/// A map that is as full as its capacity and the pictures allow.
fn gaussians(config: &Config, Extent { pixels, frames, .. }: Extent) -> Need {
    let capacity = config.map.capacity as u64;
    let count = capacity.saturating_add(pixels).min(pixels.saturating_mul(frames));
    let each = GAUSSIAN_COPIES * size_of::<Gaussian<f32>>() as u64 + SPLAT;
    Need {
        key: "map.capacity",
        value: capacity.to_string(),
        bytes: count.saturating_mul(each),
        advice: "lower it",
    }
}

/// A field with its optimiser, and the rays of a step. Settings that no field can be made of need
/// nothing: they are refused when it is made.
fn field(config: &Config, extent: Extent) -> Vec<Need> {
    let bound = match config.hashgrid.bound {
        0.0 => ROOM,
        bound => f64::from(bound),
    };
    let (settings, cells) = largest_field(config, bound, !extent.tracked);
    let (Ok(training), table) = (settings.training_bytes(), config.hashgrid.log2_table) else {
        return Vec::new();
    };
    let table = Need {
        key: "hashgrid.log2_table",
        value: table.to_string(),
        bytes: training.saturating_add(2 * FieldSettings::occupancy_bytes(cells)),
        advice: "lower it",
    };
    // With poses each pixel takes a ray for every virtual camera.
    let per_pixel = match (extent.tracked, config.formation.blur) {
        (false, true) => config.formation.virtual_cameras as u64,
        _ => 1,
    };
    let count = (config.hashgrid.rays as u64).saturating_mul(per_pixel);
    let rays = Need {
        key: "hashgrid.rays",
        value: config.hashgrid.rays.to_string(),
        bytes: settings.ray_bytes(count, RAY_SAMPLES).unwrap_or(0),
        advice: "take fewer",
    };
    vec![table, rays]
}

/// Keyframes that are kept, where their number is known: every n-th frame is one.
fn keyframes(config: &Config, Extent { pixels, frames, tracked }: Extent) -> Option<Need> {
    let mapping = &config.mapping;
    let every = mapping.keyframe_interval.max(1) as u64;
    (tracked && mapping.keyframe_motion == 0.0).then(|| Need {
        key: "mapping.keyframe_interval",
        value: every.to_string(),
        bytes: (frames / every).saturating_mul(pixels * KEYFRAME_NUMBERS * 4),
        advice: "take a larger one, smaller pictures or fewer frames",
    })
}

/// Renders of an exposure, each with about a Gaussian for every pixel; re-projection needs one, and
/// `auto` re-projects unless the blur is long.
fn virtual_cameras(config: &Config, Extent { pixels, .. }: Extent) -> Need {
    let formation = &config.formation;
    let count = match (formation.blur, formation.blur_model) {
        (true, BlurModel::Exact) => formation.virtual_cameras as u64,
        _ => 1,
    };
    Need {
        key: "formation.virtual_cameras",
        value: formation.virtual_cameras.to_string(),
        bytes: count.saturating_mul(pixels).saturating_mul(2 * RENDER_PIXEL + SPLAT),
        advice: "take fewer, or smaller pictures",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIDEO: Extent = Extent { pixels: 640 * 480, frames: 300, tracked: true };
    const GB: u64 = 1_000_000_000;

    fn preset(name: &str) -> Config {
        Config::preset(name).expect("known")
    }

    fn message(config: &Config, extent: Extent, available: u64) -> String {
        check_needs(needs(config, extent), available).expect_err("too much").to_string()
    }

    #[test]
    fn presets_fit_into_a_small_machine() {
        for name in crate::config::PRESET_NAMES {
            let config = preset(name);
            let extent = Extent { tracked: !config.is_rgb(), ..VIDEO };
            check_needs(needs(&config, extent), 4 * GB).expect(name);
        }
    }

    #[test]
    fn extreme_settings_are_refused_by_name() {
        let mut config = preset("paper-rgb");
        config.hashgrid.log2_table = 24;
        config.parameters.field.levels = 32;
        let text = message(&config, VIDEO, 8 * GB);
        assert!(text.starts_with("hashgrid.log2_table = 24 needs about "), "{text}");
        assert!(text.contains("; this machine has 8.0 GB: lower it"), "{text}");

        let mut config = preset("paper-rgb");
        (config.hashgrid.rays, config.parameters.field.hidden_width) = (1_000_000, 1024);
        assert!(message(&config, VIDEO, 32 * GB).starts_with("hashgrid.rays = 1000000 "));
        config.hashgrid.rays = usize::MAX;
        assert!(message(&config, VIDEO, u64::MAX - 1).starts_with("hashgrid.rays = "));

        let mut config = preset("default");
        config.map.capacity = 100_000_000;
        assert!(message(&config, VIDEO, 16 * GB).starts_with("map.capacity = 100000000 "));
        // Three small frames cannot fill it.
        let few = Extent { pixels: 48 * 36, frames: 3, ..VIDEO };
        check_needs(needs(&config, few), GB).expect("a small map");

        let mut config = preset("paper-tum");
        config.mapping.keyframe_interval = 1;
        let long = Extent { frames: 20_000, ..VIDEO };
        assert!(message(&config, long, 64 * GB).starts_with("mapping.keyframe_interval = 1 "));

        let mut config = preset("paper-tum");
        (config.formation.virtual_cameras, config.map.capacity) = (64, 1);
        let large = Extent { pixels: 32_000_000, frames: 3, ..VIDEO };
        assert!(message(&config, large, 64 * GB).starts_with("formation.virtual_cameras = 64 "));
    }

    #[test]
    fn fields_that_cannot_be_made_are_left_to_their_own_error() {
        let mut config = preset("paper-rgb");
        config.parameters.field.levels = 0;
        assert!(needs(&config, VIDEO).iter().all(|need| !need.key.starts_with("hashgrid")));
    }
}
