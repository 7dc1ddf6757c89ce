//! The driver process: the person. Sees their part of what can be sensed, and the display, and acts.
//!
//! With a cockpit ([`cockpit`]) it is a human being at a page in a browser.
//!
//! In lockstep, the person looks at the display of step k before acting at k. In real time they wait for it no longer
//! than half a step, and see a later one when it comes.

pub mod cockpit;
mod gridworld;
mod highway;
mod person;

pub use cockpit::CockpitOptions;
pub use domains::discrete::Acting;
pub use gridworld::GridworldSeat;
pub use highway::{Driving, HighwaySeat};

use anyhow::{Result, ensure};
use gridworld::GridworldPlayer;
use highway::HighwayDriver;
use messages::{Display, DriverAction, Sensed, topic};
use person::ActingPerson;
use runtime::{
    ClockMode, Input, Node, Output, Receive, RunArguments, Stamp, Wake, now_ns, run_process,
};
use scenario::Scenario;
use serde::{Deserialize, Serialize};

/// Options of the driver process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriverOptions {
    /// Where the person is, and who they are.
    #[serde(rename = "place")]
    pub scenario: Scenario<HighwaySeat, GridworldSeat>,
    /// Seed of the person's noise.
    pub seed: u64,
    /// A person at a page in a browser, in place of the one that [`DriverOptions::scenario`] names, who stands in for
    /// them where something has to be known of a person in advance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cockpit: Option<CockpitOptions>,
}

/// Joins the run and drives until it ends.
///
/// # Errors
/// When the options cannot be used, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &DriverOptions) -> Result<()> {
    let seed = options.seed;
    if let Some(cockpit) = &options.cockpit {
        return run_process(arguments, |node| cockpit::sit(node, options, cockpit));
    }
    run_process(arguments, |node| match &options.scenario {
        Scenario::Highway(seat) => drive(node, HighwayDriver::new(seat, seed)?, seat.step_ns() / 2),
        Scenario::Gridworld(seat) => drive(
            node,
            GridworldPlayer::new(seat, seed)?,
            seat.scene.step_ns() / 2,
        ),
    })
}

struct DriverPorts<S: Sensed> {
    sensed: Input<S>,
    display: Input<Display>,
    action: Output<DriverAction>,
}

/// `patience_ns`: how long the person waits for a display in real time.
fn drive<P: ActingPerson>(node: &mut Node, mut person: P, patience_ns: u64) -> Result<()> {
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let mut ports = DriverPorts::<P::Sensed> {
        sensed: node.input(P::Sensed::TOPIC, Receive::in_clock(node.arguments().clock))?,
        display: node
            .input(topic::DISPLAY, Receive::InOrder)?
            .once_in(node.arguments().clock),
        action: node.output(topic::DRIVER_ACTION)?,
    };
    node.needs_no_catching_up();
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    let patience_ns = (!lockstep).then_some(patience_ns);
    let mut episode = None;
    while node.wait(&mut [&mut ports.sensed], None)? != Wake::Stop {
        ports.sensed.take()?;
        let (Some(sensed), Some(header)) = (ports.sensed.message(), ports.sensed.header()) else {
            continue;
        };
        ensure!(
            sensed.measure() == person.measure(),
            "{}: domain, visual and verbal numbers are {:?}, this person's are {:?}",
            P::Sensed::TOPIC,
            sensed.measure(),
            person.measure()
        );
        let stamp = Stamp::of(header);
        // Somebody else's episode: a person takes the wheel between two, or where a dead process left it.
        if !node.is_active(stamp.episode, stamp.step) {
            node.pass(stamp.episode, stamp.step);
            node.end_step();
            continue;
        }
        if episode.replace(stamp.episode) != Some(stamp.episode) {
            person.reset(stamp.episode);
        }
        let wake = match patience_ns {
            None => node.wait_step(&mut [&mut ports.display], stamp.episode, stamp.step, None)?,
            Some(patience) => look(
                node,
                &mut ports.display,
                &mut person,
                stamp,
                now_ns() + patience,
            )?,
        };
        if wake == Wake::Stop {
            break;
        }
        if let Some(display) = ports.display.message().filter(|_| lockstep) {
            person.see(display);
        }
        ports
            .action
            .send_with(stamp, |action| person.act(sensed, action))?;
        node.end_step();
    }
    Ok(())
}

/// Sees every display that comes until that of this step, or until the deadline. What is said is heard once, however
/// late it comes; only a display of an earlier episode is passed over.
fn look(
    node: &mut Node,
    display: &mut Input<Display>,
    person: &mut impl ActingPerson,
    stamp: Stamp,
    deadline_ns: u64,
) -> Result<Wake> {
    loop {
        while let Some(display) = display.next()? {
            if display.header.episode == stamp.episode {
                person.see(display);
            }
            if (display.header.episode, display.header.step) >= (stamp.episode, stamp.step) {
                return Ok(Wake::Message);
            }
        }
        match node.wait(&mut [&mut *display], Some(deadline_ns))? {
            Wake::Message => {}
            wake => return Ok(wake),
        }
    }
}
