//! Image decoding: PNG (every kind) and JPEG for colour, 16-bit PNG or raw 16-bit values for depth,
//! from whole files or byte ranges.

use crate::DatasetError;
use i2slam_geometry::Image;
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

/// Largest accepted size of a decoded image [bytes].
const MAX_IMAGE_BYTES: usize = 1 << 30;

enum ImageFormat {
    Png,
    Jpeg,
}

/// Encoding of depth images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum DepthEncoding {
    /// A 16-bit grey PNG.
    #[default]
    Png,
    /// Raw little-endian values, row by row.
    Raw { width: usize, height: usize },
    /// Raw values, deflated (zlib).
    Zlib { width: usize, height: usize },
}

/// Reads a whole file, or `range` of it.
fn read_bytes(path: &Path, range: Option<&Range<u64>>) -> Result<Vec<u8>, DatasetError> {
    let Some(range) = range else {
        return std::fs::read(path).map_err(|e| DatasetError::read(path, e));
    };
    let length = usize::try_from(range.end.saturating_sub(range.start)).unwrap_or(usize::MAX);
    if length > MAX_IMAGE_BYTES {
        return Err(DatasetError::image(path, "the image is too large"));
    }
    let mut bytes = vec![0; length];
    let mut file = File::open(path).map_err(|e| DatasetError::read(path, e))?;
    file.seek(SeekFrom::Start(range.start))
        .and_then(|_| file.read_exact(&mut bytes))
        .map_err(|e| DatasetError::read(path, e))?;
    Ok(bytes)
}

fn read_image(
    path: &Path,
    range: Option<&Range<u64>>,
) -> Result<(Vec<u8>, ImageFormat), DatasetError> {
    let bytes = read_bytes(path, range)?;
    let format = match bytes.as_slice() {
        [0x89, b'P', b'N', b'G', ..] => ImageFormat::Png,
        [0xff, 0xd8, 0xff, ..] => ImageFormat::Jpeg,
        [] => return Err(DatasetError::image(path, "the file is empty, expected an image")),
        _ => return Err(DatasetError::image(path, "neither PNG nor JPEG")),
    };
    Ok((bytes, format))
}

/// Width and height [px], from the header alone.
pub(crate) fn image_size(
    path: &Path,
    range: Option<&Range<u64>>,
) -> Result<(usize, usize), DatasetError> {
    let (bytes, format) = read_image(path, range)?;
    match format {
        ImageFormat::Png => {
            let mut decoder = png_decoder(&bytes);
            let info = decoder.read_header_info().map_err(|e| png_error(path, &e))?;
            Ok((info.width as usize, info.height as usize))
        }
        ImageFormat::Jpeg => {
            let mut decoder = jpeg_decoder(&bytes);
            decoder.decode_headers().map_err(|e| jpeg_error(path, &e))?;
            decoder.dimensions().ok_or_else(|| DatasetError::image(path, "JPEG without a size"))
        }
    }
}

/// Decodes a colour image to 3 planes in `[0, 1]`; grey is repeated, alpha ignored.
pub(crate) fn decode_colour(
    path: &Path,
    range: Option<&Range<u64>>,
) -> Result<Image<f32>, DatasetError> {
    let (bytes, format) = read_image(path, range)?;
    match format {
        ImageFormat::Png => colour_from_png(path, &bytes),
        ImageFormat::Jpeg => colour_from_jpeg(path, &bytes),
    }
}

/// Width and height [px] of a depth image.
pub(crate) fn depth_size(
    path: &Path,
    range: Option<&Range<u64>>,
    code: DepthEncoding,
) -> Result<(usize, usize), DatasetError> {
    match code {
        DepthEncoding::Png => image_size(path, range),
        DepthEncoding::Raw { width, height } | DepthEncoding::Zlib { width, height } => {
            Ok((width, height))
        }
    }
}

/// Decodes a depth image to 1 plane of the stored 16-bit values.
pub(crate) fn decode_depth(
    path: &Path,
    range: Option<&Range<u64>>,
    code: DepthEncoding,
) -> Result<Image<u16>, DatasetError> {
    let (bytes, width, height) = match code {
        DepthEncoding::Png => return depth_from_png(path, range),
        DepthEncoding::Raw { width, height } => (read_bytes(path, range)?, width, height),
        DepthEncoding::Zlib { width, height } => {
            let packed = read_bytes(path, range)?;
            let limit = 2 * width * height;
            let bytes = miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(&packed, limit);
            let damaged = |_| DatasetError::image(path, "damaged depth (zlib)");
            (bytes.map_err(damaged)?, width, height)
        }
    };
    if bytes.len() != 2 * width * height {
        let reason = format!("depth of {} bytes, expected {width}x{height} values", bytes.len());
        return Err(DatasetError::image(path, reason));
    }
    let data = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    Ok(Image { width, height, channels: 1, data })
}

fn depth_from_png(path: &Path, range: Option<&Range<u64>>) -> Result<Image<u16>, DatasetError> {
    let (bytes, format) = read_image(path, range)?;
    if matches!(format, ImageFormat::Jpeg) {
        return Err(DatasetError::image(path, "depth is a JPEG, expected a 16-bit grey PNG"));
    }
    let png = read_png(path, &bytes, Transformations::IDENTITY)?;
    if (png.color, png.depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
        let reason = format!(
            "depth is {:?} of {} bits, expected a 16-bit grey PNG",
            png.color, png.depth as u8
        );
        return Err(DatasetError::image(path, reason));
    }
    let data = png.bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    Ok(Image { width: png.width, height: png.height, channels: 1, data })
}

struct Png {
    width: usize,
    height: usize,
    color: ColorType,
    depth: BitDepth,
    bytes: Vec<u8>,
}

fn png_decoder(bytes: &[u8]) -> Decoder<Cursor<&[u8]>> {
    Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MAX_IMAGE_BYTES })
}

fn png_error(path: &Path, error: &png::DecodingError) -> DatasetError {
    DatasetError::image(path, format!("damaged or cut-off PNG ({error})"))
}

fn read_png(path: &Path, bytes: &[u8], transform: Transformations) -> Result<Png, DatasetError> {
    let mut decoder = png_decoder(bytes);
    decoder.set_transformations(transform);
    let mut reader = decoder.read_info().map_err(|e| png_error(path, &e))?;
    let size = reader.output_buffer_size().filter(|&n| n <= MAX_IMAGE_BYTES);
    let size = size.ok_or_else(|| DatasetError::image(path, "the image is too large"))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(|e| png_error(path, &e))?;
    bytes.truncate(info.buffer_size());
    let (width, height) = (info.width as usize, info.height as usize);
    Ok(Png { width, height, color: info.color_type, depth: info.bit_depth, bytes })
}

fn colour_from_png(path: &Path, bytes: &[u8]) -> Result<Image<f32>, DatasetError> {
    let png = read_png(path, bytes, Transformations::EXPAND)?;
    let samples = png.color.samples();
    let planes = if samples >= 3 { [0, 1, 2] } else { [0, 0, 0] };
    let wide = png.depth == BitDepth::Sixteen;
    let mut out = Image::new(png.width, png.height, 3);
    for (channel, plane) in planes.into_iter().enumerate() {
        let out = out.plane_mut(channel).iter_mut();
        if wide {
            for (value, pixel) in out.zip(png.bytes.chunks_exact(2 * samples)) {
                let pair = [pixel[2 * plane], pixel[2 * plane + 1]];
                *value = f32::from(u16::from_be_bytes(pair)) / 65535.0;
            }
        } else {
            for (value, pixel) in out.zip(png.bytes.chunks_exact(samples)) {
                *value = f32::from(pixel[plane]) / 255.0;
            }
        }
    }
    Ok(out)
}

fn jpeg_decoder(bytes: &[u8]) -> JpegDecoder<ZCursor<&[u8]>> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(ZCursor::new(bytes), options)
}

fn jpeg_error(path: &Path, error: &dyn std::fmt::Debug) -> DatasetError {
    DatasetError::image(path, format!("damaged or cut-off JPEG ({error:?})"))
}

/// Whether an end marker follows the last scan: the decoder silently fills up truncated images.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xff, marker]);
    last(0xd9).is_some_and(|end| last(0xda).is_some_and(|scan| scan < end))
}

fn colour_from_jpeg(path: &Path, bytes: &[u8]) -> Result<Image<f32>, DatasetError> {
    if !jpeg_is_whole(bytes) {
        return Err(DatasetError::image(path, "cut-off JPEG (no end of image)"));
    }
    let mut decoder = jpeg_decoder(bytes);
    let pixels = decoder.decode().map_err(|e| jpeg_error(path, &e))?;
    let (width, height) =
        decoder.dimensions().ok_or_else(|| DatasetError::image(path, "JPEG without a size"))?;
    if pixels.len() != 3 * width * height {
        return Err(DatasetError::image(path, "JPEG of an unknown colour space"));
    }
    Ok(image_from_rgb(width, height, &pixels))
}

/// Planes R, G, B in `[0, 1]` of interleaved 8-bit pixels.
pub(crate) fn image_from_rgb(width: usize, height: usize, pixels: &[u8]) -> Image<f32> {
    let mut out = Image::new(width, height, 3);
    for channel in 0..3 {
        let plane = out.plane_mut(channel).iter_mut();
        for (value, pixel) in plane.zip(pixels.chunks_exact(3)) {
            *value = f32::from(pixel[channel]) / 255.0;
        }
    }
    out
}
