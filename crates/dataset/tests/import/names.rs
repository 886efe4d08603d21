//! Names of a model's images that have folders, repeat, or are none.

use crate::colmap::{images_binary, images_named, text_model, write_binary};
use crate::scene::{colour_png, colour_sequence};
use crate::support::Folder;
use crate::{assert_says, assert_warns};
use i2slam_dataset::import::{ImportOptions, ImportedKeyframes};

fn open(folder: &Folder) -> ImportedKeyframes {
    ImportedKeyframes::open(&folder.0, None, &ImportOptions::default()).expect("opens")
}

/// The picture of every keyframe, below `images/`.
fn pictures(files: &ImportedKeyframes) -> Vec<String> {
    let sequence = files.sequence().expect("a sequence");
    let name = |index: usize| {
        let path = &sequence.entries[index].colour;
        let (_, below) = path.to_str().expect("a name").rsplit_once("images/").expect("images/");
        below.to_owned()
    };
    files.keyframes.iter().map(|keyframe| name(keyframe.index)).collect()
}

/// A model of images of some names, and pictures `images/PATH`.
fn model(names: &[&str], pictures: &[&str]) -> Folder {
    let folder = text_model(1, &[]);
    std::fs::remove_dir_all(folder.join("images")).expect("removes");
    folder.write("sparse/0/images.txt", images_named(names));
    for (i, path) in pictures.iter().enumerate() {
        folder.write(&format!("images/{path}"), colour_png(i));
    }
    folder
}

#[test]
fn pictures_in_folders_are_found_by_their_whole_names() {
    let names = ["right/1.png", "left/0.png", "left/1.png"];
    let folder = model(&names, &["left/0.png", "left/1.png", "right/0.png", "right/1.png"]);
    let files = open(&folder);
    assert_eq!(pictures(&files), ["left/0.png", "left/1.png", "right/1.png"]);
    assert_eq!(files.unmatched.images_without_pose, 1);
}

#[test]
fn a_name_with_another_folder_takes_no_picture_of_another_image() {
    let names = ["left/0.png", "right/0.png", "left/1.png", "left/2.png"];
    let files = open(&model(&names, &["0.png", "1.png", "2.png"]));
    assert_eq!(pictures(&files), ["1.png", "2.png"]);
    assert_warns(&files.warnings, &["2 of 4 poses left out", "left/0.png"]);
    // Two pictures end like the second name, and none is it.
    let names = ["left/0.png", "1.png", "2.png"];
    let files = open(&model(&names, &["left/0.png", "left/1.png", "right/1.png", "right/2.png"]));
    assert_eq!(pictures(&files), ["left/0.png", "right/2.png"]);
    assert_warns(&files.warnings, &["1 of 3 poses left out", "1.png"]);
}

#[test]
fn blank_lines_may_stand_before_an_image_only() {
    let folder = model(&["0.png"], &["0.png", "1.png", "2.png"]);
    let image =
        |i: usize| images_named(&["", "1.png", "2.png"]).lines().nth(2 * i).map(String::from);
    let (second, third) = (image(1).expect("a line"), image(2).expect("a line"));
    let text = format!("# head\n\n{second}\n\n\n# middle\n{third}\n1 2 -1 3 4 5\n\n");
    folder.write("sparse/0/images.txt", text);
    assert_eq!(pictures(&open(&folder)), ["1.png", "2.png"]);
    for (points, count) in [("1 2 -1 3", "4 columns"), (third.as_str(), "10 columns")] {
        folder.write("sparse/0/images.txt", format!("{second}\n{points}\n{third}\n\n"));
        let files = ImportedKeyframes::open(&folder.0, None, &ImportOptions::default());
        assert_says(files, &["images.txt, line 2", count, "2D points"]);
    }
}

#[test]
fn an_image_without_a_name_is_refused() {
    let folder = text_model(2, &[0, 1]);
    write_binary(&folder, &[0, 1]);
    let nameless = images_binary(&[0, 1]);
    let name = nameless.windows(7).position(|word| word == b"000.png").expect("a name");
    folder.write("sparse/0/images.bin", [&nameless[..name], &nameless[name + 7..]].concat());
    let files = ImportedKeyframes::open(&folder.0, None, &ImportOptions::default());
    assert_says(files, &["images.bin", "image 0 of 2", "no name"]);
}

#[test]
fn pictures_of_a_dataset_keep_their_times() {
    let folder = model(&["rgb/001.png", "rgb/002.png"], &["unused.png"]);
    let dataset = colour_sequence(3);
    let files = ImportedKeyframes::open(&folder.0, Some(&dataset.0), &ImportOptions::default())
        .expect("opens");
    let times: Vec<f64> = files.keyframes.iter().map(|keyframe| keyframe.timestamp).collect();
    assert_eq!(times, [1, 2].map(crate::scene::stamp));
}
