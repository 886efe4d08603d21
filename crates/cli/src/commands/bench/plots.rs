//! The plots of the page: the paper's runtime figure, and quality over virtual cameras.

use super::figures::{ATE, Figure, PSNR, SECONDS};
use super::plot::{Plot, Point, Series};
use super::suite::Layout;
use super::summary::Results;

/// All plots that the suite has figures for.
pub(super) fn plots(results: &Results<'_>) -> Vec<Plot> {
    let mut plots = Vec::new();
    let (over_cameras, over_time) = ("over the number of virtual cameras", "over time per frame");
    if results.plan.suite.tables.contains(&Layout::VirtualCameras) {
        let cameras = |place: usize| {
            Some(results.plan.settings[place].config.formation.virtual_cameras as f64)
        };
        for figure in [&PSNR, &ATE] {
            plots.push(plot(results, figure, (over_cameras, "virtual cameras", false), cameras));
        }
    }
    let seconds =
        |place: usize| results.over_sequences(place, &SECONDS).measured().map(|value| value.mean);
    for figure in [&ATE, &PSNR] {
        plots.push(plot(results, figure, (over_time, "seconds per frame [s]", true), seconds));
    }
    plots
}

/// A figure over what `x` says of each configuration.
fn plot(
    results: &Results<'_>,
    figure: &'static Figure,
    (over, x_label, may_be_logarithmic): (&str, &str, bool),
    x: impl Fn(usize) -> Option<f64>,
) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    for (place, setting) in results.plan.settings.iter().enumerate() {
        let value = results.over_sequences(place, figure);
        let (Some(x), Some(value)) = (x(place), value.measured()) else { continue };
        let point = Point {
            name: setting.entry.name.clone(),
            x,
            y: value.mean * figure.factor,
            spread: value.spread.unwrap_or(0.0) * figure.factor,
        };
        let name = setting.entry.series.as_ref().unwrap_or(&setting.entry.name);
        match series.iter_mut().find(|series| series.name == *name) {
            Some(series) => series.points.push(point),
            None => series.push(Series { name: name.clone(), points: vec![point] }),
        }
    }
    for series in &mut series {
        series.points.sort_by(|a, b| a.x.total_cmp(&b.x));
    }
    let better = if figure.lower { "Lower is better" } else { "Higher is better" };
    let means = match results.sequences_with(figure).len() {
        0 | 1 => String::new(),
        count => format!(", mean over {count} sequences"),
    };
    let bars = if results.plan.suite.seeds.len() > 1 {
        "; bars are the standard deviation over seeds"
    } else {
        ""
    };
    Plot {
        title: format!("{} {over}", figure.label),
        explanation: format!("{better}{means}{bars}."),
        x_label: x_label.to_owned(),
        y_label: match figure.unit {
            "" => figure.label.to_owned(),
            unit => format!("{} [{unit}]", figure.label),
        },
        from_zero: figure.lower,
        may_be_logarithmic,
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{plan, results};
    use super::*;

    #[test]
    fn a_configuration_that_failed_has_no_point() {
        let plan = plan();
        let plots = plots(&results(&plan, &[(1, 0, 0), (1, 0, 1)]));
        assert_eq!(plots.len(), 4);
        let over_time = &plots[2];
        assert_eq!(over_time.series.len(), 1);
        let point = &over_time.series[0].points[0];
        assert_eq!((point.x, point.y), (1.5, 10650.0));
        assert_eq!(plots[3].html(), "", "no PSNR was measured");
    }
}
