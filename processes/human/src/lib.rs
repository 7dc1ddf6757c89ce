//! The human-model process: follows what the person believes, z^H_k, and answers the planner's questions about what
//! imagined people would do (DESIGN §3).

mod person;

pub use person::{GROUPS, Person};

use anyhow::{Result, bail};
use messages::{Display, DriverAction, HumanBelief, LidarFrame, topic};
use models::utterances::UtteranceTable;
use models::{HumanModel, Kind, RecurrentHuman, SelfHuman};
use runtime::{ClockMode, Node, Receive, RunArguments, Stamp, Wake, now_ns};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// What the process needs besides its place in the run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Which human model.
    pub kind: Kind,
    /// The self-model's file.
    pub model: PathBuf,
    /// The file of what was learned of the person: implants, or the policy of `bc` and `sqil`.
    #[serde(default)]
    pub implants: Option<PathBuf>,
}

impl Options {
    /// Reads the model that these options name.
    ///
    /// # Errors
    /// If a file is missing, damaged, or not what the kind needs.
    pub fn load(&self) -> Result<Box<dyn HumanModel>> {
        if !self.kind.is_self_model() {
            let Some(path) = &self.implants else {
                bail!(
                    "human model `{}` needs its policy: none given",
                    self.kind.name()
                );
            };
            let (policy, visible_m) = models::recurrent_file::load_policy(path, self.kind)?;
            let human = RecurrentHuman::new(self.kind, Arc::new(policy), visible_m);
            return Ok(Box::new(human));
        }
        let model = models::checkpoint::load_self_model(&self.model)?;
        let implants = match (self.kind, &self.implants) {
            (Kind::Myself, _) => None,
            (kind, None) => bail!("human model `{}` needs implants: none given", kind.name()),
            (kind, Some(path)) => {
                let implants = models::checkpoint::load_implants(path, &model)?;
                if implants.has_policy() != (kind == Kind::Mirror) {
                    let has = if implants.has_policy() { "a" } else { "no" };
                    bail!(
                        "{}: has {has} policy implant, which is not human model `{}`",
                        path.display(),
                        kind.name()
                    );
                }
                Some(implants)
            }
        };
        Ok(Box::new(SelfHuman::new(Arc::new(model), implants)))
    }
}

/// Joins the run and models the person until it ends.
///
/// # Errors
/// If a file cannot be used, or the run cannot be joined or is lost; the launcher is told.
pub fn run(arguments: &RunArguments, options: &Options) -> Result<()> {
    join(arguments, |node| attend(node, options.load()?))
}

/// As [`run`], with any human model that is in memory already.
///
/// # Errors
/// As [`run`].
pub fn run_with(arguments: &RunArguments, model: Box<dyn HumanModel>) -> Result<()> {
    join(arguments, |node| attend(node, model))
}

fn join(arguments: &RunArguments, work: impl FnOnce(&mut Node) -> Result<()>) -> Result<()> {
    let mut node = Node::join(arguments)?;
    let result = work(&mut node);
    match &result {
        Ok(()) => node.finish()?,
        Err(error) => node.fail(&format!("{error:#}"))?,
    }
    result
}

fn attend(node: &mut Node, model: Box<dyn HumanModel>) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let receive = if lockstep {
        Receive::InOrder
    } else {
        Receive::Newest
    };
    let mut displays = node.input::<Display>(topic::DISPLAY, receive)?;
    let mut lidar = node.input::<LidarFrame>(topic::LIDAR, receive)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let mut questions = node.request_server()?;
    let beliefs = node.output::<HumanBelief>(topic::HUMAN_BELIEF)?;
    let mut person = Person::new(model, UtteranceTable::shipped()?);

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
        match node.wait_step(&mut [&mut lidar], episode, step, deadline)? {
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
        let Some(frame) = lidar.message() else {
            continue;
        };
        let taken = actions
            .message()
            .map_or([0.0; 2], |a| [a.throttle, a.steer]);
        beliefs.send_with(Stamp::of(&frame.header), |out| {
            person.observe(frame, display, taken, out)
        })?;
        node.end_step();
    }
    Ok(())
}
