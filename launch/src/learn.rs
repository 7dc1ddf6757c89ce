//! Learning what a person sees and does: `mirror demos`, `mirror train human`, and what `mirror up` does at its start for
//! a person that nothing was learned of yet.

use crate::cli::{DemosArguments, Setting, TrainHumanArguments};
use crate::failure::Failure;
use crate::inputs;
use crate::screen::Progress;
use anyhow::{Context, Result, anyhow};
use domains::highway::{Person, Scene};
use driver::Driving;
use models::{Implants, Kind, SelfModel};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use training::demonstrations::{Demonstrations, record_in};
use training::implants::{Settings, learn};

/// Seed of demonstrations: never the rounds that are driven or scored with what was learned from them.
pub const DEMONSTRATION_SEED: u64 = 0x6465_6d6f;
/// Rounds that `mirror up` learns from: each of the six cases once.
const ROUNDS: usize = 6;

/// The command that this program was called with, for the metadata of the files that it makes.
pub fn command_line() -> String {
    let words: Vec<_> = std::env::args_os()
        .skip(1)
        .map(|word| word.to_string_lossy().into_owned())
        .collect();
    format!("mirror {}", words.join(" "))
}

/// `mirror demos`: records rounds of a simulated person without communication.
pub fn demos(arguments: &DemosArguments) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let out = inputs::writable("--out", &arguments.out)?;
        let Driving::Simulated(person) =
            inputs::driver(&format!("sim:{}", arguments.person))?.driving
        else {
            return Err(anyhow!(
                "--person {}: not a simulated person",
                arguments.person
            ));
        };
        let name = match arguments.setting {
            Setting::Original => "highway-clear",
            Setting::Transfer => "highway-fog",
        };
        Ok((out, person, Scene::builtin(name)?))
    };
    let (out, person, scene) = plan().map_err(Failure::refused)?;
    let mut demonstrations = record_in(
        Arc::new(scene),
        &person,
        arguments.seed,
        0,
        arguments.rounds,
    )
    .context("the scene's road")?;
    demonstrations.source = command_line();
    demonstrations.save(&out).map_err(anyhow::Error::from)?;
    let steps: usize = demonstrations
        .rounds
        .iter()
        .map(|round| round.steps.len())
        .sum();
    let collided = demonstrations
        .rounds
        .iter()
        .filter(|round| round.collided)
        .count();
    println!(
        "{}: {} rounds, {steps} steps, {collided} collisions",
        out.display(),
        demonstrations.rounds.len()
    );
    Ok(ExitCode::SUCCESS)
}

/// `mirror train human`: learns implants from demonstrations, and nothing else.
pub fn train_human(arguments: &TrainHumanArguments) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let out = inputs::writable("--out", &arguments.out)?;
        let kind = inputs::human("--kind", &arguments.kind)?;
        let (_, model) = inputs::self_model(arguments.self_model.as_deref())?;
        Ok((out, kind, model, Demonstrations::load(&arguments.demos)?))
    };
    let (out, kind, model, demonstrations) = plan().map_err(Failure::refused)?;
    let progress = Progress::new(
        "learning",
        (Settings::default().iterations * Settings::default().starts_m.len()) as u64,
    );
    let settings = Settings {
        seed: arguments.seed,
        ..Settings::default()
    };
    let learned = learn(
        &model,
        kind,
        &demonstrations,
        &settings,
        |iteration, loss| {
            progress.at(iteration as u64, &format!("loss {loss:.4}"));
        },
    );
    progress.finish();
    let learned = learned
        .with_context(|| arguments.demos.display().to_string())
        .map_err(Failure::refused)?;
    models::checkpoint::save_implants(&out, &learned.implants, &model, &command_line())
        .map_err(anyhow::Error::from)?;
    let last = learned.losses.last().copied().unwrap_or(f32::NAN);
    println!(
        "{}: learned from {} rounds, last loss {last:.4}",
        out.display(),
        demonstrations.rounds.len()
    );
    Ok(ExitCode::SUCCESS)
}

/// Learns a simulated person's implants from rounds on the highway in this scene's fog, without communication.
///
/// # Errors
/// When the rounds are too short to learn from.
pub fn at_start(scene: &Scene, person: &Person, kind: Kind, model: &SelfModel) -> Result<Implants> {
    // What a person sees depends on the fog; recorded traffic offers one short round, the highway as many as are needed.
    let mut highway = Scene {
        fog: scene.fog,
        ..Scene::default()
    };
    if scene.course.is_none() {
        highway = scene.clone();
    }
    let demonstrations = record_in(Arc::new(highway), person, DEMONSTRATION_SEED, 0, ROUNDS)
        .context("the scene's road")?;
    let settings = Settings::default();
    let text = format!(
        "learning what person {} sees and does from {ROUNDS} rounds",
        person.id
    );
    let progress = Progress::new(&text, iterations(&settings));
    let learned = learn(
        model,
        kind,
        &demonstrations,
        &settings,
        |iteration, loss| {
            progress.at(iteration as u64, &format!("loss {loss:.4}"));
        },
    );
    progress.finish();
    Ok(learned.context("learning the human model")?.implants)
}

/// Steps of learning, from all the starts that are tried.
fn iterations(settings: &Settings) -> u64 {
    (settings.iterations * settings.starts_m.len()) as u64
}

/// Writes implants where the processes of a run find them.
///
/// # Errors
/// Names the file.
pub fn save(path: &Path, implants: &Implants, model: &SelfModel) -> Result<()> {
    Ok(models::checkpoint::save_implants(
        path,
        implants,
        model,
        &command_line(),
    )?)
}
