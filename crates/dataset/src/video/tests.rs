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
fn streams_are_refused_with_a_way_out() {
    let refused = |text: &str| refused_stream(Path::new(text)).map(|error| error.to_string());
    assert!(refused("rtsp://a/b").is_some_and(|m| m.contains("ffmpeg -i rtsp://a/b -t 60")));
    assert!(refused("-").is_some_and(|m| m.contains("record it first")));
    assert!(refused("a/b.mp4").is_none());
    assert!(is_video(Path::new("a/b.MP4")) && !is_video(Path::new("b.sens")));
}
