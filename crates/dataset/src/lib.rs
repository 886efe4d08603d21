//! Frames from disk, RGB-D or colour alone: sequences in, [`Frame`]s out.
//!
//! A sequence is recognised by its files, see [`Layout`]: TUM RGB-D, ETH3D SLAM, ScanNet
//! (extracted, or its `.sens` file), Replica as rendered for NICE-SLAM, 7-Scenes, nerfstudio's
//! `transforms.json` with depth, plain folders of colour and depth images, and videos (colour
//! alone, decoded by the program `ffmpeg`).
//!
//! Every frame is delivered ready to use: lens distortion removed, cropped, scaled, depth in
//! metres. [`Sequence::camera`] is the pinhole camera of the delivered frames.
//!
//! ```no_run
//! use i2slam_dataset::{OpenOptions, Sequence};
//! let options = OpenOptions { scale: 0.5, ..OpenOptions::default() };
//! let sequence = Sequence::open("rgbd_dataset_freiburg1_desk".as_ref(), &options)?;
//! for frame in sequence.stream() {
//!     let frame = frame?;
//!     assert_eq!(frame.colour.width, sequence.camera.width);
//! }
//! # Ok::<(), i2slam_dataset::DatasetError>(())
//! ```

mod alike;
mod area;
mod associate;
mod calibration;
mod camera_file;
mod checks;
mod decode;
mod distortion;
mod error;
mod estimated;
mod guess;
pub mod import;
mod layouts;
mod lists;
mod options;
mod orientation;
mod prepare;
mod published;
mod resample;
mod sequence;
mod sizes;
mod stream;
mod trajectory_file;
mod video;

pub use calibration::write_camera;
pub use error::DatasetError;
pub use estimated::EstimatedCamera;
pub use layouts::Layout;
pub use options::OpenOptions;
pub use prepare::Frame;
pub use published::paper_frames;
pub use sequence::{Entry, LeftOut, Parts, Sequence, is_without_depth};
pub use stream::FrameStream;
pub use trajectory_file::{read_trajectory, write_trajectory};
pub use video::{MAX_RECORDING_BYTES, Recording, is_stream, is_video};
