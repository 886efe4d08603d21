//! The machine's limits: multiply-adds in registers, and bytes from memory.

use super::{fastest, on_threads};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::hint::black_box;

/// Independent sums: enough to hide the latency of a multiply-add on two pipes.
const CHAINS: usize = 24;
const STEPS: usize = 100_000;

struct MultiplyAdds;

impl WithSimd for MultiplyAdds {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (a, b) = (simd.splat_f32s(black_box(0.999_9)), simd.splat_f32s(black_box(1e-4)));
        let mut sums: [S::f32s; CHAINS] = std::array::from_fn(|k| simd.splat_f32s(k as f32));
        for _ in 0..STEPS {
            for k in 0..CHAINS {
                sums[k] = simd.mul_add_e_f32s(sums[k], a, b);
            }
        }
        let mut total = simd.splat_f32s(0.0);
        for k in 0..CHAINS {
            total = simd.add_f32s(total, sums[k]);
        }
        simd.reduce_sum_f32s(total)
    }
}

struct LanesOf;

impl WithSimd for LanesOf {
    type Output = usize;

    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F32_LANES
    }
}

/// Operations per second in single precision: a multiply-add counts two.
pub(crate) fn flops(threads: usize) -> f64 {
    let arch = Arch::new();
    let operations = (arch.dispatch(LanesOf) * CHAINS * STEPS * 2 * threads) as f64;
    let seconds = on_threads(threads, || {
        fastest(20, 0.5, || {
            rayon::broadcast(|_| black_box(arch.dispatch(MultiplyAdds)));
        })
    });
    seconds.map_or(f64::NAN, |seconds| operations / seconds)
}

/// Numbers per array: far more than any cache holds.
const LONG: usize = 1 << 25;

struct Sum<'a>(&'a [f32]);

impl WithSimd for Sum<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (vectors, _) = S::as_simd_f32s(self.0);
        let mut sums = [simd.splat_f32s(0.0); 4];
        for four in vectors.chunks_exact(4) {
            for k in 0..4 {
                sums[k] = simd.add_f32s(sums[k], four[k]);
            }
        }
        let pairs = [simd.add_f32s(sums[0], sums[1]), simd.add_f32s(sums[2], sums[3])];
        simd.reduce_sum_f32s(simd.add_f32s(pairs[0], pairs[1]))
    }
}

/// Bytes per second: read only, and read and written by a copy.
pub(crate) fn bandwidth(threads: usize) -> (f64, f64) {
    let (from, mut to) = (vec![1.0_f32; LONG], vec![0.0_f32; LONG]);
    let (arch, part) = (Arch::new(), LONG / threads.max(1));
    let bytes = (LONG * size_of::<f32>()) as f64;
    let seconds = on_threads(threads, || {
        let read = fastest(8, 0.5, || {
            black_box(from.par_chunks(part).map(|part| arch.dispatch(Sum(part))).sum::<f32>());
        });
        let copied = fastest(8, 0.5, || {
            let parts = to.par_chunks_mut(part).zip(from.par_chunks(part));
            parts.for_each(|(to, from)| to.copy_from_slice(from));
            black_box(&to);
        });
        (read, copied)
    });
    seconds.map_or((f64::NAN, f64::NAN), |(read, copied)| (bytes / read, 2.0 * bytes / copied))
}

/// One line per number of threads.
pub(crate) fn print() {
    println!("threads,gflop_per_s,read_gb_per_s,copy_gb_per_s");
    for threads in [1, rayon::current_num_threads()] {
        let (read, copied) = bandwidth(threads);
        println!("{threads},{:.1},{:.1},{:.1}", flops(threads) / 1e9, read / 1e9, copied / 1e9);
    }
}
