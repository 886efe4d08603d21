//! The golden numbers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(crate) fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

pub(crate) fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

pub(crate) type Numbers = BTreeMap<String, f64>;

pub(crate) fn numbers(name: &str) -> Numbers {
    let text = read(&golden(name));
    let pairs = text.lines().filter_map(|l| l.split_once(' '));
    pairs.map(|(k, v)| (k.to_owned(), v.parse().unwrap())).collect()
}
