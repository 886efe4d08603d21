//! Image decoding: PNG (every kind) and JPEG for colour, 16-bit PNG or raw values for depth, from whole
//! files or parts of them. The size is read first, so that no image of another size than
//! expected is decoded.

use super::header::{ImageFormat, ImageHeader, MAX_PIXELS, check_pixels, jpeg_error, png_error};
use super::lzfse::decompress_lzfse;
use crate::DatasetError;
use crate::file_part::FilePart;
use i2slam_geometry::Image;
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::Cursor;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

/// Bytes of a pixel in the largest encoding, 16-bit RGBA.
const MAX_PIXEL_BYTES: usize = 8;

/// Bytes beside the pixels: colour profile, thumbnails, the short video that phones append.
const MAX_METADATA_BYTES: usize = 64 << 20;

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
    /// Raw 32-bit floats [m], compressed by LZFSE; not a number where there is no reading.
    LzfseMetres { width: usize, height: usize },
}

/// Value of one metre in depth that was stored as floats: steps of a quarter of a millimetre up to 16 m.
pub(crate) const METRES_AS_INTEGERS: f64 = 4000.0;

/// Size that an image must have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExpectedSize<'a> {
    /// Width and height [px].
    pub(crate) size: (usize, usize),
    /// Images or files that have this size, for messages.
    pub(crate) reference: &'a str,
}

impl ExpectedSize<'_> {
    fn check(&self, path: &Path, found: (usize, usize)) -> Result<(), DatasetError> {
        DatasetError::check_size(path, found, self.size, self.reference)
    }

    /// Largest accepted encoded size [bytes].
    fn max_bytes(&self) -> usize {
        let pixels = self.size.0.saturating_mul(self.size.1).min(MAX_PIXELS);
        MAX_PIXEL_BYTES * pixels + MAX_METADATA_BYTES
    }
}

/// Reads a whole file, or a part of it, of at most `limit` bytes.
fn read_bytes(path: &Path, part: Option<&FilePart>, limit: usize) -> Result<Vec<u8>, DatasetError> {
    let bytes = match part {
        None => i2slam_storage::read(path, limit as u64),
        Some(part) if part.length() > limit as u64 => {
            return Err(DatasetError::image(path, "damaged: too many bytes for its size"));
        }
        Some(part) => part.read(path, limit as u64),
    };
    bytes.map_err(|e| DatasetError::read(path, e))
}

/// Reads an encoded image of the expected size.
fn read_image(
    path: &Path,
    part: Option<&FilePart>,
    expected: ExpectedSize,
) -> Result<(Vec<u8>, ImageFormat), DatasetError> {
    let header = ImageHeader::read(path, part)?;
    expected.check(path, header.size)?;
    header.check_length(path)?;
    Ok((read_bytes(path, part, expected.max_bytes())?, header.format))
}

/// Width and height [px] of a PNG or JPEG file, from its header alone. An image of more than
/// [`MAX_PIXELS`], or of more than its bytes can hold, is an error.
pub fn read_image_size(path: &Path) -> Result<(usize, usize), DatasetError> {
    image_size(path, None)
}

/// A PNG or JPEG file as planes R, G and B in `[0, 1]`; grey is repeated, alpha ignored.
pub fn read_colour(path: &Path) -> Result<Image<f32>, DatasetError> {
    let size = read_image_size(path)?;
    decode_colour(path, None, ExpectedSize { size, reference: "its header" })
}

/// Width and height [px], from the header alone. An image of more than [`MAX_PIXELS`], or of more
/// than its bytes can hold, is an error.
pub(crate) fn image_size(
    path: &Path,
    part: Option<&FilePart>,
) -> Result<(usize, usize), DatasetError> {
    let header = ImageHeader::read(path, part)?;
    check_pixels(path, header.size)?;
    header.check_length(path)?;
    Ok(header.size)
}

/// Decodes a colour image to 3 planes in `[0, 1]`; grey is repeated, alpha ignored. An image of
/// another size is an error, and not decoded.
pub(crate) fn decode_colour(
    path: &Path,
    part: Option<&FilePart>,
    expected: ExpectedSize,
) -> Result<Image<f32>, DatasetError> {
    let (bytes, format) = read_image(path, part, expected)?;
    match format {
        ImageFormat::Png => colour_from_png(path, &bytes, expected),
        ImageFormat::Jpeg => colour_from_jpeg(path, &bytes, expected),
    }
}

/// Width and height [px] of a depth image.
pub(crate) fn depth_size(
    path: &Path,
    part: Option<&FilePart>,
    code: DepthEncoding,
) -> Result<(usize, usize), DatasetError> {
    match code {
        DepthEncoding::Png => image_size(path, part),
        DepthEncoding::Raw { width, height }
        | DepthEncoding::Zlib { width, height }
        | DepthEncoding::LzfseMetres { width, height } => Ok((width, height)),
    }
}

/// Decodes a depth image to 1 plane of the stored 16-bit values, or [`METRES_AS_INTEGERS`]. An image of
/// another size is an error, and not decoded.
pub(crate) fn decode_depth(
    path: &Path,
    part: Option<&FilePart>,
    code: DepthEncoding,
    expected: ExpectedSize,
) -> Result<Image<u16>, DatasetError> {
    if code == DepthEncoding::Png {
        return depth_from_png(path, part, expected);
    }
    let (width, height) = depth_size(path, part, code)?;
    expected.check(path, (width, height))?;
    let bytes = read_bytes(path, part, expected.max_bytes())?;
    let bytes = match code {
        DepthEncoding::LzfseMetres { .. } => {
            let data = decompress_lzfse(path, &bytes, ("depth", (width, height), 4))?;
            let data = data.chunks_exact(4).map(|b| integer_of_metres([b[0], b[1], b[2], b[3]]));
            return Ok(Image { width, height, channels: 1, data: data.collect() });
        }
        DepthEncoding::Zlib { .. } => {
            let limit = 2 * width * height;
            let inflated = miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(&bytes, limit);
            inflated.map_err(|_| DatasetError::image(path, "damaged depth (zlib)"))?
        }
        _ => bytes,
    };
    if bytes.len() != 2 * width * height {
        let reason = format!("depth of {} bytes, expected {width}x{height} values", bytes.len());
        return Err(DatasetError::image(path, reason));
    }
    let data = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    Ok(Image { width, height, channels: 1, data })
}

/// A little-endian float of metres in steps of [`METRES_AS_INTEGERS`]; 0 where it is no depth, or too far.
fn integer_of_metres(bytes: [u8; 4]) -> u16 {
    let steps = (f64::from(f32::from_le_bytes(bytes)) * METRES_AS_INTEGERS).round();
    if (1.0..=f64::from(u16::MAX)).contains(&steps) { steps as u16 } else { 0 }
}

/// Decodes the confidence of every reading of depth: true where it is the least, 0.
pub(crate) fn decode_doubtful(
    path: &Path,
    part: Option<&FilePart>,
    code: DepthEncoding,
    expected: ExpectedSize,
) -> Result<Vec<bool>, DatasetError> {
    if let DepthEncoding::LzfseMetres { width, height } = code {
        let bytes = read_bytes(path, part, expected.max_bytes())?;
        let bytes = decompress_lzfse(path, &bytes, ("confidence", (width, height), 1))?;
        return Ok(bytes.into_iter().map(|confidence| confidence == 0).collect());
    }
    let confidence = decode_colour(path, part, expected)?;
    Ok(confidence.plane(0).iter().map(|confidence| *confidence == 0.0).collect())
}

fn depth_from_png(
    path: &Path,
    part: Option<&FilePart>,
    expected: ExpectedSize,
) -> Result<Image<u16>, DatasetError> {
    let (bytes, format) = read_image(path, part, expected)?;
    if matches!(format, ImageFormat::Jpeg) {
        return Err(DatasetError::image(path, "depth is a JPEG, expected a 16-bit grey PNG"));
    }
    let png = read_png(path, &bytes, Transformations::IDENTITY, expected)?;
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

fn read_png(
    path: &Path,
    bytes: &[u8],
    transform: Transformations,
    expected: ExpectedSize,
) -> Result<Png, DatasetError> {
    let limits = Limits { bytes: expected.max_bytes() };
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(transform);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let mut reader = decoder.read_info().map_err(|e| png_error(path, &e))?;
    // The decoder takes three bytes a colour on trust.
    let is_broken = |palette: &[u8]| palette.is_empty() || !palette.len().is_multiple_of(3);
    if reader.info().palette.as_deref().is_some_and(is_broken) {
        return Err(DatasetError::image(path, "damaged PNG (its palette has no whole colours)"));
    }
    let size = reader.output_buffer_size().filter(|&n| n <= expected.max_bytes());
    let size = size.ok_or_else(|| DatasetError::image(path, "the image is too large"))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(|e| png_error(path, &e))?;
    bytes.truncate(info.buffer_size());
    let (width, height) = (info.width as usize, info.height as usize);
    // The first frame of an animation may be smaller than the header says.
    expected.check(path, (width, height))?;
    Ok(Png { width, height, color: info.color_type, depth: info.bit_depth, bytes })
}

fn colour_from_png(
    path: &Path,
    bytes: &[u8],
    expected: ExpectedSize,
) -> Result<Image<f32>, DatasetError> {
    let png = read_png(path, bytes, Transformations::EXPAND, expected)?;
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

/// Whether an end marker follows the last scan: the decoder silently fills up truncated images.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xff, marker]);
    last(0xd9).is_some_and(|end| last(0xda).is_some_and(|scan| scan < end))
}

fn colour_from_jpeg(
    path: &Path,
    bytes: &[u8],
    expected: ExpectedSize,
) -> Result<Image<f32>, DatasetError> {
    if !jpeg_is_whole(bytes) {
        return Err(DatasetError::image(path, "cut-off JPEG (no end of image)"));
    }
    let (width, height) = expected.size;
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let options = options.set_max_width(width).set_max_height(height);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder.decode().map_err(|e| jpeg_error(path, &e))?;
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
