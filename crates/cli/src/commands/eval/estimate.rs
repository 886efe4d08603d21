//! Input of an evaluation: a result folder, a trajectory, or pictures.

use crate::failure::{Failure, failed};
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam_result::{UnitOfLength, unit_of_trajectory};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Estimate that is compared with ground truth.
pub(super) enum Estimate {
    /// Folder with `trajectory.txt`, `renders/` and, unless another system wrote it, `frames.csv`.
    Result(PathBuf),
    /// A trajectory file.
    Trajectory(PathBuf),
    /// A folder of PNG or EXR pictures.
    Pictures(PathBuf),
}

/// A row of `frames.csv`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RunFrame {
    pub(super) index: usize,
    pub(super) timestamp: f64,
    pub(super) keyframe: bool,
    /// Whether the map never saw it; false without that column.
    pub(super) held_out: bool,
    /// Exposure and gains of red, green and blue, where the table has them.
    pub(super) exposure: Option<f64>,
    pub(super) white_balance: Option<[f64; 3]>,
}

impl Estimate {
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        if !path.exists() {
            return Err(unsuitable(path, "no such file or folder"));
        }
        if !path.is_dir() {
            return Ok(Self::Trajectory(path.to_owned()));
        }
        if path.join("trajectory.txt").is_file() {
            return Ok(Self::Result(path.to_owned()));
        }
        for extension in ["png", "exr"] {
            if !picture_files(path, extension)?.is_empty() {
                return Ok(Self::Pictures(path.to_owned()));
            }
        }
        Err(unsuitable(path, &difference_from_estimate(path)))
    }

    pub(super) fn trajectory(&self) -> Option<PathBuf> {
        match self {
            Self::Result(folder) => Some(folder.join("trajectory.txt")),
            Self::Trajectory(file) => Some(file.clone()),
            Self::Pictures(_) => None,
        }
    }

    /// Poses of a result as they were known when their frames came, if it has them.
    pub(super) fn online_trajectory(&self) -> Option<PathBuf> {
        self.result().map(|folder| folder.join("trajectory_online.txt")).filter(|f| f.is_file())
    }

    /// Unit of length by the header of the trajectory; metres without one.
    pub(super) fn unit_of_length(&self) -> Result<UnitOfLength, Failure> {
        let Some(path) = self.trajectory() else { return Ok(UnitOfLength::Metre) };
        let text = i2slam_storage::read_text(&path).map_err(|e| failed(&path, e))?;
        Ok(unit_of_trajectory(&text))
    }

    pub(super) fn result(&self) -> Option<&Path> {
        match self {
            Self::Result(folder) => Some(folder),
            _ => None,
        }
    }

    /// Rendered pictures of one kind by frame; the pictures themselves of a folder of pictures.
    pub(super) fn renders(&self, kind: &str, extension: &str) -> Result<PictureFiles, Failure> {
        let folder = match self {
            Self::Result(folder) => folder.join("renders").join(kind),
            Self::Pictures(folder) => folder.clone(),
            Self::Trajectory(_) => return Ok(PictureFiles::new()),
        };
        if folder.is_dir() { picture_files(&folder, extension) } else { Ok(PictureFiles::new()) }
    }

    /// Rows of `frames.csv`, if there is one.
    pub(super) fn run_frames(&self) -> Result<Option<Vec<RunFrame>>, Failure> {
        let path = match self.result() {
            Some(folder) => folder.join("frames.csv"),
            None => return Ok(None),
        };
        if !path.is_file() {
            return Ok(None);
        }
        let text = i2slam_storage::read_text(&path).map_err(|e| failed(&path, e))?;
        run_frames(&text).map(Some).map_err(|reason| failed(&path, reason))
    }
}

/// Refusal of a path that names no estimate.
fn unsuitable(path: &Path, reason: &str) -> Failure {
    Failure::Usage(format!("{}: {reason}", path.display()))
}

/// Reason why a folder cannot be evaluated.
fn difference_from_estimate(path: &Path) -> String {
    let shown = path.display();
    if path.read_dir().is_ok_and(|mut entries| entries.next().is_none()) {
        return "the folder is empty: a result folder, a trajectory or pictures are evaluated"
            .into();
    }
    if path.join("frames.csv").is_file() {
        return "a result without its trajectory.txt: there is nothing to evaluate".to_owned();
    }
    match Sequence::open(path, &OpenOptions::default()) {
        Ok(_) => format!(
            "a dataset, and no result yet: `i2slam run {shown} --out RESULT` makes one, `i2slam \
             eval RESULT` evaluates it"
        ),
        Err(_) => {
            "holds neither trajectory.txt nor pictures (PNG, EXR): it is no result".to_owned()
        }
    }
}

/// Picture files by frame number: their names, or their positions if not all names are numbers.
pub(super) type PictureFiles = BTreeMap<usize, PathBuf>;

/// Lists the pictures with this extension in a folder.
pub(super) fn picture_files(folder: &Path, extension: &str) -> Result<PictureFiles, Failure> {
    let entries = std::fs::read_dir(folder).map_err(|e| failed(folder, e))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    let alike =
        |file: &PathBuf| file.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    files.retain(alike);
    files.sort();
    let number = |file: &PathBuf| file.file_stem()?.to_str()?.parse::<usize>().ok();
    let numbered = files.iter().all(|file| number(file).is_some());
    let place = |(i, file): (usize, PathBuf)| match number(&file) {
        Some(index) if numbered => (index, file),
        _ => (i, file),
    };
    Ok(files.into_iter().enumerate().map(place).collect())
}

fn run_frames(text: &str) -> Result<Vec<RunFrame>, String> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| {
        let place = names.iter().position(|n| *n == name);
        place.ok_or_else(|| format!("has no column `{name}`"))
    };
    let (index, timestamp, keyframe) =
        (column("index")?, column("timestamp")?, column("keyframe")?);
    let held_out = names.iter().position(|n| *n == "held_out");
    let optional = |name: &str| names.iter().position(|n| *n == name);
    let exposure = optional("exposure");
    let gains = ["r", "g", "b"].map(|c| optional(&format!("white_balance_{c}")));
    let rows = lines.enumerate().filter(|(_, line)| !line.is_empty());
    rows.map(|(row, line)| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |i: Option<usize>| cells.get(i?)?.parse::<f64>().ok();
        let balance = || Some([number(gains[0])?, number(gains[1])?, number(gains[2])?]);
        let frame = || {
            Some(RunFrame {
                index: cells.get(index)?.parse().ok()?,
                timestamp: cells.get(timestamp)?.parse().ok()?,
                keyframe: *cells.get(keyframe)? != "0",
                held_out: held_out.is_some_and(|i| cells.get(i).is_some_and(|c| *c != "0")),
                exposure: number(exposure),
                white_balance: balance(),
            })
        };
        frame().ok_or_else(|| format!("line {} is no frame", row + 2))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_by_column_names() {
        let frames = run_frames("timestamp,index,x,keyframe\n1.5,7,0,1\n\n2.5,8,0,0\n");
        let frame = |index, timestamp, keyframe| RunFrame {
            index,
            timestamp,
            keyframe,
            ..RunFrame::default()
        };
        assert_eq!(frames, Ok(vec![frame(7, 1.5, true), frame(8, 2.5, false)]));
        let held = run_frames("index,timestamp,keyframe,held_out\n7,1.5,0,1\n8,2,1,0\n");
        let held = held.map(|frames| frames.iter().map(|f| f.held_out).collect());
        assert_eq!(held, Ok(vec![true, false]));
        let table = "index,timestamp,keyframe,white_balance_b,white_balance_g,white_balance_r,\
                     exposure\n7,1.5,1,0.8,1,1.2,0.5\n";
        let tone = run_frames(table).expect("a frame")[0];
        assert_eq!((tone.exposure, tone.white_balance), (Some(0.5), Some([1.2, 1.0, 0.8])));
        assert!(run_frames("index\n1\n").unwrap_err().contains("timestamp"));
        let bad = run_frames("index,timestamp,keyframe\n1,x,0\n");
        assert!(bad.unwrap_err().contains("line 2"));
    }
}
