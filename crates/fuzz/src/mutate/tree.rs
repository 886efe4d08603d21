//! Changes of the files of a folder: missing, of another kind, of another content.

use crate::case::{Case, Oddity};
use i2slam_compute::Random;

/// Size of an oversize file [bytes], above the memory of a case.
const OVERSIZE: u64 = 3 << 30;

/// Makes one change.
pub(super) fn change(case: &mut Case, random: &mut Random) {
    let Some(name) = super::chosen_file(&case.files, random) else { return };
    let odd = match random.below(10) {
        0 | 1 => return drop(case.files.remove(&name)),
        2 => return drop(case.files.insert(name, Vec::new())),
        3 => return swap(case, &name, random),
        4 => Oddity::Folder,
        5 => Oddity::DanglingLink,
        6 => Oddity::LinkToItself,
        7 => Oddity::EndlessDevice,
        8 => Oddity::Pipe,
        _ => Oddity::Sparse(OVERSIZE),
    };
    case.files.remove(&name);
    case.oddities.push((name, odd));
}

/// Exchanges the contents of two files.
fn swap(case: &mut Case, name: &str, random: &mut Random) {
    let names: Vec<String> = case.files.keys().cloned().collect();
    let other = &names[random.below(names.len())];
    let (a, b) = (case.files[name].clone(), case.files[other].clone());
    case.files.insert(name.to_owned(), b);
    case.files.insert(other.clone(), a);
}
