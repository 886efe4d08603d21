//! Tests of both lanes.

mod gradients;
mod parity;
mod poison;
mod scenes;
