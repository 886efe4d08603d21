//! Decoding of colour and depth images, and resampling to the delivered pixel grid.

mod area_resampling;
mod decode;
mod depth_interpolation;
mod header;
mod lzfse;
mod resampling;

pub(crate) use decode::{
    DepthEncoding, ExpectedSize, METRES_AS_INTEGERS, decode_colour, decode_depth, decode_doubtful,
    depth_size, image_from_rgb, image_size,
};
pub use decode::{read_colour, read_image_size};
pub use header::MAX_PIXELS;
pub(crate) use header::{MAX_DEFLATE_RATIO, check_pixels};
pub(crate) use resampling::{RecordingCameras, Resampler};
