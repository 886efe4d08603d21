//! Poses as lines of text while the frames come (`--poses`): for a robot, a plot, another program.

use crate::console::print_status;
use crate::failure::Failure;
use crate::output_file::{check_folder, previous};
use i2slam::geometry::StampedPose;
use i2slam_result::{UnitOfLength, online_trajectory, trajectory_line};
use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

/// Time that a reader gets for the last lines when the run has ended.
const LAST_LINES: Duration = Duration::from_secs(2);

/// Writer of a line for every pose, in the TUM format, as soon as it is known. Lines are written on a
/// thread of their own: a reader that is slow, or stops, holds no frame up.
pub(crate) struct PoseLines {
    path: PathBuf,
    /// The first lines.
    head: String,
    /// True if poses of an earlier run are moved out of the way.
    overwrite: bool,
    /// Lines to be written, and the end of the thread that does; `None` before the first one.
    writer: Mutex<Option<(Sender<String>, Receiver<()>)>>,
    /// Number of poses, and time stamp of the first one [s].
    written: Mutex<(usize, f64)>,
}

impl PoseLines {
    /// Checks the name of a file; `-` is the standard output, where results then go to standard error.
    /// It is opened with the first pose, so that a run that is refused leaves nothing. A file that
    /// exists is refused, unless it has poses of an earlier run, which then move, and so is one in the
    /// dataset or among the results.
    pub(crate) fn new(
        path: &Path,
        folders: [&Path; 2],
        unit: UnitOfLength,
        overwrite: bool,
    ) -> Result<Self, Failure> {
        let refused = |why: &str| Err(Failure::Usage(format!("--poses {}: {why}", path.display())));
        if path != Path::new("-") {
            if path.is_dir() {
                return refused("it is a folder, name a file in it");
            }
            match path.is_file().then(|| has_poses(path)) {
                Some(true) if !overwrite => {
                    return refused(
                        "it has the poses of an earlier run: choose another name, or move them to \
                         FILE.previous with --overwrite",
                    );
                }
                Some(false) => return refused("the file exists, choose another name"),
                Some(true) if previous(path).exists() && !has_poses(&previous(path)) => {
                    return refused("FILE.previous has no poses, choose another name");
                }
                _ => {}
            }
            if let Err(why) = check_folder(path, folders) {
                return refused(why);
            }
        }
        let head = online_trajectory(&[], unit);
        let (writer, written) = (Mutex::default(), Mutex::default());
        Ok(Self { path: path.to_owned(), head, overwrite, writer, written })
    }

    /// True for `-`: poses go to the standard output, and results to standard error.
    pub(crate) fn is_standard_output(&self) -> bool {
        self.path == Path::new("-")
    }

    /// Hands the pose of a frame to the writer.
    pub(crate) fn add(&self, pose: &StampedPose) {
        let Ok(mut writer) = self.writer.lock() else { return };
        let (lines, _) = writer.get_or_insert_with(|| self.start());
        // Fails only if a line could not be written, which was told.
        lines.send(trajectory_line(pose)).ok();
        if let Ok(mut written) = self.written.lock() {
            let first = if written.0 == 0 { pose.timestamp } else { written.1 };
            *written = (written.0 + 1, first);
        }
    }

    /// Says at the end of a run of so many frames how many poses were known while they came, unless all were.
    pub(crate) fn report(&self, frames: usize) {
        let place = match self.is_standard_output() {
            true => "the standard output".into(),
            false => self.path.display().to_string(),
        };
        let in_the_end = "trajectory.txt of the result has those that were found in the end";
        let Ok(written) = self.written.lock() else { return };
        match *written {
            (0, _) => print_status(&format!(
                "warning: no pose was known while frames came, so that none was written to {place}; {in_the_end}"
            )),
            (count, first) if count < frames => print_status(&format!(
                "{count} poses of {frames} frames, from the time {first:.3} s on, were known while frames \
                 came, and written to {place}; {in_the_end}"
            )),
            _ => {}
        }
    }

    fn start(&self) -> (Sender<String>, Receiver<()>) {
        let ((lines, given), (ended, end)) = (channel(), channel());
        let (path, head, overwrite) = (self.path.clone(), self.head.clone(), self.overwrite);
        thread::spawn(move || {
            if let Err(error) = write_lines((&path, overwrite), &head, &given) {
                let name = path.display();
                print_status(&format!("warning: no more poses are written to {name}: {error}"));
            }
            ended.send(()).ok();
        });
        (lines, end)
    }
}

impl Drop for PoseLines {
    fn drop(&mut self) {
        let Some((lines, end)) = self.writer.get_mut().ok().and_then(Option::take) else { return };
        drop(lines);
        if let Err(RecvTimeoutError::Timeout) = end.recv_timeout(LAST_LINES) {
            let name = self.path.display();
            print_status(&format!("warning: nobody reads the last poses from {name}"));
        }
    }
}

/// True if a file begins as those with poses do.
fn has_poses(path: &Path) -> bool {
    let heads =
        [UnitOfLength::Metre, UnitOfLength::Unknown].map(|unit| online_trajectory(&[], unit));
    let longest = heads.iter().map(String::len).max().unwrap_or(0);
    let mut start = String::new();
    let read = i2slam_storage::open(path)
        .and_then(|file| file.take(longest as u64).read_to_string(&mut start));
    read.is_ok() && heads.iter().any(|head| start.starts_with(head))
}

/// Writes all lines, each at once. A named pipe waits for its reader.
fn write_lines(
    (path, overwrite): (&Path, bool),
    head: &str,
    lines: &Receiver<String>,
) -> io::Result<()> {
    let mut out: Box<dyn Write> = if path == Path::new("-") {
        Box::new(io::stdout())
    } else {
        // A file that somebody has made since the name was checked is not overwritten.
        let is_pipe = path.exists() && !path.is_file();
        if overwrite && path.is_file() && has_poses(path) {
            fs::rename(path, previous(path))?;
        }
        Box::new(OpenOptions::new().write(true).create_new(!is_pipe).open(path)?)
    };
    out.write_all(head.as_bytes())?;
    for line in lines {
        out.write_all(line.as_bytes())?;
        out.flush()?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::geometry::Pose;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn poses_of_an_earlier_run_are_moved_where_that_is_asked_for() {
        let scratch = TemporaryFolder::new("pose-lines");
        let path = scratch.join("poses.txt");
        let no = Path::new("no");
        let run = |timestamp: f64, overwrite| {
            let lines = PoseLines::new(&path, [no, no], UnitOfLength::Metre, overwrite)?;
            lines.add(&StampedPose { timestamp, world_from_camera: Pose::identity() });
            Ok::<(), Failure>(())
        };
        let is_of = |stamp: &str| {
            let text = fs::read_to_string(&path).expect("poses");
            let poses = text.lines().filter(|line| !line.starts_with('#'));
            poses.map(|line| line.starts_with(stamp)).collect::<Vec<bool>>() == [true]
        };
        run(1.5, false).expect("a new file");
        assert!(run(2.5, false).is_err() && is_of("1.5"));
        run(2.5, true).expect("an earlier one");
        assert!(is_of("2.5"));
        let earlier = fs::read_to_string(previous(&path)).expect("the earlier one");
        assert!(earlier.lines().any(|line| line.starts_with("1.5")));
        fs::write(&path, "2.5 of somebody else\n").expect("room");
        assert!(run(3.5, true).is_err() && is_of("2.5 of somebody else"));
    }
}
