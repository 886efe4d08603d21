//! Changes of bytes.

use i2slam_compute::Random;

/// Bytes at the beginning of a file that half of the changes go to: headers.
const HEADER: usize = 96;

/// Numbers at which readers go wrong.
const EXTREMES: [u64; 20] = [
    0,
    1,
    2,
    3,
    7,
    16,
    255,
    256,
    0x7fff,
    0xffff,
    0x1_0000,
    100_000,
    0x00ff_ffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    u64::MAX >> 1,
    1 << 63,
    u64::MAX,
];

/// The content with one change.
pub(super) fn change(content: &[u8], donor: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = content.to_vec();
    match random.below(14) {
        0 | 1 => flip_bit(&mut bytes, random),
        2 => overwrite(&mut bytes, &[[0, 0x7f, 0x80, 0xff][random.below(4)]], random),
        3..=6 => overwrite(&mut bytes, &extreme_word(random), random),
        7 => overwrite(&mut bytes, &extreme_float(random), random),
        8 => nudge(&mut bytes, random),
        9 => bytes.truncate(place(bytes.len(), random)),
        10 => {
            let (start, end) = range(bytes.len(), random);
            bytes.drain(start..end);
        }
        11 => {
            let (start, end) = range(bytes.len(), random);
            let copy = bytes[start..end].repeat(1 + random.below(3));
            insert(&mut bytes, &copy, random);
        }
        12 => {
            let (start, end) = range(donor.len(), random);
            insert(&mut bytes, &donor[start..end], random);
        }
        _ => {
            let at = place(bytes.len(), random);
            let (start, _) = range(donor.len(), random);
            bytes.truncate(at);
            bytes.extend(&donor[start..]);
        }
    }
    if bytes == content {
        bytes.push(0);
    }
    bytes
}

/// An index in `0..=length`, often among the first.
fn place(length: usize, random: &mut Random) -> usize {
    let is_header = random.uniform() < 0.5;
    random.below(1 + if is_header { length.min(HEADER) } else { length })
}

/// A range of at most 512 bytes.
fn range(length: usize, random: &mut Random) -> (usize, usize) {
    let start = place(length, random);
    let longest = (length - start).min([4, 16, 64, 512][random.below(4)]);
    (start, start + random.below(1 + longest))
}

fn flip_bit(bytes: &mut [u8], random: &mut Random) {
    let at = place(bytes.len(), random);
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= 1 << random.below(8);
    }
}

/// Overwrites bytes, half the time at a multiple of four.
fn overwrite(bytes: &mut [u8], word: &[u8], random: &mut Random) {
    let at = place(bytes.len().saturating_sub(word.len()), random);
    let at = if random.uniform() < 0.5 { at & !3 } else { at };
    if let Some(target) = bytes.get_mut(at..at + word.len()) {
        target.copy_from_slice(word);
    }
}

fn insert(bytes: &mut Vec<u8>, piece: &[u8], random: &mut Random) {
    let at = place(bytes.len(), random);
    bytes.splice(at..at, piece.iter().copied());
}

/// A number of 2, 4 or 8 bytes in either order.
fn extreme_word(random: &mut Random) -> Vec<u8> {
    let value = EXTREMES[random.below(EXTREMES.len())];
    let width = [2, 4, 8][random.below(3)];
    match random.uniform() < 0.6 {
        true => value.to_le_bytes()[..width].to_vec(),
        false => value.to_be_bytes()[8 - width..].to_vec(),
    }
}

fn extreme_float(random: &mut Random) -> Vec<u8> {
    const VALUES: [f64; 9] =
        [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308, 1e38, 1e-300, -0.0, -1.0];
    let value = VALUES[random.below(VALUES.len())];
    match random.uniform() < 0.5 {
        true => value.to_le_bytes().to_vec(),
        false => (value as f32).to_le_bytes().to_vec(),
    }
}

/// Adds a small number to a byte: lengths and counts that are off by a little.
fn nudge(bytes: &mut [u8], random: &mut Random) {
    let at = place(bytes.len(), random);
    if let Some(byte) = bytes.get_mut(at) {
        let step = 1 + random.below(8) as u8;
        *byte =
            if random.uniform() < 0.5 { byte.wrapping_add(step) } else { byte.wrapping_sub(step) };
    }
}
