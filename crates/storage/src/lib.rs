//! Files: output folders that are written whole or not at all, and bounded reading of regular files.

mod read;

pub use read::{MAX_TEXT, open, read, read_text};
