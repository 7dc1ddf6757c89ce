//! What users name on the command line of a gridworld, resolved and checked before anything starts.

use crate::inputs::model_file;
use anyhow::{Context, Result};
use domains::discrete::{Discrete, Domain, Scene, Setting, SimulatedPerson, Words, World};
use models::SelfModel;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The words of a domain that ship with the project.
///
/// # Errors
/// If the shipped table is damaged.
pub fn words(domain: Domain) -> Result<Words> {
    Ok(models::words::shipped(domain)?)
}

/// The world of a scene, with the words that ship.
///
/// # Errors
/// If the words do not fit.
pub fn world(scene: &Scene) -> Result<World> {
    Ok(World::new(scene, &words(scene.domain())?)?)
}

/// The file of a domain's self-model that ships.
pub fn shipped_self_model(domain: Domain) -> PathBuf {
    models::shipped::path(match domain {
        Domain::Driving => models::shipped::DRIVING,
        Domain::SearchRescue => models::shipped::SEARCH_RESCUE,
        Domain::BombDefusal => models::shipped::BOMB_DEFUSAL,
    })
}

/// The robot's self-model of a domain: the given file or the one that ships.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn self_model(domain: Domain, given: Option<&Path>) -> Result<(PathBuf, Arc<SelfModel>)> {
    let path = match given {
        Some(path) => model_file(path)?,
        None => shipped_self_model(domain),
    };
    let layout = world(&Scene::of(domain, Setting::Original))?
        .layout()
        .clone();
    let model = SelfModel::load(&path, Arc::new(layout))?;
    Ok((path, Arc::new(model)))
}

/// The simulated person of this number, or of this file, in a scene.
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
