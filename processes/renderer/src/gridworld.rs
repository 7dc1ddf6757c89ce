//! A gridworld's decisions as what the person sees and hears, and what the terminal says of it.

use crate::content::Options;
use crate::lines::{CYAN, Lines, RED, YELLOW, text_of};
use crate::render::{Render, Tell, is_in_force};
use domains::discrete::{Domain, Layout, Words, sentence};
use messages::{CommAction, Display, Observation, Outcome, Picture};
use std::io::{self, Write};
use std::sync::Arc;

/// [`messages::Utterance::kind`] of what the text says.
const IN_WORDS: u32 = 3;

/// Shows regions and says sentences as they were decided; nothing has to wait for its turn.
pub struct GridRenderer {
    layout: Arc<Layout>,
    words: Words,
    text: String,
    episode: Option<u32>,
    /// Step of the decision whose words were said last; words are not said again.
    heard_step: Option<u32>,
}

impl GridRenderer {
    /// A renderer that has said nothing yet; `words` are the world's.
    pub fn new(layout: Arc<Layout>, words: Words) -> Self {
        Self {
            layout,
            words,
            text: String::with_capacity(256),
            episode: None,
            heard_step: None,
        }
    }

    fn say(&mut self, item: usize, sensed: &Observation, display: &mut Display) {
        let count = display.utterance_count as usize;
        let Some(utterance) = display.utterances.get_mut(count) else {
            return;
        };
        self.text.clear();
        let (domain, words) = (self.layout.domain, &self.words);
        sentence(domain, words, item, sensed.verbal(), &mut self.text);
        // A zero follows.
        let length = self.text.len().min(utterance.text.len() - 1);
        utterance.text[..length].copy_from_slice(&self.text.as_bytes()[..length]);
        (utterance.item, utterance.kind) = (item as u32, IN_WORDS);
        display.utterance_count += 1;
    }
}

impl Render for GridRenderer {
    type Sensed = Observation;

    fn follows(&self, episode: u32) -> bool {
        self.episode == Some(episode)
    }

    fn follow(&mut self, episode: u32, shown: Option<&Display>) {
        let shown = shown.filter(|shown| shown.header.episode == episode);
        (self.episode, self.heard_step) = (Some(episode), shown.map(|shown| shown.header.step));
    }

    fn render(
        &mut self,
        sensed: &Observation,
        decision: Option<&CommAction>,
        display: &mut Display,
    ) {
        if !self.follows(sensed.header.episode) {
            self.follow(sensed.header.episode, None);
        }
        display.objects = [-1; 16];
        let Some(decision) = decision.filter(|decision| is_in_force(decision, &sensed.header))
        else {
            return;
        };
        let possible = self.layout.communicable;
        display.highlighted = decision.visual & possible.visual;
        let decided_at = decision.header.step;
        if self.heard_step.replace(decided_at) != Some(decided_at) {
            let said = decision.verbal & possible.verbal;
            for item in (0..self.layout.utterances).filter(|item| said >> item & 1 == 1) {
                self.say(item, sensed, display);
            }
        }
    }
}

/// The lines, written to `out`; its errors are left to `out`, because a closed terminal must not stop a run.
pub struct GridEvents<W> {
    lines: Lines<W>,
    layout: Arc<Layout>,
    /// What was shown at the step before.
    shown: u32,
    picture: String,
}

impl<W: Write> GridEvents<W> {
    /// Writes to `out`, with colours if it is a terminal.
    pub fn new(out: W, colours: bool, options: &Options, layout: Arc<Layout>) -> Self {
        Self {
            lines: Lines::new(out, colours, options.step_s),
            layout,
            shown: 0,
            picture: String::new(),
        }
    }
}

impl<W: Write> Tell for GridEvents<W> {
    type Sensed = Observation;

    fn picture(&mut self, picture: &Picture) {
        let text = picture.text.split(|&byte| byte == 0).next();
        self.picture.clear();
        self.picture
            .push_str(&String::from_utf8_lossy(text.unwrap_or_default()));
    }

    fn display(&mut self, display: &Display, sensed: &Observation) -> io::Result<()> {
        let (episode, step) = (sensed.header.episode, sensed.header.step);
        if self.lines.enter(episode)? {
            self.shown = 0;
            self.lines.draw(&self.picture)?;
        }
        let spoken = (display.utterance_count as usize).min(display.utterances.len());
        for utterance in &display.utterances[..spoken] {
            let text = text_of(utterance);
            self.lines
                .line(step, CYAN, "SAY", format_args!("“{text}”"))?;
        }
        let news = display.highlighted & !self.shown;
        self.shown = display.highlighted;
        if news == 0 {
            return Ok(());
        }
        let names = self.layout.region_names.iter().enumerate();
        let news: Vec<_> = names
            .filter(|(region, _)| news >> region & 1 == 1)
            .map(|(_, name)| *name)
            .collect();
        let news = news.join(", ");
        self.lines
            .line(step, YELLOW, "SHOW", format_args!("{news}"))
    }

    fn outcome(&mut self, outcome: &Outcome) -> io::Result<()> {
        self.lines.enter(outcome.header.episode)?;
        if outcome.collided != 0 {
            let what = match self.layout.domain {
                Domain::Driving => "hit another car",
                Domain::SearchRescue | Domain::BombDefusal => "ran into an obstacle",
            };
            let step = outcome.header.step;
            self.lines
                .line(step, RED, "CRASH", format_args!("{what}"))?;
        }
        let success = match self.layout.domain {
            Domain::Driving => "the end of the road reached",
            Domain::SearchRescue => "the victim is rescued",
            Domain::BombDefusal => "the bomb is defused",
        };
        self.lines.end(outcome, success)
    }
}
