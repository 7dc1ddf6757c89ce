//! `mirror train self` of a gridworld: the robot's self-model from nothing, or on from where an earlier run stopped.

use crate::cli::TrainSelfArguments;
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use crate::learn::command_line;
use crate::screen::Progress;
use crate::train_self::{checkpoint_of, open, outputs, write};
use anyhow::{Context, Result, ensure};
use domains::discrete::{Discrete, Domain, End, Scene, Setting, World};
use std::path::PathBuf;
use std::process::ExitCode;
use training::config::GridworldConfig;
use training::discrete::{Actor, Lived, Rollout, Settings, Trainer};

/// Checkpoints of a whole run; writing one takes a fraction of a second.
const CHECKPOINTS: u32 = 12;
/// Seed of the rounds by which the finished model is judged: training never saw them.
const EVALUATION_SEED: u64 = 0x6a75_6467;
/// Rounds of each scenario by which it is judged.
const EVALUATED: u32 = 10;

/// Runs `mirror train self` in a gridworld.
pub fn train_self(arguments: &TrainSelfArguments, domain: Domain) -> Result<ExitCode, Failure> {
    let (world, config) = configured(arguments, domain).map_err(Failure::refused)?;
    if arguments.print_config {
        out!("{}", config.to_toml().trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let (mut trainer, out) = prepare(arguments, &world, &config).map_err(Failure::refused)?;
    let checkpoint = checkpoint_of(&out);
    let mut metrics = arguments
        .metrics
        .as_deref()
        .map(|path| open(path, arguments.resume))
        .transpose()?;
    let every = trainer.settings.phases.div_ceil(CHECKPOINTS).max(1);
    let progress = Progress::new("phases", u64::from(trainer.settings.phases));
    while !trainer.is_done() {
        let phase = trainer.phase();
        if let Some((path, file)) = &mut metrics {
            write(file, &phase).with_context(|| path.display().to_string())?;
        }
        let reward = phase.policy_reward.or(phase.expert_reward);
        let word = format!(
            "reward {:.2}, −ELBO {:.2}",
            reward.unwrap_or(f32::NAN),
            phase.loss
        );
        progress.at(u64::from(trainer.phase), &word);
        // The first, too, so that a run that ends soon can be continued.
        if trainer.phase == 1 || trainer.phase.is_multiple_of(every) || trainer.is_done() {
            trainer
                .save(&checkpoint, &command_line())
                .map_err(anyhow::Error::from)?;
        }
    }
    progress.finish();
    trainer
        .model
        .save(&out, &command_line())
        .map_err(anyhow::Error::from)?;
    let rounds = EVALUATED * world.scenarios();
    out!(
        "{}: {} phases; over {rounds} new rounds {}; the expert {}",
        out.display(),
        trainer.phase,
        judged(
            &world,
            &trainer,
            Actor::Greedy {
                explore: 0.0,
                limited: false
            },
            rounds
        ),
        judged(&world, &trainer, Actor::Expert { slips: 0.0 }, rounds),
    );
    out!(
        "{}: continue with --resume and more --phases, or delete it",
        checkpoint.display()
    );
    Ok(ExitCode::SUCCESS)
}

/// How an actor does on rounds that nobody learned from, in words.
fn judged(world: &World, trainer: &Trainer, actor: Actor, rounds: u32) -> String {
    let mut rollout = Rollout::new(world.clone(), &trainer.model);
    let lived: Vec<Lived> = (0..rounds)
        .map(|round| {
            let lived = rollout.episode(&trainer.model, actor, EVALUATION_SEED, round);
            lived.0
        })
        .collect();
    let n = lived.len().max(1) as f32;
    let reward = lived.iter().map(|l| l.reward).sum::<f32>() / n;
    let done = lived.iter().filter(|l| l.end == End::Success).count();
    format!(
        "earns {reward:.2} a round and ends {:.0} % in success",
        100.0 * done as f32 / n
    )
}

/// The world to learn in, and the settings that were asked for.
fn configured(arguments: &TrainSelfArguments, domain: Domain) -> Result<(World, GridworldConfig)> {
    ensure!(
        arguments.episodes.is_none(),
        "--episodes: only the highway counts in episodes, a gridworld's training in --phases"
    );
    let world = inputs::world(&Scene::of(domain, Setting::Original))?;
    let mut config = GridworldConfig::load(domain.name(), arguments.config.as_deref())?;
    config.sizes(world.layout(), arguments.config.as_deref())?;
    if let Some(phases) = arguments.phases {
        config.self_model.phases = phases;
    }
    Ok((world, config))
}

fn prepare(
    arguments: &TrainSelfArguments,
    world: &World,
    config: &GridworldConfig,
) -> Result<(Trainer, PathBuf)> {
    let out = outputs(arguments)?;
    let mut trainer = if arguments.resume {
        Trainer::resume(&checkpoint_of(&out), world.clone())?
    } else {
        let settings = Settings {
            seed: arguments.seed.unwrap_or_default(),
            ..config.self_model
        };
        let sizes = config.sizes(world.layout(), arguments.config.as_deref())?;
        Trainer::with_sizes(world.clone(), settings, sizes)
    };
    if let Some(phases) = arguments.phases {
        trainer.settings.phases = phases;
    }
    Ok((trainer, out))
}
