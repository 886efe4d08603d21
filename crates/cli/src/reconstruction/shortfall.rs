//! Runs that ended with a result which is not what was asked for.

use i2slam_result::Metrics;

/// Errors of a run, the reasons for a degraded result first, in one line; a reason that is among
/// `problems` is told there.
pub(super) fn with_shortfall(metrics: &Metrics, problems: Vec<String>) -> Vec<String> {
    let reasons = metrics.degraded_because.iter().filter(|reason| !problems.contains(reason));
    let reasons: Vec<&str> = reasons.map(String::as_str).collect();
    let shortfall = (!reasons.is_empty()).then(|| reasons.join("; "));
    shortfall.into_iter().chain(problems).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_come_first_and_once() {
        let texts = |all: &[&str]| -> Vec<String> { all.iter().map(ToString::to_string).collect() };
        let mut metrics = Metrics::default();
        assert_eq!(with_shortfall(&metrics, texts(&["no room"])), ["no room"]);
        metrics.degrade(texts(&["none was tracked", "the map is empty", "no room"]));
        let due = ["none was tracked; the map is empty", "no room"];
        assert_eq!(with_shortfall(&metrics, texts(&["no room"])), due);
    }
}
