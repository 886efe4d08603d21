//! A monocular front end: pictures in, camera poses, sparse and dense depth out.
//!
//! Points are followed through all pictures (pyramidal Lucas-Kanade with gain and bias, so that
//! exposure may change); two keyframes with parallax start a map, which grows keyframe by keyframe
//! by resection, triangulation and bundle adjustment; the frames between follow, and a last
//! adjustment takes all. Keyframes that were lost are found again by their looks, and a path is
//! closed where it returns to a place whose points were lost. The unit of length is arbitrary.
//! [`DenseDepthEstimator`] finds the depth of most pixels of keyframes afterwards.

mod bundle;
mod closure;
mod corners;
mod dense;
mod descriptor;
mod determined;
mod error;
mod focal;
mod front_end;
mod grow;
mod landmark;
mod lens;
mod look;
mod order;
mod patch;
mod pose_graph;
mod progress;
mod pyramid;
mod recognise;
mod relocalise;
mod resection;
mod result;
mod robust;
mod rolling;
mod scene;
mod shift;
mod sight;
mod similarity;
mod skyline;
mod start;
mod straighten;
mod tracker;
mod tracks;
mod triangulate;
mod two_view;
mod warning;

pub use dense::{DenseDepth, DenseDepthEstimator, PosedView};
pub use error::{OdometryError, PictureError};
pub use front_end::{FrontEnd, Intrinsics, MIN_FRAMES, MIN_SIDE};
pub use progress::{Progress, Stage};
pub use result::{FrameReport, FrameStatus, Keyframe, Reconstruction, SparseDepth};
pub use warning::Warning;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
