//! The `mirror` command: starts and watches the process set, and holds every process behind `mirror process <name>`.

mod cli;
mod columns;
mod console;
mod doctor;
mod evaluate;
mod evaluate_all;
mod evaluate_gridworld;
mod evaluate_real;
mod failure;
mod guard;
mod inputs;
mod keeps_up;
mod learn;
mod learned;
mod ls;
mod manual;
mod messages_package;
mod own;
mod people;
mod place;
mod process;
mod profile;
mod replay;
mod results_file;
mod scenes;
mod screen;
mod suspend;
mod swap;
mod train_self;
mod up;

use clap::Parser;
use cli::{Cli, Command, Train};
use std::io::{self, Write};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn main() -> ExitCode {
    let Cli { command, vectors } = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version too, which go to the standard output.
        Err(told) => {
            let printed = told.print().and_then(|()| io::stdout().flush());
            if !told.use_stderr() {
                console::note(printed);
            }
            return console::verdict(ExitCode::from(told.exit_code() as u8));
        }
    };
    nn::vectors::choose(vectors);
    // Whoever only prints ends quietly with its reader (`mirror doctor | head`); who runs a set, or talks to one, goes on without.
    let goes_on = matches!(
        command,
        Command::Up(_)
            | Command::Swap(_)
            | Command::Replay(_)
            | Command::Profile(_)
            | Command::Process(_)
            | Command::ExecGuard(_)
    );
    if !goes_on {
        // SAFETY: no other thread runs yet, and no handler of ours is replaced.
        unsafe { libc::signal(libc::SIGPIPE, libc::SIG_DFL) };
    }
    let result = match command {
        Command::Up(arguments) => up::up(&arguments),
        Command::Swap(arguments) => swap::swap(&arguments),
        Command::Replay(arguments) => replay::replay(&arguments),
        Command::Profile(arguments) => profile::profile(&arguments),
        Command::Ls(arguments) => ls::ls(&arguments),
        Command::Scenes(arguments) => scenes::scenes(&arguments),
        Command::People(arguments) => people::people(&arguments),
        Command::Completions(arguments) => manual::completions(&arguments),
        Command::Man(arguments) => manual::man(&arguments),
        Command::Messages(arguments) => messages_package::write(&arguments),
        Command::Doctor(arguments) => doctor::doctor(&arguments),
        Command::Demos(arguments) => learn::demos(&arguments),
        Command::Evaluate(study) => evaluate::evaluate(&study),
        Command::Train(Train::Myself(arguments)) => train_self::train_self(&arguments),
        Command::Train(Train::Human(arguments)) => learn::train_human(&arguments),
        Command::Process(arguments) => process::process(&arguments),
        Command::ExecGuard(arguments) => guard::guard(&arguments),
    };
    screen::close();
    let status = match result {
        Ok(status) => status,
        Err(failure) => {
            screen::error(&failure);
            ExitCode::from(failure.status)
        }
    };
    console::verdict(status)
}
