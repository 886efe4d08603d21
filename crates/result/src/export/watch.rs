//! Progress and cancellation of an export.

use super::error::ExportError;
use i2slam::CancellationToken;

/// Who watches an export: told of its steps, and able to end it.
pub struct Watch<'a> {
    /// Called with a few words, the steps that are done and their number.
    pub progress: &'a dyn Fn(&'static str, usize, usize),
    /// Ends the export.
    pub cancellation: CancellationToken,
}

impl Watch<'_> {
    /// Reports that `done` of `total` steps are done.
    ///
    /// # Errors
    /// [`ExportError::Cancelled`].
    pub(crate) fn step(
        &self,
        name: &'static str,
        done: usize,
        total: usize,
    ) -> Result<(), ExportError> {
        (self.progress)(name, done, total);
        if self.cancellation.is_cancelled() { Err(ExportError::Cancelled) } else { Ok(()) }
    }
}
