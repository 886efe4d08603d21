//! Reconstructs a sequence and compares every forecast of the run's duration with the true one.
//!
//! usage: forecasts SEQUENCE [--rgb] [--scale S]
use i2slam::run::{Observer, RuntimeForecast, Stage};
use i2slam::{RunOptions, reconstruct};
use std::error::Error;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Beginning of a stage, or a forecast of the whole duration, and when it came [s].
struct Line {
    time: f64,
    text: String,
    forecast: Option<f64>,
}

/// Observer that notes when stages begin, and what is forecast when.
struct Notes {
    started: Instant,
    lines: Arc<Mutex<Vec<Line>>>,
}

impl Notes {
    fn add(&self, text: String, forecast: Option<f64>) {
        let Ok(mut lines) = self.lines.lock() else { return };
        if lines.last().is_none_or(|last| last.text != text) {
            lines.push(Line { time: self.started.elapsed().as_secs_f64(), text, forecast });
        }
    }
}

impl Observer for Notes {
    fn progress(&self, stage: Stage, _done: usize, _total: usize) {
        self.add(stage.name().to_owned(), None);
    }

    fn forecast(&self, forecast: &RuntimeForecast) {
        self.add(format!("{forecast:?}"), Some(forecast.seconds));
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value_of = |flag: &str| arguments.iter().position(|a| a == flag).map(|i| &arguments[i + 1]);
    let sequence = arguments.first().ok_or("usage: forecasts SEQUENCE [--rgb] [--scale S]")?;
    let mut options = match arguments.iter().any(|a| a == "--rgb") {
        true => RunOptions::colour_alone(),
        false => RunOptions::with_depth(),
    };
    if let Some(scale) = value_of("--scale") {
        (options.open.scale, options.open.max_side) = (scale.parse()?, None);
    }
    let sequence = options.open_sequence(sequence.as_ref())?;
    let (started, lines) = (Instant::now(), Arc::<Mutex<Vec<Line>>>::default());
    let outcome = reconstruct(&sequence, &options, Notes { started, lines: Arc::clone(&lines) })?;
    let seconds = started.elapsed().as_secs_f64();
    for Line { time, text, forecast } in lines.lock().map_err(|e| e.to_string())?.iter() {
        let share = 100.0 * time / seconds;
        match forecast {
            None => println!("{time:7.1} s {share:3.0} %  {text}"),
            Some(all) => {
                let error = 100.0 * (all / seconds - 1.0);
                println!("{time:7.1} s {share:3.0} %  forecast {all:.1} s ({error:+.0} %): {text}");
            }
        }
    }
    println!("{seconds:7.1} s 100 %  {}", outcome.reconstruction.map);
    Ok(())
}
