//! Reading of RGB-D and colour sequences, and of keyframes of other programs ([`import`]).
//!
//! A sequence is recognised by its files, see [`Layout`]: TUM RGB-D, ETH3D SLAM, ScanNet
//! (extracted, or its `.sens` file), Replica as rendered for NICE-SLAM, 7-Scenes, nerfstudio's
//! `transforms.json` with depth, recordings of the apps Stray Scanner and Record3D, plain folders of colour and depth images, and videos (decoded by
//! the program `ffmpeg`; a second track of 16-bit grey is depth).
//!
//! [`Frame`]s are delivered undistorted, cropped and scaled, with depth in metres.
//! [`Sequence::camera`] is the pinhole camera of the delivered frames.
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

mod camera;
mod error;
mod file_part;
mod formats;
mod image;
pub mod import;
mod options;
pub mod path_text;
mod sequence;
mod text;
mod video;

pub use camera::EstimatedCamera;
pub use error::DatasetError;
pub use file_part::{FilePart, Packing};
pub use formats::{
    DepthEntry, DroppedFrames, FrameEntry, FrameParts, Layout, camera_json, paper_frames,
    read_trajectory, write_trajectory,
};
pub use image::{MAX_PIXELS, read_colour, read_image_size};
pub use options::{DepthPairing, OpenOptions};
pub use sequence::{
    DepthPicture, Frame, FrameStream, LiveFrameStream, LiveSequence, RecordedSequence, Sequence,
    is_without_depth,
};
pub use video::{MAX_RECORDING_BYTES, VideoEncoder, VideoFormat, is_stream, is_video};
