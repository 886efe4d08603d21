//! Errors of sessions, and the checks of what goes into them.

use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;

/// An error while a frame is processed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The frame does not fit the camera of the session.
    #[error(
        "frame {index}: its {what} is {actual:?} pixels, expected {expected:?}: all frames of a \
         sequence must have one size"
    )]
    Size {
        /// Position in the associated stream.
        index: usize,
        /// Image of the frame: colour or depth.
        what: &'static str,
        /// Width and height of the frame.
        actual: (usize, usize),
        /// Width and height of the camera.
        expected: (usize, usize),
    },
    /// The data of an image do not match its size and channels.
    #[error(
        "frame {index}: its {what} holds {values} numbers in {channels} channels, expected \
         {expected} channels of its size"
    )]
    Channels {
        /// Position in the associated stream.
        index: usize,
        /// Image of the frame: colour, depth or depth variance.
        what: &'static str,
        /// Length of the data.
        values: usize,
        /// Declared channels.
        channels: usize,
        /// Required channels.
        expected: usize,
    },
    /// The time stamp of a keyframe is not finite.
    #[error("frame {index}: its time stamp is not finite")]
    Stamp {
        /// Position in the associated stream.
        index: usize,
    },
    /// The pose of a keyframe is not finite.
    #[error("frame {index}: its pose holds a number that is not finite")]
    Pose {
        /// Position in the associated stream.
        index: usize,
    },
    /// The map cannot be started with its settings: no further frame can be tracked.
    #[error("the map cannot be started: {source}")]
    Map {
        /// The invalid setting.
        source: SettingsError,
    },
}

/// Checks size and `channels` of one image of frame `index`.
pub(super) fn check_image(
    index: usize,
    (what, expected_channels): (&'static str, usize),
    image: &Image<f32>,
    camera: &Camera<f64>,
) -> Result<(), SessionError> {
    let (actual, expected) = ((image.width, image.height), (camera.width, camera.height));
    if actual != expected {
        return Err(SessionError::Size { index, what, actual, expected });
    }
    let (values, channels, expected) = (image.data.len(), image.channels, expected_channels);
    if channels != expected || values != expected * image.pixels() {
        return Err(SessionError::Channels { index, what, values, channels, expected });
    }
    Ok(())
}
