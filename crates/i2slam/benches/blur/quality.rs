//! Each method against an exact exposure of 32 views, on a map of the demo clip.

use super::Outcome;
use super::fitted::{Fitted, psnr};
use i2slam::objective::{BlurMethod, Sampling};

const LENGTHS: [f64; 11] = [0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 40.0];

/// Tangents (ρ, φ) whose size does not matter.
const MOTIONS: [(&str, [f64; 6]); 3] = [
    ("rotation", [0.0, 0.0, 0.0, 0.6, 0.8, 0.5]),
    ("translation", [0.8, -0.6, 0.2, 0.0, 0.0, 0.0]),
    ("both", [0.6, 0.0, 0.3, 0.25, -0.1, 0.15]),
];

/// Views of the exact exposure.
const EXACT: usize = 32;

/// Frames whose poses the exposures are laid around.
const FRAMES: [usize; 3] = [6, 15, 24];

/// PSNR in decibels: the mean over the frames, and the least for the method `image`.
pub(crate) fn print() -> Outcome {
    let mut fitted = Fitted::demo()?;
    println!("motion,blur_px,views,margin_px,sharp,exact,image,image_least,image_without_margin");
    for (name, direction) in MOTIONS {
        for length in LENGTHS {
            let sampling = fitted.sampling(length, BlurMethod::Reprojected);
            let mut sums = [0.0; 4];
            let mut least = f64::MAX;
            for index in FRAMES {
                let values = compare(&mut fitted, index, direction, length);
                (0..4).for_each(|k| sums[k] += values[k] / FRAMES.len() as f64);
                least = least.min(values[2]);
            }
            let [sharp, exact, image, without] = sums;
            println!(
                "{name},{length},{},{},{sharp:.1},{exact:.1},{image:.1},{least:.1},\
                 {without:.1}",
                sampling.virtual_cameras, sampling.margin
            );
        }
    }
    Ok(())
}

/// Sharp, exact, image and image without a margin, against the exact exposure.
fn compare(fitted: &mut Fitted, index: usize, direction: [f64; 6], length: f64) -> [f64; 4] {
    let frame = fitted.scene.frames[index].clone();
    let depth = fitted.depth(frame.middle());
    let shutter = fitted.exposure(frame.middle(), &depth, direction, length);
    let sampling = |method| fitted.sampling(length, method);
    let image = sampling(BlurMethod::Reprojected);
    let methods = [
        Sampling::SINGLE_CAMERA,
        sampling(BlurMethod::Exact),
        image,
        Sampling { margin: 0, ..image },
    ];
    let exact = Sampling { virtual_cameras: EXACT, ..sampling(BlurMethod::Exact) };
    let reference = fitted.predict(&frame, shutter, exact);
    methods.map(|sampling| psnr(&fitted.predict(&frame, shutter, sampling), &reference))
}
