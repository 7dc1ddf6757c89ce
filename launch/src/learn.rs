//! Learning what a person sees and does: `mirror demos`, `mirror train human`, and what `mirror up` does at its start for
//! a person that nothing was learned of yet.

use crate::cli::{DemosArguments, Setting as Asked, TrainHumanArguments};
use crate::console::out;
use crate::failure::Failure;
use crate::inputs::{self, DEMONSTRATION_SEED};
use crate::screen::Progress;
use anyhow::{Context, Result, anyhow, ensure};
use domains::discrete::{self, Discrete, Setting};
use domains::highway::{self, Person};
use driver::Driving;
use models::{Kind, SelfModel};
use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, OnceLock};
use training::config::Config;
use training::people::{Demonstrations, learn, wants_original};
use training::rounds::{Round, Rounds};

/// Rounds on the highway that `mirror up` learns from: each of the six cases once.
const HIGHWAY_ROUNDS: usize = 6;
/// Rounds in a gridworld that `mirror up` learns from, at least.
const GRIDWORLD_ROUNDS: u32 = 8;

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
    let setting = match arguments.setting {
        Asked::Original => Setting::Original,
        Asked::Transfer => Setting::Transfer,
    };
    let plan = || -> Result<_> {
        let out = inputs::writable("--out", &arguments.out)?;
        let (seed, count) = (arguments.seed, arguments.rounds);
        let rounds = match arguments.domain.gridworld() {
            Some(domain) => {
                let scene = discrete::Scene::of(domain, setting);
                play(&scene, &arguments.person, seed, u32::try_from(count)?)?
            }
            None => drive(setting, &arguments.person, seed, count)?,
        };
        Ok((out, rounds))
    };
    let (out, mut rounds) = plan().map_err(Failure::refused)?;
    rounds.source = command_line();
    rounds.save(&out).map_err(anyhow::Error::from)?;
    let count = rounds.rounds.len();
    let result = match arguments.domain.gridworld() {
        Some(_) => {
            let reward: f32 = rounds.rounds.iter().flat_map(|r| &r.reward).sum();
            format!("mean reward {:.2}", reward / count.max(1) as f32)
        }
        None => {
            let collided = rounds.rounds.iter().filter(|round| round.ended);
            format!("{} collisions", collided.count())
        }
    };
    out!(
        "{}: {count} rounds, {} steps, {result}",
        out.display(),
        rounds.steps()
    );
    Ok(ExitCode::SUCCESS)
}

/// Lets a simulated person, by number or file, play rounds 0, 1, … of `seed` in a gridworld's scene without an assistant.
fn play(scene: &discrete::Scene, person: &str, seed: u64, rounds: u32) -> Result<Rounds> {
    let mut world = inputs::world(scene)?;
    let mut person = inputs::person("--person", person, scene)?;
    Ok(Rounds::record(&mut world, &mut person, seed, 0, rounds))
}

/// Lets a simulated driver, by number or file, drive rounds 0, 1, … of `seed` on the highway without an assistant.
fn drive(setting: Setting, person: &str, seed: u64, rounds: usize) -> Result<Rounds> {
    let Driving::Simulated(driver) = inputs::driver(&format!("sim:{person}"))? else {
        return Err(anyhow!("--person {person}: not a simulated person"));
    };
    let scene = Arc::new(highway::Scene::builtin(match setting {
        Setting::Original => "highway-clear",
        Setting::Transfer => "highway-fog",
    })?);
    Rounds::record_drives_in(scene, &driver, seed, 0, rounds).context("the scene's road")
}

/// `mirror train human`: learns implants or a policy from demonstrations.
pub fn train_human(arguments: &TrainHumanArguments) -> Result<ExitCode, Failure> {
    let (domain, file) = (arguments.domain.name(), arguments.config.as_deref());
    let config = Config::load(domain, file).map_err(Failure::refused)?;
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
            kind.learns(),
            "--kind {}: learns nothing of a person",
            kind.name()
        );
        let domain = arguments.domain.gridworld();
        let (_, model) = inputs::self_model(domain, arguments.self_model.as_deref())?;
        let rounds = Rounds::load(demos, &model.layout)?;
        let original = match &arguments.original {
            None => None,
            Some(path) => {
                ensure!(
                    domain.is_some(),
                    "--original: on the highway an expert's rounds in clear weather stand in for these"
                );
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
    let demonstrations = Demonstrations {
        original: original.as_ref(),
        ..Demonstrations::of(&rounds)
    };
    let seed = arguments.seed;
    let said = learn_to(
        &out,
        kind,
        &model,
        &demonstrations,
        &config,
        seed,
        "learning",
    )
    .with_context(|| demos.display().to_string())
    .map_err(Failure::refused)?;
    let all = std::iter::once(&rounds).chain(&original);
    let lengths = all.flat_map(|rounds| rounds.rounds.iter().map(Round::len));
    let least = match kind.is_self_model() {
        true => config.implants.skip + 1,
        false => 1,
    };
    let rounds = rounds_in_words(lengths, least);
    out!("{}: learned from {rounds}; {said}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// How many rounds of these lengths were learned from, and how many were not because they are empty or hold fewer than `least`
/// steps: `6 rounds`, or `1 round, 3 empty`.
fn rounds_in_words(lengths: impl Iterator<Item = usize>, least: usize) -> String {
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
pub fn driver_at_start(
    scene: &highway::Scene,
    person: &Person,
    kind: Kind,
    model: &Arc<SelfModel>,
    path: &Path,
) -> Result<()> {
    // What a person sees depends on the fog; recorded traffic offers one short round, the highway as many as are needed.
    let mut highway = highway::Scene {
        fog: scene.fog,
        ..highway::Scene::default()
    };
    if scene.course.is_none() {
        highway = scene.clone();
    }
    let scene = Arc::new(highway);
    let rounds = Rounds::record_drives_in(scene, person, DEMONSTRATION_SEED, 0, HIGHWAY_ROUNDS)
        .context("the scene's road")?;
    let title = format!(
        "learning what person {} sees and does from {HIGHWAY_ROUNDS} rounds",
        person.id
    );
    let demonstrations = Demonstrations::of(&rounds);
    let config = Config::shipped(rounds.domain);
    learn_to(path, kind, model, &demonstrations, &config, 0, &title)
        .context("learning the human model")?;
    Ok(())
}

/// Learns what a simulated person sees and does from rounds in this gridworld without communication (each scenario equally
/// often) and writes it to `path`; for `bc` and `sqil` in the transfer setting, from as many rounds of the original one too.
/// `person`: number or file.
///
/// # Errors
/// Names the person; or the file cannot be written.
pub fn person_at_start(
    scene: &discrete::Scene,
    person: &str,
    kind: Kind,
    model: &Arc<SelfModel>,
    path: &Path,
) -> Result<()> {
    let scenarios = inputs::world(scene)?.scenarios();
    let count = scenarios * GRIDWORLD_ROUNDS.div_ceil(scenarios);
    let rounds = play(scene, person, DEMONSTRATION_SEED, count)?;
    let original = wants_original(kind, scene.setting())
        .then(|| {
            let scene = scene.clone().in_setting(Setting::Original);
            play(&scene, person, DEMONSTRATION_SEED, count)
        })
        .transpose()?;
    let title = format!("learning what person {person} sees and does from {count} rounds");
    let demonstrations = Demonstrations {
        original: original.as_ref(),
        ..Demonstrations::of(&rounds)
    };
    let config = Config::shipped(rounds.domain);
    learn_to(path, kind, model, &demonstrations, &config, 0, &title)
        .context("learning the human model")?;
    Ok(())
}

/// Learns what `kind` takes and writes it to `path`; gives a word about how it went.
fn learn_to(
    path: &Path,
    kind: Kind,
    model: &Arc<SelfModel>,
    demonstrations: &Demonstrations,
    config: &Config,
    seed: u64,
    title: &str,
) -> Result<String> {
    let progress = OnceLock::new();
    let tell = |done, most, word: &str| {
        let progress = progress.get_or_init(|| Progress::new(title, most));
        progress.at(done, word);
    };
    let learned = learn(kind, model, demonstrations, config, seed, &tell);
    if let Some(progress) = progress.get() {
        progress.finish();
    }
    let learned = learned?;
    learned.save(path, model, &command_line())?;
    Ok(learned.about().to_owned())
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
