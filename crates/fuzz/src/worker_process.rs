//! A worker seen from outside: started when needed, asked for one case at a time, ended when it
//! does not answer.

use crate::arguments::Arguments;
use crate::failure::{Failure, Outcome};
use crate::memory::LIMIT;
use crate::protocol::{Answer, Request};
use i2slam_check::TemporaryFolder;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Bytes of the end of a worker's standard error that are kept.
const KEPT_ERROR: usize = 2000;
/// Time to write and remove a case's files [s].
const TIME_FOR_FILES: f64 = 5.0;

/// A worker, running or not yet.
pub(crate) struct WorkerProcess {
    arguments: Arguments,
    seed: u64,
    scratch: TemporaryFolder,
    running: Option<Running>,
}

struct Running {
    child: Child,
    requests: ChildStdin,
    lines: Receiver<String>,
    errors: Option<JoinHandle<String>>,
}

impl WorkerProcess {
    /// A worker with a name that is unique in this process.
    pub(crate) fn new(arguments: &Arguments, seed: u64, name: &str) -> Self {
        let scratch = TemporaryFolder::new(&format!("fuzz-{name}"));
        Self { arguments: arguments.clone(), seed, scratch, running: None }
    }

    /// Runs a case. An error means that no worker could be started.
    pub(crate) fn ask(&mut self, request: Request<'_>) -> Result<Answer, String> {
        let mut running = match self.running.take() {
            Some(running) => running,
            None => self.start()?,
        };
        let limit = self.arguments.time_limit;
        let failed =
            |failure| Answer { outcome: Outcome::Failed(failure), seconds: 0.0, memory: 0 };
        if running.requests.write_all(request.line().as_bytes()).is_err() {
            return Ok(failed(Failure::Death(running.end())));
        }
        let mut printed = None;
        let patience = Duration::from_secs_f64(limit + TIME_FOR_FILES);
        let mut answer = loop {
            match running.lines.recv_timeout(patience) {
                Ok(line) => match Answer::parse(&line) {
                    Some(answer) => break answer,
                    None => printed = printed.or(Some(line)),
                },
                Err(RecvTimeoutError::Timeout) => {
                    running.end();
                    return Ok(Answer { seconds: limit, ..failed(Failure::Hang(limit)) });
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Ok(failed(Failure::Death(running.end())));
                }
            }
        };
        self.running = Some(running);
        let is_failed = matches!(answer.outcome, Outcome::Failed(_));
        let found = match printed {
            _ if is_failed => None,
            Some(line) => Some(Failure::Printed(line)),
            None if answer.seconds > limit => Some(Failure::Hang(limit)),
            None => (answer.memory > LIMIT).then_some(Failure::Memory(answer.memory)),
        };
        if let Some(failure) = found {
            answer.outcome = Outcome::Failed(failure);
        }
        Ok(answer)
    }

    fn start(&self) -> Result<Running, String> {
        let program = std::env::current_exe().map_err(|e| e.to_string())?;
        let mut command = Command::new(&program);
        command.arg("worker").arg(&self.scratch.0).arg("--corpus").arg(&self.arguments.corpus);
        command.args(["--seed", &self.seed.to_string()]);
        command.env("I2SLAM_FFMPEG", &program);
        // Threads reserve address space, which is bounded.
        command.envs([("RAYON_NUM_THREADS", "2"), ("MALLOC_ARENA_MAX", "1")]);
        if self.arguments.case.is_none() {
            // The message matters, and it stands before a trace that is longer than what is kept.
            command.env("RUST_BACKTRACE", "0");
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|e| format!("cannot start a worker: {e}"))?;
        let (Some(requests), Some(out), Some(error)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err("a worker without pipes".into());
        };
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            let lines = BufReader::new(out).lines().map_while(Result::ok);
            // The receiver is gone once the worker is ended.
            lines.take_while(|line| sender.send(line.clone()).is_ok()).for_each(drop);
        });
        let errors = Some(std::thread::spawn(move || end_of(error)));
        Ok(Running { child, requests, lines, errors })
    }
}

impl Running {
    /// Ends the worker if it has not ended; its status and the end of its standard error.
    fn end(mut self) -> String {
        // Gives a worker that is about to die the time to do so by itself.
        std::thread::sleep(Duration::from_millis(20));
        let status = match self.child.try_wait() {
            Ok(Some(status)) => Ok(status),
            _ => self.child.kill().and_then(|()| self.child.wait()),
        };
        let status = status.map_or_else(|e| e.to_string(), |status| status.to_string());
        let said = self.errors.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        format!("{status} {}", said.trim())
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        // A worker ends when its input does.
        if let Some(Running { mut child, requests, .. }) = self.running.take() {
            drop(requests);
            let _ = child.wait();
        }
    }
}

/// The end of a stream, read to its end.
fn end_of(mut stream: impl Read) -> String {
    let (mut kept, mut buffer) = (Vec::new(), [0; 4096]);
    while let Ok(length @ 1..) = stream.read(&mut buffer) {
        kept.extend(&buffer[..length]);
        let excess = kept.len().saturating_sub(KEPT_ERROR);
        kept.drain(..excess);
    }
    String::from_utf8_lossy(&kept).into_owned()
}
