//! Test programs that are started once more as a process of a set: such a process is no test, and stands in no list of
//! them.
//!
//! A program that uses [`stand_in!`] says `harness = false` in its crate's `Cargo.toml`. It lists its tests: one that
//! is forgotten is never used, which the compiler says. Options are those of every test program.

use libtest_mimic::{Arguments, Trial};
use std::ffi::OsString;
use std::process::{Command, ExitCode};

/// What a process that stands in is to do, in the environment.
const ROLE: &str = "MIRROR_TEST_STANDS_IN_AS";

/// This test program, to be started as a process that stands in for another.
#[derive(Clone, Debug)]
pub struct Stander {
    role: String,
}

impl Stander {
    /// One that does `role`.
    pub fn new(role: &str) -> Self {
        Self {
            role: role.to_owned(),
        }
    }

    /// The command that starts it.
    ///
    /// # Panics
    /// If this program's file is not known.
    pub fn command(&self) -> Command {
        let mut command = Command::new(std::env::current_exe().expect("this program's path"));
        command.env(ROLE, &self.role);
        command
    }

    /// The same for a shell, with more variables for its environment, as `mirror up --exec` takes it.
    ///
    /// # Panics
    /// If this program's file is not known.
    pub fn shell(&self, environment: &[(&str, &str)]) -> String {
        let program = std::env::current_exe().expect("this program's path");
        let more: Vec<String> = environment
            .iter()
            .map(|(name, value)| format!("{name}={value} "))
            .collect();
        let more = more.concat();
        format!("env {ROLE}={} {more}{}", self.role, program.display())
    }
}

/// Stands in, if this process was started by a [`Stander`]'s command: `stand_in` hears the role and the program's last
/// argument. Otherwise runs the tests.
pub fn run(stand_in: fn(&str, OsString), tests: Vec<(&'static str, fn())>) -> ExitCode {
    if let Ok(role) = std::env::var(ROLE) {
        stand_in(&role, std::env::args_os().next_back().unwrap_or_default());
        return ExitCode::SUCCESS;
    }
    let trial = |(name, test): (&str, fn())| {
        Trial::test(name, move || {
            test();
            Ok(())
        })
    };
    let trials = tests.into_iter().map(trial).collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// The `main` of a test program that is also started as a process: `stand_in!(function; test, test, …);`.
#[macro_export]
macro_rules! stand_in {
    ($stand_in:path; $($test:ident),+ $(,)?) => {
        fn main() -> std::process::ExitCode {
            $crate::run($stand_in, vec![$((stringify!($test), $test as fn())),+])
        }
    };
}
