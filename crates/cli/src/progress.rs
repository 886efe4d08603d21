//! Progress of a command on standard error: a bar on a terminal, otherwise a line now and then.

use crate::allocator::return_free_pages;
use crate::console::print_status;
use crate::interrupt;
use crate::live_viewer::LiveViewer;
use crate::messages;
use crate::pose_lines::PoseLines;
use i2slam::geometry::StampedPose;
use i2slam::run::{CameraEstimate, Observer, RuntimeForecast, Stage};
use i2slam::{CancellationToken, FrameEstimate, Reconstruction, Warning};
use i2slam_result::FrameFiles;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time between two lines where there is no terminal.
const PAUSE: Duration = Duration::from_secs(10);

/// Time after which the rest of a phase is extrapolated.
const MIN_MEASURED: Duration = Duration::from_secs(2);

/// Time between two pictures of the spinner.
const TICK: Duration = Duration::from_millis(200);

/// Progress display. Clones share one display.
#[derive(Clone)]
pub(crate) struct Progress {
    display: Display,
    phase: Arc<Mutex<Phase>>,
    poses: Option<Arc<PoseLines>>,
    live: Option<Arc<LiveViewer>>,
    /// Files by which warnings call frames.
    files: Arc<FrameFiles>,
    /// Whether flags can make the run smaller, which long ones are advised of.
    is_adjustable: bool,
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
    /// Time of the last line.
    last: Arc<Mutex<Instant>>,
    /// Names of phases printed so far.
    named: Arc<Mutex<Vec<&'static str>>>,
}

/// One kind of work.
#[derive(Clone, Copy)]
struct Phase {
    name: &'static str,
    /// Number of its steps; 0 if unknown.
    total: usize,
    /// Steps that were done before it, and are done.
    first: usize,
    done: usize,
    started: Instant,
    /// The first report of finished steps: the time before it is that of preparations, too.
    timed_from: Option<(usize, Instant)>,
}

impl Phase {
    fn new(name: &'static str, first: usize, total: usize) -> Self {
        Self { name, total, first, done: first, started: Instant::now(), timed_from: None }
    }

    /// True if it goes on with so many steps of work that is called `name`; mapping starts over when the
    /// camera or its readout is found anew.
    fn goes_on(&self, name: &str, done: usize) -> bool {
        let starts_over = done < self.first || (done == 0 && self.done > 0);
        name == self.name && !starts_over
    }

    /// True if frames are mapped in it.
    fn maps_frames(&self) -> bool {
        let stages = [Stage::Online, Stage::Frames, Stage::Keyframes, Stage::Mapping];
        stages.iter().any(|stage| stage.name() == self.name)
    }

    /// Expected time for the remaining steps in words, once it can be extrapolated.
    fn rest(&self, done: usize) -> String {
        let is_measured = self.started.elapsed() > MIN_MEASURED;
        match self.seconds_per_step(done).filter(|_| is_measured) {
            Some(seconds) => {
                let seconds = seconds * self.total.saturating_sub(done) as f64;
                format!("  {seconds:.0} s left of this step")
            }
            None => String::new(),
        }
    }

    /// Counts so many steps as finished.
    fn finish(&mut self, done: usize) {
        self.done = done;
        if done > self.first {
            self.timed_from.get_or_insert_with(|| (done, Instant::now()));
        }
    }

    /// Time of a step; none before two reports of finished ones.
    fn seconds_per_step(&self, done: usize) -> Option<f64> {
        let (from, since) = self.timed_from.filter(|(from, _)| done > *from)?;
        Some(since.elapsed().as_secs_f64() / (done - from) as f64)
    }
}

impl Progress {
    /// Progress over `total` frames.
    pub(crate) fn new(total: usize, quiet: bool) -> Self {
        let display = if quiet {
            Display::Quiet
        } else if std::io::stderr().is_terminal() {
            Display::Bar(bar(total))
        } else {
            let last = Arc::new(Mutex::new(Instant::now()));
            Display::Lines(Lines { last, named: Arc::default() })
        };
        let phase = Arc::new(Mutex::new(Phase::new("frames", 0, total)));
        let files = Arc::default();
        Self { display, phase, poses: None, live: None, files, is_adjustable: true }
    }

    /// With a line for every pose as soon as it is known.
    pub(crate) fn with_poses(self, poses: Option<Arc<PoseLines>>) -> Self {
        Self { poses, ..self }
    }

    /// With a page that follows the run.
    pub(crate) fn with_live_viewer(self, live: Option<Arc<LiveViewer>>) -> Self {
        Self { live, ..self }
    }

    /// With warnings that call frames by their files, too.
    pub(crate) fn with_files(self, files: FrameFiles) -> Self {
        Self { files: Arc::new(files), ..self }
    }

    /// Without advice on flags, for commands that have none.
    pub(crate) fn without_advice(self) -> Self {
        Self { is_adjustable: false, ..self }
    }

    /// Reports `done` of `total` steps of a phase. Phases may come in turns, and their totals
    /// change; a total of 0 is unknown.
    pub(crate) fn step(&self, name: &'static str, done: usize, total: usize) {
        return_free_pages();
        self.show_live(name, done, total);
        let Ok(mut phase) = self.phase.lock() else { return };
        if !phase.goes_on(name, done) {
            *phase = Phase::new(name, done, total);
            match &self.display {
                Display::Bar(bar) => show(bar, &phase),
                Display::Lines(lines) => lines.name_once(name),
                Display::Quiet => {}
            }
        } else if total != phase.total {
            phase.total = total;
            if let Display::Bar(bar) = &self.display {
                bar.set_length(total as u64);
            }
        }
        phase.finish(done);
        match &self.display {
            Display::Bar(bar) if total == 0 && done > 0 => bar.set_message(done.to_string()),
            Display::Lines(lines) if total == 0 && done > 0 && lines.is_due() => {
                print_status(&format!("{name} {done}"));
            }
            _ if total == 0 => {}
            Display::Bar(bar) => bar.set_position(done as u64),
            Display::Lines(lines) if lines.is_due() => {
                print_status(&format!("{name} {done}/{total}{}", phase.rest(done)));
            }
            Display::Lines(_) | Display::Quiet => {}
        }
    }

    fn show_live(&self, name: &str, done: usize, total: usize) {
        let Some(live) = &self.live else { return };
        live.set_status(match (done, total) {
            (0, 0) => name.to_owned(),
            (_, 0) => format!("{name} {done}"),
            _ => format!("{name} {done} of {total}"),
        });
    }

    /// Prints a line above the bar, unless quiet.
    pub(crate) fn note(&self, line: &str) {
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| print_status(line)),
            Display::Lines(_) => print_status(line),
            Display::Quiet => {}
        }
    }

    /// Prints a warning above the bar.
    pub(crate) fn warn(&self, warning: &str) {
        let line = format!("warning: {warning}");
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| print_status(&line)),
            _ => print_status(&line),
        }
    }

    /// Removes the bar.
    pub(crate) fn clear(&self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

impl Observer for Progress {
    fn progress(&self, stage: Stage, done: usize, total: usize) {
        self.step(stage.name(), done, total);
    }

    fn frame(&self, estimate: &FrameEstimate, done: usize, total: usize) {
        let Ok(mut phase) = self.phase.lock() else { return };
        // Frames are mapped beside the adjustment of the path, too.
        if !phase.maps_frames() {
            return;
        }
        // More frames may be tracked than are mapped.
        let done = done.max(phase.done);
        phase.finish(done);
        self.show_live(phase.name, done, total);
        let seconds = phase.seconds_per_step(done).map(|seconds| format!("{seconds:.2} s/frame  "));
        let size = match estimate.gaussians {
            0 => String::new(),
            count => format!("{count} Gaussians  "),
        };
        let losses = match estimate.losses.image {
            // Not measured: the frame is not refined, or not yet.
            0.0 => String::new(),
            loss => format!("loss {loss:.4}  blur {:.1} px", estimate.blur_length),
        };
        let figures = format!("{}{size}{losses}", seconds.unwrap_or_default());
        match &self.display {
            Display::Bar(bar) => {
                bar.set_position(done as u64);
                bar.set_message(figures);
            }
            Display::Lines(lines) if lines.is_due() || done == total => {
                let (name, left) = (phase.name, phase.rest(done));
                print_status(&format!("{name} {done}/{total}  {figures}{left}"));
            }
            Display::Lines(_) | Display::Quiet => {}
        }
    }

    fn map(&self, current: &dyn Fn() -> Reconstruction) {
        self.live.iter().for_each(|live| live.show(current));
    }

    fn follows_map(&self) -> bool {
        self.live.is_some()
    }

    fn pose(&self, pose: &StampedPose) {
        self.live.iter().for_each(|live| live.add_pose(pose));
        self.poses.iter().for_each(|lines| lines.add(pose));
    }

    fn note(&self, line: &str) {
        Self::note(self, line);
    }

    fn warning(&self, warning: &Warning) {
        self.warn(&warning.clone().with_frame_name(|index| self.files.name(index)).text);
    }

    fn camera(&self, camera: &CameraEstimate) {
        messages::camera_lines(camera).iter().for_each(|line| self.note(line));
    }

    fn forecast(&self, forecast: &RuntimeForecast) {
        let line = messages::forecast_line(forecast, self.is_adjustable);
        line.iter().for_each(|line| self.note(line));
    }

    fn cancellation(&self) -> CancellationToken {
        interrupt::cancellation()
    }
}

impl Lines {
    fn name_once(&self, name: &'static str) {
        let Ok(mut named) = self.named.lock() else { return };
        if !named.contains(&name) {
            print_status(name);
            named.push(name);
            if let Ok(mut last) = self.last.lock() {
                *last = Instant::now();
            }
        }
    }

    /// Whether the pause since the last line is over; then the next pause begins.
    fn is_due(&self) -> bool {
        let Ok(mut last) = self.last.lock() else { return false };
        let is_due = last.elapsed() >= PAUSE;
        if is_due {
            *last = Instant::now();
        }
        is_due
    }
}

fn bar(total: usize) -> ProgressBar {
    let bar = ProgressBar::new(total as u64);
    show(&bar, &Phase::new("frames", 0, total));
    bar
}

/// Shows the bar of a phase, or a spinner if its number of steps is unknown.
fn show(bar: &ProgressBar, phase: &Phase) {
    let template = match phase.total {
        0 => "{prefix} {spinner} {wide_msg}  {elapsed}",
        _ => "{prefix} {bar:24.cyan/dim} {pos}/{len}  {wide_msg}  {eta} left",
    };
    bar.set_position(0);
    bar.set_length(phase.total as u64);
    bar.set_prefix(phase.name);
    bar.set_message("");
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.reset_eta();
    bar.reset_elapsed();
    match phase.total {
        0 => bar.enable_steady_tick(TICK),
        _ => bar.disable_steady_tick(),
    }
    // Draws follow each other 50 ms apart at the least: what was shown above may be half of a phase.
    bar.force_draw();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_that_starts_over_is_timed_anew() {
        let mut phase = Phase::new("mapping frames", 26, 39);
        phase.done = 39;
        assert!(phase.goes_on("mapping frames", 39) && phase.goes_on("mapping frames", 30));
        assert!(!phase.goes_on("mapping frames", 25) && !phase.goes_on("mapping frames", 0));
        assert!(!phase.goes_on("rendering", 39));
        phase = Phase::new("mapping frames", 0, 40);
        assert!(phase.goes_on("mapping frames", 0));
        phase.done = 40;
        assert!(!phase.goes_on("mapping frames", 0));
    }

    #[test]
    fn steps_done_before_a_phase_take_none_of_its_time() {
        let started = Instant::now() - Duration::from_secs(10);
        let phase = Phase { started, ..Phase::new("mapping frames", 29, 40) };
        let phase = Phase { timed_from: Some((30, started)), ..phase };
        assert!((phase.seconds_per_step(35).expect("steps") - 2.0).abs() < 0.1);
        assert_eq!(phase.rest(35), "  10 s left of this step");
    }

    #[test]
    fn preparations_are_no_step() {
        let started = Instant::now() - Duration::from_secs(100);
        let mut phase = Phase { started, ..Phase::new("mapping frames", 0, 80) };
        phase.finish(0);
        assert_eq!((phase.timed_from, phase.rest(0)), (None, String::new()));
        phase.finish(1);
        assert_eq!(phase.rest(1), "");
        assert!(phase.seconds_per_step(2).expect("a step") < 1.0);
    }
}
