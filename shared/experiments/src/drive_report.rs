//! What the highway study found: conditions with intervals over people, tests within people, plots, and the paper's claims
//! (g) and (h).

use crate::anova::{Anova, PairedT, paired_t, repeated_measures};
use crate::drive::Condition;
use crate::plot::{Bars, bars};
use crate::results::{Claim, Verdict, claims_table, link, probability, with_interval};
use crate::statistics::{Interval, over_people, share};
use anyhow::Context;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;

/// How many times as much counts as "several times".
const SEVERAL: f64 = 3.0;

/// What is measured of a person under a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Share of rounds with a collision.
    Collisions,
    /// Seconds with a highlight, per minute.
    HighlightedS,
    /// Utterances per minute.
    Utterances,
    /// Mean reward of a round.
    Reward,
}

impl Measure {
    /// Every measure.
    pub const ALL: [Self; 4] = [
        Self::Collisions,
        Self::HighlightedS,
        Self::Utterances,
        Self::Reward,
    ];

    /// For people, with its unit; and the factor that brings it there.
    const fn title(self) -> (&'static str, f64) {
        match self {
            Self::Collisions => ("collisions (% of rounds)", 100.0),
            Self::HighlightedS => ("highlighting (s per minute)", 1.0),
            Self::Utterances => ("utterances per minute", 1.0),
            Self::Reward => ("reward of a round", 1.0),
        }
    }
}

/// A condition's results over all people.
#[derive(Clone, Debug, Serialize)]
pub struct ConditionSummary {
    /// Condition.
    pub condition: &'static str,
    /// Rounds.
    pub rounds: usize,
    /// Share of rounds with a collision, interval over people.
    pub collisions: Interval,
    /// The same with Wilson's interval over rounds.
    pub collisions_by_round: Interval,
    /// Mean reward of a round, interval over people.
    pub reward: Interval,
    /// Highlighted sectors that show a car, per minute.
    pub visual_per_minute: Interval,
    /// Seconds with a highlight per minute.
    pub highlighted_s_per_minute: Interval,
    /// Utterances per minute.
    pub utterances_per_minute: Interval,
    /// Communication cost of a round.
    pub cost: Interval,
}

/// Tests of one measure within people.
#[derive(Clone, Debug, Serialize)]
pub struct Tests {
    /// What was measured.
    pub measure: Measure,
    /// Over all of [`Report::compared`]; none where nothing varies.
    pub anova: Option<Anova>,
    /// MIRROR against each other condition, adjusted for their number: what it was compared with, and mirror − other.
    pub pairs: Vec<(&'static str, PairedT)>,
}

/// What the study found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Per condition.
    pub conditions: Vec<ConditionSummary>,
    /// Conditions in fog that are compared with each other, by person: the paper's four, as far as they were run.
    pub compared: Vec<&'static str>,
    /// Tests over these.
    pub tests: Vec<Tests>,
    /// The paper's claims that the conditions allow to judge.
    pub claims: Vec<Claim>,
    #[serde(skip)]
    people: usize,
}

/// Rows of one person under one condition.
type Rows<'a> = Vec<&'a Vec<String>>;

fn number(row: &[String], column: usize) -> f64 {
    row.get(column)
        .and_then(|cell| cell.parse().ok())
        .unwrap_or(f64::NAN)
}

fn mean(rows: &Rows, column: usize) -> f64 {
    rows.iter().map(|row| number(row, column)).sum::<f64>() / rows.len().max(1) as f64
}

fn per_minute(rows: &Rows, column: usize, unit: f64, step_s: f64) -> f64 {
    let sum = |column| rows.iter().map(|row| number(row, column)).sum::<f64>();
    sum(column) * unit / (sum(4) * step_s / 60.0).max(1e-9)
}

fn measured(measure: Measure, rows: &Rows, step_s: f64) -> f64 {
    match measure {
        Measure::Collisions => mean(rows, 5),
        Measure::HighlightedS => per_minute(rows, 8, step_s, step_s),
        Measure::Utterances => per_minute(rows, 9, 1.0, step_s),
        Measure::Reward => mean(rows, 6),
    }
}

impl Report {
    /// Sums up the rows of `drive.csv` of persons 1 to `people`.
    pub fn new(conditions: &[Condition], people: u32, rows: &[Vec<String>], step_s: f64) -> Self {
        let of = |condition: Condition, person: u32| -> Rows<'_> {
            let person = person.to_string();
            rows.iter()
                .filter(|row| row[0] == condition.name() && row[1] == person)
                .collect()
        };
        let summaries = conditions
            .iter()
            .map(|&condition| {
                let persons: Vec<Rows> = (1..=people).map(|id| of(condition, id)).collect();
                summarise(condition, &persons, step_s)
            })
            .collect();
        let compared: Vec<Condition> = [
            Condition::Silent,
            Condition::Bc,
            Condition::Sqil,
            Condition::Mirror,
            Condition::MirrorKl,
        ]
        .into_iter()
        .filter(|condition| conditions.contains(condition))
        .collect();
        let tests: Vec<Tests> = Measure::ALL
            .into_iter()
            .map(|measure| {
                // Who says nothing has nothing to compare: in what was said, only the others are.
                let speaks = |c: &&Condition| {
                    !matches!(measure, Measure::HighlightedS | Measure::Utterances)
                        || c.human().is_some()
                };
                let compared: Vec<Condition> = compared.iter().filter(speaks).copied().collect();
                let table: Vec<Vec<f64>> = (1..=people)
                    .map(|id| {
                        let value = |c: &Condition| measured(measure, &of(*c, id), step_s);
                        compared.iter().map(value).collect()
                    })
                    .collect();
                test(measure, &compared, &table)
            })
            .collect();
        let mut report = Self {
            conditions: summaries,
            compared: compared.iter().map(|c| c.name()).collect(),
            tests,
            claims: Vec::new(),
            people: people as usize,
        };
        report.claims = report.judge();
        report
    }

    fn condition(&self, condition: Condition) -> Option<&ConditionSummary> {
        let name = condition.name();
        self.conditions.iter().find(|c| c.condition == name)
    }

    fn pair(&self, measure: Measure, other: Condition) -> Option<&PairedT> {
        let tests = self.tests.iter().find(|t| t.measure == measure)?;
        let pair = tests.pairs.iter().find(|(name, _)| *name == other.name())?;
        Some(&pair.1)
    }

    /// Claims (g) and (h), where their conditions were run.
    fn judge(&self) -> Vec<Claim> {
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

    /// Writes `drive.json`, `drive.svg` and `drive.png`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        let path = out.join("drive.json");
        std::fs::write(&path, serde_json::to_string_pretty(self)?)
            .with_context(|| path.display().to_string())?;
        let panel = |measure: Measure| {
            let (title, factor) = measure.title();
            let bar = |c: &ConditionSummary| {
                let Interval { mean, low, high } = *c.of(measure);
                let scaled = Interval {
                    mean: mean * factor,
                    low: low * factor,
                    high: high * factor,
                };
                (c.condition.to_owned(), scaled)
            };
            // Speaking all the time would flatten all the others.
            let shown = |c: &&ConditionSummary| {
                measure == Measure::Collisions
                    || measure == Measure::Reward
                    || c.condition != Condition::Everything.name()
            };
            Bars {
                title: title.to_owned(),
                bars: self.conditions.iter().filter(shown).map(bar).collect(),
            }
        };
        bars(&Measure::ALL.map(panel), &out.join("drive"))
    }

    /// The study's section of RESULTS.md. `command` made it; `note` says what was special about the run.
    pub fn section(&self, results: &Path, out: &Path, command: &str, note: &str) -> String {
        let mut text = format!(
            "`{command}`: {} simulated people, six cases each, within subjects; intervals over people. {note}\n\n",
            self.people
        );
        if !self.claims.is_empty() {
            text.push_str(&claims_table(&self.claims));
            text.push('\n');
        }
        text.push_str("| condition | rounds | collisions (%) | highlighting (s/min) | utterances/min | reward |\n| --- | --- | --- | --- | --- | --- |\n");
        for c in &self.conditions {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} |",
                c.condition,
                c.rounds,
                with_interval(&c.collisions, 100.0, 1),
                with_interval(&c.highlighted_s_per_minute, 1.0, 1),
                with_interval(&c.utterances_per_minute, 1.0, 1),
                with_interval(&c.reward, 1.0, 1),
            );
        }
        let _ = writeln!(
            text,
            "\nRepeated-measures one-way ANOVA over {}, p corrected after Greenhouse and Geisser, and paired t-tests of MIRROR against each, p adjusted after Bonferroni:\n",
            self.compared.join(", ")
        );
        for tests in &self.tests {
            let _ = writeln!(text, "- {}", tests.sentence());
        }
        let plot = |extension| link(results, &out.join("drive").with_extension(extension));
        let _ = writeln!(
            text,
            "\n![collisions and communication]({})\n\n([PNG]({}), [rounds]({}))",
            plot("svg"),
            plot("png"),
            link(results, &out.join("drive.csv")),
        );
        text
    }
}

impl Tests {
    /// Both tests in words.
    pub fn sentence(&self) -> String {
        let mut text = self.measure.title().0.to_owned();
        match &self.anova {
            None => text.push_str(": nothing to analyse"),
            Some(a) => {
                let _ = write!(
                    text,
                    ": F({:.0}, {:.0}) = {:.2}, ε = {:.2}, {}, partial η² = {:.2}",
                    a.df_conditions,
                    a.df_error,
                    a.f,
                    a.epsilon,
                    probability(a.p_corrected),
                    a.partial_eta_squared
                );
            }
        }
        let factor = self.measure.title().1;
        for (other, pair) in &self.pairs {
            let _ = write!(
                text,
                "; mirror − {other}: {}, t({:.0}) = {:.2}, {}",
                with_interval(&pair.difference, factor, 1),
                pair.df,
                pair.t,
                probability(pair.p_adjusted)
            );
        }
        text
    }
}

impl ConditionSummary {
    fn of(&self, measure: Measure) -> &Interval {
        match measure {
            Measure::Collisions => &self.collisions,
            Measure::HighlightedS => &self.highlighted_s_per_minute,
            Measure::Utterances => &self.utterances_per_minute,
            Measure::Reward => &self.reward,
        }
    }
}

/// `table[i][j]`: person i under `compared[j]`.
fn test(measure: Measure, compared: &[Condition], table: &[Vec<f64>]) -> Tests {
    let column = |j: usize| -> Vec<f64> { table.iter().map(|row| row[j]).collect() };
    let mirror = compared.iter().position(|c| *c == Condition::Mirror);
    let pairs = mirror.map_or(Vec::new(), |mirror| {
        let others = (0..compared.len()).filter(|j| *j != mirror);
        others
            .filter_map(|j| {
                let pair = paired_t(&column(mirror), &column(j), compared.len() - 1).ok()?;
                Some((compared[j].name(), pair))
            })
            .collect()
    });
    Tests {
        measure,
        anova: repeated_measures(table).ok(),
        pairs,
    }
}

fn summarise(condition: Condition, persons: &[Rows], step_s: f64) -> ConditionSummary {
    let over = |value: &dyn Fn(&Rows) -> f64| -> Interval {
        let values: Vec<f64> = persons
            .iter()
            .filter(|rows| !rows.is_empty())
            .map(value)
            .collect();
        over_people(&values)
    };
    let measure = |m: Measure| over(&|rows| measured(m, rows, step_s));
    let all = || persons.iter().flatten();
    let rounds = all().count();
    let hits = all().filter(|row| row[5] == "1").count();
    ConditionSummary {
        condition: condition.name(),
        rounds,
        collisions: measure(Measure::Collisions),
        collisions_by_round: share(hits, rounds),
        reward: measure(Measure::Reward),
        visual_per_minute: over(&|rows| per_minute(rows, 7, 1.0, step_s)),
        highlighted_s_per_minute: measure(Measure::HighlightedS),
        utterances_per_minute: measure(Measure::Utterances),
        cost: over(&|rows| mean(rows, 10)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of four people: collisions by condition and case, highlighted steps, utterances.
    fn rows(of: &[(Condition, [u32; 4], u32, u32)]) -> Vec<Vec<String>> {
        let mut rows = Vec::new();
        for (condition, hits, highlighted, utterances) in of {
            for person in 1..=4_u32 {
                for case in 1..=6_u32 {
                    let hit = u32::from(case <= hits[person as usize - 1]);
                    // Nobody is told exactly as much as anybody else.
                    let more = person + case;
                    let row = format!(
                        "{},{person},1,{case},100,{hit},{},3,{},{},0.5",
                        condition.name(),
                        150 - 100 * hit + person,
                        highlighted * more / 8,
                        utterances * more / 8,
                    );
                    rows.push(row.split(',').map(str::to_owned).collect());
                }
            }
        }
        rows
    }

    const FOUR: [Condition; 4] = [
        Condition::Silent,
        Condition::Bc,
        Condition::Mirror,
        Condition::MirrorKl,
    ];

    fn report(mirror: [u32; 4], kl: ([u32; 4], u32, u32)) -> Report {
        let rows = rows(&[
            (Condition::Silent, [5, 5, 6, 6], 0, 0),
            (Condition::Bc, [5, 6, 5, 6], 16, 16),
            (Condition::Mirror, mirror, 8, 8),
            (Condition::MirrorKl, kl.0, kl.1, kl.2),
        ]);
        Report::new(&FOUR, 4, &rows, 0.15)
    }

    fn verdicts(report: &Report) -> Vec<(char, Verdict)> {
        report
            .claims
            .iter()
            .map(|c| (c.letter, c.verdict))
            .collect()
    }

    #[test]
    fn claims_follow_from_the_rows() {
        let as_in_the_paper = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
        assert_eq!(
            verdicts(&as_in_the_paper),
            [('g', Verdict::Reproduced), ('h', Verdict::Reproduced)]
        );
        // No better than the others, and belief matching both safer and, on one channel, quieter.
        let otherwise = report([5, 5, 6, 6], ([0, 0, 1, 0], 8, 64));
        assert_eq!(
            verdicts(&otherwise),
            [('g', Verdict::Not), ('h', Verdict::Partly)]
        );
    }

    #[test]
    fn numbers_are_per_person_and_minute() {
        let report = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
        let mirror = report.condition(Condition::Mirror).expect("was run");
        assert_eq!(mirror.rounds, 24);
        assert!((mirror.collisions.mean - 2.0 / 24.0).abs() < 1e-12);
        // Person p is told p + c times in case c, in rounds of 15 s: (6 p + 21) / 1.5 min.
        let expected = (1..=4).map(|p| f64::from(6 * p + 21) / 1.5).sum::<f64>() / 4.0;
        assert!((mirror.utterances_per_minute.mean - expected).abs() < 1e-9);
        assert!((mirror.highlighted_s_per_minute.mean - 0.15 * expected).abs() < 1e-9);
        let utterances = &report.tests[2];
        assert_eq!(
            utterances.pairs.len(),
            2,
            "silence is not compared in what it says"
        );
        assert_eq!(report.tests[0].pairs.len(), 3);
    }

    #[test]
    fn section_and_plots_are_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let report = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
        report.write(folder.path()).expect("written");
        for file in ["drive.json", "drive.svg", "drive.png"] {
            assert!(folder.path().join(file).exists(), "{file}");
        }
        let file = folder.path().join("RESULTS.md");
        let text = report.section(&file, folder.path(), "mirror evaluate drive", "A test.");
        for part in [
            "| (g) |",
            "| (h) |",
            "F(3, 9)",
            "mirror − silent",
            "(drive.svg)",
            "| mirror-kl | 24 |",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
    }
}
