//! The worker: runs the cases that its standard input names, and answers each with a line.

use crate::arguments::Arguments;
use crate::case::Case;
use crate::corpus::{self, Seed};
use crate::failure::{Failure, Outcome, fault_of};
use crate::memory::{Meter, bound_address_space};
use crate::mutate;
use crate::protocol::{Answer, Request};
use crate::readers::{self, Reader};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, BufRead, Write};
use std::panic;
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

/// Message and place of the first panic of a case, on any thread.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Serves until the standard input ends. `scratch` takes the files of cases.
pub(crate) fn serve(arguments: &Arguments, scratch: &Path) -> Result<bool, String> {
    panic::set_hook(Box::new(|info| {
        let mut first = PANIC.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        first.get_or_insert_with(|| info.to_string());
        // Shown only if the worker dies of it, outside of a reader.
        eprintln!("{info}");
    }));
    bound_address_space()?;
    let mut corpora: BTreeMap<&str, Vec<Seed>> = BTreeMap::new();
    for line in io::stdin().lock().lines() {
        let line = line.map_err(|e| e.to_string())?;
        let request = Request::parse(&line).ok_or_else(|| format!("no request: {line}"))?;
        let reader = readers::find(request.reader).ok_or_else(|| format!("no reader: {line}"))?;
        if !corpora.contains_key(reader.name) {
            corpora.insert(reader.name, corpus::read(&arguments.corpus, reader.name)?);
        }
        let seed = arguments.seed.unwrap_or_default();
        let case = mutate::case(&corpora[reader.name], reader.name, seed, request.id);
        let folder = scratch.join("case");
        remove(&folder);
        let written = case.write(&folder);
        written.map_err(|e| format!("cannot write a case to {}: {e}", folder.display()))?;
        let answer = judged(reader, &case, &folder);
        remove(&folder);
        let mut out = io::stdout().lock();
        let sent = out.write_all(answer.line().as_bytes()).and_then(|()| out.flush());
        sent.map_err(|e| e.to_string())?;
    }
    Ok(true)
}

fn remove(folder: &Path) {
    // There may be none.
    let _ = fs::remove_dir_all(folder);
}

fn judged(reader: &Reader, case: &Case, folder: &Path) -> Answer {
    let (meter, start) = (Meter::start(), Instant::now());
    let result = panic::catch_unwind(|| (reader.read)(folder));
    let (seconds, memory) = (start.elapsed().as_secs_f64(), meter.peak());
    let panicked = PANIC.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take();
    let outcome = match (panicked, result) {
        (Some(message), _) => Outcome::Failed(Failure::Panic(message)),
        (None, Err(_)) => Outcome::Failed(Failure::Panic("without message".into())),
        (None, Ok(Ok(()))) => Outcome::Accepted,
        (None, Ok(Err(message))) => match fault_of(&message, case, folder) {
            None => Outcome::Refused(message),
            Some(fault) => Outcome::Failed(Failure::Message(fault, message)),
        },
    };
    Answer { outcome, seconds, memory }
}
