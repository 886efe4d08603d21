//! Image files (PNG for pictures and depth, OpenEXR for radiance), and the pictures under
//! `renders/`.

use crate::ResultError;
use i2slam::geometry::Image;
use i2slam_storage::OutputFolder;
use std::io::{self, Cursor, Write};

/// Depth PNGs hold this many units per metre (TUM RGB-D's convention).
pub const DEPTH_UNITS_PER_METRE: f32 = 5000.0;

/// Converts 0 to 1 into 0 to 255; values outside are clamped, NaN is black.
pub(crate) fn byte(value: f32) -> u8 {
    (value * 255.0).round().clamp(0.0, 255.0) as u8
}

/// The pixels of a picture in the order R, G, B; a single channel is repeated.
pub(crate) fn interleaved_bytes(picture: &Image<f32>) -> Vec<u8> {
    let plane = |c: usize| picture.plane(c.min(picture.channels.saturating_sub(1)));
    let (red, green, blue) = (plane(0), plane(1), plane(2));
    let mut bytes = Vec::with_capacity(3 * picture.pixels());
    for i in 0..picture.pixels() {
        bytes.extend([byte(red[i]), byte(green[i]), byte(blue[i])]);
    }
    bytes
}

/// Writes a picture in `[0, 1]` as an 8-bit RGB PNG.
pub fn write_picture(out: &mut dyn Write, picture: &Image<f32>) -> io::Result<()> {
    let header = (picture, png::ColorType::Rgb, png::BitDepth::Eight);
    write_png(out, header, &interleaved_bytes(picture))
}

/// Writes one plane in `[0, 1]` as an 8-bit grey PNG.
pub(crate) fn write_mask(out: &mut dyn Write, mask: &Image<f32>) -> io::Result<()> {
    let bytes: Vec<u8> = mask.plane(0).iter().map(|&value| byte(value)).collect();
    write_png(out, (mask, png::ColorType::Grayscale, png::BitDepth::Eight), &bytes)
}

/// Writes depth [m] as a 16-bit grey PNG: 5000 is 1 m, 0 is no depth. Depth beyond 13.1 m does not
/// fit 16 bits and becomes 0.
pub fn write_depth(out: &mut dyn Write, depth: &Image<f32>) -> io::Result<()> {
    let units = depth.plane(0).iter().map(|&metres| {
        let unit = (metres * DEPTH_UNITS_PER_METRE).round();
        if unit > 0.0 && unit <= f32::from(u16::MAX) { unit as u16 } else { 0 }
    });
    let bytes: Vec<u8> = units.flat_map(u16::to_be_bytes).collect();
    write_png(out, (depth, png::ColorType::Grayscale, png::BitDepth::Sixteen), &bytes)
}

fn write_png(
    out: &mut dyn Write,
    (image, colour, bits): (&Image<f32>, png::ColorType, png::BitDepth),
    bytes: &[u8],
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(out, image.width as u32, image.height as u32);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().map_err(io_error)?;
    writer.write_image_data(bytes).map_err(io_error)?;
    writer.finish().map_err(io_error)
}

fn io_error(error: png::EncodingError) -> io::Error {
    match error {
        png::EncodingError::IoError(source) => source,
        other => io::Error::other(other),
    }
}

/// Writes linear radiance (Rec. 709 primaries) as an RGB OpenEXR in half floats.
pub fn write_radiance(out: &mut dyn Write, radiance: &Image<f32>) -> io::Result<()> {
    use exr::prelude::{Compression, Encoding, SpecificChannels, WritableImage, f16};
    let (width, height) = (radiance.width, radiance.height);
    let (red, green, blue) = (radiance.plane(0), radiance.plane(1), radiance.plane(2));
    let pixels = SpecificChannels::rgb(|position: exr::prelude::Vec2<usize>| {
        let i = position.y() * width + position.x();
        (f16::from_f32(red[i]), f16::from_f32(green[i]), f16::from_f32(blue[i]))
    });
    let mut bytes = Cursor::new(Vec::new());
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    exr::prelude::Image::from_encoded_channels((width, height), encoding, pixels)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(io::Error::other)?;
    out.write_all(bytes.get_ref())
}

/// Kinds of renders of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderKind {
    /// Seen from mid-exposure, with the frame's own exposure, white balance and response.
    Sharp,
    /// The picture predicted by image formation, blur included.
    Blurred,
    /// Linear radiance.
    Hdr,
    /// Depth along the optical axis.
    Depth,
    /// Opacity of the map: black where nothing was ever seen.
    Opacity,
}

impl RenderKind {
    /// All kinds.
    pub const ALL: [Self; 5] = [Self::Sharp, Self::Blurred, Self::Hdr, Self::Depth, Self::Opacity];

    /// Name of the kind and of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sharp => "sharp",
            Self::Blurred => "blurred",
            Self::Hdr => "hdr",
            Self::Depth => "depth",
            Self::Opacity => "opacity",
        }
    }

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// File name under `renders/`: kind, then position in the associated stream.
    pub fn file(self, index: usize) -> String {
        format!("{}/{index:06}.{}", self.name(), self.extension())
    }

    /// Extension of its files.
    pub fn extension(self) -> &'static str {
        if self == Self::Hdr { "exr" } else { "png" }
    }
}

/// Writes a render as `<parent>/<kind>/NNNNNN.png` (or `.exr`); `parent` may be empty.
pub fn save_render(
    folder: &OutputFolder,
    parent: &str,
    kind: RenderKind,
    index: usize,
    image: &Image<f32>,
) -> Result<(), ResultError> {
    let file = kind.file(index);
    let relative = if parent.is_empty() { file } else { format!("{parent}/{file}") };
    let written = folder.write(&relative, |out| match kind {
        RenderKind::Sharp | RenderKind::Blurred => write_picture(out, image),
        RenderKind::Hdr => write_radiance(out, image),
        RenderKind::Depth => write_depth(out, image),
        RenderKind::Opacity => write_mask(out, image),
    });
    Ok(written?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{ReadChannels, ReadLayers};

    fn decoded(bytes: &[u8]) -> (png::OutputInfo, Vec<u8>) {
        let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut pixels).expect("pixels");
        (info, pixels)
    }

    #[test]
    fn depth_keeps_metres_and_marks_what_does_not_fit() {
        let depth = Image { width: 2, height: 2, channels: 1, data: vec![1.0, 0.0, 2.5, 20.0] };
        let mut bytes = Vec::new();
        write_depth(&mut bytes, &depth).expect("memory");
        let (info, pixels) = decoded(&bytes);
        assert_eq!((info.width, info.height), (2, 2));
        assert_eq!(pixels, [5000_u16, 0, 12500, 0].map(u16::to_be_bytes).concat());
    }

    #[test]
    fn pictures_are_cut_to_their_range() {
        let data = vec![-1.0, 0.5, 2.0, f32::NAN, 1.0, 0.2];
        let picture = Image { width: 2, height: 1, channels: 3, data };
        let mut bytes = Vec::new();
        write_picture(&mut bytes, &picture).expect("memory");
        assert_eq!(decoded(&bytes).1, [0, 255, 255, 128, 0, 51]);
    }

    #[test]
    fn radiance_survives_at_half_precision() {
        let data: Vec<f32> = (0..3 * 35).map(|i| 0.01 * 1.08_f32.powi(i)).collect();
        let radiance = Image { width: 7, height: 5, channels: 3, data };
        let mut bytes = Vec::new();
        write_radiance(&mut bytes, &radiance).expect("memory");
        let read = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .rgb_channels(
                |size, _| Image::<f32>::new(size.width(), size.height(), 3),
                |image: &mut Image<f32>, p, (r, g, b): (f32, f32, f32)| {
                    for (channel, value) in [r, g, b].into_iter().enumerate() {
                        let (width, height) = (image.width, image.height);
                        image.data[(channel * height + p.y()) * width + p.x()] = value;
                    }
                },
            )
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(bytes))
            .expect("an EXR");
        let back = &read.layer_data.channel_data.pixels;
        for (a, b) in back.data.iter().zip(&radiance.data) {
            assert!((a - b).abs() <= 1e-3 * b, "{a} {b}");
        }
    }

    #[test]
    fn kinds_have_names() {
        for kind in RenderKind::ALL {
            assert_eq!(RenderKind::from_name(kind.name()), Some(kind));
        }
        assert_eq!(RenderKind::from_name("sharpest"), None);
    }
}
