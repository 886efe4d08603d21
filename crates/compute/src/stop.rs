//! The wish that long work end early.

use std::fmt;
use std::sync::Arc;

/// Whether somebody wishes long work to end early. Work asks between its steps, on any thread; a
/// wish is never taken back. The default is that nobody ever does.
#[derive(Clone, Default)]
pub struct Stop(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl Stop {
    /// Wished as soon as `wished` says so.
    pub fn when(wished: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(wished)))
    }

    /// Whether it is wished by now.
    pub fn is_wished(&self) -> bool {
        self.0.as_ref().is_some_and(|wished| wished())
    }
}

impl fmt::Debug for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Stop").field(&self.is_wished()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn copies_share_the_wish() {
        static WISHED: AtomicBool = AtomicBool::new(false);
        let stop = Stop::when(|| WISHED.load(Ordering::SeqCst));
        let copy = stop.clone();
        assert!(!copy.is_wished() && !Stop::default().is_wished());
        WISHED.store(true, Ordering::SeqCst);
        assert!(copy.is_wished() && stop.is_wished() && !Stop::default().is_wished());
    }
}
