//! The renderer: turns the planner's decision for a step into highlights and utterances, and tells the terminal.

mod content;
mod events;

pub use content::{Options, Renderer};
pub use events::Events;

use anyhow::Result;
use messages::{CommAction, Display, Header, LidarFrame, Outcome, topic};
use runtime::{ClockMode, Input, InputOptions, Node, Output, Receive, RunArguments, Stamp, Wake};
use std::io::{self, IsTerminal};

/// Joins the run and renders until it ends.
///
/// # Errors
/// When the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &Options) -> Result<()> {
    let mut node = Node::join(arguments)?;
    let result = Process::new(&node, options).and_then(|mut process| match arguments.clock {
        ClockMode::Lockstep => process.lockstep(&mut node),
        ClockMode::RealTime => process.real_time(&mut node),
    });
    let told = match &result {
        Ok(()) => node.finish(),
        Err(error) => node.fail(&format!("{error:#}")),
    };
    // Why the process failed matters more than that the launcher could not be told.
    result.and(told.map_err(Into::into))
}

struct Process {
    lidar: Input<LidarFrame>,
    decision: Input<CommAction>,
    outcome: Input<Outcome>,
    display: Output<Display>,
    /// What a predecessor showed, for one that joins late.
    shown: Option<Input<Display>>,
    renderer: Renderer,
    events: Option<Events<io::Stdout>>,
}

impl Process {
    fn new(node: &Node, options: &Options) -> Result<Self> {
        let receive = match node.arguments().clock {
            ClockMode::Lockstep => Receive::InOrder,
            ClockMode::RealTime => Receive::Newest,
        };
        let colours = io::stdout().is_terminal();
        Ok(Self {
            lidar: node.input(topic::LIDAR, receive)?,
            decision: node.input(topic::COMM_ACTION, receive)?,
            outcome: node.input(topic::OUTCOME, Receive::InOrder)?,
            display: node.output(topic::DISPLAY)?,
            shown: match node.arguments().standby {
                false => None,
                true => {
                    let asleep = InputOptions {
                        wakes: false,
                        ..InputOptions::new(Receive::Newest)
                    };
                    Some(node.input_with(topic::DISPLAY, asleep)?.uncounted())
                }
            },
            renderer: Renderer::new(options),
            events: options
                .print
                .then(|| Events::new(io::stdout(), colours, options)),
        })
    }

    /// Every frame waits for its decision; for an episode's first there is none.
    fn lockstep(&mut self, node: &mut Node) -> Result<()> {
        if node.ready()? == Wake::Stop {
            return Ok(());
        }
        while node.wait(&mut [&mut self.lidar], None)? != Wake::Stop {
            self.lidar.take()?;
            let Some((episode, step)) = self
                .lidar
                .header()
                .map(|header| (header.episode, header.step))
            else {
                continue;
            };
            if step > 0 {
                match node.wait_step(&mut [&mut self.decision], episode, step, None)? {
                    Wake::Stop => break,
                    // Who joined late has no decision for its first frames; they are not its own to show.
                    Wake::Passed if !node.speaks(episode, step) => continue,
                    _ => {}
                }
            }
            self.show(node)?;
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
            &mut [&mut self.lidar, &mut self.decision, &mut self.outcome],
            None,
        )? != Wake::Stop
        {
            let sensed = self.lidar.take()?;
            let decided = self.decision.take()?;
            if sensed || (decided && self.is_late()) {
                node.count_missed(u64::from(!sensed));
                self.show(node)?;
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
        self.decision.header().map(place) <= self.lidar.header().map(place)
    }

    fn show(&mut self, node: &Node) -> Result<()> {
        self.tell_outcomes(node)?;
        let Some(frame) = self.lidar.message() else {
            return Ok(());
        };
        let Header { episode, step, .. } = frame.header;
        if !self.renderer.follows(episode) {
            // What a predecessor said in this episode is still in the person's ears.
            if let Some(shown) = &mut self.shown {
                shown.take()?;
            }
            let shown = self.shown.as_ref().and_then(Input::message);
            self.renderer.follow(episode, shown);
        } else if node.speaks(episode, step) {
            self.shown = None; // from here on, it is this one's own
        }
        let mut display = self.display.loan()?;
        self.renderer
            .render(frame, self.decision.message(), &mut display);
        if let Some(events) = &mut self.events
            && node.speaks(episode, step)
        {
            // A closed terminal is no reason to stop showing.
            let _ = events.display(&display, frame);
        }
        display.send(Stamp::of(&frame.header))?;
        Ok(())
    }

    fn tell_outcomes(&mut self, node: &Node) -> Result<()> {
        while self.outcome.take()? {
            if let (Some(events), Some(outcome)) = (&mut self.events, self.outcome.message())
                && node.speaks(outcome.header.episode, outcome.header.step)
            {
                let _ = events.outcome(outcome);
            }
        }
        Ok(())
    }
}
