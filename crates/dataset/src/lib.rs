//! RGB-D frames from disk: sequences in, [`Frame`]s out.
//!
//! Two layouts are understood.
//!
//! * **TUM RGB-D**: `rgb.txt` and `depth.txt` list `timestamp file`; every colour image goes with
//!   the depth image nearest in time, then the stream is thinned (see [`OpenOptions`]).
//! * **Plain folder**: `colour/` (or `color/`, `rgb/`, `images/`) beside `depth/` and
//!   `camera.json`; pairs by time stamp or number in the file names.
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

mod associate;
mod calibration;
mod checks;
mod decode;
mod distortion;
mod error;
mod layout;
mod lists;
mod options;
mod plain;
mod prepare;
mod resample;
mod sequence;
mod stream;
mod trajectory_file;

pub use calibration::write_camera;
pub use error::DatasetError;
pub use options::OpenOptions;
pub use prepare::Frame;
pub use sequence::{Entry, LeftOut, Sequence};
pub use stream::FrameStream;
pub use trajectory_file::{read_trajectory, write_trajectory};
