//! The highway study (paper §V): the same simulated drivers in clear weather, in fog without communication, and in fog with
//! an assistant; every person drives all six cases under every condition.

use crate::statistics::{Interval, over_people, share};
use crate::table::Table;
use anyhow::Context;
use domains::highway::display::Presenter;
use domains::highway::{
    Case, Cockpit, End, Fog, Observation, Person, Scene, Shown, SimulatedDriver, World, speech,
};
use models::observation::{PER_SECTOR, SECTORS};
use models::utterances::{Said, UtteranceTable};
use models::{Communicated, Implants, Kind, SelfHuman, SelfModel};
use planning::{Assistant, Settings};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;
use training::demonstrations::{Demonstrations, record};
use training::rollout::step_of;

/// What is said in a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// No fog, nothing communicated.
    Clear,
    /// Fog, nothing communicated (NC).
    Silent,
    /// Fog, everything communicated all the time: the upper bound of communication.
    Everything,
    /// Fog, planned with the MIRROR human model.
    Mirror,
    /// Fog, planned with perceptual implants only.
    MirrorP,
    /// Fog, planned with the unchanged self-model as human model.
    Myself,
}

impl Condition {
    /// Every condition.
    pub const ALL: [Self; 6] = [
        Self::Clear,
        Self::Silent,
        Self::Everything,
        Self::Mirror,
        Self::MirrorP,
        Self::Myself,
    ];

    /// Its name in tables and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Clear => "clear",
            Self::Silent => "silent",
            Self::Everything => "everything",
            Self::Mirror => "mirror",
            Self::MirrorP => "mirror-p",
            Self::Myself => "self",
        }
    }

    /// The condition of that name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name() == name)
    }

    /// The human model that plans under this condition.
    pub const fn human(self) -> Option<Kind> {
        match self {
            Self::Mirror => Some(Kind::Mirror),
            Self::MirrorP => Some(Kind::MirrorP),
            Self::Myself => Some(Kind::Myself),
            _ => None,
        }
    }
}

/// What to run.
#[derive(Clone, Debug)]
pub struct Study {
    /// Conditions.
    pub conditions: Vec<Condition>,
    /// Persons 1 to this number.
    pub people: u32,
    /// Seeds per condition without a planner.
    pub seeds: u64,
    /// Seeds per condition with one.
    pub planned_seeds: u64,
    /// First seed.
    pub seed: u64,
    /// Demonstration rounds that implants are learned from.
    pub rounds: usize,
    /// The planner.
    pub settings: Settings,
}

/// How one round went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundResult {
    /// Control steps.
    pub steps: u32,
    /// Whether it ended in a collision.
    pub collided: bool,
    /// Sum of rewards.
    pub reward: f64,
    /// Sum over steps of highlighted sectors that showed a car.
    pub visual: u32,
    /// Steps with at least one highlight.
    pub highlighted_steps: u32,
    /// Utterances.
    pub utterances: u32,
    /// Sum of C(ω) over steps, of what was really shown and said.
    pub cost: f64,
}

/// A condition's results over all people.
#[derive(Clone, Debug, serde::Serialize)]
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
    /// Highlighted sectors per minute.
    pub visual_per_minute: Interval,
    /// Seconds with a highlight per minute.
    pub highlighted_s_per_minute: Interval,
    /// Utterances per minute.
    pub utterances_per_minute: Interval,
    /// Communication cost of a round.
    pub cost: Interval,
}

const HEADER: &str =
    "condition,person,seed,case,steps,collided,reward,visual,highlighted_steps,utterances,cost";

/// Stream of rounds that demonstrations come from: never the rounds that are scored.
const DEMONSTRATION_SEED: u64 = 0x6465_6d6f;

/// Runs a study, or what is left of it, and writes `drive.csv` and `drive.json` into `out`.
///
/// # Errors
/// If a scene or person cannot be read, or `out` not be written.
pub fn run(
    study: &Study,
    model: Option<&Arc<SelfModel>>,
    out: &Path,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> anyhow::Result<Vec<ConditionSummary>> {
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let table = Table::open(&out.join("drive.csv"), HEADER, 4)?;
    let mut jobs = Vec::new();
    for &condition in &study.conditions {
        let seeds = match condition.human() {
            Some(_) => study.planned_seeds,
            None => study.seeds,
        };
        for person in 1..=study.people {
            for seed in study.seed..study.seed + seeds {
                let missing = Case::ALL.into_iter().any(|case| {
                    !table.has(&format!(
                        "{},{person},{seed},{}",
                        condition.name(),
                        case.number()
                    ))
                });
                if missing {
                    jobs.push((condition, person, seed));
                }
            }
        }
    }
    let total = jobs.len();
    let done = std::sync::atomic::AtomicUsize::new(0);
    progress(0, total);
    jobs.par_iter().try_for_each(|&(condition, id, seed)| {
        let mut rider = Rider::new(study, model, condition, id)?;
        for case in Case::ALL {
            let key = format!("{},{id},{seed},{}", condition.name(), case.number());
            if table.has(&key) {
                continue;
            }
            let r = rider.round(seed, case)?;
            table.append(&format!(
                "{key},{},{},{:.4},{},{},{},{:.4}\n",
                r.steps,
                u8::from(r.collided),
                r.reward,
                r.visual,
                r.highlighted_steps,
                r.utterances,
                r.cost
            ))?;
        }
        let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        progress(done, total);
        anyhow::Ok(())
    })?;
    let rows = table.finish()?;
    let step_s = Scene::builtin("highway-fog")?.step_s();
    let summaries: Vec<_> = study
        .conditions
        .iter()
        .map(|&condition| summarise(condition, &rows, step_s))
        .collect();
    let path = out.join("drive.json");
    std::fs::write(&path, serde_json::to_string_pretty(&summaries)?)
        .with_context(|| path.display().to_string())?;
    Ok(summaries)
}

/// One person under one condition.
pub struct Rider {
    condition: Condition,
    scene: Arc<Scene>,
    world: World,
    driver: SimulatedDriver,
    assistant: Option<Assistant>,
    settings: Settings,
    presenter: Presenter,
    table: UtteranceTable,
    verbal: Vec<f32>,
}

impl Rider {
    /// Seats person `id`; with a planner, learns their implants from demonstration rounds in the same fog first.
    ///
    /// # Errors
    /// If the person or scene cannot be read, or a planner has no self-model.
    pub fn new(
        study: &Study,
        model: Option<&Arc<SelfModel>>,
        condition: Condition,
        id: u32,
    ) -> anyhow::Result<Self> {
        let scene = Arc::new(Scene::builtin("highway-fog")?);
        let person = Person::builtin(id)?;
        let fog = match condition {
            Condition::Clear => Fog::clear(),
            _ => scene.fog(),
        };
        let mut world = World::new(scene.clone())?;
        let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
        let mut driver = SimulatedDriver::new(&person, &fog, cockpit);
        let assistant = match condition.human() {
            None => None,
            Some(kind) => {
                let model = model.context("a planner needs a self-model")?;
                let implants = match kind {
                    Kind::Myself => None,
                    kind => Some(learn_implants(
                        &mut world,
                        &mut driver,
                        model,
                        kind,
                        study.rounds,
                    )?),
                };
                let human = Box::new(SelfHuman::new(model.clone(), implants));
                Some(Assistant::new(model.clone(), human, study.settings))
            }
        };
        Ok(Self {
            condition,
            presenter: Presenter::new(scene.communication.speech_interval_s, scene.step_s()),
            scene,
            world,
            driver,
            assistant,
            settings: study.settings,
            table: UtteranceTable::shipped()?,
            verbal: vec![0.0; SECTORS * PER_SECTOR],
        })
    }

    /// Drives one round of a case.
    ///
    /// # Errors
    /// None that a human model in the same process could cause.
    pub fn round(&mut self, seed: u64, case: Case) -> anyhow::Result<RoundResult> {
        let episode = case.number();
        self.world.reset_case(seed, episode, case);
        self.driver.reset(seed, episode);
        self.presenter.reset();
        if let Some(assistant) = &mut self.assistant {
            assistant.reset();
        }
        let mut result = RoundResult::default();
        let mut taken = [0.0; 2];
        let mut decision = planning::Decision::default();
        loop {
            let step = result.steps;
            let shown = self.shown(step, &decision);
            self.count(&shown, &mut result);
            let action = self.driver.act(self.world.observation(), &shown);
            if let Some(assistant) = &mut self.assistant {
                let visual = step_of(self.world.observation()).visual;
                hear(&self.table, &shown, &mut self.verbal);
                assistant.observe(&visual, &self.verbal, communicated(&shown), taken);
                let ready = self.presenter.ready_in(step + 1) as usize;
                decision = assistant.decide(Some(action), ready, seed, episode, step)?;
            }
            taken = action;
            let outcome = self.world.step(action);
            result.steps += 1;
            result.reward += f64::from(outcome.reward);
            if outcome.end != End::Running {
                result.collided = outcome.collided;
                return Ok(result);
            }
        }
    }

    fn shown(&mut self, step: u32, decision: &planning::Decision) -> Shown {
        let observation = self.world.observation();
        match self.condition {
            Condition::Clear | Condition::Silent => Shown::default(),
            Condition::Everything => {
                let mut shown = self
                    .presenter
                    .present(step, 0x3f, 0, &[0.0; SECTORS], observation);
                shown.utterances = speech::utterances(observation).map(Some);
                shown
            }
            _ => {
                let probability = core::array::from_fn(|s| decision.probability[SECTORS + s]);
                self.presenter.present(
                    step,
                    decision.communicated.visual_bits(),
                    decision.communicated.verbal_bits(),
                    &probability,
                    observation,
                )
            }
        }
    }

    fn count(&self, shown: &Shown, result: &mut RoundResult) {
        let told = communicated(shown);
        let visible = visible_sectors(self.world.observation(), shown);
        result.visual += visible;
        result.highlighted_steps += u32::from(visible > 0);
        result.utterances += told.verbal_bits().count_ones();
        result.cost += f64::from(self.settings.cost(told));
    }

    /// The scene that is driven in.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }
}

/// Learns a person's implants from rounds without communication, in the fog that the driver was made for.
///
/// # Errors
/// If the rounds are too short to learn from.
pub fn learn_implants(
    world: &mut World,
    driver: &mut SimulatedDriver,
    model: &SelfModel,
    kind: Kind,
    rounds: usize,
) -> anyhow::Result<Implants> {
    let demonstrations = demonstrate(world, driver, rounds);
    let settings = training::implants::Settings::default();
    let learned = training::implants::learn(model, kind, &demonstrations, &settings, |_, _| {})?;
    Ok(learned.implants)
}

/// Rounds of one case after the other.
pub fn demonstrate(
    world: &mut World,
    driver: &mut SimulatedDriver,
    rounds: usize,
) -> Demonstrations {
    record(world, driver, DEMONSTRATION_SEED, 0, rounds)
}

/// Sectors that are highlighted or spoken about.
pub fn communicated(shown: &Shown) -> Communicated {
    let verbal = shown
        .utterances
        .iter()
        .enumerate()
        .fold(0, |bits, (s, heard)| bits | u32::from(heard.is_some()) << s);
    Communicated::new(shown.highlighted, verbal)
}

/// Highlighted sectors in which there is a car to highlight.
fn visible_sectors(observation: &Observation, shown: &Shown) -> u32 {
    let mut sectors = 0_u32;
    for (azimuth, object) in observation.object.iter().enumerate() {
        if *object >= 0 && shown.reveals(azimuth, *object) {
            sectors |= 1 << speech::sector_of(azimuth);
        }
    }
    sectors.count_ones()
}

/// What was really spoken, as the 120 numbers that models hear.
pub fn hear(table: &UtteranceTable, shown: &Shown, verbal: &mut [f32]) {
    verbal.fill(0.0);
    for (sector, heard) in shown.utterances.iter().enumerate() {
        if let Some(heard) = heard {
            let said = match heard.kind {
                speech::UtteranceKind::Nothing => Said::Nothing,
                speech::UtteranceKind::Slow => Said::Slow,
                speech::UtteranceKind::Fast => Said::Fast,
            };
            table.encode(sector, said, heard.range_m, verbal);
        }
    }
}

fn summarise(condition: Condition, rows: &[Vec<String>], step_s: f64) -> ConditionSummary {
    let number = |row: &[String], column: usize| row[column].parse::<f64>().unwrap_or(f64::NAN);
    let mine: Vec<&Vec<String>> = rows.iter().filter(|r| r[0] == condition.name()).collect();
    let mut people: Vec<&str> = mine.iter().map(|r| r[1].as_str()).collect();
    people.sort_unstable();
    people.dedup();
    let per_person = |value: &dyn Fn(&[&&Vec<String>]) -> f64| -> Interval {
        let values: Vec<f64> = people
            .iter()
            .map(|&person| {
                let rows: Vec<&&Vec<String>> = mine.iter().filter(|r| r[1] == person).collect();
                value(&rows)
            })
            .collect();
        over_people(&values)
    };
    let mean = |column: usize| {
        per_person(&|rows| {
            rows.iter().map(|r| number(r, column)).sum::<f64>() / rows.len().max(1) as f64
        })
    };
    let per_minute = |column: usize, unit: f64| {
        per_person(&|rows| {
            let steps: f64 = rows.iter().map(|r| number(r, 4)).sum();
            let items: f64 = rows.iter().map(|r| number(r, column)).sum();
            items * unit / (steps * step_s / 60.0).max(1e-9)
        })
    };
    let hits = mine.iter().filter(|r| r[5] == "1").count();
    ConditionSummary {
        condition: condition.name(),
        rounds: mine.len(),
        collisions: mean(5),
        collisions_by_round: share(hits, mine.len()),
        reward: mean(6),
        visual_per_minute: per_minute(7, 1.0),
        highlighted_s_per_minute: per_minute(8, step_s),
        utterances_per_minute: per_minute(9, 1.0),
        cost: mean(10),
    }
}
