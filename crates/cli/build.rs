//! Lists the files of the demo clip, so that the program carries them.

use std::env;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

fn main() {
    let manifest = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let clip = manifest.join("assets/demo");
    println!("cargo::rerun-if-changed={}", clip.display());
    let mut files = Vec::new();
    collect(&clip, &mut files);
    files.sort();
    let mut code = String::from("pub(crate) static CLIP: &[(&str, &[u8])] = &[\n");
    for file in &files {
        let name = file.strip_prefix(&clip).expect("a file of the clip");
        let name = name.to_string_lossy().replace('\\', "/");
        writeln!(code, "    ({name:?}, include_bytes!({:?})),", file.display().to_string())
            .expect("room for a list");
    }
    code += "];\n";
    let out = PathBuf::from(env::var("OUT_DIR").expect("set by cargo")).join("clip.rs");
    fs::write(out, code).expect("the build folder can be written");
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).expect("assets/demo holds the demo clip");
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.is_dir() {
            collect(&path, files);
        } else {
            files.push(path);
        }
    }
}
