//! Small pictures.

use jpeg_encoder::{ColorType, Encoder};
use png::BitDepth;

/// Width and height of most pictures [px].
pub(crate) const SIZE: (usize, usize) = (24, 18);

/// R, G, B of a smooth pattern that depends on the frame.
pub(super) fn pattern((width, height): (usize, usize), frame: usize) -> Vec<u8> {
    let pixel = |k: usize| {
        let (x, y) = (k % width + frame, k / width);
        [8 * x % 256, 11 * y % 256, 5 * (x + y) % 256].map(|v| v as u8)
    };
    (0..width * height).flat_map(pixel).collect()
}

fn png(
    (width, height): (usize, usize),
    (colour, depth): (png::ColorType, BitDepth),
    data: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    if colour == png::ColorType::Indexed {
        encoder.set_palette((0..48).map(|v| 5 * v).collect::<Vec<u8>>());
    }
    // Writing to memory fails only if the data do not fit the size.
    let mut writer = encoder.write_header().expect("a valid header");
    writer.write_image_data(data).expect("data of this size");
    writer.finish().expect("a whole picture");
    bytes
}

/// A colour PNG of 8 bit.
pub(crate) fn colour(size: (usize, usize), frame: usize) -> Vec<u8> {
    png(size, (png::ColorType::Rgb, BitDepth::Eight), &pattern(size, frame))
}

/// A colour PNG with transparency, of 16 bit.
pub(super) fn colour_deep(size: (usize, usize), frame: usize) -> Vec<u8> {
    let rgba = |pixel: &[u8]| [pixel[0], 1, pixel[1], 2, pixel[2], 3, 255, 255];
    let data: Vec<u8> = pattern(size, frame).chunks(3).flat_map(rgba).collect();
    png(size, (png::ColorType::Rgba, BitDepth::Sixteen), &data)
}

/// A colour PNG with a palette of 4 bit.
pub(super) fn colour_palette(size: (usize, usize), frame: usize) -> Vec<u8> {
    let index = |pixel: &[u8]| pixel[0] & 15;
    let indices: Vec<u8> = pattern(size, frame).chunks(3).map(index).collect();
    let packed: Vec<u8> = indices.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    png(size, (png::ColorType::Indexed, BitDepth::Four), &packed)
}

/// A grey PNG of 16 bit: `value` and a slope.
pub(super) fn depth((width, height): (usize, usize), value: usize) -> Vec<u8> {
    let grey = |k: usize| ((value + 10 * (k % width)) as u16).to_be_bytes();
    let data: Vec<u8> = (0..width * height).flat_map(grey).collect();
    png((width, height), (png::ColorType::Grayscale, BitDepth::Sixteen), &data)
}

/// A JPEG, with EXIF data if given.
pub(super) fn jpeg(size: (usize, usize), frame: usize, exif: Option<&[u8]>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 80);
    if let Some(segment) = exif {
        encoder.add_app_segment(1, segment.to_vec()).expect("a short segment");
    }
    let (width, height) = (size.0 as u16, size.1 as u16);
    encoder
        .encode(&pattern(size, frame), width, height, ColorType::Rgb)
        .expect("data of this size");
    bytes
}

/// A progressive JPEG.
pub(super) fn jpeg_progressive(size: (usize, usize), frame: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 80);
    encoder.set_progressive(true);
    let (width, height) = (size.0 as u16, size.1 as u16);
    encoder
        .encode(&pattern(size, frame), width, height, ColorType::Rgb)
        .expect("data of this size");
    bytes
}

/// EXIF data: an orientation, and a focal length as that of 35 mm film.
pub(super) fn exif(orientation: u16, millimetres: u16) -> Vec<u8> {
    let entry = |tag: u16, kind: u16, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()]
            .concat()
    };
    let directory = |entries: &[Vec<u8>]| {
        [&(entries.len() as u16).to_le_bytes()[..], &entries.concat(), &[0; 4]].concat()
    };
    // The first directory is 30 bytes long and points to that of the camera behind it.
    let first = directory(&[entry(0x112, 3, orientation.into()), entry(0x8769, 4, 8 + 30)]);
    let camera = directory(&[entry(0xa405, 3, millimetres.into())]);
    [&b"Exif\0\0II*\0\x08\0\0\0"[..], &first, &camera].concat()
}
