//! Rendered sequences: reproducible, readable, and true to their own poses and exposures.

mod blender;
mod shipped;
mod support;

use i2slam_dataset::{Frame, OpenOptions, Sequence, read_trajectory};
use i2slam_geometry::{Camera, Pose};
use i2slam_synthetic::{Response, Spec, SyntheticError, synthesise};
use support::{Scratch, files, render, small_spec};

#[test]
fn one_seed_gives_the_same_bytes_with_any_number_of_threads() {
    let mut spec = small_spec();
    spec.camera.frames = 2;
    spec.camera.readout = 0.5;
    spec.white_balance.drift = 0.3;
    spec.depth.kinect = true;
    let with_threads = |threads: usize, name: &str, seed: u64| {
        let scratch = Scratch::new(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let spec = i2slam_synthetic::Spec { seed, ..spec.clone() };
        pool.install(|| render(&spec, &scratch.0));
        files(&scratch.0)
    };
    let first = with_threads(1, "one", 5);
    let second = with_threads(3, "three", 5);
    assert_eq!(first.len(), 2 * 4 + 9, "{:?}", first.keys());
    assert!(first == second, "files differ");
    assert!(with_threads(2, "other", 6) != first);
}

/// Without blur, noise and exposure changes the pictures are the sharp radiance of one exposure.
#[test]
fn depth_and_poses_carry_a_frame_onto_another() {
    let scratch = Scratch::new("warp");
    let mut spec = small_spec();
    spec.camera.sub_frames = 16;
    spec.exposure.automatic = false;
    (spec.exposure.shutter_minimum, spec.exposure.shutter_maximum) = (0.0, 0.0);
    (spec.noise.read, spec.noise.shot) = (0.0, 0.0);
    spec.camera.frame_rate = 12.0;
    render(&spec, &scratch.0);
    let sequence = Sequence::open(&scratch.0, &OpenOptions::default()).expect("a sequence");
    assert_eq!((sequence.len(), sequence.camera.width, sequence.camera.height), (7, 80, 60));
    assert!((sequence.frame_rate - 12.0).abs() < 1e-3);
    let poses = read_trajectory(sequence.ground_truth.as_ref().expect("poses")).expect("poses");
    let pose = |i: usize| poses[i].world_from_camera;
    for first in 0..2 {
        let [a, b] = [first, first + 5].map(|i| sequence.load(i).expect("a frame"));
        let b_from_a = pose(first + 5).inverse() * pose(first);
        let (right, overlap) = warp_error(&sequence.camera, &a, &b, b_from_a);
        let (wrong, _) = warp_error(&sequence.camera, &a, &b, b_from_a.inverse());
        let (none, _) = warp_error(&sequence.camera, &a, &b, Pose::identity());
        assert!(overlap > 0.4, "{overlap}");
        assert!(right < 0.035, "{right} {wrong} {none}");
        assert!(wrong > 2.5 * right && none > 2.0 * right, "{right} {wrong} {none}");
    }
}

/// Mean difference of colours over points that `b` sees too, and their share.
fn warp_error(camera: &Camera<f64>, a: &Frame, b: &Frame, b_from_a: Pose<f64>) -> (f64, f64) {
    let (mut sum, mut count) = (0.0, 0);
    let [from, to] = [a, b].map(|frame| frame.depth_image().expect("depth"));
    for pixel in 0..from.pixels() {
        let (column, row) = (pixel % from.width, pixel / from.width);
        let (u, v) = Camera::<f64>::pixel_centre(column, row);
        let z = f64::from(from.data[pixel]);
        let point = b_from_a * camera.unproject(u, v, z);
        if z <= 0.0 || point.z <= 0.1 {
            continue;
        }
        let (u, v) = camera.project(point);
        let Some(tap) = b.colour.tap(u as f32, v as f32) else { continue };
        let seen = f64::from(to.at(0, u as usize, v as usize));
        if (seen - point.z).abs() > 0.03 * point.z {
            continue;
        }
        for channel in 0..3 {
            let value = tap.sample(b.colour.plane(channel)).0;
            sum += f64::from((value - a.colour.plane(channel)[pixel]).abs()) / 3.0;
        }
        count += 1;
    }
    (sum / f64::from(count.max(1)), f64::from(count) / from.pixels() as f64)
}

#[test]
fn exposure_and_shutter_follow_the_rule_of_the_appendix() {
    let scratch = Scratch::new("exposure");
    let mut spec = small_spec();
    spec.exposure.smoothing = 1.0;
    (spec.noise.read, spec.noise.shot) = (0.0, 0.0);
    let summary = render(&spec, &scratch.0);
    assert!((summary.shutter[0] - 0.1).abs() < 1e-9 && (summary.shutter[1] - 1.0).abs() < 1e-9);
    let table = std::fs::read_to_string(scratch.0.join("exposure.csv")).expect("a table");
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    assert_eq!(rows.len(), 7);
    let sequence = Sequence::open(&scratch.0, &OpenOptions::default()).expect("a sequence");
    let text = std::fs::read_to_string(scratch.0.join("camera.json")).expect("a camera");
    let number = |key: &str| -> f64 {
        let after = text.split(&format!("\"{key}\": ")).nth(1).expect(key);
        after.split([',', '\n']).next().and_then(|v| v.parse().ok()).expect(key)
    };
    let (a, b) = (number("shutter_a"), number("shutter_b"));
    for (i, row) in rows.iter().enumerate() {
        assert!((row[3] - row[2].exp2()).abs() < 1e-5, "dt = 2^EV");
        assert!((row[4] - (a * row[2].exp2() + b)).abs() < 1e-5, "SV = a 2^EV + b");
        assert!((row[5] - row[4] / 30.0).abs() < 1e-6);
        // Blur moves the median a little.
        let grey = median_grey(&sequence.load(i).expect("a frame"));
        assert!((grey - 0.5).abs() < 0.03, "frame {i}: {grey}");
    }
}

/// Pictures are the radiance through lens, white balance, exposure and response; the table tells all.
#[test]
fn pictures_follow_from_radiance_and_the_table() {
    let scratch = Scratch::new("lens");
    let mut spec = small_spec();
    spec.camera.frames = 3;
    spec.lens.vignetting = [-0.3, -0.2, 0.1];
    (spec.white_balance.drift, spec.white_balance.period) = (0.5, 1.0);
    spec.exposure.response = Response::Srgb;
    (spec.exposure.shutter_minimum, spec.exposure.shutter_maximum) = (0.0, 0.0);
    (spec.noise.read, spec.noise.shot) = (0.0, 0.0);
    render(&spec, &scratch.0);
    let table = std::fs::read_to_string(scratch.0.join("exposure.csv")).expect("a table");
    assert!(
        table.starts_with("frame,") && table.contains(",vignetting_a,vignetting_b,"),
        "{table}"
    );
    let row: Vec<f64> =
        table.lines().nth(3).expect("frame 2").split(',').flat_map(str::parse).collect();
    assert_eq!(row[10..], [-0.3, -0.2, 0.1]);
    assert!(row[7] > 1.05 && row[9] < 0.95, "{row:?}");
    let open = |name: &str| std::fs::File::open(scratch.0.join(name)).expect("a file");
    let picture = |name: &str| {
        let mut decoder = png::Decoder::new(std::io::BufReader::new(open(name)));
        decoder.set_transformations(png::Transformations::IDENTITY);
        let mut bytes = vec![0; 80 * 60 * 3];
        decoder.read_info().and_then(|mut r| r.next_frame(&mut bytes)).expect("pixels");
        bytes.into_iter().map(|byte| f64::from(byte) / 255.0).collect::<Vec<f64>>()
    };
    let (sharp, taken) = (picture("sharp/000002.png"), picture("rgb/000002.png"));
    let radiance = exr::prelude::read_first_rgba_layer_from_file(
        scratch.0.join("hdr/000002.exr"),
        |size, _| vec![[0.0_f32; 3]; size.width() * size.height()],
        |pixels, at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * 80 + at.x()] = [r, g, b],
    );
    let radiance = radiance.expect("radiance").layer_data.channel_data.pixels;
    // Largest difference of the sharp picture; of the one taken, which has fewer samples a pixel, the
    // means near the corners, with lens and without.
    let (mut of_sharp, mut with_lens, mut without, mut count) = (0.0_f64, 0.0, 0.0, 0.0);
    for (i, colour) in radiance.iter().enumerate() {
        let (u, v) = ((i % 80) as f64 - 39.5, (i / 80) as f64 - 29.5);
        let factor = i2slam_synthetic::vignetting_at(&spec.lens, u.hypot(v) / 50.0);
        for channel in 0..3 {
            let at = 3 * i + channel;
            let lit = f64::from(colour[channel]) * row[3] * row[7 + channel];
            let [seen, lit] =
                [lit * factor, lit].map(|x| f64::from(Response::Srgb.apply(x as f32, channel)));
            of_sharp = of_sharp.max((lit - sharp[at]).abs());
            if u.hypot(v) > 35.0 {
                with_lens += seen - taken[at];
                without += lit - taken[at];
                count += 1.0;
            }
        }
    }
    assert!(of_sharp < 0.006, "{of_sharp}");
    let (with_lens, without) = (with_lens / count, without / count);
    assert!(with_lens.abs() < 0.005 && without > 0.03, "{with_lens} {without}");
}

/// The tone-mapped median of linear luminance.
fn median_grey(frame: &Frame) -> f64 {
    let response = Response::Reinhard;
    let planes = [0, 1, 2].map(|channel| frame.colour.plane(channel));
    let linear = |i: usize, channel: usize| response.invert(planes[channel][i], channel);
    let grey = |i| 0.2126 * linear(i, 0) + 0.7152 * linear(i, 1) + 0.0722 * linear(i, 2);
    let mut grey: Vec<f32> = (0..frame.colour.pixels()).map(grey).collect();
    grey.sort_by(f32::total_cmp);
    f64::from(response.apply(grey[grey.len() / 2], 1))
}

/// Clipped at the desk, blurred on the way, two stops darker where the camera turns to.
#[test]
fn the_camera_turns_away_from_a_bright_desk_with_every_seed() {
    for seed in [1, 2, 3] {
        let scratch = Scratch::new("turn-away");
        let mut spec = Spec { seed, ..Spec::shipped("turn-away").expect("a specification") };
        (spec.camera.width, spec.camera.height) = (48, 36);
        (spec.camera.sub_frames, spec.camera.sharp_samples) = (1, 1);
        (spec.light.texel, spec.output.hdr_every) = (0.2, 0);
        let summary = render(&spec, &scratch.0);
        let [low, high] = summary.exposure_values;
        // Coarse light evens the room out: in full size it is about two stops.
        assert!((1.4..2.6).contains(&(high - low)), "seed {seed}: {} stops", high - low);
        // 17 px in pictures of 320 px.
        let blur = 320.0 / 48.0 * summary.blur[2];
        assert!((14.0..22.0).contains(&blur), "seed {seed}: {blur} px");
        let sequence = Sequence::open(&scratch.0, &OpenOptions::default()).expect("a sequence");
        let white = |frame: usize| {
            let colour = sequence.load(frame).expect("a frame").colour;
            let green = colour.plane(1).iter().filter(|&&v| v > 0.995).count();
            green as f64 / colour.pixels() as f64
        };
        assert!(white(30) > 0.01, "seed {seed}: {} at the desk", white(30));
        let poses = sequence.true_trajectory().expect("poses");
        let turned = |a: usize, b: usize| {
            let step = poses[a].world_from_camera.local(poses[b].world_from_camera);
            step.rotation.norm().to_degrees()
        };
        assert!((turned(45, 70) - 70.0).abs() < 8.0 && turned(70, 79) < 6.0, "seed {seed}");
        assert!(turned(45, 104) < 8.0, "seed {seed}: back within two seconds");
    }
}

#[test]
fn a_run_can_be_ended_and_leaves_nothing() {
    let scratch = Scratch::new("ended");
    let mut calls = 0;
    let result = synthesise(&small_spec(), &scratch.0, false, &mut |_| {
        calls += 1;
        calls < 3
    });
    assert!(matches!(result, Err(SyntheticError::Interrupted)));
    assert!(!scratch.0.exists());
}
