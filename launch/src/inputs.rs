//! What users name on the command line (people, models, files), resolved and checked before anything starts; scenes, and what
//! depends on them, stand in [`crate::place`].

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use domains::discrete::{Discrete, Domain, Scene, Setting, SimulatedPerson, Words, World};
use domains::highway::{Person, modalities};
use driver::Driving;
use models::{Kind, SelfModel};
use planner::PlannerMethod;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Seed of demonstrations: never the rounds that are driven or scored with what was learned from them.
pub const DEMONSTRATION_SEED: u64 = 0x6465_6d6f;

/// Reads who drives on the highway: `sim:ID`, `sim:FILE` or `recorded:ID`.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn driver(text: &str) -> Result<Driving> {
    Ok(match text.split_once(':') {
        Some(("sim", id)) if id.bytes().all(|byte| byte.is_ascii_digit()) => {
            let number = id
                .parse()
                .with_context(|| format!("--driver {text}: not a number"))?;
            Driving::Simulated(Person::builtin(number).with_context(|| format!("--driver {text}"))?)
        }
        Some(("sim", file)) => Driving::Simulated(Person::load(Path::new(file))?),
        Some(("recorded", id)) => {
            let car = id
                .parse()
                .with_context(|| format!("--driver {text}: {id:?} is no car's number"))?;
            Driving::Recorded(car)
        }
        _ => bail!("--driver {text}: expected sim:ID, sim:FILE.toml, recorded:ID or browser"),
    })
}

/// The kind of human model of that name.
///
/// # Errors
/// Lists the kinds that there are.
pub fn human(option: &str, text: &str) -> Result<Kind> {
    let kinds = || Kind::ALL.map(Kind::name).join(", ");
    Kind::parse(text).with_context(|| {
        format!(
            "{option} {text}: there is no such human model; there are {}",
            kinds()
        )
    })
}

/// Whether this planner can ask this human model.
///
/// # Errors
/// Names both.
pub fn agree(planner: &str, human: Kind) -> Result<()> {
    ensure!(
        planner != PlannerMethod::Kl.name() || human.is_self_model(),
        "--planner kl --human {}: belief matching needs a human model whose belief is of the robot's kind: mirror, mirror-p or self",
        human.name()
    );
    Ok(())
}

/// The way to decide of that name.
///
/// # Errors
/// Lists the ways that there are.
pub fn planner(text: &str) -> Result<PlannerMethod> {
    PlannerMethod::from_str(text, false).map_err(|_| {
        let kinds: Vec<_> = PlannerMethod::value_variants()
            .iter()
            .map(|kind| kind.name())
            .collect();
        anyhow!(
            "there is no planner {text:?}; there are {}",
            kinds.join(", ")
        )
    })
}

/// A path that something can be written to: its directory exists, and what is there is a file, a device or a pipe.
///
/// # Errors
/// Names the path.
pub fn writable(option: &str, path: &Path) -> Result<PathBuf> {
    let path = std::path::absolute(path).with_context(|| format!("{option} {}", path.display()))?;
    files::check(&path).with_context(|| option.to_owned())?;
    Ok(path)
}

/// A path that a file can be written to which is read again, or continued, later: no device and no pipe.
///
/// # Errors
/// Names the path.
pub fn writable_file(option: &str, path: &Path) -> Result<PathBuf> {
    let path = std::path::absolute(path).with_context(|| format!("{option} {}", path.display()))?;
    files::check_regular(&path).with_context(|| option.to_owned())?;
    Ok(path)
}

/// The robot's self-model of a gridworld, or of the highway: the given file or the one that ships.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn self_model(
    domain: Option<Domain>,
    given: Option<&Path>,
) -> Result<(PathBuf, Arc<SelfModel>)> {
    let path = match given {
        Some(path) => model_file(path)?,
        None => shipped_self_model(domain),
    };
    let layout = match domain {
        None => modalities::layout(),
        Some(domain) => {
            let world = world(&Scene::of(domain, Setting::Original))?;
            Arc::new(world.layout().clone())
        }
    };
    let model = SelfModel::load(&path, layout)?;
    Ok((path, Arc::new(model)))
}

/// The file of the self-model that ships, of a gridworld or of the highway.
pub fn shipped_self_model(domain: Option<Domain>) -> PathBuf {
    models::shipped::path(match domain {
        None => models::shipped::HIGHWAY,
        Some(Domain::Driving) => models::shipped::DRIVING,
        Some(Domain::SearchRescue) => models::shipped::SEARCH_RESCUE,
        Some(Domain::BombDefusal) => models::shipped::BOMB_DEFUSAL,
    })
}

/// The words of a domain that ship with the project.
///
/// # Errors
/// If the shipped table is damaged.
pub fn words(domain: Domain) -> Result<Words> {
    Ok(models::words::shipped(domain)?)
}

/// The world of a gridworld's scene, with the words that ship.
///
/// # Errors
/// If the words do not fit.
pub fn world(scene: &Scene) -> Result<World> {
    Ok(World::new(scene, &words(scene.domain())?)?)
}

/// The simulated person of this number, or of this file, in a gridworld's scene.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn person(option: &str, text: &str, scene: &Scene) -> Result<SimulatedPerson> {
    let words = words(scene.domain())?;
    if !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()) {
        let id = text
            .parse()
            .with_context(|| format!("{option} {text}: not a number"))?;
        return SimulatedPerson::builtin(scene, id, &words)
            .with_context(|| format!("{option} {text}"));
    }
    Ok(SimulatedPerson::load(scene, Path::new(text), &words)?)
}

/// A model's file as every process finds it: by its whole path, or by its name if it ships.
///
/// # Errors
/// Names the file.
pub fn model_file(path: &Path) -> Result<PathBuf> {
    match models::shipped::is_name(path) {
        true => Ok(path.to_owned()),
        false => std::path::absolute(path).with_context(|| path.display().to_string()),
    }
}

/// BLAKE3 of a model's bytes, as 64 hexadecimal digits: of a file, or of one that ships.
///
/// # Errors
/// The system's, with the file's name.
pub fn model_digest(path: &Path) -> std::io::Result<String> {
    match models::shipped::bytes(path) {
        Some(bytes) => Ok(blake3::hash(bytes).to_hex().to_string()),
        None => recorder::setup::digest(path),
    }
}
