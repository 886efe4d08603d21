//! Pictures read from files for comparison.

use crate::failure::{Failure, failed};
use i2slam::dataset::{MAX_PIXELS, read_image_size};
use i2slam::geometry::Image;
use i2slam_result::DEPTH_UNITS_PER_METRE;
use png::{BitDepth, ColorType, Decoder, Limits, OutputInfo, Transformations};
use std::io::BufReader;
use std::path::Path;

/// Memory that the decoder of a PNG may take beside the pixels [bytes]: some rows of the widest
/// picture, and tables.
const MAX_DECODER_BYTES: usize = 64 << 20;

/// Reads an 8- or 16-bit PNG as planes R, G, B in `[0, 1]`.
pub(crate) fn read_png(path: &Path) -> Result<Image<f32>, Failure> {
    let (info, bytes) = decode_png(path, Transformations::EXPAND | Transformations::STRIP_16)?;
    let samples = info.color_type.samples();
    let mut image = Image::new(info.width as usize, info.height as usize, 3);
    for channel in 0..3 {
        let source = if samples >= 3 { channel } else { 0 };
        let plane = image.plane_mut(channel);
        for (value, pixel) in plane.iter_mut().zip(bytes.chunks_exact(samples)) {
            *value = f32::from(pixel[source]) / 255.0;
        }
    }
    Ok(image)
}

/// Reads a 16-bit depth PNG of a result folder [m].
pub(crate) fn read_depth(path: &Path) -> Result<Image<f32>, Failure> {
    let (info, bytes) = decode_png(path, Transformations::IDENTITY)?;
    if (info.color_type, info.bit_depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
        return Err(failed(path, "is no 16-bit grey picture"));
    }
    let metres = |b: &[u8]| f32::from(u16::from_be_bytes([b[0], b[1]])) / DEPTH_UNITS_PER_METRE;
    let (width, height) = (info.width as usize, info.height as usize);
    let data = bytes.chunks_exact(2).take(width * height).map(metres).collect();
    Ok(Image { width, height, channels: 1, data })
}

/// Decodes a PNG of at most [`MAX_PIXELS`].
fn decode_png(path: &Path, transform: Transformations) -> Result<(OutputInfo, Vec<u8>), Failure> {
    read_image_size(path)?;
    let file = i2slam_storage::open(path).map_err(|e| failed(path, e))?;
    let limits = Limits { bytes: MAX_DECODER_BYTES };
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(transform);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(|e| failed(path, e))?;
    let size = reader.output_buffer_size().ok_or_else(|| failed(path, "is too large"))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(|e| failed(path, e))?;
    Ok((info, bytes))
}

/// Reads the R, G, B channels of an OpenEXR picture of at most [`MAX_PIXELS`].
pub(crate) fn read_exr(path: &Path) -> Result<Image<f32>, Failure> {
    use exr::prelude::{ReadChannels, ReadLayers, Vec2};
    let file = i2slam_storage::open(path).map_err(|e| failed(path, e))?;
    let chunks = exr::block::read(BufReader::new(file), false).map_err(|e| failed(path, e))?;
    for header in chunks.headers() {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        if width.checked_mul(height).is_none_or(|pixels| pixels > MAX_PIXELS) {
            let most = MAX_PIXELS / 1_000_000;
            let reason = format!("is {width}x{height} px, and at most {most} megapixels are read");
            return Err(failed(path, reason));
        }
    }
    let read = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size: Vec2<usize>, _| Image::<f32>::new(size.width(), size.height(), 3),
            |image: &mut Image<f32>, at: Vec2<usize>, (r, g, b): (f32, f32, f32)| {
                let pixel = at.y() * image.width + at.x();
                for (channel, value) in [r, g, b].into_iter().enumerate() {
                    image.plane_mut(channel)[pixel] = value;
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_chunks(chunks)
        .map_err(|e| failed(path, e))?;
    Ok(read.layer_data.channel_data.pixels)
}

/// Reduces `reference` to the size of `picture`; `None` if it is smaller or of another shape.
pub(crate) fn at_size_of(reference: Image<f32>, picture: &Image<f32>) -> Option<Image<f32>> {
    let (width, height) = (picture.width, picture.height);
    if (reference.width, reference.height) == (width, height) {
        return Some(reference);
    }
    let same_view = reference.width * height == reference.height * width;
    (same_view && reference.width > width).then(|| reference.resized_by_area(width, height))
}

/// Stacks pictures of equal width.
pub(crate) fn stacked(frames: &[Image<f32>]) -> Image<f32> {
    let (width, channels) = frames.first().map_or((0, 0), |f| (f.width, f.channels));
    let height = frames.iter().map(|f| f.height).sum();
    let planes = (0..channels).flat_map(|c| frames.iter().map(move |f| f.plane(c)));
    Image { width, height, channels, data: planes.collect::<Vec<_>>().concat() }
}
