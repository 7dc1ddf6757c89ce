//! The driver in a run: in real time, a display that shows a late decision is the second of its step, and is heard.

use anyhow::{Result, ensure};
use domains::bomb_defusal::WAIT;
use domains::discrete::{Discrete, Scene, World};
use driver::{Acting, DriverOptions, GridworldSeat};
use messages::{Display, DriverAction, Observation, ProcessState, topic};
use runtime::{
    ClockMode, InstanceLock, Launcher, LauncherWake, Node, Receive, RunArguments, Stamp, Wake,
    now_ns,
};
use scenario::Scenario;
use std::path::Path;

/// World and renderer in one: three steps of a round, of which the second is shown what was decided late; gives what
/// the person does in each, and what would have been right.
fn others(arguments: &RunArguments, scene: &Scene) -> Result<([u32; 3], u32)> {
    let mut node = Node::join(arguments)?;
    let observations = node.output::<Observation>(topic::OBSERVATION)?;
    let displays = node.output::<Display>(topic::DISPLAY)?;
    let mut actions = node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)?;
    node.ready()?;

    let mut world = World::new(scene, &models::words::shipped(scene.domain())?)?;
    world.reset(3, 0, 0);
    let layout = world.layout().clone();
    let right = world.expert() as u32;
    let send = |step: u32, world: &World| {
        observations.send_with(Stamp::sensed(0, step), |out| {
            out.domain = layout.number;
            (out.visual_len, out.verbal_len) = (layout.visual as u32, layout.verbal as u32);
            let (visual, verbal) = (&mut out.visual, &mut out.verbal);
            world.observe(&mut visual[..layout.visual], &mut verbal[..layout.verbal]);
        })
    };
    let mut done = [u32::MAX; 3];
    let mut act = |node: &mut Node, step: u32| -> Result<u32> {
        let wake = node.wait_step(&mut [&mut actions], 0, step, None)?;
        ensure!(wake == Wake::Message, "no action at step {step}: {wake:?}");
        Ok(actions.message().map_or(u32::MAX, |action| action.choice))
    };
    // Nothing is shown at first: the person waits.
    send(0, &world)?;
    displays.send_with(Stamp::sensed(0, 0), |_| {})?;
    done[0] = act(&mut node, 0)?;
    // What was decided for step 0 comes late, and is shown in a second display of that step; that of step 1 never
    // comes.
    let all = layout.communicable;
    displays.send_with(Stamp::sensed(0, 0), |out| {
        out.highlighted = all.visual as u32;
        out.utterance_count = 1;
        out.utterances[0].item = all.verbal.trailing_zeros();
    })?;
    world.step(WAIT);
    send(1, &world)?;
    done[1] = act(&mut node, 1)?;
    // Nothing is shown any more, and what the person knew of the terminals went with the press.
    world.step(WAIT);
    displays.send_with(Stamp::sensed(0, 2), |_| {})?;
    send(2, &world)?;
    done[2] = act(&mut node, 2)?;
    node.finish()?;
    Ok((done, right))
}

/// Runs the driver of somebody who never notices a terminal on their own.
fn run(clock: ClockMode, folder: &Path) -> Result<([u32; 3], u32)> {
    let file = folder.join("inattentive.toml");
    std::fs::write(&file, "id = 1\nnotice = 0.0\n")?;
    let text = "name = \"fast\"\ndomain = \"bomb_defusal\"\nsetting = \"transfer\"\n[clock]\nrate = 100.0\n";
    let scene = Scene::from_toml(Path::new("fast.toml"), text)?;
    let lock = InstanceLock::acquire(folder, "late")?;
    let mut launcher = Launcher::open(lock, 42, clock)?;
    let process = |name: &str, index| RunArguments {
        launcher_pid: 0, // threads of this process, not children of a launcher
        ..launcher.arguments().for_process(name, index)
    };
    let (ours, theirs) = (process("driver", 0), process("others", 1));
    let options = DriverOptions {
        cockpit: None,
        scenario: Scenario::Gridworld(GridworldSeat {
            scene: scene.clone(),
            person: Acting::File(file),
        }),
        seed: 3,
    };
    let driver = std::thread::spawn(move || driver::run(&ours, &options));
    let others = std::thread::spawn(move || others(&theirs, &scene));
    let deadline = now_ns() + 60_000_000_000;
    launcher.wait_ready(&["driver", "others"], &[], deadline)?;
    launcher.start()?;
    let mut running = 2;
    while running > 0 {
        ensure!(
            launcher.wait(&[], Some(deadline))? == LauncherWake::Report,
            "no end"
        );
        while let Some(report) = launcher.next_report()? {
            ensure!(
                report.state() != Ok(ProcessState::Failed),
                "a process failed"
            );
            if report.state() == Ok(ProcessState::Finished) {
                running -= 1;
                launcher.stop()?;
            }
        }
    }
    driver.join().expect("no panic")?;
    others.join().expect("no panic")
}

#[test]
fn in_real_time_a_late_display_of_a_step_is_heard() -> Result<()> {
    let folder = testing::private_directory();
    let (done, right) = run(ClockMode::RealTime, folder.path())?;
    assert_ne!(right, WAIT as u32);
    assert_eq!(done, [WAIT as u32, right, WAIT as u32]);
    Ok(())
}
