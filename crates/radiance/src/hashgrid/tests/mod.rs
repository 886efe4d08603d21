//! Tests of both lanes.

mod convergence;
mod files;
mod gradients;
mod parity;
mod poison;
mod scenes;
