//! The readers, by the name of their folder in the corpus.

use i2slam::Config;
use i2slam::dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};
use i2slam::dataset::{DatasetError, OpenOptions, Sequence, read_trajectory};
use i2slam_result::RunInput;
use i2slam_synthetic::{Spec, SyntheticError};
use std::fs;
use std::path::{Path, PathBuf};

/// Frames and keyframes of a case that are loaded.
const LOADED: usize = 4;

/// A reader of files below a folder.
pub(crate) struct Reader {
    pub(crate) name: &'static str,
    /// Reads everything; the error is the message that a user would see.
    pub(crate) read: fn(&Path) -> Result<(), String>,
}

/// All readers.
pub(crate) const READERS: [Reader; 22] = [
    reader("tum", sequence),
    reader("eth3d", sequence),
    reader("scannet", sequence),
    reader("sens", sequence),
    reader("record3d", sequence),
    reader("replica", sequence),
    reader("seven-scenes", sequence),
    reader("nerfstudio", sequence),
    reader("plain", sequence),
    reader("pictures", pictures),
    reader("video", video),
    reader("camera", camera),
    reader("import-nerfstudio", import),
    reader("import-colmap", import),
    reader("import-arrays", import),
    reader("import-archive", import_archive),
    reader("import-trajectory", import),
    reader("trajectory", trajectory),
    reader("frame-list", frame_list),
    reader("result", result),
    reader("config", config),
    reader("synth-spec", synth_spec),
];

/// A reader that misbehaves as its file says, for the tests of this program.
pub(crate) const MISBEHAVING: Reader = reader("misbehaving", misbehave);

const fn reader(name: &'static str, read: fn(&Path) -> Result<(), String>) -> Reader {
    Reader { name, read }
}

/// The reader with a name.
pub(crate) fn find(name: &str) -> Option<&'static Reader> {
    READERS.iter().chain([&MISBEHAVING]).find(|reader| reader.name == name)
}

fn text(error: DatasetError) -> String {
    error.to_string()
}

fn sequence(folder: &Path) -> Result<(), String> {
    let with_depth = open(folder, &OpenOptions::default());
    if with_depth.is_err() {
        let colour_only = OpenOptions { colour_only: true, guess_camera: true, ..small() };
        // Its message is that of another way to read the folder.
        let _ = open(folder, &colour_only);
    }
    with_depth
}

fn small() -> OpenOptions {
    OpenOptions { max_side: Some(640), turn_pictures: true, ..OpenOptions::default() }
}

/// Opens a sequence and loads its first frames and its ground truth.
fn open(path: &Path, options: &OpenOptions) -> Result<(), String> {
    let sequence = Sequence::open(path, options).map_err(text)?;
    // Each is read, whatever became of those before.
    let frames: Vec<_> = (0..sequence.len().min(LOADED)).map(|i| sequence.load(i)).collect();
    sequence.true_trajectory().map_err(text)?;
    frames.into_iter().try_for_each(|frame| frame.map(drop)).map_err(text)
}

fn pictures(folder: &Path) -> Result<(), String> {
    open(folder, &OpenOptions { colour_only: true, guess_camera: true, ..small() })
}

fn video(folder: &Path) -> Result<(), String> {
    let options = OpenOptions { colour_only: true, guess_camera: true, ..small() };
    open(&folder.join("clip.mp4"), &options)
}

/// The file in `lens/` as the option that names a camera file, and the folder `frames/`.
fn camera(folder: &Path) -> Result<(), String> {
    let lens = folder.join("lens");
    let files = fs::read_dir(&lens).into_iter().flatten().flatten();
    let camera = files.map(|entry| entry.path()).min();
    let camera = Some(camera.unwrap_or_else(|| lens.join("camera.json")));
    open(&folder.join("frames"), &OpenOptions { camera, ..OpenOptions::default() })
}

fn import(folder: &Path) -> Result<(), String> {
    let pictures = folder.join("pictures");
    let variance = Some(folder.join("variance")).filter(|path| path.is_dir());
    import_from(&folder.join("poses"), Some(pictures).filter(|path| path.is_dir()), variance)
}

fn import_archive(folder: &Path) -> Result<(), String> {
    import_from(&folder.join("run.npz"), None, None)
}

fn import_from(
    poses: &Path,
    pictures: Option<PathBuf>,
    variance: Option<PathBuf>,
) -> Result<(), String> {
    let options = ImportOptions {
        variance,
        depth: ImportDepth::Imported,
        open: OpenOptions { guess_camera: true, ..ImportOptions::default().open },
        ..ImportOptions::default()
    };
    let files = ImportedKeyframes::open(poses, pictures.as_deref(), &options).map_err(text)?;
    let loaded: Vec<_> = (0..files.len().min(LOADED)).map(|i| files.load(i)).collect();
    loaded.into_iter().try_for_each(|keyframe| keyframe.map(drop)).map_err(text)
}

fn trajectory(folder: &Path) -> Result<(), String> {
    read_trajectory(folder.join("trajectory.txt")).map(drop).map_err(text)
}

fn frame_list(folder: &Path) -> Result<(), String> {
    let path = folder.join("frames.txt");
    let named = |what: String| format!("{}: {what}", path.display());
    // The programs that take such a list read it whole before.
    let bytes = bounded(&path).map_err(named)?;
    let words = String::from_utf8(bytes).map_err(|_| named("no text".into()))?;
    let frames = i2slam_eval::frame_list::parse(&words);
    frames.map(drop).map_err(|line| named(format!("line {line} is no frame")))
}

fn result(folder: &Path) -> Result<(), String> {
    let loaded = i2slam_result::load(folder).map_err(|e| e.to_string());
    let input = RunInput::load(folder).map_err(|e| e.to_string());
    let loaded = loaded?;
    // What was accepted can be drawn and described.
    let described = (loaded.map.to_string(), loaded.trajectory().len(), loaded.typical_tone());
    if described.0.is_empty() {
        return Err(format!("{}: a map without description", folder.display()));
    }
    input.map(drop)
}

fn config(folder: &Path) -> Result<(), String> {
    let path = folder.join("config.toml");
    let stored = Config::from_stored_file(&path);
    let config = Config::from_toml_file(&path, None).map_err(|e| e.to_string())?;
    // Settings that are accepted can be written, and read again.
    Config::from_toml(&config.to_toml(), "config.toml written again", None)
        .map_err(|e| e.to_string())?;
    stored.map(drop).map_err(|e| e.to_string())
}

fn synth_spec(folder: &Path) -> Result<(), String> {
    let path = folder.join("spec.toml");
    Spec::from_toml_file(&path).map(drop).map_err(|error| match error {
        // The program adds file and line.
        SyntheticError::OutOfRange { .. } => format!("{}: {error}", path.display()),
        error => error.to_string(),
    })
}

/// Reads a small regular file.
fn bounded(path: &Path) -> Result<Vec<u8>, String> {
    let found = fs::metadata(path).map_err(|e| e.to_string())?;
    match found.is_file() && found.len() < 1 << 24 {
        true => fs::read(path).map_err(|e| e.to_string()),
        false => Err("no regular file of at most 16 MB".into()),
    }
}

fn misbehave(folder: &Path) -> Result<(), String> {
    let path = folder.join("act.txt");
    let act = bounded(&path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    match act.unwrap_or_default().trim() {
        "accept" => Ok(()),
        "panic" => panic!("as asked"),
        "panic in a thread" => {
            let thread = std::thread::spawn(|| panic!("in a thread"));
            // A caller that goes on hides it.
            drop(thread.join());
            Ok(())
        }
        "abort" => std::process::abort(),
        "hang" => loop {
            std::thread::sleep(std::time::Duration::from_secs(60));
        },
        "overflow the stack" => Err(format!("{}", overflow(&[0; 512]))),
        "reserve" => Err(format!("{}: {}", path.display(), vec![0_u8; 3 << 30].len())),
        "say nothing" => Err(String::new()),
        "name no file" => Err("something is wrong".into()),
        "show an error's insides" => Err(format!("{}: Error {{ kind: 3 }}", path.display())),
        "print" => {
            println!("a library prints");
            Ok(())
        }
        _ => Err(format!("{}: no act", path.display())),
    }
}

#[expect(unconditional_recursion, reason = "the stack overflows, as asked")]
fn overflow(bytes: &[usize; 512]) -> usize {
    let mut next = *bytes;
    next[bytes[1] % 512] += 1;
    overflow(&next) + next[7]
}
