//! `communicate` (the paper's figure "Task Performance and Communication Amount"): what assistants with different human models
//! earn for a person in the transfer setting, and how much they say for it.

use super::Common;
use super::communicate_report::Report;
use super::fit::learned;
use super::subject::{Place, SplitRounds};
use super::units::{Sheet, Unit, run as run_units};
use domains::discrete::{Discrete, End, Setting};
use models::Kind;
use models::{SelfHuman, SelfModel};
use planning::ideal::IdealPeople;
use planning::items::settings_of;
use planning::round::{Advice, RoundResult, play};
use planning::{Assistant, Method, Settings};
use std::path::Path;
use std::sync::Arc;

/// Seed of the rounds that assistants are judged by: nobody learns from these.
const JUDGED: u64 = 0x706c_6179_6564_0000;

/// Who decides what is communicated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Nobody (NC).
    Silent,
    /// All that the channels can carry, in every step.
    Everything,
    /// An assistant that imagines the person themselves (IM).
    Ideal,
    /// An assistant that imagines a model of the person.
    Model(Kind),
}

impl Condition {
    /// Those that are run unless others are asked for.
    pub const DEFAULT: [Self; 7] = [
        Self::Silent,
        Self::Everything,
        Self::Ideal,
        Self::Model(Kind::Mirror),
        Self::Model(Kind::MirrorP),
        Self::Model(Kind::Bc),
        Self::Model(Kind::Sqil),
    ];

    /// Its name in tables and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Silent => "nc",
            Self::Everything => "everything",
            Self::Ideal => "ideal",
            Self::Model(kind) => kind.name(),
        }
    }

    /// The condition of that name.
    pub fn parse(name: &str) -> Option<Self> {
        let others = [Self::Silent, Self::Everything, Self::Ideal];
        let models = Kind::ALL.map(Self::Model);
        others
            .into_iter()
            .chain(models)
            .find(|condition| condition.name() == name)
    }

    /// Whether there is something to learn.
    pub const fn learns(self) -> bool {
        !matches!(
            self,
            Self::Silent | Self::Everything | Self::Ideal | Self::Model(Kind::Myself | Kind::Ideal)
        )
    }
}

/// What to run.
#[derive(Clone, Debug)]
pub struct Study {
    /// Domain, people, seeds.
    pub common: Common,
    /// Conditions.
    pub conditions: Vec<Condition>,
    /// Percentages of the 20 rounds that models learn from.
    pub percents: Vec<u32>,
    /// Rounds a person and condition.
    pub rounds: u32,
    /// How every assistant decides …
    pub method: Method,
    /// … and with which settings.
    pub settings: Settings,
}

/// The scene's planner; with `samples` imagined futures, a fifth of the candidates elites, where it is the cross-entropy
/// method.
///
/// # Errors
/// If the planner cannot have so many.
pub fn settings(common: &Common, samples: usize) -> anyhow::Result<Settings> {
    let place = Place::new(common.domain, Setting::Transfer)?;
    let mut settings = settings_of(place.scene.planning());
    settings.samples = samples;
    settings.elites = (settings.candidates() / 5).max(1);
    match settings.problem() {
        None => Ok(settings),
        Some(problem) => anyhow::bail!("{samples} imagined futures: {problem}"),
    }
}

/// Rounds that show every scenario equally often, about twenty.
///
/// # Errors
/// If the words that ship are damaged.
pub fn default_rounds(common: &Common) -> anyhow::Result<u32> {
    let scenarios = Place::new(common.domain, Setting::Transfer)?
        .world
        .scenarios();
    Ok(scenarios * (20.0 / f64::from(scenarios)).round().max(1.0) as u32)
}

const HEADER: &str =
    "condition,percent,person,seed,round,steps,reward,success,collisions,visual,verbal,cost,nll";

/// All rounds of one person under one condition.
struct Piece<'a> {
    study: &'a Study,
    model: &'a Arc<SelfModel>,
    condition: Condition,
    percent: u32,
    person: u32,
    seed: u64,
}

impl Unit for Piece<'_> {
    fn keys(&self) -> Vec<String> {
        let name = self.condition.name();
        let Self {
            percent,
            person,
            seed,
            ..
        } = self;
        (0..self.study.rounds)
            .map(|round| format!("{name},{percent},{person},{seed},{round}"))
            .collect()
    }

    fn effort(&self) -> usize {
        match self.condition {
            Condition::Silent | Condition::Everything => 1,
            Condition::Ideal => 60,
            Condition::Model(_) => 40,
        }
    }

    fn rows(&self) -> anyhow::Result<Vec<String>> {
        let (study, model) = (self.study, self.model);
        let domain = study.common.domain;
        let mut place = Place::new(domain, Setting::Transfer)?;
        let mut person = place.person(self.person)?;
        let human = match self.condition {
            Condition::Silent | Condition::Everything => None,
            // The assistant's own human model is not asked where clones of the person are.
            Condition::Ideal => {
                let human = SelfHuman::new(Arc::clone(model), None, 0);
                Some(Box::new(human) as Box<dyn models::HumanModel>)
            }
            Condition::Model(kind) => {
                let lived =
                    SplitRounds::record(&mut place, Setting::Transfer, self.person, self.seed)?;
                let whose = [self.person, self.percent];
                let learned = learned(&study.common, kind, model, &lived, whose, self.seed)?;
                Some(learned.human(model))
            }
        };
        let mut assistant = human.map(|human| {
            let items = Arc::clone(&model.layout);
            let (settings, method) = (study.settings, study.method);
            Assistant::new(Arc::clone(model), human, settings, method, items)
        });
        let mut clones =
            (self.condition == Condition::Ideal).then(|| IdealPeople::new(&person, &model.layout));
        let seed = JUDGED + self.seed;
        self.keys()
            .into_iter()
            .enumerate()
            .map(|(round, key)| {
                let advice = match (&mut assistant, &mut clones) {
                    (None, _) if self.condition == Condition::Everything => Advice::Everything,
                    (None, _) => Advice::Silence,
                    (Some(assistant), None) => Advice::Planned(assistant),
                    (Some(assistant), Some(clones)) => Advice::Ideal(assistant, clones),
                };
                let r = play(&mut place.world, &mut person, advice, seed, round as u32)?;
                Ok(format!("{key},{}", cells(&r)))
            })
            .collect()
    }
}

fn cells(r: &RoundResult) -> String {
    format!(
        "{},{:.4},{},{},{},{},{:.4},{:.4}",
        r.steps,
        r.reward,
        u8::from(r.end == End::Success),
        r.collisions,
        r.visual_items,
        r.verbal_items,
        r.cost,
        r.surprise / r.steps.max(1) as f32
    )
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
        for &condition in &study.conditions {
            let percents: &[u32] = match condition.learns() {
                true => &study.percents,
                false => &[0],
            };
            units.extend(percents.iter().map(|&percent| Piece {
                study,
                model,
                condition,
                percent,
                person,
                seed,
            }));
        }
    }
    let name = common.name("communicate");
    let sheet = Sheet {
        out,
        name: &name,
        header: HEADER,
        key: 5,
        about: common.about(
            model,
            serde_json::json!({
                "planner": study.settings,
                "method": study.method.name(),
            }),
        ),
    };
    Ok(Report::new(study, &run_units(&sheet, &units, progress)?))
}
