//! Intervals for what the experiments report, and how much of a difference is rounding.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// A mean with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Interval {
    /// The mean.
    pub mean: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Units of rounding, ε = 2⁻⁵², by which two numbers may differ that would be equal if computers did not round. A sum of n
/// numbers is off by at most about n ε times the sum of their magnitudes: 1024 covers a mean over a thousand steps or
/// rounds, and leaves twelve significant digits, more than anything here is measured to.
const ROUNDING_UNITS: f64 = 1024.0;

/// The largest difference between numbers of this magnitude that rounding alone explains: 1024 ε max |x|, that is 2.3e−13
/// of the largest. The magnitude is that of what was measured, not of differences taken from it.
pub fn rounding(measured: impl IntoIterator<Item = f64>) -> f64 {
    let largest = measured.into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    ROUNDING_UNITS * f64::EPSILON * largest
}

/// Sum of the squared deviations from `mean`; 0 where none of them is larger than `noise`.
pub(crate) fn squared_deviations(values: &[f64], mean: f64, noise: f64) -> f64 {
    match values.iter().all(|v| (v - mean).abs() <= noise) {
        true => 0.0,
        false => values.iter().map(|v| (v - mean) * (v - mean)).sum(),
    }
}

/// Mean over people with Student's 95 % interval. The interval is the mean itself for fewer than two people, and where people
/// differ by no more than [`rounding`].
pub fn over_people(values: &[f64]) -> Interval {
    interval(values, rounding(values.iter().copied()))
}

/// [`over_people`] of values that rounding moved by up to `noise`.
pub(crate) fn interval(values: &[f64], noise: f64) -> Interval {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n.max(1.0);
    if values.len() < 2 {
        return Interval {
            mean,
            low: mean,
            high: mean,
        };
    }
    let variance = squared_deviations(values, mean, noise) / (n - 1.0);
    let quantile = StudentsT::new(0.0, 1.0, n - 1.0).map_or(1.96, |t| t.inverse_cdf(0.975));
    let half = quantile * (variance / n).sqrt();
    Interval {
        mean,
        low: mean - half,
        high: mean + half,
    }
}

/// A share with Wilson's 95 % interval, for single rounds.
pub fn share(hits: usize, rounds: usize) -> Interval {
    let (hits, n, z) = (hits as f64, rounds.max(1) as f64, 1.959_964);
    let p = hits / n;
    let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt() / (1.0 + z * z / n);
    Interval {
        mean: p,
        low: (centre - half).max(0.0),
        high: (centre + half).min(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// scipy: t.interval(0.95, 4, loc=mean, scale=sem) of [1, 2, 4, 4, 9]; statsmodels proportion_confint(7, 20, method="wilson").
    #[test]
    fn agrees_with_scipy_and_statsmodels() {
        let interval = over_people(&[1.0, 2.0, 4.0, 4.0, 9.0]);
        assert!((interval.mean - 4.0).abs() < 1e-12);
        assert!((interval.low - 0.172_935).abs() < 1e-4, "{interval:?}");
        assert!((interval.high - 7.827_065).abs() < 1e-4, "{interval:?}");
        let wilson = share(7, 20);
        assert!((wilson.low - 0.181_192).abs() < 1e-4, "{wilson:?}");
        assert!((wilson.high - 0.567_147).abs() < 1e-4, "{wilson:?}");
    }
}
