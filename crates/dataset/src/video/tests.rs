//! A script in place of ffmpeg: what is asked of it, and what is made of its answers.

use super::*;
use std::fs;
use std::os::unix::fs::PermissionsExt;

/// Frames of 2x2 px whose bytes are all their number; `fps_mode` is unknown to it, as to old ones.
const SCRIPT: &str = r#"#!/bin/sh
here=$(dirname "$0")
echo "$@" >> "$here/asked"
case "$*" in *fps_mode*) echo "Unrecognized option 'fps_mode'." >&2; exit 1;; esac
case "$*" in
  *ffv1*) echo "[rtsp @ 0x1] [error] it hung up" >&2; cat "$here/frames"; [ -e "$here/endless" ] && exec sleep 60;;
  *rawvideo*) cat "$here/frames"; echo "[h264 @ 0x1] [error] it broke" >&2;;
  *) cat "$here/words" >&2;;
esac
"#;

struct Folder(PathBuf);

impl Folder {
    /// A folder with the script, a video of `listed` frames, of which `given` can be decoded.
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

    fn list(&self, options: &OpenOptions) -> Result<Listing, DatasetError> {
        let ffmpeg = Ffmpeg::at(self.0.join("ffmpeg"));
        Video::list_with(ffmpeg, &self.0.join("a.mp4"), options, 30.0)
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
    video.picture(number).expect("a picture").data[0] * 255.0
}

#[test]
fn pictures_come_by_number_from_one_decoder() {
    let folder = Folder::new("order", 10, 10);
    let listing = folder.list(&OpenOptions::default()).expect("a video");
    assert_eq!(listing.entries.len(), 10);
    assert!((listing.entries[7].timestamp - 0.7).abs() < 1e-12 && listing.warnings.is_empty());
    let video = listing.video.expect("a decoder");
    for number in [0, 1, 4, 9, 3, 9, 0] {
        assert_eq!(shown(&video, number), number as f32);
    }
    assert_eq!(folder.decodings(), 1, "what was decoded is kept");
}

#[test]
fn going_far_back_decodes_again() {
    let folder = Folder::new("back", 10, 10);
    let video = folder.list(&OpenOptions::default()).expect("a video").video.expect("a decoder");
    let mut reader = Reader::new(video.ffmpeg.clone(), (2, 2)).keeping(2);
    let mut picture = |number| reader.picture(&video.path, number).expect("a picture")[0];
    assert_eq!([picture(6), picture(5), picture(2), picture(3)], [6, 5, 2, 3]);
    assert_eq!(folder.decodings(), 2);
}

#[test]
fn a_frame_that_does_not_come_is_an_error_with_its_cause() {
    let folder = Folder::new("short", 10, 4);
    let video = folder.list(&OpenOptions::default()).expect("a video").video.expect("a decoder");
    assert_eq!(shown(&video, 3), 3.0);
    let error = video.picture(5).expect_err("no such frame");
    assert!(error.concerns_one_frame());
    let message = error.to_string();
    assert!(message.contains("frame 4 cannot be decoded: ffmpeg says: it broke"), "{message}");
    let decodings = folder.decodings();
    assert!(video.picture(6).is_err() && video.picture(4).is_err());
    assert_eq!(folder.decodings(), decodings, "what cannot be decoded is not tried again");
    assert_eq!(shown(&video, 2), 2.0);
}

#[test]
fn a_video_that_was_cut_off_is_told() {
    let folder = Folder::new("claims", 3, 3);
    let listing = folder.list(&OpenOptions::default()).expect("a video");
    assert!(
        listing.warnings[0].contains("lasts 1.0 s, but 3 frames of 0.2 s"),
        "{:?}",
        listing.warnings
    );
    let options = OpenOptions { frames: Some(0..2), ..OpenOptions::default() };
    let listing = folder.list(&options).expect("a video");
    assert_eq!((listing.entries.len(), listing.warnings.len()), (2, 0));
}

#[test]
fn streams_are_known_by_what_they_are() {
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

impl Folder {
    fn record(&self, most: u64, should_end: &dyn Fn() -> bool) -> Result<Recording, DatasetError> {
        let ffmpeg = Ffmpeg::at(self.0.join("ffmpeg"));
        Recording::with(ffmpeg, Path::new("rtsp://a/b"), most, should_end)
    }
}

#[test]
fn a_stream_is_decoded_once_into_a_file_that_goes_with_it() {
    let folder = Folder::new("stream", 3, 4);
    let recording = folder.record(1 << 20, &|| false).expect("a stream");
    let path = recording.path();
    assert_eq!(
        fs::read(&path).expect("a file"),
        fs::read(folder.0.join("frames")).expect("frames")
    );
    assert!(recording.warnings[0].contains("it hung up"), "{:?}", recording.warnings);
    let asked = fs::read_to_string(folder.0.join("asked")).expect("questions");
    // The script is old: it refuses the first words before it reads.
    assert_eq!(asked.lines().filter(|l| l.contains("-vsync 0 -c:v ffv1")).count(), 1, "{asked}");
    assert!(asked.lines().all(|line| line.contains("-i rtsp://a/b ")), "{asked}");
    let ffmpeg = Ffmpeg::at(folder.0.join("ffmpeg"));
    let listing = Video::list_with(ffmpeg, &path, &OpenOptions::default(), 30.0).expect("a video");
    assert!(listing.entries.len() == 3 && is_video(&path));
    drop(recording);
    assert!(!path.exists());
}

#[test]
fn a_live_stream_ends_when_it_is_asked_to() {
    let folder = Folder::new("live", 1, 4);
    fs::write(folder.0.join("endless"), "").expect("room");
    let begin = std::time::Instant::now();
    let recording =
        folder.record(1 << 20, &|| begin.elapsed().as_millis() > 500).expect("what came");
    assert!(begin.elapsed().as_secs() < 20);
    assert_eq!(fs::read(recording.path()).expect("a file").len(), 4 * 12);
    assert!(recording.warnings.is_empty(), "{:?}", recording.warnings);
}

#[test]
fn a_recording_has_a_bound_and_no_recording_a_reason() {
    let folder = Folder::new("bound", 1, 4);
    fs::write(folder.0.join("endless"), "").expect("room");
    let recording = folder.record(30, &|| false).expect("what fits");
    assert_eq!(fs::read(recording.path()).expect("a file").len(), 4 * 12);
    assert!(recording.warnings[0].contains("all that is kept"), "{:?}", recording.warnings);
    let silent = Folder::new("silent", 1, 0);
    let refusal = silent.record(1 << 20, &|| false).expect_err("nothing came").to_string();
    assert!(refusal.contains("it hung up") && refusal.contains("rtsp://a/b"), "{refusal}");
}
