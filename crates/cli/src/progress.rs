//! What is seen while a run goes on: a bar on a terminal, now and then a line elsewhere. What is
//! warned of is kept.

use crate::output::complain;
use i2slam::{FrameEstimate, Warning};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time between two lines where there is no terminal.
const PAUSE: Duration = Duration::from_secs(10);

/// Time after which a phase tells how long it will take.
const TELLING: Duration = Duration::from_secs(2);

/// Time between two looks of a bar whose end is not known.
const TICK: Duration = Duration::from_millis(200);

/// How far a run is. Clones tell of the same run.
#[derive(Clone)]
pub(crate) struct Progress {
    display: Display,
    phase: Phase,
    warnings: Arc<Mutex<Vec<Warning>>>,
}

#[derive(Clone)]
enum Display {
    Bar(ProgressBar),
    Lines(Lines),
    Quiet,
}

/// One line now and then.
#[derive(Clone)]
struct Lines {
    last: Arc<Mutex<Instant>>,
    /// Phases that were named.
    named: Arc<Mutex<Vec<&'static str>>>,
}

/// What is done.
#[derive(Clone)]
struct Phase {
    name: &'static str,
    /// Its steps; 0 where they are not known.
    total: usize,
    started: Instant,
}

impl Phase {
    fn new(name: &'static str, total: usize) -> Self {
        Self { name, total, started: Instant::now() }
    }

    /// How long the rest takes, in words, as soon as some steps tell.
    fn rest(&self, done: usize) -> String {
        let seconds = self.pace(done) * self.total.saturating_sub(done) as f64;
        match done > 0 && self.started.elapsed() > TELLING {
            true => format!("  {seconds:.0} s left of these"),
            false => String::new(),
        }
    }

    /// Seconds that a step has taken.
    fn pace(&self, done: usize) -> f64 {
        self.started.elapsed().as_secs_f64() / done.max(1) as f64
    }
}

impl Progress {
    /// Over `total` frames.
    pub(crate) fn new(total: usize, quiet: bool) -> Self {
        let display = if quiet {
            Display::Quiet
        } else if std::io::stderr().is_terminal() {
            Display::Bar(bar(total))
        } else {
            let last = Arc::new(Mutex::new(Instant::now()));
            Display::Lines(Lines { last, named: Arc::default() })
        };
        Self { display, phase: Phase::new("frames", total), warnings: Arc::default() }
    }

    /// One more frame of the phase is done; `done` counts it.
    pub(crate) fn frame(&mut self, estimate: &FrameEstimate, done: usize, total: usize) {
        let seconds = self.phase.pace(done);
        let size = match estimate.gaussians {
            0 => String::new(),
            count => format!("{count} Gaussians  "),
        };
        let words = format!(
            "{seconds:.2} s/frame  loss {:.4}  {size}blur {:.1} px",
            estimate.losses.image, estimate.blur_length
        );
        match &self.display {
            Display::Bar(bar) => {
                bar.set_position(done as u64);
                bar.set_message(words);
            }
            Display::Lines(lines) if due(&lines.last) || done == total => {
                let (what, left) = (self.phase.name, seconds * (total - done) as f64);
                complain(&format!("{what} {done}/{total}  {words}  {left:.0} s left of these"));
            }
            Display::Lines(_) | Display::Quiet => {}
        }
    }

    /// Begin another kind of work of `total` steps, 0 where their number is not known.
    pub(crate) fn phase(&mut self, name: &'static str, total: usize) {
        self.phase = Phase::new(name, total);
        match &self.display {
            Display::Bar(bar) => show(bar, &self.phase),
            Display::Lines(lines) => {
                if let Ok(mut last) = lines.last.lock() {
                    *last = Instant::now();
                }
                lines.name(name);
            }
            Display::Quiet => {}
        }
    }

    /// One more step of a phase.
    pub(crate) fn step(&self, done: usize) {
        let Phase { name, total, .. } = self.phase;
        match &self.display {
            Display::Bar(bar) => bar.set_position(done as u64),
            Display::Lines(lines) if due(&lines.last) => {
                complain(&format!("{name} {done}/{total}{}", self.phase.rest(done)));
            }
            Display::Lines(_) | Display::Quiet => {}
        }
    }

    /// So much is done of a phase, which may have been left for another and come back, and whose
    /// number of steps, 0 where it is not known, may have changed.
    pub(crate) fn stage(&mut self, name: &'static str, done: usize, total: usize) {
        if name == self.phase.name {
            if total != self.phase.total {
                self.phase.total = total;
                if let Display::Bar(bar) = &self.display {
                    bar.set_length(total as u64);
                }
            }
        } else {
            self.phase = Phase::new(name, total);
            match &self.display {
                Display::Bar(bar) => show(bar, &self.phase),
                Display::Lines(lines) => lines.name_once(name),
                Display::Quiet => {}
            }
        }
        if total > 0 {
            self.step(done);
        }
    }

    /// Something to know, above the bar.
    pub(crate) fn note(&self, line: &str) {
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| complain(line)),
            Display::Lines(_) => complain(line),
            Display::Quiet => {}
        }
    }

    /// A warning, above the bar; it is kept.
    pub(crate) fn warn(&self, warning: impl Into<Warning>) {
        let warning = warning.into();
        let line = format!("warning: {warning}");
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| complain(&line)),
            _ => complain(&line),
        }
        if let Ok(mut warnings) = self.warnings.lock() {
            warnings.push(warning);
        }
    }

    /// All warnings so far.
    pub(crate) fn warnings(&self) -> Vec<Warning> {
        self.warnings.lock().map(|warnings| warnings.clone()).unwrap_or_default()
    }

    /// Remove the bar.
    pub(crate) fn clear(&self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

impl Lines {
    fn name(&self, name: &'static str) {
        complain(name);
        if let Ok(mut named) = self.named.lock() {
            named.push(name);
        }
    }

    fn name_once(&self, name: &'static str) {
        let is_new = self.named.lock().is_ok_and(|named| !named.contains(&name));
        if is_new {
            self.name(name);
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
    show(&bar, &Phase::new("frames", total));
    bar
}

/// The bar of a phase, or where its end is not known a sign that it goes on.
fn show(bar: &ProgressBar, phase: &Phase) {
    let template = match phase.total {
        0 => "{prefix} {spinner}  {elapsed}",
        _ => "{prefix} {bar:24.cyan/dim} {pos}/{len}  {msg}  {eta} left",
    };
    // Every change may be seen at once.
    bar.set_prefix(phase.name);
    bar.set_message("");
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_length(phase.total as u64);
    bar.set_position(0);
    bar.reset_eta();
    bar.reset_elapsed();
    match phase.total {
        0 => bar.enable_steady_tick(TICK),
        _ => bar.disable_steady_tick(),
    }
}
