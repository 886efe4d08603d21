//! Bytes per Gaussian, counted and measured.

use super::stages::Step;

const SIZE: (usize, usize) = (320, 240);
const COUNTS: [usize; 4] = [100_000, 300_000, 500_000, 700_000];

/// Bytes per Gaussian of the map: 14 numbers.
const MAP: usize = 14 * 4;
/// Of its gradient: as many, and whether it was seen.
const GRADIENT: usize = 14 * 4 + 1;
/// Of Adam's two moments of means, colours, opacities and scales, and its age.
const ADAM: usize = 2 * 10 * 4 + 4;
/// Of the footprint.
const FOOTPRINT: usize = 64;
/// Of a visible one: its item, sorted, and both buffers of the sort.
const ITEM: usize = 8 + 8 + 2 * 8;
/// Of a pair with a tile: entry, place, sums on the way back.
const PAIR: usize = 8 + 4 + 44;

/// Most resident memory of this process so far [bytes].
fn peak() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<usize>().ok().map(|kib| kib * 1024)
}

/// What a number of Gaussians is expected to take, and what the peak of the process grew by, from
/// one number to the next. Needs a process of its own: the peak never falls.
pub(crate) fn print() {
    println!("# bytes\npart,bytes");
    println!("map,{MAP}\ngradient,{GRADIENT}\nadam,{ADAM}\nfootprint,{FOOTPRINT}");
    println!("visible,{ITEM}\npair,{PAIR}");
    println!("# memory\ngaussians,pairs,counted_bytes,peak_bytes,counted_slope,measured_slope");
    let mut last: Option<(usize, usize, usize)> = None;
    for count in COUNTS {
        let mut step = Step::new(count, SIZE);
        step.forward();
        step.backward();
        step.adam();
        let work = step.rasterizer.work();
        let each = MAP + GRADIENT + ADAM + FOOTPRINT;
        let counted = each * count + ITEM * work.visible + PAIR * work.pairs;
        let Some(peak) = peak() else { return };
        let slope = |before: usize, now: usize, by: usize| (now - before) as f64 / by as f64;
        match last {
            Some((n, c, p)) => println!(
                "{count},{},{counted},{peak},{:.0},{:.0}",
                work.pairs,
                slope(c, counted, count - n),
                slope(p, peak, count - n)
            ),
            None => println!("{count},{},{counted},{peak},,", work.pairs),
        }
        last = Some((count, counted, peak));
    }
}
