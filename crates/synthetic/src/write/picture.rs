//! Image files: PNG for pictures and depth, OpenEXR for radiance.

use i2slam_geometry::Image;
use std::io::{self, Cursor};

/// Depth image value of one metre.
pub(crate) const DEPTH_SCALE: f64 = 5000.0;

/// An 8-bit RGB PNG of a picture in `[0, 1]`.
pub(crate) fn write_picture(picture: &Image<f32>) -> io::Result<Vec<u8>> {
    let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
    let planes = [0, 1, 2].map(|channel| picture.plane(channel));
    let pixels = (0..picture.pixels()).flat_map(|i| planes.map(|plane| byte(plane[i])));
    let bytes: Vec<u8> = pixels.collect();
    write_png(picture, png::ColorType::Rgb, png::BitDepth::Eight, &bytes)
}

/// A 16-bit grey PNG of depth in metres; what does not fit 16 bits becomes 0.
pub(crate) fn write_depth(depth: &Image<f32>) -> io::Result<Vec<u8>> {
    let units = depth.plane(0).iter().map(|&metres| {
        let unit = (f64::from(metres) * DEPTH_SCALE).round_ties_even();
        if unit > 0.0 && unit <= f64::from(u16::MAX) { unit as u16 } else { 0 }
    });
    let bytes: Vec<u8> = units.flat_map(u16::to_be_bytes).collect();
    write_png(depth, png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes)
}

fn write_png(
    image: &Image<f32>,
    colour: png::ColorType,
    bits: png::BitDepth,
    bytes: &[u8],
) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, image.width as u32, image.height as u32);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(out)
}

/// A half-float linear RGB OpenEXR of radiance (Rec. 709 primaries).
pub(crate) fn write_radiance(radiance: &Image<f32>) -> io::Result<Vec<u8>> {
    use exr::prelude::{Compression, Encoding, SpecificChannels, Vec2, WritableImage, f16};
    let (width, height) = (radiance.width, radiance.height);
    let planes = [0, 1, 2].map(|channel| radiance.plane(channel));
    let pixels = SpecificChannels::rgb(|at: Vec2<usize>| {
        let [r, g, b] = planes.map(|plane| f16::from_f32(plane[at.y() * width + at.x()]));
        (r, g, b)
    });
    let mut bytes = Cursor::new(Vec::new());
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    exr::prelude::Image::from_encoded_channels((width, height), encoding, pixels)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(io::Error::other)?;
    Ok(bytes.into_inner())
}
