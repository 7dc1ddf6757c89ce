//! The world process: holds the truth, publishes what can be sensed of it, and moves when the person acts.
//!
//! A world hands over to another, and takes over, between two episodes.
//!
//! At step k it publishes the outcome of step k − 1, what is true and what can be sensed at k, waits for the driver's
//! action k (lockstep) or for the beat (real time), and steps. The step that ends an episode has an outcome, but
//! nothing to be sensed: nobody is asked to act on it.

mod gridworld;
mod highway;
mod listeners;
mod options;
mod ports;
mod truth;

pub use options::{HighwayRoad, WorldOptions};

use anyhow::Result;
use gridworld::Gridworld;
use highway::Highway;
use messages::Presence;
use ports::{Awaited, WorldPorts};
use runtime::{ClockMode, NEVER, Node, RunArguments, Stamp, Ticker, Wake, now_ns, run_process};
use scenario::Scenario;
use truth::Truth;

/// Joins the run and drives its episodes to the end.
///
/// # Errors
/// When the options cannot be used, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &WorldOptions) -> Result<()> {
    run_process(arguments, |node| match &options.scenario {
        Scenario::Highway(road) => {
            let world = Highway::new(node, road.world()?, options.has_cockpit)?;
            drive(node, options, world)
        }
        Scenario::Gridworld(scene) => {
            let world = Gridworld::new(node, scene)?;
            drive(node, options, world)
        }
    })
}

fn drive<T: Truth>(node: &mut Node, options: &WorldOptions, mut world: T) -> Result<()> {
    let mut ports = WorldPorts::new(node, options.has_cockpit)?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    // A world that is on standby begins with the episode that it is told to.
    if node.is_standby() && node.wait_turn(NEVER.0 - 1, 0)? == Wake::Stop {
        return Ok(());
    }
    for episode in node.active_from().0..options.episodes {
        if !node.is_active(episode, 0) {
            node.retire()?;
            if node.wait_turn(episode, 0)? == Wake::Stop {
                break;
            }
        }
        world.reset(options.seed, episode);
        let wake = match node.arguments().clock {
            ClockMode::Lockstep => lockstep(node, &mut ports, &mut world, episode)?,
            ClockMode::RealTime if options.has_cockpit => {
                at_the_wheel(node, &mut ports, &mut world, episode)?
            }
            ClockMode::RealTime => real_time(node, &mut ports, &mut world, episode)?,
        };
        if wake == Wake::Stop {
            break;
        }
    }
    Ok(())
}

/// An episode in which the world waits for every action, however long it takes.
fn lockstep<T: Truth>(
    node: &mut Node,
    ports: &mut WorldPorts<T::Sensed>,
    world: &mut T,
    episode: u32,
) -> Result<Wake> {
    for step in 0.. {
        if ports.keep_together(node, episode, step)? == Wake::Stop
            || ports.listeners.wait(node, (episode, step))? == Wake::Stop
        {
            return Ok(Wake::Stop);
        }
        // When these two are there, everything that others send in this episode has been sent.
        if !world.is_running() && ports.await_last(node, episode, step)? == Wake::Stop {
            return Ok(Wake::Stop);
        }
        ports.publish(world, episode, step)?;
        // A step ends where what it moved is published, so that a frame's compute time covers the moving.
        node.end_step();
        if !world.is_running() {
            break;
        }
        match ports.await_action(node, episode, step)? {
            Awaited::Stop => return Ok(Wake::Stop),
            Awaited::GivenUp => world.give_up(),
            Awaited::Action => world.step(step, ports.action.message()),
        }
    }
    Ok(Wake::Message)
}

/// An episode at the scene's own pace, with the newest action; an action that is not there in time is counted as a
/// missed deadline.
fn real_time<T: Truth>(
    node: &mut Node,
    ports: &mut WorldPorts<T::Sensed>,
    world: &mut T,
    episode: u32,
) -> Result<Wake> {
    let mut ticker = Ticker::new(now_ns(), world.step_ns());
    for step in 0.. {
        ports.publish(world, episode, step)?;
        node.end_step();
        if !world.is_running() {
            break;
        }
        if node.wait_tick(&mut ticker)? == Wake::Stop {
            return Ok(Wake::Stop);
        }
        let action = ports.newest_action(episode)?;
        let is_late = action.is_none_or(|action| action.header.step < step);
        world.step(step, action);
        node.count_missed(u64::from(is_late));
    }
    Ok(Wake::Message)
}

/// As [`real_time`], with a person at the wheel: their action may change from tick to tick, and while nobody is there
/// the world stands still.
fn at_the_wheel<T: Truth>(
    node: &mut Node,
    ports: &mut WorldPorts<T::Sensed>,
    world: &mut T,
    episode: u32,
) -> Result<Wake> {
    let tick_ns = world.step_ns() / u64::from(world.ticks().max(1));
    let mut ticker = Ticker::new(now_ns(), tick_ns);
    for step in 0.. {
        ports.publish(world, episode, step)?;
        node.end_step();
        if !world.is_running() {
            break;
        }
        loop {
            if ports.presence(episode)? != Presence::Present {
                match ports.await_presence(node, episode)? {
                    (Wake::Stop, _) => return Ok(Wake::Stop),
                    (_, Presence::GivenUp) => {
                        world.give_up();
                        break;
                    }
                    _ => ticker = Ticker::new(now_ns(), tick_ns),
                }
            }
            if node.wait_tick(&mut ticker)? == Wake::Stop {
                return Ok(Wake::Stop);
            }
            let action = ports.newest_action(episode)?;
            let is_late = action.is_none_or(|action| action.header.step < step);
            if world.tick(step, action) {
                node.count_missed(u64::from(is_late));
                break;
            }
            world.show_motion(Stamp::sensed(episode, step))?;
        }
    }
    Ok(Wake::Message)
}
