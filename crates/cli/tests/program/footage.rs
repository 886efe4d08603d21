//! Made-up videos: raw frames beside an empty file, and a script that answers as ffmpeg would.

use crate::program::{Ran, TemporaryFolder, program};
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

pub(crate) const WIDTH: usize = 160;
pub(crate) const HEIGHT: usize = 120;
/// True focal length [px]: 63.2 degrees across.
pub(crate) const FOCAL: f64 = 130.0;

/// Writes `FILE.words` to standard error, or `FILE.rgb` to standard output where raw video is asked
/// for, FILE being what stands behind `-i`, with `.depth` behind it for the second track. A stream holds the name of such a file, and is handed
/// on as it is, and decoded from standard input once the line is there; `http://host/NAME` is the file NAME
/// beside the script, and does not end where there is a `NAME.endless`.
const SCRIPT: &str = r#"#!/bin/sh
raw= nut= track=
while [ $# -gt 0 ]; do
  case "$1" in
    -i) file=$2; shift;;
    rawvideo) raw=1;;
    nut) nut=1;;
    0:V:1) track=.depth;;
  esac
  shift
done
if [ "$nut" ] && [ "$raw" ]; then
  read -r file
  file=$file$track
  cat "$file.words" >&2
  exec cat "$file.rgb"
fi
if [ "$nut" ]; then
  case "$file" in
    -) exec cat;;
    *://*) file=$(dirname "$0")/${file##*/};;
  esac
  cat "$file"
  [ -e "$file.endless" ] && exec sleep 60
  exit
fi
if [ -s "$file" ]; then file=$(cat "$file"); fi
file=$file$track
if [ "$track" ] && [ ! -e "$file.words" ]; then
  echo "[fatal] Stream map '0:V:1' matches no streams." >&2
  exit 1
fi
if [ "$raw" ]; then exec cat "$file.rgb"; fi
cat "$file.words" >&2
"#;

/// Pose of the camera, scene and lens of a frame.
#[derive(Clone, Copy)]
pub(crate) struct View {
    /// To the right of where it began [m].
    pub(crate) x: f64,
    /// Turned to the right [rad].
    pub(crate) turned: f64,
    /// Which scene.
    pub(crate) scene: u32,
    /// Radial distortion of the lens, `k1` as in OpenCV.
    pub(crate) k1: f64,
}

impl View {
    pub(crate) fn moved(x: f64) -> Self {
        Self { x, turned: 0.0, scene: 0, k1: 0.0 }
    }

    /// Bytes R G B of a wall with a step in depth.
    fn picture(self) -> Vec<u8> {
        (0..WIDTH * HEIGHT)
            .flat_map(|pixel| {
                let [x, y, _] = self.seen(pixel);
                [texture(x, y, self.scene); 3]
            })
            .collect()
    }

    /// Two bytes of depth for each pixel [mm].
    fn depth(self) -> Vec<u8> {
        let millimetres = |pixel| (1000.0 * self.seen(pixel)[2]).round() as u16;
        (0..WIDTH * HEIGHT).flat_map(|pixel| millimetres(pixel).to_le_bytes()).collect()
    }

    /// Place on the wall that a pixel shows, and its depth [m].
    fn seen(self, pixel: usize) -> [f64; 3] {
        let (sin, cos) = self.turned.sin_cos();
        let across = ((pixel % WIDTH) as f64 + 0.5 - 80.0) / FOCAL;
        let down = ((pixel / WIDTH) as f64 + 0.5 - 60.0) / FOCAL;
        let [across, down] = straight([across, down], self.k1);
        let ray = [cos * across + sin, down, cos - sin * across];
        let at = |z: f64| [self.x + ray[0] / ray[2] * z, ray[1] / ray[2] * z, z / ray[2]];
        let near = at(2.0);
        if near[1] > 0.1 { near } else { at(3.5) }
    }
}

/// Undistorts a point `shown` by the lens (distances from the centre in focal
/// lengths): `shown = seen (1 + k1 ‖seen‖²)`.
fn straight(shown: [f64; 2], k1: f64) -> [f64; 2] {
    let mut seen = shown;
    for _ in 0..30 {
        let factor = 1.0 + k1 * (seen[0] * seen[0] + seen[1] * seen[1]);
        seen = shown.map(|v| v / factor);
    }
    seen
}

fn texture(x: f64, y: f64, scene: u32) -> u8 {
    let wave = |a: f64, b: f64| (a * x + b * y).sin();
    let sum = match scene {
        0 => wave(13.0, 5.0) + wave(-6.0, 17.0) + wave(23.0, -19.0),
        _ => wave(3.0, 21.0) + wave(16.0, -9.0) + wave(-27.0, -11.0),
    };
    (127.5 + 30.0 * sum) as u8
}

/// Steps to the right, evenly in time.
pub(crate) fn walk(frames: u32, step: f64) -> Vec<(u32, View)> {
    (0..frames).map(|i| (20 * i, View::moved(step * f64::from(i)))).collect()
}

/// A folder with videos in it.
pub(crate) struct Footage {
    pub(crate) scratch: TemporaryFolder,
}

impl Footage {
    pub(crate) fn new(name: &str) -> Self {
        let scratch = TemporaryFolder::new(name);
        let script = scratch.join("ffmpeg");
        fs::write(&script, SCRIPT).expect("room");
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).expect("a script");
        Self { scratch }
    }

    /// A video of these views at these times [1/600 s].
    pub(crate) fn video(&self, name: &str, views: &[(u32, View)]) -> PathBuf {
        let path = self.scratch.join(name);
        let mut words =
            String::from("[Parsed_showinfo_0 @ 0x1] [info] config in time_base: 1/600\n");
        let mut frames = Vec::new();
        for (n, (ticks, view)) in views.iter().enumerate() {
            writeln!(
                words,
                "[Parsed_showinfo_0 @ 0x1] [info] n:{n:4} pts:{ticks:7} pts_time:0 fmt:yuv420p \
                 sar:0/1 s:{WIDTH}x{HEIGHT} i:P"
            )
            .expect("memory");
            frames.extend(view.picture());
        }
        fs::write(path.with_extension("mp4.words"), words).expect("room");
        fs::write(path.with_extension("mp4.rgb"), frames).expect("room");
        fs::write(&path, "").expect("room");
        path
    }

    /// A [video](Self::video) with depth as its second track [mm].
    pub(crate) fn video_with_depth(&self, name: &str, views: &[(u32, View)]) -> PathBuf {
        let path = self.video(name, views);
        let words = fs::read_to_string(path.with_extension("mp4.words")).expect("words");
        let depth: Vec<u8> = views.iter().flat_map(|(_, view)| view.depth()).collect();
        fs::write(path.with_extension("mp4.depth.words"), words.replace("yuv420p", "gray16le"))
            .expect("room");
        fs::write(path.with_extension("mp4.depth.rgb"), depth).expect("room");
        path
    }

    /// A file of which nothing can be decoded, and what ffmpeg says of it.
    pub(crate) fn broken(&self, name: &str, words: &str) -> PathBuf {
        let path = self.scratch.join(name);
        fs::write(path.with_extension("mp4.words"), words).expect("room");
        fs::write(&path, "").expect("room");
        path
    }

    /// The program on a video, with this ffmpeg.
    pub(crate) fn i2slam(&self, command: &str, video: &Path, more: &[&str]) -> Ran {
        Ran::of(&mut self.command(command, video, more))
    }

    pub(crate) fn command(&self, command: &str, video: &Path, more: &[&str]) -> Command {
        let head = [command.as_ref(), video.as_os_str()];
        let mut command = program(head.into_iter().chain(more.iter().map(AsRef::as_ref)));
        let passing = self.scratch.join("tmp");
        fs::create_dir_all(&passing).expect("room");
        command.env("I2SLAM_FFMPEG", self.scratch.join("ffmpeg")).env("TMPDIR", passing);
        command
    }

    /// Whether nothing was left in the folder for what passes.
    pub(crate) fn is_tidy(&self) -> bool {
        fs::read_dir(self.scratch.join("tmp")).expect("a folder").next().is_none()
    }

    /// A quick run into `out`.
    pub(crate) fn run(&self, video: &Path, more: &[&str]) -> Ran {
        Ran::of(&mut self.quick("out", video, more))
    }

    /// A quick run into a folder.
    pub(crate) fn quick(&self, out: &str, video: &Path, more: &[&str]) -> Command {
        let (out, config) = (self.scratch.join(out), self.scratch.join("quick.toml"));
        fs::write(&config, QUICK).expect("room");
        let [out, config] = [&out, &config].map(|path| path.to_str().expect("a name"));
        let flags = ["--out", out, "--config", config, "--render", "none"];
        self.command("run", video, &[&flags, more].concat())
    }
}

/// Few steps, and still a map in which the frames are found.
const QUICK: &str = "[mapping]\nfirst_iterations = 10\niterations = 2\nfinal_iterations = 4\n";
