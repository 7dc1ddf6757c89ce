//! What a run will do, resolved and checked before anything starts.

use super::control_socket::Replacement;
use crate::cli::{Clock, UpArguments};
use crate::inputs;
use crate::learned::{self, ImplantSource};
use crate::place::{self, NamedPerson, NamedScene, Who};
use crate::process::NAMES;
use anyhow::{Context, Result, bail, ensure};
use models::Kind;
use models::SelfModel;
use planner::PlannerMethod;
use planning::Settings;
use recorder::setup::Setup;
use runtime::{ClockMode, RunArguments};
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

/// A run that can be started.
#[derive(Clone)]
pub struct RunPlan {
    /// Where.
    pub scene: NamedScene,
    /// Who drives.
    pub driver: NamedPerson,
    /// The model of the person.
    pub human: Kind,
    /// Whose own model `ideal` is: who drove when the human model was chosen.
    pub modelled: Who,
    /// How to decide.
    pub planner: PlannerMethod,
    /// Settings of the planner.
    pub settings: Settings,
    /// The robot's self-model: its file, and itself.
    pub self_model: (PathBuf, Arc<SelfModel>),
    /// What the human model learned of the person.
    pub implants: ImplantSource,
    /// Episodes to drive.
    pub episodes: u32,
    /// Seed.
    pub seed: u64,
    /// How time passes.
    pub clock: ClockMode,
    /// The recording's file.
    pub record: Option<PathBuf>,
    /// The summary's file.
    pub summary: Option<PathBuf>,
    /// Name of the process set.
    pub instance: String,
    /// Other programs in place of our own processes.
    pub exec: BTreeMap<&'static str, String>,
    /// See [`RunArguments::spin_us`].
    pub spin_us: u32,
    /// Print no events.
    pub quiet: bool,
    /// Whether a page shows the run live.
    pub view: bool,
    /// Where pages are served.
    pub listen: Option<SocketAddr>,
    /// Seconds after which a round is void that nobody drives any more.
    pub void_after_s: f64,
    /// Times in a row that a process is started again.
    pub restarts: u32,
    /// How long a process may be silent before it hangs, in ns; see [`super::supervise`].
    pub hang_limit_ns: u64,
    /// What a recording says about the run's beginning; a recorder that is started again repeats it.
    pub(super) setup: OnceCell<Setup>,
}

impl RunPlan {
    /// Resolves the command line.
    ///
    /// # Errors
    /// Names the option, or the file and the place in it, that cannot be used.
    pub fn resolve(arguments: &UpArguments) -> Result<Self> {
        let (scene, driver) = place::scene(&arguments.scene, arguments.fog, &arguments.driver)?;
        let settings = place::settings(&scene)?;
        let human = inputs::human("--human", &arguments.human)?;
        let self_model = place::self_model(arguments.self_model.as_deref(), &scene.scenario)?;
        let exec = replacements(&arguments.exec)?;
        let implants = match &arguments.implants {
            // Nobody would use what was learned.
            None if exec.contains_key("human") => ImplantSource::None,
            given => learned::implants(given.as_deref(), human, &driver.who, &self_model.1)?,
        };
        inputs::agree(arguments.planner.name(), human)?;
        let option = |name, path: &Option<PathBuf>| {
            path.as_deref()
                .map(|path| inputs::writable(name, path))
                .transpose()
        };
        Ok(Self {
            settings,
            human,
            modelled: driver.who.clone(),
            self_model,
            implants,
            planner: arguments.planner,
            episodes: arguments.episodes,
            seed: arguments.seed,
            clock: clock(arguments.clock, &scene, &driver)?,
            record: (arguments.record.as_deref())
                .map(|path| inputs::writable_file("--record", path))
                .transpose()?,
            summary: option("--summary", &arguments.summary)?,
            instance: arguments
                .instance
                .clone()
                .unwrap_or_else(|| format!("up-{}", std::process::id())),
            exec,
            spin_us: arguments.spin,
            quiet: arguments.quiet,
            view: arguments.view,
            listen: arguments.listen.map(|listen| listen.0),
            void_after_s: arguments.void_after,
            restarts: arguments.restarts,
            hang_limit_ns: (arguments.hang_limit * 1e9) as u64,
            setup: OnceCell::new(),
            scene,
            driver,
        })
    }

    /// Learns what is still to be learned of the person, before the run starts.
    ///
    /// # Errors
    /// When that is not possible.
    pub fn learn(&mut self, run: &RunArguments) -> Result<()> {
        let ImplantSource::Learn(who) = &self.implants else {
            return Ok(());
        };
        let model = &self.self_model.1;
        // A file of its own for each: a process that is to be replaced may have to be started again.
        let path = (0..)
            .map(|n| run.directory().join(format!("learned.{n}.safetensors")))
            .find(|path| !path.exists())
            .context("a name for what is learned")?;
        learned::learn_at_start(&self.scene.scenario, who, self.human, model, &path)?;
        self.implants = ImplantSource::File(path);
        Ok(())
    }

    /// Whether [`RunPlan::learn`] has something to learn.
    pub fn must_learn(&self) -> bool {
        matches!(self.implants, ImplantSource::Learn(_))
    }

    /// The same run with one process of another kind.
    ///
    /// # Errors
    /// Names what is not known, or cannot be changed while the run goes on.
    pub fn changed(&self, place: usize, asked: &Replacement) -> Result<Self> {
        let name = NAMES[place];
        let mut changed = self.clone();
        ensure!(
            asked.implants.is_none() || name == "human",
            "--implants is for human models"
        );
        match &asked.exec {
            Some(command) => {
                ensure!(!command.trim().is_empty(), "--exec: no command");
                changed.exec.insert(name, command.clone());
            }
            None => {
                changed.exec.remove(name);
            }
        }
        ensure!(
            name != "driver" || !self.driver.has_cockpit,
            "swap driver: a person is at the wheel, at a page that this driver serves"
        );
        let learned_by = |human| {
            learned::implants(
                asked.implants.as_deref(),
                human,
                &self.driver.who,
                &self.self_model.1,
            )
        };
        let Some(kind) = asked.kind.as_deref().filter(|kind| *kind != "same") else {
            // While another program stood in for it, our own may have had no reason to learn.
            if name == "human" && asked.exec.is_none() && changed.implants == ImplantSource::None {
                changed.implants = learned_by(changed.human)?;
            }
            return Ok(changed);
        };
        match name {
            "human" => {
                changed.human = inputs::human("swap human", kind)?;
                changed.modelled = self.driver.who.clone();
                changed.implants = learned_by(changed.human)?;
            }
            "planner" => {
                changed.planner = inputs::planner(kind)?;
            }
            "driver" => {
                changed.driver = place::who(kind, &self.scene)?;
                ensure!(
                    !changed.driver.has_cockpit,
                    "swap driver {kind}: a world waits for a person at the wheel from its start, or not at all"
                );
            }
            _ => bail!("swap {name} {kind}: there is only `same`, or another program by --exec"),
        }
        let is_ours = |name: &str| !changed.exec.contains_key(name);
        if is_ours("human") && is_ours("planner") {
            inputs::agree(changed.planner.name(), changed.human)?;
        }
        Ok(changed)
    }

    /// Whether somebody plans what to communicate.
    pub fn plans(&self) -> bool {
        self.planner != PlannerMethod::None || self.exec.contains_key("planner")
    }

    /// What a running set says of itself.
    pub fn status(&self) -> serde_json::Value {
        serde_json::json!({
            "scene": self.scene.name,
            "driver": self.kind_of_process("driver"),
            "human": self.kind_of_process("human"),
            "planner": self.kind_of_process("planner"),
            "seed": self.seed,
            "clock": self.clock,
            "episodes": self.episodes,
        })
    }

    /// What kind of process stands at a place.
    pub fn kind_of(&self, place: usize) -> String {
        self.kind_of_process(NAMES[place])
    }

    /// What kind of process stands in for one of our own, or which of our own it is.
    pub fn kind_of_process(&self, name: &str) -> String {
        if let Some(command) = self.exec.get(name) {
            return command.clone();
        }
        match name {
            "human" => self.human.name().to_owned(),
            "planner" => self.planner.name().to_owned(),
            "driver" => self.driver.name.clone(),
            _ => name.to_owned(),
        }
    }
}

/// How time passes: as asked for; for a person on the highway at its own pace.
fn clock(asked: Option<Clock>, scene: &NamedScene, driver: &NamedPerson) -> Result<ClockMode> {
    let needs_real_time = driver.has_cockpit && scene.gridworld().is_none();
    Ok(match asked {
        Some(Clock::Lockstep) if needs_real_time => {
            bail!("--driver browser --clock lockstep: a person drives on the highway in real time")
        }
        Some(Clock::Realtime) => ClockMode::RealTime,
        None if needs_real_time => ClockMode::RealTime,
        Some(Clock::Lockstep) | None => ClockMode::Lockstep,
    })
}

/// `--exec PROCESS=COMMAND`, each process at most once.
fn replacements(given: &[String]) -> Result<BTreeMap<&'static str, String>> {
    let mut exec = BTreeMap::new();
    for text in given {
        let (process, command) = text
            .split_once('=')
            .with_context(|| format!("--exec {text}: expected PROCESS=COMMAND"))?;
        let known = NAMES.iter().find(|name| **name == process);
        let name = *known.with_context(|| {
            format!(
                "--exec {text}: no process {process:?}; there are {}",
                NAMES.join(", ")
            )
        })?;
        ensure!(!command.trim().is_empty(), "--exec {text}: no command");
        ensure!(
            exec.insert(name, command.to_owned()).is_none(),
            "--exec {text}: {name} is replaced twice"
        );
    }
    Ok(exec)
}
