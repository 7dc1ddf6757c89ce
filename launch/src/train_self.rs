//! `mirror train self`: the robot's self-model from nothing, or on from where an earlier run stopped.

use crate::cli::TrainSelfArguments;
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use crate::learn::command_line;
use crate::screen::Progress;
use anyhow::{Context, Result};
use domains::discrete::{End, Setting};
use models::Sizes;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use training::config::Config;
use training::environment::{Environment, shipped};
use training::rollout::Actor;
use training::self_model::{SelfModelSettings, Trainer};

/// Checkpoints of a whole run; writing one takes a fraction of a second.
const CHECKPOINTS: u32 = 16;
/// Seed of the rounds by which the finished model is judged: training never saw them.
const EVALUATION_SEED: u64 = 0x6a75_6467;
/// Rounds by which it is judged on the highway, and in a gridworld, where they show each scenario ten times or more.
const EVALUATED: [u32; 2] = [30, 90];

/// Runs `mirror train self`.
pub fn train_self(arguments: &TrainSelfArguments) -> Result<ExitCode, Failure> {
    let plan = || -> Result<_> {
        let (domain, file) = (arguments.domain.name(), arguments.config.as_deref());
        let mut config = Config::load(domain, file)?;
        let environment = shipped(domain, Setting::Original)?;
        let sizes = config.sizes(environment.layout(), file)?;
        let phases = arguments.phases.unwrap_or(config.self_model.phases);
        config.self_model.phases = phases;
        Ok((config, environment, sizes))
    };
    let (config, environment, sizes) = plan().map_err(Failure::refused)?;
    if arguments.print_config {
        out!("{}", config.to_toml().trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let settings = SelfModelSettings {
        seed: arguments.seed.unwrap_or_default(),
        ..config.self_model
    };
    let (mut trainer, out) =
        prepare(arguments, environment, settings, sizes).map_err(Failure::refused)?;
    run(arguments, &mut trainer, &out)?;
    let rounds = EVALUATED[usize::from(arguments.domain.gridworld().is_some())];
    let policy = judged(&mut trainer, Actor::Mode, rounds);
    let expert = judged(&mut trainer, Actor::Expert { slips: 0.0 }, rounds);
    out!(
        "{}: {} phases; over {rounds} new rounds it {policy}; the expert {expert}",
        out.display(),
        trainer.phase,
    );
    out!(
        "{}: continue with --resume and more --phases, or delete it",
        checkpoint_of(&out).display()
    );
    Ok(ExitCode::SUCCESS)
}

fn prepare(
    arguments: &TrainSelfArguments,
    environment: Box<dyn Environment>,
    settings: SelfModelSettings,
    sizes: Sizes,
) -> Result<(Trainer, PathBuf)> {
    let out = outputs(arguments)?;
    let mut trainer = match arguments.resume {
        true => Trainer::resume(&checkpoint_of(&out), environment)?,
        false => Trainer::with_sizes(environment, settings, sizes),
    };
    trainer.settings.phases = arguments.phases.unwrap_or(trainer.settings.phases);
    Ok((trainer, out))
}

/// Trains to the end and writes the model, and now and then what is needed to continue.
fn run(arguments: &TrainSelfArguments, trainer: &mut Trainer, out: &Path) -> Result<()> {
    let checkpoint = checkpoint_of(out);
    let mut metrics = match &arguments.metrics {
        None => None,
        Some(path) => {
            let file: File = files::log(path, arguments.resume)?;
            Some((path, BufWriter::new(file)))
        }
    };
    let every = trainer.settings.phases.div_ceil(CHECKPOINTS).max(1);
    let progress = Progress::new("phases", u64::from(trainer.settings.phases));
    while !trainer.is_done() {
        let phase = trainer.phase();
        if let Some((path, file)) = &mut metrics {
            write(file, &phase).with_context(|| path.display().to_string())?;
        }
        let of_policy = phase.policy_reward.or(phase.limited_reward);
        let (who, reward) = match (of_policy, phase.expert_reward) {
            (Some(reward), _) => ("policy", reward),
            (None, reward) => ("expert", reward.unwrap_or(f32::NAN)),
        };
        let word = format!("{who} reward {reward:.2}, −ELBO {:.2}", phase.losses.loss);
        progress.at(u64::from(trainer.phase), &word);
        // The first, too, so that a run that ends soon can be continued.
        if trainer.phase == 1 || trainer.phase.is_multiple_of(every) || trainer.is_done() {
            trainer.save(&checkpoint, &command_line())?;
        }
    }
    progress.finish();
    trainer.model.save(out, &command_line())?;
    Ok(())
}

/// How an actor does on rounds that nobody learned from, in words.
fn judged(trainer: &mut Trainer, actor: Actor, rounds: u32) -> String {
    let lived = trainer.evaluate(actor, EVALUATION_SEED, rounds);
    let n = lived.len().max(1) as f32;
    let reward = lived.iter().map(|l| l.reward).sum::<f32>() / n;
    let share = |end: End| 100.0 * lived.iter().filter(|l| l.end == end).count() as f32 / n;
    format!(
        "earns {reward:.2} a round and ends {:.0} % in success, {:.0} % in a collision",
        share(End::Success),
        share(End::Collision)
    )
}

/// The model's file, once it is clear that it can be written, and what is written beside it, too.
///
/// # Errors
/// Names the option and the file.
fn outputs(arguments: &TrainSelfArguments) -> Result<PathBuf> {
    let out = arguments.out.as_deref().context("--out: which file?")?;
    let out = inputs::writable_file("--out", out)?;
    inputs::writable_file("--out", &checkpoint_of(&out))?;
    if let Some(metrics) = &arguments.metrics {
        inputs::writable("--metrics", metrics)?;
    }
    Ok(out)
}

/// Where a run keeps what it needs to continue.
fn checkpoint_of(out: &Path) -> PathBuf {
    out.with_extension("training.safetensors")
}

fn write(file: &mut BufWriter<File>, metrics: &impl Serialize) -> Result<()> {
    serde_json::to_writer(&mut *file, metrics)?;
    file.write_all(b"\n")?;
    Ok(file.flush()?)
}
