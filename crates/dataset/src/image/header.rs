//! Headers of encoded images: format and size, read before anything is decoded.

use crate::DatasetError;
use crate::file_part::{FilePart, Packing};
use std::io::{BufRead, BufReader, Cursor, Seek, SeekFrom};
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Largest accepted image [px]: a photograph of 100 megapixels fits. Encoded, decoded and as three
/// planes, an image takes up to 28 bytes a pixel for a moment, 3.8 GB.
pub const MAX_PIXELS: usize = 1 << 27;

/// Largest ratio of deflated to stored bytes that the format allows (zlib's technical notes).
pub(crate) const MAX_DEFLATE_RATIO: u64 = 1032;

/// Largest image that is inflated to read its header [bytes].
const MAX_INFLATED: u64 = 64 << 20;

/// Longest side that a JPEG can have [px].
const MAX_JPEG_SIDE: usize = u16::MAX as usize;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ImageFormat {
    Png,
    Jpeg,
}

/// Format and size of an encoded image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageHeader {
    pub(super) format: ImageFormat,
    /// Width and height [px].
    pub(super) size: (usize, usize),
    /// Bytes that are there.
    length: u64,
    /// Bytes that an image of this size takes at least.
    needed: u64,
}

impl ImageHeader {
    /// Reads the header of a whole file, or of a part of it.
    pub(super) fn read(path: &Path, part: Option<&FilePart>) -> Result<Self, DatasetError> {
        let failed = |e| DatasetError::read(path, e);
        if let Some(part) = part.filter(|part| part.packing != Packing::Stored) {
            let bytes = part.read(path, MAX_INFLATED).map_err(failed)?;
            return Self::of_reader(path, Cursor::new(bytes), part.length());
        }
        let file = i2slam_storage::open(path).map_err(failed)?;
        let end = file.metadata().map_err(failed)?.len();
        let range = part.map_or(0..end, |part| part.range.clone());
        let mut file = BufReader::new(file);
        file.seek(SeekFrom::Start(range.start)).map_err(failed)?;
        Self::of_reader(path, file, range.end.saturating_sub(range.start))
    }

    /// Reads the header at the place of a reader, of so many bytes.
    fn of_reader(
        path: &Path,
        mut file: impl BufRead + Seek,
        length: u64,
    ) -> Result<Self, DatasetError> {
        let format = match file.fill_buf().map_err(|e| DatasetError::read(path, e))? {
            [0x89, b'P', b'N', b'G', ..] => ImageFormat::Png,
            [0xff, 0xd8, 0xff, ..] => ImageFormat::Jpeg,
            [] => return Err(DatasetError::image(path, "the file is empty, expected an image")),
            _ => return Err(DatasetError::image(path, "neither PNG nor JPEG")),
        };
        let (size, needed) = match format {
            ImageFormat::Png => png_size(path, file)?,
            ImageFormat::Jpeg => (jpeg_size(path, file)?, 0),
        };
        Ok(Self { format, size, length, needed })
    }

    /// An error for an image of more pixels than its bytes can hold.
    pub(super) fn check_length(&self, path: &Path) -> Result<(), DatasetError> {
        if self.needed <= self.length {
            return Ok(());
        }
        let (length, (width, height)) = (self.length, self.size);
        let reason =
            format!("damaged or cut-off: {length} bytes hold no image of {width}x{height} px");
        Err(DatasetError::image(path, reason))
    }
}

/// An error for an image of more than [`MAX_PIXELS`].
pub(crate) fn check_pixels(
    path: &Path,
    (width, height): (usize, usize),
) -> Result<(), DatasetError> {
    if width.checked_mul(height).is_some_and(|pixels| pixels <= MAX_PIXELS) {
        return Ok(());
    }
    let most = MAX_PIXELS / 1_000_000;
    let reason = format!("it is {width}x{height} px, and at most {most} megapixels are read");
    Err(DatasetError::image(path, reason))
}

/// Size of a PNG, and the bytes that it takes at least.
fn png_size(path: &Path, file: impl BufRead + Seek) -> Result<((usize, usize), u64), DatasetError> {
    let mut decoder = png::Decoder::new(file);
    let info = decoder.read_header_info().map_err(|e| png_error(path, &e))?;
    let pixels = u64::from(info.width) * u64::from(info.height);
    let bits = pixels.saturating_mul(info.bits_per_pixel() as u64);
    Ok(((info.width as usize, info.height as usize), bits / 8 / MAX_DEFLATE_RATIO))
}

fn jpeg_size(path: &Path, file: impl BufRead + Seek) -> Result<(usize, usize), DatasetError> {
    let options = DecoderOptions::default();
    let options = options.set_max_width(MAX_JPEG_SIDE).set_max_height(MAX_JPEG_SIDE);
    let mut decoder = JpegDecoder::new_with_options(file, options);
    decoder.decode_headers().map_err(|e| jpeg_error(path, &e))?;
    decoder.dimensions().ok_or_else(|| DatasetError::image(path, "JPEG without a size"))
}

pub(super) fn png_error(path: &Path, error: &png::DecodingError) -> DatasetError {
    DatasetError::image(path, format!("damaged or cut-off PNG ({error})"))
}

pub(super) fn jpeg_error(path: &Path, error: &dyn std::fmt::Debug) -> DatasetError {
    DatasetError::image(path, format!("damaged or cut-off JPEG ({error:?})"))
}
