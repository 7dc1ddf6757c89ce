//! Which models a replay asks: the recorded ones, or those that the command line names in their place.

use crate::cli::ReplayArguments;
use crate::inputs;
use crate::place::{self, ItemNames};
use crate::up::setup::{IMPLANTS, PERSON, SELF_MODEL};
use anyhow::{Context, Result, anyhow, bail};
use driver::{Acting, Driving};
use models::Kind;
use recorder::setup::{ModelFile, Setup, digest};
use replay::Drive;
use scenario::Scenario;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// What a replay runs, and what may be expected of it.
pub struct Resolved {
    /// What the recording was set up from.
    pub setup: Setup,
    /// For the belief process.
    pub belief: belief::BeliefOptions,
    /// For the human-model process.
    pub human: human::HumanOptions,
    /// For the planner process.
    pub planner: planner::PlannerOptions,
    /// Recorded human model and planner, by name.
    pub then: (String, String),
    /// Digest of the self-model that is used.
    pub self_model: String,
    /// Why the decisions need not be the recorded ones; where empty, they must be.
    pub differences: Vec<String>,
    /// What the user should know before the replay starts.
    pub warnings: Vec<String>,
    /// Where implants come from that the recording does not have.
    implants: ImplantsFrom,
    /// The simulated person, of a file that the recording has attached.
    person: Option<Acting>,
}

enum ImplantsFrom {
    None,
    Given(PathBuf),
    Attached,
    Learn,
}

impl Resolved {
    /// Takes recorded options and what stands in for them.
    ///
    /// # Errors
    /// Names the recording and what it lacks, the option, or the model file and both its digests.
    pub fn new(arguments: &ReplayArguments, drive: &Drive) -> Result<Self> {
        let file = arguments.recording.display();
        let setup = drive.found.setup.clone().with_context(|| {
            format!(
                "{file}: has no metadata \"{}\" at its head that says what it was set up from: recorded by an earlier version",
                recorder::setup::METADATA
            )
        })?;
        let mut belief: belief::BeliefOptions = options(&setup, "belief", &arguments.recording)?;
        let mut human: human::HumanOptions = options(&setup, "human", &arguments.recording)?;
        let mut planner: planner::PlannerOptions =
            options(&setup, "planner", &arguments.recording)?;
        let recorded_method = planner.method;
        let then = (
            human.kind.name().to_owned(),
            planner.method.name().to_owned(),
        );
        let mut differences = Vec::new();
        let mut warnings = Vec::new();

        let kind = match &arguments.human {
            Some(text) => inputs::human("--human", text)?,
            None => human.kind,
        };
        let domain = match &belief.scenario {
            Scenario::Highway(()) => None,
            Scenario::Gridworld(scene) => Some(scene.domain()),
        };
        let shipped = inputs::shipped_self_model(domain);
        let (model, self_model) =
            self_model(arguments, &setup, &shipped, &mut differences, &mut warnings)?;
        belief.model.clone_from(&model);
        human.model.clone_from(&model);
        planner.model = Some(model);
        planner.method = arguments.planner.unwrap_or(planner.method);
        if kind != human.kind {
            differences.push(format!(
                "human model {} instead of {}",
                kind.name(),
                human.kind.name()
            ));
        }
        if planner.method != recorded_method {
            differences.push(format!(
                "planner {} instead of {}",
                planner.method.name(),
                then.1
            ));
        }
        let implants = match (&arguments.implants, kind) {
            (Some(_), kind) if !kind.learns() => {
                bail!("--implants: human model `{}` has none", kind.name())
            }
            (Some(path), _) => {
                let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
                let now = digest(&path).context("--implants")?;
                if setup
                    .files
                    .get(IMPLANTS)
                    .is_none_or(|then| then.blake3 != now)
                {
                    differences.push(format!("implants {}", path.display()));
                }
                ImplantsFrom::Given(path)
            }
            (None, Kind::Ideal) => {
                if human.person.is_none() {
                    human.person = Some(acting(&setup, &arguments.recording)?);
                }
                ImplantsFrom::None
            }
            (None, Kind::Myself) => ImplantsFrom::None,
            (None, kind) if kind == human.kind => ImplantsFrom::Attached,
            (None, _) => ImplantsFrom::Learn,
        };
        human.kind = kind;
        if arguments.human.is_some() || arguments.planner.is_some() {
            inputs::agree(planner.method.name(), kind)?;
        }
        for process in ["belief", "human", "planner"] {
            let is_replaced = match process {
                "human" => arguments.human.is_some(),
                "planner" => arguments.planner.is_some(),
                _ => false,
            };
            if let Some(command) = setup.exec.get(process) {
                if !is_replaced {
                    warnings.push(format!(
                        "{process} was the program `{command}`: our own stands in for it"
                    ));
                }
                differences.push(format!("{process} was the program `{command}`"));
            }
        }
        if setup.clock != "lockstep" {
            differences.push(
                "recorded in real time: then, processes took the newest message that was there; here, each takes its step's"
                    .to_owned(),
            );
        }
        for (topic, (episode, step)) in &drive.successions {
            differences.push(format!(
                "another process took over on /{topic} at episode {episode} step {step}: swapped, or started again"
            ));
        }
        Ok(Self {
            setup,
            belief,
            human,
            planner,
            then,
            self_model,
            differences,
            warnings,
            implants,
            person: None,
        })
    }

    /// Puts the human model's implants where its process finds them, and checks that it can use them.
    ///
    /// # Errors
    /// Names the file that cannot be used, or what is missing to learn from.
    pub fn provide(&mut self, drive: &Drive, directory: &Path) -> Result<()> {
        let person = directory.join("person.toml");
        if self.detach(PERSON, drive, &person)? {
            self.person = Some(Acting::File(person));
        } else if self.setup.files.contains_key(PERSON) {
            let recording = drive.parts[0].file.display();
            bail!("{recording}: has no attachment \"{PERSON}\", the simulated person's file");
        }
        if self.human.person.is_some() && self.person.is_some() {
            self.human.person.clone_from(&self.person);
        }
        let path = directory.join("implants.safetensors");
        self.human.implants = match &self.implants {
            ImplantsFrom::None => None,
            ImplantsFrom::Given(path) => Some(path.clone()),
            ImplantsFrom::Attached => {
                if !self.detach(IMPLANTS, drive, &path)? {
                    let recording = drive.parts[0].file.display();
                    bail!("{recording}: has no attachment \"{IMPLANTS}\"; give --implants");
                }
                Some(path)
            }
            ImplantsFrom::Learn => {
                self.learn(&drive.parts[0].file, &path)?;
                Some(path)
            }
        };
        self.human.load()?;
        Ok(())
    }

    /// Writes what the recording has attached under this name to `path`; false where it has nothing.
    fn detach(&self, name: &str, drive: &Drive, path: &Path) -> Result<bool> {
        let recording = drive.parts[0].file.display();
        let known = self.setup.files.get(name);
        let bytes = drive.found.attachments.get(name);
        let (Some(known), Some(bytes)) = (known, bytes) else {
            return Ok(false);
        };
        let now = blake3::hash(bytes).to_hex().to_string();
        if now != known.blake3 {
            bail!(
                "{recording}: attachment \"{name}\" is damaged: its digest is {now}, not {}",
                known.blake3
            );
        }
        files::write(path, bytes)?;
        Ok(true)
    }

    /// Learns what the recorded person sees and does, as `mirror up` would have at its start.
    fn learn(&self, recording: &Path, path: &Path) -> Result<()> {
        let kind = self.human.kind;
        let world: world::WorldOptions = options(&self.setup, "world", recording)?;
        let driver: driver::DriverOptions = options(&self.setup, "driver", recording)?;
        let scenario = match world.scenario {
            Scenario::Highway(mut road) => {
                if let Some(file) = &road.recording {
                    let recorded = domains::commonroad::Scenario::read(file)?;
                    road.scene.course = Some(std::sync::Arc::new(recorded.course(road.seat)?));
                }
                Scenario::Highway(road)
            }
            Scenario::Gridworld(scene) => {
                let layout = models::words::layout_of(&scene)?;
                Scenario::Gridworld((scene, layout))
            }
        };
        let who = match driver.scenario {
            Scenario::Highway(seat) => Scenario::Highway(seat.person),
            Scenario::Gridworld(seat) => {
                Scenario::Gridworld(self.person.clone().unwrap_or(seat.person))
            }
        };
        if let Scenario::Highway(Driving::Recorded(_)) = who {
            bail!(
                "--human {} needs --implants for a recorded driver",
                kind.name()
            );
        }
        let (_, model) = place::self_model(Some(&self.human.model), &scenario)?;
        crate::learned::learn_at_start(&scenario, &who, kind, &model, path)
    }

    /// What a page needs to show the recording.
    ///
    /// # Errors
    /// When the recording does not say where it was made, or the road cannot be built.
    pub fn view_options(&self, recording: &Path) -> Result<view::ViewOptions> {
        let world: world::WorldOptions = options(&self.setup, "world", recording)?;
        let stage = match world.scenario {
            Scenario::Highway(mut road) => {
                if let Some(file) = &road.recording {
                    let recorded = domains::commonroad::Scenario::read(file)?;
                    road.scene.course = Some(std::sync::Arc::new(recorded.course(road.seat)?));
                }
                Scenario::Highway(view::Road::of(&road.scene)?)
            }
            Scenario::Gridworld(scene) => Scenario::Gridworld(scene),
        };
        let (human, planner) = &self.then;
        let about = [
            ("driver", self.setup.driver.clone()),
            ("human", human.clone()),
            ("planner", planner.clone()),
            ("human_now", self.human.kind.name().to_owned()),
            ("planner_now", self.planner.method.name().to_owned()),
        ];
        let about = about.map(|(key, value)| (key.to_owned(), value));
        Ok(view::ViewOptions {
            stage,
            model: self.human.model.clone(),
            implants: self.human.implants.clone(),
            about: about.into(),
        })
    }

    /// What can be communicated.
    pub fn items(&self) -> Result<ItemNames> {
        Ok(match &self.belief.scenario {
            Scenario::Highway(()) => ItemNames::SECTORS,
            Scenario::Gridworld(scene) => ItemNames::of(&*models::words::layout_of(scene)?),
        })
    }
}

/// The simulated person of a recording, whose own model `ideal` is.
fn acting(setup: &Setup, recording: &Path) -> Result<Acting> {
    let driver: driver::DriverOptions = options(setup, "driver", recording)?;
    match driver.scenario {
        Scenario::Gridworld(seat) => Ok(seat.person),
        Scenario::Highway(_) => bail!(
            "--human ideal: the simulated person's own model is for the gridworlds; of a driver on the highway there is none"
        ),
    }
}

/// A process's recorded options.
fn options<T: DeserializeOwned>(setup: &Setup, process: &str, recording: &Path) -> Result<T> {
    let place = || {
        format!(
            "{}: metadata \"{}\": options of {process}",
            recording.display(),
            recorder::setup::METADATA
        )
    };
    let options = setup
        .options
        .get(process)
        .with_context(|| format!("{}: there are none", place()))?;
    serde_json::from_value(options.clone()).with_context(place)
}

/// The self-model's file and digest: the given one, or the recorded one as it was then.
fn self_model(
    arguments: &ReplayArguments,
    setup: &Setup,
    shipped: &Path,
    differences: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<(PathBuf, String)> {
    let recorded = setup.files.get(SELF_MODEL).with_context(|| {
        format!(
            "{}: metadata \"{}\": does not name the self-model",
            arguments.recording.display(),
            recorder::setup::METADATA
        )
    })?;
    if let Some(path) = &arguments.self_model {
        let path = inputs::model_file(path)?;
        let now = inputs::model_digest(&path).context("--self-model")?;
        if now != recorded.blake3 {
            differences.push(format!(
                "self-model {} instead of {}",
                path.display(),
                recorded.path.display()
            ));
        }
        return Ok((path, now));
    }
    for path in [recorded.path.as_path(), shipped] {
        if inputs::model_digest(path).is_ok_and(|now| now == recorded.blake3) {
            return Ok((path.to_owned(), recorded.blake3.clone()));
        }
    }
    let ModelFile {
        path, blake3: then, ..
    } = recorded;
    match inputs::model_digest(path) {
        Ok(now) if arguments.human.is_some() => {
            let text = format!(
                "self-model {} has changed since: digest {then} then, {now} now",
                path.display()
            );
            warnings.push(text.clone());
            differences.push(text);
            Ok((path.clone(), now))
        }
        Ok(now) => Err(anyhow!(
            "self-model {} has changed since the recording: its digest was {then} then and is {now} now; name another file with --self-model, or another --human to compare with",
            path.display()
        )),
        Err(error) => Err(anyhow!(
            "self-model of the recording, digest {then}: {error}; name another file with --self-model"
        )),
    }
}
