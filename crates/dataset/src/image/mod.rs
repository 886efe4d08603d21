//! Decoding of colour and depth images, and resampling to the delivered pixel grid.

mod area_resampling;
mod decode;
mod resampling;

pub(crate) use decode::{
    DepthEncoding, decode_colour, decode_depth, depth_size, image_from_rgb, image_size,
};
pub(crate) use resampling::{RecordingCameras, Resampler};
