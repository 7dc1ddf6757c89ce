//! The driver process: the person. Sees their part of the LIDAR frame and the display, and acts.
//!
//! In lockstep, the person looks at the display of step k before acting at k. In real time they wait for it no longer
//! than half a step, and see a later one when it comes.

mod person;

pub use person::{Driving, Options};

use anyhow::Result;
use messages::{Display, DriverAction, LidarFrame, topic};
use person::Driver;
use runtime::{ClockMode, Input, Node, Output, Receive, RunArguments, Stamp, Wake, now_ns};

/// Joins the run and drives until it ends.
///
/// # Errors
/// When the options cannot be used, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &Options) -> Result<()> {
    let mut node = Node::join(arguments)?;
    let result = drive(&mut node, options);
    match &result {
        Ok(()) => node.finish()?,
        Err(error) => node.fail(&format!("{error:#}"))?,
    }
    result
}

struct Ports {
    lidar: Input<LidarFrame>,
    display: Input<Display>,
    action: Output<DriverAction>,
}

fn drive(node: &mut Node, options: &Options) -> Result<()> {
    let mut driver = Driver::new(options)?;
    let lockstep = node.arguments().clock == ClockMode::Lockstep;
    let mut ports = Ports {
        lidar: node.input(
            topic::LIDAR,
            if lockstep {
                Receive::InOrder
            } else {
                Receive::Newest
            },
        )?,
        display: node.input(topic::DISPLAY, Receive::InOrder)?,
        action: node.output(topic::DRIVER_ACTION)?,
    };
    node.needs_no_catching_up();
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    let patience_ns = (!lockstep).then(|| options.step_ns() / 2);
    let mut episode = None;
    while node.wait(&mut [&mut ports.lidar], None)? != Wake::Stop {
        ports.lidar.take()?;
        let Some(frame) = ports.lidar.message() else {
            continue;
        };
        let stamp = Stamp::of(&frame.header);
        // Somebody else's episode: a person takes the wheel between two, or where a dead process left it.
        if !node.speaks(stamp.episode, stamp.step) {
            node.pass(stamp.episode, stamp.step);
            node.end_step();
            continue;
        }
        if episode.replace(stamp.episode) != Some(stamp.episode) {
            driver.reset(stamp.episode);
        }
        let wake = match patience_ns {
            None => node.wait_step(&mut [&mut ports.display], stamp.episode, stamp.step, None)?,
            Some(patience) => look(
                node,
                &mut ports.display,
                &mut driver,
                stamp,
                now_ns() + patience,
            )?,
        };
        if wake == Wake::Stop {
            break;
        }
        if let Some(display) = ports.display.message().filter(|_| lockstep) {
            driver.see(display);
        }
        let [throttle, steer] = driver.act(frame);
        ports.action.send_with(stamp, |action| {
            (action.throttle, action.steer) = (throttle, steer)
        })?;
        node.end_step();
    }
    Ok(())
}

/// Sees every display that comes until that of this step, or until the deadline. What is said is heard once, however
/// late it comes; only a display of an earlier episode is passed over.
fn look(
    node: &mut Node,
    display: &mut Input<Display>,
    driver: &mut Driver,
    stamp: Stamp,
    deadline_ns: u64,
) -> Result<Wake> {
    loop {
        while let Some(display) = display.next()? {
            if display.header.episode == stamp.episode {
                driver.see(display);
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
