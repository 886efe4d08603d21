//! A recording of the finished run for another program (`--rerun`). Its format comes with many packages,
//! so that a program of its own brings what writes it.

use crate::arguments::Rerun;
use crate::failure::Failure;
use crate::output_file::check_folder;
use i2slam::geometry::Image;
use i2slam::{FrameEstimate, Reconstruction};
use i2slam_result::FrameFiles;
use i2slam_storage::{StorageError, write_file};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// First bytes of a recording.
const MAGIC: &[u8] = b"RRF2";

/// Contents of a recording.
pub struct RecordedRun<'a> {
    /// Name of the sequence.
    pub title: &'a str,
    /// Frames, map and camera.
    pub reconstruction: &'a Reconstruction,
    /// Files of the pictures taken, by which frames are called.
    pub files: &'a FrameFiles,
    /// False if time stamps are counted at an assumed frame rate, as those of photographs.
    pub has_times: bool,
    /// Loads the picture of a frame as filmed (planes R, G, B in `[0, 1]`); `None` where it cannot be
    /// read.
    pub load_picture: &'a mut dyn FnMut(&FrameEstimate) -> Option<Image<f32>>,
}

/// Writes the recording of a run.
pub type Recorder = fn(RecordedRun<'_>, &mut dyn Write) -> io::Result<()>;

/// A recording to be written when the run has ended.
#[derive(Clone)]
pub(crate) struct Recording {
    path: PathBuf,
    recorder: Recorder,
}

impl Recording {
    /// The recording that is asked for. Refused without a recorder, in `folders`, and in place of a file
    /// that is there, unless that is a recording and may be replaced.
    pub(crate) fn of(
        Rerun { rerun }: &Rerun,
        recorder: Option<Recorder>,
        folders: [&Path; 2],
        overwrite: bool,
    ) -> Result<Option<Self>, Failure> {
        let Some(path) = rerun else { return Ok(None) };
        let refused = |why: &str| Err(Failure::Usage(format!("--rerun {}: {why}", path.display())));
        let Some(recorder) = recorder else {
            return refused(
                "this program was built without recordings: in the repository, `cargo install --path \
                 crates/rerun` builds it with them",
            );
        };
        if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("rrd")) {
            return refused("the name of a recording ends with .rrd");
        }
        if path.symlink_metadata().is_ok() {
            match (is_recording(path), overwrite) {
                (true, true) => {}
                (true, false) => return refused("the recording exists, choose another name"),
                (false, _) => return refused("it exists and is no recording, choose another name"),
            }
        }
        match check_folder(path, folders) {
            Ok(()) => Ok(Some(Self { path: path.clone(), recorder })),
            Err(why) => refused(why),
        }
    }

    /// Writes the file, whole or not at all.
    pub(crate) fn write(&self, run: RecordedRun<'_>) -> Result<(), StorageError> {
        write_file(&self.path, |out| (self.recorder)(run, out))
    }
}

fn is_recording(path: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    let read = i2slam_storage::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && head == MAGIC
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;
    use std::fs;

    #[test]
    fn a_file_that_is_there_is_refused_unless_it_is_a_recording_to_be_replaced() {
        let scratch = TemporaryFolder::new("recording");
        let path = scratch.join("run.rrd");
        let recorder: Recorder = |run, out| out.write_all(run.title.as_bytes());
        let of = |name: &str, recorder, overwrite| {
            let rerun = Rerun { rerun: Some(scratch.join(name)) };
            let found =
                Recording::of(&rerun, recorder, [Path::new("no"), Path::new("no")], overwrite);
            found.map(|found| found.expect("asked for"))
        };
        let refusal = |name: &str, recorder, overwrite| match of(name, recorder, overwrite) {
            Err(failure) => failure.message().unwrap_or_default().to_owned(),
            Ok(_) => String::new(),
        };
        assert!(refusal("run.rrd", None, true).contains("cargo install --path crates/rerun"));
        assert!(refusal("run.txt", Some(recorder), true).contains("ends with .rrd"));
        assert!(refusal("no/run.rrd", Some(recorder), true).contains("no such folder"));
        let write = |title| {
            let recording = of("run.rrd", Some(recorder), true).expect("not refused");
            let reconstruction = i2slam::Session::refining(
                i2slam::Config::default(),
                i2slam::geometry::Camera {
                    fx: 8.0,
                    fy: 8.0,
                    cx: 4.0,
                    cy: 3.0,
                    width: 8,
                    height: 6,
                },
                30.0,
            )
            .reconstruction();
            let load_picture: &mut dyn FnMut(&FrameEstimate) -> Option<Image<f32>> = &mut |_| None;
            let (reconstruction, files) = (&reconstruction, &FrameFiles::default());
            let has_times = true;
            let run = RecordedRun { title, reconstruction, files, has_times, load_picture };
            recording.write(run).expect("room");
            fs::read_to_string(&path).expect("written")
        };
        assert_eq!(write("RRF2 one"), "RRF2 one");
        assert!(refusal("run.rrd", Some(recorder), false).contains("the recording exists"));
        assert_eq!(write("RRF2 two"), "RRF2 two");
        fs::write(&path, "mine").expect("room");
        assert!(refusal("run.rrd", Some(recorder), true).contains("is no recording"));
    }
}
