//! Learning what a person sees and does: `mirror demos`, `mirror train human`, and what `mirror up` does at its start for
//! a person that nothing was learned of yet.

use crate::cli::{DemosArguments, Setting, TrainHumanArguments};
use crate::console::out;
use crate::failure::Failure;
use crate::gridworld;
use crate::inputs;
use crate::screen::Progress;
use anyhow::{Context, Result, anyhow, ensure};
use domains::highway::{Person, Scene, modalities};
use driver::Driving;
use models::{Kind, SelfModel};
use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, OnceLock};
use training::config::{self, HighwayConfig};
use training::demonstrations::{Demonstrations, record_in};
use training::implants::{Settings, learn};
use training::policies::{self, Expert, Learned};

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
    if let Some(domain) = arguments.domain.gridworld() {
        return gridworld::learn::demos(arguments, domain);
    }
    let plan = || -> Result<_> {
        let out = inputs::writable("--out", &arguments.out)?;
        let Driving::Simulated(person) = inputs::driver(&format!("sim:{}", arguments.person))?
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
    out!(
        "{}: {} rounds, {steps} steps, {collided} collisions",
        out.display(),
        demonstrations.rounds.len()
    );
    Ok(ExitCode::SUCCESS)
}

/// `mirror train human`: learns implants or a policy from demonstrations.
pub fn train_human(arguments: &TrainHumanArguments) -> Result<ExitCode, Failure> {
    if let Some(domain) = arguments.domain.gridworld() {
        return gridworld::learn::train_human(arguments, domain);
    }
    let config = HighwayConfig::load(modalities::NAME, arguments.config.as_deref());
    let config = config.map_err(Failure::refused)?;
    if arguments.print_config {
        out!("{}", config.to_toml().trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let plan = || -> Result<_> {
        let out = arguments.out.as_deref().context("--out: which file?")?;
        let out = inputs::writable("--out", out)?;
        let demos = arguments.demos.as_deref().context("--demos: which file?")?;
        let kind = inputs::human("--kind", &arguments.kind)?;
        ensure!(
            arguments.original.is_none(),
            "--original: on the highway an expert's rounds in clear weather stand in for these"
        );
        let (_, model) = inputs::self_model(arguments.self_model.as_deref())?;
        Ok((out, demos, kind, model, Demonstrations::load(demos)?))
    };
    let (out, demos, kind, model, demonstrations) = plan().map_err(Failure::refused)?;
    let said = learn_to(
        &out,
        kind,
        &demonstrations,
        &model,
        &config,
        arguments.seed,
        "learning",
    )
    .with_context(|| demos.display().to_string())
    .map_err(Failure::refused)?;
    let lengths = demonstrations.rounds.iter().map(|round| round.steps.len());
    let least = match kind {
        Kind::Bc => 1,
        Kind::Sqil => config.sqil.window,
        _ => config.implants.least_steps(&demonstrations),
    };
    let rounds = rounds_in_words(lengths, least);
    out!("{}: learned from {rounds}; {said}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// How many rounds of these lengths were learned from, and how many were not because they are empty or hold fewer than `least`
/// steps: `6 rounds`, or `1 round, 3 empty`.
pub fn rounds_in_words(lengths: impl Iterator<Item = usize>, least: usize) -> String {
    let (mut used, mut empty, mut short) = (0_usize, 0_usize, 0_usize);
    for length in lengths {
        match length {
            0 => empty += 1,
            _ if length < least => short += 1,
            _ => used += 1,
        }
    }
    let mut words = format!("{used} {}", if used == 1 { "round" } else { "rounds" });
    if empty > 0 {
        words += &format!(", {empty} empty");
    }
    if short > 0 {
        words += &format!(", {short} of fewer than {least} steps");
    }
    words
}

/// Learns what a simulated person sees and does from rounds on the highway in this scene's fog, without communication, and
/// writes it to `path`.
///
/// # Errors
/// When the rounds are too short to learn from, or the file cannot be written.
pub fn at_start(
    scene: &Scene,
    person: &Person,
    kind: Kind,
    model: &SelfModel,
    path: &Path,
) -> Result<()> {
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
    let text = format!(
        "learning what person {} sees and does from {ROUNDS} rounds",
        person.id
    );
    learn_to(
        path,
        kind,
        &demonstrations,
        model,
        config::highway(),
        0,
        &text,
    )
    .context("learning the human model")?;
    Ok(())
}

/// Learns what `kind` takes and writes it to `path`; gives a word about how it went.
fn learn_to(
    path: &Path,
    kind: Kind,
    demonstrations: &Demonstrations,
    model: &SelfModel,
    config: &HighwayConfig,
    seed: u64,
    title: &str,
) -> Result<String> {
    match kind {
        Kind::Bc | Kind::Sqil => policy_to(path, kind, demonstrations, config, seed, title),
        _ => implant_to(path, kind, demonstrations, model, config, seed, title),
    }
}

fn implant_to(
    path: &Path,
    kind: Kind,
    demonstrations: &Demonstrations,
    model: &SelfModel,
    config: &HighwayConfig,
    seed: u64,
    title: &str,
) -> Result<String> {
    let settings = Settings {
        seed,
        ..config.implants
    };
    let iterations = settings.iterations * settings.starts_m.len();
    let progress = Progress::new(title, iterations as u64);
    let learned = learn(model, kind, demonstrations, &settings, |iteration, loss| {
        progress.at(iteration as u64, &format!("loss {loss:.4}"));
    });
    progress.finish();
    let learned = learned?;
    learned.implants.save(path, model, 0, &command_line())?;
    let last = learned.losses.last().copied().unwrap_or(f32::NAN);
    Ok(format!("last loss {last:.4}"))
}

fn policy_to(
    path: &Path,
    kind: Kind,
    demonstrations: &Demonstrations,
    config: &HighwayConfig,
    seed: u64,
    title: &str,
) -> Result<String> {
    let progress = OnceLock::new();
    let learned = policies::learn(
        kind,
        demonstrations,
        &Expert::default(),
        config,
        seed,
        &|done, most, word| {
            let progress = progress.get_or_init(|| Progress::new(title, most));
            progress.at(done, word);
        },
    );
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    let Learned { person, about } = learned?;
    let notes = [("mirror.learning", about.clone())];
    let layout = modalities::layout();
    person.save(path, kind, &layout, &command_line(), &notes)?;
    Ok(about)
}

#[cfg(test)]
mod tests {
    use super::rounds_in_words;

    #[test]
    fn what_was_not_learned_from_is_said() {
        let said = |lengths: &[usize], least| rounds_in_words(lengths.iter().copied(), least);
        assert_eq!(said(&[3, 7], 1), "2 rounds");
        assert_eq!(said(&[0, 7, 0, 0], 1), "1 round, 3 empty");
        assert_eq!(
            said(&[0, 7, 70], 20),
            "1 round, 1 empty, 1 of fewer than 20 steps"
        );
        assert_eq!(said(&[], 1), "0 rounds");
    }
}
