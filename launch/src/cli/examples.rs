//! The examples at the end of every command's `--help`: a line that says what one is for, and below it the command.
//! Each can be copied as it stands, into a clone's root; what an example reads, an earlier one of another command
//! makes.

pub const TOP: &str = "\
Examples:
  # An assistant drives three foggy episodes with a simulated driver
  mirror up
  # Where one can drive, and who drives
  mirror scenes
  mirror people";

pub const UP: &str = "\
Examples:
  # Another simulated person, with every message recorded
  mirror up --driver sim:7 --episodes 6 --record drive.mcap --summary drive.json
  # A gridworld, without an assistant
  mirror up --scene search-smoke --planner none --human self";

pub const REPLAY: &str = "\
Examples:
  # Are the decisions the same once more?
  mirror replay drive.mcap
  # What would have been said with behavioural cloning as human model?
  mirror replay drive.mcap --human bc --summary replay.json";

pub const PROFILE: &str = "\
Examples:
  # A set of its own: where the time of a step goes, with a drawing
  mirror profile --episodes 2 --out out/profile --picture profile.svg
  # Ten seconds of a set that runs
  mirror profile --attach lab --seconds 10";

pub const DEMOS: &str = "\
Examples:
  # Six rounds of person 3 in fog on the highway
  mirror demos --person 3 --out rounds.safetensors
  # Nine rounds of gridworld driving in clear weather
  mirror demos --domain driving --person 3 --setting original --rounds 9 --out clear.safetensors";

pub const TRAIN: &str = "\
Examples:
  # What person 3 sees and how they act, from what `mirror demos` recorded
  mirror train human --demos rounds.safetensors --out implants.safetensors
  # A self-model of gridworld driving, from nothing
  mirror train self --domain driving --out driving-self.safetensors";

pub const TRAIN_SELF: &str = "\
Examples:
  # Half a minute on two cores
  mirror train self --domain driving --out driving-self.safetensors
  # Go on where an earlier run was stopped
  mirror train self --domain driving --out driving-self.safetensors --resume";

pub const TRAIN_HUMAN: &str = "\
Examples:
  # Perception and policy, from six rounds
  mirror train human --demos rounds.safetensors --out implants.safetensors
  # Behavioural cloning, from the same rounds
  mirror train human --kind bc --demos rounds.safetensors --out bc.safetensors";

pub const EVALUATE: &str = "\
Examples:
  # The quick form of every study, in minutes
  mirror evaluate all --quick --out out/quick
  # One study as in RESULTS.md
  mirror evaluate implants --out out/implants";

pub const FIT: &str = "\
Examples:
  # In gridworld driving, as in RESULTS.md
  mirror evaluate fit --domain driving --out out/gridworlds
  # To see that it runs
  mirror evaluate fit --domain driving --quick --out out/quick";

pub const COMMUNICATE: &str = "\
Examples:
  # In gridworld driving, as in RESULTS.md
  mirror evaluate communicate --domain driving --out out/gridworlds
  # Nobody, MIRROR, and everything always; to see that it runs
  mirror evaluate communicate --domain driving --conditions nc,mirror,everything --quick --out out/quick";

pub const DRIVE: &str = "\
Examples:
  # As in RESULTS.md: more than an hour on two cores
  mirror evaluate drive --out out/drive
  # Two conditions, to see that it runs
  mirror evaluate drive --conditions silent,mirror --quick --out out/quick";

pub const REAL: &str = "\
Examples:
  # On the cars of highway-recorded, the scene that ships
  mirror evaluate real --quick --out out/real
  # On a folder of CommonRoad scenarios
  mirror evaluate real --data examples/commonroad --quick --out out/folder";

pub const IMPLANTS: &str = "\
Examples:
  # Everybody on the highway in fog, as in RESULTS.md
  mirror evaluate implants --out out/implants
  # Three people of gridworld driving
  mirror evaluate implants --domain driving --quick --out out/quick";

pub const FORESIGHT: &str = "\
Examples:
  # Everybody, three seeds
  mirror evaluate foresight --out out/foresight
  # A self-model of your own, three people
  mirror evaluate foresight --self-model self.safetensors --quick --out out/quick";

pub const UNAIDED: &str = "\
Examples:
  # Everybody on the highway in fog
  mirror evaluate unaided --out out/unaided
  # Three people of gridworld driving
  mirror evaluate unaided --domain driving --quick --out out/quick";

pub const ALL: &str = "\
Examples:
  # As in RESULTS.md: hours
  mirror evaluate all --out out/all
  # The quick form of every study, in minutes
  mirror evaluate all --quick --out out/quick";

pub const SWAP: &str = "\
Examples:
  # Another human model, in the only set that runs
  mirror swap human bc
  # No assistant from now on, in the set called lab
  mirror swap planner none --instance lab --report swap.json";

pub const MESSAGES: &str = "\
Examples:
  # The package mirror_msgs
  mirror messages --out mirror_msgs
  # Into a ROS 2 workspace
  mirror messages --out ~/ros2_ws/src/mirror_msgs";

pub const DOCTOR: &str = "\
Examples:
  # What is wrong, if anything
  mirror doctor
  # Remove what dead runs left
  mirror doctor --clean";

pub const SCENES: &str = "\
Examples:
  # A table
  mirror scenes
  # For programs
  mirror scenes --json";

pub const PEOPLE: &str = "\
Examples:
  # The highway's drivers
  mirror people --domain highway
  # Everybody, with everything that their files say
  mirror people --json";

pub const LS: &str = "\
Examples:
  # What runs, and how far it is
  mirror ls
  # For programs
  mirror ls --json";

pub const COMPLETIONS: &str = "\
Examples:
  # For every bash from now on
  mirror completions bash > ~/.local/share/bash-completion/completions/mirror
  # For fish
  mirror completions fish > ~/.config/fish/completions/mirror.fish";

pub const MAN: &str = "\
Examples:
  # Read the page
  mirror man | man -l -
  # A page for every command
  mirror man --out ~/.local/share/man/man1";

#[cfg(test)]
mod tests {
    use crate::cli::Cli;
    use clap::{Command, CommandFactory, Parser};

    /// The commands of an Examples section.
    fn examples(help: &str) -> Vec<&str> {
        let lines = help.lines().skip_while(|line| *line != "Examples:");
        lines
            .skip(1)
            .take_while(|line| line.starts_with("  "))
            .map(str::trim)
            .filter(|line| !line.starts_with('#'))
            .collect()
    }

    /// The words that the program gets: the shell keeps what follows `>` and `|`.
    fn words(line: &str) -> Vec<&str> {
        let words = line.split_whitespace();
        words
            .take_while(|word| !matches!(*word, ">" | "|"))
            .collect()
    }

    fn check(command: &Command, path: &[&str]) {
        let help = command.get_after_help().map(ToString::to_string);
        let help = help.unwrap_or_default();
        let found = examples(&help);
        assert!(found.len() >= 2, "{path:?} shows {found:?}");
        for line in found {
            let words = words(line);
            assert!(words.starts_with(path), "{line}: an example of {path:?}");
            if let Err(error) = Cli::try_parse_from(&words) {
                panic!("{line}: {error}");
            }
        }
        for inner in command.get_subcommands() {
            if !inner.is_hide_set() && inner.get_name() != "help" {
                check(inner, &[path, &[inner.get_name()]].concat());
            }
        }
    }

    #[test]
    fn every_command_shows_two_examples_that_it_understands() {
        check(&Cli::command(), &["mirror"]);
    }

    #[test]
    fn examples_end_where_their_section_does() {
        let help =
            "Before:\n  mirror a\nExamples:\n  # What\n  mirror b --c > d\n\nAfter:\n  mirror e";
        assert_eq!(examples(help), ["mirror b --c > d"]);
        assert_eq!(words("mirror b --c > d"), ["mirror", "b", "--c"]);
    }
}
