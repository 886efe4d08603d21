//! Tests of both lanes.

mod gradients;
mod moving;
mod moving_gradients;
mod parity;
mod poison;
mod scenes;
