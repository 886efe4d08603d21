//! Errors of commands and their exit codes.

pub(crate) use crate::console::Failure;
use crate::console::print_text;
use i2slam::dataset::DatasetError;
use i2slam::{ConfigError, RunError};
use i2slam_eval::EvalError;
use serde::Serialize;
use std::fmt::Display;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::sync::Mutex;

impl Failure {
    /// A refusal of the arguments.
    pub(crate) fn usage(message: &str) -> Self {
        Self::Usage(message.to_owned())
    }
}

/// Failure of a file or folder: `PATH: reason`.
pub(crate) fn failed(path: &Path, reason: impl Display) -> Failure {
    Failure::Failed(format!("{}: {reason}", path.display()))
}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Cancelled { .. } => Self::Interrupted,
            RunError::Config(error) => error.into(),
            RunError::Dataset(error) => error.into(),
            RunError::Preset { .. } => Self::Usage(error.to_string()),
            RunError::KnownCamera { source_of_camera } => Self::Usage(format!(
                "--distortion estimate is for pictures of an unknown camera; this one is given by \
                 {source_of_camera}"
            )),
            // The hook knows where it was, too.
            RunError::Panic { .. } => last_panic(),
            error => Self::Failed(error.to_string()),
        }
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        match error {
            ConfigError::Unreadable { .. } => Self::Failed(error.to_string()),
            _ => Self::Usage(error.to_string()),
        }
    }
}

impl From<DatasetError> for Failure {
    fn from(error: DatasetError) -> Self {
        match error {
            DatasetError::Option { name, ref reason } => match flag(name) {
                Some(flag) => Self::Usage(format!("{flag}: {reason}")),
                None => Self::Usage(error.to_string()),
            },
            DatasetError::NoCamera { .. } => Self::Failed(format!(
                "{error}; flags: --camera FILE.json, --intrinsics FX FY CX CY, --fov DEGREES"
            )),
            DatasetError::MissingFolder { .. }
            | DatasetError::OnePicture { .. }
            | DatasetError::FolderOfVideo { .. }
            | DatasetError::Empty { .. }
            | DatasetError::UnknownLayout { .. }
            | DatasetError::UnknownImport { .. } => Self::Usage(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

/// Flag that sets an option of a dataset; none for those of the settings.
fn flag(option: &str) -> Option<&'static str> {
    match option {
        "depth_scale" => Some("--depth-scale"),
        "field_of_view" => Some("--fov"),
        "frames" => Some("--frames"),
        "intrinsics" => Some("--intrinsics"),
        "scale" => Some("--scale"),
        "stride" => Some("--stride"),
        _ => None,
    }
}

impl From<EvalError> for Failure {
    fn from(error: EvalError) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Prints a value as JSON on standard output.
pub(crate) fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value);
    print_text(&text.map_err(|e| Failure::Failed(format!("cannot write JSON: {e}")))?);
    Ok(())
}

/// Text and place of the last panic.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Runs `work` and turns a panic, which is a bug, into a message.
pub(crate) fn catch_panics<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(|info| {
        if let Ok(mut last) = PANIC.lock() {
            *last = Some(info.to_string().replace('\n', " "));
        }
    }));
    let result = panic::catch_unwind(AssertUnwindSafe(work));
    panic::set_hook(usual);
    result.unwrap_or_else(|_| Err(last_panic()))
}

fn last_panic() -> Failure {
    let last = PANIC.lock().ok().and_then(|mut last| last.take()).unwrap_or_default();
    Failure::Failed(format!("this is a mistake of i2slam, please report it: {last}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_message_with_its_place() {
        let outer = catch_panics(|| {
            let inner = catch_panics(|| -> Result<(), Failure> { panic!("lost\nthe thread") });
            let message = inner.expect_err("a panic").message().map(str::to_owned);
            let message = message.expect("a message");
            assert!(message.contains("lost the thread") && message.contains("failure.rs"));
            Ok(1)
        });
        assert!(matches!(outer, Ok(1)));
    }

    #[test]
    fn an_option_is_named_as_it_is_typed() {
        let told = |name| {
            let reason = "expected more".to_owned();
            let failure = Failure::from(DatasetError::Option { name, reason });
            (failure.exit_code(), failure.message().map(str::to_owned))
        };
        assert_eq!(told("field_of_view"), (2, Some("--fov: expected more".into())));
        assert_eq!(told("max_depth"), (2, Some("option max_depth: expected more".into())));
    }
}
