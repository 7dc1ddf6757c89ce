//! Lines about events, for a terminal: when, what, and the rest.

use messages::{EpisodeEnd, Outcome, Utterance};
use std::borrow::Cow;
use std::io::{self, Write};

const BOLD: &str = "\x1b[1m";
/// Of what is said.
pub const CYAN: &str = "\x1b[36m";
/// Of what is shown.
pub const YELLOW: &str = "\x1b[33m";
/// Of accidents.
pub const RED: &str = "\x1b[31m";
const PLAIN: &str = "\x1b[0m";

/// Where the lines go, and the episode that they are about.
pub struct EventLines<W> {
    out: W,
    colours: bool,
    step_s: f32,
    episode: Option<u32>,
}

impl<W: Write> EventLines<W> {
    /// Writes to `out`, with colours if it is a terminal.
    pub fn new(out: W, colours: bool, step_s: f32) -> Self {
        Self {
            out,
            colours,
            step_s,
            episode: None,
        }
    }

    /// Tells of an episode's beginning; whether it is one.
    ///
    /// # Errors
    /// What `out` gives.
    pub fn enter(&mut self, episode: u32) -> io::Result<bool> {
        if self.episode.replace(episode) == Some(episode) {
            return Ok(false);
        }
        self.line(0, BOLD, "START", format_args!("episode {episode}"))?;
        Ok(true)
    }

    /// Tells of an episode's end, if this is it.
    ///
    /// # Errors
    /// What `out` gives.
    pub fn end(&mut self, outcome: &Outcome, success: &str) -> io::Result<()> {
        let how = match outcome.end() {
            Ok(EpisodeEnd::Goal) => success,
            Ok(EpisodeEnd::Collision) => "ended by a collision",
            Ok(EpisodeEnd::OutOfTime) => "out of time",
            Ok(EpisodeEnd::Voided) => "void: nobody was at the wheel any more",
            Ok(EpisodeEnd::Running) | Err(_) => return Ok(()),
        };
        let (episode, step) = (outcome.header.episode, outcome.header.step);
        self.line(step, BOLD, "END", format_args!("episode {episode}: {how}"))
    }

    /// Tells what the person is told of the assistant itself.
    ///
    /// # Errors
    /// What `out` gives.
    pub fn notice(&mut self, step: u32, utterance: &Utterance) -> io::Result<()> {
        self.line(step, RED, "NOTE", format_args!("{}", text_of(utterance)))
    }

    /// A drawing of several lines.
    ///
    /// # Errors
    /// What `out` gives.
    pub fn draw(&mut self, drawing: &str) -> io::Result<()> {
        for line in drawing.lines() {
            writeln!(self.out, "           {line}")?;
        }
        Ok(())
    }

    /// Tells of something else.
    ///
    /// # Errors
    /// What `out` gives.
    pub fn line(
        &mut self,
        step: u32,
        colour: &str,
        word: &str,
        rest: core::fmt::Arguments,
    ) -> io::Result<()> {
        let (colour, plain) = if self.colours {
            (colour, PLAIN)
        } else {
            ("", "")
        };
        let time_s = step as f32 * self.step_s;
        writeln!(self.out, "{time_s:7.2} s  {colour}{word:<5}{plain}  {rest}")
    }
}

/// The words of an utterance.
pub fn text_of(utterance: &Utterance) -> Cow<'_, str> {
    let text = utterance.text.split(|&byte| byte == 0).next();
    String::from_utf8_lossy(text.unwrap_or_default())
}
