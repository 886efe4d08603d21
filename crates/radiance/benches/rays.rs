//! Time of a training batch of the hash-grid field at its full size: 4096 rays drawn from all over
//! a room. Rates, and shares of the machine's peak, are the table `rays` of the bench `kernels`.
//!
//! `textbook_*` is the reference lane in `f32` on one thread for a sixteenth of the rays.

#[path = "kernels/room.rs"]
mod room;

use divan::{Bencher, black_box};
use i2slam_radiance::hashgrid::*;
use room::*;

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn forward(bencher: Bencher<'_, '_>) {
    let ((field, occupancy), rays) = (scene(), rays());
    let (mut renderer, mut renders) = (FieldRenderer::new(march()), Vec::new());
    bencher.bench_local(|| renderer.render(black_box(&field), &occupancy, &rays, &mut renders));
}

fn backward(bencher: Bencher<'_, '_>, with_field: bool, with_rays: bool) {
    let ((field, occupancy), rays, cotangents) = (scene(), rays(), cotangents());
    let (mut renderer, mut by_rays) = (FieldRenderer::new(march()), Vec::new());
    renderer.keep_slopes(with_rays);
    renderer.render(&field, &occupancy, &rays, &mut Vec::new());
    let mut gradient = FieldGradient::zeros(&field);
    bencher.bench_local(|| {
        let gradient = with_field.then_some(&mut gradient);
        let by_rays = with_rays.then_some(&mut by_rays);
        renderer.pull_back(black_box(&field), &rays, &cotangents, gradient, by_rays);
    });
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_field(bencher: Bencher<'_, '_>) {
    backward(bencher, true, false);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_rays(bencher: Bencher<'_, '_>) {
    backward(bencher, false, true);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_field_and_rays(bencher: Bencher<'_, '_>) {
    backward(bencher, true, true);
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn textbook_forward_and_backward_of_a_sixteenth(bencher: Bencher<'_, '_>) {
    let ((field, occupancy), rays, cotangents) = (scene(), rays(), cotangents());
    let mut gradient = FieldGradient::zeros(&field);
    let parts = textbook(&field, &occupancy, &rays, &cotangents);
    bencher.bench_local(|| {
        render_textbook(&field, &parts);
        pull_back_textbook(&field, &parts, &mut gradient);
    });
}
