//! Videos and streams whose second track is depth, made by ffmpeg.

use super::support::{CAMERA, Folder, HEIGHT, WIDTH, depth_png, png, rgb_png, shared_data};
use i2slam_compute::CancellationToken;
use i2slam_dataset::{DepthPairing, Frame, LiveSequence, OpenOptions, RecordedSequence, Sequence};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Output of a video for a pipe: ffmpeg recognises a container by its first 2048 bytes, which pictures
/// of FFV1 that are this small take long to fill.
const RAW: &str = "-c:v:0 rawvideo -pix_fmt:v:0 rgb24 -max_interleave_delta 1";

/// Interval of colour pictures that are written to a pipe one by one [s].
const INTERVAL: f64 = 0.2;

/// Depth of picture `i`: all that 16 bits can be, ends included.
fn depth_values(i: usize) -> Vec<u16> {
    let value = |at: usize| match at {
        0..3 => [65535, 0, 1][at],
        _ => ((at * 331 + i * 7919) % 65536) as u16,
    };
    (0..WIDTH * HEIGHT).map(value).collect()
}

/// A folder of `count` colour and depth pictures.
fn pictures(count: usize) -> Folder {
    let folder = Folder::new();
    for i in 0..count {
        folder.write(&format!("rgb/{i:03}.png"), rgb_png(WIDTH, HEIGHT, 60 + 5 * i as u8));
        let bytes: Vec<u8> = depth_values(i).iter().flat_map(|v| v.to_be_bytes()).collect();
        let (grey, bits) = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
        folder.write(&format!("depth/{i:03}.png"), png((WIDTH, HEIGHT), grey, bits, None, &bytes));
    }
    folder.write("camera.json", CAMERA);
    folder
}

fn ffmpeg(arguments: &str) {
    let mut ffmpeg = Command::new("ffmpeg");
    let ffmpeg = ffmpeg.args(["-v", "error", "-nostdin", "-y"]).args(arguments.split_whitespace());
    assert!(ffmpeg.status().expect("ffmpeg").success(), "{arguments}");
}

/// A video of both, with options for depth as input and for the output.
fn video(folder: &Folder, name: &str, (input, output): (&str, &str)) -> PathBuf {
    let (colour, depth, path) = (folder.join("rgb"), folder.join("depth"), folder.join(name));
    ffmpeg(&format!(
        "-framerate 10 -i {}/%03d.png {input} -i {}/%03d.png -map 0:v -map 1:v -fps_mode passthrough \
         -enc_time_base 1/1000 -c:v ffv1 {output} {}",
        colour.display(),
        depth.display(),
        path.display()
    ));
    path
}

/// Depth values as they are, for exact comparison.
fn options(folder: &Folder) -> OpenOptions {
    let camera = Some(folder.join("camera.json"));
    OpenOptions { camera, depth_scale: Some(1.0), ..OpenOptions::default() }
}

fn frames(sequence: &Sequence) -> Vec<Frame> {
    sequence.stream().map(|frame| frame.expect("a frame")).collect()
}

/// The depth picture that a frame got, by its values; -1 for none.
fn depth_of(frame: &Frame) -> i32 {
    let Some(depth) = frame.depth_image() else { return -1 };
    let found = (0..100).find(|i| {
        depth_values(*i).iter().zip(&depth.data).all(|(value, z)| f32::from(*value) == *z)
    });
    found.expect("the values as recorded") as i32
}

fn depth_stamps(frames: &[Frame]) -> Vec<f64> {
    frames.iter().filter_map(|frame| Some(frame.depth.as_ref()?.timestamp)).collect()
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_of_a_second_track_is_exact_and_has_its_own_times() {
    let folder = pictures(6);
    for (name, output) in [
        ("ffv1.mkv", ""),
        ("png.mkv", "-c:v:1 png"),
        ("le.nut", "-c:v:1 rawvideo -pix_fmt:v:1 gray16le"),
        ("be.nut", "-c:v:1 rawvideo -pix_fmt:v:1 gray16be"),
    ] {
        let output = format!("-filter:v:1 settb=1/1000,setpts=PTS+12 {output}");
        let path = video(&folder, name, ("-framerate 10", &output));
        let sequence = Sequence::open(&path, &options(&folder)).expect("a video");
        assert_eq!((sequence.len(), sequence.frames_with_depth()), (6, 6), "{name}");
        assert_eq!(sequence.layout_name(), "video");
        let frames = frames(&sequence);
        assert_eq!(frames.iter().map(depth_of).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5], "{name}");
        for (frame, depth) in frames.iter().zip(depth_stamps(&frames)) {
            assert!((depth - frame.timestamp - 0.012).abs() < 1.1e-3, "{depth}");
        }
        // Out of order.
        assert_eq!(depth_of(&sequence.load(1).expect("a frame")), 1);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_of_videos_is_in_millimetres_unless_a_camera_says_otherwise() {
    let folder = Folder::new();
    for i in 0..3 {
        folder.write(&format!("rgb/{i:03}.png"), rgb_png(WIDTH, HEIGHT, 90));
        folder.write(&format!("depth/{i:03}.png"), depth_png(WIDTH, HEIGHT, 2000));
    }
    let path = video(&folder, "a.mkv", ("-framerate 10", ""));
    let camera = folder.write("c.json", CAMERA.replace('}', r#","depth_scale":4000}"#));
    let colmap = folder.write("cameras.txt", "1 PINHOLE 16 12 14 14 8 6\n");
    let guessed = OpenOptions { guess_camera: true, ..OpenOptions::default() };
    for (options, metres) in [
        (guessed.clone(), 2.0),
        (OpenOptions { camera: Some(camera), ..OpenOptions::default() }, 0.5),
        (OpenOptions { camera: Some(colmap), ..OpenOptions::default() }, 2.0),
        (OpenOptions { depth_scale: Some(500.0), ..guessed.clone() }, 4.0),
        (OpenOptions { max_depth: Some(1.9), ..guessed }, 0.0),
    ] {
        let sequence = Sequence::open(&path, &options).expect("a video");
        let frame = sequence.load(2).expect("a frame");
        assert_eq!(frame.depth_image().expect("depth").data[7], metres);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn other_second_tracks_and_unwanted_depth_are_ignored() {
    let folder = pictures(4);
    let opened = |path: &Path, options: &OpenOptions| {
        let sequence = Sequence::open(path, options).expect("a video");
        assert_eq!((sequence.len(), sequence.warnings.as_slice()), (4, [].as_slice()), "{path:?}");
        assert!(frames(&sequence).iter().all(|frame| frame.depth.is_none()));
        sequence.frames_with_depth()
    };
    for (name, output) in [
        ("colour.mkv", "-pix_fmt:v:1 yuv420p"),
        ("grey.mkv", "-pix_fmt:v:1 gray"),
        ("deep.mkv", "-pix_fmt:v:1 gray12le"),
        ("mpeg.avi", "-c:v mpeg4 -pix_fmt yuv420p"),
    ] {
        let path = video(&folder, name, ("-framerate 10", output));
        assert_eq!(opened(&path, &options(&folder)), 0);
    }
    let path = video(&folder, "depth.mkv", ("-framerate 10", ""));
    let colour_only = OpenOptions { colour_only: true, ..options(&folder) };
    assert_eq!(opened(&path, &colour_only), 0);
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_of_another_rate_is_paired_as_in_folders() {
    let folder = pictures(8);
    let path = video(&folder, "slow.mkv", ("-framerate 5", "-t 0.75"));
    let open = |options: OpenOptions| {
        let sequence = Sequence::open(&path, &options).expect("a video");
        let frames = frames(&sequence);
        (sequence, frames.iter().map(|f| (f.index, depth_of(f))).collect::<Vec<_>>())
    };
    let (sequence, pairs) = open(options(&folder));
    let all = [(0, 0), (1, -1), (2, 1), (3, -1), (4, 2), (5, -1), (6, 3), (7, -1)];
    assert_eq!(pairs, all);
    assert!(sequence.warnings[0].contains("4 of 8 frames have a depth"), "{:?}", sequence.warnings);
    let part = OpenOptions { frames: Some(2..7), stride: 2, ..options(&folder) };
    assert_eq!(open(part).1, [all[2], all[4], all[6]]);
    let nearest = OpenOptions { depth_pairing: DepthPairing::Nearest, ..options(&folder) };
    let (sequence, pairs) = open(nearest.clone());
    assert_eq!(
        (pairs.as_slice(), sequence.dropped.without_depth),
        (&[(0, 0), (1, 1), (2, 2), (3, 3)][..], 4)
    );
    let part = OpenOptions { frames: Some(2..4), ..nearest };
    assert_eq!(open(part).1, [(2, 2), (3, 3)]);
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_is_resampled_as_that_of_folders() {
    let folder = pictures(2);
    let path = video(&folder, "a.mkv", ("-framerate 10", ""));
    let lens = CAMERA.replace('}', r#","distortion":[-0.2,0.05,0,0]}"#);
    for (camera, scale, crop_border) in
        [(CAMERA, 0.75, 0), (CAMERA, 0.8, 1), (lens.as_str(), 1.0, 0), (lens.as_str(), 0.75, 0)]
    {
        folder.write("camera.json", camera);
        let options = OpenOptions { scale, crop_border, ..options(&folder) };
        let of_folder = Sequence::open(&folder.0, &options).expect("a folder").load(1);
        let of_video = Sequence::open(&path, &options).expect("a video").load(1);
        let depth = |frame: Result<Frame, _>| frame.expect("a frame").depth.expect("depth").image;
        assert_eq!(depth(of_video), depth(of_folder), "{scale} {crop_border}");
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_of_another_size_or_time_is_told() {
    let folder = pictures(3);
    let path = video(&folder, "small.mkv", ("-framerate 10", "-s:v:1 8x6"));
    let refusal = Sequence::open(&path, &options(&folder)).expect_err("two sizes").to_string();
    let expected = "second video track, depth, is 8x6 px, expected 16x12 as the first";
    assert!(refusal.contains("small.mkv") && refusal.contains(expected), "{refusal}");
    let path = video(&folder, "late.mkv", ("-framerate 10 -itsoffset 5", ""));
    let sequence = Sequence::open(&path, &options(&folder)).expect("colour");
    assert_eq!((sequence.len(), sequence.frames_with_depth()), (3, 0));
    let told =
        sequence.warnings.iter().any(|w| w.contains("none of 3 pictures") && w.contains("4.8"));
    assert!(told, "{:?}", sequence.warnings);
    let nearest = OpenOptions { depth_pairing: DepthPairing::Nearest, ..options(&folder) };
    let refusal = Sequence::open(&path, &nearest).expect_err("no frame").to_string();
    assert!(refusal.contains("late.mkv") && refusal.contains("none of 3 pictures"), "{refusal}");
}

/// Numbers of track, and one after the last byte, of the pictures in a video file in order.
fn packets(path: &Path) -> Vec<(usize, usize)> {
    let mut probe = Command::new("ffprobe");
    let fields = ["-v", "error", "-show_entries", "packet=stream_index,pos", "-of", "csv=p=0"];
    let listed = probe.args(fields).arg(path).output().expect("ffprobe").stdout;
    let listed = String::from_utf8(listed).expect("text");
    let numbers: Vec<(usize, usize)> = listed
        .lines()
        .filter_map(|line| line.split_once(','))
        .map(|(track, pos)| (track.parse().expect("a track"), pos.parse().expect("a place")))
        .collect();
    let end = std::fs::metadata(path).expect("a file").len() as usize;
    let ends = numbers.iter().skip(1).map(|(_, pos)| *pos).chain([end]);
    numbers.iter().zip(ends).map(|((track, _), end)| (*track, end)).collect()
}

/// Frames of a stream, each with the delay after its last picture was written [s], and the sequence
/// that is left.
struct Streamed {
    frames: Vec<(Frame, f64)>,
    recorded: RecordedSequence,
    has_depth: bool,
}

/// Writes a video to a pipe, colour every [`INTERVAL`], and reads its frames at the other end.
fn streamed(folder: &Folder, video: &Path, options: &OpenOptions) -> Streamed {
    let pipe = folder.join("camera");
    if !pipe.exists() {
        assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    }
    let (packets, bytes) = (packets(video), std::fs::read(video).expect("a video"));
    let to = pipe.clone();
    let camera = std::thread::spawn(move || {
        let mut to = std::fs::OpenOptions::new().write(true).open(to).expect("a pipe");
        let (begin, mut written, mut times) = (Instant::now(), 0, Vec::new());
        for (track, end) in packets {
            if track == 0 {
                let due = Duration::from_secs_f64(times.len() as f64 * INTERVAL);
                std::thread::sleep(due.saturating_sub(begin.elapsed()));
                times.push(Instant::now());
            }
            to.write_all(&bytes[written..end]).expect("a reader");
            written = end;
        }
        // What comes after the end does not count.
        std::thread::sleep(Duration::from_secs(1));
        times
    });
    let live = LiveSequence::open(&pipe, options, CancellationToken::default()).expect("a stream");
    let arriving = live.frames(live.first()).expect("decoders");
    let came: Vec<(Frame, Instant)> = arriving.map(|frame| (frame, Instant::now())).collect();
    let times = camera.join().expect("a camera");
    let delay = |(frame, came): (Frame, Instant)| {
        let delay = came.saturating_duration_since(times[frame.index]).as_secs_f64();
        (frame, delay)
    };
    let (has_depth, frames) = (live.has_depth(), came.into_iter().map(delay).collect());
    Streamed { frames, recorded: live.finish().expect("a sequence"), has_depth }
}

/// Frames as they came are those of the sequence that is left.
fn assert_as_recorded(streamed: &Streamed) {
    let recorded = frames(&streamed.recorded.sequence);
    assert_eq!(recorded.len(), streamed.frames.len());
    for ((live, _), recorded) in streamed.frames.iter().zip(&recorded) {
        assert_eq!(live, recorded);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn frames_of_a_stream_have_depth_while_they_come() {
    let folder = pictures(20);
    for (name, milliseconds) in [("together.nut", 0), ("later.nut", 13)] {
        let output = format!("{RAW} -filter:v:1 settb=1/1000,setpts=PTS+{milliseconds}");
        let path = video(&folder, name, ("-framerate 10", &output));
        let streamed = streamed(&folder, &path, &options(&folder));
        assert!(streamed.has_depth);
        let pairs: Vec<i32> = streamed.frames.iter().map(|(frame, _)| depth_of(frame)).collect();
        assert_eq!(pairs, (0..20).collect::<Vec<i32>>(), "{name}");
        // Until the decoders run, pictures wait; the last one comes when the stream ends.
        let delays: Vec<f64> = streamed.frames[8..19].iter().map(|(_, delay)| *delay).collect();
        eprintln!("{name}: {delays:.2?}");
        assert!(delays.iter().all(|delay| *delay < 2.0 * INTERVAL), "{delays:.2?}");
        assert_as_recorded(&streamed);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_that_ends_early_holds_up_nothing() {
    let folder = pictures(24);
    let path = video(&folder, "ends.nut", ("-framerate 10", &format!("{RAW} -frames:v:1 6")));
    let streamed = streamed(&folder, &path, &options(&folder));
    let pairs: Vec<i32> = streamed.frames.iter().map(|(frame, _)| depth_of(frame)).collect();
    let expected: Vec<i32> = (0..6).chain([-1; 18]).collect();
    assert_eq!(pairs, expected);
    let delays: Vec<f64> = streamed.frames[16..].iter().map(|(_, delay)| *delay).collect();
    eprintln!("after the end of depth: {delays:.2?}");
    // Those that wait when the stream ends come then.
    assert!(delays[..5].iter().all(|delay| *delay < 4.5 * INTERVAL), "{delays:.2?}");
    assert_as_recorded(&streamed);
}

#[test]
#[ignore = "needs ffmpeg"]
fn depth_that_never_comes_is_none() {
    let folder = pictures(8);
    let output = format!("{RAW} -frames:v:1 1 -filter:v:1 setpts=PTS+100");
    let path = video(&folder, "never.nut", ("-framerate 10", &output));
    let streamed = streamed(&folder, &path, &options(&folder));
    assert!(streamed.frames.len() == 8);
    assert!(streamed.frames.iter().all(|(frame, _)| frame.depth.is_none()));
    assert_as_recorded(&streamed);
}

#[test]
#[ignore = "needs ffmpeg"]
fn streams_with_another_second_track_and_none_are_colour_alone() {
    let folder = pictures(8);
    let colour = folder.join("alone.nut");
    let pattern = folder.join("rgb/%03d.png");
    ffmpeg(&format!("-framerate 10 -i {} -c:v ffv1 {}", pattern.display(), colour.display()));
    let second = video(&folder, "two.nut", ("-framerate 10", "-pix_fmt:v:1 yuv420p"));
    let depth = video(&folder, "depth.nut", ("-framerate 10", ""));
    let colour_only = OpenOptions { colour_only: true, ..options(&folder) };
    for (path, options) in
        [(colour, options(&folder)), (second, options(&folder)), (depth, colour_only)]
    {
        let streamed = streamed(&folder, &path, &options);
        assert!(!streamed.has_depth && streamed.frames.len() == 8, "{path:?}");
        assert!(streamed.frames.iter().all(|(frame, _)| frame.depth.is_none()));
        assert_as_recorded(&streamed);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn streams_are_paired_as_their_recordings() {
    let folder = pictures(16);
    // Depth at two thirds of the rate, begun later.
    let path =
        video(&folder, "other.nut", ("-framerate 6.7 -itsoffset 0.33", "-max_interleave_delta 1"));
    for depth_pairing in [DepthPairing::OneToOne, DepthPairing::Nearest] {
        let options = OpenOptions { depth_pairing, ..options(&folder) };
        let streamed = streamed(&folder, &path, &options);
        let count = streamed.recorded.sequence.frames_with_depth();
        assert!(streamed.has_depth && count >= 6, "{count}");
        assert_as_recorded(&streamed);
    }
}

/// The command of docs/datasets.md.
#[test]
#[ignore = "needs ../shared and ffmpeg"]
fn a_video_of_a_folder_has_its_frames() {
    let (data, folder) = (shared_data("dining-room"), Folder::new());
    let path = folder.join("clip.mkv");
    let input = |name: &str| {
        format!("-framerate 30 -t 0.65 -pattern_type glob -i {}/{name}/*.png", data.display())
    };
    ffmpeg(&format!(
        "{} {} -map 0:v -map 1:v -c:v ffv1 {}",
        input("rgb"),
        input("depth"),
        path.display()
    ));
    let camera = Some(data.join("camera.json"));
    let options = OpenOptions { camera, frames: Some(0..20), scale: 0.5, ..OpenOptions::default() };
    let of_video = frames(&Sequence::open(&path, &options).expect("a video"));
    let of_folder = frames(&Sequence::open(&data, &options).expect("a folder"));
    assert_eq!((of_video.len(), of_folder.len()), (20, 20));
    for (video, folder) in of_video.iter().zip(&of_folder) {
        assert_eq!(video.depth_image(), folder.depth_image());
        let differences =
            video.colour.data.iter().zip(&folder.colour.data).map(|(a, b)| (a - b).abs());
        assert!(differences.fold(0.0, f32::max) < 1.5 / 255.0);
        assert!((video.timestamp - folder.timestamp).abs() < 1e-3);
    }
}
