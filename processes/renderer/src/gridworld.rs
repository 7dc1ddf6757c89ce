//! A gridworld's decisions as what the person sees and hears, and what the terminal says of it.

use crate::content::RendererOptions;
use crate::lines::{CYAN, EventLines, RED, YELLOW, text_of};
use crate::render::{Render, Tell, is_in_force};
use domains::Layout;
use domains::discrete::{Domain, Words, sentence};
use messages::{
    CommAction, Display, LidarFrame, Observation, Outcome, PICTURE_BYTES, Picture, UtteranceContent,
};
use std::io::{self, Write};
use std::sync::Arc;

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
        if let Some(domain) = Domain::from_name(self.layout.domain) {
            sentence(domain, &self.words, item, sensed.verbal(), &mut self.text);
        }
        // A zero follows.
        let length = self.text.len().min(utterance.text.len() - 1);
        utterance.text[..length].copy_from_slice(&self.text.as_bytes()[..length]);
        (utterance.item, utterance.kind) = (item as u32, UtteranceContent::InWords.wire());
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
        display.objects = [LidarFrame::NO_OBJECT; 16];
        let Some(decision) = decision.filter(|decision| is_in_force(decision, &sensed.header))
        else {
            return;
        };
        let possible = self.layout.communicable;
        display.highlighted = decision.visual & possible.visual as u32;
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
    lines: EventLines<W>,
    layout: Arc<Layout>,
    /// What was shown at the step before.
    shown: u32,
    picture: String,
    /// The episode whose beginning was drawn last.
    drawn: Option<u32>,
}

impl<W: Write> GridEvents<W> {
    /// Writes to `out`, with colours if it is a terminal.
    pub fn new(out: W, colours: bool, options: &RendererOptions, layout: Arc<Layout>) -> Self {
        Self {
            lines: EventLines::new(out, colours, options.step_s),
            layout,
            shown: 0,
            picture: String::with_capacity(PICTURE_BYTES),
            drawn: None,
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
        self.lines.enter(episode)?;
        if self.drawn.replace(episode) != Some(episode) {
            self.shown = 0;
            self.lines.draw(&self.picture)?;
        }
        let spoken = (display.utterance_count as usize).min(display.utterances.len());
        for utterance in &display.utterances[..spoken] {
            if utterance.is_notice() {
                self.lines.notice(step, utterance)?;
                continue;
            }
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
            let what = self.layout.accident;
            let step = outcome.header.step;
            self.lines
                .line(step, RED, "CRASH", format_args!("{what}"))?;
        }
        self.lines.end(outcome, self.layout.success)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::discrete::{Discrete, Scene, World};
    use messages::Message;

    /// The world of search and rescue at its start, and what is sensed of it.
    fn sensed(step: u32) -> (Arc<Layout>, Words, Observation) {
        let scene = Scene::builtin("search-smoke").expect("it ships");
        let words = models::words::shipped(scene.domain()).expect("they ship");
        let mut world = World::new(&scene, &words).expect("they fit");
        world.reset(1, 0, 0);
        let layout = world.layout().clone();
        let mut sensed = Observation::ZERO;
        sensed.header.step = step;
        (sensed.visual_len, sensed.verbal_len) = (layout.visual as u32, layout.verbal as u32);
        let (visual, verbal) = (&mut sensed.visual, &mut sensed.verbal);
        world.observe(&mut visual[..layout.visual], &mut verbal[..layout.verbal]);
        (Arc::new(layout), words, sensed)
    }

    fn decision(step: u32, visual: u32, verbal: u32) -> CommAction {
        let mut decision = CommAction::ZERO;
        decision.header.step = step;
        (decision.visual, decision.verbal) = (visual, verbal);
        decision
    }

    #[test]
    fn what_is_decided_is_shown_and_said_once() {
        let (layout, words, first) = sensed(3);
        let mut renderer = GridRenderer::new(layout, words);
        let decided = decision(3, 0b101, 0b1001);
        let mut display = Display::ZERO;
        renderer.render(&first, Some(&decided), &mut display);
        assert_eq!((display.highlighted, display.said()), (0b101, 0b1001));
        let said: Vec<_> = display.utterances[..2].iter().map(text_of).collect();
        assert!(
            said[0].contains("top right") && said[1].contains("top corridor"),
            "{said:?}"
        );
        // A decision for the step before still shows, and is not said again.
        let (.., next) = sensed(4);
        let mut display = Display::ZERO;
        renderer.render(&next, Some(&decided), &mut display);
        assert_eq!((display.highlighted, display.utterance_count), (0b101, 0));
        let mut display = Display::ZERO;
        renderer.render(&sensed(9).2, Some(&decided), &mut display);
        assert_eq!(display.highlighted, 0);
    }

    #[test]
    fn the_terminal_tells_of_it_in_words() {
        let (layout, words, sensed) = sensed(0);
        let mut renderer = GridRenderer::new(Arc::clone(&layout), words);
        let mut out = Vec::new();
        let mut events = GridEvents::new(&mut out, false, &RendererOptions::default(), layout);
        let mut picture = Picture::ZERO;
        picture.text[..8].copy_from_slice(b"#P.\nmore");
        events.picture(&picture);
        let mut display = Display::ZERO;
        renderer.render(&sensed, Some(&decision(0, 0b11, 0b10000)), &mut display);
        events.display(&display, &sensed).expect("memory takes it");
        let mut outcome = Outcome::ZERO;
        (outcome.header.step, outcome.collided) = (2, 1);
        outcome.end = messages::EpisodeEnd::Goal.wire();
        events.outcome(&outcome).expect("memory takes it");
        let text = String::from_utf8_lossy(&out);
        let lines: Vec<_> = text.lines().map(str::trim_start).collect();
        assert_eq!(lines[..3], ["0.00 s  START  episode 0", "#P.", "more"]);
        assert!(
            lines[3].starts_with("0.00 s  SAY    “The bottom corridor is "),
            "{text}"
        );
        assert_eq!(lines[4], "0.00 s  SHOW   top left, top");
        assert!(lines[5].ends_with("CRASH  ran into an obstacle"), "{text}");
        assert!(
            lines[6].ends_with("END    episode 0: the victim is rescued"),
            "{text}"
        );
    }
}
