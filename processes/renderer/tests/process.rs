//! The renderer in a run: in lockstep every frame gets the display that its decision asks for.

use messages::{
    AZIMUTHS, BEAMS, CommAction, Display, LidarFrame, Message, Outcome, ProcessState, topic,
};
use renderer::{Render, Renderer, RendererOptions};
use runtime::{
    ClockMode, Input, InstanceLock, Launcher, LauncherWake, Node, Output, Receive, RunArguments,
    Stamp, Wake, now_ns,
};

const STEPS: u32 = 60;

/// Cars ahead and behind that come nearer with every step.
fn frame(episode: u32, step: u32) -> LidarFrame {
    let mut frame = LidarFrame::ZERO;
    (frame.header.episode, frame.header.step) = (episode, step);
    frame.range = [1.0; BEAMS];
    frame.object = [-1; AZIMUTHS];
    for (azimuth, speed_mps) in [(0, 3.0), (18, 18.0)] {
        frame.range[azimuth] = 0.9 - 0.01 * step as f32;
        frame.object[azimuth] = azimuth as i32;
        frame.speed_mps[azimuth] = speed_mps;
    }
    frame
}

fn decision(episode: u32, step: u32) -> CommAction {
    let mut decision = CommAction::ZERO;
    (decision.header.episode, decision.header.step) = (episode, step);
    decision.visual = u32::from(step.is_multiple_of(3));
    decision.verbal = u32::from(step.is_multiple_of(7)) << 3;
    decision.verbal_probability[3] = 0.9;
    decision
}

/// World and planner in one: sends a frame, waits for its display, sends the next decision.
struct Others {
    node: Node,
    lidar: Output<LidarFrame>,
    decision: Output<CommAction>,
    _outcome: Output<Outcome>,
    display: Input<Display>,
}

impl Others {
    fn join(arguments: &RunArguments) -> anyhow::Result<Self> {
        let node = Node::join(arguments)?;
        Ok(Self {
            lidar: node.output(topic::LIDAR)?,
            decision: node.output(topic::COMM_ACTION)?,
            _outcome: node.output(topic::OUTCOME)?,
            display: node.input(topic::DISPLAY, Receive::InOrder)?,
            node,
        })
    }

    /// The decision for a frame comes after its display.
    fn run_late(mut self) -> anyhow::Result<Vec<Display>> {
        let mut displays = Vec::new();
        self.node.ready()?;
        for step in [0, 1] {
            let stamp = Stamp::sensed(0, step);
            self.lidar
                .send_with(stamp, |place| *place = frame(0, step))?;
            for late in [false, true] {
                if late {
                    self.decision
                        .send_with(stamp, |place| *place = decision(0, step))?;
                }
                while !self.display.take()? {
                    if self.node.wait(&mut [&mut self.display], None)? == Wake::Stop {
                        anyhow::bail!("no display at step {step}, late: {late}");
                    }
                }
                displays.extend(self.display.message());
            }
        }
        self.node.finish()?;
        Ok(displays)
    }

    fn run(mut self) -> anyhow::Result<Vec<Display>> {
        let mut displays = Vec::new();
        self.node.ready()?;
        for (episode, step) in
            (0..2).flat_map(|episode| (0..STEPS).map(move |step| (episode, step)))
        {
            let stamp = Stamp {
                episode,
                step,
                cause_ns: 1 + u64::from(step),
            };
            self.lidar
                .send_with(stamp, |place| *place = frame(episode, step))?;
            if self
                .node
                .wait_step(&mut [&mut self.display], episode, step, None)?
                == Wake::Stop
            {
                break;
            }
            displays.extend(self.display.message());
            self.decision
                .send_with(stamp.next(), |place| *place = decision(episode, step + 1))?;
        }
        self.node.finish()?;
        Ok(displays)
    }
}

/// Runs a renderer among the others; what it displayed, and how many late decisions it counted.
fn run(
    clock: ClockMode,
    options: &RendererOptions,
    play: fn(Others) -> anyhow::Result<Vec<Display>>,
) -> anyhow::Result<(Vec<Display>, u64)> {
    let root = testing::private_directory();
    let lock = InstanceLock::acquire(root.path(), "render")?;
    let mut launcher = Launcher::open(lock, 42, clock)?;
    let process = |name: &str, index| RunArguments {
        launcher_pid: 0, // threads of this process, not children of a launcher
        ..launcher.arguments().for_process(name, index)
    };
    let (ours, theirs) = (process("renderer", 0), process("others", 1));
    let same = options.clone();
    let renderer = std::thread::spawn(move || renderer::run(&ours, &same));
    let others = std::thread::spawn(move || play(Others::join(&theirs)?));
    let deadline = now_ns() + 60_000_000_000;
    launcher.wait_ready(&["renderer", "others"], &[], deadline)?;
    launcher.start()?;
    let (mut running, mut missed) = (2, 0);
    while running > 0 {
        anyhow::ensure!(
            launcher.wait(&[], Some(deadline))? == LauncherWake::Report,
            "no end"
        );
        while let Some(report) = launcher.next_report()? {
            anyhow::ensure!(
                report.state() != Ok(ProcessState::Failed),
                "a process failed"
            );
            if report.state() == Ok(ProcessState::Finished) {
                running -= 1;
                missed += report.missed_deadlines;
                launcher.stop()?;
            }
        }
    }
    renderer.join().expect("no panic")?;
    Ok((others.join().expect("no panic")?, missed))
}

fn options() -> RendererOptions {
    RendererOptions {
        print: false,
        ..RendererOptions::default()
    }
}

/// In real time a frame is shown at once, and again when what was decided for it comes; that is counted.
#[test]
fn a_late_decision_is_shown_when_it_comes() -> anyhow::Result<()> {
    let (displays, missed) = run(ClockMode::RealTime, &options(), Others::run_late)?;
    let seen = displays.iter().map(|d| (d.header.step, d.highlighted));
    assert_eq!(seen.collect::<Vec<_>>(), [(0, 0), (0, 1), (1, 1), (1, 0)]);
    assert_eq!(missed, 2);
    Ok(())
}

#[test]
fn every_frame_gets_its_display() -> anyhow::Result<()> {
    let options = options();
    let (displays, missed) = run(ClockMode::Lockstep, &options, Others::run)?;
    assert_eq!(missed, 0);
    assert_eq!(displays.len(), 2 * STEPS as usize);
    let mut expected = Renderer::new(&options);
    let (mut spoken, mut shown) = (0, 0);
    for display in &displays {
        let (episode, step) = (display.header.episode, display.header.step);
        assert_eq!(display.header.cause_ns, 1 + u64::from(step));
        let mut wanted = Display::ZERO;
        let decision = decision(episode, step);
        let decided = (step > 0).then_some(&decision);
        expected.render(&frame(episode, step), decided, &mut wanted);
        wanted.header = display.header;
        assert_eq!(display, &wanted);
        spoken += display.utterance_count;
        shown += display.highlighted;
    }
    // Every seventh step wants to speak, 24 steps after the last utterance at the earliest: steps 7 and 35.
    assert_eq!(spoken, 2 * 2);
    assert_eq!(shown, 2 * ((STEPS - 1) / 3));
    Ok(())
}
