//! The odometry as its users call it, on small rendered pictures of a room.

mod dense;
mod front_end;
mod progress;
mod revisits;
mod scene;
