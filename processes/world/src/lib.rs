//! The world process: holds the truth, publishes what can be sensed of it, and moves when the person acts.
//!
//! A world hands over to another, and takes over, between two episodes.
//!
//! At step k it publishes the outcome of step k − 1, the scene and the LIDAR frame k, waits for the driver's action k
//! (lockstep) or for the beat (real time), and steps. The step that ends an episode has an outcome and a scene, but no
//! frame: nobody is asked to act on it.

mod options;
mod ports;

pub use options::Options;

use anyhow::Result;
use domains::highway::{End, Outcome, World};
use ports::Ports;
use runtime::{ClockMode, NEVER, Node, RunArguments, Ticker, Wake, now_ns};

/// Joins the run and drives its episodes to the end.
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

fn drive(node: &mut Node, options: &Options) -> Result<()> {
    let mut world = options.world()?;
    let mut ports = Ports::new(node)?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    // A world that stands by begins with the episode that it is told to.
    let stands_by = node.stands_by();
    if stands_by && node.wait_turn(NEVER.0 - 1, 0)? == Wake::Stop {
        return Ok(());
    }
    for episode in node.turn().0..options.episodes {
        if !node.speaks(episode, 0) {
            node.retire()?;
            if node.wait_turn(episode, 0)? == Wake::Stop {
                break;
            }
        }
        world.reset(options.seed, episode);
        let wake = match node.arguments().clock {
            ClockMode::Lockstep => lockstep(node, &mut ports, &mut world, episode)?,
            ClockMode::RealTime => real_time(node, &mut ports, &mut world, episode)?,
        };
        if wake == Wake::Stop {
            break;
        }
    }
    Ok(())
}

/// An episode in which the world waits for every action, however long it takes.
fn lockstep(node: &mut Node, ports: &mut Ports, world: &mut World, episode: u32) -> Result<Wake> {
    let mut outcome = Outcome::default();
    for step in 0.. {
        if ports.keep_together(node, episode, step)? == Wake::Stop {
            return Ok(Wake::Stop);
        }
        if outcome.end != End::Running {
            // When these two are there, everything that others send in this episode has been sent.
            if ports.await_last(node, episode, step)? == Wake::Stop {
                return Ok(Wake::Stop);
            }
            ports.publish(world, &outcome, episode, step)?;
            node.end_step();
            break;
        }
        ports.publish(world, &outcome, episode, step)?;
        // A step ends where what it moved is published, so that a frame's compute time covers the moving.
        node.end_step();
        if node.wait_step(&mut [&mut ports.action], episode, step, None)? == Wake::Stop {
            return Ok(Wake::Stop);
        }
        outcome = world.step(ports.action());
    }
    Ok(Wake::Message)
}

/// An episode at the scene's own pace, with the newest action; an action that is not there in time is counted as a
/// missed deadline, and the one before it holds.
fn real_time(node: &mut Node, ports: &mut Ports, world: &mut World, episode: u32) -> Result<Wake> {
    let clock = &world.scene().clock;
    let period_ns = 1e9 * world.scene().step_s() / clock.rate;
    let mut ticker = Ticker::new(now_ns(), period_ns as u64);
    let (mut outcome, mut held) = (Outcome::default(), [0.0; 2]);
    for step in 0.. {
        ports.publish(world, &outcome, episode, step)?;
        node.end_step();
        if outcome.end != End::Running {
            break;
        }
        if node.wait_tick(&mut ticker)? == Wake::Stop {
            return Ok(Wake::Stop);
        }
        match ports.newest_action(episode)? {
            Some((decided_at, action)) => {
                held = action;
                node.count_missed(u64::from(decided_at < step));
            }
            None => node.count_missed(1),
        }
        outcome = world.step(held);
    }
    Ok(Wake::Message)
}
