//! Time and memory of the kernels of both maps, beside the limits of the machine.
//!
//! ```sh
//! cargo bench -p i2slam-radiance --bench kernels              # all tables
//! cargo bench -p i2slam-radiance --bench kernels -- machine   # one of: machine, stages, step,
//!                                                             # size, memory, rays
//! ```
//!
//! Every table is printed as lines of comma-separated values under a line `# name`; every time is
//! the fastest of many. `docs/performance.py` makes `docs/performance.md` of them, and
//! `scripts/compare` compares them between two commits by the lines that begin with `time,`.

mod counts;
mod field;
mod gaussians;
mod machine;

/// Name of a table and the function that prints it.
type Table = (&'static str, fn());

const TABLES: [Table; 6] = [
    ("machine", machine::print),
    ("stages", gaussians::print_stages),
    ("step", gaussians::print_step),
    ("size", gaussians::print_sizes),
    ("memory", gaussians::print_memory),
    ("rays", field::print),
];

fn main() {
    let asked: Vec<_> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    for (name, print) in TABLES {
        if asked.is_empty() || asked.iter().any(|word| word == name) {
            println!("# {name}");
            print();
        }
    }
}

/// The fastest of at least `rounds` runs that take at least `least` seconds together [s].
fn fastest(rounds: usize, least: f64, mut work: impl FnMut()) -> f64 {
    let (mut best, mut total, mut count) = (f64::MAX, 0.0, 0);
    while count < rounds || total < least {
        let clock = std::time::Instant::now();
        work();
        let seconds = clock.elapsed().as_secs_f64();
        (best, total, count) = (best.min(seconds), total + seconds, count + 1);
    }
    best
}

/// Runs `work` on a pool of `threads` threads, inside of it.
fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> Option<R> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok()?;
    Some(pool.install(work))
}
