//! Errors of exposures that are predicted from the map of a result.
//!
//! ```sh
//! cargo run -p i2slam-bench --example auto_exposure -- RESULT [DATASET/exposure.csv]
//! ```
//!
//! Five parts of the sequence are left out in turn: a controller is fitted to the exposures of all other
//! frames and follows the light of all. Root mean square of what it and the median of the other frames are
//! off the run's own exposures [stops], and with a table (columns `frame` and `dt`, in any unit) off the true
//! ones, which are brought to the run's unit by the median ratio.

use i2slam::Reconstruction;
use i2slam::formation::{AutoExposureFit, ExposureSample};
use std::collections::HashMap;
use std::convert::Infallible;
use std::error::Error;
use std::f64::consts::LN_2;

const BLOCKS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let result = arguments.next().ok_or("which result?")?;
    let reconstruction = i2slam_result::load(result.as_ref())?;
    let Ok(samples) = reconstruction.light_meter().samples(|_, _| Ok::<(), Infallible>(()));
    let fit = AutoExposureFit::new(&samples).ok_or("fewer than ten frames")?;
    let found = fit.controller;
    println!(
        "{}, slope {:.2}, time constant {:.3} s, {}",
        found.meter.name(),
        found.slope,
        found.time_constant,
        if fit.better_than_constant().is_some() { "used" } else { "one exposure is as good" }
    );
    let predictions = left_out(&samples);
    let own: Vec<f64> = samples.iter().map(|sample| sample.log_exposure).collect();
    report("off the run's", &predictions, &own);
    if let Some(table) = arguments.next() {
        let mut due = true_exposures(&reconstruction, &std::fs::read_to_string(table)?)?;
        let gain = median(own.iter().zip(&due).map(|(own, due)| own - due));
        due.iter_mut().for_each(|due| *due += gain);
        report("off the truth", &predictions, &due);
    }
    Ok(())
}

/// Of each frame, ln Δt by a controller and by the median exposure of frames in other parts.
fn left_out(samples: &[ExposureSample]) -> Vec<[f64; 2]> {
    let blocks = (0..BLOCKS).map(|k| k * samples.len() / BLOCKS..(k + 1) * samples.len() / BLOCKS);
    let predicted = blocks.flat_map(|block| {
        let mut rest = samples.to_vec();
        rest[block.clone()].iter_mut().for_each(|sample| sample.log_exposure = f64::NAN);
        let known = rest.iter().map(|sample| sample.log_exposure).filter(|e| e.is_finite());
        let constant = median(known);
        let fit = AutoExposureFit::new(&rest);
        let mut camera = fit.map(|fit| fit.controller.follow());
        let mut next =
            |sample: &ExposureSample| camera.as_mut()?.next(sample.time, sample.metering.as_ref());
        let all: Vec<_> = rest.iter().map(|s| [next(s).unwrap_or(constant), constant]).collect();
        all[block].to_vec()
    });
    predicted.collect()
}

fn report(what: &str, predictions: &[[f64; 2]], due: &[f64]) {
    let [predicted, constant] = [0, 1].map(|i| {
        let square = |(found, due): (&[f64; 2], &f64)| (found[i] - due).powi(2);
        let sum: f64 = predictions.iter().zip(due).map(square).sum();
        (sum / due.len() as f64).sqrt() / LN_2
    });
    println!("{what}: {predicted:.3} stops, one exposure {constant:.3}");
}

/// ln Δt of the tracked frames in a table with named columns.
fn true_exposures(run: &Reconstruction, table: &str) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name| names.iter().position(|n| *n == name).ok_or(format!("no column {name}"));
    let (frame, exposure) = (column("frame")?, column("dt")?);
    let row = |line: &str| -> Option<(usize, f64)> {
        let cells: Vec<&str> = line.split(',').collect();
        Some((cells.get(frame)?.parse().ok()?, cells.get(exposure)?.parse::<f64>().ok()?.ln()))
    };
    let rows: HashMap<usize, f64> = lines.filter_map(row).collect();
    let frames = run.frames.iter().filter(|frame| frame.tracked);
    let due: Option<Vec<f64>> = frames.map(|frame| rows.get(&frame.index).copied()).collect();
    Ok(due.ok_or("a frame is not in the table")?)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
