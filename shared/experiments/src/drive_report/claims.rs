//! The paper's claims (g) and (h) about the highway, judged by what the study found.

use super::{Measure, Report};
use crate::anova::PairedT;
use crate::drive::Condition;
use crate::results::{Claim, Verdict, probability, with_interval};
use crate::statistics::Interval;

/// How many times as much counts as "several times".
const SEVERAL: f64 = 3.0;

impl Report {
    /// Claims (g) and (h), where their conditions were run.
    pub(super) fn judge(&self) -> Vec<Claim> {
        let mut claims = Vec::new();
        let collisions = |condition| self.condition(condition).map(|c| c.collisions);
        let fewer = |pair: &PairedT| pair.difference.mean < 0.0 && pair.is_significant();
        let [silent, bc] = [Condition::Silent, Condition::Bc]
            .map(|other| Some((collisions(other)?, self.pair(Measure::Collisions, other)?)));
        if let (Some(mirror), Some((nc, than_nc)), Some((bc, than_bc))) =
            (collisions(Condition::Mirror), silent, bc)
        {
            claims.push(Claim {
                letter: 'g',
                claim: "on the highway MIRROR has fewer collisions than NC and BC".to_owned(),
                ours: format!(
                    "collisions in % of rounds: MIRROR {}, NC {} ({} adjusted), BC {} ({} adjusted); each part holds if MIRROR's are fewer at an adjusted 5 %",
                    with_interval(&mirror, 100.0, 1),
                    with_interval(&nc, 100.0, 1),
                    probability(than_nc.p_adjusted),
                    with_interval(&bc, 100.0, 1),
                    probability(than_bc.p_adjusted),
                ),
                verdict: Verdict::of(&[fewer(than_nc), fewer(than_bc)]),
            });
        }
        if let (Some(mirror), Some(kl), Some(than_kl)) = (
            self.condition(Condition::Mirror),
            self.condition(Condition::MirrorKl),
            self.pair(Measure::Collisions, Condition::MirrorKl),
        ) {
            let times = |kl: &Interval, mirror: &Interval| kl.mean / mirror.mean.max(1e-9);
            let shown = times(
                &kl.highlighted_s_per_minute,
                &mirror.highlighted_s_per_minute,
            );
            let said = times(&kl.utterances_per_minute, &mirror.utterances_per_minute);
            let kl_is_safer = than_kl.difference.mean > 0.0 && than_kl.is_significant();
            claims.push(Claim {
                letter: 'h',
                claim: "MIRROR-KL communicates several times more than MIRROR without significantly fewer collisions"
                    .to_owned(),
                ours: format!(
                    "highlighting in s per minute: MIRROR-KL {}, MIRROR {} ({shown:.1} times); utterances per minute {} and {} ({said:.1} times); collisions in % of rounds {} and {} ({} adjusted); \"several\" is taken as at least {SEVERAL}",
                    with_interval(&kl.highlighted_s_per_minute, 1.0, 1),
                    with_interval(&mirror.highlighted_s_per_minute, 1.0, 1),
                    with_interval(&kl.utterances_per_minute, 1.0, 1),
                    with_interval(&mirror.utterances_per_minute, 1.0, 1),
                    with_interval(&kl.collisions, 100.0, 1),
                    with_interval(&mirror.collisions, 100.0, 1),
                    probability(than_kl.p_adjusted),
                ),
                verdict: Verdict::of(&[shown >= SEVERAL, said >= SEVERAL, !kl_is_safer]),
            });
        }
        claims
    }
}
