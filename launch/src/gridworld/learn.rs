//! Learning what a person sees and does in a gridworld: `mirror demos` and `mirror train human` with `--domain`, and what
//! `mirror up` does at its start for a person that nothing was learned of yet.

use super::inputs;
use crate::cli::{DemosArguments, Setting as Asked, TrainHumanArguments};
use crate::console::out;
use crate::failure::Failure;
use crate::inputs::{human, writable};
use crate::learn::{DEMONSTRATION_SEED, command_line, rounds_in_words};
use crate::screen::Progress;
use anyhow::{Context, Result, ensure};
use domains::discrete::{Discrete, Domain, Scene, Setting};
use models::Kind;
use models::SelfModel;
use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;
use training::config::GridworldConfig;
use training::discrete::people::{Lessons, learn, wants_original};
use training::discrete::{Round, Rounds};

/// Rounds that `mirror up` learns from, at least.
const LEAST_ROUNDS: u32 = 8;

/// The setting that was asked for.
pub fn setting(asked: Asked) -> Setting {
    match asked {
        Asked::Original => Setting::Original,
        Asked::Transfer => Setting::Transfer,
    }
}

/// Lets a simulated person, by number or file, play rounds 0, 1, … of `seed` in a scene without an assistant.
///
/// # Errors
/// Names the person.
pub fn record(scene: &Scene, person: &str, seed: u64, rounds: u32) -> Result<Rounds> {
    let mut world = inputs::world(scene)?;
    let mut person = inputs::person("--person", person, scene)?;
    Ok(Rounds::record(&mut world, &mut person, seed, 0, rounds))
}

/// `mirror demos`.
pub fn demos(arguments: &DemosArguments, domain: Domain) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let out = writable("--out", &arguments.out)?;
        let scene = Scene::of(domain, setting(arguments.setting));
        let rounds = u32::try_from(arguments.rounds)?;
        let rounds = record(&scene, &arguments.person, arguments.seed, rounds)?;
        Ok((out, rounds))
    };
    let (out, mut rounds) = plan().map_err(Failure::refused)?;
    rounds.source = command_line();
    rounds.save(&out).map_err(anyhow::Error::from)?;
    let reward: f32 = rounds.rounds.iter().flat_map(|r| &r.reward).sum();
    out!(
        "{}: {} rounds, {} steps, mean reward {:.2}",
        out.display(),
        rounds.rounds.len(),
        rounds.steps(),
        reward / rounds.rounds.len().max(1) as f32
    );
    Ok(ExitCode::SUCCESS)
}

/// `mirror train human`.
pub fn train_human(arguments: &TrainHumanArguments, domain: Domain) -> Result<ExitCode, Failure> {
    let config = GridworldConfig::load(domain.name(), arguments.config.as_deref());
    let config = config.map_err(Failure::refused)?;
    if arguments.print_config {
        out!("{}", config.to_toml().trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let plan = || -> Result<_> {
        let out = arguments.out.as_deref().context("--out: which file?")?;
        let out = writable("--out", out)?;
        let demos = arguments.demos.as_deref().context("--demos: which file?")?;
        let kind = human("--kind", &arguments.kind)?;
        ensure!(
            kind.learns(),
            "--kind {}: learns nothing of a person",
            kind.name()
        );
        let (_, model) = inputs::self_model(domain, arguments.self_model.as_deref())?;
        let rounds = Rounds::load(demos, &model.layout)?;
        let original = match &arguments.original {
            None => None,
            Some(path) => {
                ensure!(
                    wants_original(kind, rounds.setting),
                    "--original: only bc and sqil learn from rounds of both settings, and only for the transfer setting"
                );
                let original = Rounds::load(path, &model.layout)?;
                ensure!(
                    original.setting == Setting::Original,
                    "--original {}: rounds of the transfer setting",
                    path.display()
                );
                Some(original)
            }
        };
        Ok((out, demos, kind, model, rounds, original))
    };
    let (out, demos, kind, model, rounds, original) = plan().map_err(Failure::refused)?;
    let said = learn_to(
        &out,
        kind,
        &model,
        &Lessons {
            rounds: &rounds,
            original: original.as_ref(),
            validation: None,
            sqil_phases: None,
            config: Some(&config),
        },
        arguments.seed,
        "learning",
    )
    .with_context(|| demos.display().to_string())
    .map_err(Failure::refused)?;
    let all = std::iter::once(&rounds).chain(&original);
    let lengths = all.flat_map(|rounds| rounds.rounds.iter().map(Round::len));
    let rounds = rounds_in_words(lengths, 1);
    out!("{}: learned from {rounds}; {said}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Learns what a simulated person sees and does from rounds in this scene without communication (each scenario equally often) and writes it
/// to `path`; for `bc` and `sqil` in the transfer setting, from as many rounds of the original one too. `person`: number or file.
///
/// # Errors
/// Names the person; or the file cannot be written.
pub fn at_start(
    scene: &Scene,
    person: &str,
    kind: Kind,
    model: &SelfModel,
    path: &Path,
) -> Result<()> {
    let scenarios = inputs::world(scene)?.scenarios();
    let count = scenarios * LEAST_ROUNDS.div_ceil(scenarios);
    let rounds = record(scene, person, DEMONSTRATION_SEED, count)?;
    let original = wants_original(kind, scene.setting())
        .then(|| {
            let scene = scene.clone().in_setting(Setting::Original);
            record(&scene, person, DEMONSTRATION_SEED, count)
        })
        .transpose()?;
    let title = format!("learning what person {person} sees and does from {count} rounds");
    let lessons = Lessons {
        rounds: &rounds,
        original: original.as_ref(),
        validation: None,
        sqil_phases: None,
        config: None,
    };
    learn_to(path, kind, model, &lessons, 0, &title).context("learning the human model")?;
    Ok(())
}

/// Learns what `kind` takes and writes it to `path`; gives a word about how it went.
///
/// # Errors
/// The rounds do not suffice, or the file cannot be written.
pub fn learn_to(
    path: &Path,
    kind: Kind,
    model: &SelfModel,
    lessons: &Lessons,
    seed: u64,
    title: &str,
) -> Result<String> {
    let progress = OnceLock::new();
    let learned = learn(kind, model, lessons, seed, &mut |done, most, word| {
        let progress = progress.get_or_init(|| Progress::new(title, most));
        progress.at(done, word);
    });
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    let learned = learned?;
    learned.save(path, model, &command_line())?;
    Ok(learned.about().to_owned())
}
