//! Round trips and failures, on a reconstruction made by hand.

use super::*;
use crate::export::ply;
use crate::export::splat::{Display, splats};
use i2slam::Config;
use i2slam::config::MapKind;
use i2slam::formation::{
    CameraResponse, FrameTone, NodeSpacing, ShutterPoses, StartCurve, Vignetting, tone::NODES,
};
use i2slam::geometry::{Camera, Pose, Rotation, StampedPose, Tangent, Vec3};
use i2slam::radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Shape};
use i2slam::radiance::hashgrid::{
    FieldSettings, HashGridField, HashGridMap, MarchSettings, Occupancy, OccupancySettings,
};
use i2slam::{Convergence, FrameEstimate, Losses, Map, Reconstruction};
use i2slam_check::TemporaryFolder;
use i2slam_storage::{Claim, OutputFolder};
use std::fs;

/// Frames along an arc, three response curves, a few Gaussians.
pub(crate) fn example(frames: usize) -> Reconstruction {
    let pose = |t: f64| {
        let turn = Vec3::new(0.1 * t.sin(), 0.3 * t, -0.05 * t);
        Pose::new(Rotation::exp(turn), Vec3::new(t.sin(), 0.1 * t, 0.4 * t.cos()))
    };
    let frame = |i: usize| {
        let t = i as f64 / 30.0;
        let tone = FrameTone::from_array([0.2 * t as f32, 0.01, 0.0, -0.02 * t as f32]);
        FrameEstimate {
            index: 2 * i,
            timestamp: 1_305_031_237.361_618 + t,
            shutter: ShutterPoses { start: pose(t - 0.01), end: pose(t + 0.01) },
            readout: 0.7 + 0.1 * t,
            depth_offset: Tangent::from_array([0.001 * t, 0.0, 0.002, 0.0, -0.003, 1e-9]),
            tone,
            response: 0,
            keyframe: i.is_multiple_of(5),
            held_out: i == 4,
            tracked: i != 3,
            refined: true,
            losses: Losses { image: 0.02 + 0.01 * t.cos(), depth: 0.004, trajectory: 1e-5 * t },
            convergence: Convergence {
                converged: i != 2,
                iterations: 20 + i,
                position_deviation: (i > 0).then_some(1e-4),
                rotation_deviation: (i > 0).then_some(2.5e-5),
            },
            blur_length: 3.0 + 2.0 * (2.0 * t).sin(),
            tracking_seconds: 0.25,
            mapping_seconds: 0.125,
            gaussians: 1000 + i,
        }
    };
    let mut response = CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Power(2.2));
    response.nodes[1][40] += 0.01;
    let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
    for i in 0..7 {
        let v = i as f32 * 0.37;
        map.push(Gaussian {
            mean: [v, -v, 1.0 + v],
            log_scale: [-4.0 - v, -3.0, -5.0],
            rotation: [1.0, v, 0.2, 0.0],
            opacity_logit: v - 1.0,
            colour: [-v, 0.3, 1e-20],
        });
    }
    Reconstruction {
        config: Config::preset("default").expect("a preset"),
        camera: Camera { width: 64, height: 48, fx: 60.1, fy: 59.9, cx: 32.2, cy: 24.7 },
        online_trajectory: (frames / 2..frames)
            .map(|i| {
                let (timestamp, world_from_camera) = (frame(i).timestamp, frame(i).middle());
                StampedPose { timestamp, world_from_camera }
            })
            .collect(),
        frames: (0..frames).map(frame).collect(),
        map: Map::Gaussians(map),
        responses: vec![response],
        vignetting: Vignetting { coefficients: [-0.2, -0.3, 0.1] },
        rolling_shutter_readout: 0.0123,
        unit_of_length: UnitOfLength::Keyframes,
    }
}

/// Opens a folder of a result, whatever it holds.
fn output(path: &std::path::Path) -> OutputFolder {
    let claim = Claim { command: "i2slam run", names: NAMES, overwrite: true };
    OutputFolder::replace(path, claim).expect("a folder")
}

/// Saves a reconstruction.
fn saved(path: &std::path::Path, reconstruction: &Reconstruction) {
    let mut folder = output(path);
    assert!(save(&folder, reconstruction, &FrameFiles::default()).is_empty());
    folder.commit().expect("room");
}

#[test]
fn a_response_that_was_found_loads_with_the_curve_it_began_with() {
    let scratch = TemporaryFolder::new("found-response");
    let mut before = example(2);
    let begun = (0..NODES).map(|i| (i as f64 / 255.0).powf(1.3)).collect();
    let spacing = NodeSpacing::Power(4.5);
    let mut found = CameraResponse::of_nodes(vec![begun; 3], StartCurve::Shoulder, spacing);
    found.nodes[1][70] += 0.01;
    before.responses = vec![found];
    saved(&scratch.0, &before);
    assert_eq!(load(&scratch.0).expect("a result").responses, before.responses);
}

#[test]
fn a_saved_folder_loads_as_it_was() {
    let scratch = TemporaryFolder::new("load");
    let before = example(6);
    saved(&scratch.0, &before);
    let after = load(&scratch.0).expect("a result");
    assert_eq!(after.map, before.map);
    assert_eq!(after.camera, before.camera);
    assert_eq!(after.responses, before.responses);
    assert_eq!(after.config, before.config);
    assert_eq!(after.online_trajectory.len(), 3);
    for (a, b) in after.online_trajectory.iter().zip(&before.online_trajectory) {
        let off = a.world_from_camera.local(b.world_from_camera).to_array();
        assert!(off.iter().all(|v| v.abs() < 1e-7), "{a:?} {b:?}");
    }
    assert_eq!(after.rolling_shutter_readout, before.rolling_shutter_readout);
    for (a, b) in after.frames.iter().zip(&before.frames) {
        assert_eq!((a.shutter, a.tone, a.losses), (b.shutter, b.tone, b.losses));
        assert_eq!(a.refined, b.refined);
        let rest = |f: &FrameEstimate| (f.depth_offset, f.held_out, f.readout);
        assert_eq!(rest(a), rest(b));
        let (found, kept) = (a.convergence, b.convergence);
        assert_eq!(found.converged, kept.converged);
        assert_eq!(
            (found.iterations, found.position_deviation),
            (kept.iterations, kept.position_deviation)
        );
        let [found, kept] = [found, kept].map(|c| c.rotation_deviation);
        assert_eq!(found.is_some(), kept.is_some());
        let off = found.zip(kept).map_or(0.0, |(a, b)| (a / b - 1.0).abs());
        assert!(off < 1e-12, "{found:?} {kept:?}");
        assert_eq!((a.index, a.timestamp, a.blur_length), (b.index, b.timestamp, b.blur_length));
        assert_eq!((a.keyframe, a.tracked, a.gaussians), (b.keyframe, b.tracked, b.gaussians));
    }
}

#[test]
fn a_field_is_saved_and_loaded() {
    let settings = FieldSettings { levels: 2, log2_table: 6, ..FieldSettings::cube([0.1; 3], 1.5) };
    let occupancy = OccupancySettings { resolution: 8, ..OccupancySettings::default() };
    let field = HashGridMap {
        field: HashGridField::new(settings, 1).expect("settings in range"),
        occupancy: Occupancy::empty(occupancy),
        march: MarchSettings::cube(1.5),
    };
    let scratch = TemporaryFolder::new("field");
    saved(&scratch.0, &example(2));
    assert!(scratch.0.join("map.ply").exists());
    let before = Reconstruction { map: Map::HashGrid(Box::new(field)), ..example(2) };
    saved(&scratch.0, &before);
    assert!(!scratch.0.join("map.ply").exists());
    let after = load(&scratch.0).expect("a result");
    assert_eq!(after.map, before.map);
    assert_eq!(after.viewer().depth(Pose::identity()).data, vec![0.0; 64 * 48]);
}

/// `config.toml` as it was written when every parameter was a setting.
const EARLIER_CONFIG: &str = include_str!("../tests/data/config-0.1.toml");

#[test]
fn a_result_with_settings_of_an_earlier_version_opens() {
    let scratch = TemporaryFolder::new("earlier");
    saved(&scratch.0, &example(2));
    let write = |text: &str| fs::write(scratch.join("config.toml"), text).expect("room");
    write(EARLIER_CONFIG);
    let config = load(&scratch.0).expect("a result").config;
    assert_eq!((config.preset.as_str(), config.map.kind), ("default-rgb", MapKind::Gaussian));
    assert!(config.input.is_rolling());
    let unknown = EARLIER_CONFIG.replace("blur_model", "blur_modell");
    assert_ne!(unknown, EARLIER_CONFIG);
    write(&unknown);
    let message = load(&scratch.0).expect_err("no such setting").to_string();
    assert!(message.contains("config.toml") && message.contains("blur_modell"), "{message}");
}

#[test]
fn damage_is_named() {
    let scratch = TemporaryFolder::new("damage");
    saved(&scratch.0, &example(4));
    let refusal = |file: &str, content: &[u8]| {
        let path = scratch.0.join(file);
        let good = fs::read(&path).expect("a file");
        fs::write(&path, content).expect("room");
        let message = load(&scratch.0).expect_err("damage").to_string();
        fs::write(&path, good).expect("room");
        assert!(message.contains(file), "{message}");
        message
    };
    assert!(refusal("map.i2slam", b"ply\n").contains("not an i2slam file"));
    assert!(refusal("frames.csv", b"index,time\n").contains("column names"));
    assert!(refusal("trajectory_shutter.txt", b"0 1 2 nan\n").contains("line 1"));
    assert!(refusal("trajectory_online.txt", b"0 1 2 nan\n").contains("1"));
    assert!(refusal("camera.json", b"{}").contains("width"));
    assert!(refusal("state.json", b"{\"format\":9,\"responses\":[]}").contains("format 9"));
    fs::remove_file(scratch.0.join("map.i2slam")).expect("a file");
    let message = load(&scratch.0).expect_err("no map").to_string();
    assert!(message.contains("map.i2slam") && message.contains("no such file"), "{message}");
}

#[test]
fn a_file_in_the_way_does_not_lose_the_result() {
    let scratch = TemporaryFolder::new("order");
    let mut folder = output(&scratch.join("out"));
    assert!(save(&folder, &example(6), &FrameFiles::default()).is_empty());
    fs::write(scratch.join("out/state.json"), "mine").expect("a file in the way");
    let message = folder.commit_or_save().expect_err("in the way").to_string();
    assert!(message.contains("state.json") && message.contains("out-partial"), "{message}");
    assert_eq!(load(&scratch.join("out-partial")).expect("a result").frames.len(), 6);
    assert_eq!(fs::read_to_string(scratch.join("out/state.json")).ok().as_deref(), Some("mine"));
}

#[test]
fn renders_are_removed_and_files_of_the_user_stay() {
    let scratch = TemporaryFolder::new("renders");
    let mut folder = output(&scratch.0);
    let image = i2slam::geometry::Image::new(8, 6, 3);
    for kind in RenderKind::ALL {
        save_render(&folder, "renders", kind, 12, &image).expect("room");
    }
    for parent in ["renders/optimised", "views"] {
        save_render(&folder, parent, RenderKind::Sharp, 3, &image).expect("room");
    }
    folder.write_text("views/poses.txt", "").expect("room");
    folder.commit().expect("room");
    drop(folder);
    assert!(scratch.join("renders/hdr/000012.exr").exists());
    fs::write(scratch.join("renders/sharp/notes.txt"), "mine").expect("room");
    remove_renders(&scratch.0).expect("removal");
    assert!(!scratch.join("renders/hdr").exists() && !scratch.join("views").exists());
    assert!(!scratch.join("renders/sharp/000012.png").exists());
    assert!(!scratch.join("renders/optimised").exists());
    assert!(scratch.join("renders/sharp/notes.txt").exists());
}

#[test]
fn an_empty_reconstruction_is_saved_and_loaded() {
    let scratch = TemporaryFolder::new("empty");
    let mut nothing = example(0);
    if let Map::Gaussians(map) = &mut nothing.map {
        map.retain(&[false; 7]);
    }
    let mut folder = output(&scratch.0);
    assert!(save(&folder, &nothing, &FrameFiles::default()).is_empty());
    assert!(save_metrics(&folder, &Metrics::of(&nothing)).is_ok());
    folder.commit().expect("room");
    let loaded = load(&scratch.0).expect("a result");
    assert!(loaded.frames.is_empty() && loaded.map.gaussians() == 0);
}

#[test]
fn viewers_get_display_colours() {
    let mut reconstruction = example(5);
    let Map::Gaussians(gaussians) = reconstruction.map.clone() else { panic!("Gaussians") };
    let radiance = gaussians.activation.radiance(gaussians.colours[0]);
    let (tone, curve) = reconstruction.typical_tone().expect("a tone");
    let expected = curve.evaluate(0, tone.gains()[0] * radiance[0]).clamp(0.0, 1.0);
    let dc = |reconstruction: &Reconstruction| {
        let mut bytes = Vec::new();
        let display = Display::Formed(reconstruction.typical_tone());
        ply::write(&mut bytes, &splats(&gaussians, &display, Pose::identity()), None)
            .expect("memory");
        let start = bytes.len() - 7 * 17 * 4 + 6 * 4;
        f32::from_le_bytes([bytes[start], bytes[start + 1], bytes[start + 2], bytes[start + 3]])
    };
    assert!((dc(&reconstruction) * 0.282_094_8 + 0.5 - expected).abs() < 1e-6);
    reconstruction.config.formation.tone = false;
    assert!((dc(&reconstruction) * 0.282_094_8 + 0.5 - radiance[0].min(1.0)).abs() < 1e-6);
}
