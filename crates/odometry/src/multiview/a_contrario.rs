//! Agreement beyond chance (Moisan and Stival 2004; Moisan, Moulon and Monasse 2012).

/// Natural logarithm of the expected number of models as good among random matches, at most.
const MAX_LOG_FALSE_ALARMS: f64 = -9.0;

/// True if so many of the matches agree with a model that `sample` of them determine that it is no chance.
/// `chances` are the probabilities with which each agreeing one would agree with a wrong model.
///
/// Of `n` matches, `(n - s) C(n, k) C(k, s) p^(k - s)` models would be expected to have `k` as good.
pub(crate) fn is_no_chance(matches: usize, sample: usize, chances: &[f64]) -> bool {
    let (n, k) = (matches, chances.len());
    if k <= sample || n < k {
        return false;
    }
    let log_choose = |n: usize, k: usize| -> f64 {
        (0..k).map(|i| ((n - i) as f64).ln() - ((i + 1) as f64).ln()).sum()
    };
    let log_chances = chances.iter().map(|p| p.ln()).sum::<f64>() * (k - sample) as f64 / k as f64;
    let log = ((n - sample) as f64).ln() + log_choose(n, k) + log_choose(k, sample) + log_chances;
    log < MAX_LOG_FALSE_ALARMS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_that_agree_may_be_chance_and_many_may_not() {
        let of = |agreeing: usize, p: f64| is_no_chance(100, 5, &vec![p; agreeing]);
        assert!(of(24, 0.01) && !of(8, 0.01));
        // What agrees easily proves little.
        assert!(!of(24, 0.1) && of(60, 0.1));
        assert!(!is_no_chance(3, 5, &[0.01; 3]));
    }
}
