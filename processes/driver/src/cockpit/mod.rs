//! A person at the wheel: their page takes the simulated person's place.
//!
//! What the page sends is held until something newer comes, and goes to the world at once. A page that goes away, or
//! falls silent, pauses the round; one that does not come back voids it. Everything that the page tells of itself, when
//! a sentence began to be heard, when a display was seen, how old the input is, goes out on `driver/cockpit` and so into
//! the recording.

mod attendance;
mod board;
mod page;
mod road;

use crate::{DriverOptions, GridworldSeat, HighwaySeat};
use anyhow::{Context, Result, ensure};
use attendance::Attendance;
use board::Board;
use messages::{
    Cockpit, CockpitEvent, Display, DriverAction, EpisodeEnd, Outcome, Presence, Scene, Sensed,
    topic,
};
use page::{FromPage, ToPage};
use road::Drive;
use runtime::{
    Advance, Input, Node, Output, PortError, Receive, RunArguments, Source, Stamp, Wake, now_ns,
};
use scenario::Scenario;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::os::fd::RawFd;
use std::path::PathBuf;
use web::{Access, COCKPIT, Incoming, PageId, Server, Slot};

/// How often the process looks whether the page is still there.
const LOOK_NS: u64 = 100_000_000;
/// States whose drawing a page may still confirm, and sentences whose onset.
const REMEMBERED: usize = 128;

/// A person at a page in a browser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CockpitOptions {
    /// A round is void when nobody has been at the wheel for so long after it began.
    pub void_after_s: f64,
    /// Episodes of the run, for the page.
    pub episodes: u32,
}

/// Where the process finds what its server needs: address and token, which stand in no options, because these go into
/// recordings.
pub fn access_file(arguments: &RunArguments) -> PathBuf {
    arguments.directory().join("cockpit-access.json")
}

/// What is one domain's: what the page is shown, and what its input means.
trait Table {
    type Sensed: Sensed;

    /// What [`Sensed::measure`] must be.
    fn measure(&self) -> [u32; 3];

    /// What the page is told first, beside what every domain has.
    fn scene(&self) -> serde_json::Value;

    /// Whether a page's input holds from step to step; a choice is made anew at every step.
    fn holds_input(&self) -> bool;

    /// Begins an episode.
    fn reset(&mut self, episode: u32);

    /// Something new is sensed.
    fn sense(&mut self, sensed: &Self::Sensed);

    /// What is shown and said.
    fn see(&mut self, display: &Display);

    /// What the page is shown of a step, where that is not in motion.
    fn shown(&self) -> Option<serde_json::Value>;

    /// Where everybody is.
    fn motion(&mut self, scene: &Scene, number: u64) -> Option<ToPage>;
}

/// Joins with a page in the person's place, until the run ends.
///
/// # Errors
/// When nothing can be served, or a port fails.
pub(crate) fn sit(
    node: &mut Node,
    options: &DriverOptions,
    cockpit: &CockpitOptions,
) -> Result<()> {
    match &options.scenario {
        Scenario::Highway(seat) => drive_highway(node, seat, cockpit),
        Scenario::Gridworld(seat) => play(node, seat, options.seed, cockpit),
    }
}

fn drive_highway(node: &mut Node, seat: &HighwaySeat, options: &CockpitOptions) -> Result<()> {
    let table = Drive::new(seat)?;
    Driver::new(node, table, options)?.run(node)
}

fn play(node: &mut Node, seat: &GridworldSeat, seed: u64, options: &CockpitOptions) -> Result<()> {
    let table = Board::new(seat, seed)?;
    Driver::new(node, table, options)?.run(node)
}

/// The server as something that the process waits for.
struct Pages {
    server: Server,
}

impl Source for Pages {
    fn topic(&self) -> &'static str {
        "pages"
    }

    fn pending(&mut self) -> Result<bool, PortError> {
        Ok(self.server.has_incoming())
    }

    fn advance_to(&mut self, _: u32, _: u32) -> Result<Advance, PortError> {
        Ok(Advance::Waiting)
    }

    fn descriptor(&self) -> RawFd {
        self.server.descriptor()
    }

    fn mark_notified(&mut self) {}

    fn drain(&mut self) -> Option<u64> {
        None
    }
}

/// What the person does, as their page last said.
#[derive(Clone, Copy, Debug, Default)]
struct HeldInput {
    throttle: f32,
    steer: f32,
    choice: Option<u32>,
    /// When it arrived; 0 for never.
    arrived_ns: u64,
}

struct Driver<T: Table> {
    table: T,
    pages: Pages,
    attendance: Attendance,
    sensed: Input<T::Sensed>,
    display: Input<Display>,
    outcome: Input<Outcome>,
    motion: Input<Scene>,
    action: Output<DriverAction>,
    cockpit: Output<Cockpit>,
    /// The step that is being acted on.
    stamp: Option<Stamp>,
    /// Whether this step's choice has been made.
    has_chosen: bool,
    input: HeldInput,
    told: Presence,
    round_trip_ns: u64,
    /// Number and time of the states that were sent last.
    sent: VecDeque<(u64, u64)>,
    /// Number, time and words of the sentences that were sent last.
    said: VecDeque<(u64, u64, [u8; 64], u32)>,
    next: u64,
    /// Step and time of the displays that were sent last.
    shown: VecDeque<(u32, u64)>,
}

impl<T: Table> Driver<T> {
    fn new(node: &Node, table: T, options: &CockpitOptions) -> Result<Self> {
        let arguments = node.arguments();
        let access = Access::load(&access_file(arguments)).context("the cockpit's address")?;
        let server = Server::start(&access, COCKPIT)?;
        let hello = ToPage::Hello {
            instance: arguments.instance.clone(),
            run: format!("{:016x}", arguments.run_id),
            episodes: options.episodes,
            void_after_s: options.void_after_s,
            scene: table.scene(),
        };
        server.greet(&hello.text());
        let receive = Receive::in_clock(arguments.clock);
        Ok(Self {
            sensed: node.input(T::Sensed::TOPIC, receive)?,
            display: node.input(topic::DISPLAY, Receive::InOrder)?,
            outcome: node.input(topic::OUTCOME, Receive::InOrder)?,
            motion: node.input(topic::MOTION, Receive::Newest)?.uncounted(),
            action: node.output(topic::DRIVER_ACTION)?,
            cockpit: node.output(topic::COCKPIT)?,
            table,
            pages: Pages { server },
            attendance: Attendance::new((options.void_after_s * 1e9) as u64),
            stamp: None,
            has_chosen: false,
            input: HeldInput::default(),
            told: Presence::Absent,
            round_trip_ns: 0,
            sent: VecDeque::with_capacity(REMEMBERED),
            said: VecDeque::with_capacity(REMEMBERED),
            next: 0,
            shown: VecDeque::with_capacity(REMEMBERED),
        })
    }

    fn run(mut self, node: &mut Node) -> Result<()> {
        node.needs_no_catching_up();
        if node.ready()? == Wake::Stop {
            return Ok(());
        }
        loop {
            let wake = node.wait(
                &mut [
                    &mut self.pages,
                    &mut self.motion,
                    &mut self.sensed,
                    &mut self.display,
                    &mut self.outcome,
                ],
                Some(now_ns() + LOOK_NS),
            )?;
            if wake == Wake::Stop {
                self.tell(&ToPage::Over);
                return Ok(());
            }
            self.hear_pages()?;
            self.take_outcomes()?;
            self.take_sensed(node)?;
            self.take_displays()?;
            self.take_motion()?;
            self.tell_presence()?;
        }
    }

    fn tell(&self, message: &ToPage) {
        self.pages.server.tell(&message.text());
    }

    fn hear_pages(&mut self) -> Result<()> {
        while let Some(incoming) = self.pages.server.take() {
            let now = now_ns();
            match incoming {
                Incoming::Joined(page) => {
                    if let Some(before) = self.attendance.join(page, now) {
                        let server = &self.pages.server;
                        server.tell_one(before, &ToPage::Replaced.text());
                    }
                    if let Some(stamp) = self.stamp {
                        let episode = stamp.episode;
                        let round = ToPage::Round { episode };
                        self.pages.server.tell_one(page, &round.text());
                    }
                }
                Incoming::Left(page) => {
                    if self.attendance.leave(page) {
                        self.input = HeldInput::default();
                    }
                }
                Incoming::Said(page, text) if self.attendance.is_driver(page) => {
                    // What is no message of ours says nothing.
                    if let Ok(message) = serde_json::from_str::<FromPage>(&text) {
                        self.hear(page, message, now)?;
                    }
                }
                Incoming::Said(..) => {}
            }
        }
        Ok(())
    }

    fn hear(&mut self, page: PageId, message: FromPage, now: u64) -> Result<()> {
        self.attendance.hear(now);
        match message {
            FromPage::Ready { episode } => self.attendance.get_ready(episode),
            FromPage::Away => {
                self.attendance.go_away();
                self.input = HeldInput::default();
            }
            FromPage::Input {
                throttle,
                steer,
                drawn,
                held_ms,
            } => {
                let sent = self.sent.iter().rev().find(|(number, _)| *number == drawn);
                if let Some((_, sent_ns)) = sent {
                    let held_ns = to_ns(held_ms);
                    self.round_trip_ns = now.saturating_sub(*sent_ns).saturating_sub(held_ns);
                }
                let (throttle, steer) = (within(throttle), within(steer));
                let is_new = (throttle, steer) != (self.input.throttle, self.input.steer);
                self.input = HeldInput {
                    throttle,
                    steer,
                    choice: None,
                    arrived_ns: now,
                };
                if is_new && self.table.holds_input() {
                    self.act()?;
                }
            }
            FromPage::Choice {
                choice,
                episode,
                step,
            } => {
                // A key that was meant for another step chooses nothing.
                let is_now = self
                    .stamp
                    .is_some_and(|stamp| (stamp.episode, stamp.step) == (episode, step));
                if is_now && !self.has_chosen && self.presence(now) == Presence::Present {
                    self.input = HeldInput {
                        choice: Some(choice),
                        arrived_ns: now,
                        ..HeldInput::default()
                    };
                    self.has_chosen = true;
                    self.act()?;
                }
            }
            FromPage::Heard { id, after_ms } => {
                self.tell_heard(id, Some(to_ns(after_ms)))?;
            }
            FromPage::Unheard { id } => self.tell_heard(id, None)?,
            FromPage::Seen { step, after_ms } => {
                let shown = self.shown.iter().rev().find(|(shown, _)| *shown == step);
                if let Some((_, sent_ns)) = shown {
                    let happened_ns = sent_ns + self.round_trip_ns / 2 + to_ns(after_ms);
                    self.send(CockpitEvent::Seen, |out| out.happened_ns = happened_ns)?;
                }
            }
            FromPage::Ping { at } => {
                self.pages
                    .server
                    .tell_one(page, &ToPage::Pong { at }.text());
            }
        }
        Ok(())
    }

    /// A sentence is heard, so long after it arrived; or not at all.
    fn tell_heard(&mut self, id: u64, after_ns: Option<u64>) -> Result<()> {
        let Some(place) = self.said.iter().position(|(said, ..)| *said == id) else {
            return Ok(());
        };
        // Once.
        let Some((_, sent_ns, text, item)) = self.said.remove(place) else {
            return Ok(());
        };
        let event = match after_ns {
            Some(_) => CockpitEvent::Heard,
            None => CockpitEvent::Unheard,
        };
        let travelled_ns = self.round_trip_ns / 2;
        self.send(event, |out| {
            out.happened_ns = sent_ns + travelled_ns + after_ns.unwrap_or(0);
            (out.text, out.item) = (text, item);
        })
    }

    fn presence(&self, now: u64) -> Presence {
        match self.stamp {
            Some(stamp) => self.attendance.presence(stamp.episode, now),
            None => Presence::Absent,
        }
    }

    /// Sends what the person does now.
    fn act(&mut self) -> Result<()> {
        let (Some(stamp), input) = (self.stamp, self.input) else {
            return Ok(());
        };
        self.action.send_with(stamp, |out| {
            (out.throttle, out.steer) = (input.throttle, input.steer);
            if let Some(choice) = input.choice {
                (out.choice, out.is_choice) = (choice, 1);
            }
        })?;
        Ok(())
    }

    fn send(&mut self, event: CockpitEvent, write: impl FnOnce(&mut Cockpit)) -> Result<()> {
        let Some(stamp) = self.stamp else {
            return Ok(());
        };
        let now = now_ns();
        let presence = self.attendance.presence(stamp.episode, now);
        let arrived_ns = self.input.arrived_ns;
        let (round_trip_ns, pages) = (self.round_trip_ns, self.pages.server.pages() as u32);
        self.cockpit.send_with(stamp, |out| {
            out.event = event.wire();
            out.happened_ns = now;
            out.presence = presence.wire();
            out.round_trip_ns = round_trip_ns;
            out.pages = pages;
            if arrived_ns > 0 {
                out.input_age_ns = now.saturating_sub(arrived_ns);
            }
            write(out);
        })?;
        Ok(())
    }

    /// Tells the world whenever somebody comes or goes.
    fn tell_presence(&mut self) -> Result<()> {
        let presence = self.attendance.attend(now_ns());
        if self.stamp.is_some() && presence != self.told {
            self.told = presence;
            self.send(CockpitEvent::Presence, |_| ())?;
            self.tell(&ToPage::Presence { presence });
        }
        Ok(())
    }

    fn take_sensed(&mut self, node: &mut Node) -> Result<()> {
        while self.sensed.take()? {
            let (Some(sensed), Some(header)) = (self.sensed.message(), self.sensed.header()) else {
                break;
            };
            ensure!(
                sensed.measure() == self.table.measure(),
                "{}: domain, visual and verbal numbers are {:?}, this cockpit's are {:?}",
                T::Sensed::TOPIC,
                sensed.measure(),
                self.table.measure()
            );
            let stamp = Stamp::of(header);
            if !node.is_active(stamp.episode, stamp.step) {
                node.pass(stamp.episode, stamp.step);
                node.end_step();
                continue;
            }
            let is_new = self.stamp.map(|before| before.episode) != Some(stamp.episode);
            if is_new {
                self.table.reset(stamp.episode);
                self.attendance.begin(stamp.episode);
                let episode = stamp.episode;
                self.tell(&ToPage::Round { episode });
                self.input = HeldInput::default();
            }
            self.table.sense(sensed);
            (self.stamp, self.has_chosen) = (Some(stamp), false);
            self.show_step();
            // Whatever is sent about a step is about its episode: also that nobody is there yet.
            self.told = self.attendance.attend(now_ns());
            self.send(CockpitEvent::Presence, |_| ())?;
            if is_new {
                let presence = self.told;
                self.tell(&ToPage::Presence { presence });
            }
            if self.table.holds_input() {
                self.act()?;
            }
            node.end_step();
        }
        Ok(())
    }

    fn show_step(&self) {
        if let (Some(stamp), Some(shown)) = (self.stamp, self.table.shown()) {
            let step = ToPage::Step {
                episode: stamp.episode,
                step: stamp.step,
                shown,
            };
            self.pages.server.publish(Slot::Step, &step.text());
        }
    }

    fn take_displays(&mut self) -> Result<()> {
        while self.display.take()? {
            let Some(display) = self.display.message() else {
                break;
            };
            self.table.see(display);
            let now = now_ns();
            let said = display.utterances.iter();
            for utterance in said.take(display.utterance_count as usize) {
                self.next += 1;
                remember(
                    &mut self.said,
                    (self.next, now, utterance.text, utterance.item),
                );
                let say = ToPage::Say {
                    id: self.next,
                    text: runtime::text_of(&utterance.text),
                    item: utterance.item,
                };
                self.pages.server.tell(&say.text());
            }
            let boxes = display.objects.iter().take(display.object_count as usize);
            let shown = ToPage::Display {
                step: display.header.step,
                boxes: boxes.copied().filter(|id| *id >= 0).collect(),
                items: display.highlighted,
            };
            remember(&mut self.shown, (display.header.step, now));
            self.pages.server.tell(&shown.text());
            self.show_step();
        }
        Ok(())
    }

    fn take_motion(&mut self) -> Result<()> {
        if self.motion.take()?
            && let Some(scene) = self.motion.message()
        {
            self.next += 1;
            if let Some(motion) = self.table.motion(scene, self.next) {
                remember(&mut self.sent, (self.next, now_ns()));
                self.pages.server.publish(Slot::Motion, &motion.text());
            }
        }
        Ok(())
    }

    fn take_outcomes(&mut self) -> Result<()> {
        while self.outcome.take()? {
            let Some(outcome) = self.outcome.message() else {
                break;
            };
            let end = outcome.end().unwrap_or(EpisodeEnd::Running);
            if end != EpisodeEnd::Running {
                let message = ToPage::End {
                    episode: outcome.header.episode,
                    end: page::name_of(end),
                };
                self.pages.server.tell(&message.text());
            }
        }
        Ok(())
    }
}

fn remember<T>(kept: &mut VecDeque<T>, new: T) {
    if kept.len() == REMEMBERED {
        kept.pop_front();
    }
    kept.push_back(new);
}

/// A page's number as an input: what is none is no input.
fn within(value: f32) -> f32 {
    match value.is_finite() {
        true => value.clamp(-1.0, 1.0),
        false => 0.0,
    }
}

/// Milliseconds of a page in nanoseconds; at most a minute, at least nothing.
fn to_ns(ms: f64) -> u64 {
    match ms.is_finite() {
        true => (ms.clamp(0.0, 60_000.0) * 1e6) as u64,
        false => 0,
    }
}
