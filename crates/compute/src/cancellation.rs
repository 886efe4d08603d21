//! Cooperative cancellation of long work.

use std::fmt;
use std::sync::Arc;

/// Cooperative cancellation token. Work asks [`is_cancelled`](Self::is_cancelled) between its
/// steps, on any thread, and returns with the results so far. The default token is never cancelled.
#[derive(Clone, Default)]
pub struct CancellationToken(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl CancellationToken {
    /// A token that is cancelled as soon as `cancelled` returns true, which it must from then on.
    pub fn when(cancelled: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(cancelled)))
    }

    /// Whether work should end now.
    pub fn is_cancelled(&self) -> bool {
        self.0.as_ref().is_some_and(|cancelled| cancelled())
    }
}

impl fmt::Debug for CancellationToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("CancellationToken").field(&self.is_cancelled()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn clones_share_the_state() {
        static CANCELLED: AtomicBool = AtomicBool::new(false);
        let token = CancellationToken::when(|| CANCELLED.load(Ordering::SeqCst));
        let clone = token.clone();
        assert!(!clone.is_cancelled() && !CancellationToken::default().is_cancelled());
        CANCELLED.store(true, Ordering::SeqCst);
        assert!(clone.is_cancelled() && token.is_cancelled());
        assert!(!CancellationToken::default().is_cancelled());
    }
}
