//! The live view: a page that shows a run while it goes on. The process behind it only watches: nobody waits for it,
//! and it can be ended and started again at any time.
//!
//! What a step's messages say together is a [`Frame`]. The newest frame replaces older ones on their way to a page, so
//! that a page that is slow sees fewer of them; the last minute's are kept for pages that are opened later.

mod decode;
mod frame;
mod ports;
mod recording;
mod stage;

pub use decode::Decoder;
pub use frame::{Frame, Frames};
pub use recording::{Beside, show_recording};
use stage::Describe;
pub use stage::{Road, Stage};

use anyhow::{Context, Result};
use messages::Report;
use ports::Ports;
use recorder::topics::Recorded;
use runtime::{Observer, ObserverWake, RunArguments, now_ns, text_of};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use web::{Access, Incoming, LIVE_VIEW, Server, Slot};

/// How often the ports are looked at.
const LOOK_NS: u64 = 10_000_000;
/// A page is shown at most so many frames a second.
const SHOW_NS: u64 = 33_000_000;
/// Frames kept: a minute of the highway.
const KEPT: usize = 400;

/// Options of the view process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewOptions {
    /// Where the run takes place.
    pub stage: Stage,
    /// The robot's self-model, which decodes what the person is believed to believe.
    pub model: PathBuf,
    /// What the human model learned of the person's sight.
    pub implants: Option<PathBuf>,
    /// What drives, models, and decides, for the page.
    pub about: BTreeMap<String, String>,
}

/// Where the process finds what its server needs.
pub fn access_file(arguments: &RunArguments) -> PathBuf {
    arguments.directory().join("view-access.json")
}

/// Shows a run until it ends.
///
/// # Errors
/// When nothing can be served, or a port fails.
pub fn run(arguments: &RunArguments, options: &ViewOptions) -> Result<()> {
    let mut observer = Observer::join(arguments)?;
    let access = Access::load(&access_file(arguments)).context("the live view's address")?;
    let decoder = Decoder::new(&options.stage, &options.model, options.implants.as_deref())?;
    let mut ports = Ports::new(&observer)?;
    let server = Server::start(&access, LIVE_VIEW)?;
    let mut view = View {
        hello: hello(options, &decoder, arguments.run_id),
        frames: Frames::new(decoder),
        kept: VecDeque::with_capacity(KEPT),
        reports: BTreeMap::new(),
        has_changed: false,
        shown_ns: 0,
        server,
    };
    view.server.greet(&view.hello.to_string());
    loop {
        view.hear_pages();
        ports.drain(|message| view.take(message))?;
        view.keep();
        view.show();
        match observer.sleep(now_ns() + LOOK_NS)? {
            ObserverWake::Deadline => {}
            ObserverWake::Stop | ObserverWake::RunOver => break,
        }
    }
    // The set may be gone already; pages hear that it is over all the same.
    let drained = ports.drain(|message| view.take(message));
    view.shown_ns = 0;
    view.show();
    view.server.tell(r#"{"t":"over"}"#);
    drained
}

fn hello(options: &ViewOptions, decoder: &Decoder, run_id: u64) -> Value {
    json!({
        "t": "hello",
        "run": format!("{run_id:016x}"),
        "about": options.about,
        "stage": options.stage.describe(),
        "sight": decoder.sight(),
    })
}

struct View {
    hello: Value,
    frames: Frames,
    kept: VecDeque<Arc<str>>,
    /// What every process says of itself.
    reports: BTreeMap<String, Value>,
    has_changed: bool,
    shown_ns: u64,
    server: Server,
}

impl View {
    fn hear_pages(&mut self) {
        while let Some(incoming) = self.server.take() {
            // A page has nothing to say here; one that is opened is shown the last minute.
            if let Incoming::Joined(page) = incoming {
                for frame in &self.kept {
                    self.server.tell_one(page, frame);
                }
            }
        }
    }

    fn take(&mut self, message: &Recorded) {
        if let Recorded::Report(report) = message {
            self.reports.insert(text_of(&report.process), of(report));
        }
        self.frames.take(message);
        self.has_changed = true;
    }

    /// Keeps the frames that are complete.
    fn keep(&mut self) {
        for complete in self.frames.settle() {
            if self.kept.len() == KEPT {
                self.kept.pop_front();
            }
            let text: Arc<str> = complete.json(&Value::Null).into();
            self.kept.push_back(text);
        }
    }

    fn show(&mut self) {
        let now = now_ns();
        if !self.has_changed || now.saturating_sub(self.shown_ns) < SHOW_NS {
            return;
        }
        (self.has_changed, self.shown_ns) = (false, now);
        // The newest step, and the one before it, in which human model and planner have spoken.
        if let Some(frame) = self.frames.before() {
            self.server.publish(Slot::Step, &frame.json(&Value::Null));
        }
        if let Some(frame) = self.frames.current() {
            let reports = json!(self.reports);
            self.server.publish(Slot::Motion, &frame.json(&reports));
        }
    }
}

fn of(report: &Report) -> Value {
    json!({
        "steps": report.steps,
        "missed": report.missed_deadlines,
        "compute_us": report.compute_ns.map(|ns| ns / 1000),
        "lost": report.ports.iter().take(report.port_count as usize).map(|port| port.lost).sum::<u64>(),
    })
}
