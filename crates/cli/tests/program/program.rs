//! The program as a child process, and a made-up sequence with depth for it: two textured walls and
//! a floor, seen by a camera that moves a little.

pub(crate) use i2slam_check::{Ran, TemporaryFolder};
use serde_json::Value;
use std::ffi::OsStr;
use std::fmt::Write;
use std::fs;
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

/// The program with arguments.
pub(crate) fn program<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_i2slam"));
    command.args(arguments);
    command
}

/// A running program whose standard error is read line by line.
pub(crate) struct Running {
    child: Child,
    lines: Lines<BufReader<ChildStderr>>,
    heard: String,
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("the program starts");
        let errors = child.stderr.take().expect("a pipe");
        Self { child, lines: BufReader::new(errors).lines(), heard: String::new() }
    }

    /// Waits for a line with this text.
    #[track_caller]
    pub(crate) fn until(&mut self, text: &str) -> String {
        for line in self.lines.by_ref().map_while(Result::ok) {
            self.heard += &format!("{line}\n");
            if line.contains(text) {
                return line;
            }
        }
        panic!("`{text}` is not in:\n{}", self.heard);
    }

    /// Sends Ctrl-C and waits for the end.
    #[track_caller]
    pub(crate) fn interrupted(mut self) -> Ran {
        let sent = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status();
        assert!(sent.expect("kill").success());
        self.heard.extend(self.lines.map_while(Result::ok).map(|line| line + "\n"));
        let ran = Ran::from(self.child.wait_with_output().expect("an end"));
        Ran { err: self.heard, ..ran }
    }
}

/// Runs the program to its end.
pub(crate) fn run<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ran {
    Ran::of(&mut program(arguments))
}

/// Runs the program with texts and paths, and with a slice of further flags behind a semicolon.
macro_rules! i2slam {
    ($($argument:expr),+ $(,)?) => { $crate::program::i2slam!($($argument),+; []) };
    ($($argument:expr),+; $more:expr) => {{
        let more: &[&str] = &$more;
        let more = more.iter().map(::std::ffi::OsStr::new);
        $crate::program::run([$(::std::ffi::OsStr::new(&$argument)),+].into_iter().chain(more))
    }};
}
pub(crate) use i2slam;

/// A made-up sequence, and a folder beside it for the result of its run.
pub(crate) struct Room {
    pub(crate) scratch: TemporaryFolder,
    pub(crate) data: PathBuf,
    pub(crate) out: PathBuf,
}

impl Room {
    pub(crate) fn new(name: &str, scene: Scene) -> Self {
        let scratch = TemporaryFolder::new(name);
        let (data, out) = (scratch.join("room"), scratch.join("out"));
        scene.write(&data);
        Self { scratch, data, out }
    }

    /// The sequence with a quick run of it.
    pub(crate) fn reconstructed(name: &str, scene: Scene, flags: &[&str]) -> Self {
        let room = Self::new(name, scene);
        room.run(flags).exits_with(0);
        room
    }

    /// The sequence with sharp pictures equal to those taken.
    pub(crate) fn with_sharp(name: &str) -> Self {
        let room = Self::new(name, Scene::default());
        fs::create_dir(room.data.join("sharp")).expect("a folder");
        for entry in fs::read_dir(room.data.join("rgb")).expect("pictures").flatten() {
            let to = room.data.join("sharp").join(entry.file_name());
            fs::copy(entry.path(), to).expect("room");
        }
        room
    }

    pub(crate) fn run(&self, flags: &[&str]) -> Ran {
        reconstruct(&self.data, &self.out, flags)
    }

    pub(crate) fn eval(&self, flags: &[&str]) -> Ran {
        i2slam!("eval", self.out; flags)
    }

    /// Results of an evaluation.
    pub(crate) fn eval_json(&self, flags: &[&str]) -> Value {
        json(&i2slam!("eval", self.out, "--json"; flags))
    }

    /// A text file of the result.
    pub(crate) fn text(&self, file: &str) -> String {
        fs::read_to_string(self.out.join(file)).expect(file)
    }

    /// A number of `metrics.json`; `None` for null.
    pub(crate) fn metric(&self, key: &str) -> Option<f64> {
        number(&self.out.join("metrics.json"), key)
    }

    /// A column of `frames.csv`.
    pub(crate) fn column(&self, name: &str) -> Vec<f64> {
        let table = self.text("frames.csv");
        let names = table.lines().next().expect("names");
        let place = names.split(',').position(|n| n == name).expect("a column");
        let cell = |row: &str| row.split(',').nth(place).and_then(|c| c.parse().ok());
        table.lines().skip(1).map(|row| cell(row).expect("a number")).collect()
    }

    pub(crate) fn has(&self, file: &str) -> bool {
        self.out.join(file).exists()
    }
}

/// The object on standard output of a successful call.
#[track_caller]
pub(crate) fn json(ran: &Ran) -> Value {
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    serde_json::from_str(&ran.out).expect("JSON")
}

/// `i2slam run` on a folder with quick settings.
pub(crate) fn reconstruct(dataset: &Path, out: &Path, more: &[&str]) -> Ran {
    let config = out.with_extension("quick.toml");
    fs::write(&config, "[mapping]\nfinal_iterations = 3\niterations = 12\n").expect("room");
    i2slam!("run", dataset, "--out", out, "--config", config; more)
}

/// Number at a key of a flat JSON file; `None` for null.
pub(crate) fn number(json: &Path, key: &str) -> Option<f64> {
    let text = fs::read_to_string(json).expect("a JSON file");
    let object: Value = serde_json::from_str(&text).expect("JSON");
    let value = object.get(key);
    value.unwrap_or_else(|| panic!("{key} is not in {text}")).as_f64()
}

/// Number of lines of a text file that are no comments.
pub(crate) fn rows(path: &Path) -> usize {
    let text = fs::read_to_string(path).expect("a text file");
    text.lines().filter(|line| !line.starts_with('#')).count()
}

pub(crate) const WIDTH: usize = 48;
pub(crate) const HEIGHT: usize = 36;
const FOCAL: f64 = 45.0;
/// Depth image value of one metre.
const UNITS: f64 = 5000.0;

/// Options of the sequence.
#[derive(Clone, Copy)]
pub(crate) struct Scene {
    pub(crate) frames: usize,
    /// Camera motion from frame to frame [m].
    pub(crate) step: f64,
    /// `depth_scale` written to camera.json.
    pub(crate) declared_units: f64,
}

impl Default for Scene {
    fn default() -> Self {
        Self { frames: 6, step: 0.01, declared_units: UNITS }
    }
}

/// Time of a frame [s].
pub(crate) fn stamp(frame: usize) -> String {
    format!("{:.6}", 100.0 + 0.04 * frame as f64)
}

impl Scene {
    /// Write the sequence in the TUM layout with camera.json and ground truth.
    pub(crate) fn write(&self, folder: &Path) {
        for part in ["rgb", "depth"] {
            fs::create_dir_all(folder.join(part)).expect("a folder");
        }
        let (mut colours, mut depths, mut truth) = (String::new(), String::new(), String::new());
        for frame in 0..self.frames {
            let time = stamp(frame);
            let x = self.step * frame as f64;
            let (colour, depth) = self.pictures(x);
            write_colour(&folder.join(format!("rgb/{time}.png")), (WIDTH, HEIGHT), &colour);
            write_depth(&folder.join(format!("depth/{time}.png")), &depth);
            writeln!(colours, "{time} rgb/{time}.png").expect("memory");
            writeln!(depths, "{time} depth/{time}.png").expect("memory");
            writeln!(truth, "{time} {x:.6} 0 {:.6} 0 0 0 1", 0.3 * x).expect("memory");
        }
        fs::write(folder.join("rgb.txt"), colours).expect("room");
        fs::write(folder.join("depth.txt"), depths).expect("room");
        fs::write(folder.join("groundtruth.txt"), truth).expect("room");
        let camera = format!(
            "{{\"width\": {WIDTH}, \"height\": {HEIGHT}, \"fx\": {FOCAL}, \"fy\": {FOCAL}, \
             \"cx\": 24, \"cy\": 18, \"pixel_centre\": 0.5, \"depth_scale\": {}, \"fps\": 25}}",
            self.declared_units
        );
        fs::write(folder.join("camera.json"), camera).expect("room");
    }

    /// Colour bytes and depth units seen from `(x, 0, 0.3 x)`.
    fn pictures(&self, x: f64) -> (Vec<u8>, Vec<u16>) {
        let (mut colour, mut depth) = (Vec::new(), Vec::new());
        for row in 0..HEIGHT {
            for column in 0..WIDTH {
                let across = (column as f64 + 0.5 - 24.0) / FOCAL;
                let down = (row as f64 + 0.5 - 18.0) / FOCAL;
                // A back wall at z = 1.6, a wall on the right that comes towards the camera, and a
                // floor 0.35 m below it.
                let back = 1.6 - 0.3 * x;
                let right = (0.9 - x + 0.15 * x) / (across + 0.5);
                let floor = if down > 0.0 { 0.35 / down } else { f64::INFINITY };
                let z = if across > -0.4 { back.min(right) } else { back }.min(floor);
                let point = [x + across * z, down * z, 0.3 * x + z];
                colour.extend(texture(point));
                depth.push((z * UNITS).round() as u16);
            }
        }
        (colour, depth)
    }
}

/// A smooth pattern without repetition in the picture.
fn texture([x, y, z]: [f64; 3]) -> [u8; 3] {
    let value = |phase: f64| {
        let wave = (9.0 * x + phase).sin() * (13.0 * y - phase).cos() + (5.0 * z + 11.0 * y).sin();
        (127.5 + 50.0 * wave) as u8
    };
    [value(0.0), value(1.3), value(2.1)]
}

/// An 8-bit RGB PNG.
pub(crate) fn write_colour(path: &Path, (width, height): (usize, usize), bytes: &[u8]) {
    write_png(path, (width, height), png::ColorType::Rgb, png::BitDepth::Eight, bytes);
}

/// A 16-bit grey PNG of the scene's size.
pub(crate) fn write_depth(path: &Path, units: &[u16]) {
    let bytes: Vec<u8> = units.iter().flat_map(|u| u.to_be_bytes()).collect();
    let (colour, bits) = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    write_png(path, (WIDTH, HEIGHT), colour, bits, &bytes);
}

fn write_png(
    path: &Path,
    (width, height): (usize, usize),
    colour: png::ColorType,
    bits: png::BitDepth,
    bytes: &[u8],
) {
    let file = fs::File::create(path).expect("a file");
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(bytes).expect("pixels");
}
