//! Rays of a hash-grid field, forward and back to its parameters.

use super::{counts, machine, on_threads, room};
use i2slam_radiance::hashgrid::{FieldGradient, FieldRenderer};
use std::time::Instant;

/// Rounds, in each of which every lane has its turn.
const ROUNDS: usize = 16;

/// Fastest times forward and back \[s\].
type Times = [f64; 2];

/// The fast lane on one thread and on all, then the plain one on one.
pub(crate) fn print() {
    let (field, occupancy) = room::scene();
    let (rays, cotangents) = (room::rays(), room::cotangents());
    let mut gradient = FieldGradient::zeros(&field);
    let (mut renderer, mut renders) = (FieldRenderer::new(room::march()), Vec::new());
    let parts = room::textbook(&field, &occupancy, &rays, &cotangents);
    let all = rayon::current_num_threads();
    let mut best = [[f64::MAX; 2]; 3];
    for _ in 0..ROUNDS {
        for (k, threads) in [1, all].into_iter().enumerate() {
            let times = on_threads(threads, || {
                let clock = Instant::now();
                renderer.render(&field, &occupancy, &rays, &mut renders);
                let between = clock.elapsed().as_secs_f64();
                renderer.pull_back(&field, &rays, &cotangents, Some(&mut gradient), None);
                [between, clock.elapsed().as_secs_f64() - between]
            });
            keep(&mut best[k], times.unwrap_or([f64::NAN; 2]));
        }
        let clock = Instant::now();
        room::render_textbook(&field, &parts);
        let between = clock.elapsed().as_secs_f64();
        room::pull_back_textbook(&field, &parts, &mut gradient);
        keep(&mut best[2], [between, clock.elapsed().as_secs_f64() - between]);
    }
    println!(
        "lane,threads,rays,samples,forward_ms,backward_ms,rays_per_s,million_samples_per_s,\
         gflop_per_s,share_of_peak"
    );
    let of_textbook = (parts.len(), parts.iter().map(|part| part.2.len()).sum());
    let count = counts::field(field.settings());
    let rows = [
        ("cpu", 1, (rays.len(), renderer.samples())),
        ("cpu", all, (rays.len(), renderer.samples())),
        ("textbook", 1, of_textbook),
    ];
    for ((lane, threads, (rays, samples)), [forward, backward]) in rows.into_iter().zip(best) {
        let both = forward + backward;
        let flops = (count.forward + count.backward) * samples as f64 / both;
        println!(
            "{lane},{threads},{rays},{samples},{:.2},{:.2},{:.0},{:.3},{:.1},{:.3}",
            1e3 * forward,
            1e3 * backward,
            rays as f64 / both,
            samples as f64 / both / 1e6,
            flops / 1e9,
            flops / machine::flops(threads)
        );
    }
    println!("time,rays/forward,{:.6e}", best[0][0]);
    println!("time,rays/backward,{:.6e}", best[0][1]);
}

fn keep(best: &mut Times, times: Times) {
    best.iter_mut().zip(times).for_each(|(best, time)| *best = best.min(time));
}
