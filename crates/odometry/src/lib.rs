//! Visual odometry: pictures in, with measured depth or without; camera poses, sparse and dense
//! depth out.
//!
//! Points are tracked through all pictures; a keyframe with measured depth, or two keyframes with
//! parallax, start a map, to which every frame is registered when it comes, with bundle adjustment
//! around every keyframe; loops are closed when a place is seen again. At the end all frames are
//! adjusted together: keyframes without a pose are relocalized by what they look like, and loops are
//! closed that are left. With depth, frames are aligned to the keyframes around them by picture and
//! depth, too, and lengths are metres; the unit is arbitrary otherwise. [`DenseDepthEstimator`]
//! computes the depth of most pixels of keyframes afterwards.
//!
//! Folders, each using only those above it:
//!
//! | folder | |
//! |---|---|
//! | `track` | KLT tracking of corners from picture to picture, choice of keyframes |
//! | `depth` | depth pictures, their registration, and the model of the sensor that took them |
//! | `features` | SIFT features, and verified matches of photographs that points cannot be tracked through |
//! | `multiview` | geometry of few views: landmarks, lens distortion, triangulation, PnP, essential matrix |
//! | `bundle` | bundle adjustment and the covariance of the intrinsics |
//! | `sfm_state` | camera, poses, landmarks and tracks so far |
//! | `segmentation` | tracks of large moving objects, left out of the map |
//! | `register` | initialization, registration of all other frames, dense constraints |
//! | `intrinsics` | search for the focal length, observability of focal length and distortion |
//! | `rolling_shutter` | estimation of the readout, correction of image positions |
//! | `relocalize` | keyframes recognised in others by descriptors and geometric verification |
//! | `loops` | loop closure by a pose graph of similarities |
//! | `online` | the map so far, and the pose of a frame when it comes |
//! | `diagnosis` | wrong input: pictures of one colour, frozen or shuffled frames, large moving objects |
//! | `result`, `front_end` | the result, and the pipeline from pictures to it |
//! | `alignment` | dense alignment of a frame to a target by picture and depth; stands alone |
//! | `dense` | dense depth by fused readings, plane sweep and semi-global matching; uses `track`, `depth` |

mod error;
#[cfg(test)]
mod fixtures;
mod progress;
mod warning;

mod track {
    pub(crate) mod corners;
    pub(crate) mod global_translation;
    pub(crate) mod motion_blur;
    pub(crate) mod patch;
    pub(crate) mod point_search;
    pub(crate) mod pyramid;
    pub(crate) mod thumbnail;
    pub(crate) mod tracker;
    pub(crate) mod tracks;
}

mod depth {
    pub(crate) mod calibration;
    pub(crate) mod depth_map;
    pub(crate) mod pairing;
    pub(crate) mod readings;
    pub(crate) mod registration;
    pub(crate) mod scale;
    pub(crate) mod sensor_model;
    pub(crate) mod stored_picture;
}

mod multiview {
    pub(crate) mod a_contrario;
    pub(crate) mod landmark;
    pub(crate) mod lens_distortion;
    pub(crate) mod pnp;
    pub(crate) mod robust_loss;
    pub(crate) mod triangulation;
    pub(crate) mod two_view;
    pub(crate) mod whitening;
}

mod features;

mod bundle;
mod sfm_state;

mod segmentation {
    pub(crate) mod least_median;
    pub(crate) mod moving_tracks;
    pub(crate) mod picture_share;
    pub(crate) mod relative_motion;
}

mod register {
    pub(crate) mod approximate_poses;
    pub(crate) mod dense_constraints;
    pub(crate) mod first_pairs;
    pub(crate) mod initialization;
    pub(crate) mod known_path;
    pub(crate) mod missing_matches;
    pub(crate) mod photographs;
    pub(crate) mod position_refinement;
    pub(crate) mod registration;
    pub(crate) mod resection_intersection;
}

mod intrinsics {
    pub(crate) mod focal_length;
    pub(crate) mod observability;
}

mod rolling_shutter {
    pub(crate) mod frame_motion;
    pub(crate) mod readout;
    pub(crate) mod rolling_shutter_init;
}

mod relocalize {
    pub(crate) mod descriptor;
    pub(crate) mod geometric_verification;
    pub(crate) mod relocalization;
    pub(crate) mod view_overlap;
}

mod online {
    pub(crate) mod frame_update;
    pub(crate) mod local_map;
    mod map_restart;
    pub(crate) mod online_map;
    pub(crate) mod path_alignment;
    pub(crate) mod revisits;
}

mod loops {
    pub(crate) mod loop_closure;
    pub(crate) mod pose_graph;
}

pub mod alignment;

mod diagnosis {
    pub(crate) mod findings;
    pub(crate) mod frozen;
    pub(crate) mod motion;
    pub(crate) mod moving_object;
    pub(crate) mod order;
    pub(crate) mod pictures;
}

mod front_end;
mod keyframe_density;
mod map_building;
mod pose_deviation;
mod result;

mod dense;
mod relative_blur;

pub use dense::{
    DenseDepth, DenseDepthEstimator, KeyframePictures, MAX_KEYFRAME_DISTANCE,
    MAX_PHOTOGRAPH_DISTANCE, MeasuredDepth, PosedView,
};
pub use depth::depth_map::DepthPicture;
pub use depth::registration::register_depth;
pub use depth::sensor_model::DepthModel;
pub use diagnosis::pictures::blank_reason;
pub use error::{OdometryError, PictureError};
pub use front_end::{FrontEnd, MIN_FRAMES, MIN_POSED_SHARE, MIN_SIDE};
pub use intrinsics::focal_length::Intrinsics;
pub use online::frame_update::{FrameUpdate, TrackingStatus};
pub use online::path_alignment::align_path;
pub use pose_deviation::{MIN_NEIGHBOURS, NEIGHBOUR_WINDOW, PoseDeviation};
pub use progress::{Progress, Stage};
pub use relative_blur::photograph_motions;
pub use result::{Keyframe, Reconstruction, SparseDepth};
pub use warning::Warning;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
