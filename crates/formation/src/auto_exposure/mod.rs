//! Exposure of views that nobody took: what the camera would have chosen for what is seen there.
//!
//! A camera on automatic exposure meters the light of the view and follows it with some delay. From
//! the frames of a run, which exposures it chose for what the map shows are known, and meter, line and
//! delay are fitted to them (as the controller of PPISP, Deutsch et al. 2026, is by training; here by least
//! squares):
//!
//! ```text
//! ln Δt = clamp(a + b y),   τ dy/dt = m - y,   m = ln of metered light
//! ```

mod controller;
mod fit;
mod metering;

pub use controller::{AutoExposure, ExposureFollower};
pub use fit::{AutoExposureFit, ExposureSample};
pub use metering::{Meter, Metering};

#[cfg(test)]
mod tests;
