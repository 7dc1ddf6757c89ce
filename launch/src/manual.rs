//! `mirror completions` and `mirror man`: what a shell and `man` know of the command line, made from its definition.

use crate::cli::{Cli, CompletionsArguments, ManArguments};
use crate::console::{self, out};
use crate::failure::Failure;
use anyhow::{Context, Result};
use clap::builder::Resettable;
use clap::{Command, CommandFactory};
use clap_mangen::Man;
use std::io::{self, Write};
use std::process::ExitCode;

/// The program's name, for the shell and in the names of pages.
const NAME: &str = "mirror";

/// `mirror completions`.
pub fn completions(arguments: &CompletionsArguments) -> Result<ExitCode, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut visible(), NAME, &mut script);
    console::note(io::stdout().lock().write_all(&script));
    Ok(ExitCode::SUCCESS)
}

/// `mirror man`: the page of the program itself, or a folder with that and one for every command.
pub fn man(arguments: &ManArguments) -> Result<ExitCode, Failure> {
    let mut command = visible().disable_help_subcommand(true);
    command.build();
    let Some(folder) = &arguments.out else {
        console::note(io::stdout().lock().write_all(&page(&command)?));
        return Ok(ExitCode::SUCCESS);
    };
    let place = || format!("--out {}", folder.display());
    std::fs::create_dir_all(folder)
        .with_context(place)
        .map_err(Failure::refused)?;
    let mut pages = Vec::new();
    collect(&command, &mut pages)?;
    for (name, page) in &pages {
        files::write(&folder.join(name), page).map_err(anyhow::Error::from)?;
    }
    out!("{}: {} pages", folder.display(), pages.len());
    Ok(ExitCode::SUCCESS)
}

/// The commands that people use: without those by which `up` starts itself.
fn visible() -> Command {
    let whole = Cli::command();
    let commands = whole.get_subcommands().filter(|sub| !sub.is_hide_set());
    let mut shown = Command::new(NAME)
        .args(whole.get_arguments().cloned())
        .subcommands(commands.cloned());
    if let Some(version) = whole.get_version() {
        shown = shown.version(version.to_owned());
    }
    for (text, set) in [
        (whole.get_about(), Command::about as fn(Command, _) -> _),
        (whole.get_long_about(), Command::long_about),
        (whole.get_after_help(), Command::after_help),
    ] {
        if let Some(text) = text {
            shown = set(shown, text.clone());
        }
    }
    shown
}

/// Pages of a command and all below it, with the names of their files.
fn collect(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<()> {
    pages.push((format!("{}.1", name_of(command)), page(command)?));
    for inner in command.get_subcommands() {
        collect(inner, pages)?;
    }
    Ok(())
}

/// `mirror-train-human`.
fn name_of(command: &Command) -> &str {
    command.get_display_name().unwrap_or(command.get_name())
}

/// A page. What stands after a command's help are paragraphs with a heading each, whose lines keep their ends.
fn page(command: &Command) -> Result<Vec<u8>> {
    let after = command.get_after_help().map(ToString::to_string);
    let bare = command.clone().after_help(Resettable::Reset);
    let mut page = Vec::new();
    Man::new(bare)
        .source(format!("{NAME} {}", env!("CARGO_PKG_VERSION")))
        .render(&mut page)
        .context("a manual page")?;
    for paragraph in after.unwrap_or_default().split("\n\n") {
        if let Some((heading, lines)) = paragraph.split_once('\n') {
            let heading = heading.trim_end_matches(':').to_uppercase();
            page.extend_from_slice(format!(".SH \"{}\"\n.nf\n", escaped(&heading)).as_bytes());
            for line in lines.lines() {
                page.extend_from_slice(format!("{}\n", escaped(line)).as_bytes());
            }
            page.extend_from_slice(b".fi\n");
        }
    }
    Ok(page)
}

/// Text in which roff reads nothing but characters.
fn escaped(line: &str) -> String {
    let text = line.replace('\\', "\\e").replace('-', "\\-");
    match text.starts_with(['.', '\'']) {
        true => format!("\\&{text}"),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap_complete::Shell;

    #[test]
    fn every_command_that_people_use_has_a_page_with_its_examples() {
        let mut command = visible().disable_help_subcommand(true);
        command.build();
        let mut pages = Vec::new();
        collect(&command, &mut pages).unwrap();
        let page = |name: &str| {
            let found = pages.iter().find(|(known, _)| known == name);
            let (_, page) = found.unwrap_or_else(|| panic!("no {name}"));
            String::from_utf8(page.clone()).unwrap()
        };
        let human = page("mirror-train-human.1");
        assert!(human.contains("\\-\\-demos"), "{human}");
        let example = ".SH \"EXAMPLES\"\n.nf\n  # Perception and policy, from six rounds\n  mirror train human \\-\\-demos rounds.safetensors";
        assert!(human.contains(example), "{human}");
        assert!(page("mirror.1").contains("mirror\\-up(1)"));
        let hidden = |name: &str| name.contains("process.") || name.contains("guard");
        assert!(!pages.iter().any(|(name, _)| hidden(name)));
    }

    #[test]
    fn roff_reads_no_command_where_there_is_none() {
        assert_eq!(escaped(".TH a-b \\c"), "\\&.TH a\\-b \\ec");
        assert_eq!(escaped("'quoted'"), "\\&'quoted'");
    }

    #[test]
    fn shells_are_offered_scenes_kinds_and_domains_but_no_hidden_command() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut visible(), NAME, &mut script);
            // zsh has a backslash before a colon.
            let script = String::from_utf8(script).unwrap().replace('\\', "");
            for word in [
                "search-smoke",
                "mirror-p",
                "bomb_defusal",
                "sim:21",
                "lockstep",
            ] {
                assert!(script.contains(word), "{shell}: no {word}");
            }
            assert!(!script.contains("exec-guard"), "{shell}");
        }
    }
}
