//! What of imported keyframes is wanted.

use crate::OpenOptions;
use std::path::PathBuf;

/// Which depth imported keyframes get.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Depth {
    /// None.
    None,
    /// What the imported files themselves hold, if anything.
    #[default]
    Imported,
    /// That of the depth pictures of the sequence.
    Pictures,
}

/// How keyframes are opened. Start from [`Options::default`].
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// How the pictures are opened. `association_tolerance` also bounds the distance in time
    /// between a pose and its picture; `frames` and `stride` choose among the pictures, and poses
    /// of others are left out; poses of pictures that
    /// `minimum_gap` leaves out are too, with a warning, so that frames have the numbers of the
    /// dataset opened alike; default 0 here. `colour_only` does not matter.
    pub open: OpenOptions,
    /// Which depth is taken.
    pub depth: Depth,
    /// A folder with the variance of the depth pictures, by the names or numbers of these or of
    /// the colour pictures: `.npy` arrays of the variance [m²], or 16-bit PNG of the standard
    /// deviation, on the scale of the depth pictures.
    pub variance: Option<PathBuf>,
    /// Whether depths and poses of some neighbours are compared, to warn of wrong conventions.
    /// Default true.
    pub check_conventions: bool,
    /// Whether pictures in arrays have their channels in the order R, G, B, or B, G, R. Default
    /// `None`: by the name of the array, `images` as DROID-SLAM keeps them (B, G, R) or
    /// `cam0_images` as NeRF-SLAM does (R, G, B).
    pub arrays_are_rgb: Option<bool>,
    /// How many colour images of the sequence one step of whole time stamps counts, which is the
    /// stride of the program that wrote them (`--stride` of DROID-SLAM's `demo.py`, 3 unless said
    /// otherwise); at least 1. Default 1.
    pub frames_per_stamp: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            open: OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() },
            depth: Depth::default(),
            variance: None,
            check_conventions: true,
            arrays_are_rgb: None,
            frames_per_stamp: 1,
        }
    }
}
