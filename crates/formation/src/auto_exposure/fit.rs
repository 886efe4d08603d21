//! Fit of a controller to the frames of a run.

use super::controller::{AutoExposure, LowPass};
use super::metering::{Meter, Metering};
use i2slam_compute::median;
use std::f64::consts::LN_2;
use std::ops::Range;

/// Parts of a sequence that are left out in turn: neighbouring frames are alike, so that single
/// frames left out would be known from those beside them.
const BLOCKS: usize = 5;
/// Fewest frames of a fit.
const MIN_FRAMES: usize = 2 * BLOCKS;
/// Time constants that are tried [median frame intervals]; each is 1.5 times the one before. The first
/// follows by 95 % from frame to frame: less cannot be told from none, and flights have no jumps for it.
const TIME_CONSTANTS: [f64; 13] =
    [0.33, 0.5, 0.75, 1.1, 1.7, 2.5, 3.8, 5.7, 8.5, 13.0, 19.0, 29.0, 43.0];
/// The slope of full compensation: every view is made equally bright. None is steeper; a meter that asks
/// for one reads something that varies less than what the camera meters.
const FULL_COMPENSATION: f64 = -1.0;
/// Deviation of metered light from what exposure was chosen for [ln]: cameras leave an exposure that is
/// off by up to a third of a stop. Where views differ by less, the slope is that of full compensation;
/// smaller residuals are no outliers.
const METERING_DEVIATION: f64 = 0.13;
/// Steps of reweighting.
const STEPS: usize = 10;
/// Width of Cauchy's loss in deviations of the residuals (Holland and Welsch 1977).
const CAUCHY_WIDTH: f64 = 2.385;
/// Error of a constant exposure below which it stays [ln]: a tenth of a stop is hardly seen.
const MIN_CONSTANT_ERROR: f64 = 0.1 * LN_2;
/// Largest error of a controller over that of a constant.
const MAX_ERROR_RATIO: f64 = 0.8;
/// Share of the frames beyond either end of their range: single exposures may be wrong.
const OUTSIDE_RANGE: f64 = 0.02;
/// By how much exposures may leave the range of the frames' [ln]: half a stop.
const MARGIN: f64 = 0.5 * LN_2;
/// Largest error that counts as it is [ln]: frames whose exposure was not found decide nothing.
const MAX_ERROR: f64 = LN_2;

/// A frame that a controller is fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureSample {
    /// Time [s].
    pub time: f64,
    /// Light of its view; `None` where the map shows nothing there.
    pub metering: Option<Metering>,
    /// ln Δt.
    pub log_exposure: f64,
}

/// A fitted controller, with the errors of ln Δt in parts of the sequence that were left out (root mean
/// square, single errors counting as a stop at most).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoExposureFit {
    /// The controller of all frames.
    pub controller: AutoExposure,
    /// Error of controllers that were chosen and fitted without the frames they are judged by.
    pub error: f64,
    /// Error of the median exposure of the other frames.
    pub constant_error: f64,
}

impl AutoExposureFit {
    /// Fits a controller to frames in order of time, by robust least squares; meter and time constant are
    /// those with the least error on parts left out. `None` for fewer than ten frames.
    pub fn new(samples: &[ExposureSample]) -> Option<Self> {
        let known: Vec<_> = samples.iter().filter(|s| s.log_exposure.is_finite()).collect();
        let metered: Vec<(f64, Metering, f64)> =
            known.iter().filter_map(|s| Some((s.time, s.metering?, s.log_exposure))).collect();
        if metered.len() < MIN_FRAMES {
            return None;
        }
        let table = Table::new(&metered);
        let all: Vec<usize> = (0..metered.len()).collect();
        let (mut error, mut constant_error) = (0.0, 0.0);
        for block in blocks(all.len()) {
            let rest = without(&all, &block);
            let constant = table.median_exposure(&rest);
            let (column, controller) = table.fit(&rest);
            for i in block {
                let due = table.log_exposures[i];
                error += square(controller.exposed(column.light[i]) - due);
                constant_error += square(constant - due);
            }
        }
        let (_, controller) = table.fit(&all);
        let [error, constant_error] =
            [error, constant_error].map(|sum: f64| (sum / all.len() as f64).sqrt());
        Some(Self { controller, error, constant_error })
    }

    /// The controller, where it predicts exposures better than a constant does by a fifth, and these
    /// vary by more than a tenth of a stop.
    pub fn better_than_constant(&self) -> Option<AutoExposure> {
        let varies = self.constant_error > MIN_CONSTANT_ERROR;
        let explains = self.error < MAX_ERROR_RATIO * self.constant_error;
        (varies && explains && self.controller.slope < 0.0).then_some(self.controller)
    }
}

/// Metered light of all frames behind one low pass.
struct Column {
    meter: Meter,
    time_constant: f64,
    light: Vec<f64>,
}

/// A line `offset + slope · light`.
#[derive(Clone, Copy)]
struct Line {
    offset: f64,
    slope: f64,
}

impl Line {
    fn at(self, light: f64) -> f64 {
        self.offset + self.slope * light
    }
}

/// All columns, with the exposures that they are to explain.
struct Table {
    columns: Vec<Column>,
    log_exposures: Vec<f64>,
}

impl Table {
    fn new(samples: &[(f64, Metering, f64)]) -> Self {
        let mut intervals: Vec<f64> = samples.windows(2).map(|w| w[1].0 - w[0].0).collect();
        let interval = median(&mut intervals).unwrap_or(0.0).max(0.0);
        let column = |meter: Meter, intervals: f64| {
            let time_constant = intervals * interval;
            let mut smoothed = LowPass::new(time_constant);
            let light = samples.iter().map(|(time, m, _)| smoothed.next(*time, m.get(meter)));
            Column { meter, time_constant, light: light.collect() }
        };
        let columns = Meter::ALL.iter().flat_map(|m| TIME_CONSTANTS.map(|t| column(*m, t)));
        let log_exposures = samples.iter().map(|(_, _, log_exposure)| *log_exposure).collect();
        Self { columns: columns.collect(), log_exposures }
    }

    /// The column that explains parts of some frames best by the others, and its line through all of them.
    fn choose(&self, frames: &[usize]) -> (&Column, Line) {
        let error = |column: &Column| -> f64 {
            let parts = blocks(frames.len()).map(|block| {
                let rest = without(frames, &block);
                let line = self.line(column, &rest);
                let error = |&i: &usize| square(line.at(column.light[i]) - self.log_exposures[i]);
                frames[block].iter().map(error).sum::<f64>()
            });
            parts.sum()
        };
        let first = &self.columns[0];
        let best = self.columns[1..].iter().fold((first, error(first)), |best, column| {
            let error = error(column);
            if error < best.1 { (column, error) } else { best }
        });
        (best.0, self.line(best.0, frames))
    }

    /// The line through some frames, by ridge regression with Cauchy's weights.
    fn line(&self, column: &Column, frames: &[usize]) -> Line {
        let mut line = Line { offset: self.median_exposure(frames), slope: 0.0 };
        let mut weights = vec![1.0; frames.len()];
        for _ in 0..STEPS {
            line = self.weighted_line(column, frames, &weights);
            let residuals =
                frames.iter().map(|&i| line.at(column.light[i]) - self.log_exposures[i]);
            let residuals: Vec<f64> = residuals.collect();
            let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
            // The median of sizes is 0.6745 deviations of a normal distribution.
            let deviation = (median(&mut sizes).unwrap_or(0.0) / 0.6745).max(METERING_DEVIATION);
            let width = CAUCHY_WIDTH * deviation;
            weights = residuals.iter().map(|r| 1.0 / (1.0 + (r / width).powi(2))).collect();
        }
        line
    }

    fn weighted_line(&self, column: &Column, frames: &[usize], weights: &[f64]) -> Line {
        let points =
            || frames.iter().map(|&i| (column.light[i], self.log_exposures[i])).zip(weights);
        let total: f64 = weights.iter().sum();
        let mean = points().fold((0.0, 0.0), |(x, y), (p, w)| (x + w * p.0, y + w * p.1));
        let mean = (mean.0 / total, mean.1 / total);
        let moments = points().fold((0.0, 0.0), |(xx, xy), (p, w)| {
            let (x, y) = (p.0 - mean.0, p.1 - mean.1);
            (xx + w * x * x, xy + w * x * y)
        });
        let ridge = total * METERING_DEVIATION * METERING_DEVIATION;
        let slope = (moments.1 + ridge * FULL_COMPENSATION) / (moments.0 + ridge);
        let slope = slope.clamp(FULL_COMPENSATION, 0.0);
        Line { offset: mean.1 - slope * mean.0, slope }
    }

    /// The controller of some frames, with the column that it reads.
    fn fit(&self, frames: &[usize]) -> (&Column, AutoExposure) {
        let (column, Line { offset, slope }) = self.choose(frames);
        let (&Column { meter, time_constant, .. }, range) = (column, self.range(frames));
        (column, AutoExposure { meter, offset, slope, time_constant, range })
    }

    fn median_exposure(&self, frames: &[usize]) -> f64 {
        let mut values: Vec<f64> = frames.iter().map(|&i| self.log_exposures[i]).collect();
        median(&mut values).unwrap_or(0.0)
    }

    /// The range of the exposures of some frames, but for a few at either end, widened.
    fn range(&self, frames: &[usize]) -> [f64; 2] {
        let mut values: Vec<f64> = frames.iter().map(|&i| self.log_exposures[i]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let place = (OUTSIDE_RANGE * values.len() as f64) as usize;
        let [least, most] = [place, values.len() - 1 - place].map(|place| values[place]);
        [least - MARGIN, most + MARGIN]
    }
}

/// The square of an error, up to the largest that counts.
fn square(error: f64) -> f64 {
    error.clamp(-MAX_ERROR, MAX_ERROR).powi(2)
}

/// Places of the blocks of a list.
fn blocks(count: usize) -> impl Iterator<Item = Range<usize>> {
    (0..BLOCKS).map(move |k| k * count / BLOCKS..(k + 1) * count / BLOCKS)
}

fn without(frames: &[usize], block: &Range<usize>) -> Vec<usize> {
    [&frames[..block.start], &frames[block.end..]].concat()
}
