//! `implants` in the gridworlds (the paper's appendix "Learnt perceptual implants"): what MIRROR found of people's sight against
//! what they really see, in both settings.

use super::drawing::{Sketch, draw};
use super::subject::{LEARNING, Place, SplitRounds};
use super::units::{Done, Sheet, Unit, by_person, number, run as run_units};
use super::{Common, title};
use crate::results::{Claim, Verdict, claims_table, link, ruled, with_interval};
use crate::statistics::{Interval, over_people};
use crate::table::write_json;
use domains::Perception;
use domains::discrete::{Domain, Mind, Setting};
use models::{Kind, SelfModel};
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use training::implants::{self, ImplantSettings};
use training::rounds::Rounds;

/// Settings, in the order of rows.
const SETTINGS: [Setting; 2] = [Setting::Original, Setting::Transfer];
/// (f): share of what was there that learned and true limits have to agree on, seen or not seen.
const AGREE: f64 = 0.9;
/// (f): bomb defusal's probabilities are near the real ones within this much, on average.
const NEAR: f64 = 0.05;
/// Share of the probability within an interval.
const INTERVAL: f32 = 0.9;
/// People whose implants are drawn.
const DRAWN: u32 = 5;

/// What to run.
#[derive(Clone, Debug)]
pub struct Study {
    /// Domain, people, seeds.
    pub common: Common,
    /// Rounds to learn from, at most 20.
    pub rounds: usize,
}

/// What a domain's limits are called.
pub fn limit_names(domain: Domain) -> Vec<String> {
    match domain {
        Domain::Driving => ["ahead left", "ahead right", "behind left", "behind right"]
            .map(str::to_owned)
            .to_vec(),
        Domain::SearchRescue => vec!["radius".to_owned()],
        Domain::BombDefusal => (1..=domains::bomb_defusal::TERMINALS)
            .map(|terminal| format!("terminal {terminal}"))
            .collect(),
    }
}

/// In what a domain's limits are measured.
const fn unit(domain: Domain) -> &'static str {
    match domain {
        Domain::BombDefusal => "probability",
        _ => "cells",
    }
}

/// One person in one setting.
struct Piece<'a> {
    study: &'a Study,
    model: &'a Arc<SelfModel>,
    setting: Setting,
    person: u32,
    seed: u64,
}

const HEADER: &str = "setting,person,seed,limit,true,learned,moments,seen,agreed,low,high";

impl Unit for Piece<'_> {
    fn keys(&self) -> Vec<String> {
        let limits = self.model.layout.perception.limits();
        (0..limits)
            .map(|limit| {
                let setting = self.setting.name();
                format!("{setting},{},{},{limit}", self.person, self.seed)
            })
            .collect()
    }

    fn effort(&self) -> usize {
        1
    }

    fn rows(&self) -> anyhow::Result<Vec<String>> {
        let domain = self.study.common.domain;
        let mut place = Place::new(domain, self.setting)?;
        let lived = SplitRounds::record(&mut place, self.setting, self.person, self.seed)?;
        let settings = ImplantSettings {
            seed: self.seed,
            ..ImplantSettings::of(domain.name())
        };
        let rounds = lived.first(self.study.rounds);
        let mut ignore = |_, _| {};
        let known = implants::learn(self.model, Kind::Mirror, &rounds, &settings, &mut ignore)?;
        let known = known.posterior;
        let learned = known.mean_limits();
        let perception = self.model.layout.perception;
        let person = place.person(self.person)?;
        let truth: Vec<f32> = person
            .sight()
            .limits
            .to_vec()
            .into_iter()
            .map(|limit| limit.min(perception.largest()))
            .collect();
        let counts = agreement(perception, &truth, &learned, &lived.test);
        let rows = self.keys().into_iter().enumerate().map(|(k, key)| {
            let [moments, seen, agreed] = counts[k];
            let (truth, learned) = (truth[k], learned[k]);
            let [low, high] = known.interval(k, INTERVAL);
            format!("{key},{truth:.4},{learned:.4},{moments},{seen},{agreed},{low:.4},{high:.4}")
        });
        Ok(rows.collect())
    }
}

/// For each limit: regions that it governs over all steps of some rounds, how many of them are truly seen, and on how many the
/// learned limits agree. Nothing where chance decides.
fn agreement(
    perception: &dyn Perception,
    truth: &[f32],
    learned: &[f32],
    rounds: &Rounds,
) -> Vec<[u32; 3]> {
    let mut counts = vec![[0; 3]; perception.limits()];
    if perception.noise_rows() > 0 {
        return counts;
    }
    let width = rounds.sizes[0];
    for visual in rounds
        .rounds
        .iter()
        .flat_map(|r| r.visual.chunks_exact(width))
    {
        for region in 0..perception.regions() {
            let (distance, limit) = perception.distance(region, visual, None);
            let (seen, thought) = (distance <= truth[limit], distance <= learned[limit]);
            let [moments, are_seen, agreed] = &mut counts[limit];
            *moments += 1;
            *are_seen += u32::from(seen);
            *agreed += u32::from(seen == thought);
        }
    }
    counts
}

/// Runs a study, or what is left of it.
///
/// # Errors
/// If the folder cannot be written or holds a study with other settings.
pub fn run(
    study: &Study,
    model: &Arc<SelfModel>,
    out: &Path,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> anyhow::Result<Report> {
    let common = study.common;
    let mut units = Vec::new();
    for (seed, person) in common.everybody() {
        units.extend(SETTINGS.map(|setting| Piece {
            study,
            model,
            setting,
            person,
            seed,
        }));
    }
    let name = common.name("implants");
    let sheet = Sheet {
        out,
        name: &name,
        header: HEADER,
        key: 4,
        about: common.about(model, serde_json::json!({ "rounds": study.rounds })),
    };
    let perception = model.layout.perception;
    let done = run_units(&sheet, &units, progress)?;
    Ok(Report::new(study, perception, &done))
}

/// One setting's implants.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Setting.
    pub setting: &'static str,
    /// Mean |learned − true| over the limits, in their unit.
    pub error: Interval,
    /// What half of the largest limit would give.
    pub error_of_middle: Interval,
    /// Share of what was there on which learned and true limits agree; none where chance decides.
    pub agreement: Option<Interval>,
    /// Share that the true limits let be seen.
    pub seen: Option<Interval>,
    /// Mean of the learned limits.
    pub learned: Interval,
    /// Mean of the true ones.
    pub truth: Interval,
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
    /// Rounds learned from.
    pub rounds: usize,
    /// Per setting.
    pub settings: Vec<Summary>,
    /// Claims.
    pub claims: Vec<Claim>,
    /// Seconds, summed over the cores.
    pub work_s: f64,
    #[serde(skip)]
    sketches: Vec<Sketch>,
    #[serde(skip)]
    which: Domain,
    #[serde(skip)]
    name: String,
}

impl Report {
    fn new(study: &Study, perception: &dyn Perception, done: &Done) -> Self {
        let common = study.common;
        let by_chance = perception.noise_rows() > 0;
        let middle = f64::from(perception.largest()) / 2.0;
        let mut settings = Vec::new();
        let mut sketches = Vec::new();
        for setting in SETTINGS {
            let rows: Vec<&Vec<String>> = done
                .rows
                .iter()
                .filter(|row| row[0] == setting.name())
                .filter(|row| common.has(number(row, 1), number(row, 2)))
                .collect();
            let over = |value: &dyn Fn(&[String]) -> f64| over_people(&by_person(&rows, 1, value));
            // Limits weigh by how often they matter.
            let share = |column: usize| {
                (!by_chance).then(|| {
                    let sum = |id: u32, column| -> f64 {
                        let own = rows.iter().filter(|row| number(row, 1) == f64::from(id));
                        own.map(|row| number(row, column)).sum()
                    };
                    let of = |id| sum(id, column) / sum(id, 6).max(1.0);
                    over_people(&(1..=common.people).map(of).collect::<Vec<f64>>())
                })
            };
            settings.push(Summary {
                setting: setting.name(),
                error: over(&|row| (number(row, 5) - number(row, 4)).abs()),
                error_of_middle: over(&|row| (middle - number(row, 4)).abs()),
                agreement: share(8),
                seen: share(7),
                learned: over(&|row| number(row, 5)),
                truth: over(&|row| number(row, 4)),
            });
            let first = common.seed.to_string();
            for person in 1..=common.people.min(DRAWN) {
                let of = |column: usize| -> Vec<f64> {
                    let own = rows
                        .iter()
                        .filter(|row| number(row, 1) == f64::from(person) && row[2] == first);
                    own.map(|row| number(row, column)).collect()
                };
                sketches.push(Sketch {
                    domain: common.domain,
                    title: format!("person {person}, {}", setting.name()),
                    truth: of(4),
                    learned: of(5),
                });
            }
        }
        let mut report = Self {
            domain: common.domain.name(),
            people: common.people,
            seeds: common.seeds,
            rounds: study.rounds,
            settings,
            claims: Vec::new(),
            work_s: done.work_s,
            sketches,
            which: common.domain,
            name: common.name("implants"),
        };
        let claim = report.judge();
        report.claims.push(claim);
        report
    }

    /// (f) Learned perceptual implants match the truth.
    fn judge(&self) -> Claim {
        let (mut parts, mut ours) = (Vec::new(), String::new());
        for s in &self.settings {
            match &s.agreement {
                Some(agreement) => {
                    parts.push(agreement.mean >= AGREE);
                    let _ = write!(
                        ours,
                        "{}: agree on {} % of what was there, off by {} cells; ",
                        s.setting,
                        with_interval(agreement, 100.0, 1),
                        with_interval(&s.error, 1.0, 2),
                    );
                }
                None => {
                    parts.push(s.error.mean <= NEAR);
                    let _ = write!(
                        ours,
                        "{}: learned probabilities {}, real {}, off by {}; ",
                        s.setting,
                        with_interval(&s.learned, 1.0, 3),
                        with_interval(&s.truth, 1.0, 3),
                        with_interval(&s.error, 1.0, 3),
                    );
                }
            }
        }
        let rule = match self.which {
            Domain::BombDefusal => format!("off by at most {NEAR} on average"),
            _ => format!(
                "seen or not seen, learned and true limits agree on at least {:.0} % of what was there in rounds that nobody learned from",
                100.0 * AGREE
            ),
        };
        Claim {
            letter: 'f',
            claim: "learned perceptual implants match the truth in the original and in the transfer setting, with bomb defusal's probabilities near the person's real ones".to_owned(),
            ours: ruled(&format!("in each setting, {rule}"), &ours),
            verdict: Verdict::of(&parts),
        }
    }

    /// Writes the report as JSON and draws the implants of the first people.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        write_json(&out.join(format!("{}.json", self.name)), self)?;
        draw(&self.sketches, SETTINGS.len(), &out.join(&self.name))
    }

    /// The study's section of RESULTS.md. `command` made it; `note` says what was special about the run.
    pub fn section(&self, results: &Path, out: &Path, command: &str, note: &str) -> String {
        let mut text = format!(
            "`{command}`: limits of sight that MIRROR learned from {} rounds ({} to learn from at most) against the true ones, {} simulated people, {} seed(s); intervals over people. {:.0} s, summed over the cores. {note}\n\n",
            self.rounds, LEARNING, self.people, self.seeds, self.work_s,
        );
        text.push_str(&claims_table(&self.claims));
        let unit = unit(self.which);
        let _ = write!(
            text,
            "\n| setting | error ({unit}) | error of always half of the largest | mean learned | mean true | agreement (%) | truly seen (%) |\n| --- | --- | --- | --- | --- | --- | --- |"
        );
        for s in &self.settings {
            let percent = |share: &Option<Interval>| {
                share
                    .as_ref()
                    .map_or_else(String::new, |share| with_interval(share, 100.0, 1))
            };
            let _ = write!(
                text,
                "\n| {} | {} | {} | {} | {} | {} | {} |",
                s.setting,
                with_interval(&s.error, 1.0, 3),
                with_interval(&s.error_of_middle, 1.0, 3),
                with_interval(&s.learned, 1.0, 3),
                with_interval(&s.truth, 1.0, 3),
                percent(&s.agreement),
                percent(&s.seen),
            );
        }
        let shows = match self.which {
            Domain::Driving => {
                "two lanes, the person's car in the middle, ahead is up: learned distances filled, true ones outlined"
            }
            Domain::SearchRescue => {
                "the house in its nine portions, for a person in its middle: portions that the learned radius reaches filled, the learned radius dashed, the true one drawn through (around the house where all of it is seen)"
            }
            Domain::BombDefusal => {
                "learned probabilities of noticing each of the six terminals in a step as bars, the person's real one as a line"
            }
        };
        let plot = |extension: &str| link(results, &out.join(format!("{}.{extension}", self.name)));
        let _ = writeln!(
            text,
            "\n\n![{}: {shows}]({})\n\n{shows}. ([PNG]({}), [table]({}); limits are numbered: {})",
            title(self.which),
            plot("svg"),
            plot("png"),
            plot("csv"),
            limit_names(self.which).join(", "),
        );
        text
    }

    /// Lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let line = |s: &Summary| {
            let agreement = s.agreement.as_ref().map_or(String::new(), |a| {
                format!(", agreement {} %", with_interval(a, 100.0, 1))
            });
            format!(
                "{:<9} error {} {}{agreement}",
                s.setting,
                with_interval(&s.error, 1.0, 3),
                unit(self.which),
            )
        };
        self.settings.iter().map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::discrete::Discrete;

    /// The true limits agree with themselves everywhere; limits of nothing only where nothing is seen.
    #[test]
    fn agreement_counts_what_is_on_the_same_side() {
        for domain in [Domain::Driving, Domain::SearchRescue] {
            let mut place = Place::new(domain, Setting::Transfer).expect("ships");
            let lived = SplitRounds::record(&mut place, Setting::Transfer, 2, 1).expect("lived");
            let perception = place.world.layout().perception;
            let person = place.person(2).expect("ships");
            let truth = person.sight().limits.to_vec();
            let same = agreement(perception, &truth, &truth, &lived.test);
            let blind = vec![-1.0; truth.len()];
            let other = agreement(perception, &truth, &blind, &lived.test);
            let mut all = 0;
            for ([moments, seen, agreed], [_, _, hidden]) in same.iter().zip(&other) {
                assert_eq!(moments, agreed);
                assert_eq!(*hidden, moments - seen);
                all += moments;
            }
            let steps: usize = lived.test.steps();
            assert_eq!(all as usize, steps * perception.regions());
            // What the limits let be seen is what the person said that they perceived.
            let seen: u32 = same.iter().map(|c| c[1]).sum();
            let masks = lived.test.rounds.iter().flat_map(|r| &r.perceived);
            assert_eq!(seen, masks.map(|m| m.visual.count_ones()).sum::<u32>());
        }
    }
}
