//! A search that somebody watches, and ends.

mod scene;

use i2slam_compute::CancellationToken;
use i2slam_odometry::{FrontEnd, Intrinsics, OdometryError, Progress, Reconstruction, Stage};
use scene::{INTERVAL, camera, moving, picture};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

type Told = Vec<(Stage, usize, usize)>;

/// Searches through 40 pictures; the search is to end once `enough` is told.
fn search(
    enough: impl Fn(Stage, usize) -> bool + Send + Sync + 'static,
) -> (Result<Reconstruction, OdometryError>, Told) {
    let mut front_end = FrontEnd::new(Intrinsics::Guess(camera()));
    for i in 0..40 {
        front_end.push(&picture(1, moving(i), 1.0), i as f64 * INTERVAL).expect("a picture");
    }
    let (told, wished) = (Arc::new(Mutex::new(Told::new())), Arc::new(AtomicBool::new(false)));
    let (book, wish) = (Arc::clone(&told), Arc::clone(&wished));
    let listener = move |stage, done, of| {
        book.lock().expect("no panics").push((stage, done, of));
        wish.fetch_or(enough(stage, done), Ordering::SeqCst);
    };
    let cancellation = CancellationToken::when(move || wished.load(Ordering::SeqCst));
    let found = front_end.finish_with_progress(Progress::new(cancellation, listener));
    let told = told.lock().expect("no panics").clone();
    (found, told)
}

#[test]
fn stages_are_told_with_their_counts() {
    let (found, told) = search(|_, _| false);
    let found = found.expect("a path");
    let first = |stage: Stage| told.iter().position(|(s, ..)| *s == stage);
    let order =
        [Stage::RollingShutter, Stage::FocalLength, Stage::Registration, Stage::LoopClosure]
            .map(first);
    assert!(order.iter().all(Option::is_some) && order.is_sorted(), "{told:?}");
    let counts = told.iter().filter(|(stage, ..)| *stage == Stage::Registration);
    let counts: Vec<(usize, usize)> = counts.map(|(_, done, of)| (*done, *of)).collect();
    assert!(counts.is_sorted() && counts.iter().all(|(done, of)| done <= of), "{counts:?}");
    assert_eq!(counts.last().map(|(done, _)| *done), Some(found.keyframes.len()));
}

#[test]
fn a_search_that_is_to_end_ends_with_what_it_is_at() {
    for (at, done) in
        [(Stage::FocalLength, 0), (Stage::Registration, 4), (Stage::RollingShutter, 0)]
    {
        let (found, told) = search(move |stage, count| stage == at && count >= done);
        assert_eq!(found.err(), Some(OdometryError::Cancelled), "{at:?}");
        let wished = told.iter().position(|(stage, count, _)| *stage == at && *count >= done);
        let after = told.len() - 1 - wished.expect("told");
        assert!(after <= 2, "{at:?}: {told:?}");
    }
}
