//! Errors of the odometry.

use crate::depth::depth_map::DepthPicture;
use i2slam_geometry::Image;
use thiserror::Error;

/// Reason why there is no camera path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum OdometryError {
    /// Too few pictures.
    #[error(
        "{frames} pictures are too few: a path needs at least {needed} that show the same scene from different places"
    )]
    TooFewFrames {
        /// Accepted pictures.
        frames: usize,
        /// Pictures needed.
        needed: usize,
    },
    /// Hardly any point could be tracked or matched.
    #[error(
        "too few points of one picture were found in another: the scene has too little texture, or the pictures are too dark, too blurred, or taken from places that are too far apart (photographs need 20 degrees or less to the next one)"
    )]
    TooFewPoints,
    /// Nothing moves in the pictures.
    #[error(
        "the camera stands still: points move by {motion:.1} pixels at most; depth needs a camera that changes its place"
    )]
    StillCamera {
        /// Largest median motion between two keyframes [px].
        motion: f64,
    },
    /// The camera turned about its own centre.
    #[error(
        "the camera only turned: a rotation explains all motion up to {residual:.1} pixels; depth needs a camera that changes its place"
    )]
    RotationOnly {
        /// Largest median residual of a rotation between two keyframes [px].
        residual: f64,
    },
    /// The motion is not that of a camera in a rigid scene.
    #[error(
        "no two pictures agree on a motion of the camera: the scene itself moves, or the intrinsics are far off; check them or let the focal length be estimated"
    )]
    NoConsistentMotion,
    /// A picture could not be read back from the [`ScratchStore`](i2slam_storage::ScratchStore).
    #[error(
        "a picture that had left memory could not be read back from the scratch file ({reason}): check the disk, or allow more memory"
    )]
    Scratch {
        /// Kind of the failure.
        reason: std::io::ErrorKind,
    },
    /// Cancelled through [`Progress`](crate::Progress).
    #[error("ended before the path of the camera was found")]
    Cancelled,
}

/// Reason why a picture was refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PictureError {
    /// Size other than the camera's.
    #[error(
        "a picture of {}x{} pixels, but the camera's are {}x{}",
        .size[0], .size[1], .expected[0], .expected[1]
    )]
    Size {
        /// Width and height of the picture [px].
        size: [usize; 2],
        /// Those of the camera's pictures [px].
        expected: [usize; 2],
    },
    /// Too small for tracking.
    #[error(
        "a picture of {}x{} pixels is too small: each side needs at least {least}",
        .size[0], .size[1]
    )]
    TooSmall {
        /// Width and height of the picture [px].
        size: [usize; 2],
        /// Smallest side [px].
        least: usize,
    },
    /// Neither one plane nor three, or incomplete ones.
    #[error(
        "a picture of {channels} planes and {values} values: expected one or three complete planes"
    )]
    Planes {
        /// Planes that the picture claims.
        channels: usize,
        /// Values that it has.
        values: usize,
    },
    /// Depth of another size than the camera's pictures, or of more than one plane.
    #[error(
        "depth of {}x{} pixels: expected one plane of {}x{}",
        .size[0], .size[1], .expected[0], .expected[1]
    )]
    Depth {
        /// Width and height of the depth picture [px].
        size: [usize; 2],
        /// Those of the camera's pictures [px].
        expected: [usize; 2],
    },
    /// Depth with a timestamp that is not a number.
    #[error(
        "depth with timestamp {timestamp} s: expected a number of seconds by the clock of the pictures"
    )]
    DepthStamp {
        /// Timestamp of the depth picture [s].
        timestamp: f64,
    },
    /// Timestamp not above the one before.
    #[error("timestamp {timestamp} s after {last} s: timestamps must increase")]
    Stamp {
        /// Timestamp of the picture [s].
        timestamp: f64,
        /// Timestamp of the one before [s].
        last: f64,
    },
}

impl PictureError {
    /// Refuses a picture that is not of the `expected` size, has a side shorter than `least` pixels, or no
    /// colour or grey planes of that size.
    pub(crate) fn check(
        picture: &Image<f32>,
        expected: [usize; 2],
        least: usize,
    ) -> Result<(), Self> {
        let size = [picture.width, picture.height];
        if size != expected {
            return Err(Self::Size { size, expected });
        }
        if size[0].min(size[1]) < least {
            return Err(Self::TooSmall { size, least });
        }
        let (channels, values) = (picture.channels, picture.data.len());
        match matches!(channels, 1 | 3) && values == picture.pixels() * channels {
            true => Ok(()),
            false => Err(Self::Planes { channels, values }),
        }
    }

    /// Refuses measured depth that is not one plane of the `expected` size, or has no time stamp.
    pub(crate) fn check_depth(
        &DepthPicture { depth, timestamp }: &DepthPicture<'_>,
        expected: [usize; 2],
    ) -> Result<(), Self> {
        let (channels, values) = (depth.channels, depth.data.len());
        let size = [depth.width, depth.height];
        if size != expected || channels != 1 || values != depth.pixels() {
            return Err(Self::Depth { size, expected });
        }
        match timestamp.is_finite() {
            true => Ok(()),
            false => Err(Self::DepthStamp { timestamp }),
        }
    }
}
