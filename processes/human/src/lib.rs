//! The human-model process: follows what the person believes, z^H_k, and answers the planner's questions about what
//! imagined people would do.

mod person;
mod senses;

pub use person::{GROUPS, ModelledPerson};
pub use senses::{GridSenses, Senses};

use anyhow::{Result, ensure};
use domains::discrete::{Acting, SimulatedPerson};
use domains::highway::modalities;
use messages::{Display, DriverAction, HumanBelief, Sensed, topic};
use models::utterances::UtteranceTable;
use models::{HumanError, HumanModel, IdealHuman, Kind, SelfModel};
use runtime::{ClockMode, Node, Receive, RunArguments, Stamp, Wake, now_ns, run_process};
use scenario::{Scenario, scene_or_null};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HumanOptions {
    /// Which human model.
    pub kind: Kind,
    /// The self-model's file.
    pub model: PathBuf,
    /// The file of what was learned of the person: implants, or the policy of `bc` and `sqil`.
    #[serde(default)]
    pub implants: Option<PathBuf>,
    /// The simulated person whose own model `ideal` is.
    #[serde(default)]
    pub person: Option<Acting>,
    /// Highway or gridworld; as JSON, the gridworld's scene under `gridworld`.
    #[serde(default, rename = "gridworld", with = "scene_or_null")]
    pub scenario: Scenario,
    /// Seed of the run, for models by which it is chance what people perceive.
    #[serde(default)]
    pub seed: u64,
}

impl HumanOptions {
    /// Reads the model that these options name.
    ///
    /// # Errors
    /// If a file is missing, damaged, or not what the kind needs.
    pub fn load(&self) -> Result<Box<dyn HumanModel>> {
        if let Scenario::Gridworld(scene) = &self.scenario {
            let layout = models::words::layout_of(scene)?;
            if self.kind == Kind::Ideal {
                let person = self.person.as_ref().ok_or(HumanError::Nobody)?;
                let words = models::words::shipped(scene.domain())?;
                let person = SimulatedPerson::of(scene, person, &words)?;
                return Ok(Box::new(IdealHuman::new(person, layout.actions.rows())));
            }
            let model = Arc::new(SelfModel::load(&self.model, layout)?);
            let file = self.implants.as_deref();
            return Ok(models::load_human(file, self.kind, &model)?);
        }
        ensure!(
            self.kind != Kind::Ideal,
            "human model `ideal` is for the gridworlds: of a driver on the highway there is none"
        );
        let model = SelfModel::load(&self.model, modalities::layout())?;
        let file = self.implants.as_deref().filter(|_| self.kind.learns());
        Ok(models::load_human(file, self.kind, &Arc::new(model))?)
    }
}

/// Joins the run and models the person until it ends.
///
/// # Errors
/// If a file cannot be used, or the run cannot be joined or is lost; the launcher is told.
pub fn run(arguments: &RunArguments, options: &HumanOptions) -> Result<()> {
    run_process(arguments, |node| {
        let (model, seed) = (options.load()?, options.seed);
        match &options.scenario {
            Scenario::Highway(()) => attend(
                node,
                ModelledPerson::new(model, UtteranceTable::shipped()?, seed),
            ),
            Scenario::Gridworld(scene) => {
                let layout = models::words::layout_of(scene)?;
                attend(
                    node,
                    ModelledPerson::new(model, GridSenses { layout }, seed),
                )
            }
        }
    })
}

/// As [`run`], with any human model of the highway that is in memory already.
///
/// # Errors
/// As [`run`].
pub fn run_with(arguments: &RunArguments, model: Box<dyn HumanModel>) -> Result<()> {
    run_process(arguments, |node| {
        attend(
            node,
            ModelledPerson::new(model, UtteranceTable::shipped()?, 0),
        )
    })
}

fn attend<S: Senses>(node: &mut Node, mut person: ModelledPerson<S>) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let receive = Receive::in_clock(node.arguments().clock);
    let mut displays = node
        .input::<Display>(topic::DISPLAY, receive)?
        .once_in(node.arguments().clock);
    let mut world = node.input::<S::Sensed>(S::Sensed::TOPIC, receive)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let mut questions = node.request_server()?;
    let beliefs = node.output::<HumanBelief>(topic::HUMAN_BELIEF)?;

    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    // A step begins with its display, the last of its inputs: until then questions start from the step before.
    while node.wait(&mut [&mut displays, questions.source()], None)? != Wake::Stop {
        questions.serve_all(node, |question, answer| person.answer(question, answer))?;
        if !displays.take()? {
            continue;
        }
        let Some(display) = displays.message() else {
            continue;
        };
        let (episode, step) = (display.header.episode, display.header.step);
        let deadline = if lockstep { None } else { Some(now_ns()) };
        match node.wait_step(&mut [&mut world], episode, step, deadline)? {
            Wake::Stop => break,
            // The display is older than what is left of its frames, for one that joined late.
            Wake::Passed => continue,
            Wake::Message | Wake::Deadline => {}
        }
        if step > 0
            && person.follows(episode)
            && node.wait_step(&mut [&mut actions], episode, step - 1, deadline)? == Wake::Stop
        {
            break;
        }
        let (Some(sensed), Some(header)) = (world.message(), world.header()) else {
            continue;
        };
        ensure!(
            sensed.measure() == person.measure(),
            "{}: domain, visual and verbal numbers are {:?}, the human model's are {:?}",
            S::Sensed::TOPIC,
            sensed.measure(),
            person.measure()
        );
        beliefs.send_with(Stamp::of(header), |out| {
            person.observe(sensed, display, actions.message(), out)
        })?;
        node.end_step();
    }
    Ok(())
}
