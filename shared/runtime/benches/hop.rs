//! Latency of a hop between two processes, and of a lockstep tick of the whole set with nothing to compute.
//!
//! `cargo bench -p runtime --bench hop` starts itself again as the processes. A hop counts from the sender's stamp to
//! the receiver's return from its wait; `blocking` sleeps in `poll(2)`, `polling` spins. A tick counts from one LIDAR
//! frame to the next through world, driver, belief, human, planner and renderer, with the recorder looking on, waiting
//! for the same messages as the real ones do. Tails are whole: nothing is filtered.

use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Outcome, ProcessState, RobotBelief,
    Scene, topic,
};
use runtime::{
    ClockMode, Input, InputOptions, InstanceLock, Launcher, LauncherWake, Node, NodeError, Receive,
    RunArguments, StageTimer, Stamp, Wake, now_ns, text_of,
};
use std::process::{Child, Command};

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

const STEPS: u32 = 20_000;
/// The first steps connect ports and fill caches: they belong to a run's start, which is shown apart.
const WARM_UP: u32 = 200;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, json] = words.as_slice()
        && flag == "--process"
    {
        return Ok(process(&RunArguments::from_json(json, "--process")?)?);
    }
    println!(
        "{:<34} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "µs", "p50", "p90", "p99", "p99.9", "max"
    );
    for (name, spin_us) in [("hop, blocking", 0), ("hop, polling", 1_000_000)] {
        run(name, &["ping", "pong"], spin_us)?;
    }
    let set = [
        "world", "driver", "belief", "human", "planner", "renderer", "recorder",
    ];
    for (name, spin_us) in [
        ("tick, blocking", 0),
        ("tick, spin 20 µs", 20),
        ("tick, spin 100 µs", 100),
    ] {
        run(name, &set, spin_us)?;
    }
    Ok(())
}

fn run(name: &str, processes: &[&str], spin_us: u32) -> Result<(), Box<dyn std::error::Error>> {
    let lock = InstanceLock::take("bench")?;
    let mut launcher = Launcher::open(lock, 1, ClockMode::Lockstep)?;
    let program = std::env::current_exe()?;
    let mut children: Vec<Child> = Vec::new();
    for (index, process) in processes.iter().enumerate() {
        let mut arguments = launcher.arguments().for_process(process, index as u32);
        arguments.spin_us = spin_us;
        children.push(
            Command::new(&program)
                .args(["--process", &arguments.to_json()])
                .spawn()?,
        );
    }
    launcher.wait_ready(processes, &[], now_ns() + 30_000_000_000)?;
    let start = now_ns();
    launcher.start()?;
    // The first process ends the run.
    let mut rest = processes.len();
    while rest > 0 {
        if launcher.wait(&[], Some(now_ns() + 120_000_000_000))? != LauncherWake::Report {
            return Err("a process did not finish".into());
        }
        while let Some(report) = launcher.next_report()? {
            let process = text_of(&report.process);
            let lost: u64 = report.ports.iter().map(|port| port.lost).sum();
            if report.state() == Ok(ProcessState::Failed) {
                return Err(format!("{process}: {}", text_of(&report.text)).into());
            }
            if report.state() != Ok(ProcessState::Finished) {
                continue;
            }
            rest -= 1;
            if process == processes[0] {
                launcher.stop()?;
            }
            if report.steps > 0 {
                let us = report.compute_ns.map(|ns| ns as f64 / 1e3);
                let label = format!("{name} ({process})");
                println!(
                    "{label:<34} {:>9.1} {:>9.1} {:>9.1} {:>9.1} {:>9.1}   n {} lost {lost} allocations {}",
                    us[0], us[1], us[2], us[3], us[4], report.steps, report.allocations
                );
            }
        }
    }
    println!("    whole run: {:.1} ms", (now_ns() - start) as f64 / 1e6);
    for mut child in children {
        child.wait()?;
    }
    Ok(())
}

fn process(arguments: &RunArguments) -> Result<(), NodeError> {
    let mut node = Node::join(arguments)?;
    let mut times = StageTimer::new();
    let done = match arguments.process.as_str() {
        "ping" => ping(&mut node, &mut times),
        "pong" => pong(&mut node, &mut times),
        "world" => world(&mut node, &mut times),
        "driver" => driver(&mut node),
        "belief" => belief(&mut node),
        "human" => human(&mut node),
        "planner" => planner(&mut node),
        "renderer" => renderer(&mut node),
        _ => recorder(&mut node),
    };
    match done {
        Ok(()) => {
            // What is reported are the times measured here rather than compute times.
            node.report_times(times);
            node.finish()?;
            Ok(())
        }
        Err(error) => {
            node.fail(&error.to_string())?;
            Err(error)
        }
    }
}

fn ping(node: &mut Node, times: &mut StageTimer) -> Result<(), NodeError> {
    let frames = node.output::<LidarFrame>(topic::LIDAR)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    node.ready()?;
    for step in 0..STEPS {
        frames.send_with(Stamp::sensed(0, step), |_| {})?;
        if node.wait_step(&mut [&mut actions], 0, step, None)? == Wake::Stop {
            break;
        }
        if step >= WARM_UP {
            times.record(now_ns() - actions.header().map_or(0, |header| header.sent_ns));
        }
    }
    Ok(())
}

fn pong(node: &mut Node, times: &mut StageTimer) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let actions = node.output::<DriverAction>(topic::DRIVER_ACTION)?;
    node.ready()?;
    while node.wait(&mut [&mut frames], None)? == Wake::Message {
        if let Some(frame) = frames.next()? {
            let (stamp, sent_ns) = (Stamp::of(&frame.header), frame.header.sent_ns);
            if stamp.step >= WARM_UP {
                times.record(now_ns() - sent_ns);
            }
            actions.send_with(stamp, |_| {})?;
        }
    }
    Ok(())
}

fn world(node: &mut Node, times: &mut StageTimer) -> Result<(), NodeError> {
    let frames = node.output::<LidarFrame>(topic::LIDAR)?;
    let scenes = node.output::<Scene>(topic::SCENE)?;
    let outcomes = node.output::<Outcome>(topic::OUTCOME)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    node.ready()?;
    let mut before = now_ns();
    for step in 0..STEPS {
        let stamp = Stamp::sensed(0, step);
        frames.send_with(stamp, |_| {})?;
        scenes.send_with(stamp, |_| {})?;
        outcomes.send_with(stamp, |_| {})?;
        if node.wait_step(&mut [&mut actions], 0, step, None)? == Wake::Stop {
            break;
        }
        let now = now_ns();
        if step >= WARM_UP {
            times.record(now - before);
        }
        before = now;
    }
    Ok(())
}

fn driver(node: &mut Node) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let mut displays = node.input::<Display>(topic::DISPLAY, Receive::InOrder)?;
    let actions = node.output::<DriverAction>(topic::DRIVER_ACTION)?;
    node.ready()?;
    for step in 0.. {
        if node.wait_step(&mut [&mut frames, &mut displays], 0, step, None)? == Wake::Stop {
            break;
        }
        actions.send_with(stamp_of(&frames), |_| {})?;
    }
    Ok(())
}

fn stamp_of<M: messages::Message>(input: &Input<M>) -> Stamp {
    input.header().map(Stamp::of).unwrap_or_default()
}

fn belief(node: &mut Node) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let beliefs = node.output::<RobotBelief>(topic::ROBOT_BELIEF)?;
    node.ready()?;
    for step in 0.. {
        if node.wait_step(&mut [&mut frames], 0, step, None)? == Wake::Stop
            || (step > 0 && node.wait_step(&mut [&mut actions], 0, step - 1, None)? == Wake::Stop)
        {
            break;
        }
        beliefs.send_with(stamp_of(&frames), |_| {})?;
    }
    Ok(())
}

fn human(node: &mut Node) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let mut displays = node.input::<Display>(topic::DISPLAY, Receive::InOrder)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let beliefs = node.output::<HumanBelief>(topic::HUMAN_BELIEF)?;
    node.ready()?;
    for step in 0.. {
        if node.wait_step(&mut [&mut frames, &mut displays], 0, step, None)? == Wake::Stop
            || (step > 0 && node.wait_step(&mut [&mut actions], 0, step - 1, None)? == Wake::Stop)
        {
            break;
        }
        beliefs.send_with(stamp_of(&frames), |_| {})?;
    }
    Ok(())
}

fn planner(node: &mut Node) -> Result<(), NodeError> {
    let mut robot = node.input::<RobotBelief>(topic::ROBOT_BELIEF, Receive::InOrder)?;
    let mut human = node.input::<HumanBelief>(topic::HUMAN_BELIEF, Receive::InOrder)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    let decisions = node.output::<CommAction>(topic::COMM_ACTION)?;
    node.ready()?;
    for step in 0.. {
        if node.wait_step(&mut [&mut robot, &mut human, &mut actions], 0, step, None)? == Wake::Stop
        {
            break;
        }
        decisions.send_with(stamp_of(&robot).next(), |_| {})?;
    }
    Ok(())
}

fn renderer(node: &mut Node) -> Result<(), NodeError> {
    let mut frames = node.input::<LidarFrame>(topic::LIDAR, Receive::InOrder)?;
    let mut decisions = node.input::<CommAction>(topic::COMM_ACTION, Receive::InOrder)?;
    let displays = node.output::<Display>(topic::DISPLAY)?;
    node.ready()?;
    for step in 0.. {
        if node.wait_step(&mut [&mut frames], 0, step, None)? == Wake::Stop
            || (step > 0 && node.wait_step(&mut [&mut decisions], 0, step, None)? == Wake::Stop)
        {
            break;
        }
        displays.send_with(stamp_of(&frames), |_| {})?;
    }
    Ok(())
}

fn recorder(node: &mut Node) -> Result<(), NodeError> {
    let options = InputOptions::recorder();
    let mut frames = node.input_with::<LidarFrame>(topic::LIDAR, options)?;
    let mut scenes = node.input_with::<Scene>(topic::SCENE, options)?;
    let mut outcomes = node.input_with::<Outcome>(topic::OUTCOME, options)?;
    let mut robot = node.input_with::<RobotBelief>(topic::ROBOT_BELIEF, options)?;
    let mut human = node.input_with::<HumanBelief>(topic::HUMAN_BELIEF, options)?;
    let mut decisions = node.input_with::<CommAction>(topic::COMM_ACTION, options)?;
    let mut displays = node.input_with::<Display>(topic::DISPLAY, options)?;
    let mut actions = node.input_with::<DriverAction>(topic::DRIVER_ACTION, options)?;
    node.ready()?;
    loop {
        let wake = node.wait(&mut [], Some(now_ns() + 5_000_000))?;
        while frames.take()? {}
        while scenes.take()? {}
        while outcomes.take()? {}
        while robot.take()? {}
        while human.take()? {}
        while decisions.take()? {}
        while displays.take()? {}
        while actions.take()? {}
        if wake == Wake::Stop {
            return Ok(());
        }
    }
}
