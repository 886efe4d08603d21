//! Poses as lines of text while the frames come (`--poses`): for a robot, a plot, another program.

use crate::console::print_status;
use crate::failure::Failure;
use i2slam::geometry::StampedPose;
use i2slam_result::{UnitOfLength, online_trajectory, trajectory_line};
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Writer of a line for every pose, in the TUM format, as soon as it is known. Nobody who stops reading
/// ends the run.
pub(crate) struct PoseLines {
    path: PathBuf,
    state: Mutex<State>,
}

struct State {
    /// `None` once a line could not be written.
    out: Option<Box<dyn Write + Send>>,
    last: f64,
}

impl PoseLines {
    /// Opens a file, or the standard output for `-`, where results then go to standard error. An
    /// earlier file is replaced on demand alone; a named pipe waits for its reader.
    pub(crate) fn open(path: &Path, overwrite: bool, unit: UnitOfLength) -> Result<Self, Failure> {
        let out: Box<dyn Write + Send> = if path == Path::new("-") {
            Box::new(io::stdout())
        } else {
            let name = path.display();
            if path.is_file() && !overwrite {
                return Err(Failure::Usage(format!(
                    "--poses {name}: the file exists, choose another name or add --overwrite"
                )));
            }
            let file = OpenOptions::new().write(true).create(true).truncate(true).open(path);
            Box::new(file.map_err(|error| Failure::Failed(format!("--poses {name}: {error}")))?)
        };
        let state = Mutex::new(State { out: Some(out), last: f64::NEG_INFINITY });
        let lines = Self { path: path.to_owned(), state };
        lines.write(|out| out.write_all(online_trajectory(&[], unit).as_bytes()));
        Ok(lines)
    }

    /// Whether lines go to the standard output, which results then leave to them.
    pub(crate) fn is_standard_output(&self) -> bool {
        self.path == Path::new("-")
    }

    /// Writes the pose of a frame. A stream whose time stamps had to be repaired is tracked twice: the
    /// first pose of a frame counts.
    pub(crate) fn add(&self, pose: &StampedPose) {
        if let Ok(mut state) = self.state.lock() {
            if pose.timestamp <= state.last {
                return;
            }
            state.last = pose.timestamp;
        }
        self.write(|out| out.write_all(trajectory_line(pose).as_bytes()));
    }

    fn write(&self, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) {
        let Ok(mut state) = self.state.lock() else { return };
        let Some(out) = &mut state.out else { return };
        if let Err(error) = write(out).and_then(|()| out.flush()) {
            state.out = None;
            let name = self.path.display();
            print_status(&format!("warning: no more poses are written to {name}: {error}"));
        }
    }
}
