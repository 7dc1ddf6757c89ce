//! The highway study (paper §V): the same simulated drivers in clear weather, in fog without communication, and in fog with
//! an assistant; every person drives all six cases under every condition.

use crate::drive_report::Report;
use crate::oracle::Oracle;
use crate::table::{Table, ensure_same};
use anyhow::Context;
use domains::highway::SECTORS;
use domains::highway::display::Presenter;
use domains::highway::modalities::{self, PER_SECTOR};
use domains::highway::{
    Case, Cockpit, End, Fog, Observation, Person, Scene, Shown, SimulatedDriver, World, speech,
};
use models::utterances::{Said, UtteranceTable};
use models::{Communicated, Kind, SelfModel};
use planning::items::Sectors;
use planning::{Assistant, Method, PlanMoment, Settings};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;
use training::config::Config;
use training::environment::visual_of;
use training::people::{Demonstrations, learn};
use training::rounds::Rounds;

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
    /// Fog, planned with behavioural cloning (BC).
    Bc,
    /// Fog, the MIRROR human model, belief matching instead of planning (MIRROR-KL).
    MirrorKl,
    /// Fog, planned with soft-Q imitation (SQIL).
    Sqil,
    /// Fog, the MIRROR human model, the cross-entropy method in place of the race.
    MirrorCe,
    /// Fog, the race with the simulator as world and the person themselves as human model: the ceiling of what planning can do.
    Ideal,
}

impl Condition {
    /// Every condition.
    pub const ALL: [Self; 11] = [
        Self::Clear,
        Self::Silent,
        Self::Everything,
        Self::Mirror,
        Self::MirrorP,
        Self::Myself,
        Self::Bc,
        Self::MirrorKl,
        Self::Sqil,
        Self::MirrorCe,
        Self::Ideal,
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
            Self::Bc => "bc",
            Self::MirrorKl => "mirror-kl",
            Self::Sqil => "sqil",
            Self::MirrorCe => "mirror-ce",
            Self::Ideal => "ideal",
        }
    }

    /// The condition of that name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name() == name)
    }

    /// The human model that plans under this condition; none where nobody plans, or the person themselves is it.
    pub const fn human(self) -> Option<Kind> {
        match self {
            Self::Mirror | Self::MirrorKl | Self::MirrorCe => Some(Kind::Mirror),
            Self::MirrorP => Some(Kind::MirrorP),
            Self::Myself => Some(Kind::Myself),
            Self::Bc => Some(Kind::Bc),
            Self::Sqil => Some(Kind::Sqil),
            Self::Clear | Self::Silent | Self::Everything | Self::Ideal => None,
        }
    }

    /// About how many rounds without a planner one round takes, for the time that is left.
    const fn effort(self) -> usize {
        match (self, self.human(), self.method()) {
            (Self::Ideal, ..) => 300,
            (_, None, _) => 1,
            (_, Some(_), Method::Kl) => 50,
            (_, Some(_), Method::Race) => 300,
            (_, Some(_), Method::Ce) => 1000,
        }
    }

    /// Whether something is planned.
    pub const fn plans(self) -> bool {
        self.human().is_some() || matches!(self, Self::Ideal)
    }

    /// How what is said is decided, where there is a human model.
    pub const fn method(self) -> Method {
        match self {
            Self::MirrorKl => Method::Kl,
            Self::MirrorCe => Method::Ce,
            _ => Method::Race,
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

const HEADER: &str =
    "condition,person,seed,case,steps,collided,reward,visual,highlighted_steps,utterances,cost";

/// Stream of rounds that demonstrations come from: never the rounds that are scored.
const DEMONSTRATION_SEED: u64 = 0x6465_6d6f;

/// Runs a study, or what is left of it, and writes `drive.csv` into `out`. `progress` hears of (done, all), in units of
/// a round without a planner.
///
/// # Errors
/// If a scene or person cannot be read, `out` not be written, or it holds a study with other settings.
pub fn run(
    study: &Study,
    model: Option<&Arc<SelfModel>>,
    out: &Path,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> anyhow::Result<Report> {
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let about = serde_json::json!({
        "rounds": study.rounds,
        "planner": study.settings,
        "self_model": model.map(|model| model.digest()),
    });
    ensure_same(&out.join("drive.settings.json"), &about)?;
    let table = Table::open(&out.join("drive.csv"), HEADER, 4)?;
    let key = |condition: Condition, person: u32, seed: u64, case: Case| {
        format!("{},{person},{seed},{}", condition.name(), case.number())
    };
    let (mut jobs, mut total) = (Vec::new(), 0);
    for &condition in &study.conditions {
        let seeds = match condition.plans() {
            true => study.planned_seeds,
            false => study.seeds,
        };
        for person in 1..=study.people {
            for seed in study.seed..study.seed + seeds {
                let missing: Vec<Case> = Case::ALL
                    .into_iter()
                    .filter(|&case| !table.has(&key(condition, person, seed, case)))
                    .collect();
                total += missing.len() * condition.effort();
                if !missing.is_empty() {
                    jobs.push((condition, person, seed, missing));
                }
            }
        }
    }
    let done = std::sync::atomic::AtomicUsize::new(0);
    progress(0, total);
    jobs.par_iter()
        .try_for_each(|(condition, id, seed, cases)| {
            let mut rider = Rider::new(study, model, *condition, *id)?;
            for &case in cases {
                let r = rider.round(*seed, case)?;
                table.append(&format!(
                    "{},{},{},{:.4},{},{},{},{:.4}\n",
                    key(*condition, *id, *seed, case),
                    r.steps,
                    u8::from(r.collided),
                    r.reward,
                    r.visual,
                    r.highlighted_steps,
                    r.utterances,
                    r.cost
                ))?;
                let effort = condition.effort();
                let before = done.fetch_add(effort, std::sync::atomic::Ordering::Relaxed);
                progress(before + effort, total);
            }
            anyhow::Ok(())
        })?;
    let rows = table.finish()?;
    let step_s = Scene::builtin("highway-fog")?.step_s();
    Ok(Report::new(&study.conditions, study.people, &rows, step_s))
}

/// One person under one condition.
pub struct Rider {
    condition: Condition,
    scene: Arc<Scene>,
    world: World,
    driver: SimulatedDriver,
    assistant: Option<Assistant>,
    oracle: Option<Oracle>,
    settings: Settings,
    presenter: Presenter,
    table: UtteranceTable,
    verbal: Vec<f32>,
}

impl Rider {
    /// Seats person `id`; with a planner, learns about them from demonstration rounds in the same fog first.
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
                let demonstrations = demonstrate(&mut world, &mut driver, study.rounds);
                let demonstrations = Demonstrations::of(&demonstrations);
                let config = Config::shipped(modalities::NAME);
                let learned = learn(kind, model, &demonstrations, &config, 0, &|_, _, _| {})?;
                let human = learned.human(model);
                Some(Assistant::new(
                    model.clone(),
                    human,
                    study.settings,
                    condition.method(),
                    Sectors,
                ))
            }
        };
        Ok(Self {
            condition,
            presenter: Presenter::new(scene.communication.speech_interval_s, scene.step_s()),
            scene,
            world,
            driver,
            assistant,
            oracle: (condition == Condition::Ideal).then(|| Oracle::new(study.settings)),
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
                let visual = visual_of(self.world.observation());
                hear(&self.table, &shown, &mut self.verbal);
                let at = [seed, u64::from(episode), u64::from(step)];
                assistant.observe(&visual, &self.verbal, communicated(&shown), &taken, at);
                let moment = PlanMoment {
                    seed,
                    episode,
                    step,
                    speech_ready_steps: self.presenter.ready_in(step + 1) as usize,
                };
                decision = assistant.decide(Some(action), moment)?;
            }
            if let Some(oracle) = &mut self.oracle {
                let moment = PlanMoment {
                    seed,
                    episode,
                    step,
                    speech_ready_steps: self.presenter.ready_in(step + 1) as usize,
                };
                decision = oracle.decide(&self.world, &self.driver, action, moment)?;
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

/// Rounds of one case after the other.
pub fn demonstrate(world: &mut World, driver: &mut SimulatedDriver, rounds: usize) -> Rounds {
    Rounds::record_drives(world, driver, DEMONSTRATION_SEED, 0, rounds)
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
