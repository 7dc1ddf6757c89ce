//! What the child processes do.

use super::{Child, arguments};
use messages::{DriverAction, ImaginePhase, LidarFrame, Outcome, topic};
use runtime::{
    InputOptions, InstanceLock, Launcher, Node, NodeError, Receive, RunArguments, Stamp, Wake,
    now_ns,
};
use std::ffi::OsString;

/// Steps of a lockstep run.
pub const STEPS: u32 = 400;
/// Messages of the talker.
pub const TALK: u64 = 100;

/// Plays a role to its end. A failure is reported and ends the process with a panic.
pub fn play(role: &str, _: OsString) {
    let arguments = arguments();
    if role == "launcher" {
        return launcher(&arguments);
    }
    let mut node = Node::join(&arguments).expect("joins");
    let done = match role {
        "world" => world(&mut node),
        "echo" => echo(&mut node),
        "talker" => talker(&mut node),
        "gapper" => gapper(&mut node),
        "human" => human(&mut node),
        "planner" => planner(&mut node),
        other => panic!("no role {other}"),
    };
    match done {
        Ok(()) => node.finish().expect("reports"),
        Err(error) => {
            node.fail(&error.to_string()).expect("reports");
            panic!("{error}");
        }
    }
}

/// Sends a frame, waits for the action of the same step, checks it.
fn world(node: &mut Node) -> Result<(), NodeError> {
    let frames = node.output::<LidarFrame>(topic::LIDAR)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    for step in 0..STEPS {
        let stamp = Stamp::sensed(0, step);
        frames.send_with(stamp, |frame| frame.ego[1] = step as f32)?;
        if node.wait_step(&mut [&mut actions], 0, step, None)? == Wake::Stop {
            break;
        }
        let action = actions.message().expect("the wait was for it");
        assert_eq!(action.steer, step as f32 / STEPS as f32);
        assert_eq!(
            action.header.cause_ns, stamp.cause_ns,
            "the cause travels along"
        );
        assert_eq!(action.header.run_id, 7);
        assert!(action.header.sent_ns >= stamp.cause_ns);
        node.end_step();
    }
    Ok(())
}

/// Answers every frame with an action.
fn echo(node: &mut Node) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let actions = node.output::<DriverAction>(topic::DRIVER_ACTION)?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [&mut frames], None)? == Wake::Message {
        if let Some(frame) = frames.next()? {
            let mut action = actions.loan()?;
            action.steer = frame.ego[1] / STEPS as f32;
            action.send(Stamp::of(&frame.header))?;
            node.end_step();
        }
    }
    Ok(())
}

fn talker(node: &mut Node) -> Result<(), NodeError> {
    let outcomes = node.output::<Outcome>(topic::OUTCOME)?;
    if node.ready()? == Wake::Message {
        for step in 0..TALK {
            outcomes.send_with(Stamp::sensed(0, step as u32), |outcome| {
                outcome.reward = step as f32
            })?;
        }
    }
    Ok(())
}

fn gapper(node: &mut Node) -> Result<(), NodeError> {
    let options = InputOptions {
        receive: Receive::InOrder,
        buffer: 8,
        wakes: true,
    };
    let mut inbox = node.input_with::<Outcome>(topic::OUTCOME, options)?;
    let outcomes = node.output::<Outcome>(topic::OUTCOME)?;
    if node.ready()? == Wake::Message {
        for count in [20, 30] {
            for step in 0..count {
                outcomes.send_with(Stamp::sensed(0, step), |_| {})?;
            }
            while inbox.take()? {}
        }
    }
    Ok(())
}

/// Steers each imagined person by their group and row.
fn human(node: &mut Node) -> Result<(), NodeError> {
    let mut server = node.request_server()?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    while node.wait(&mut [server.source()], None)? == Wake::Message {
        server.serve_all(node, |question, answer| {
            for row in 0..question.rows as usize {
                answer.action[2 * row..][..2]
                    .copy_from_slice(&[question.visual[row], question.group as f32]);
            }
        })?;
        node.end_step();
    }
    Ok(())
}

/// Asks for both groups before it looks at an answer.
fn planner(node: &mut Node) -> Result<(), NodeError> {
    let mut client = node.request_client()?;
    if node.ready()? == Wake::Stop {
        return Ok(());
    }
    for step in 0..STEPS {
        for group in 0..2 {
            client.ask(Stamp::sensed(0, step), |question| {
                question.group = group;
                question.phase = ImaginePhase::Perceive.wire();
                question.rows = 500;
                for row in 0..500 {
                    question.visual[row] = (step as usize * 500 + row) as f32;
                }
            })?;
        }
        assert_eq!(client.unanswered(), 2);
        for group in 0..2 {
            if client.wait_answer(node, None)? == Wake::Stop {
                return Ok(());
            }
            let answer = client.answer().expect("the wait was for it");
            assert_eq!(
                (answer.group, answer.rows, answer.header.step),
                (group, 500, step)
            );
            assert_eq!(
                answer.action[998..1000],
                [(step as usize * 500 + 499) as f32, group as f32]
            );
        }
        assert_eq!(client.unanswered(), 0);
        node.end_step();
    }
    Ok(())
}

/// A launcher with one child, which waits to be killed.
fn launcher(arguments: &RunArguments) {
    let lock =
        InstanceLock::acquire(&arguments.root, &arguments.instance).expect("the instance is free");
    let mut launcher = Launcher::open(lock, arguments.run_id, arguments.clock).expect("opens");
    let echo = Child::spawn("echo", &launcher.arguments().for_process("echo", 0));
    launcher
        .wait_ready(&["echo"], &[echo.descriptor()], now_ns() + 60_000_000_000)
        .expect("the echo is ready");
    launcher.start().expect("start is sent");
    println!("grandchild {}", echo.pid());
    let _ = launcher.wait(&[], None);
}
