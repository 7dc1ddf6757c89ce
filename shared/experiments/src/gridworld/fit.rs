//! `fit` (the paper's figure "Policy Negative Log-Likelihood"): how well each human model, having learned from a part of 20 rounds,
//! predicts what the person does in rounds that nobody learned from, in the original and in the transfer setting.

use super::subject::{LEARNING, Place, SplitRounds, TEST, VALIDATION, rounds_of};
use super::units::{Done, Sheet, Unit, by_person, number, run as run_units};
use super::{Common, score, title};
use crate::anova::paired_t;
use crate::plot::{Line, Lines, lines};
use crate::results::{Claim, Verdict, claims_table, link, probability, ruled, with_interval};
use crate::statistics::{Interval, over_people};
use crate::table::write_json;
use domains::discrete::{Discrete, Setting};
use models::Kind;
use models::SelfModel;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use training::config::Config;
use training::people::{Demonstrations, Learned, learn, wants_original};

/// The person themselves: the ideal model.
pub const IDEAL: &str = "ideal";
/// Settings, in the order of panels.
const SETTINGS: [Setting; 2] = [Setting::Original, Setting::Transfer];
/// Models that learn.
pub const LEARNERS: [Kind; 4] = [Kind::Mirror, Kind::MirrorP, Kind::Bc, Kind::Sqil];

/// What to run.
#[derive(Clone, Debug)]
pub struct Study {
    /// Domain, people, seeds.
    pub common: Common,
    /// Percentages of the rounds to learn from.
    pub percents: Vec<u32>,
}

/// One model of one person.
struct Piece<'a> {
    study: &'a Study,
    model: &'a Arc<SelfModel>,
    setting: Setting,
    /// None for the ideal model.
    kind: Option<Kind>,
    percent: u32,
    person: u32,
    seed: u64,
}

const HEADER: &str = "setting,model,percent,person,seed,rounds,nll";

impl Unit for Piece<'_> {
    fn keys(&self) -> Vec<String> {
        let Self {
            setting,
            kind,
            percent,
            person,
            seed,
            ..
        } = self;
        let name = kind.map_or(IDEAL, Kind::name);
        vec![format!(
            "{},{name},{percent},{person},{seed}",
            setting.name()
        )]
    }

    fn effort(&self) -> usize {
        match self.kind {
            Some(Kind::Bc | Kind::Sqil) => 2 + self.percent as usize / 20,
            Some(Kind::Mirror | Kind::MirrorP) => 2,
            _ => 1,
        }
    }

    fn rows(&self) -> anyhow::Result<Vec<String>> {
        let domain = self.study.common.domain;
        let mut place = Place::new(domain, self.setting)?;
        let lived = SplitRounds::record(&mut place, self.setting, self.person, self.seed)?;
        let rounds = rounds_of(self.percent);
        let nll = match self.kind {
            None => {
                let first = (LEARNING + VALIDATION) as u32;
                let actions = place.world.layout().actions.rows();
                let person = place.person(self.person)?;
                score::of_person(&person, actions, &lived.test, lived.seed, first)
            }
            Some(kind) => {
                let learned = learned(
                    &self.study.common,
                    kind,
                    self.model,
                    &lived,
                    [self.person, self.percent],
                    self.seed,
                )?;
                match &learned {
                    Learned::Policy { person, .. } => score::of_policy(&person.policy, &lived.test),
                    _ => {
                        let mut human = learned.human(self.model);
                        score::of_model(&mut *human, self.model, &lived.test)
                    }
                }
            }
        };
        let rounds = if self.percent == 0 { 0 } else { rounds };
        let key = &self.keys()[0];
        Ok(vec![format!("{key},{rounds},{nll:.6}")])
    }
}

/// Learns a model of a person from the first `percent` of their rounds; BC and SQIL in the transfer setting from as many of the
/// original setting too.
///
/// # Errors
/// If there is nothing to learn from.
pub fn learned(
    common: &Common,
    kind: Kind,
    model: &Arc<SelfModel>,
    lived: &SplitRounds,
    [person, percent]: [u32; 2],
    seed: u64,
) -> anyhow::Result<Learned> {
    let rounds = rounds_of(percent);
    let own = lived.first(rounds);
    let original = wants_original(kind, own.setting)
        .then(|| -> anyhow::Result<_> {
            let mut place = Place::new(common.domain, Setting::Original)?;
            let lived = SplitRounds::record(&mut place, Setting::Original, person, seed)?;
            Ok(lived.first(rounds))
        })
        .transpose()?;
    let demonstrations = Demonstrations {
        rounds: &own,
        original: original.as_ref(),
        validation: Some(&lived.validation),
    };
    let mut config = Config::shipped(common.domain.name());
    config.sqil.phases = common.sqil_phases.unwrap_or(config.sqil.phases);
    Ok(learn(
        kind,
        model,
        &demonstrations,
        &config,
        seed,
        &|_, _, _| {},
    )?)
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
        for setting in SETTINGS {
            let mut add = |kind, percent| {
                units.push(Piece {
                    study,
                    model,
                    setting,
                    kind,
                    percent,
                    person,
                    seed,
                });
            };
            for kind in LEARNERS {
                study.percents.iter().for_each(|p| add(Some(kind), *p));
            }
            add(Some(Kind::Myself), 0);
            add(None, 0);
        }
    }
    let name = common.name("fit");
    let sheet = Sheet {
        out,
        name: &name,
        header: HEADER,
        key: 5,
        about: common.about(model, serde_json::Value::Null),
    };
    Ok(Report::new(study, &run_units(&sheet, &units, progress)?))
}

/// One model's likelihood in a setting.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Setting.
    pub setting: &'static str,
    /// Model.
    pub model: &'static str,
    /// Percentage of the rounds that it learned from; 0 for who learns nothing.
    pub percent: u32,
    /// −log π(a), nats a step, with its interval over people.
    pub nll: Interval,
    /// Per person.
    #[serde(skip)]
    pub people: Vec<f64>,
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
    /// Results.
    pub points: Vec<Point>,
    /// Claims.
    pub claims: Vec<Claim>,
    /// Seconds, summed over the cores.
    pub work_s: f64,
    #[serde(skip)]
    percents: Vec<u32>,
    #[serde(skip)]
    name: String,
    #[serde(skip)]
    title: &'static str,
}

impl Report {
    fn new(study: &Study, done: &Done) -> Self {
        let common = study.common;
        let mut points = Vec::new();
        for setting in SETTINGS {
            let mut add = |model: &'static str, percent: u32| {
                let percents = percent.to_string();
                let rows: Vec<&Vec<String>> = done
                    .rows
                    .iter()
                    .filter(|row| row[0] == setting.name() && row[1] == model)
                    .filter(|row| row[2] == percents && common.has(number(row, 3), number(row, 4)))
                    .collect();
                let people = by_person(&rows, 3, &|row| number(row, 6));
                points.push(Point {
                    setting: setting.name(),
                    model,
                    percent,
                    nll: over_people(&people),
                    people,
                });
            };
            for kind in LEARNERS {
                study.percents.iter().for_each(|p| add(kind.name(), *p));
            }
            add(Kind::Myself.name(), 0);
            add(IDEAL, 0);
        }
        let mut report = Self {
            domain: common.domain.name(),
            people: common.people,
            seeds: common.seeds,
            points,
            claims: Vec::new(),
            work_s: done.work_s,
            percents: study.percents.clone(),
            name: common.name("fit"),
            title: title(common.domain),
        };
        report.claims.extend(report.judge());
        report
    }

    fn point(&self, setting: &str, model: &str, percent: u32) -> Option<&Point> {
        self.points
            .iter()
            .find(|p| p.setting == setting && p.model == model && p.percent == percent)
    }

    /// (a) BC has the best policy NLL.
    fn judge(&self) -> Option<Claim> {
        let most = *self.percents.iter().max()?;
        let (mut parts, mut ours) = (Vec::new(), String::new());
        for setting in SETTINGS {
            let of = |kind: Kind| self.point(setting.name(), kind.name(), most);
            let bc = of(Kind::Bc)?;
            let others = LEARNERS.iter().filter(|kind| **kind != Kind::Bc);
            let next = others
                .filter_map(|kind| of(*kind))
                .min_by(|a, b| a.nll.mean.total_cmp(&b.nll.mean))?;
            let pair = paired_t(&bc.people, &next.people, SETTINGS.len()).ok();
            parts.push(bc.nll.mean < next.nll.mean);
            parts.push(
                pair.as_ref()
                    .is_some_and(|pair| pair.difference.mean < 0.0 && pair.is_significant()),
            );
            let _ = write!(
                ours,
                "{}: BC {}, best of the others {} {}{}; ",
                setting.name(),
                with_interval(&bc.nll, 1.0, 3),
                next.model,
                with_interval(&next.nll, 1.0, 3),
                pair.map_or(String::new(), |p| format!(
                    ", {} adjusted",
                    probability(p.p_adjusted)
                )),
            );
        }
        Some(Claim {
            letter: 'a',
            claim: "BC has the best policy NLL".to_owned(),
            ours: ruled(
                "in each setting, learned from all rounds: BC's mean is lowest of the models that learn; it is lower than the next at an adjusted 5 %",
                &ours,
            ),
            verdict: Verdict::of(&parts),
        })
    }

    /// Writes the report as JSON and draws it.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        write_json(&out.join(format!("{}.json", self.name)), self)?;
        let panel = |setting: Setting| {
            let line = |model: &'static str| {
                let learns = self.percents.iter().filter_map(|percent| {
                    let point = self
                        .point(setting.name(), model, *percent)
                        .or_else(|| self.point(setting.name(), model, 0))?;
                    Some((f64::from(*percent), point.nll))
                });
                Line {
                    name: model.to_owned(),
                    points: learns.collect(),
                }
            };
            let models = LEARNERS.iter().map(|kind| kind.name());
            Lines {
                title: format!("{}, {} setting", self.title, setting.name()),
                x: format!("% of {LEARNING} rounds learned from"),
                y: "−log π(a), nats a step".to_owned(),
                y_most: None,
                lines: models
                    .chain([Kind::Myself.name(), IDEAL])
                    .map(line)
                    .collect(),
            }
        };
        lines(&SETTINGS.map(panel), &out.join(&self.name))
    }

    /// Lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let line = |p: &Point| {
            let nll = with_interval(&p.nll, 1.0, 3);
            format!(
                "{:<9} {:<9} {:>3} %   {nll} nats a step",
                p.setting, p.model, p.percent
            )
        };
        self.points.iter().map(line).collect()
    }

    /// The study's section of RESULTS.md. `command` made it; `note` says what was special about the run.
    pub fn section(&self, results: &Path, out: &Path, command: &str, note: &str) -> String {
        let mut text = format!(
            "`{command}`: −log π(a) in nats a step on {TEST} rounds that nobody learned from, {} simulated people, {} seed(s); intervals over people. \
             {LEARNING} rounds to learn from, {VALIDATION} that say when BC and SQIL have to stop; in the transfer setting these two learn from as many rounds of the original one too. \
             BC, SQIL and the ideal model are told what the person perceived. {:.0} s, summed over the cores. {note}\n\n",
            self.people, self.seeds, self.work_s,
        );
        text.push_str(&claims_table(&self.claims));
        for setting in SETTINGS {
            let _ = write!(text, "\n| {} |", setting.name());
            for percent in &self.percents {
                let _ = write!(text, " {} rounds |", rounds_of(*percent));
            }
            let _ = write!(text, "\n| --- |{}", " --- |".repeat(self.percents.len()));
            for kind in LEARNERS {
                let _ = write!(text, "\n| {} |", kind.name());
                for percent in &self.percents {
                    let point = self.point(setting.name(), kind.name(), *percent);
                    let cell = point.map(|p| with_interval(&p.nll, 1.0, 3));
                    let _ = write!(text, " {} |", cell.unwrap_or_default());
                }
            }
            for model in [Kind::Myself.name(), IDEAL] {
                let point = self.point(setting.name(), model, 0);
                let cell = point.map(|p| with_interval(&p.nll, 1.0, 3));
                let rest = " |".repeat(self.percents.len());
                let _ = write!(text, "\n| {model} | {}{rest}", cell.unwrap_or_default());
            }
            text.push('\n');
        }
        let plot = |extension: &str| link(results, &out.join(format!("{}.{extension}", self.name)));
        let _ = writeln!(
            text,
            "\n![likelihood against rounds learned from]({})\n\n([PNG]({}), [table]({}))",
            plot("svg"),
            plot("png"),
            plot("csv"),
        );
        text
    }
}
