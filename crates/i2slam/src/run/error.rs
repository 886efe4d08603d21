//! Errors of a run.

use crate::config::ConfigError;
use crate::keyframes::MonocularError;
use crate::session::SessionError;
use i2slam_dataset::DatasetError;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use thiserror::Error;

/// Why a run gave no reconstruction, or ended early.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// The observer cancelled it before there was anything to keep.
    #[error("ended before {before}: there is nothing to write")]
    Cancelled {
        /// The step that was not reached.
        before: &'static str,
    },
    /// Settings that contradict each other.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A preset for another kind of input.
    #[error(
        "preset {preset} is for {}",
        if *.with_depth { "colour alone" } else { "colour with depth" }
    )]
    Preset {
        /// Name of the preset.
        preset: String,
        /// Whether the run has depth.
        with_depth: bool,
    },
    /// Distortion was to be estimated where the camera is known.
    #[error(
        "lens distortion is estimated only where the camera is unknown; this one is given by \
         {source_of_camera}"
    )]
    KnownCamera {
        /// File or option that gives the camera.
        source_of_camera: String,
    },
    /// Keyframes of another program cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Visual odometry failed.
    #[error("no path of the camera was found: {0}")]
    NoPath(MonocularError),
    /// Keyframes of another program without depth, for a map of Gaussians.
    #[error(
        "the keyframes have no depth, which Gaussians begin on, and none was found in their pictures: \
         give depth, or make a radiance field, which needs none (--map hashgrid)"
    )]
    NoDepth,
    /// Not one frame could be used.
    #[error("{what}: {reason}")]
    NoUsableFrame {
        /// Frames or keyframes, in words.
        what: String,
        /// The first error.
        reason: String,
    },
    /// A frame ended the run.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A panic, which is a mistake of this library.
    #[error("this is a mistake of i2slam, please report it: {message}")]
    Panic {
        /// Its text.
        message: String,
    },
}

/// Runs `work` and turns a panic into [`RunError::Panic`], so that results so far can be kept.
pub(super) fn catch_panic<T>(work: impl FnOnce() -> Result<T, RunError>) -> Result<T, RunError> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|payload| Err(RunError::Panic { message: text(payload.as_ref()) }))
}

fn text(payload: &(dyn Any + Send)) -> String {
    let literal = payload.downcast_ref::<&str>().map(ToString::to_string);
    literal.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_errors_with_their_text() {
        let number = 7;
        for (panic, text) in [
            (catch_panic::<()>(|| panic!("lost the thread")), "report it: lost the thread"),
            (catch_panic::<()>(|| panic!("lost frame {number}")), "lost frame 7"),
        ] {
            let error = panic.expect_err("a panic").to_string();
            assert!(error.contains(text), "{error}");
        }
        assert!(matches!(catch_panic(|| Ok(1)), Ok(1)));
    }
}
