//! A call of the program `i2slam` as a child process, with its output in a log.

use crate::interrupt::interrupted;
use i2slam_storage::{StorageError, create};
use std::ffi::OsString;
use std::io;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Interval at which a child is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// A call of `i2slam`.
pub(crate) struct Call<'a> {
    pub(crate) program: &'a Path,
    pub(crate) arguments: Vec<OsString>,
    pub(crate) threads: usize,
    /// File for standard error.
    pub(crate) log: &'a Path,
    /// File for standard output [default: the log].
    pub(crate) output: Option<&'a Path>,
    pub(crate) timeout: Option<Duration>,
}

/// Why a call did not succeed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Stopped {
    /// It failed for this reason, in one line.
    Failed(String),
    /// The user ended the benchmark.
    Interrupted,
}

impl From<io::Error> for Stopped {
    fn from(error: io::Error) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<StorageError> for Stopped {
    fn from(error: StorageError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl Call<'_> {
    /// Runs the program to its end; `started` gets the process id.
    pub(crate) fn run(&self, started: impl FnOnce(u32)) -> Result<(), Stopped> {
        let log = create(self.log)?;
        let output = match self.output {
            Some(path) => create(path)?,
            None => log.try_clone()?,
        };
        let mut child = Command::new(self.program)
            .args(&self.arguments)
            .env("RAYON_NUM_THREADS", self.threads.to_string())
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(log)
            .spawn()?;
        started(child.id());
        let status = self.wait(&mut child)?;
        if interrupted() && !status.success() {
            return Err(Stopped::Interrupted);
        }
        if status.success() { Ok(()) } else { Err(Stopped::Failed(self.reason(status))) }
    }

    fn wait(&self, child: &mut Child) -> Result<ExitStatus, Stopped> {
        let begun = Instant::now();
        loop {
            if let Some(status) = child.try_wait()? {
                return Ok(status);
            }
            let late = self.timeout.filter(|limit| begun.elapsed() > *limit);
            if interrupted() || late.is_some() {
                child.kill().ok();
                child.wait()?;
                return Err(match late {
                    Some(limit) => {
                        Stopped::Failed(format!("ended after {} s (--timeout)", limit.as_secs()))
                    }
                    None => Stopped::Interrupted,
                });
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    /// The child's last error message, else its exit status and last line.
    fn reason(&self, status: ExitStatus) -> String {
        let log = std::fs::read(self.log).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let error = log.lines().rev().find_map(|line| line.strip_prefix("error: "));
        match (error, log.lines().rev().find(|line| !line.trim().is_empty())) {
            (Some(error), _) => error.to_owned(),
            (None, Some(last)) => format!("{}: {last}", describe(status)),
            (None, None) => describe(status),
        }
    }
}

#[cfg(unix)]
fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(9) => "killed by signal 9 (out of memory?)".to_owned(),
        Some(signal) => format!("ended by signal {signal}"),
        None => format!("ended with code {}", status.code().unwrap_or(1)),
    }
}

#[cfg(not(unix))]
fn describe(status: ExitStatus) -> String {
    format!("ended with {status}")
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn shell(name: &str, script: &str, timeout: Option<Duration>) -> Result<(), Stopped> {
        let log = std::env::temp_dir().join(format!("i2slam-call-{name}-{}", std::process::id()));
        let call = Call {
            program: Path::new("/bin/sh"),
            arguments: vec!["-c".into(), script.into()],
            threads: 1,
            log: &log,
            output: None,
            timeout,
        };
        let result = call.run(|_| ());
        std::fs::remove_file(&log).ok();
        result
    }

    fn failed(result: Result<(), Stopped>) -> String {
        match result {
            Err(Stopped::Failed(reason)) => reason,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_reason_of_a_failure_is_in_one_line() {
        assert_eq!(shell("good", "true", None), Ok(()));
        let own = failed(shell("own", "echo 'error: no room' >&2; echo later >&2; exit 1", None));
        assert_eq!(own, "no room");
        assert!(failed(shell("silent", "exit 3", None)).contains("code 3"));
        assert!(failed(shell("signal", "kill -SEGV $$", None)).contains("signal 11"));
    }

    #[test]
    fn a_call_that_takes_too_long_is_ended() {
        let begun = Instant::now();
        let reason = failed(shell("late", "sleep 20", Some(Duration::from_millis(50))));
        assert!(reason.contains("--timeout") && begun.elapsed() < Duration::from_secs(10));
    }
}
