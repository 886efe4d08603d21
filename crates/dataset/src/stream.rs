//! Frames read ahead on another thread.

use crate::prepare::Preparation;
use crate::{DatasetError, Entry, Frame};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

/// Frames that wait to be taken; together with the one being read they bound the memory.
const READ_AHEAD: usize = 4;

/// All frames of a sequence in order. Dropping it stops the thread that reads ahead.
#[derive(Debug)]
pub struct FrameStream {
    source: Source,
}

#[derive(Debug)]
enum Source {
    /// A thread reads; `None` only while the stream is being dropped.
    Ahead { frames: Option<Receiver<Result<Frame, DatasetError>>>, thread: Option<JoinHandle<()>> },
    /// The system gave no thread: frames are read when they are asked for.
    OnDemand { entries: VecDeque<Entry>, preparation: Arc<Preparation> },
}

impl FrameStream {
    pub(crate) fn start(entries: Vec<Entry>, preparation: Arc<Preparation>) -> Self {
        let (sender, receiver) = sync_channel(READ_AHEAD);
        let (ahead, prepare) = (entries.clone(), Arc::clone(&preparation));
        let read = move || {
            for entry in &ahead {
                if sender.send(prepare.load(entry)).is_err() {
                    break;
                }
            }
        };
        let source = match std::thread::Builder::new().name("read frames".into()).spawn(read) {
            Ok(thread) => Source::Ahead { frames: Some(receiver), thread: Some(thread) },
            Err(_) => Source::OnDemand { entries: entries.into(), preparation },
        };
        Self { source }
    }
}

impl Iterator for FrameStream {
    type Item = Result<Frame, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.source {
            Source::Ahead { frames, thread } => match frames.as_ref()?.recv() {
                Ok(frame) => Some(frame),
                Err(_) => {
                    pass_on_panic(thread.take());
                    None
                }
            },
            Source::OnDemand { entries, preparation } => {
                entries.pop_front().map(|entry| preparation.load(&entry))
            }
        }
    }
}

/// A reader that panicked must not look like the end of the sequence.
fn pass_on_panic(thread: Option<JoinHandle<()>>) {
    if let Some(Err(panic)) = thread.map(JoinHandle::join) {
        std::panic::resume_unwind(panic);
    }
}

impl Drop for FrameStream {
    fn drop(&mut self) {
        if let Source::Ahead { frames, thread } = &mut self.source {
            // Without a receiver the thread ends at its next frame.
            drop(frames.take());
            if let Some(thread) = thread.take() {
                // Nobody waits for its frames any more, so how it ended does not matter.
                let _ = thread.join();
            }
        }
    }
}
