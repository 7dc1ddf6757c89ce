//! The `mirror` command: starts and watches the process set, and holds every process behind `mirror process <name>`.

mod cli;
mod doctor;
mod evaluate;
mod evaluate_all;
mod evaluate_real;
mod failure;
mod gridworld;
mod inputs;
mod learn;
mod learned;
mod place;
mod process;
mod profile;
mod replay;
mod screen;
mod swap;
mod train_self;
mod up;

use clap::Parser;
use cli::{Cli, Command, Train};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Up(arguments) => up::up(&arguments),
        Command::Swap(arguments) => swap::swap(&arguments),
        Command::Replay(arguments) => replay::replay(&arguments),
        Command::Profile(arguments) => profile::profile(&arguments),
        Command::Doctor(arguments) => doctor::doctor(&arguments),
        Command::Demos(arguments) => learn::demos(&arguments),
        Command::Evaluate(study) => evaluate::evaluate(&study),
        Command::Train(Train::Myself(arguments)) => train_self::train_self(&arguments),
        Command::Train(Train::Human(arguments)) => learn::train_human(&arguments),
        Command::Process(arguments) => process::process(&arguments),
    };
    match result {
        Ok(status) => status,
        Err(failure) => {
            screen::error(&failure);
            ExitCode::from(failure.status)
        }
    }
}
