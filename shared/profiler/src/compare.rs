//! `--against FILE`: what became slower or faster since an older profile, and what does not exceed the noise.
//!
//! The rule. Every figure of a profile is cut, in the order of time, into twenty blocks of equal length, and each block
//! has its median and, where it has samples enough, its 99th percentile. Neighbouring steps resemble each other, blocks
//! hardly do. The blocks of the two profiles are compared by their ranks (Mann–Whitney, two-sided, with the normal
//! approximation and the correction for ties); the p-values of all figures together are held against 5 % by Holm's
//! procedure. What passes *and* differs by 2 % or more is called slower or faster; everything else is within the noise.
//! Ranks within two runs cannot see what differs between runs of the same program, such as another load of the machine:
//! the conditions of both profiles are printed above the table.

use crate::metrics::Metric;
use crate::result::{Measured, Profile, SCHEMA};
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Chance of one false word in a whole comparison.
const ERROR: f64 = 0.05;
/// Differences below this are not called any.
const LEAST: f64 = 0.02;
/// Blocks that a side needs.
const FEWEST: usize = 8;

/// What of an older profile is compared.
#[derive(Clone, Debug, Deserialize)]
pub struct Older {
    /// Under which conditions it was measured.
    pub measured: Measured,
    /// Its figures.
    pub metrics: BTreeMap<String, Metric>,
}

/// Reads an older profile.
///
/// # Errors
/// Names the file, and what about it cannot be used.
pub fn read(path: &Path) -> Result<Older> {
    #[derive(Deserialize)]
    struct Version {
        schema: String,
    }
    let text =
        std::fs::read_to_string(path).with_context(|| format!("--against {}", path.display()))?;
    let place = || format!("--against {}: no profile", path.display());
    let Version { schema } = serde_json::from_str(&text).with_context(place)?;
    if schema != SCHEMA {
        bail!(
            "--against {}: is of schema {schema:?}, this program reads {SCHEMA:?}",
            path.display()
        );
    }
    serde_json::from_str(&text).with_context(place)
}

/// How a figure changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeVerdict {
    /// Beyond the noise, and longer.
    Slower,
    /// Beyond the noise, and shorter.
    Faster,
    /// Not beyond the noise.
    Same,
    /// Too few samples to tell.
    Unknown,
}

/// A figure of both profiles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// The figure, and which of its percentiles.
    pub figure: String,
    /// Then, in ns.
    pub before: u64,
    /// Now, in ns.
    pub after: u64,
    /// Now over then.
    pub ratio: f64,
    /// Of the rank test, before Holm's procedure; 1 where there are too few blocks.
    pub p: f64,
    /// What that means.
    pub verdict: ChangeVerdict,
}

/// Compares the figures that both have, most changed first.
pub fn compare(before: &Older, after: &Profile) -> Vec<Change> {
    let mut changes = Vec::new();
    for (name, new) in &after.metrics {
        let Some(old) = before.metrics.get(name) else {
            continue;
        };
        for (percentile, was, is, old, new) in [
            ("p50", old.p50, new.p50, &old.block_p50, &new.block_p50),
            ("p99", old.p99, new.p99, &old.block_p99, &new.block_p99),
        ] {
            let enough = old.len().min(new.len()) >= FEWEST;
            changes.push(Change {
                figure: format!("{name} {percentile}"),
                before: was,
                after: is,
                ratio: is as f64 / (was as f64).max(1.0),
                p: if enough { rank_test(old, new) } else { 1.0 },
                verdict: match enough {
                    true => ChangeVerdict::Same,
                    false => ChangeVerdict::Unknown,
                },
            });
        }
    }
    judge(&mut changes);
    let size = |change: &Change| change.ratio.max(1e-9).ln().abs();
    changes.sort_by(|a, b| size(b).total_cmp(&size(a)).then(a.figure.cmp(&b.figure)));
    changes
}

/// Holm's procedure over all changes with a test.
fn judge(changes: &mut [Change]) {
    let mut tested: Vec<usize> = (0..changes.len())
        .filter(|place| changes[*place].verdict != ChangeVerdict::Unknown)
        .collect();
    tested.sort_by(|a, b| changes[*a].p.total_cmp(&changes[*b].p));
    let count = tested.len();
    for (rank, place) in tested.into_iter().enumerate() {
        let change = &mut changes[place];
        if change.p > ERROR / (count - rank) as f64 {
            break;
        }
        if (change.ratio - 1.0).abs() >= LEAST {
            change.verdict = match change.ratio > 1.0 {
                true => ChangeVerdict::Slower,
                false => ChangeVerdict::Faster,
            };
        }
    }
}

/// Mann–Whitney: the chance that samples of one origin have rank sums at least so different.
fn rank_test(a: &[u64], b: &[u64]) -> f64 {
    let mut all: Vec<(u64, bool)> = a.iter().map(|value| (*value, true)).collect();
    all.extend(b.iter().map(|value| (*value, false)));
    all.sort_unstable();
    let (n, m) = (a.len() as f64, b.len() as f64);
    let total = n + m;
    let (mut rank_sum, mut ties) = (0.0, 0.0);
    let mut from = 0;
    while from < all.len() {
        let equal = all[from..]
            .iter()
            .take_while(|(value, _)| *value == all[from].0);
        let to = from + equal.count();
        let tied = (to - from) as f64;
        let rank = (from + 1 + to) as f64 / 2.0;
        let ours = all[from..to].iter().filter(|(_, is_a)| *is_a).count();
        rank_sum += rank * ours as f64;
        ties += tied * (tied * tied - 1.0);
        from = to;
    }
    let u = rank_sum - n * (n + 1.0) / 2.0;
    let mean = n * m / 2.0;
    let variance = n * m / 12.0 * (total + 1.0 - ties / (total * (total - 1.0)));
    if variance <= 0.0 {
        return 1.0;
    }
    // Half a rank for a step function's approximation by a smooth one.
    let z = ((u - mean).abs() - 0.5).max(0.0) / variance.sqrt();
    complementary_error(z / std::f64::consts::SQRT_2).min(1.0)
}

/// erfc for z ≥ 0, by its continued fraction for large z and its series for small (Abramowitz & Stegun 7.1.5, 7.1.14).
fn complementary_error(z: f64) -> f64 {
    let scale = (-z * z).exp() / std::f64::consts::PI.sqrt();
    if z < 2.0 {
        let (mut term, mut sum) = (z, z);
        for n in 1..100 {
            term *= 2.0 * z * z / (2 * n + 1) as f64;
            sum += term;
        }
        return 1.0 - 2.0 * scale * sum;
    }
    let mut fraction = z;
    for n in (1..=60).rev() {
        fraction = z + n as f64 / 2.0 / fraction;
    }
    scale / fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_function_is_that_of_tables() {
        for (z, expected) in [
            (0.0, 1.0),
            (0.5, 0.479_500_122_186_953),
            (1.5, 0.033_894_853_524_689),
            (2.5, 4.069_520_174_449_6e-4),
            (4.0, 1.541_725_790_028e-8),
        ] {
            let got = complementary_error(z);
            assert!((got / expected - 1.0).abs() < 1e-9, "{z}: {got}");
        }
    }

    #[test]
    fn the_rank_test_agrees_with_scipy() {
        // scipy.stats.mannwhitneyu(a, b, method="asymptotic") with and without ties.
        let a = [10, 12, 14, 16, 18, 20, 22, 24];
        let b = [11, 13, 19, 21, 23, 25, 27, 29];
        assert!(
            (rank_test(&a, &b) - SCIPY[0]).abs() < 1e-9,
            "{}",
            rank_test(&a, &b)
        );
        let c = [10, 10, 12, 12, 12, 13, 14, 15];
        let d = [12, 13, 14, 15, 15, 16, 16, 17];
        assert!(
            (rank_test(&c, &d) - SCIPY[1]).abs() < 1e-9,
            "{}",
            rank_test(&c, &d)
        );
        assert_eq!(rank_test(&[5; 8], &[5; 8]), 1.0);
    }

    const SCIPY: [f64; 2] = [0.189_262_963_315_025_46, 0.019_198_061_936_870_92];

    fn change(p: f64, ratio: f64) -> Change {
        Change {
            figure: String::new(),
            before: 1,
            after: 1,
            ratio,
            p,
            verdict: ChangeVerdict::Same,
        }
    }

    #[test]
    fn holm_holds_all_figures_together_against_the_noise() {
        let mut changes = [
            change(0.001, 1.5),
            change(0.03, 0.5),
            change(0.02, 1.3),
            change(0.0001, 1.001),
        ];
        judge(&mut changes);
        let verdicts = changes.map(|change| change.verdict);
        // 0.0001 ≤ 0.05/4, but by a thousandth; 0.001 ≤ 0.05/3; 0.02 ≤ 0.05/2; 0.03 ≤ 0.05.
        use ChangeVerdict::{Faster, Same, Slower};
        assert_eq!(verdicts, [Slower, Faster, Slower, Same]);
        let mut one = [change(0.03, 2.0), change(0.04, 2.0)];
        judge(&mut one);
        assert_eq!(one.map(|change| change.verdict), [Same, Same]);
    }
}
