//! Turns a decision into what the person sees and hears: which objects get a box, which sentence is spoken, about which
//! car, and when the next sentence may start.

use crate::render::{Render, is_in_force};
use domains::highway::display::most_wanted;
use domains::highway::speech::{self, SECTOR_AZIMUTHS, displayable};
use domains::highway::{Observation, UtteranceKind};
use messages::{CommAction, Display, LidarFrame, SECTORS, Utterance, UtteranceContent};
use scenario::{Scenario, scene_or_null};

/// How to render.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RendererOptions {
    /// Simulated seconds of a step.
    pub step_s: f32,
    /// Simulated seconds from the start of an utterance to the earliest start of the next.
    pub speech_interval_s: f32,
    /// Whether events are written to the standard output.
    pub print: bool,
    /// Whether they are written in colours, though the standard output is a pipe: there is a terminal at its end.
    #[serde(default)]
    pub colours: bool,
    /// Highway or gridworld; as JSON, the gridworld's scene under `gridworld`.
    #[serde(default, rename = "gridworld", with = "scene_or_null")]
    pub scenario: Scenario,
}

impl Default for RendererOptions {
    /// The highway's: steps of 0.15 s, and one utterance every 3.5 s at most, as in the authors' scripts.
    fn default() -> Self {
        Self {
            step_s: 0.15,
            speech_interval_s: 3.5,
            print: true,
            colours: false,
            scenario: Scenario::Highway(()),
        }
    }
}

/// Keeps what rendering remembers from step to step: what was decided, and when something was last said.
#[derive(Clone, Debug)]
pub struct Renderer {
    step_s: f32,
    /// Steps from one utterance to the next.
    interval_steps: u32,
    /// Episode that was last rendered.
    episode: Option<u32>,
    /// First step of the episode at which an utterance may start.
    ready_step: u32,
    /// Step of the decision whose words were last considered; words are not kept for later.
    heard_step: Option<u32>,
    observation: Observation,
}

impl Renderer {
    /// A renderer that has said nothing yet.
    pub fn new(options: &RendererOptions) -> Self {
        let steps = options.speech_interval_s / options.step_s;
        Self {
            step_s: options.step_s,
            // Rounding of the quotient must not add a step to an interval of a whole number of steps.
            interval_steps: (steps - 1e-3).ceil().max(1.0) as u32,
            episode: None,
            ready_step: 0,
            heard_step: None,
            observation: Observation::default(),
        }
    }

    fn utterance(&mut self, frame: &LidarFrame, sector: usize) -> Utterance {
        self.observation.range = frame.range;
        self.observation.object = frame.object;
        self.observation.speed_mps = frame.speed_mps;
        let heard = speech::utterances(&self.observation)[sector];
        let words = speech::sentence(sector, heard.kind).as_bytes();
        let mut text = [0; 64];
        // `sentence` promises at most 63 bytes, so that a zero follows.
        let length = words.len().min(text.len() - 1);
        text[..length].copy_from_slice(&words[..length]);
        Utterance {
            text,
            item: sector as u32,
            kind: content_of(heard.kind).wire(),
            range_m: heard.range_m,
            speed_mps: heard.speed_mps,
        }
    }
}

impl Render for Renderer {
    type Sensed = LidarFrame;

    fn follows(&self, episode: u32) -> bool {
        self.episode == Some(episode)
    }

    fn follow(&mut self, episode: u32, shown: Option<&Display>) {
        (self.episode, self.ready_step, self.heard_step) = (Some(episode), 0, None);
        if let Some(shown) = shown.filter(|shown| shown.header.episode == episode) {
            let steps = (shown.speech_ready_s / self.step_s).round() as u32;
            self.ready_step = shown.header.step + steps;
        }
    }

    /// What `decision` highlights and says is resolved in what the LIDAR sees now.
    fn render(&mut self, frame: &LidarFrame, decision: Option<&CommAction>, display: &mut Display) {
        let (episode, step) = (frame.header.episode, frame.header.step);
        if !self.follows(episode) {
            self.follow(episode, None);
        }
        display.objects = [LidarFrame::NO_OBJECT; 16];
        display.object_count = 0;
        display.utterance_count = 0;
        display.highlighted = 0;
        if let Some(decision) = decision.filter(|decision| is_in_force(decision, &frame.header)) {
            highlight(frame, decision.visual, display);
            let is_new =
                self.heard_step.replace(decision.header.step) != Some(decision.header.step);
            if is_new
                && step >= self.ready_step
                && let Some(sector) = most_wanted(decision.verbal, &decision.verbal_probability)
            {
                display.utterances[0] = self.utterance(frame, sector);
                display.utterance_count = 1;
                self.ready_step = step + self.interval_steps;
            }
        }
        display.speech_ready_s = self.ready_step.saturating_sub(step) as f32 * self.step_s;
    }
}

fn content_of(kind: UtteranceKind) -> UtteranceContent {
    match kind {
        UtteranceKind::Nothing => UtteranceContent::Nothing,
        UtteranceKind::Slow => UtteranceContent::Slow,
        UtteranceKind::Fast => UtteranceContent::Fast,
    }
}

fn highlight(frame: &LidarFrame, visual: u32, display: &mut Display) {
    for sector in (0..SECTORS).filter(|sector| visual >> sector & 1 == 1) {
        let (first, last) = SECTOR_AZIMUTHS[sector];
        for azimuth in (first..=last).filter(|azimuth| displayable(*azimuth)) {
            let (object, count) = (frame.object[azimuth], display.object_count as usize);
            // Where there is no car, there is nothing to highlight.
            display.highlighted |= u32::from(object >= 0) << sector;
            let is_new = object >= 0 && !display.objects[..count].contains(&object);
            if is_new && count < display.objects.len() {
                display.objects[count] = object;
                display.object_count += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{AZIMUTHS, Message};

    const REACH_M: f32 = 40.0;

    fn frame(step: u32, cars: &[(usize, i32, f32, f32)]) -> LidarFrame {
        let mut frame = LidarFrame::ZERO;
        frame.header.step = step;
        frame.range = [1.0; messages::BEAMS];
        frame.object = [LidarFrame::NO_OBJECT; AZIMUTHS];
        for &(azimuth, object, range_m, speed_mps) in cars {
            frame.range[AZIMUTHS + azimuth] = range_m / REACH_M;
            frame.object[azimuth] = object;
            frame.speed_mps[azimuth] = speed_mps;
        }
        frame
    }

    fn decision(step: u32, visual: u32, verbal: &[(usize, f32)]) -> CommAction {
        let mut decision = CommAction::ZERO;
        decision.header.step = step;
        decision.visual = visual;
        for &(sector, probability) in verbal {
            decision.verbal |= 1 << sector;
            decision.verbal_probability[sector] = probability;
        }
        decision
    }

    /// What is shown at the decision's own step.
    fn render(
        renderer: &mut Renderer,
        frame: &LidarFrame,
        visual: u32,
        verbal: &[(usize, f32)],
    ) -> Display {
        let mut decision = decision(frame.header.step, visual, verbal);
        decision.header.episode = frame.header.episode;
        let mut display = Display::ZERO;
        renderer.render(frame, Some(&decision), &mut display);
        display
    }

    #[test]
    fn highlights_are_the_objects_in_front_each_once() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let frame = frame(
            3,
            &[
                (0, 7, 20.0, 5.0),
                (1, 7, 20.0, 5.0),
                (5, 4, 9.0, 5.0),
                (12, 9, 9.0, 5.0),
            ],
        );
        let display = render(&mut renderer, &frame, 0b00_1111, &[]);
        // Left-rear and rear are behind the head-up display's reach.
        assert_eq!(display.highlighted, 0b00_0011);
        assert_eq!(display.object_count, 2);
        // Right-front is within reach, and empty.
        assert_eq!(render(&mut renderer, &frame, 0b10_0000, &[]).highlighted, 0);
        assert_eq!(display.objects[..3], [7, 4, -1]);
        assert_eq!(display.utterance_count, 0);
    }

    #[test]
    fn the_likeliest_sector_is_spoken_about_and_then_there_is_silence() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let cars = [(18, 2, 23.0, 18.2), (11, 3, 30.0, 5.0), (14, 4, 12.0, 8.8)];
        let wanted = [(2, 0.5), (3, 0.9)];
        let first = render(&mut renderer, &frame(10, &cars), 0, &wanted);
        assert_eq!((first.utterance_count, first.utterances[0].item), (1, 3));
        assert_eq!(first.utterances[0].content(), Ok(UtteranceContent::Fast));
        assert!((first.utterances[0].range_m - 23.0).abs() < 1e-5);
        assert_eq!(first.utterances[0].speed_mps, 18.2);
        let words = speech::sentence(3, speech::UtteranceKind::Fast);
        assert!(first.utterances[0].text.starts_with(words.as_bytes()));
        assert_eq!(
            first.utterances[0].text[words.len()..],
            [0; 64][words.len()..]
        );
        // 3.5 s are 23 1/3 steps: the next may start with the 24th.
        assert!((first.speech_ready_s - 3.6).abs() < 1e-5);
        let early = render(&mut renderer, &frame(33, &cars), 0, &wanted);
        assert_eq!(early.utterance_count, 0);
        assert!((early.speech_ready_s - 0.15).abs() < 1e-5);
        let later = render(&mut renderer, &frame(34, &cars), 0, &[(2, 0.5)]);
        assert_eq!((later.utterance_count, later.utterances[0].item), (1, 2));
        // The nearest car of the sector is the slow one at 12 m.
        assert_eq!(later.utterances[0].content(), Ok(UtteranceContent::Slow));
        assert!((later.utterances[0].range_m - 12.0).abs() < 1e-5);
    }

    #[test]
    fn an_empty_sector_and_a_new_episode_can_be_spoken_about() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let wanted = [(3, 0.9)];
        let first = render(&mut renderer, &frame(10, &[]), 0, &wanted);
        assert_eq!(first.utterances[0].content(), Ok(UtteranceContent::Nothing));
        assert_eq!(first.utterances[0].range_m, REACH_M);
        let mut next = frame(1, &[]);
        next.header.episode = 1;
        assert_eq!(render(&mut renderer, &next, 0, &wanted).utterance_count, 1);
    }

    #[test]
    fn an_interval_of_whole_steps_is_that_many_steps() {
        let options = RendererOptions {
            step_s: 0.15,
            speech_interval_s: 3.0,
            ..RendererOptions::default()
        };
        assert_eq!(Renderer::new(&options).interval_steps, 20);
    }

    #[test]
    fn without_a_decision_nothing_is_shown() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let mut display = Display::ZERO;
        renderer.render(&frame(0, &[(0, 1, 5.0, 1.0)]), None, &mut display);
        assert_eq!(
            (
                display.highlighted,
                display.object_count,
                display.utterance_count
            ),
            (0, 0, 0)
        );
        assert_eq!(display.objects, [-1; 16]);
    }

    #[test]
    fn a_late_decision_is_held_for_two_steps_and_spoken_once() {
        let options = RendererOptions {
            speech_interval_s: 0.15,
            ..RendererOptions::default()
        };
        let mut renderer = Renderer::new(&options);
        let decision = decision(5, 1, &[(3, 0.9)]);
        let shown: Vec<_> = (4..9)
            .map(|step| {
                let mut display = Display::ZERO;
                renderer.render(
                    &frame(step, &[(0, 1, 5.0, 1.0)]),
                    Some(&decision),
                    &mut display,
                );
                (display.highlighted, display.utterance_count)
            })
            .collect();
        assert_eq!(shown, [(0, 0), (1, 1), (1, 0), (1, 0), (0, 0)]);
    }

    #[test]
    fn a_decision_of_another_episode_shows_nothing() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let mut next = frame(5, &[]);
        next.header.episode = 1;
        let mut display = Display::ZERO;
        renderer.render(&next, Some(&decision(5, 1, &[(3, 0.9)])), &mut display);
        assert_eq!((display.highlighted, display.utterance_count), (0, 0));
    }
}
