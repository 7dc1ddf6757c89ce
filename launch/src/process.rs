//! `mirror process NAME`: how `mirror up` starts its own executable as one of the processes.

use crate::cli::ProcessArguments;
use crate::failure::Failure;
use runtime::RunArguments;
use std::process::ExitCode;

/// The processes in launch order.
pub use messages::PROCESSES as NAMES;

/// Runs a process until its run ends.
pub fn process(arguments: &ProcessArguments) -> Result<ExitCode, Failure> {
    let run = RunArguments::read(&arguments.run).map_err(Failure::refused)?;
    runtime::name_thread(&format!("mirror:{}", run.process));
    match run.process.as_str() {
        "world" => world::run(&run, &run.options().map_err(Failure::refused)?)?,
        "driver" => driver::run(&run, &run.options().map_err(Failure::refused)?)?,
        "belief" => belief::run(&run, &run.options().map_err(Failure::refused)?)?,
        "human" => human::run(&run, &run.options().map_err(Failure::refused)?)?,
        "planner" => planner::run(&run, &run.options().map_err(Failure::refused)?)?,
        "renderer" => renderer::run(&run, &run.options().map_err(Failure::refused)?)?,
        "recorder" => recorder::run(&run, &run.options().map_err(Failure::refused)?)?,
        "view" => view::run(&run, &run.options().map_err(Failure::refused)?)?,
        "replay" => ::replay::run(&run, &run.options().map_err(Failure::refused)?)?,
        other => {
            let names = NAMES.join(", ");
            return Err(Failure::refused(anyhow::anyhow!(
                "there is no process {other:?}; there are {names}"
            )));
        }
    }
    Ok(ExitCode::SUCCESS)
}
