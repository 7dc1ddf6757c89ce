//! What the study `communicate` found: performance and amount of communication with intervals over people, differences within
//! people, plots, and the paper's claims (b) to (e).

use super::communicate::{Condition, Study};
use super::subject::rounds_of;
use super::title;
use super::units::{Done, by_person, number};
use crate::anova::{PairedT, paired_t};
use crate::plot::{Bars, bars};
use crate::results::{Claim, Verdict, claims_table, link, probability, ruled, with_interval};
use crate::statistics::{Interval, over_people};
use crate::table::write_json;
use domains::discrete::Domain;
use models::Kind;
use planning::Method;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;

/// Columns of the table that are measured, their names with units, and the factor that brings them there.
const MEASURES: [(usize, &str, f64); 8] = [
    (6, "reward of a round", 1.0),
    (7, "success (% of rounds)", 100.0),
    (5, "steps of a round", 1.0),
    (8, "collisions of a round", 1.0),
    (9, "visual items a round", 1.0),
    (10, "verbal items a round", 1.0),
    (11, "communication cost a round", 1.0),
    (12, "surprise (nats a step)", 1.0),
];
const REWARD: usize = 0;
const VERBAL: usize = 5;
const COST: usize = 6;
/// Measures that are drawn.
const DRAWN: [usize; 4] = [REWARD, 1, 4, VERBAL];

/// (c): amounts of communication within this factor are close.
const CLOSE: f64 = 2.0;
/// (d): the share of the gain over NC that 4 rounds have to keep.
const KEPT: f64 = 0.8;
/// (e): slightly better is up to this much reward: the paper's two steps at 0.1 each.
const SLIGHTLY: f64 = 0.2;
/// (e): far more is at least this many times as much, as for claim (h).
const FAR_MORE: f64 = 3.0;

/// One condition.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Condition.
    pub condition: &'static str,
    /// Percentage of the 20 rounds that its model learned from; 0 where none is learned.
    pub percent: u32,
    /// Rounds lived.
    pub rounds: usize,
    /// In the order of the measures: reward, success, steps, collisions, visual and verbal items, cost, surprise.
    pub measures: Vec<Interval>,
    /// Reward less that of NC, within people, adjusted for the number of conditions.
    pub than_silent: Option<PairedT>,
    /// Reward less that of MIRROR from all rounds.
    pub than_mirror: Option<PairedT>,
    /// Per measure and person.
    #[serde(skip)]
    pub people: Vec<Vec<f64>>,
}

impl Summary {
    fn label(&self) -> String {
        match self.percent {
            0 => self.condition.to_owned(),
            percent => format!("{} {}", self.condition, rounds_of(percent)),
        }
    }
}

/// What the study found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Domain.
    pub domain: &'static str,
    /// People and seeds.
    pub people: u32,
    /// See `people`.
    pub seeds: u64,
    /// Rounds a person, seed and condition.
    pub rounds: u32,
    /// How the assistants planned.
    pub planner: String,
    /// Names of the measures.
    pub measures: Vec<&'static str>,
    /// Conditions.
    pub conditions: Vec<Summary>,
    /// Claims.
    pub claims: Vec<Claim>,
    /// Seconds, summed over the cores.
    pub work_s: f64,
    #[serde(skip)]
    which: Domain,
    #[serde(skip)]
    name: String,
}

impl Report {
    pub(super) fn new(study: &Study, done: &Done) -> Self {
        let common = study.common;
        let mut conditions = Vec::new();
        for &condition in &study.conditions {
            let percents: &[u32] = match condition.learns() {
                true => &study.percents,
                false => &[0],
            };
            for &percent in percents {
                let cell = percent.to_string();
                let within = |row: &&Vec<String>| {
                    common.has(number(row, 2), number(row, 3))
                        && number(row, 4) < f64::from(study.rounds)
                };
                let rows: Vec<&Vec<String>> = done
                    .rows
                    .iter()
                    .filter(|row| row[0] == condition.name() && row[1] == cell)
                    .filter(within)
                    .collect();
                let people: Vec<Vec<f64>> = MEASURES
                    .iter()
                    .map(|(column, ..)| by_person(&rows, 2, &|row| number(row, *column)))
                    .collect();
                conditions.push(Summary {
                    condition: condition.name(),
                    percent,
                    rounds: rows.len(),
                    measures: people.iter().map(|values| over_people(values)).collect(),
                    than_silent: None,
                    than_mirror: None,
                    people,
                });
            }
        }
        let mut report = Self {
            domain: common.domain.name(),
            people: common.people,
            seeds: common.seeds,
            rounds: study.rounds,
            planner: match study.method {
                Method::Race => format!(
                    "`race`, on at most {} futures of a candidate",
                    study.settings.race.futures
                ),
                Method::Ce => format!("`ce`, with {} imagined futures", study.settings.samples),
                Method::Kl => "`kl`".to_owned(),
            },
            measures: MEASURES.map(|(_, name, _)| name).to_vec(),
            conditions,
            claims: Vec::new(),
            work_s: done.work_s,
            which: common.domain,
            name: common.name("communicate"),
        };
        report.compare(study);
        report.judge(study);
        report
    }

    fn compare(&mut self, study: &Study) {
        let most = study.percents.iter().copied().max().unwrap_or_default();
        let reward = |condition: Condition, percent| {
            let of = |s: &&Summary| s.condition == condition.name() && s.percent == percent;
            let summary = self.conditions.iter().find(of)?;
            Some(summary.people[REWARD].clone())
        };
        let silent = reward(Condition::Silent, 0);
        let mirror = reward(Condition::Model(Kind::Mirror), most);
        let tests = self.conditions.len().saturating_sub(1);
        for summary in &mut self.conditions {
            let than = |other: &Option<Vec<f64>>| {
                let other = other.as_ref()?;
                paired_t(&summary.people[REWARD], other, tests).ok()
            };
            (summary.than_silent, summary.than_mirror) = (than(&silent), than(&mirror));
        }
    }

    fn of(&self, condition: Condition, percent: u32) -> Option<&Summary> {
        let name = condition.name();
        self.conditions
            .iter()
            .find(|s| s.condition == name && s.percent == percent)
    }

    fn judge(&mut self, study: &Study) {
        let (Some(&most), Some(&least)) =
            (study.percents.iter().max(), study.percents.iter().min())
        else {
            return;
        };
        let claims = [
            self.helps(most),
            self.is_best(most),
            self.few_suffice(least, most),
            self.speaks_more(most),
        ];
        self.claims.extend(claims.into_iter().flatten());
    }

    /// (b) Every assistant that communicates beats NC.
    fn helps(&self, most: u32) -> Option<Claim> {
        let silent = self.of(Condition::Silent, 0)?;
        let kinds = [Kind::Mirror, Kind::MirrorP, Kind::Bc, Kind::Sqil];
        let assistants = std::iter::once(self.of(Condition::Ideal, 0))
            .chain(kinds.map(|kind| self.of(Condition::Model(kind), most)))
            .flatten();
        let (mut parts, mut ours) = (Vec::new(), String::new());
        let nc = with_interval(&silent.measures[REWARD], 1.0, 2);
        let _ = write!(ours, "reward of NC {nc}; gain over it: ");
        for summary in assistants {
            let gain = summary.than_silent.as_ref();
            parts.push(gain.is_some_and(|g| g.difference.mean > 0.0 && g.is_significant()));
            let word = gain.map_or("no difference".to_owned(), |gain| {
                format!(
                    "{} ({})",
                    with_interval(&gain.difference, 1.0, 2),
                    probability(gain.p_adjusted)
                )
            });
            let _ = write!(ours, "{} {word}, ", summary.condition);
        }
        (!parts.is_empty()).then(|| Claim {
            letter: 'b',
            claim: "every assistant that communicates beats NC".to_owned(),
            ours: ruled(
                &format!(
                    "each, learned from {} rounds, gains reward over NC at an adjusted 5 %",
                    rounds_of(most)
                ),
                &ours,
            ),
            verdict: Verdict::of(&parts),
        })
    }

    /// (c) In driving and bomb defusal MIRROR's assistance is best of the learned models, with an amount close to IM's.
    fn is_best(&self, most: u32) -> Option<Claim> {
        if self.which == Domain::SearchRescue {
            return None;
        }
        let of = |kind| self.of(Condition::Model(kind), most);
        let (mirror, bc, sqil) = (of(Kind::Mirror)?, of(Kind::Bc)?, of(Kind::Sqil)?);
        let ideal = self.of(Condition::Ideal, 0)?;
        let better = |other: &Summary| {
            let pair = other.than_mirror.as_ref();
            pair.is_some_and(|pair| pair.difference.mean < 0.0 && pair.is_significant())
        };
        let mean = |s: &Summary, measure: usize| s.measures[measure].mean;
        let best = [bc, sqil]
            .iter()
            .all(|other| mean(mirror, REWARD) > mean(other, REWARD));
        let ratio = mean(mirror, COST) / mean(ideal, COST).max(1e-9);
        let close = (1.0 / CLOSE..=CLOSE).contains(&ratio);
        let cell = |s: &Summary, measure: usize| with_interval(&s.measures[measure], 1.0, 2);
        let p = |s: &Summary| {
            s.than_mirror
                .as_ref()
                .map_or(String::new(), |pair| probability(pair.p_adjusted))
        };
        Some(Claim {
            letter: 'c',
            claim: "in driving and bomb defusal MIRROR's assistance gives the best performance of the learned models, with an amount of communication close to the ideal model's".to_owned(),
            ours: ruled(
                &format!("MIRROR's mean is highest of MIRROR, BC and SQIL; higher than BC's, and than SQIL's, at an adjusted 5 %; its cost within a factor of {CLOSE} of the ideal model's"),
                &format!(
                "reward: MIRROR {}, BC {} ({}), SQIL {} ({}); cost of communication a round: MIRROR {}, ideal {} ({ratio:.1} times)",
                cell(mirror, REWARD),
                cell(bc, REWARD),
                p(bc),
                cell(sqil, REWARD),
                p(sqil),
                cell(mirror, COST),
                cell(ideal, COST),
            )),
            verdict: Verdict::of(&[best, better(bc), better(sqil), close]),
        })
    }

    /// (d) Four rounds suffice.
    fn few_suffice(&self, least: u32, most: u32) -> Option<Claim> {
        if least == most {
            return None;
        }
        let mirror = Condition::Model(Kind::Mirror);
        let (few, all) = (self.of(mirror, least)?, self.of(mirror, most)?);
        let silent = self.of(Condition::Silent, 0)?;
        let gain = |s: &Summary| s.measures[REWARD].mean - silent.measures[REWARD].mean;
        let kept = match gain(all) > 0.0 {
            true => gain(few) / gain(all),
            false => 0.0,
        };
        let pair = paired_t(&few.people[REWARD], &all.people[REWARD], 1).ok();
        let worse = pair
            .as_ref()
            .is_some_and(|pair| pair.difference.mean < 0.0 && pair.is_significant());
        let keeps = gain(all) > 0.0 && kept >= KEPT;
        Some(Claim {
            letter: 'd',
            claim: "4 rounds suffice: performance from 20 % of the data is close to that from all of it".to_owned(),
            ours: ruled(
                &format!("MIRROR keeps at least {:.0} % of a gain over NC, and is not lower at 5 %", 100.0 * KEPT),
                &format!(
                "reward of MIRROR from {} rounds {}, from {} {}{}; {:.0} % of the gain over NC (0 where there is none)",
                rounds_of(least),
                with_interval(&few.measures[REWARD], 1.0, 2),
                rounds_of(most),
                with_interval(&all.measures[REWARD], 1.0, 2),
                pair.map_or(String::new(), |pair| format!(
                    ", difference {} ({})",
                    with_interval(&pair.difference, 1.0, 2),
                    probability(pair.p)
                )),
                100.0 * kept,
            )),
            verdict: Verdict::of(&[keeps, keeps && !worse]),
        })
    }

    /// (e) In search and rescue SQIL is at most slightly better and speaks far more.
    fn speaks_more(&self, most: u32) -> Option<Claim> {
        if self.which != Domain::SearchRescue {
            return None;
        }
        let of = |kind| self.of(Condition::Model(kind), most);
        let (mirror, sqil) = (of(Kind::Mirror)?, of(Kind::Sqil)?);
        let mean = |s: &Summary, measure: usize| s.measures[measure].mean;
        let better = mean(sqil, REWARD) - mean(mirror, REWARD);
        let times = mean(sqil, VERBAL) / mean(mirror, VERBAL).max(1e-9);
        let cell = |s: &Summary, measure: usize| with_interval(&s.measures[measure], 1.0, 2);
        Some(Claim {
            letter: 'e',
            claim: "in search and rescue SQIL is at most slightly better and speaks far more"
                .to_owned(),
            ours: ruled(
                &format!(
                    "SQIL's mean is at most {SLIGHTLY} (two steps) higher; it says at least {FAR_MORE} times as much"
                ),
                &format!(
                    "reward: SQIL {}, MIRROR {}; verbal items a round: SQIL {}, MIRROR {} ({times:.1} times)",
                    cell(sqil, REWARD),
                    cell(mirror, REWARD),
                    cell(sqil, VERBAL),
                    cell(mirror, VERBAL),
                ),
            ),
            verdict: Verdict::of(&[better <= SLIGHTLY, times >= FAR_MORE]),
        })
    }

    /// Writes the report as JSON and draws it.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        write_json(&out.join(format!("{}.json", self.name)), self)?;
        let panel = |measure: usize| {
            let (_, name, factor) = MEASURES[measure];
            let bar = |s: &Summary| {
                let Interval { mean, low, high } = s.measures[measure];
                let scaled = Interval {
                    mean: mean * factor,
                    low: low * factor,
                    high: high * factor,
                };
                (s.label(), scaled)
            };
            // Saying everything would flatten all the others.
            let shown = |s: &&Summary| {
                measure == REWARD || measure == 1 || s.condition != Condition::Everything.name()
            };
            Bars {
                title: format!("{}: {name}", title(self.which)),
                bars: self.conditions.iter().filter(shown).map(bar).collect(),
            }
        };
        bars(&DRAWN.map(panel), &out.join(&self.name))
    }

    /// Lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let head = format!("{:<12} {}", "condition", self.measures.join("   "));
        let line = |s: &Summary| {
            let cells: Vec<String> = s
                .measures
                .iter()
                .zip(MEASURES)
                .map(|(interval, (.., factor))| with_interval(interval, factor, 2))
                .collect();
            format!("{:<12} {}", s.label(), cells.join("   "))
        };
        std::iter::once(head)
            .chain(self.conditions.iter().map(line))
            .collect()
    }

    /// The study's section of RESULTS.md. `command` made it; `note` says what was special about the run.
    pub fn section(&self, results: &Path, out: &Path, command: &str, note: &str) -> String {
        let mut text = format!(
            "`{command}`: the transfer setting, {} simulated people, {} seed(s), {} rounds each under each condition; intervals over people. \
             The number behind a model is how many rounds it learned from (BC and SQIL: from as many of the original setting too). \
             All assistants plan by {}. {:.0} s, summed over the cores. {note}\n\n",
            self.people, self.seeds, self.rounds, self.planner, self.work_s,
        );
        if !self.claims.is_empty() {
            text.push_str(&claims_table(&self.claims));
        }
        text.push_str("\n| condition |");
        for measure in &self.measures {
            let _ = write!(text, " {measure} |");
        }
        text.push_str(" reward − NC | reward − MIRROR |\n| --- |");
        text.push_str(&" --- |".repeat(self.measures.len() + 2));
        for s in &self.conditions {
            let _ = write!(text, "\n| {} |", s.label());
            for (interval, (.., factor)) in s.measures.iter().zip(MEASURES) {
                let _ = write!(text, " {} |", with_interval(interval, factor, 2));
            }
            for pair in [&s.than_silent, &s.than_mirror] {
                let cell = pair.as_ref().map(|pair| {
                    format!(
                        "{}, {}",
                        with_interval(&pair.difference, 1.0, 2),
                        probability(pair.p_adjusted)
                    )
                });
                let _ = write!(text, " {} |", cell.unwrap_or_default());
            }
        }
        let plot = |extension: &str| link(results, &out.join(format!("{}.{extension}", self.name)));
        let _ = writeln!(
            text,
            "\n\nDifferences are within people, their p adjusted after Bonferroni for {} comparisons. Surprise is −log of the probability that the assistant's model gave to what the person did.\n\n\
             ![performance and amount of communication]({})\n\n([PNG]({}), [rounds]({}))",
            self.conditions.len().saturating_sub(1),
            plot("svg"),
            plot("png"),
            plot("csv"),
        );
        text
    }
}
