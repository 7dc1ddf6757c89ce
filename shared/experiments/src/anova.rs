//! Tests for within-subjects studies (paper §V-C): the repeated-measures one-way analysis of variance with Greenhouse and
//! Geisser's correction, and paired t-tests adjusted after Bonferroni.
//!
//! ```text
//! SS_conditions = n Σ_j (x̄_·j − x̄)²,   SS_error = Σ_ij (x_ij − x̄_i· − x̄_·j + x̄)²
//! F = (SS_conditions / (k − 1)) / (SS_error / ((n − 1)(k − 1)))
//! ε = (tr S̃)² / ((k − 1) tr S̃²),   S̃ the covariance of the conditions, centred by rows and columns
//! ```
//!
//! Rounding is no effect: differences within [`rounding`] of what was measured count as none.

use crate::statistics::{Interval, interval, rounding, squared_deviations};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};

/// A repeated-measures one-way analysis of variance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Anova {
    /// F.
    pub f: f64,
    /// Degrees of freedom of the conditions, k − 1.
    pub df_conditions: f64,
    /// Degrees of freedom of the error, (n − 1)(k − 1).
    pub df_error: f64,
    /// Probability of an F at least as large, assuming sphericity.
    pub p: f64,
    /// Greenhouse and Geisser's ε.
    pub epsilon: f64,
    /// p with both degrees of freedom multiplied by ε.
    pub p_corrected: f64,
    /// SS_conditions / (SS_conditions + SS_error).
    pub partial_eta_squared: f64,
}

/// Why there is nothing to test.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TestError {
    /// Fewer than two people or conditions.
    #[error(
        "a within-subjects test needs two people and two conditions, not {people} and {conditions}"
    )]
    TooFew {
        /// People.
        people: usize,
        /// Conditions.
        conditions: usize,
    },
    /// A person lacks a condition.
    #[error("person {0} (from 0) was not measured under every condition")]
    Missing(usize),
    /// Nothing varies.
    #[error(
        "people do not differ in how the conditions affect them: there is no error to compare with"
    )]
    NoError,
}

/// Analyses `people[i][j]`, what was measured of person i under condition j. Where every residual is within [`rounding`] of
/// the largest measurement, F would be a quotient of rounding errors or of something by nothing: [`TestError::NoError`].
///
/// # Errors
/// [`TestError`].
pub fn repeated_measures(people: &[Vec<f64>]) -> Result<Anova, TestError> {
    let n = people.len();
    let k = people.first().map_or(0, Vec::len);
    if n < 2 || k < 2 {
        return Err(TestError::TooFew {
            people: n,
            conditions: k,
        });
    }
    let lacks = |row: &Vec<f64>| row.len() != k || row.iter().any(|x| !x.is_finite());
    if let Some(person) = people.iter().position(lacks) {
        return Err(TestError::Missing(person));
    }
    let (nf, kf) = (n as f64, k as f64);
    let of_person: Vec<f64> = people
        .iter()
        .map(|row| row.iter().sum::<f64>() / kf)
        .collect();
    let of_condition: Vec<f64> = (0..k)
        .map(|j| people.iter().map(|row| row[j]).sum::<f64>() / nf)
        .collect();
    let grand = of_person.iter().sum::<f64>() / nf;
    let between: f64 = nf
        * of_condition
            .iter()
            .map(|m| (m - grand).powi(2))
            .sum::<f64>();
    let residuals: Vec<f64> = people
        .iter()
        .zip(&of_person)
        .flat_map(|(row, person)| {
            row.iter()
                .zip(&of_condition)
                .map(move |(x, condition)| x - person - condition + grand)
        })
        .collect();
    let noise = rounding(people.iter().flatten().copied());
    let error = squared_deviations(&residuals, 0.0, noise);
    if error == 0.0 {
        return Err(TestError::NoError);
    }
    let (df_conditions, df_error) = (kf - 1.0, (nf - 1.0) * (kf - 1.0));
    let f = (between / df_conditions) / (error / df_error);
    let epsilon = greenhouse_geisser(people, &of_condition);
    Ok(Anova {
        f,
        df_conditions,
        df_error,
        p: above(f, df_conditions, df_error),
        epsilon,
        p_corrected: above(f, df_conditions * epsilon, df_error * epsilon),
        partial_eta_squared: between / (between + error),
    })
}

/// P(F ≥ f).
fn above(f: f64, df_conditions: f64, df_error: f64) -> f64 {
    FisherSnedecor::new(df_conditions, df_error).map_or(f64::NAN, |law| law.sf(f))
}

fn greenhouse_geisser(people: &[Vec<f64>], of_condition: &[f64]) -> f64 {
    let (n, k) = (people.len() as f64, of_condition.len());
    let mut covariance = vec![vec![0.0; k]; k];
    for row in people {
        for a in 0..k {
            for b in 0..k {
                covariance[a][b] +=
                    (row[a] - of_condition[a]) * (row[b] - of_condition[b]) / (n - 1.0);
            }
        }
    }
    let of_row: Vec<f64> = covariance
        .iter()
        .map(|row| row.iter().sum::<f64>() / k as f64)
        .collect();
    let grand = of_row.iter().sum::<f64>() / k as f64;
    let (mut trace, mut squares) = (0.0, 0.0);
    for a in 0..k {
        for b in 0..k {
            let centred = covariance[a][b] - of_row[a] - of_row[b] + grand;
            squares += centred * centred;
            if a == b {
                trace += centred;
            }
        }
    }
    let least = 1.0 / (k as f64 - 1.0);
    (trace * trace / (squares * (k as f64 - 1.0))).clamp(least, 1.0)
}

/// A paired t-test, two-sided.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PairedT {
    /// Mean of first − second with its unadjusted 95 % interval.
    pub difference: Interval,
    /// t.
    pub t: f64,
    /// n − 1.
    pub df: f64,
    /// Probability of a |t| at least as large.
    pub p: f64,
    /// p times the number of tests made, at most 1 (Bonferroni).
    pub p_adjusted: f64,
}

impl PairedT {
    /// Whether the difference is significant at 5 % after adjustment.
    pub fn is_significant(&self) -> bool {
        self.p_adjusted < 0.05
    }
}

/// Compares `first` with `second`, person by person; one of `tests` such comparisons.
///
/// With the noise that [`rounding`] gives for the largest of all measurements: where no difference exceeds it, there is no
/// difference (mean 0, t = 0, p = 1). Where a difference does, but all are the same within it, t has its mathematical limit:
/// there is no doubt about the sign (t = ±∞, p = 0).
///
/// # Errors
/// [`TestError`].
pub fn paired_t(first: &[f64], second: &[f64], tests: usize) -> Result<PairedT, TestError> {
    let n = first.len();
    if n < 2 || second.len() != n {
        return Err(TestError::TooFew {
            people: n.min(second.len()),
            conditions: 2,
        });
    }
    let mut differences: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    if let Some(person) = differences.iter().position(|d| !d.is_finite()) {
        return Err(TestError::Missing(person));
    }
    let nf = n as f64;
    let noise = rounding(first.iter().chain(second).copied());
    if differences.iter().all(|d| d.abs() <= noise) {
        differences.fill(0.0);
    }
    let difference = interval(&differences, noise);
    let mean = difference.mean;
    let variance = squared_deviations(&differences, mean, noise) / (nf - 1.0);
    let df = nf - 1.0;
    let (t, p) = if variance == 0.0 {
        match mean {
            0.0 => (0.0, 1.0),
            _ => (mean.signum() * f64::INFINITY, 0.0),
        }
    } else {
        let t = mean / (variance / nf).sqrt();
        let p = StudentsT::new(0.0, 1.0, df).map_or(f64::NAN, |law| 2.0 * law.sf(t.abs()));
        (t, p)
    };
    Ok(PairedT {
        difference,
        t,
        df,
        p,
        p_adjusted: (p * tests.max(1) as f64).min(1.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::over_people;

    #[derive(serde::Deserialize)]
    struct Fixture {
        made_by: String,
        cases: Vec<Case>,
    }

    #[derive(serde::Deserialize)]
    struct Case {
        name: String,
        people: Vec<Vec<f64>>,
        anova: [f64; 7],
        pairs: Vec<Pair>,
        intervals: Vec<[f64; 3]>,
    }

    #[derive(serde::Deserialize)]
    struct Pair {
        a: usize,
        b: usize,
        t: f64,
        p: f64,
        p_bonferroni: f64,
        difference: [f64; 3],
    }

    fn assert_near(ours: f64, theirs: f64, what: &str) {
        let tolerance = 1e-8 * theirs.abs() + 1e-12;
        assert!(
            (ours - theirs).abs() <= tolerance,
            "{what}: {ours} and {theirs}"
        );
    }

    /// Against pingouin, statsmodels and scipy: `tools/statistics_fixture.py` wrote what they say.
    #[test]
    fn agrees_with_pingouin_statsmodels_and_scipy() {
        let text = include_str!("../../../tools/fixtures/statistics.json");
        let fixture: Fixture = serde_json::from_str(text).expect("the fixture");
        assert!(fixture.made_by.contains("pingouin"));
        assert!(fixture.cases.len() >= 4);
        for case in &fixture.cases {
            let ours = repeated_measures(&case.people).expect(&case.name);
            let ours = [
                ours.f,
                ours.df_conditions,
                ours.df_error,
                ours.p,
                ours.epsilon,
                ours.p_corrected,
                ours.partial_eta_squared,
            ];
            for (i, (ours, theirs)) in ours.iter().zip(case.anova).enumerate() {
                assert_near(*ours, theirs, &format!("{}: number {i}", case.name));
            }
            let column = |j: usize| -> Vec<f64> { case.people.iter().map(|row| row[j]).collect() };
            for pair in &case.pairs {
                let what = format!("{}: {} and {}", case.name, pair.a, pair.b);
                let ours =
                    paired_t(&column(pair.a), &column(pair.b), case.pairs.len()).expect(&what);
                assert_near(ours.t, pair.t, &what);
                assert_near(ours.p, pair.p, &what);
                assert_near(ours.p_adjusted, pair.p_bonferroni, &what);
                let Interval { mean, low, high } = ours.difference;
                for (ours, theirs) in [mean, low, high].into_iter().zip(pair.difference) {
                    assert!(
                        (ours - theirs).abs() < 1e-6 * (1.0 + theirs.abs()),
                        "{what}: {ours} and {theirs}"
                    );
                }
            }
            for (j, theirs) in case.intervals.iter().enumerate() {
                let Interval { mean, low, high } = over_people(&column(j));
                for (ours, theirs) in [mean, low, high].into_iter().zip(theirs) {
                    assert!(
                        (ours - theirs).abs() < 1e-6 * (1.0 + theirs.abs()),
                        "{}: interval {j}",
                        case.name
                    );
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_tested_says_so() {
        assert!(matches!(
            repeated_measures(&[vec![1.0, 2.0]]),
            Err(TestError::TooFew { .. })
        ));
        assert_eq!(
            repeated_measures(&[vec![1.0, 2.0], vec![1.0]]),
            Err(TestError::Missing(1))
        );
        assert_eq!(
            repeated_measures(&[vec![0.1, 0.4], vec![0.3, 0.6]]),
            Err(TestError::NoError)
        );
        let same = paired_t(&[1.0, 2.0], &[1.0, 2.0], 3).expect("two people");
        assert_eq!((same.t, same.p_adjusted), (0.0, 1.0));
        let apart = paired_t(&[1.0, 2.0], &[2.0, 3.0], 3).expect("two people");
        assert_eq!((apart.t, apart.p_adjusted), (f64::NEG_INFINITY, 0.0));
    }
}
