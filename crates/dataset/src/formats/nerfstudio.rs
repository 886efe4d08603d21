//! nerfstudio and instant-ngp: `transforms.json`, with `depth_file_path` or for its pictures alone.

mod file;

use super::pairs::{last_number, stamped as stamps_in_names};
use super::poses::{rigid, stamped};
use super::{Layout, Listing, counted};
use crate::calibration::{Calibration, DepthGrid, Traits};
use crate::lists::read_text;
use crate::{DatasetError, Entry};
use file::{Intrinsics, Pinhole, SceneFile, Shot};
use i2slam_geometry::Pose;
use std::path::{Path, PathBuf};

/// Depth image value of one metre where the file does not say: millimetres.
const DEFAULT_DEPTH_SCALE: f64 = 1000.0;

/// Intrinsics of frames may differ by this share before a warning.
const SAME_INTRINSICS: f64 = 1e-3;

/// A `transforms.json` with its frames (those with depth, if depth is wanted), in order of number
/// or name.
pub(crate) struct Scene {
    path: PathBuf,
    file: SceneFile,
    shots: Vec<Shot>,
    without_depth: usize,
}

/// `transforms.json`, if it speaks of depth.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    let path = folder.join("transforms.json");
    let text = std::fs::read_to_string(&path).ok()?;
    text.contains("depth_file_path").then_some(path)
}

impl Scene {
    /// Reads the file; `with_depth`: frames without `depth_file_path` do not count.
    pub(crate) fn open(path: &Path, with_depth: bool) -> Result<Self, DatasetError> {
        let refuse = |reason: String| DatasetError::Metadata { path: path.into(), reason };
        let mut file: SceneFile = serde_json::from_str(&read_text(path)?)
            .map_err(|e| refuse(format!("{e}; expected a transforms.json of nerfstudio")))?;
        file.check().map_err(refuse)?;
        let all = std::mem::take(&mut file.frames);
        let count = all.len();
        let mut shots: Vec<Shot> =
            all.into_iter().filter(|shot| !with_depth || shot.depth_file_path.is_some()).collect();
        if shots.is_empty() {
            let expected = if with_depth { "frames with depth_file_path" } else { "frames" };
            return Err(DatasetError::Empty { path: path.to_path_buf(), expected });
        }
        shots.sort_by_cached_key(|shot| {
            (
                last_number(&shot.file_path.with_extension("").to_string_lossy()),
                shot.file_path.clone(),
            )
        });
        let without_depth = count - shots.len();
        Ok(Self { path: path.to_path_buf(), file, shots, without_depth })
    }

    /// Whether a frame has depth.
    pub(crate) fn has_depth(&self) -> bool {
        self.shots.iter().any(|shot| shot.depth_file_path.is_some())
    }

    pub(super) fn traits(&self) -> Traits {
        let scale = self.file.integer_depth_scale.map_or(DEFAULT_DEPTH_SCALE, f64::recip);
        Traits {
            depth_scale: scale,
            frame_rate: None,
            grid: DepthGrid::Spread,
            invalid_depth: None,
        }
    }

    /// The camera of the file, else that of the first frame. Pixel centres at one half.
    pub(crate) fn calibration(&self) -> Result<Calibration, DatasetError> {
        let refuse = |reason: String| DatasetError::Metadata { path: self.path.clone(), reason };
        let intrinsics = self.intrinsics(&self.shots[0]);
        let Pinhole { k, size } = intrinsics.pinhole().map_err(refuse)?;
        let distortion = self.file.distortion(&intrinsics).map_err(refuse)?;
        let source = self.path.display().to_string();
        let traits = self.traits();
        Ok(Calibration {
            intrinsics: k,
            size,
            ..Calibration::from_opencv(k, distortion, &source, traits)
        })
    }

    fn intrinsics(&self, shot: &Shot) -> Intrinsics {
        shot.intrinsics.clone().or(&self.file.intrinsics)
    }

    /// The frames, at the times in their names, else `place / frame_rate` [s].
    pub(super) fn list(&self, frame_rate: f64) -> Result<Listing, DatasetError> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let colour: Vec<PathBuf> =
            self.shots.iter().map(|shot| picture(folder, &shot.file_path)).collect();
        let times = stamps_in_names(&colour);
        let rising = times.filter(|t| t.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let entries = self.shots.iter().zip(colour).enumerate().map(|(index, (shot, colour))| {
            let timestamp = rising.as_ref().map_or(index as f64 / frame_rate, |t| t[index].0);
            let depth = shot.depth_file_path.as_ref().map(|depth| folder.join(depth));
            let (place, depth_timestamp) = (index, timestamp);
            Entry { index, place, timestamp, depth_timestamp, colour, depth, parts: None }
        });
        let entries: Vec<Entry> = entries.collect();
        let poses = entries.iter().zip(&self.shots).map(|(e, shot)| (e.timestamp, self.pose(shot)));
        let (poses, warning) = stamped(poses);
        let mut listing = Listing { poses, ..Listing::new(Layout::Nerfstudio, entries) };
        listing.left_out.without_depth = self.without_depth;
        if self.without_depth > 0 {
            let count = counted(self.without_depth, "frame");
            listing.warnings.push(format!("{count} left out: no depth_file_path"));
        }
        listing.warnings.extend(warning);
        listing.warnings.extend(self.intrinsics_warning());
        Ok(listing)
    }

    /// The pose, from OpenGL's camera axes (y up, z backwards) to OpenCV's. Positions are divided
    /// by `applied_scale`, so that they are metres as depth is.
    fn pose(&self, shot: &Shot) -> Option<Pose<f64>> {
        let rows = shot.transform_matrix.as_ref()?;
        let mut m = [0.0; 16];
        m[15] = 1.0;
        for (i, row) in rows.iter().take(3).enumerate() {
            let [x, y, z, t] = row[..] else { return None };
            let scale = self.file.applied_scale.unwrap_or(1.0);
            m[4 * i..4 * i + 4].copy_from_slice(&[x, -y, -z, t / scale]);
        }
        (rows.len() >= 3).then(|| rigid(&m)).flatten()
    }

    /// A warning if the frames were not taken with one camera.
    fn intrinsics_warning(&self) -> Option<String> {
        let focal = |shot: &Shot| self.intrinsics(shot).pinhole().ok().map(|camera| camera.k[0]);
        let first = focal(&self.shots[0])?;
        let apart = self.shots.iter().filter_map(focal).map(|f| (f / first - 1.0).abs());
        let most = apart.fold(0.0, f64::max);
        (most > SAME_INTRINSICS).then(|| {
            format!(
                "the focal length changes by up to {:.1} % between frames: that of the first is \
                 taken for all",
                100.0 * most
            )
        })
    }
}

/// The file of a picture; instant-ngp leaves out the ending of PNG files.
fn picture(folder: &Path, name: &Path) -> PathBuf {
    let path = folder.join(name);
    if path.extension().is_none() && !path.is_file() { path.with_extension("png") } else { path }
}
