//! What users name on the command line (people, models, files), resolved and checked before anything starts; scenes, and what
//! depends on them, stand in [`crate::place`].

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use domains::highway::Person;
use driver::Driving;
use models::{Kind, SelfModel};
use planner::PlannerMethod;
use std::path::{Path, PathBuf};

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
        _ => bail!("--driver {text}: expected sim:ID, sim:FILE.toml or recorded:ID"),
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

/// The robot's self-model of the highway: the given file or the one that ships.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn self_model(given: Option<&Path>) -> Result<(PathBuf, SelfModel)> {
    let path = match given {
        Some(path) => model_file(path)?,
        None => models::shipped::path(models::shipped::HIGHWAY),
    };
    let model = SelfModel::load(&path, domains::highway::modalities::layout())?;
    Ok((path, model))
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
