//! Watching a set: as one more subscriber of every topic, which looks every few milliseconds and is never woken.

use crate::about::{AskStatus, SetDescription, about};
use crate::graph::GraphTopic;
use crate::started::StartedSet;
use crate::system::{self, Machine, Usage};
use crate::table::{MOST_STEPS, StepTable};
use anyhow::Result;
use messages::PROCESSES;
use messages::{
    CommAction, Display, DriverAction, Header, HumanBelief, ImagineAnswer, ImagineRequest,
    LidarFrame, Observation, Report, RobotBelief, topic,
};
use runtime::instance::{nodes, root_of};
use runtime::{Input, Observer, ObserverWake, PortError, now_ns, text_of};
use std::collections::BTreeMap;

/// Between two looks. Inputs hold a thousand messages each, a tenth of a second of the fastest lockstep run; the rarer
/// the looks, the less they disturb: messages are then fetched in long rows …
const LOOK_NS: u64 = 20_000_000;
/// … but only four of the planner's half-megabyte questions are held, of which two are open at a time.
const LOOK_AT_PLANS_NS: u64 = 1_500_000;
/// Without a question for so long, none are expected.
const PLANS_NS: u64 = 1_000_000_000;
/// Between two readings of processor times.
const USAGE_NS: u64 = 250_000_000;
/// How long a process may take for a report.
const REPORT_NS: u64 = 1_000_000_000;
/// Between two looks for it.
const REPORT_LOOK_NS: u64 = 2_000_000;

/// One subscriber of every topic of a step.
pub struct WatchPorts {
    lidar: Input<LidarFrame>,
    observation: Input<Observation>,
    robot_belief: Input<RobotBelief>,
    human_belief: Input<HumanBelief>,
    decision: Input<CommAction>,
    display: Input<Display>,
    action: Input<DriverAction>,
    questions: Input<ImagineRequest>,
    answers: Input<ImagineAnswer>,
    /// The newest frame's header; in a gridworld, the newest observation's.
    pub frame: Option<Header>,
    /// Messages taken.
    pub messages: u64,
    /// Until when questions are expected.
    plans_until: u64,
}

impl WatchPorts {
    /// Subscribes. `expects_plans`: whether the planner may be imagining, so that looks must be frequent from the
    /// start.
    ///
    /// # Errors
    /// [`PortError`], as when the set speaks another version of a message.
    pub fn attach(observer: &Observer, expects_plans: bool) -> Result<Self, PortError> {
        Ok(Self {
            lidar: observer.input(topic::LIDAR)?,
            observation: observer.input(topic::OBSERVATION)?,
            robot_belief: observer.input(topic::ROBOT_BELIEF)?,
            human_belief: observer.input(topic::HUMAN_BELIEF)?,
            decision: observer.input(topic::COMM_ACTION)?,
            display: observer.input(topic::DISPLAY)?,
            action: observer.input(topic::DRIVER_ACTION)?,
            questions: observer.input(topic::IMAGINE)?,
            answers: observer.input(topic::IMAGINE_ANSWER)?,
            frame: None,
            messages: 0,
            plans_until: if expects_plans {
                now_ns() + PLANS_NS
            } else {
                0
            },
        })
    }

    /// Takes what waits. Of every message only the header is read, and of decisions and imagination a number more.
    pub fn drain(&mut self, table: &mut StepTable) -> Result<(), PortError> {
        let questions_before = self.questions.received();
        let mut messages = 0;
        macro_rules! headers {
            ($($input:ident: $topic:ident,)*) => {$(
                while self.$input.take()? {
                    if let Some(header) = self.$input.header() {
                        messages += 1;
                        table.add(GraphTopic::$topic, header);
                    }
                }
            )*};
        }
        headers! {
            robot_belief: RobotBelief, human_belief: HumanBelief, display: Display, action: Action,
        }
        macro_rules! frames {
            ($($input:ident: $topic:ident,)*) => {$(
                while self.$input.take()? {
                    if let Some(header) = self.$input.header() {
                        messages += 1;
                        table.add(GraphTopic::$topic, header);
                        self.frame = Some(*header);
                    }
                }
            )*};
        }
        frames! { lidar: Lidar, observation: Observation, }
        while self.decision.take()? {
            if let Some(decision) = self.decision.message() {
                messages += 1;
                table.add_decision(decision);
            }
        }
        while self.questions.take()? {
            if let Some(question) = self.questions.message() {
                messages += 1;
                table.add_imagination(&question.header, question.group, false);
            }
        }
        while self.answers.take()? {
            if let Some(answer) = self.answers.message() {
                messages += 1;
                table.add_imagination(&answer.header, answer.group, true);
            }
        }
        self.messages += messages;
        if self.questions.received() != questions_before {
            self.plans_until = now_ns() + PLANS_NS;
        }
        Ok(())
    }

    /// The newest frame's header; what waits on other topics is left where it is.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn newest_frame(&mut self) -> Result<Option<Header>, PortError> {
        newest_of(&mut self.lidar, &mut self.observation)
    }

    /// How long to sleep until the next look.
    pub fn pause_ns(&self) -> u64 {
        if now_ns() < self.plans_until {
            LOOK_AT_PLANS_NS
        } else {
            LOOK_NS
        }
    }

    /// Messages that these inputs lost, by topic.
    fn lost(&self) -> BTreeMap<String, u64> {
        [
            (topic::LIDAR, self.lidar.lost()),
            (topic::OBSERVATION, self.observation.lost()),
            (topic::ROBOT_BELIEF, self.robot_belief.lost()),
            (topic::HUMAN_BELIEF, self.human_belief.lost()),
            (topic::COMM_ACTION, self.decision.lost()),
            (topic::DISPLAY, self.display.lost()),
            (topic::DRIVER_ACTION, self.action.lost()),
            (topic::IMAGINE, self.questions.lost()),
            (topic::IMAGINE_ANSWER, self.answers.lost()),
        ]
        .map(|(topic, lost)| (topic.to_owned(), lost))
        .into()
    }
}

/// One subscriber of frames, whichever the world sends.
pub struct FrameMarker {
    lidar: Input<LidarFrame>,
    observation: Input<Observation>,
}

impl FrameMarker {
    /// Subscribes.
    ///
    /// # Errors
    /// As [`WatchPorts::attach`].
    pub fn attach(observer: &Observer) -> Result<Self, PortError> {
        Ok(Self {
            lidar: observer.input(topic::LIDAR)?,
            observation: observer.input(topic::OBSERVATION)?,
        })
    }

    /// The newest header that waits.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn newest(&mut self) -> Result<Option<Header>, PortError> {
        newest_of(&mut self.lidar, &mut self.observation)
    }
}

fn newest_of(
    lidar: &mut Input<LidarFrame>,
    observation: &mut Input<Observation>,
) -> Result<Option<Header>, PortError> {
    while lidar.take()? {}
    while observation.take()? {}
    Ok(lidar.header().or(observation.header()).copied())
}

/// When to stop watching, besides at the run's end and on a signal.
#[derive(Clone, Copy, Debug, Default)]
pub struct Until {
    /// After so many nanoseconds since the first frame.
    pub ns: Option<u64>,
    /// When this many episodes have ended.
    pub episodes: Option<u32>,
}

/// Why watching ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchEnd {
    /// What was asked for has been seen.
    Enough,
    /// Memory holds no more steps.
    Full,
    /// The run ended.
    RunOver,
    /// SIGINT or SIGTERM.
    Stop,
}

/// A process of the set, as it was found.
#[derive(Clone, Debug, Default)]
pub struct Watched {
    /// Process id; 0 for none.
    pub pid: u32,
    /// Processor times at the beginning and when last read.
    pub usage: Option<[Usage; 2]>,
    /// Memory when last read: resident and proportional, in KiB.
    pub memory_kib: Option<(u64, u64)>,
    /// The first report sent since the beginning, and the newest.
    pub reports: Option<Box<[Report; 2]>>,
}

/// What was observed.
pub struct Observed {
    /// Headers of all messages.
    pub table: StepTable,
    /// What the set says about itself.
    pub about: SetDescription,
    /// The processes, in launch order, and the launcher last.
    pub processes: Vec<Watched>,
    /// The machine before and after.
    pub machine: [Machine; 2],
    /// This process before and after.
    pub own: [Usage; 2],
    /// Messages that this process itself lost, by topic.
    pub lost: BTreeMap<String, u64>,
    /// Messages taken.
    pub messages: u64,
    /// How long.
    pub seconds: f64,
    /// Why it ended.
    pub end: WatchEnd,
}

impl Observed {
    /// Whether no step was seen.
    pub fn is_empty(&self) -> bool {
        self.table.len() == 0
    }
}

/// Somebody who watches a set. The ports come before what they belong to.
pub struct Watch {
    reports: Input<Report>,
    /// What is watched.
    pub observer: Observer,
    /// The set, where it is our own.
    pub started: Option<StartedSet>,
    ask: AskStatus,
}

impl Watch {
    /// Begins to listen to reports. `ask`: how the set's launcher is asked for its status.
    ///
    /// # Errors
    /// When the port cannot be made.
    pub fn new(observer: Observer, started: Option<StartedSet>, ask: AskStatus) -> Result<Self> {
        Ok(Self {
            reports: observer.input(topic::REPORT)?,
            observer,
            started,
            ask,
        })
    }

    /// Watches.
    ///
    /// # Errors
    /// When a port fails.
    pub fn observe(&mut self, until: Until) -> Result<Observed> {
        let attached_ns = now_ns();
        let mut ports = WatchPorts::attach(&self.observer, true)?;
        let mut table = StepTable::default();
        let mut processes = vec![Watched::default(); PROCESSES.len() + 1];
        let mut end = self.first_frame(&mut ports, &mut table)?;
        let about = about(&self.observer, self.ask);
        let run_id = ports.frame.map_or(about.run_id, |frame| frame.run_id);
        self.find(&mut processes);
        let (own_before, machine_before) = (own(), system::machine());
        let started = now_ns();
        if end.is_none() {
            self.observer.request_reports(run_id)?;
        }
        let mut next_usage = started + USAGE_NS;
        while end.is_none() {
            match self.observer.sleep(now_ns() + ports.pause_ns())? {
                ObserverWake::Deadline => {}
                ObserverWake::RunOver => end = Some(WatchEnd::RunOver),
                ObserverWake::Stop => end = Some(WatchEnd::Stop),
            }
            ports.drain(&mut table)?;
            self.take_reports(&mut processes, run_id, attached_ns)?;
            let now = now_ns();
            if now >= next_usage {
                next_usage = now + USAGE_NS;
                read_usage(&mut processes, false);
            }
            // The frame of an episode says that those before it are over.
            let episodes = ports.frame.map_or(0, |frame| frame.episode);
            if until.ns.is_some_and(|ns| now - started >= ns)
                || until.episodes.is_some_and(|asked| episodes >= asked)
            {
                end.get_or_insert(WatchEnd::Enough);
            } else if table.len() >= MOST_STEPS {
                end.get_or_insert(WatchEnd::Full);
            }
        }
        let own_after = own();
        read_usage(&mut processes, true);
        let machine = [machine_before, system::machine()];
        let seconds = (own_after.at_ns - own_before.at_ns) as f64 * 1e-9;
        // What is still on its way belongs to the last steps; those who ended have said their last words.
        ports.drain(&mut table)?;
        let end = end.unwrap_or(WatchEnd::Enough);
        if end != WatchEnd::RunOver && run_id != 0 {
            self.last_reports(&mut processes, run_id, attached_ns)?;
        }
        self.take_reports(&mut processes, run_id, attached_ns)?;
        Ok(Observed {
            table,
            about,
            processes,
            machine,
            own: [own_before, own_after],
            lost: ports.lost(),
            messages: ports.messages,
            seconds,
            end,
        })
    }

    /// Waits for the first frame. A set that we started learns first.
    fn first_frame(
        &mut self,
        ports: &mut WatchPorts,
        table: &mut StepTable,
    ) -> Result<Option<WatchEnd>> {
        loop {
            match self.observer.sleep(now_ns() + ports.pause_ns())? {
                ObserverWake::Deadline => {}
                ObserverWake::RunOver => return Ok(Some(WatchEnd::RunOver)),
                ObserverWake::Stop => return Ok(Some(WatchEnd::Stop)),
            }
            ports.drain(table)?;
            if ports.frame.is_some() {
                return Ok(None);
            }
        }
    }

    /// Finds the processes of the set, and reads their processor times for the first time.
    fn find(&self, processes: &mut [Watched]) {
        let found = self.observer.instance();
        for node in nodes(&root_of(found), found).unwrap_or_default() {
            let known = PROCESSES.iter().position(|name| *name == node.process);
            let place = match node.process.as_str() {
                "launcher" => Some(PROCESSES.len()),
                _ => known,
            };
            if let Some(place) = place.filter(|_| node.alive) {
                processes[place].pid = node.pid;
            }
        }
        for process in processes.iter_mut().filter(|process| process.pid != 0) {
            process.usage = system::usage(process.pid).map(|usage| [usage; 2]);
        }
    }

    /// Asks for reports, and waits for them no longer than [`REPORT_NS`].
    fn last_reports(&mut self, processes: &mut [Watched], run_id: u64, since: u64) -> Result<()> {
        let asked = now_ns();
        self.observer.request_reports(run_id)?;
        let is_new = |process: &Watched| {
            let newest = process.reports.as_ref().map(|reports| &reports[1]);
            newest.is_some_and(|report| report.header.sent_ns >= asked)
        };
        while now_ns() < asked + REPORT_NS {
            let wake = self.observer.sleep(now_ns() + REPORT_LOOK_NS)?;
            self.take_reports(processes, run_id, since)?;
            let all = processes[..PROCESSES.len()]
                .iter()
                .all(|process| process.pid == 0 || is_new(process));
            if all || wake != ObserverWake::Deadline {
                break;
            }
        }
        Ok(())
    }

    /// Keeps the first and the newest report of every process that was sent since.
    fn take_reports(&mut self, processes: &mut [Watched], run_id: u64, since: u64) -> Result<()> {
        while let Some(report) = self.reports.next()? {
            let name = text_of(&report.process);
            let place = PROCESSES.iter().position(|known| *known == name);
            if let Some(place) = place
                && report.header.sent_ns >= since
                && report.header.run_id == run_id
            {
                match &mut processes[place].reports {
                    Some(reports) => reports[1] = *report,
                    none => *none = Some(Box::new([*report; 2])),
                }
            }
        }
        Ok(())
    }
}

/// Reads processor times again, and memory where it is asked for or was never read: that takes the kernel longer.
fn read_usage(processes: &mut [Watched], with_memory: bool) {
    for process in processes.iter_mut().filter(|process| process.pid != 0) {
        if let (Some(now), Some(usage)) = (system::usage(process.pid), &mut process.usage) {
            usage[1] = now;
        }
        if with_memory || process.memory_kib.is_none() {
            let read = system::memory_kib(process.pid);
            process.memory_kib = read.or(process.memory_kib);
        }
    }
}

/// This process now.
pub fn own() -> Usage {
    system::usage(std::process::id()).unwrap_or_default()
}

/// A first frame that never came.
pub fn nothing_seen() -> anyhow::Error {
    anyhow::anyhow!("no step was seen before the run ended")
}

impl Watch {
    /// Leaves, and ends a set of our own. Returns how that set ended, if it did so by itself and badly.
    pub fn end(mut self) -> Option<String> {
        let status = self.started.as_mut().and_then(StartedSet::ended);
        if let Some(started) = self.started.as_mut().filter(|_| status.is_none()) {
            started.end();
        }
        let status = status.filter(|status| *status != 0)?;
        Some(format!("mirror up ended with status {status}"))
    }
}
