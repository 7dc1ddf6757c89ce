//! `mirror train self`: the robot's self-model from nothing, or on from where an earlier run stopped.

use crate::cli::TrainSelfArguments;
use crate::console::out;
use crate::failure::Failure;
use crate::gridworld;
use crate::inputs;
use crate::learn::command_line;
use crate::screen::Progress;
use anyhow::{Context, Result, ensure};
use domains::highway::{Scene, modalities};
use models::utterances::UtteranceTable;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use training::config::HighwayConfig;
use training::self_model::{Settings, Trainer};

/// Episodes from one checkpoint to the next.
const CHECKPOINT_EPISODES: u32 = 25;
/// Episodes that training never saw, driven by the finished policy.
const EVALUATED: u32 = 30;

/// Runs `mirror train self`.
pub fn train_self(arguments: &TrainSelfArguments) -> Result<ExitCode, Failure> {
    if let Some(domain) = arguments.domain.gridworld() {
        return gridworld::train_self::train_self(arguments, domain);
    }
    let config = configured(arguments).map_err(Failure::refused)?;
    if arguments.print_config {
        out!("{}", config.to_toml().trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let (mut trainer, out) = prepare(arguments, &config).map_err(Failure::refused)?;
    let checkpoint = checkpoint_of(&out);
    let mut metrics = arguments
        .metrics
        .as_deref()
        .map(|path| open(path, arguments.resume))
        .transpose()?;
    let progress = Progress::new("episodes", u64::from(trainer.settings.episodes));
    while trainer.episode < trainer.settings.episodes {
        let lived = trainer.episode();
        if let Some((path, file)) = &mut metrics {
            write(file, &lived).with_context(|| path.display().to_string())?;
        }
        let driver = if lived.expert { "expert" } else { "policy" };
        progress.at(
            u64::from(trainer.episode),
            &format!(
                "{driver} reward {:.1}, −ELBO {:.1}",
                lived.episode_reward, lived.loss
            ),
        );
        // The first, too, so that a run that ends soon can be continued.
        if trainer.episode == 1
            || trainer.episode % CHECKPOINT_EPISODES == 0
            || trainer.episode == trainer.settings.episodes
        {
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
    let (reward, collisions) = trainer.evaluate(EVALUATED);
    out!(
        "{}: {} episodes; over {EVALUATED} new ones the policy's mean reward is {reward:.1}, its collision rate {collisions:.2}",
        out.display(),
        trainer.episode,
    );
    out!(
        "{}: continue with --resume and more --episodes, or delete it",
        checkpoint.display()
    );
    Ok(ExitCode::SUCCESS)
}

/// The settings that were asked for.
fn configured(arguments: &TrainSelfArguments) -> Result<HighwayConfig> {
    ensure!(
        arguments.phases.is_none(),
        "--phases: only the gridworlds count in phases, the highway's training in --episodes"
    );
    let mut config = HighwayConfig::load(modalities::NAME, arguments.config.as_deref())?;
    config.sizes(&modalities::layout(), arguments.config.as_deref())?;
    if let Some(episodes) = arguments.episodes {
        config.self_model.episodes = episodes;
    }
    Ok(config)
}

fn prepare(arguments: &TrainSelfArguments, config: &HighwayConfig) -> Result<(Trainer, PathBuf)> {
    let out = outputs(arguments)?;
    let scene = Arc::new(Scene::builtin("highway-clear")?);
    let table = UtteranceTable::shipped()?;
    let mut trainer = if arguments.resume {
        Trainer::resume(&checkpoint_of(&out), scene, table)?
    } else {
        let settings = Settings {
            seed: arguments.seed.unwrap_or_default(),
            ..config.self_model
        };
        let sizes = config.sizes(&modalities::layout(), arguments.config.as_deref())?;
        Trainer::with_sizes(scene, table, settings, sizes)?
    };
    if let Some(episodes) = arguments.episodes {
        trainer.settings.episodes = episodes;
    }
    Ok((trainer, out))
}

/// The model's file, once it is clear that it can be written, and what is written beside it, too.
///
/// # Errors
/// Names the option and the file.
pub(crate) fn outputs(arguments: &TrainSelfArguments) -> Result<PathBuf> {
    let out = arguments.out.as_deref().context("--out: which file?")?;
    let out = inputs::writable_file("--out", out)?;
    inputs::writable_file("--out", &checkpoint_of(&out))?;
    if let Some(metrics) = &arguments.metrics {
        inputs::writable("--metrics", metrics)?;
    }
    Ok(out)
}

/// Where a run keeps what it needs to continue.
pub(crate) fn checkpoint_of(out: &Path) -> PathBuf {
    out.with_extension("training.safetensors")
}

pub(crate) fn open(path: &Path, append: bool) -> Result<(PathBuf, BufWriter<File>)> {
    let file = files::log(path, append)?;
    Ok((path.to_owned(), BufWriter::new(file)))
}

pub(crate) fn write(file: &mut BufWriter<File>, metrics: &impl serde::Serialize) -> Result<()> {
    serde_json::to_writer(&mut *file, metrics)?;
    file.write_all(b"\n")?;
    Ok(file.flush()?)
}
