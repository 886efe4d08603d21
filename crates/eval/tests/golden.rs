//! Metrics against the public tools: `golden/README.md` says how the numbers were made.

use i2slam_eval::EvalError;
use i2slam_eval::image::{lpips, ms_ssim, psnr, psnr_channel_mean, ssim, ssim_padded};
use i2slam_eval::sharpness::laplacian_variance;
use i2slam_eval::trajectory::{
    Alignment, DEFAULT_TOLERANCE, RelativePoseError, Step, TrajectoryError,
    absolute_trajectory_error, relative_pose_error,
};
use i2slam_geometry::{Image, Pose, Rotation, StampedPose, Vec3};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

type Numbers = BTreeMap<String, f64>;

fn numbers(name: &str) -> Numbers {
    let text = read(&golden(name));
    let pairs = text.lines().filter_map(|l| l.split_once(' '));
    pairs.map(|(k, v)| (k.to_owned(), v.parse().unwrap())).collect()
}

/// A TUM trajectory file: stamp, position, quaternion x y z w.
fn poses(path: &Path) -> Vec<StampedPose> {
    let text = read(path);
    let lines = text.lines().filter(|l| !l.starts_with('#') && !l.trim().is_empty());
    lines
        .map(|line| {
            let v: Vec<f64> = line.split_whitespace().map(|w| w.parse().unwrap()).collect();
            let rotation = Rotation::from_wxyz(v[7], v[4], v[5], v[6]).unwrap();
            let world_from_camera = Pose::new(rotation, Vec3::new(v[1], v[2], v[3]));
            StampedPose { timestamp: v[0], world_from_camera }
        })
        .collect()
}

/// Metrics of this crate under the names of the golden files.
fn metrics(estimate: &[StampedPose], truth: &[StampedPose]) -> Result<Numbers, EvalError> {
    let mut table = Numbers::new();
    let mut put = |group: &str, values: &[(&str, f64)]| {
        for (key, value) in values {
            table.insert(format!("{group}_{key}"), *value);
        }
    };
    let ate = |alignment| absolute_trajectory_error(estimate, truth, alignment, DEFAULT_TOLERANCE);
    for (group, alignment) in [("ape_se3", Alignment::Se3), ("ape_sim3", Alignment::Sim3)] {
        put(group, &absolute_values(&ate(alignment)?));
    }
    put("world_to_camera", &[("mean", ate(Alignment::Se3)?.splatam_mean_m)]);
    let steps = [
        ("rpe", Step::Frames(1)),
        ("rpe_5", Step::Frames(5)),
        ("rpe_5_all", Step::OverlappingFrames(5)),
        ("rpe_seconds", Step::Seconds(0.5)),
    ];
    for (group, step) in steps {
        let r = relative_pose_error(estimate, truth, step, DEFAULT_TOLERANCE)?;
        let [translation, rotation] = relative_values(&r);
        put(&format!("{group}_translation"), &translation);
        put(&format!("{group}_rotation"), &rotation);
    }
    Ok(table)
}

fn absolute_values(e: &TrajectoryError) -> [(&'static str, f64); 7] {
    [
        ("rmse", e.ate_rmse_m),
        ("mean", e.ate_mean_m),
        ("median", e.ate_median_m),
        ("max", e.ate_max_m),
        ("std", e.ate_std_m),
        ("count", e.pairs as f64),
        ("scale", e.scale),
    ]
}

fn relative_values(r: &RelativePoseError) -> [[(&'static str, f64); 5]; 2] {
    let steps = r.steps as f64;
    let translation = [
        ("rmse", r.rpe_translation_rmse_m),
        ("mean", r.rpe_translation_mean_m),
        ("median", r.rpe_translation_median_m),
        ("max", r.rpe_translation_max_m),
        ("count", steps),
    ];
    let rotation = [
        ("rmse", r.rpe_rotation_rmse_deg),
        ("mean", r.rpe_rotation_mean_deg),
        ("median", r.rpe_rotation_median_deg),
        ("max", r.rpe_rotation_max_deg),
        ("count", steps),
    ];
    [translation, rotation]
}

/// Every number on this side exists on the other and is within 1e-6.
#[track_caller]
fn assert_agree(actual: &Numbers, expected: &Numbers) {
    assert!(!actual.is_empty());
    for (key, value) in actual {
        let due = expected.get(key).unwrap_or_else(|| panic!("no golden number {key}"));
        assert!((value - due).abs() <= 1e-6, "{key}: {value} expected {due}");
    }
}

fn walk() -> (Vec<StampedPose>, Vec<StampedPose>) {
    (poses(&golden("walk_estimate.txt")), poses(&golden("walk_truth.txt")))
}

#[test]
fn walk_agrees_with_evo_also_where_the_estimate_has_more_poses() {
    let (estimate, truth) = walk();
    assert_agree(&metrics(&estimate, &truth).unwrap(), &numbers("walk.numbers"));
    assert_agree(&metrics(&truth, &estimate).unwrap(), &numbers("swapped.numbers"));
}

#[test]
#[ignore = "needs the sequence ../shared/data/tum_fr1_rpy_clip"]
fn clip_agrees_with_evo() {
    let shared = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");
    let truth = Path::new(shared).join("data/tum_fr1_rpy_clip/groundtruth.txt");
    let estimate = poses(&golden("clip_estimate.txt"));
    assert_agree(&metrics(&estimate, &poses(&truth)).unwrap(), &numbers("clip.numbers"));
}

#[test]
fn the_aligned_estimate_has_the_errors_that_are_reported() {
    let (estimate, truth) = walk();
    let e = absolute_trajectory_error(&estimate, &truth, Alignment::Sim3, 0.02).unwrap();
    assert_eq!(e.aligned_estimate.len(), estimate.len());
    for (pair, error) in e.associations.iter().zip(&e.errors_m) {
        let aligned = e.aligned_estimate[pair.estimate].world_from_camera.translation;
        let distance = (aligned - truth[pair.truth].world_from_camera.translation).norm();
        assert!((distance - error).abs() < 1e-12);
    }
}

#[test]
fn the_own_frame_of_the_estimate_does_not_matter() {
    let (estimate, truth) = walk();
    let other = Pose::new(Rotation::exp(Vec3::new(2.0, 0.1, -0.7)), Vec3::new(9.0, 1.0, 0.0));
    let moved: Vec<StampedPose> = estimate
        .iter()
        .map(|p| StampedPose { world_from_camera: other * p.world_from_camera, ..*p })
        .collect();
    let (here, there) = (metrics(&estimate, &truth).unwrap(), metrics(&moved, &truth).unwrap());
    assert_agree(&there, &here);
}

#[test]
fn the_truth_has_no_error() {
    let (_, truth) = walk();
    for (key, value) in metrics(&truth, &truth).unwrap() {
        let due = match key.as_str() {
            "ape_se3_scale" | "ape_sim3_scale" => 1.0,
            "ape_se3_count" | "ape_sim3_count" => truth.len() as f64,
            "rpe_translation_count" | "rpe_rotation_count" => truth.len() as f64 - 1.0,
            count if count.ends_with("count") => value,
            _ => 0.0,
        };
        assert!((value - due).abs() < 1e-6, "{key}: {value} expected {due}");
    }
}

#[test]
fn what_cannot_be_judged_is_an_error() {
    let (estimate, truth) = walk();
    let of = |estimate: &[StampedPose]| metrics(estimate, &truth);
    assert!(matches!(of(&[]), Err(EvalError::TooFew { found: 0, .. })));
    assert!(matches!(of(&estimate[..2]), Err(EvalError::TooFew { found: 2, .. })));
    let still = |p: &StampedPose| StampedPose { world_from_camera: Pose::identity(), ..*p };
    let frozen: Vec<StampedPose> = estimate.iter().map(still).collect();
    assert!(matches!(of(&frozen), Err(EvalError::Coincident { .. })));
    let late = |p: &StampedPose| StampedPose { timestamp: p.timestamp + 1000.0, ..*p };
    let error = of(&estimate.iter().map(late).collect::<Vec<_>>()).unwrap_err();
    assert!(matches!(error, EvalError::NoOverlap { .. }), "{error}");
    assert!(error.to_string().contains("the truth 100 to 103.9"), "{error}");
    let mut poisoned = estimate.clone();
    poisoned[3].world_from_camera.translation.y = f64::NAN;
    assert!(matches!(of(&poisoned), Err(EvalError::NotFinite { .. })));
}

#[test]
fn the_report_has_the_agreed_names() {
    let (estimate, truth) = walk();
    let e = absolute_trajectory_error(&estimate, &truth, Alignment::Se3, 0.02).unwrap();
    let json = serde_json::to_value(&e).unwrap();
    let names: Vec<&str> = json.as_object().unwrap().keys().map(String::as_str).collect();
    let mut due = vec!["alignment", "ate_max_m", "ate_mean_m", "ate_median_m", "ate_rmse_m"];
    due.extend(["ate_std_m", "pairs", "scale", "splatam_mean_m"]);
    assert_eq!(names, due);
    assert_eq!(json["alignment"], "se3");
}

/// The procedural picture of `make_pictures.py`.
fn picture([width, height]: [usize; 2], phase: f64) -> Image<f32> {
    Image::from_fn(width, height, 3, |c, column, row| {
        let (x, y) = (0.37 * column as f64 + 0.9 * c as f64 + phase, 0.23 * row as f64);
        let check = (column / 6 + row / 5 + c) % 2;
        (0.5 + 0.3 * x.sin() * (y - phase).cos() + 0.15 * check as f64) as f32
    })
}

/// Every golden number of these pictures is met.
#[track_caller]
fn assert_images_agree(name: &str, render: &Image<f32>, truth: &Image<f32>) {
    let due = numbers("pictures.numbers");
    let close = |key: &str, value: f64, tolerance: f64| {
        let due = due[&format!("{key}_{name}")];
        assert!((value - due).abs() < tolerance, "{key} {name}: {value} expected {due}");
    };
    let structural = ssim(render, truth).unwrap();
    close("ssim", structural, 1e-6);
    close("ssim_torch", structural, 1e-4);
    close("ssim_padded", ssim_padded(render, truth).unwrap(), 1e-6);
    close("laplacian_variance", laplacian_variance(render).unwrap(), 1e-9);
    close("lpips", lpips(render, truth).unwrap(), 1e-3);
    close("psnr", psnr(render, truth).unwrap(), 1e-4);
    close("psnr_channel_mean", psnr_channel_mean(render, truth).unwrap(), 1e-4);
    if due.contains_key(&format!("ms_ssim_{name}")) {
        close("ms_ssim", ms_ssim(render, truth).unwrap(), 1e-5);
    }
}

#[test]
fn procedural_pictures_agree() {
    for (prefix, size) in [("", [48, 37]), ("large_", [203, 166])] {
        for (name, phase) in [("near", 0.05), ("far", 0.8)] {
            assert_images_agree(
                &format!("{prefix}{name}"),
                &picture(size, phase),
                &picture(size, 0.0),
            );
        }
    }
}

/// An 8-bit PNG without alpha.
fn read_png(path: &Path) -> Image<f32> {
    let mut reader =
        png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let mut image = Image::new(info.width as usize, info.height as usize, 3);
    for c in 0..3 {
        let values = bytes.iter().skip(c).step_by(info.color_type.samples());
        for (out, &v) in image.plane_mut(c).iter_mut().zip(values) {
            *out = f32::from(v) / 255.0;
        }
    }
    image
}

#[test]
#[ignore = "needs the reference images of LPIPS in ../shared/weights/lpips_ref"]
fn the_reference_pictures_of_lpips_agree() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/weights/lpips_ref");
    let folder = Path::new(folder);
    let truth = read_png(&folder.join("ex_ref.png"));
    for (name, file) in [("p0", "ex_p0.png"), ("p1", "ex_p1.png")] {
        assert_images_agree(name, &read_png(&folder.join(file)), &truth);
    }
}
