//! What is seen while a run goes on: a bar on a terminal, now and then a line elsewhere.

use crate::output::complain;
use i2slam::FrameEstimate;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time between two lines where there is no terminal.
const PAUSE: Duration = Duration::from_secs(10);

/// How far a run is. Clones tell of the same run.
#[derive(Clone)]
pub(crate) struct Progress {
    display: Display,
    started: Instant,
}

#[derive(Clone)]
enum Display {
    Bar(ProgressBar),
    Lines { last: Arc<Mutex<Instant>>, phase: &'static str, total: usize },
    Quiet,
}

impl Progress {
    /// Over `total` frames.
    pub(crate) fn new(total: usize, quiet: bool) -> Self {
        let started = Instant::now();
        let display = if quiet {
            Display::Quiet
        } else if std::io::stderr().is_terminal() {
            Display::Bar(bar(total))
        } else {
            Display::Lines { last: Arc::new(Mutex::new(started)), phase: "", total }
        };
        Self { display, started }
    }

    /// One more frame of the phase is done; `done` counts it.
    pub(crate) fn frame(&mut self, estimate: &FrameEstimate, done: usize, total: usize) {
        let seconds = self.started.elapsed().as_secs_f64() / done.max(1) as f64;
        let size = match estimate.gaussians {
            0 => String::new(),
            count => format!("{count} Gaussians  "),
        };
        let words = format!(
            "{seconds:.2} s/frame  loss {:.4}  {size}blur {:.1} px",
            estimate.losses.image, estimate.blur_length
        );
        match &mut self.display {
            Display::Bar(bar) => {
                bar.set_position(done as u64);
                bar.set_message(words);
            }
            Display::Lines { last, phase, .. } if due(last) || done == total => {
                let what = if phase.is_empty() { "frames" } else { phase };
                let left = seconds * (total - done) as f64;
                complain(&format!("{what} {done}/{total}  {words}  {left:.0} s left of these"));
            }
            Display::Lines { .. } | Display::Quiet => {}
        }
    }

    /// Begin another kind of work of `total` steps.
    pub(crate) fn phase(&mut self, name: &'static str, total: usize) {
        self.started = Instant::now();
        match &mut self.display {
            Display::Bar(bar) => {
                bar.set_length(total as u64);
                bar.set_position(0);
                bar.reset_eta();
                bar.set_prefix(name);
                bar.set_message("");
            }
            Display::Lines { last, phase, total: of } => {
                (*last, *phase, *of) = (Arc::new(Mutex::new(Instant::now())), name, total);
                complain(name);
            }
            Display::Quiet => {}
        }
    }

    /// One more step of a phase.
    pub(crate) fn step(&self, done: usize) {
        match &self.display {
            Display::Bar(bar) => bar.set_position(done as u64),
            Display::Lines { last, phase, total } if due(last) => {
                complain(&format!("{phase} {done}/{total}"));
            }
            Display::Lines { .. } | Display::Quiet => {}
        }
    }

    /// Something to know, above the bar.
    pub(crate) fn note(&self, line: &str) {
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| complain(line)),
            Display::Lines { .. } => complain(line),
            Display::Quiet => {}
        }
    }

    /// A warning, above the bar.
    pub(crate) fn warn(&self, message: &str) {
        let line = format!("warning: {message}");
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| complain(&line)),
            _ => complain(&line),
        }
    }

    /// Remove the bar.
    pub(crate) fn clear(&self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

/// Whether it is time for another line; the time of this one is kept.
fn due(last: &Mutex<Instant>) -> bool {
    let Ok(mut last) = last.lock() else { return false };
    let due = last.elapsed() >= PAUSE;
    if due {
        *last = Instant::now();
    }
    due
}

fn bar(total: usize) -> ProgressBar {
    let bar = ProgressBar::new(total as u64);
    let template = "{prefix} {bar:24.cyan/dim} {pos}/{len}  {msg}  {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_prefix("frames");
    bar
}
