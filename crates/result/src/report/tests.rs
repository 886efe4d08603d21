//! The page, from a reconstruction made by hand.

use super::*;
use crate::tests::example;
use i2slam::geometry::Image;

/// A picture of stripes.
fn picture(phase: f32, sharpness: f32) -> Image<f32> {
    Image::from_fn(96, 72, 3, |channel, x, y| {
        let wave = (0.4 * x as f32 + phase + channel as f32).sin() * (0.3 * y as f32).cos();
        0.5 + sharpness * wave
    })
}

fn comparison(index: usize) -> Comparison {
    let phase = index as f32;
    let mut depth = Image::new(96, 72, 1);
    depth.data.iter_mut().enumerate().for_each(|(i, d)| *d = 1.0 + (i % 96) as f32 / 48.0);
    Comparison {
        index,
        input: picture(phase, 0.15),
        sharp: picture(phase, 0.45),
        blurred: picture(phase, 0.16),
        depth,
        brackets: [-2.0, 0.0, 2.0].map(|ev| (ev, picture(phase, 0.3))).to_vec(),
    }
}

fn page(title: &str, frames: usize) -> String {
    let reconstruction = example(frames);
    let metrics = Metrics {
        ate_rmse_m: Some(0.0171),
        psnr_blurred_db: Some(31.2),
        ..Metrics::of(&reconstruction)
    };
    let ground_truth = reconstruction.trajectory();
    let shown = frames_to_show(&reconstruction.frames, 4);
    let comparisons: Vec<_> =
        shown.iter().map(|&i| comparison(reconstruction.frames[i].index)).collect();
    let true_exposure: Vec<(usize, f64)> = reconstruction
        .frames
        .iter()
        .map(|f| (f.index, 0.01 * f64::from(f.tone.exposure())))
        .collect();
    Report {
        title,
        reconstruction: &reconstruction,
        metrics: &metrics,
        ground_truth: &ground_truth,
        metres_per_unit: 1.0,
        true_exposure: &true_exposure,
        comparisons: &comparisons,
        files: &FrameFiles::default(),
        viewer: Ok(4_890_000),
    }
    .html(|name| name != "map.ply")
}

#[test]
fn the_page_needs_nothing_else() {
    let page = page("a <b>&\" sequence", 40);
    assert!(page.contains("a &lt;b&gt;&amp;&quot; sequence") && !page.contains("a <b>&\""));
    assert!(!page.contains("{{"));
    let outside = ["src=\"http", "href=\"http", "url(http", "@import", "src=\"\"", "NaN"];
    for address in outside {
        assert!(!page.contains(address), "{address}");
    }
    assert!(page.contains("<a href=\"viewer.html\">") && page.contains("4.89 MB"));
    assert_eq!(page.matches("<figure class=\"plot\">").count(), 12);
    assert_eq!(page.matches("<figure class=\"pair").count(), 4);
}

#[test]
fn a_run_without_frames_has_a_page_too() {
    let page = page("nothing", 0);
    assert!(page.contains("No frame was processed") && !page.contains("NaN"));
}

#[test]
fn a_report_without_a_viewer_says_why() {
    let reconstruction = example(2);
    let metrics = Metrics::of(&reconstruction);
    let page = |viewer, exists: bool| {
        let report = Report {
            title: "x",
            reconstruction: &reconstruction,
            metrics: &metrics,
            ground_truth: &[],
            metres_per_unit: 1.0,
            true_exposure: &[],
            comparisons: &[],
            files: &FrameFiles::default(),
            viewer,
        };
        report.html(|_| exists)
    };
    let grid = page(Err(NoViewer::HashGrid), false);
    assert!(grid.contains("No 3D view: a hash grid") && !grid.contains("<a href=\"viewer.html\">"));
    assert!(page(Ok(1_000_000), false).contains("viewer.html could not be written"));
}

#[test]
fn shown_frames_are_spread_and_blurred() {
    let mut frames = example(40).frames;
    frames.iter_mut().for_each(|f| f.blur_length = 1.0);
    frames[7].blur_length = 9.0;
    frames[33].blur_length = 5.0;
    let shown = frames_to_show(&frames, 8);
    assert_eq!(shown.len(), 8);
    assert!(shown.contains(&7) && shown.contains(&33) && shown.is_sorted());
    assert_eq!(frames_to_show(&frames[..3], 8), [0, 1, 2]);
}

#[test]
fn every_warning_is_there_with_its_time_and_many_are_folded() {
    assert_eq!(warning_section(&[]), "");
    let of = |count: usize| -> String {
        let warning = |i| Warning::of_frame(i, "a < b").with_time(|i| Some(0.5 * i as f64));
        warning_section(&(0..count).map(warning).collect::<Vec<_>>())
    };
    let two = of(2);
    assert!(two.contains("<li>frame 1: a &lt; b <small>at 0.50 s</small></li>"), "{two}");
    assert!(!two.contains("details"));
    let many = of(UNFOLDED + 3);
    assert!(many.contains("3 more") && many.matches("<li>").count() == UNFOLDED + 3, "{many}");
}

#[test]
fn a_degraded_result_says_so_first() {
    let reconstruction = example(3);
    let mut metrics = Metrics::of(&reconstruction);
    let lead = |metrics: &Metrics| {
        let report = Report {
            title: "x",
            reconstruction: &reconstruction,
            metrics,
            ground_truth: &[],
            metres_per_unit: 1.0,
            true_exposure: &[],
            comparisons: &[],
            files: &FrameFiles::default(),
            viewer: Err(NoViewer::Empty),
        };
        headline::lead(&report)
    };
    metrics.degrade([]);
    assert!(!metrics.degraded && !lead(&metrics).contains("degraded"));
    metrics.degrade(["0 of 3 frames were tracked: <b>".to_owned(), "the map is empty".to_owned()]);
    let due = "<strong>This result is degraded: 0 of 3 frames were tracked: &lt;b&gt;; the map is \
               empty.</strong> ";
    assert!(metrics.degraded && lead(&metrics).starts_with(due), "{}", lead(&metrics));
}
