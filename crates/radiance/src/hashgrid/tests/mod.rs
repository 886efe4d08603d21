//! Tests of both lanes.

mod convergence;
mod files;
mod gradients;
mod occupancy;
mod parity;
mod poison;
mod scenes;
mod views;
