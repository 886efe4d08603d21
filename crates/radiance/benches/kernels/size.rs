//! Cost by number of Gaussians and pixels.

use super::fastest;
use super::stages::Step;

const COUNTS: [usize; 4] = [10_000, 100_000, 1_000_000, 5_000_000];
const SIZES: [(usize, usize); 4] = [(160, 120), (320, 240), (640, 480), (1280, 960)];

/// Forward and backward of every number of Gaussians at every size of the picture.
pub(crate) fn print() {
    println!("gaussians,width,height,pairs,visited,rows,forward_ms,backward_ms");
    for count in COUNTS {
        for size in SIZES {
            let mut step = Step::new(count, size);
            let (mut forward, mut backward) = (f64::MAX, f64::MAX);
            fastest(3, 0.7, || {
                forward = forward.min(fastest(1, 0.0, || step.forward()));
                backward = backward.min(fastest(1, 0.0, || step.backward()));
            });
            let work = step.rasterizer.work();
            println!(
                "{count},{},{},{},{},{},{:.3},{:.3}",
                size.0,
                size.1,
                work.pairs,
                work.visited,
                work.rows,
                forward * 1e3,
                backward * 1e3
            );
        }
    }
}
