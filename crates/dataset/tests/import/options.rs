//! ImportOptions that say nothing of the files, and files that are named.

use crate::colmap::{text_model, write_binary};
use crate::droid::{folder, members};
use crate::scene::{sequence, trajectory};
use crate::{assert_says, assert_warns};
use i2slam_dataset::OpenOptions;
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};

#[test]
fn a_camera_that_does_not_count_is_told() {
    let intrinsics = Some([99.0, 99.0, 23.5, 15.5]);
    let open = OpenOptions { intrinsics, ..OpenOptions::default() };
    let options = ImportOptions { open, check_conventions: false, ..ImportOptions::default() };
    let (arrays, model) = (folder(&members(&[0, 1])), text_model(3, &[0, 1]));
    for path in [&arrays.0, &model.0] {
        let files = ImportedKeyframes::open(path, None, &options).expect("opens");
        assert_eq!(files.camera.fx, 40.0);
        assert_warns(&files.warnings, &["the given camera ignored"]);
    }
    let pictures = sequence(2);
    let files = ImportedKeyframes::open(&arrays.0, Some(&pictures.0), &options).expect("opens");
    assert_eq!(files.camera.fx, 99.0);
    assert!(!files.warnings.iter().any(|warning| warning.contains("ignored")));
}

#[test]
fn depth_pictures_that_are_not_read_are_told() {
    let pictures = sequence(3);
    let file = pictures.write("keyframes.txt", trajectory(0..3));
    let open = |depth: ImportDepth| {
        let options = ImportOptions { depth, ..ImportOptions::default() };
        ImportedKeyframes::open(&file, None, &options).expect("opens").warnings
    };
    assert_warns(&open(ImportDepth::Imported), &["no depth of its own", "not read"]);
    for depth in [ImportDepth::None, ImportDepth::Pictures] {
        assert_eq!(open(depth), [""; 0]);
    }
}

#[test]
fn the_text_of_a_model_is_read_where_it_is_named() {
    let folder = text_model(5, &[0, 2, 3]);
    write_binary(&folder, &[1, 4]);
    let len = |path: &str| {
        let files = ImportedKeyframes::open(&folder.join(path), None, &ImportOptions::default());
        files.expect("opens").len()
    };
    assert_eq!(["sparse/0/images.txt", "sparse/0/images.bin", ""].map(len), [3, 2, 2]);
}

#[test]
fn a_file_of_torch_is_told_how_to_convert() {
    let folder = sequence(1);
    for (name, start) in [("run.pth", "PK"), ("run.pt", "PK"), ("run", "PK run/data.pkl")] {
        let file = folder.write(name, start);
        let files = ImportedKeyframes::open(&file, None, &ImportOptions::default());
        assert_says(files, &["torch.save", "np.savez", "docs/import.md"]);
    }
}
