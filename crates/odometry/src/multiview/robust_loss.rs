//! Robust losses: weight and cost of a residual.

/// Residual at which Huber's loss (1964) turns linear [standard deviations].
pub(crate) const HUBER_THRESHOLD: f64 = 1.5;

/// Length of a residual. `f64::hypot` guards against overflow at ten times the cost.
pub(crate) fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// Huber weight and cost of a residual of length `n` [standard deviations].
pub(crate) fn huber(n: f64) -> (f64, f64) {
    if n <= HUBER_THRESHOLD {
        (1.0, n * n)
    } else {
        (HUBER_THRESHOLD / n, HUBER_THRESHOLD * (2.0 * n - HUBER_THRESHOLD))
    }
}

/// Cauchy weight and cost of a residual of length `n`, with scale `width`.
pub(crate) fn cauchy(n: f64, width: f64) -> (f64, f64) {
    let s = (n / width) * (n / width);
    (1.0 / (1.0 + s), width * width * s.ln_1p())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_slope_of_the_cost() {
        for n in [0.4, 1.4, 1.6, 9.0] {
            let slope = |f: &dyn Fn(f64) -> f64| (f(n + 1e-5) - f(n - 1e-5)) / 2e-5;
            assert!((slope(&|n| huber(n).1) - 2.0 * n * huber(n).0).abs() < 1e-6);
            assert!((slope(&|n| cauchy(n, 2.0).1) - 2.0 * n * cauchy(n, 2.0).0).abs() < 1e-6);
        }
    }
}
