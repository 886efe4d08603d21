//! Calls of ffmpeg and handling of its output, with a script in its place.

use super::frame_reader::FrameReader;
use super::*;
use i2slam_compute::CancellationToken;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Outputs frames of 2x2 px whose bytes are their number; refuses `fps_mode`, as old versions do.
const SCRIPT: &str = r#"#!/bin/sh
here=$(dirname "$0")
echo "$@" >> "$here/asked"
case "$*" in *fps_mode*) echo "Unrecognized option 'fps_mode'." >&2; exit 1;; esac
case "$*" in
  *ffv1*) echo "[rtsp @ 0x1] [error] it hung up" >&2; cat "$here/frames"; [ -e "$here/endless" ] && exec sleep 60;;
  *rawvideo*) if [ -e "$here/follows" ]; then cat "$here/words" >&2; exec cat; fi
    cat "$here/frames"; echo "[h264 @ 0x1] [error] it broke" >&2;;
  *) cat "$here/words" >&2;;
esac
"#;

/// Colour pictures of the script.
const SMALL: Pictures = Pictures { track: Track::Colour, size: (2, 2), is_deep: false };

fn part(end: Option<usize>) -> VideoPart {
    VideoPart { end, depth: Some(1.0), frame_rate: 30.0 }
}

struct Folder(PathBuf);

impl Folder {
    /// A folder with the script and a video of `listed` frames, `given` of which can be decoded.
    fn new(name: &str, listed: usize, given: u8) -> Self {
        let path = std::env::temp_dir().join(format!("i2slam-video-{name}-{}", std::process::id()));
        fs::remove_dir_all(&path).ok();
        fs::create_dir_all(&path).expect("a folder");
        let script = path.join("ffmpeg");
        fs::write(&script, SCRIPT).expect("room");
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).expect("a script");
        let mut words =
            "[i] Duration: 00:00:01.00, x\nshowinfo config in time_base: 1/10\n".to_owned();
        for n in 0..listed {
            words += &format!("showinfo n: {n} pts: {n} pts_time:0 sar:0/1 s:2x2 i:P\n");
        }
        fs::write(path.join("words"), words).expect("room");
        let frames: Vec<u8> = (0..given).flat_map(|n| [n; 12]).collect();
        fs::write(path.join("frames"), frames).expect("room");
        Self(path)
    }

    fn open(&self, end: Option<usize>) -> Result<VideoListing, DatasetError> {
        let ffmpeg = Ffmpeg::at(self.0.join("ffmpeg"));
        Video::open_with(ffmpeg, &self.0.join("a.mp4"), part(end))
    }

    fn decodings(&self) -> usize {
        let asked = fs::read_to_string(self.0.join("asked")).expect("questions");
        asked.lines().filter(|line| line.contains("rawvideo")).count()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn shown(video: &Video, number: usize) -> f32 {
    video.decode(number).expect("a picture").data[0] * 255.0
}

#[test]
fn frames_are_decoded_once_and_cached() {
    let folder = Folder::new("order", 10, 10);
    let listing = folder.open(None).expect("a video");
    assert_eq!(listing.timestamps.len(), 10);
    assert!((listing.timestamps[7] - 0.7).abs() < 1e-12 && listing.warnings.is_empty());
    let video = listing.video;
    for number in [0, 1, 4, 9, 3, 9, 0] {
        assert_eq!(shown(&video, number), number as f32);
    }
    assert_eq!(folder.decodings(), 1, "what was decoded is kept");
}

#[test]
fn steps_beyond_the_cache_restart_the_decoder() {
    let folder = Folder::new("back", 10, 10);
    let video = folder.open(None).expect("a video").video;
    let mut reader = FrameReader::new(video.ffmpeg.clone(), SMALL).with_capacity(2);
    let mut picture = |number| reader.frame(&video.path, number).expect("a picture")[0];
    assert_eq!([picture(6), picture(5), picture(2), picture(3)], [6, 5, 2, 3]);
    assert_eq!(folder.decodings(), 2);
}

#[test]
fn a_missing_frame_is_an_error_with_its_cause() {
    let folder = Folder::new("short", 10, 4);
    let video = folder.open(None).expect("a video").video;
    assert_eq!(shown(&video, 3), 3.0);
    let error = video.decode(5).expect_err("no such frame");
    assert!(error.concerns_one_frame());
    let message = error.to_string();
    assert!(message.contains("frame 4 cannot be decoded: ffmpeg says: it broke"), "{message}");
    let decodings = folder.decodings();
    assert!(video.decode(6).is_err() && video.decode(4).is_err());
    assert_eq!(folder.decodings(), decodings, "what cannot be decoded is not tried again");
    assert_eq!(shown(&video, 2), 2.0);
}

#[test]
fn a_cut_off_video_gives_a_warning() {
    let folder = Folder::new("claims", 3, 3);
    let listing = folder.open(None).expect("a video");
    assert!(
        listing.warnings[0].contains("lasts 1.0 s, but 3 frames of 0.2 s"),
        "{:?}",
        listing.warnings
    );
    let listing = folder.open(Some(2)).expect("a video");
    assert_eq!((listing.timestamps.len(), listing.warnings.len()), (2, 0));
}

#[test]
fn streams_are_recognised() {
    let folder = Folder::new("kinds", 1, 1);
    let pipe = folder.0.join("camera");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
    assert!(made.success());
    for stream in [Path::new("rtsp://a/b"), Path::new("http://a/b.mp4"), Path::new("-"), &pipe] {
        assert!(is_stream(stream) && is_video(stream), "{stream:?}");
        let refusal = refused_stream(stream).expect("cannot be read twice").to_string();
        assert!(refusal.contains("record it first") && refusal.contains("-t 60"), "{refusal}");
    }
    assert!(!is_stream(Path::new("a/b.mp4")) && refused_stream(Path::new("a/b.mp4")).is_none());
    assert!(is_video(Path::new("a/b.MP4")) && !is_video(Path::new("b.sens")));
}

/// The second word of every question that follows `option`.
fn asked_after(folder: &Folder, option: &str) -> Vec<String> {
    let asked = fs::read_to_string(folder.0.join("asked")).expect("questions");
    let value = |line: &str| {
        let mut words = line.split(' ').skip_while(|word| *word != option);
        words.nth(1).unwrap_or_default().to_owned()
    };
    asked.lines().map(value).collect()
}

#[test]
fn every_call_names_the_protocols_and_containers_it_may_open() {
    let folder = Folder::new("allowed", 3, 3);
    shown(&folder.open(None).expect("a video").video, 1);
    let protocols = asked_after(&folder, "-protocol_whitelist");
    assert!(protocols.len() >= 3 && protocols.iter().all(|p| p == "file"), "{protocols:?}");
    let containers = asked_after(&folder, "-format_whitelist");
    assert!(containers.iter().all(|names| names.contains("matroska") && !names.contains("hls")));
    drop(folder);
    let folder = Folder::new("allowed-stream", 3, 3);
    folder.record(1 << 20, CancellationToken::default()).expect("a stream");
    let protocols = asked_after(&folder, "-protocol_whitelist");
    assert!(protocols.iter().all(|p| p == "rtsp,rtp,srtp,udp,tcp"), "{protocols:?}");
}

#[test]
fn a_playlist_is_refused_with_one_message() {
    let folder = Folder::new("playlist", 0, 0);
    let words = "[hls @ 0x1] [error] Format not on whitelist 'mov'\n\
                 [error] a.mp4: Invalid argument\n";
    fs::write(folder.0.join("words"), words).expect("room");
    let refusal = folder.open(None).expect_err("a playlist").to_string();
    assert!(refusal.contains("a.mp4: it is a playlist, or"), "{refusal}");
}

/// The attack itself: lists in the clothes of videos that lead to another video.
#[test]
#[ignore = "needs ffmpeg"]
fn ffmpeg_follows_no_list_and_reads_what_cameras_write() {
    let folder = Folder::new("real-playlist", 0, 0);
    let path = |name: &str| folder.0.join(name);
    let make = |name: &str, more: &[&str]| {
        let source = "testsrc=size=64x48:rate=10:duration=1";
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        let ffmpeg = ffmpeg.args(["-v", "error", "-f", "lavfi", "-i", source]).args(more);
        assert!(ffmpeg.arg(path(name)).status().expect("ffmpeg").success(), "{name}");
    };
    let open = |name: &str| Video::open_with(Ffmpeg::find(), &path(name), part(None));
    make("real.mp4", &["-c:v", "mpeg4"]);
    assert_eq!(open("real.mp4").expect("a video").timestamps.len(), 10);
    for name in ["a.mkv", "a.avi", "a.mpg", "a.ts", "a.gif", "a.mjpeg", "a.nut", "a.y4m", "a.flv"] {
        make(name, &["-r", "25", "-pix_fmt", if name == "a.gif" { "rgb8" } else { "yuvj420p" }]);
        assert!(open(name).is_ok_and(|listing| listing.timestamps.len() >= 10), "{name}");
    }
    let real = path("real.mp4");
    let hls = format!(
        "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile:{}\n#EXT-X-ENDLIST\n",
        real.display()
    );
    let session = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n\
                   m=video 5000 RTP/AVP 96\na=rtpmap:96 H264/90000\n";
    for (name, text) in [
        ("hls.mp4", hls.as_str()),
        ("concat.mp4", "ffconcat version 1.0\nfile real.mp4\n"),
        ("concat.gif", "ffconcat version 1.0\nfile real.mp4\n"),
        ("session.mp4", session),
    ] {
        fs::write(path(name), text).expect("room");
        let refusal = open(name).expect_err("no video").to_string();
        assert!(refusal.contains(name) && refusal.lines().count() == 1, "{refusal}");
    }
    fs::copy(path("a.gif"), path("many-01.gif")).expect("room");
    assert!(open("many-%02d.gif").is_err(), "a pattern of names");
}

impl Folder {
    /// The whole recording of a stream, with its warning.
    fn record(
        &self,
        most: u64,
        end: CancellationToken,
    ) -> Result<(Recording, Option<String>), DatasetError> {
        let ffmpeg = Ffmpeg::at(self.0.join("ffmpeg"));
        let mut recording =
            Recording::start_with(ffmpeg, (Path::new("rtsp://a/b"), true), most, end)?;
        let warning = recording.wait()?;
        assert_eq!(recording.growing_bytes(), None);
        Ok((recording, warning))
    }
}

#[test]
fn a_stream_is_decoded_once_into_a_temporary_file() {
    let folder = Folder::new("stream", 3, 4);
    let (recording, warning) =
        folder.record(1 << 20, CancellationToken::default()).expect("a stream");
    let path = recording.path();
    assert_eq!(
        fs::read(&path).expect("a file"),
        fs::read(folder.0.join("frames")).expect("frames")
    );
    assert!(warning.as_ref().is_some_and(|w| w.contains("it hung up")), "{warning:?}");
    let asked = fs::read_to_string(folder.0.join("asked")).expect("questions");
    // The script refuses the options of new versions before it reads.
    assert_eq!(
        asked.lines().filter(|l| l.contains("-vsync 0 -map 0:V:0 -map 0:V:1? ")).count(),
        1,
        "{asked}"
    );
    assert!(asked.lines().all(|line| line.contains("-i rtsp://a/b ")), "{asked}");
    let ffmpeg = Ffmpeg::at(folder.0.join("ffmpeg"));
    let listing = Video::open_with(ffmpeg, &path, part(None)).expect("a video");
    assert!(listing.timestamps.len() == 3 && is_video(&path));
    drop(recording);
    assert!(!path.exists());
}

#[test]
fn a_live_stream_ends_on_request() {
    let folder = Folder::new("live", 1, 4);
    fs::write(folder.0.join("endless"), "").expect("room");
    let begin = std::time::Instant::now();
    let end = CancellationToken::when(move || begin.elapsed().as_millis() > 500);
    let (recording, warning) = folder.record(1 << 20, end).expect("what came");
    assert_eq!(fs::read(recording.path()).expect("a file").len(), 4 * 12);
    assert_eq!(warning, None);
}

#[test]
fn recordings_are_bounded_and_failures_explained() {
    let folder = Folder::new("bound", 1, 4);
    fs::write(folder.0.join("endless"), "").expect("room");
    let (recording, warning) = folder.record(30, CancellationToken::default()).expect("what fits");
    assert_eq!(fs::read(recording.path()).expect("a file").len(), 4 * 12);
    assert!(warning.as_ref().is_some_and(|w| w.contains("all that is kept")), "{warning:?}");
    let silent = Folder::new("silent", 1, 0);
    let refusal = silent.record(1 << 20, CancellationToken::default());
    let refusal = refusal.expect_err("nothing came").to_string();
    assert!(refusal.contains("it hung up") && refusal.contains("rtsp://a/b"), "{refusal}");
}

/// Frames of a file that another thread still writes: the script decodes what comes.
#[test]
fn frames_are_had_while_a_file_grows() {
    use std::io::Write;
    let folder = Folder::new("grows", 3, 4);
    fs::write(folder.0.join("follows"), "").expect("room");
    let (path, is_complete) = (folder.0.join("a.nut"), Arc::<AtomicBool>::default());
    let mut file = fs::File::create(&path).expect("room");
    file.write_all(&[0; 12]).expect("room");
    let mut ffmpeg = Ffmpeg::at(folder.0.join("ffmpeg"));
    assert!(
        ffmpeg.read_log((&path, Track::Colour), "showinfo", Part::All).is_ok(),
        "learns the options"
    );
    let frames =
        LiveFrames::start(&ffmpeg, &path, Arc::clone(&is_complete), SMALL).expect("a decoder");
    let next = || {
        let picture = frames.next_within(std::time::Duration::from_secs(60)).ok();
        picture.map(|(time, bytes)| (time, bytes[0]))
    };
    assert_eq!(next(), Some((Some(0.0), 0)));
    file.write_all(&[[1; 12], [2; 12], [3; 12]].concat()).expect("room");
    assert_eq!(next(), Some((Some(0.1), 1)));
    is_complete.store(true, Ordering::Release);
    assert_eq!(next(), Some((Some(0.2), 2)));
    // The log names three frames.
    assert_eq!(next(), Some((None, 3)));
    assert_eq!(next(), None);
}

/// A stream of ffmpeg itself: every frame is had before the stream ends, with the time stamps of the
/// file that it leaves.
#[test]
#[ignore = "needs ffmpeg"]
fn ffmpeg_decodes_what_it_records() {
    let folder = Folder::new("real-stream", 0, 0);
    let pipe = folder.0.join("camera");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    let mut camera = std::process::Command::new("ffmpeg");
    let source =
        ["-v", "error", "-re", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=5:duration=6"];
    let mut camera = camera
        .args(source)
        .args(["-y", "-c:v", "ffv1", "-f", "nut"])
        .arg(&pipe)
        .spawn()
        .expect("ffmpeg");
    let options = crate::OpenOptions { guess_camera: true, ..Default::default() };
    let live = crate::LiveSequence::open(&pipe, &options, CancellationToken::default());
    let live = live.expect("a stream");
    let frames = live.frames(live.first()).expect("a decoder");
    let mut came = Vec::new();
    for frame in frames {
        if frame.index == 20 {
            assert!(camera.try_wait().expect("a camera").is_none(), "before it ends");
        }
        came.push(frame);
    }
    assert!(camera.wait().expect("a camera").success());
    let recorded = live.finish().expect("a sequence");
    assert_eq!(recorded.sequence.len(), 30);
    for (place, frame) in came.iter().enumerate() {
        assert_eq!(*frame, recorded.sequence.load(place).expect("a frame"));
    }
    assert_eq!(came.len(), 30);
}

#[test]
#[ignore = "needs ffmpeg"]
fn ffmpeg_decodes_high_dynamic_range_with_its_colours() {
    let folder = Folder::new("hlg", 0, 0);
    let path = folder.0.join("hlg.mkv");
    let made = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i"])
        .arg("color=c=0xC08040:s=32x32:d=0.2:r=10,format=gbrp,scale=out_color_matrix=bt2020,format=yuv422p10le")
        .args(["-c:v", "ffv1", "-color_primaries", "bt2020"])
        .args(["-color_trc", "arib-std-b67", "-colorspace", "bt2020nc"])
        .arg(&path)
        .status();
    assert!(made.expect("ffmpeg").success());
    let listing = Video::open(&path, part(None)).expect("a video");
    assert!(listing.warnings.is_empty(), "{:?}", listing.warnings);
    assert_eq!(listing.video.transfer(), Some(Transfer::Hlg));
    let picture = listing.video.decode(0).expect("a picture");
    // The same colour without matrix and codec.
    let values = [0xC0, 0x80, 0x40].map(|value: u16| (value * 256).to_le_bytes()).concat();
    let expected = Conversion::new(Transfer::Hlg, true).image((1, 1), &values).data;
    for (channel, expected) in expected.into_iter().enumerate() {
        let found = picture.plane(channel)[500];
        assert!((found - expected).abs() < 0.006, "channel {channel}: {found} for {expected}");
    }
}
