//! What the highway study found: conditions with intervals over people, tests within people, plots, and the paper's claims
//! (g) and (h).

mod claims;

use crate::anova::{Anova, PairedT, paired_t, repeated_measures};
use crate::drive::Condition;
use crate::plot::{Bars, bars};
use crate::results::{Claim, claims_table, link, probability, with_interval};
use crate::statistics::{Interval, over_people, share};
use crate::table::write_json;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;

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

    /// Writes `drive.json`, `drive.svg` and `drive.png`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        write_json(&out.join("drive.json"), self)?;
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
mod tests;
