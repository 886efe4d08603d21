//! A whole reconstruction in one call: [`reconstruct`] takes a sequence through the system, with
//! depth, by colour alone, or with keyframes of another program.
//!
//! ```no_run
//! use i2slam::{RunOptions, reconstruct};
//!
//! let options = RunOptions::colour_alone();
//! let sequence = options.open_sequence("holiday.mp4".as_ref())?;
//! let outcome = reconstruct(&sequence, &options, ())?;
//! println!("{}", outcome.reconstruction.map);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod camera;
mod driver;
mod error;
mod forecast;
mod imported;
mod input;
mod memory;
mod observer;
mod odometry;
mod online;
mod preview;
mod shortfall;
mod stream;

pub use camera::CameraEstimate;
pub use error::RunError;
pub use forecast::RuntimeForecast;
pub use observer::{Observer, Stage};
pub use odometry::odometry_size;
pub use stream::TrackedStream;

use crate::config::{Config, TrackingMethod};
use crate::keyframes::{ImportDepth, ImportOptions};
use crate::reconstruction::Reconstruction;
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_dataset::import::camera_file;
use i2slam_dataset::{DatasetError, LiveSequence, OpenOptions, Sequence};
use input::Input;
use observer::RunContext;
use std::path::{Path, PathBuf};

/// Longer side of pictures processed by colour alone [px]: larger ones take much longer and gain
/// little.
const COLOUR_SIDE: usize = 640;

/// Frames, and pixels of the shorter side, from which on the front end finds a path with depth:
/// below, frames are tracked against the map.
const MIN_FRONT_END_FRAMES: usize = 8;
const MIN_FRONT_END_SIDE: usize = 48;

/// Source of the camera poses that a map begins with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// The map itself: every frame with depth is tracked against it (SplaTAM).
    Map,
    /// The front end, visual odometry on all pictures.
    FrontEnd {
        /// Whether depth pictures are used, where the sequence has them.
        with_depth: bool,
        /// Whether the radial distortion of an unknown camera is estimated and removed.
        estimate_distortion: bool,
    },
    /// Files of keyframes with poses found by another program (docs/import.md).
    Files {
        /// File or folder of the poses.
        keyframes: PathBuf,
        /// The dataset that holds the pictures.
        pictures: PathBuf,
        /// Depth that the keyframes get.
        depth: ImportDepth,
        /// Folder with the variances of depth pictures.
        variance: Option<PathBuf>,
    },
}

impl PoseSource {
    /// The source that settings ask for of colour and depth: the map where it is tracked by first
    /// order alone, as the paper's presets do, else the front end.
    pub fn with_depth(config: &Config) -> Self {
        match config.tracking.method {
            TrackingMethod::Adam => Self::Map,
            TrackingMethod::SecondOrder => {
                Self::FrontEnd { with_depth: true, estimate_distortion: false }
            }
        }
    }

    /// The front end on colour alone.
    pub fn colour_alone() -> Self {
        Self::FrontEnd { with_depth: false, estimate_distortion: false }
    }

    /// Whether depth pictures of the sequence are used.
    pub fn uses_depth(&self) -> bool {
        matches!(self, Self::Map | Self::FrontEnd { with_depth: true, .. })
    }
}

/// Settings of a reconstruction.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Settings of tracking, mapping and image formation; those of an `-rgb` preset unless the
    /// source of the poses [uses depth](PoseSource::uses_depth).
    pub config: Config,
    /// Source of the poses.
    pub poses: PoseSource,
    /// Options for opening the sequence, or the pictures of imported keyframes.
    pub open: OpenOptions,
    /// Folder for a file of pictures that are beyond [`Config::memory`]: that of the system for
    /// temporary files unless set.
    pub scratch_folder: PathBuf,
}

impl RunOptions {
    /// Options for a source of poses, the sequence opened as that source and `config` need it.
    pub fn new(config: Config, poses: PoseSource) -> Self {
        let mut open = OpenOptions {
            crop_border: config.input.crop_border,
            minimum_gap: config.input.minimum_gap,
            depth_pairing: config.depth_pairing(),
            colour_only: !poses.uses_depth(),
            ..OpenOptions::default()
        };
        if let PoseSource::FrontEnd { with_depth: false, .. } = poses {
            open.guess_camera = true;
            open.turn_pictures = true;
            open.max_side = Some(COLOUR_SIDE);
        }
        Self { config, poses, open, scratch_folder: std::env::temp_dir() }
    }

    /// Colour and depth with the settings `default`.
    pub fn with_depth() -> Self {
        let config = Config::default();
        let poses = PoseSource::with_depth(&config);
        Self::new(config, poses)
    }

    /// A video or a folder of pictures by colour alone, with the settings `default-rgb`: 3D
    /// Gaussians, the longer side of pictures reduced to 640 px, an unknown focal length estimated.
    pub fn colour_alone() -> Self {
        Self::new(Config::default_rgb(), PoseSource::colour_alone())
    }

    /// Keyframes of another program with the pictures of a dataset, with the settings `default-rgb`.
    pub fn imported_keyframes(keyframes: PathBuf, pictures: PathBuf) -> Self {
        let config = Config::default_rgb();
        let (depth, variance) = (ImportDepth::Imported, None);
        Self::new(config, PoseSource::Files { keyframes, pictures, depth, variance })
    }

    /// Gives the pictures of imported keyframes the camera that comes with these, where neither
    /// options nor dataset have one.
    #[must_use]
    pub fn with_camera_of_keyframes(mut self) -> Self {
        if let PoseSource::Files { keyframes, pictures, .. } = &self.poses
            && let Err(DatasetError::NoCamera { .. }) = self.open_sequence(pictures)
        {
            self.open.camera = camera_file(keyframes);
        }
        self
    }

    /// Opens a sequence with [`open`](Self::open).
    ///
    /// # Errors
    ///
    /// A path that is no sequence, and options that do not fit it.
    pub fn open_sequence(&self, path: &Path) -> Result<Sequence, DatasetError> {
        Sequence::open(path, &self.open_options())
    }

    /// Records a stream with [`open`](Self::open) until it ends or `end` is cancelled.
    ///
    /// # Errors
    ///
    /// As [`LiveSequence::open`].
    pub fn open_stream(
        &self,
        stream: &Path,
        end: CancellationToken,
    ) -> Result<LiveSequence, DatasetError> {
        LiveSequence::open(stream, &self.open_options(), end)
    }

    /// A stream that other options have opened, with [`open`](Self::open).
    ///
    /// # Errors
    ///
    /// As [`LiveSequence::with_options`].
    pub fn reopen_stream(&self, stream: LiveSequence) -> Result<LiveSequence, DatasetError> {
        stream.with_options(&self.open_options())
    }

    fn open_options(&self) -> OpenOptions {
        let input = &self.config.input;
        OpenOptions {
            crop_border: input.crop_border,
            minimum_gap: input.minimum_gap,
            depth_pairing: self.config.depth_pairing(),
            ..self.open.clone()
        }
    }

    /// Checks the options against each other, against a sequence, and against the memory of this
    /// machine.
    ///
    /// # Errors
    ///
    /// [`RunError::Config`], [`RunError::Preset`] and [`RunError::KnownCamera`].
    pub fn validate(&self, sequence: &Sequence) -> Result<(), RunError> {
        self.config.validate()?;
        let with_depth = self.poses.uses_depth();
        if self.config.is_rgb() == with_depth {
            return Err(RunError::Preset { preset: self.config.preset.clone(), with_depth });
        }
        match self.poses {
            PoseSource::FrontEnd { estimate_distortion: true, .. } if !sequence.camera_is_guess => {
                Err(RunError::KnownCamera { source_of_camera: sequence.camera_source.clone() })
            }
            _ => Ok(memory::check(self, sequence)?),
        }
    }
}

/// Result of a run, complete or ended early.
#[derive(Debug)]
pub struct RunOutcome {
    /// Poses, tone, map and responses.
    pub reconstruction: Reconstruction,
    /// Frames of the sequence, those without a pose included.
    pub frames_given: usize,
    /// True if the frames are photographs in any order, whose time stamps tell nothing.
    pub is_unordered: bool,
    /// Frames or keyframes that could not be used.
    pub frames_skipped: usize,
    /// Wall time from the first frame to the finished map [s].
    pub seconds: f64,
    /// Whether every frame was processed and the map was refined to the end.
    pub complete: bool,
    /// The error that ended the run early; `None` if it was cancelled.
    pub problem: Option<RunError>,
    /// Why the result is not what was asked for, a sentence each; empty if it is: less than half of the frames
    /// or photographs was tracked, the map is empty, no frame was held out, no readout was found.
    pub shortfalls: Vec<String>,
    /// Camera as estimated from the pictures; `None` where poses are not found from them.
    pub camera: Option<CameraEstimate>,
    /// Source of the focal length, in words.
    pub camera_source: String,
    /// The sequence as it was used, if an estimated lens distortion was removed from it.
    pub undistorted: Option<Sequence>,
    /// All warnings, in order, with the time stamps of their frames unless these are photographs.
    pub warnings: Vec<Warning>,
}

impl RunOutcome {
    /// Calls single frames by `name` in place of their numbers, in warnings and shortfalls.
    #[must_use]
    pub fn with_frame_names(mut self, name: impl Fn(usize) -> String) -> Self {
        for warning in &mut self.warnings {
            let named = warning.clone().with_frame_name(&name);
            for shortfall in &mut self.shortfalls {
                if let Some(before) = shortfall.strip_suffix(&warning.text) {
                    *shortfall = format!("{before}{named}");
                }
            }
            *warning = named;
        }
        self
    }
}

/// Whether a sequence with depth is too small for the front end, and tracked against the map.
fn is_small(sequence: &Sequence) -> bool {
    sequence.len() < MIN_FRONT_END_FRAMES || has_small_pictures(sequence)
}

/// Whether pictures with depth are too small for the front end.
fn has_small_pictures(sequence: &Sequence) -> bool {
    let (width, height) = odometry_size(sequence);
    width.min(height) < MIN_FRONT_END_SIDE
}

/// Reconstructs a sequence: camera path, exposure and map. `observer` is `()`, or sees progress
/// and may cancel; a run cancelled after its first frame still returns what it has.
///
/// # Errors
///
/// Options that do not fit the sequence, keyframes that cannot be imported, pictures in which no
/// camera path is found, and cancellation before the first frame.
pub fn reconstruct(
    sequence: &Sequence,
    options: &RunOptions,
    observer: impl Observer + 'static,
) -> Result<RunOutcome, RunError> {
    reconstruct_tracked(sequence, None, options, observer)
}

/// [`reconstruct`] of a stream that has ended, whose frames were tracked while they came.
///
/// # Errors
///
/// As [`reconstruct`].
pub fn reconstruct_stream(
    sequence: &Sequence,
    tracked: TrackedStream,
    options: &RunOptions,
    observer: impl Observer + 'static,
) -> Result<RunOutcome, RunError> {
    reconstruct_tracked(sequence, Some(tracked), options, observer)
}

fn reconstruct_tracked(
    sequence: &Sequence,
    tracked: Option<TrackedStream>,
    options: &RunOptions,
    observer: impl Observer + 'static,
) -> Result<RunOutcome, RunError> {
    options.validate(sequence)?;
    let context = RunContext::new(observer);
    let was_tracked = tracked.as_ref().is_some_and(|tracked| tracked.frames.is_some());
    let tracked = tracked.and_then(|tracked| tracked.of_sequence(sequence));
    if was_tracked && tracked.is_none() {
        context.observer.note(
            "frames or time stamps of the stream were missing when it came: it is tracked again",
        );
    }
    let open = || match &options.poses {
        PoseSource::Map => Ok(Input::frames(sequence)),
        PoseSource::FrontEnd { with_depth: true, .. } if is_small(sequence) => {
            Ok(Input::frames(sequence))
        }
        PoseSource::FrontEnd { with_depth, estimate_distortion } => {
            let found =
                odometry::open(sequence, (*estimate_distortion, tracked), options, &context);
            match found {
                Err(RunError::NoPath(failure)) if *with_depth => {
                    context.warn(format!("{failure}: frames are tracked against the map instead"));
                    Ok(Input::frames(sequence))
                }
                found => found,
            }
        }
        PoseSource::Files { keyframes, pictures, depth, variance } => {
            let import = ImportOptions {
                open: options.open.clone(),
                depth: *depth,
                variance: variance.clone(),
                ..ImportOptions::default()
            };
            imported::open((keyframes, pictures), &import, options, &context)
        }
    };
    let mut outcome = driver::run(sequence, options, &context, open)?;
    let stamp = |index: usize| {
        if outcome.is_unordered {
            return None;
        }
        let place = sequence.entries.binary_search_by_key(&index, |entry| entry.index).ok()?;
        Some(sequence.entries[place].timestamp)
    };
    outcome.warnings =
        context.into_warnings().into_iter().map(|warning| warning.with_time(stamp)).collect();
    let of_session = std::mem::take(&mut outcome.shortfalls);
    outcome.shortfalls = shortfall::of_result(&outcome, options);
    outcome.shortfalls.extend(of_session);
    Ok(outcome)
}
