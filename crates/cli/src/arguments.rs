//! Arguments that several commands share.

use crate::console::counted;
use crate::failure::Failure;
use crate::live_viewer::LiveViewer;
use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use i2slam::config::{MAX_MEMORY, MIN_MEMORY};
use i2slam::dataset::OpenOptions;
use std::ops::{Range, RangeInclusive};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

/// Selection, size and camera of the frames.
#[derive(Args, Clone, Debug)]
pub(crate) struct Input {
    /// Only frames A to B-1, numbered from 0 in order of time as in `i2slam info` and frames.csv
    #[arg(long, value_name = "A..B", value_parser = frame_range)]
    pub(crate) frames: Option<Range<usize>>,
    /// Every N-th frame
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        allow_negative_numbers = true,
        value_parser = number::<usize>("a count of frames as in 2")
    )]
    pub(crate) stride: usize,
    /// Size of the processed pictures over that of the recorded ones [default: 1, but see
    /// --max-side]
    #[arg(
        long,
        value_name = "S",
        allow_negative_numbers = true,
        value_parser = number::<f64>("a factor as in 0.5")
    )]
    pub(crate) scale: Option<f64>,
    /// Longer side of the processed pictures at most [px]; those that come out, as renders and exports,
    /// are of the same size [default: 640 for videos and colour alone, unless --scale is given]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = picture_side)]
    pub(crate) max_side: Option<u32>,
    /// Camera file to use instead of the folder's camera.json
    #[arg(long, value_name = "FILE.json", value_parser = existing_path())]
    pub(crate) camera: Option<PathBuf>,
    /// Camera: a file (camera.json, transforms.json, COLMAP's cameras.txt, a line `fx fy cx cy`),
    /// or four numbers FX FY CX CY without distortion [px], pixel centres at integers
    #[arg(
        long,
        value_name = "FILE or NUMBERS",
        num_args = 1..=4,
        allow_negative_numbers = true,
        conflicts_with_all = ["camera", "fov"]
    )]
    pub(crate) intrinsics: Option<Vec<String>>,
    /// Camera: horizontal field of view, without distortion. For colour alone it is estimated
    /// from the pictures if no camera is given
    #[arg(
        long,
        value_name = "DEGREES",
        allow_negative_numbers = true,
        conflicts_with = "camera",
        value_parser = number::<f64>("degrees as in 60")
    )]
    pub(crate) fov: Option<f64>,
    /// Value of one metre in the depth images
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = depth_scale)]
    pub(crate) depth_scale: Option<f64>,
}

/// A page that follows the run.
#[derive(Args, Clone, Debug)]
pub(crate) struct Live {
    /// Show the map and path of now in a browser while the run lasts, on a port of this machine that
    /// other machines do not reach [default: a free one, which is printed]
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    pub(crate) live: Option<u16>,
}

/// A recording of the run for another program.
#[derive(Args, Clone, Debug)]
pub(crate) struct Rerun {
    /// Write a recording of the finished run for the viewer Rerun: path, pictures as filmed, exposure,
    /// blur, map (docs/export.md says how to build the program with it)
    #[arg(long, value_name = "FILE.rrd")]
    pub(crate) rerun: Option<PathBuf>,
}

#[derive(Args, Clone, Debug)]
pub(crate) struct Machine {
    /// Threads to use [default: all cores]; results do not depend on it
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = thread_count)]
    pub(crate) threads: Option<u16>,
    /// Print warnings and the summary only
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// Parser of a number; another text is answered with what was expected.
pub(crate) fn number<T: FromStr>(
    expected: &'static str,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| text.trim().parse().map_err(|_| format!("expected {expected}"))
}

/// Longer side of pictures [px] that is accepted.
const PICTURE_SIDES: RangeInclusive<u32> = 16..=65_535;

fn picture_side(text: &str) -> Result<u32, String> {
    let side = text.trim().parse().ok().filter(|side| PICTURE_SIDES.contains(side));
    let (least, most) = (PICTURE_SIDES.start(), PICTURE_SIDES.end());
    side.ok_or_else(|| format!("expected a whole number of pixels, {least} to {most}"))
}

/// Threads that are accepted.
const THREADS: RangeInclusive<u16> = 1..=1024;

fn thread_count(text: &str) -> Result<u16, String> {
    let (least, most) = (THREADS.start(), THREADS.end());
    let expected = format!("expected a whole number of threads, {least} to {most}, as in 4");
    text.trim().parse().ok().filter(|count| THREADS.contains(count)).ok_or(expected)
}

/// Largest depth value of one metre that is accepted: the largest reading of 16 bits is 0.1 m, less than
/// most depth cameras measure at all.
const MAX_DEPTH_SCALE: f64 = 655_350.0;

fn depth_scale(text: &str) -> Result<f64, String> {
    let scale = text.trim().parse().ok();
    scale.filter(|scale| *scale > 0.0 && *scale <= MAX_DEPTH_SCALE).ok_or_else(|| {
        format!(
            "expected the depth value of one metre, a number above 0 and at most {MAX_DEPTH_SCALE} (with \
             which 16 bits end at 0.1 m), as in 1000 or 5000"
        )
    })
}

/// Parses the memory of a run [GB].
pub(crate) fn memory(text: &str) -> Result<f64, String> {
    let memory = text.trim().parse().ok();
    memory.filter(|memory| (MIN_MEMORY..=MAX_MEMORY).contains(memory)).ok_or_else(|| {
        format!(
            "expected a number of gigabytes without unit, {MIN_MEMORY} to {MAX_MEMORY}, as in 2 or 0.5"
        )
    })
}

pub(crate) fn frame_range(text: &str) -> Result<Range<usize>, String> {
    let number = |part: &str| part.trim().parse::<usize>().ok();
    let ends = text.split_once("..").and_then(|(a, b)| Some(number(a)?..number(b)?));
    match ends {
        Some(range) if !range.is_empty() => Ok(range),
        Some(_) => Err("holds no frame: the second number must be larger".to_owned()),
        None => Err("expected two frame numbers as in 10..20".to_owned()),
    }
}

impl Input {
    /// Options for opening a sequence: those of `usual` that flags do not replace. `--scale`
    /// replaces the usual size, too.
    pub(crate) fn open_options(&self, usual: OpenOptions) -> Result<OpenOptions, Failure> {
        let given = self.intrinsics.as_deref().map(parse_intrinsics).transpose()?;
        let (file, intrinsics) = given.unwrap_or_default();
        let usual_side = usual.max_side.filter(|_| self.scale.is_none());
        Ok(OpenOptions {
            camera: file.or_else(|| self.camera.clone()),
            intrinsics,
            field_of_view: self.fov,
            depth_scale: self.depth_scale,
            frames: self.frames.clone(),
            stride: self.stride,
            scale: self.scale.unwrap_or(1.0),
            max_side: self.max_side.map(|side| side as usize).or(usual_side),
            ..usual
        })
    }
}

impl Live {
    /// The server of the page, where one is asked for.
    pub(crate) fn start(&self) -> Result<Option<Arc<LiveViewer>>, Failure> {
        Ok(self.live.map(LiveViewer::start).transpose()?.map(Arc::new))
    }
}

impl Machine {
    /// Sets the number of threads of the process.
    pub(crate) fn use_threads(&self) -> Result<(), Failure> {
        let Some(threads) = self.threads else { return Ok(()) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads));
        let failed = |e| {
            let count = counted(usize::from(threads), "thread");
            Failure::Failed(format!("cannot start {count}: {e}"))
        };
        pool.build_global().map_err(failed)
    }
}

/// Parses the path of an input, which is there.
pub(crate) fn existing_path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.exists() {
        true => Ok(path),
        false => Err("no such file or folder"),
    })
}

/// Parses `--intrinsics`: a file, or four numbers.
fn parse_intrinsics(words: &[String]) -> Result<(Option<PathBuf>, Option<[f64; 4]>), Failure> {
    let refuse = |why: &str| {
        let words = words.join(" ");
        Failure::Usage(format!(
            "--intrinsics {words}: {why}; it takes a file, or the four numbers FX FY CX CY"
        ))
    };
    let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
    match (words, numbers) {
        (_, Some(numbers)) => match <[f64; 4]>::try_from(numbers) {
            Ok(four) => Ok((None, Some(four))),
            Err(_) => Err(refuse("not four numbers")),
        },
        ([file], None) if Path::new(file).exists() => Ok((Some(file.into()), None)),
        ([_], None) => Err(refuse("no such file")),
        _ => Err(refuse("not a file and not four numbers")),
    }
}

/// Exactly N finite numbers, between spaces or commas.
pub(crate) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let words = text.split([' ', ',']).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    let numbers: [f64; N] = numbers?.try_into().ok()?;
    numbers.iter().all(|v| v.is_finite()).then_some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_half_open() {
        assert_eq!(frame_range("3..7"), Ok(3..7));
        for wrong in ["7..3", "3..3", "3", "3..", "a..b", "-1..4"] {
            assert!(frame_range(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn wrong_numbers_are_answered_with_what_is_expected() {
        assert_eq!((thread_count("4"), memory("0.5")), (Ok(4), Ok(0.5)));
        assert_eq!((depth_scale(" 5000"), depth_scale("655350")), (Ok(5000.0), Ok(655_350.0)));
        for wrong in ["0", "-1", "nan", "inf", "four", "2GB", "1e400", "1e6x", ""] {
            let answers = [
                (thread_count(wrong).err(), "1 to 1024, as in 4"),
                (memory(wrong).err(), "0.001 to 100000, as in 2 or 0.5"),
                (depth_scale(wrong).err(), "as in 1000 or 5000"),
            ];
            for (answer, words) in answers {
                let answer = answer.unwrap_or_default();
                assert!(answer.starts_with("expected") && answer.ends_with(words), "{wrong}");
            }
        }
        assert!(thread_count("1025").is_err() && thread_count("1.5").is_err());
        assert!(memory("1e6").is_err() && depth_scale("700000").is_err());
    }

    #[test]
    fn intrinsics_are_a_file_or_four_numbers() {
        let of = |text: &str| {
            let words: Vec<String> = text.split(' ').map(str::to_owned).collect();
            parse_intrinsics(&words)
        };
        assert!(matches!(of("500 501 -3.5 240"), Ok((None, Some([500.0, 501.0, -3.5, 240.0])))));
        assert!(matches!(of("Cargo.toml"), Ok((Some(file), None)) if file.ends_with("Cargo.toml")));
        for wrong in ["500", "500 501 320", "cam.json", "cam.json video.mp4", "1 2 3 x"] {
            assert!(matches!(of(wrong), Err(Failure::Usage(_))), "{wrong}");
        }
    }
}
