//! The page, from a reconstruction made by hand.

use super::*;
use crate::tests::example;
use i2slam::radiance::gaussian::{ColourActivation, GaussianMap, Shape};

fn page(reconstruction: &Reconstruction) -> String {
    let picture = |frame: &FrameEstimate| (frame.index != 4).then(|| Image::new(1000, 40, 3));
    let files = FrameFiles::from_iter([(4, "x/IMG <1>.jpg".to_owned())]);
    ViewerPage::of("a <b> sequence", reconstruction, &files).html(picture).expect("a page")
}

/// The text of the element with that identifier.
fn element<'a>(page: &'a str, id: &str) -> &'a str {
    let after = page.split_once(&format!("id=\"{id}\">")).expect("the element").1;
    after.split_once("</script>").expect("its end").0
}

#[test]
fn the_page_needs_nothing_else() {
    let page = page(&example(12));
    assert!(page.contains("a &lt;b&gt; sequence") && !page.contains("a <b>"));
    assert!(!page.contains("{{"));
    let outside = ["src=\"http", "href=\"http", "url(http", "@import", "fetch(", "import("];
    for address in outside {
        assert!(!page.contains(address), "{address}");
    }
    assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
}

#[test]
fn the_page_holds_map_and_frames() {
    let reconstruction = example(12);
    let page = page(&reconstruction);
    let scene: serde_json::Value = serde_json::from_str(element(&page, "scene")).expect("JSON");
    let count = scene["gaussians"].as_u64().expect("a count") as usize;
    assert_eq!(count, reconstruction.map.gaussians());
    let map = STANDARD.decode(element(&page, "map")).expect("base64");
    assert_eq!(map.len(), 18 * count + 72);
    let frames = scene["frames"].as_array().expect("frames");
    let indices: Vec<_> = frames.iter().filter_map(|frame| frame["index"].as_u64()).collect();
    // Frame 3 of the example, of index 6, was not tracked.
    assert_eq!(indices, [0, 2, 4, 8, 10, 12, 14, 16, 18, 20, 22]);
    let has_picture = |frame: &serde_json::Value| frame["picture"] != "";
    assert!(frames.iter().all(|frame| has_picture(frame) == (frame["index"] != 4)));
    let names: Vec<_> = frames.iter().filter_map(|frame| frame["name"].as_str()).collect();
    assert_eq!(names[..4], ["0", "2", "4, x/IMG <1>.jpg", "8"]);
    assert!(!page.contains("IMG <1>"));
    assert_eq!(scene["tone"], true);
    let up: Vec<f64> = serde_json::from_value(scene["up"].clone()).expect("a direction");
    assert!((up.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-6 && up[1] < -0.5, "{up:?}");
}

#[test]
fn every_part_has_its_place() {
    let template = include_str!("page/page.html");
    for (key, text) in PARTS {
        assert!(template.contains(&format!("{{{{{key}}}}}")), "{key}");
        assert!(!text.contains("</script"), "{key}");
    }
}

#[test]
fn maps_without_gaussians_have_no_page_and_say_why() {
    let mut reconstruction = example(3);
    reconstruction.map = Map::default();
    let empty = ViewerPage::of("x", &reconstruction, &FrameFiles::default()).html(|_| None);
    assert_eq!(empty, Err(NoViewer::Empty));
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    map.means = vec![[0.0; 3]; MAX_GAUSSIANS + 1];
    reconstruction.map = Map::Gaussians(map);
    let (frames, up) = (reconstruction.frames.as_slice(), Vec3::new(0.0, -1.0, 0.0));
    let (title, generator, reconstruction) = ("x", "i2slam", &reconstruction);
    let files = &FrameFiles::default();
    let page = ViewerPage { title, reconstruction, frames, files, up, generator };
    let large = page.html(|_| None).expect_err("too large");
    assert!(large.to_string().contains("4000001 Gaussians"), "{large}");
}

#[test]
fn large_pictures_are_made_smaller() {
    let size = |width, height| {
        let picture = within(Image::new(width, height, 3), MAX_SIDE);
        (picture.width, picture.height)
    };
    assert_eq!(size(640, 480), (640, 480));
    assert_eq!(size(1920, 1080), (640, 360));
    assert_eq!(size(3, 9000), (1, 640));
}

#[test]
fn a_live_page_starts_empty_and_is_updated() {
    let mut reconstruction = example(12);
    let files = FrameFiles::from_iter([(2, "IMG_1.jpg".to_owned())]);
    let update = ViewerPage::of_run("x", &reconstruction, &files).update().expect("an update");
    let update: serde_json::Value = serde_json::from_str(&update).expect("JSON");
    assert_eq!(update["scene"]["frames"].as_array().map(Vec::len), Some(11));
    assert_eq!(update["scene"]["frames"][1]["name"], "2, IMG_1.jpg");
    let map = STANDARD.decode(update["map"].as_str().expect("text")).expect("base64");
    assert_eq!(map.len(), 18 * reconstruction.map.gaussians() + 72);
    reconstruction.frames.clear();
    reconstruction.map = Map::default();
    let page = ViewerPage::of_run("x", &reconstruction, &files).live_html().expect("a page");
    assert!(page.contains("fetch(\"update?after=\""));
    let scene: serde_json::Value = serde_json::from_str(element(&page, "scene")).expect("JSON");
    assert_eq!((scene["gaussians"].as_u64(), element(&page, "map")), (Some(0), ""));
}
