//! What a human model learned of the person: given as a file, or learned before the run starts.

use crate::learn;
use crate::place::{RunScenario, Who};
use anyhow::{Context, Result, bail, ensure};
use driver::{Acting, Driving};
use models::{Kind, SelfModel, load_human};
use scenario::Scenario;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where what a human model learned of the person comes from: implants, or the policy of `bc` and `sqil`.
#[derive(Clone, Debug, PartialEq)]
pub enum ImplantSource {
    /// It has none.
    None,
    /// A file that was read and fits.
    File(PathBuf),
    /// They are learned from this person's rounds before the run starts.
    Learn(Box<Who>),
}

/// What the human model learned of this person: the given file, the one that ships, or what is still to be learned.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn implants(
    given: Option<&Path>,
    human: Kind,
    who: &Who,
    model: &Arc<SelfModel>,
) -> Result<ImplantSource> {
    ensure!(
        human != Kind::Ideal || matches!(who, Scenario::Gridworld(_)),
        "--human ideal: the simulated person's own model is for the gridworlds; of a driver on the highway there is none"
    );
    if !human.learns() {
        let name = human.name();
        ensure!(given.is_none(), "--implants: human model `{name}` has none");
        return Ok(ImplantSource::None);
    }
    let Some(path) = given else {
        if let Scenario::Highway(Driving::Recorded(car)) = who {
            bail!(
                "--human {} needs --implants for recorded driver {car}; or use --human self",
                human.name()
            );
        }
        return Ok(ImplantSource::Learn(Box::new(who.clone())));
    };
    let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
    load_human(Some(&path), human, model)?;
    Ok(ImplantSource::File(path))
}

/// Learns what `kind` takes of this person, from rounds without communication, and writes it to `path`.
///
/// # Errors
/// When that is not possible.
pub fn learn_at_start(
    scenario: &RunScenario,
    who: &Who,
    kind: Kind,
    model: &Arc<SelfModel>,
    path: &Path,
) -> Result<()> {
    match (scenario, who) {
        (Scenario::Highway(road), Scenario::Highway(Driving::Simulated(person))) => {
            learn::driver_at_start(&road.scene, person, kind, model, path)
        }
        (Scenario::Gridworld((scene, _)), Scenario::Gridworld(acting)) => {
            let person = match acting {
                Acting::Shipped(id) => id.to_string(),
                Acting::File(file) => file.display().to_string(),
            };
            learn::person_at_start(scene, &person, kind, model, path)
        }
        _ => bail!(
            "there is nobody to learn human model `{}` from",
            kind.name()
        ),
    }
}
