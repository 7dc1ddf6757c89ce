//! The world's ports, but for those that only one domain has.

use crate::listeners::Listeners;
use crate::truth::Truth;
use anyhow::Result;
use messages::{Cockpit, CommAction, DriverAction, HumanBelief, Outcome, Presence, Sensed, topic};
use runtime::{
    Advance, Input, InputOptions, Node, NodeError, Output, Receive, Source as _, Stamp, Wake,
    now_ns,
};

/// How often the world looks for messages that do not wake it.
const LOOK_NS: u64 = 200_000;
/// Steps that the human model may be behind; a port's buffer holds four times as many.
const MOST_BEHIND: u32 = 16;

/// What came of waiting for a person's action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Awaited {
    /// It is there.
    Action,
    /// Nobody is at the wheel any more.
    GivenUp,
    /// The run ends.
    Stop,
}

/// Ports of the world process.
pub struct WorldPorts<S: Sensed> {
    sensed: Output<S>,
    outcome: Output<Outcome>,
    /// The driver's actions.
    pub action: Input<DriverAction>,
    /// Of these, only an episode's last one is awaited.
    human: Input<HumanBelief>,
    /// Newest step that a human model spoke of. One that hands over may still be at earlier steps when its successor
    /// has spoken, so the message that came last does not tell.
    human_at: Option<(u32, u32)>,
    decision: Input<CommAction>,
    /// Where a person is at the wheel: whether they are there.
    cockpit: Option<Input<Cockpit>>,
    /// Who is waited for though nobody needs their answer.
    pub listeners: Listeners,
}

impl<S: Sensed> WorldPorts<S> {
    /// Makes them.
    pub fn new(node: &Node, has_cockpit: bool) -> Result<Self> {
        let receive = Receive::in_clock(node.arguments().clock);
        // Looked at once a step; where it wakes nobody, nobody has to notify it a thousand times a second.
        let asleep = InputOptions {
            wakes: false,
            ..InputOptions::new(Receive::Newest)
        };
        Ok(Self {
            sensed: node.output(S::TOPIC)?,
            outcome: node.output(topic::OUTCOME)?,
            action: node.input(topic::DRIVER_ACTION, receive)?,
            human: node.input_with(
                topic::HUMAN_BELIEF,
                InputOptions {
                    receive: Receive::InOrder,
                    ..asleep
                },
            )?,
            human_at: None,
            decision: node.input_with(topic::COMM_ACTION, asleep)?,
            cockpit: match has_cockpit {
                true => Some(node.input(topic::COCKPIT, Receive::Newest)?),
                false => None,
            },
            listeners: Listeners::new(node)?,
        })
    }

    /// Passes over the beliefs and decisions that came since the last step. Waits for a human model that has fallen far
    /// behind: without a planner nobody else waits for it, and its inputs would overflow.
    pub fn keep_together(&mut self, node: &mut Node, episode: u32, step: u32) -> Result<Wake> {
        self.decision.take()?;
        match step.checked_sub(MOST_BEHIND) {
            Some(oldest) => self.await_human(node, (episode, oldest)),
            None => {
                self.hear_human()?;
                Ok(Wake::Message)
            }
        }
    }

    fn hear_human(&mut self) -> Result<()> {
        while self.human.take()? {
            let heard = self.human.header().map(|h| (h.episode, h.step));
            self.human_at = self.human_at.max(heard);
        }
        Ok(())
    }

    fn await_human(&mut self, node: &mut Node, position: (u32, u32)) -> Result<Wake> {
        self.hear_human()?;
        while self.human_at < Some(position) {
            let looked = node.wait(&mut [&mut self.human], Some(now_ns() + LOOK_NS))?;
            if looked == Wake::Stop {
                return Ok(Wake::Stop);
            }
            self.hear_human()?;
        }
        Ok(Wake::Message)
    }

    /// Waits for the human model's belief of the last step and the planner's decision after it.
    pub fn await_last(&mut self, node: &mut Node, episode: u32, step: u32) -> Result<Wake> {
        let decision = &mut self.decision;
        match look_until(|deadline| node.wait_step(&mut [decision], episode, step, Some(deadline)))?
        {
            Wake::Stop => Ok(Wake::Stop),
            _ => self.await_human(node, (episode, step - 1)),
        }
    }

    /// Whether somebody is at the wheel, as far as was heard in this episode; nobody is asked where no person drives.
    pub fn presence(&mut self, episode: u32) -> Result<Presence> {
        let Some(cockpit) = &mut self.cockpit else {
            return Ok(Presence::Present);
        };
        cockpit.take()?;
        let newest = cockpit.message();
        let newest = newest.filter(|newest| newest.header.episode == episode);
        let presence = newest.and_then(|newest| newest.presence().ok());
        Ok(presence.unwrap_or(Presence::Absent))
    }

    /// Waits until somebody is at the wheel, or the episode is given up.
    pub fn await_presence(&mut self, node: &mut Node, episode: u32) -> Result<(Wake, Presence)> {
        loop {
            let presence = self.presence(episode)?;
            let Some(cockpit) = self.cockpit.as_mut() else {
                return Ok((Wake::Message, presence));
            };
            if presence != Presence::Absent {
                return Ok((Wake::Message, presence));
            }
            if node.wait(&mut [cockpit], None)? == Wake::Stop {
                return Ok((Wake::Stop, presence));
            }
        }
    }

    /// Waits for the action of a step; where a person is at the wheel, also for their giving up.
    pub fn await_action(&mut self, node: &mut Node, episode: u32, step: u32) -> Result<Awaited> {
        if self.cockpit.is_none() {
            let wake = node.wait_step(&mut [&mut self.action], episode, step, None)?;
            return Ok(match wake {
                Wake::Stop => Awaited::Stop,
                _ => Awaited::Action,
            });
        }
        loop {
            match self.action.advance_to(episode, step)? {
                Advance::Waiting => {}
                Advance::There | Advance::Passed => return Ok(Awaited::Action),
            }
            if self.presence(episode)? == Presence::GivenUp {
                return Ok(Awaited::GivenUp);
            }
            let Some(cockpit) = self.cockpit.as_mut() else {
                continue;
            };
            if node.wait(&mut [&mut self.action, cockpit], None)? == Wake::Stop {
                return Ok(Awaited::Stop);
            }
        }
    }

    /// The newest action of this episode.
    pub fn newest_action(&mut self, episode: u32) -> Result<Option<&DriverAction>> {
        self.action.take()?;
        let action = self.action.message();
        Ok(action.filter(|action| action.header.episode == episode))
    }

    /// Sends what is true and what is sensed at a step; what is sensed last, because it is what sets everybody to work.
    pub fn publish(
        &mut self,
        world: &mut impl Truth<Sensed = S>,
        episode: u32,
        step: u32,
    ) -> Result<()> {
        let stamp = Stamp::sensed(episode, step);
        self.outcome.send_with(stamp, |out| world.tell(out))?;
        world.show(stamp)?;
        if world.is_running() {
            self.sensed.send_with(stamp, |out| world.sense(out))?;
        }
        Ok(())
    }
}

/// Waits for inputs that do not wake by looking every [`LOOK_NS`].
fn look_until(mut look: impl FnMut(u64) -> Result<Wake, NodeError>) -> Result<Wake> {
    loop {
        match look(now_ns() + LOOK_NS)? {
            Wake::Deadline => {}
            wake => return Ok(wake),
        }
    }
}
