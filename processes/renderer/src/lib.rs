//! The renderer: turns the planner's decision for a step into highlights and utterances, and tells the terminal.

mod assistance;
mod content;
mod events;
mod gridworld;
mod lines;
mod render;
mod unhurried;

pub use content::{Renderer, RendererOptions};
pub use events::Events;
pub use gridworld::{GridEvents, GridRenderer};
pub use render::{Render, Tell};

use anyhow::Result;
use assistance::Assistance;
use messages::{CommAction, Display, Outcome, Picture, Sensed, topic};
use runtime::{
    ClockMode, Input, InputOptions, Node, Output, Receive, RunArguments, Stamp, Wake, run_process,
};
use scenario::Scenario;
use std::io::{self, IsTerminal};
use std::sync::Arc;
use unhurried::Unhurried;

/// Joins the run and renders until it ends.
///
/// # Errors
/// When the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &RendererOptions) -> Result<()> {
    run_process(arguments, |node| match &options.scenario {
        Scenario::Highway(()) => {
            let events = |colours| Events::new(Unhurried::new(io::stdout()), colours, options);
            render(node, options, Renderer::new(options), events)
        }
        Scenario::Gridworld(scene) => {
            let layout = models::words::layout_of(scene)?;
            let words = models::words::shipped(scene.domain())?;
            let told = Arc::clone(&layout);
            let events =
                |colours| GridEvents::new(Unhurried::new(io::stdout()), colours, options, told);
            render(node, options, GridRenderer::new(layout, words), events)
        }
    })
}

/// Renders until the run ends. `events`: what tells the terminal, with colours or without.
fn render<R: Render, T: Tell<Sensed = R::Sensed>>(
    node: &mut Node,
    options: &RendererOptions,
    renderer: R,
    events: impl FnOnce(bool) -> T,
) -> Result<()> {
    let colours = options.colours || io::stdout().is_terminal();
    let events = options.print.then(|| events(colours));
    let mut process = Process::new(node, renderer, events)?;
    match node.arguments().clock {
        ClockMode::Lockstep => process.lockstep(node),
        ClockMode::RealTime => process.real_time(node),
    }
}

struct Process<R: Render, T> {
    sensed: Input<R::Sensed>,
    decision: Input<CommAction>,
    outcome: Input<Outcome>,
    picture: Input<Picture>,
    display: Output<Display>,
    /// What a predecessor showed, for one that joins late.
    shown: Option<Input<Display>>,
    renderer: R,
    /// Real time only: in lockstep every step has its decision.
    assistance: Option<Assistance>,
    events: Option<T>,
}

impl<R: Render, T: Tell<Sensed = R::Sensed>> Process<R, T> {
    fn new(node: &Node, renderer: R, events: Option<T>) -> Result<Self> {
        let receive = Receive::in_clock(node.arguments().clock);
        let asleep = InputOptions {
            wakes: false,
            ..InputOptions::new(Receive::Newest)
        };
        Ok(Self {
            sensed: node.input(R::Sensed::TOPIC, receive)?,
            decision: node.input(topic::COMM_ACTION, receive)?,
            outcome: node.input(topic::OUTCOME, Receive::InOrder)?,
            picture: node.input_with(topic::PICTURE, asleep)?.uncounted(),
            display: node.output(topic::DISPLAY)?,
            shown: match node.arguments().standby {
                false => None,
                true => Some(node.input_with(topic::DISPLAY, asleep)?.uncounted()),
            },
            renderer,
            assistance: match node.arguments().clock {
                ClockMode::Lockstep => None,
                ClockMode::RealTime => Some(Assistance::default()),
            },
            events,
        })
    }

    /// Every frame waits for its decision; for an episode's first there is none.
    fn lockstep(&mut self, node: &mut Node) -> Result<()> {
        if node.ready()? == Wake::Stop {
            return Ok(());
        }
        while node.wait(&mut [&mut self.sensed], None)? != Wake::Stop {
            self.sensed.take()?;
            let Some((episode, step)) = self
                .sensed
                .header()
                .map(|header| (header.episode, header.step))
            else {
                continue;
            };
            if step > 0 {
                match node.wait_step(&mut [&mut self.decision], episode, step, None)? {
                    Wake::Stop => break,
                    // Who joined late has no decision for its first frames; they are not its own to show.
                    Wake::Passed if !node.is_active(episode, step) => continue,
                    _ => {}
                }
            }
            self.show(node, true)?;
            node.end_step();
        }
        self.tell_outcomes(node)
    }

    /// A frame is shown at once with the newest decision, and again when its own comes late.
    fn real_time(&mut self, node: &mut Node) -> Result<()> {
        if node.ready()? == Wake::Stop {
            return Ok(());
        }
        while node.wait(
            &mut [&mut self.sensed, &mut self.decision, &mut self.outcome],
            None,
        )? != Wake::Stop
        {
            let is_new = self.sensed.take()?;
            let decided = self.decision.take()?;
            if is_new || (decided && self.is_late()) {
                node.count_missed(u64::from(!is_new));
                self.show(node, is_new)?;
                node.end_step();
            } else {
                self.tell_outcomes(node)?;
            }
        }
        self.tell_outcomes(node)
    }

    /// Whether the newest decision is for the frame that was already shown without it.
    fn is_late(&self) -> bool {
        let place = |header: &messages::Header| (header.episode, header.step);
        self.decision.header().map(place) <= self.sensed.header().map(place)
    }

    /// Shows the frame that is sensed now; `is_new`: for the first time.
    fn show(&mut self, node: &Node, is_new: bool) -> Result<()> {
        self.tell_outcomes(node)?;
        let (Some(sensed), Some(header)) = (self.sensed.message(), self.sensed.header()) else {
            return Ok(());
        };
        let (episode, step) = (header.episode, header.step);
        if !self.renderer.follows(episode) {
            // What a predecessor said in this episode is still in the person's ears.
            if let Some(shown) = &mut self.shown {
                shown.take()?;
            }
            let shown = self.shown.as_ref().and_then(Input::message);
            self.renderer.follow(episode, shown);
        } else if node.is_active(episode, step) {
            self.shown = None; // from here on, it is this one's own
        }
        let mut display = self.display.loan()?;
        self.renderer
            .render(sensed, self.decision.message(), &mut display);
        if let Some(assistance) = self.assistance.as_mut().filter(|_| is_new) {
            assistance.look(header, self.decision.message(), &mut display);
        }
        if let Some(events) = &mut self.events
            && node.is_active(episode, step)
        {
            self.picture.take()?;
            if let Some(picture) = self.picture.message() {
                events.picture(picture);
            }
            // A closed terminal is no reason to stop showing.
            let _ = events.display(&display, sensed);
        }
        display.send(Stamp::of(header))?;
        Ok(())
    }

    fn tell_outcomes(&mut self, node: &Node) -> Result<()> {
        while self.outcome.take()? {
            if let (Some(events), Some(outcome)) = (&mut self.events, self.outcome.message())
                && node.is_active(outcome.header.episode, outcome.header.step)
            {
                let _ = events.outcome(outcome);
            }
        }
        Ok(())
    }
}
