//! Independent streams of random numbers, one for every purpose and place.

use i2slam_compute::Random;

/// The stream of `place` for `purpose` under `seed`: the same numbers in any order of work.
pub(crate) fn stream(seed: u64, purpose: u64, place: u64) -> Random {
    let first = Random::new(seed ^ purpose.wrapping_mul(0xd6e8_feb8_6659_fd93)).bits();
    Random::new(Random::new(first ^ place.wrapping_mul(0xa076_1d64_78bd_642f)).bits())
}

/// A number in `[low, high)`.
pub(crate) fn between(random: &mut Random, low: f64, high: f64) -> f64 {
    low + (high - low) * random.uniform()
}

/// As [`between`], in single precision.
pub(crate) fn between32(random: &mut Random, low: f32, high: f32) -> f32 {
    low + (high - low) * random.uniform() as f32
}

/// A number of the normal distribution (Box and Muller 1958).
pub(crate) fn gaussian(random: &mut Random) -> f64 {
    let radius = (-2.0 * (1.0 - random.uniform()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.uniform()).cos()
}

/// A hash of a lattice point, in `[0, 1)`.
pub(crate) fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343) ^ (y as u32).wrapping_mul(0xd816_3841);
    h ^= seed.wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    ((h ^ (h >> 16)) >> 8) as f32 / (1u32 << 24) as f32
}

/// Smooth noise in `[0, 1)` that repeats after `period` lattice cells on each axis.
pub(crate) fn value_noise(x: f32, y: f32, period: [i32; 2], seed: u32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - x0), smooth(y - y0));
    let wrapped = |i: i32, axis: usize| i.rem_euclid(period[axis]);
    let columns = [x0 as i32, x0 as i32 + 1].map(|i| wrapped(i, 0));
    let rows = [y0 as i32, y0 as i32 + 1].map(|j| wrapped(j, 1));
    let at = |dx: usize, dy: usize| lattice(columns[dx], rows[dy], seed);
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * u;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * u;
    top + (bottom - top) * v
}

/// Octaves of [`value_noise`] over the unit square, in `[0, 1)`, first with `period` cells.
pub(crate) fn fractal(u: f32, v: f32, period: [i32; 2], octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut amplitude) = (0.0, 0.0, 1.0);
    for octave in 0..octaves {
        let cells = period.map(|p| p << octave);
        let noise = value_noise(u * cells[0] as f32, v * cells[1] as f32, cells, seed + octave);
        sum += amplitude * noise;
        weight += amplitude;
        amplitude *= 0.5;
    }
    sum / weight
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut random = stream(1, 2, 3);
        let draws: Vec<f64> = (0..20_000).map(|_| gaussian(&mut random)).collect();
        let mean = draws.iter().sum::<f64>() / 20_000.0;
        let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 20_000.0;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
    }

    #[test]
    fn streams_differ_by_seed_purpose_and_place() {
        let first = |a, b, c| stream(a, b, c).bits();
        let all = [first(1, 1, 1), first(2, 1, 1), first(1, 2, 1), first(1, 1, 2)];
        for i in 0..4 {
            assert!((0..i).all(|j| all[i] != all[j]));
        }
    }

    #[test]
    fn noise_repeats_at_its_period() {
        let (a, b) = (fractal(0.0, 0.3, [4, 8], 3, 5), fractal(1.0, 1.3, [4, 8], 3, 5));
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}
