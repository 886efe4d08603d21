//! Arrays of DROID-SLAM and NeRF-SLAM.

use super::assert_same;
use super::scene::{HEIGHT, WIDTH, camera, look, pose, render, sequence, stamp};
use crate::support::{Folder, assert_says, assert_warns, import, zip};
use i2slam_dataset::OpenOptions;
use i2slam_dataset::import::{ImportDepth, ImportFormat, ImportOptions, ImportedKeyframes};
use i2slam_geometry::Vec3;

/// Arrays by name.
pub(super) type Members = Vec<(&'static str, Vec<u8>)>;

/// DROID-SLAM's intrinsics of the scene: an eighth, pixel centres at integers.
pub(super) fn intrinsics() -> [f64; 4] {
    [40.0, 40.0, 23.5, 15.5].map(|v| v / 8.0)
}

/// Arrays of DROID-SLAM for some frames.
pub(super) fn members(frames: &[usize]) -> Members {
    let count = frames.len();
    let (mut poses, mut images, mut disps) = (Vec::new(), Vec::new(), Vec::new());
    for &i in frames {
        let camera_from_world = pose(i).inverse();
        let (t, q) = (camera_from_world.translation, camera_from_world.rotation);
        poses.extend([t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w]);
        let (depth, colour) = render(i);
        disps.extend(depth.iter().map(|z| z.recip()));
        for channel in [2, 1, 0] {
            images.extend(colour.chunks(3).map(|pixel| f64::from(pixel[channel])));
        }
    }
    let intrinsics: Vec<f64> = frames.iter().flat_map(|_| intrinsics()).collect();
    let stamps: Vec<f64> = frames.iter().map(|&i| i as f64).collect();
    vec![
        ("tstamps", npy("<f4", &[count], &stamps)),
        ("images", npy("|u1", &[count, 3, HEIGHT, WIDTH], &images)),
        ("disps", npy("<f4", &[count, HEIGHT, WIDTH], &disps)),
        ("poses", npy("<f4", &[count, 7], &poses)),
        ("intrinsics", npy("<f4", &[count, 4], &intrinsics)),
    ]
}

/// The members with one of them replaced, or added.
pub(super) fn with(mut members: Members, name: &'static str, bytes: Vec<u8>) -> Members {
    members.retain(|member| member.0 != name);
    members.push((name, bytes));
    members
}

fn without(mut members: Members, name: &str) -> Members {
    members.retain(|member| member.0 != name);
    members
}

pub(super) fn folder(members: &Members) -> Folder {
    let folder = Folder::new();
    for (name, bytes) in members {
        folder.write(&format!("{name}.npy"), bytes);
    }
    folder
}

#[test]
fn a_folder_of_arrays_gives_pictures_poses_and_depth() {
    let folder = folder(&members(&[0, 2, 3]));
    let files = import(&folder).expect("opens");
    assert_eq!((files.format, files.len()), (ImportFormat::Droid, 3));
    assert_eq!((files.has_depth, files.has_variance), (true, false));
    assert!(files.warnings.is_empty(), "{:?}", files.warnings);
    assert_eq!(files.camera, camera());
    let keyframe = files.load(1).expect("loads");
    assert_eq!((keyframe.index, keyframe.timestamp), (2, 2.0 / 30.0));
    assert_same(keyframe.world_from_camera, pose(2));
    let (depth, colour) = render(2);
    let at = 9 * WIDTH + 17;
    for channel in 0..3 {
        let due = f32::from(colour[3 * at + channel]) / 255.0;
        assert_eq!(keyframe.colour.plane(channel)[at], due);
    }
    let found = keyframe.depth.expect("depth");
    let apart = found.data.iter().zip(&depth).map(|(a, b)| (f64::from(*a) - b).abs());
    assert!(apart.fold(0.0, f64::max) < 1e-5);
    assert!(keyframe.variance.is_none());
}

#[test]
fn channels_are_in_the_order_of_the_program_that_names_them() {
    let mut nerf_slam = members(&[0, 1]);
    nerf_slam[1].0 = "cam0_images";
    for (members, arrays_are_rgb, red) in [
        (members(&[0, 1]), None, 0),
        (members(&[0, 1]), Some(true), 2),
        (nerf_slam.clone(), None, 2),
        (nerf_slam, Some(false), 0),
    ] {
        let options = ImportOptions { arrays_are_rgb, ..ImportOptions::default() };
        let arrays = folder(&members);
        let files = ImportedKeyframes::open(&arrays.0, None, &options).expect("opens");
        let colour = files.load(0).expect("loads").colour;
        let due = f32::from(render(0).1[3 * 77]) / 255.0;
        assert_eq!(colour.plane(red)[77], due);
    }
}

#[test]
fn archives_hold_the_same() {
    let members = members(&[0, 1, 4]);
    let folder = folder(&members);
    let of_folder = import(&folder).expect("opens");
    for deflate in [false, true] {
        let file = folder.write("run.npz", npz(&members, deflate));
        let files = import(&file).expect("opens");
        assert_eq!(files.keyframes, of_folder.keyframes);
        for place in 0..3 {
            assert_eq!(files.load(place).expect("loads"), of_folder.load(place).expect("loads"));
        }
    }
}

#[test]
fn inverse_depth_of_an_eighth_is_looked_up_along_its_rays() {
    let [fx, fy, cx, cy] = intrinsics();
    let (width, height) = (WIDTH / 8, HEIGHT / 8);
    let mut disps = Vec::new();
    for i in [0, 1] {
        for pixel in 0..width * height {
            let (x, y) = ((pixel % width) as f64, (pixel / width) as f64);
            disps.push(look(i, Vec3::new((x - cx) / fx, (y - cy) / fy, 1.0)).0.recip());
        }
    }
    let small = npy("<f4", &[2, height, width], &disps);
    let folder = folder(&with(members(&[0, 1]), "disps", small));
    let files = import(&folder).expect("opens");
    let depth = files.load(1).expect("loads").depth.expect("depth");
    assert_eq!((depth.width, depth.height), (WIDTH, HEIGHT));
    let exact = |&(place, z): &(usize, &f64)| (f64::from(depth.data[place]) / z - 1.0).abs() < 1e-5;
    // The room has few walls in view; between two of them, and beside the border, it is no plane.
    let truth = render(1).0;
    let share = truth.iter().enumerate().filter(exact).count() as f64 / truth.len() as f64;
    assert!(share > 0.5, "{share}");
    assert!(depth.data.iter().all(|&z| z > 0.0));
}

#[test]
fn variances_of_depth_and_of_inverse_depth_agree() {
    let count = WIDTH * HEIGHT;
    let flat = npy("<f4", &[2, HEIGHT, WIDTH], &vec![4e-4; 2 * count]);
    let of_depth: Vec<f64> =
        [0, 1].iter().flat_map(|&i| render(i).0).map(|z| 4e-4 * z.powi(4)).collect();
    let of_depth = npy("<f8", &[2, HEIGHT, WIDTH], &of_depth);
    let variance = |name, bytes: &Vec<u8>| {
        let folder = folder(&with(members(&[0, 1]), name, bytes.clone()));
        let files = import(&folder).expect("opens");
        assert!(files.has_variance);
        files.load(1).expect("loads").variance.expect("variance")
    };
    let (a, b) = (variance("disps_cov", &flat), variance("depths_cov", &of_depth));
    for ((a, b), z) in a.data.iter().zip(&b.data).zip(render(1).0) {
        let due = 4e-4 * z.powi(4);
        assert!((f64::from(*a) / due - 1.0).abs() < 1e-4, "{a} {due}");
        assert!((f64::from(*b) / due - 1.0).abs() < 1e-4, "{b} {due}");
    }
}

#[test]
fn pictures_of_a_sequence_are_found_by_time_and_by_number() {
    let sequence = sequence(7);
    let frames = [0, 2, 6];
    let times: Vec<f64> = frames.iter().map(|&i| stamp(i)).collect();
    let halves: Vec<f64> = frames.iter().map(|&i| (i / 2) as f64).collect();
    let by_time = with(members(&frames), "tstamps", npy("<f8", &[3], &times));
    let by_half = with(members(&frames), "tstamps", npy("<i8", &[3], &halves));
    for (members, frames_per_stamp) in [(by_time, 1), (members(&frames), 1), (by_half, 2)] {
        let open = OpenOptions { scale: 0.5, ..OpenOptions::default() };
        let options = ImportOptions { open, frames_per_stamp, ..ImportOptions::default() };
        let arrays = folder(&members);
        let files = ImportedKeyframes::open(&arrays.0, Some(&sequence.0), &options).expect("opens");
        let indices: Vec<usize> = files.keyframes.iter().map(|keyframe| keyframe.index).collect();
        assert_eq!(indices, frames);
        let keyframe = files.load(2).expect("loads");
        assert_eq!((keyframe.timestamp, keyframe.colour.width), (stamp(6), WIDTH / 2));
        let depth = keyframe.depth.expect("depth");
        let (u, v) = (10.0 * 2.0 + 1.0, 5.0 * 2.0 + 1.0);
        let due = look(6, camera().unproject(u, v, 1.0)).0;
        assert!((f64::from(depth.at(0, 10, 5)) / due - 1.0).abs() < 1e-4);
        let options = ImportOptions { depth: ImportDepth::Pictures, ..options };
        let files = ImportedKeyframes::open(&arrays.0, Some(&sequence.0), &options).expect("opens");
        let measured = files.load(2).expect("loads").depth.expect("depth");
        assert!((f64::from(measured.at(0, 10, 5)) / due - 1.0).abs() < 0.02);
    }
    let far = with(members(&frames), "tstamps", npy("<i8", &[3], &[0.0, 1.0, 70.0]));
    let files =
        ImportedKeyframes::open(&folder(&far).0, Some(&sequence.0), &ImportOptions::default());
    assert_warns(&files.expect("opens").warnings, &["1 of 3 poses left out", "of its number"]);
    let none = with(members(&frames), "tstamps", npy("<i8", &[3], &[50.0, 60.0, 70.0]));
    let files =
        ImportedKeyframes::open(&folder(&none).0, Some(&sequence.0), &ImportOptions::default());
    assert_says(files, &["0 of 3 poses", "up to 70", "7 pictures", "stride"]);
}

#[test]
fn places_of_arrays_that_hold_nothing_are_left_out() {
    let frames = [1, 2, 4, 0, 0];
    let stamps = npy("<f4", &[5], &[1.0, 2.0, 4.0, 0.0, 0.0]);
    let mut unused = with(members(&frames), "tstamps", stamps);
    let poses = unused.iter_mut().find(|member| member.0 == "poses").expect("poses");
    let end = poses.1.len();
    // No pose at all, as in a buffer of zeros.
    poses.1[end - 2 * 28..].fill(0);
    let arrays = folder(&unused);
    let files = import(&arrays).expect("opens");
    let indices: Vec<usize> = files.keyframes.iter().map(|keyframe| keyframe.index).collect();
    assert_eq!(indices, [1, 2, 4]);
    assert_warns(&files.warnings, &["2 of 5 places", "repeat"]);
    assert_same(files.load(2).expect("loads").world_from_camera, pose(4));
    let again = with(members(&[0, 1, 3]), "tstamps", npy("<f4", &[3], &[0.0, 1.0, 1.0]));
    let files = import(&folder(&again)).expect("opens");
    assert_eq!((files.len(), files.keyframes[1].index), (2, 1));
}

#[test]
fn cut_off_archives_are_refused_wherever_they_end() {
    let members = members(&[0, 1]);
    let folder = Folder::new();
    for deflate in [false, true] {
        let whole = npz(&members, deflate);
        for cut in [0, 10, whole.len() / 3, whole.len() - 200, whole.len() - 1] {
            let file = folder.write("run.npz", &whole[..cut]);
            assert_says(import(&file), &["run.npz", "cut off"]);
        }
    }
}

#[test]
fn a_damaged_member_is_refused() {
    let folder = Folder::new();
    let refused = |bytes: &[u8]| {
        let file = folder.write("run.npz", bytes);
        assert_says(import(&file), &["run.npz/disps.npy", "damaged"]);
    };
    for deflate in [false, true] {
        let mut bytes = npz(&members(&[0, 1]), deflate);
        let place = bytes.windows(9).position(|word| word == b"disps.npy").expect("a member");
        bytes[place + 200] ^= 0x55;
        refused(&bytes);
    }
    // A stored member whose size is not the room that it takes.
    let mut bytes = npz(&members(&[0, 1]), false);
    let place = bytes.windows(9).rposition(|word| word == b"disps.npy").expect("a member");
    bytes[place - 46 + 26] ^= 1;
    refused(&bytes);
}

#[test]
fn arrays_that_claim_more_than_a_run_has_are_refused() {
    let scratch = Folder::new();
    let refused = |members: &Members, parts: &[&str]| {
        let file = scratch.write("run.npz", npz(members, true));
        assert_says(import(&file), parts);
    };
    let all = members(&[0, 1]);
    // Bytes behind the array, which the archive inflates to.
    let mut poses = all[3].1.clone();
    poses.resize(1 << 20, 0);
    refused(
        &with(all.clone(), "poses", poses),
        &["run.npz/poses.npy", "more bytes than its shape"],
    );
    // As many poses as its bytes hold, and more than a run of a year has.
    let many = npy("|u1", &[5_000_000, 7], &[0.0; 35_000_000]);
    let many = with(without(all.clone(), "tstamps"), "poses", many);
    refused(&many, &["poses.npy", "[5000000, 7]", "expected at most"]);
    // A size that the packed bytes cannot inflate to.
    let mut claims = npz(&all, true);
    let place = claims.windows(9).rposition(|word| word == b"poses.npy").expect("a member");
    claims[place - 22..place - 18].copy_from_slice(&0xf000_0000_u32.to_le_bytes());
    assert_says(import(&scratch.write("run.npz", claims)), &["run.npz/poses.npy", "damaged"]);
    // Pictures of 48 megapixels, of which no byte is on the disk.
    let arrays = folder(&with(all, "images", npy("|u1", &[2, 3, 6000, 8000], &[])));
    let images = std::fs::File::options().write(true).open(arrays.join("images.npy"));
    images.expect("a file").set_len(1 << 30).expect("room for nothing");
    assert_says(import(&arrays), &["images.npy", "144000000 numbers in a frame"]);
}

#[test]
fn unusable_arrays_are_named() {
    let all = members(&[0, 1]);
    let poses = |second: [f64; 7]| {
        npy("<f8", &[2, 7], &[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], second].concat())
    };
    let not_finite = poses([0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let long = poses([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5]);
    let camera = npy("<f8", &[4], &[40.0, 40.0, 400.0, 300.0]);
    let stamps = npy("<f8", &[2], &[0.0, f64::NAN]);
    let zeros = |shape: &[usize]| npy("<f4", shape, &vec![0.0; shape.iter().product()]);
    for (name, bytes, parts) in [
        ("poses", zeros(&[0, 7]), &["poses.npy is empty", "keyframes"][..]),
        ("poses", zeros(&[2, 4, 4]), &["poses.npy", "[2, 4, 4]", "expected [frames, 7]"]),
        ("poses", zeros(&[2, 7]), &["poses.npy", "frame 0", "length 0.000"]),
        ("poses", not_finite, &["poses.npy", "frame 1", "not finite"]),
        ("poses", long, &["poses.npy", "frame 1", "length 1.500", "expected 1"]),
        ("poses", b"hello".to_vec(), &["poses.npy", "no array of numpy"]),
        ("disps", zeros(&[3, 4, 6]), &["disps.npy", "[3, 4, 6]", "[2, height, width]"]),
        ("images", zeros(&[2, HEIGHT, WIDTH]), &["images.npy", "3, height, width"]),
        ("images", zeros(&[2, 3, HEIGHT, WIDTH]), &["images.npy", "F32", "expected U8"]),
        ("disps_cov", zeros(&[2, 4, 6]), &["disps_cov.npy", "expected [2, 32, 48]"]),
        ("tstamps", zeros(&[5]), &["tstamps.npy", "[5]"]),
        ("tstamps", stamps, &["tstamps.npy", "frame 1", "NaN"]),
        ("intrinsics", zeros(&[2, 3]), &["intrinsics.npy", "[2, 4]"]),
        ("intrinsics", camera, &["intrinsics.npy", "principal point", "48x32"]),
    ] {
        assert_says(import(&folder(&with(all.clone(), name, bytes))), parts);
    }
    for cut in [7, 9, 40, all[3].1.len() - 1] {
        let arrays = folder(&with(all.clone(), "poses", all[3].1[..cut].to_vec()));
        assert_says(import(&arrays), &["poses.npy", "cut off"]);
    }
    for (name, parts) in [
        ("images", &["no array images", "disps.npy"][..]),
        ("intrinsics", &["no array intrinsics"]),
    ] {
        assert_says(import(&folder(&without(all.clone(), name))), parts);
    }
    let options = ImportOptions { depth: ImportDepth::Pictures, ..ImportOptions::default() };
    assert_says(
        ImportedKeyframes::open(&folder(&all).0, None, &options),
        &["option depth", "no dataset"],
    );
    let alone = import(&folder(&without(all, "disps"))).expect("poses and pictures alone");
    assert!(!alone.has_depth);
    assert_says(import(&folder(&members(&[0]))), &["1 of 1 poses", "at least 2"]);
}

/// An `.npy` file of numbers of a type such as `<f4`.
pub(super) fn npy(descr: &str, shape: &[usize], numbers: &[f64]) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(|side| format!("{side},")).collect();
    let shape = sides.join(" ");
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for &number in numbers {
        match descr {
            "|u1" => bytes.push(number as u8),
            "<i8" => bytes.extend((number as i64).to_le_bytes()),
            "<f8" => bytes.extend(number.to_le_bytes()),
            _ => bytes.extend((number as f32).to_le_bytes()),
        }
    }
    bytes
}

/// An archive of arrays, stored or deflated, as `np.savez` and `np.savez_compressed` write it.
pub(super) fn npz(members: &[(&str, Vec<u8>)], deflate: bool) -> Vec<u8> {
    let named = |(name, bytes): &(&str, Vec<u8>)| (format!("{name}.npy"), bytes.clone());
    zip(&members.iter().map(named).collect::<Vec<_>>(), deflate)
}
