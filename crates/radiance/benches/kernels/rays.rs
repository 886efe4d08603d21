//! Rays of a hash-grid field, forward and back to its parameters.

use super::{counts, machine, on_threads, room};
use i2slam_check::processor_seconds;
use i2slam_radiance::hashgrid::{FieldGradient, FieldRenderer};

/// Rounds, in each of which every lane has its turn.
const ROUNDS: usize = 16;

/// Least times forward and back \[s of the processor\].
type Times = [f64; 2];

/// Both lanes on one thread. Times are the processor's own, without what other programs take.
pub(crate) fn print() {
    println!(
        "lane,rays,samples,forward_ms,backward_ms,rays_per_s,million_samples_per_s,gflop_per_s,\
         share_of_peak"
    );
    if on_threads(1, measure).is_none() {
        eprintln!("rays: no threads");
    }
}

fn measure() {
    let (field, occupancy) = room::scene();
    let (rays, cotangents) = (room::rays(), room::cotangents());
    let mut gradient = FieldGradient::zeros(&field);
    let (mut renderer, mut renders) = (FieldRenderer::new(room::march()), Vec::new());
    let parts = room::textbook(&field, &occupancy, &rays, &cotangents);
    let mut best = [[f64::MAX; 2]; 2];
    for _ in 0..ROUNDS {
        let clock = processor_seconds();
        renderer.render(&field, &occupancy, &rays, &mut renders);
        let between = processor_seconds();
        renderer.pull_back(&field, &rays, &cotangents, Some(&mut gradient), None);
        keep(&mut best[0], [between - clock, processor_seconds() - between]);
        let clock = processor_seconds();
        room::render_textbook(&field, &parts);
        let between = processor_seconds();
        room::pull_back_textbook(&field, &parts, &mut gradient);
        keep(&mut best[1], [between - clock, processor_seconds() - between]);
    }
    let count = counts::field(field.settings());
    let peak = machine::flops(1);
    let of_textbook = parts.iter().map(|(_, _, samples)| samples.len()).sum();
    let lanes = [("cpu", rays.len(), renderer.samples()), ("textbook", parts.len(), of_textbook)];
    for ((lane, rays, samples), [forward, backward]) in lanes.into_iter().zip(best) {
        let both = forward + backward;
        let flops = (count.forward + count.backward) * samples as f64 / both;
        println!(
            "{lane},{rays},{samples},{:.1},{:.1},{:.0},{:.3},{:.1},{:.3}",
            1e3 * forward,
            1e3 * backward,
            rays as f64 / both,
            samples as f64 / both / 1e6,
            flops / 1e9,
            flops / peak
        );
    }
    println!("time,rays/forward,{:.6e}", best[0][0]);
    println!("time,rays/backward,{:.6e}", best[0][1]);
}

fn keep(best: &mut Times, times: Times) {
    best.iter_mut().zip(times).for_each(|(best, time)| *best = best.min(time));
}
