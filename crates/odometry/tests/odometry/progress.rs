//! Progress reports and cancellation.

use crate::scene::{camera, moving, picture, tracked};
use i2slam_compute::CancellationToken;
use i2slam_odometry::{Intrinsics, OdometryError, Progress, Reconstruction, Stage};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

type Reports = Vec<(Stage, usize, usize)>;

/// Reconstructs 40 pictures; cancelled by the first report for which `cancels` is true.
fn reconstruct(
    cancels: impl Fn(Stage, usize) -> bool + Send + Sync + 'static,
) -> (Result<Reconstruction, OdometryError>, Reports) {
    let pictures = (0..40).map(|i| picture(1, moving(i), 1.0));
    let front_end = tracked(Intrinsics::Guess(camera()), pictures);
    let (reports, cancelled) =
        (Arc::new(Mutex::new(Reports::new())), Arc::new(AtomicBool::new(false)));
    let (received, cancel) = (Arc::clone(&reports), Arc::clone(&cancelled));
    let listener = move |stage, done, of| {
        received.lock().expect("no panics").push((stage, done, of));
        cancel.fetch_or(cancels(stage, done), Ordering::SeqCst);
    };
    let cancellation = CancellationToken::when(move || cancelled.load(Ordering::SeqCst));
    let found = front_end.finish(Progress::new(cancellation, listener));
    let reports = reports.lock().expect("no panics").clone();
    (found, reports)
}

#[test]
fn stages_are_reported_with_their_counts() {
    let (found, reports) = reconstruct(|_, _| false);
    let found = found.expect("a path");
    let first = |stage: Stage| reports.iter().position(|(s, ..)| *s == stage);
    let order =
        [Stage::RollingShutter, Stage::FocalLength, Stage::Registration, Stage::LoopClosure]
            .map(first);
    assert!(order.iter().all(Option::is_some) && order.is_sorted(), "{reports:?}");
    let counts = reports.iter().filter(|(stage, ..)| *stage == Stage::Registration);
    let counts: Vec<(usize, usize)> = counts.map(|(_, done, of)| (*done, *of)).collect();
    assert!(counts.is_sorted() && counts.iter().all(|(done, of)| done <= of), "{counts:?}");
    assert_eq!(counts.last().map(|(done, _)| *done), Some(found.keyframes.len()));
}

#[test]
fn cancellation_takes_effect_within_two_reports() {
    for (at, done) in
        [(Stage::FocalLength, 0), (Stage::Registration, 4), (Stage::RollingShutter, 0)]
    {
        let (found, reports) = reconstruct(move |stage, count| stage == at && count >= done);
        assert_eq!(found.err(), Some(OdometryError::Cancelled), "{at:?}");
        let cancelled = reports.iter().position(|(stage, count, _)| *stage == at && *count >= done);
        let after = reports.len() - 1 - cancelled.expect("reports");
        assert!(after <= 2, "{at:?}: {reports:?}");
    }
}
