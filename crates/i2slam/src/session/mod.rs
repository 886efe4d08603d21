//! Sessions: frames or keyframes go in one by one, a reconstruction comes out.

mod backend;
mod error;
mod keyframe;
mod online;
mod runtime_estimate;
mod state;

pub use error::SessionError;
pub use keyframe::KeyframeSession;
pub use online::Session;
pub use runtime_estimate::RuntimeEstimate;

#[cfg(test)]
mod tests;
