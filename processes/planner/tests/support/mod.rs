//! A small set of processes, each in a thread with its own node, and the rest of the world as a script.
#![allow(dead_code)] // every test program uses its own part

use domains::highway::modalities::layout;
use messages::{
    CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, ProcessState, Report,
    RobotBelief, topic,
};
use models::{Posterior, SelfHuman, SelfModel, Sizes};
use planner::{PlannerMethod, PlannerOptions};
use planning::{RaceSettings, Settings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use runtime::{
    ClockMode, Input, InstanceLock, Launcher, Node, Output, Receive, RunArguments, Stamp, Wake,
    now_ns,
};
use std::sync::Arc;
use std::thread::JoinHandle;

/// An untrained self-model, the same each time.
pub fn self_model() -> SelfModel {
    SelfModel::new(
        Sizes::of(&layout()).with_hidden(32),
        layout(),
        &mut ChaCha8Rng::seed_from_u64(4),
    )
}

/// A human model with implants that hide half of what is there.
pub fn human() -> SelfHuman {
    let model = self_model();
    let posterior = Posterior::neutral(&model, true);
    SelfHuman::new(Arc::new(model), Some(posterior), 0)
}

/// A small planner whose costs leave room for decisions either way.
pub fn options() -> PlannerOptions {
    PlannerOptions {
        method: PlannerMethod::Race,
        model: None,
        settings: Settings {
            horizon: 2,
            samples: 60,
            iterations: 2,
            race: RaceSettings {
                steps: 4,
                first: 4,
                futures: 16,
                ..RaceSettings::default()
            },
            futures: 1,
            elites: 12,
            silent: 4,
            verbal_cost: 0.01,
            visual_cost: 0.001,
            ..Settings::default()
        },
        seed: 11,
        step_s: 0.15,
        real_step_s: None,
        patience_ms: 40,
        scenario: scenario::Scenario::Highway(()),
    }
}

/// A made-up drive: random cars, a display that shows what was decided, a random driver.
pub struct Script {
    rng: ChaCha8Rng,
    episode: u32,
    ready_step: u32,
}

impl Script {
    pub fn new(episode: u32) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(u64::from(episode)),
            episode,
            ready_step: 0,
        }
    }

    pub fn next(
        &mut self,
        step: u32,
        decision: Option<&CommAction>,
    ) -> (LidarFrame, Display, DriverAction) {
        let rng = &mut self.rng;
        let mut frame = LidarFrame::ZERO;
        (frame.header.episode, frame.header.step) = (self.episode, step);
        frame.range = [1.0; messages::BEAMS];
        for _ in 0..40 {
            frame.range[rng.random_range(0..messages::BEAMS)] = rng.random();
        }
        frame.ego = core::array::from_fn(|_| rng.random_range(-0.5..0.5));
        let mut display = Display::ZERO;
        display.header = frame.header;
        if let Some(decision) = decision.filter(|_| step > 0) {
            display.highlighted = decision.visual;
            if step >= self.ready_step && decision.verbal != 0 {
                display.utterance_count = 1;
                display.utterances[0].item = decision.verbal.trailing_zeros();
                display.utterances[0].kind = rng.random_range(0..3);
                display.utterances[0].range_m = rng.random_range(0.0..40.0);
                self.ready_step = step + 6;
            }
        }
        display.speech_ready_s = self.ready_step.saturating_sub(step) as f32 * 0.15;
        let mut action = DriverAction::ZERO;
        action.header = frame.header;
        (action.throttle, action.steer) =
            (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        (frame, display, action)
    }
}

type Thread = JoinHandle<anyhow::Result<()>>;

/// Processes in threads, started.
pub struct Set {
    pub node: Node,
    lidar: Output<LidarFrame>,
    displays: Output<Display>,
    actions: Output<DriverAction>,
    pub robots: Output<RobotBelief>,
    pub people: Output<HumanBelief>,
    robot: Input<RobotBelief>,
    person: Input<HumanBelief>,
    decision: Input<CommAction>,
    threads: Vec<Thread>,
    launcher: Launcher,
    _root: tempfile::TempDir,
}

impl Set {
    /// Belief, human and planner.
    pub fn start(clock: ClockMode) -> Self {
        Self::start_with(clock, &["belief", "human", "planner"], options())
    }

    pub fn start_with(
        clock: ClockMode,
        processes: &[&'static str],
        options: PlannerOptions,
    ) -> Self {
        let root = testing::private_directory();
        let lock = InstanceLock::acquire(root.path(), "set").expect("nobody else is here");
        let mut launcher = Launcher::open(lock, 1, clock).expect("the instance opens");
        let arguments = |process: &str, index| RunArguments {
            launcher_pid: 0, // these processes are threads of the launcher's
            ..launcher.arguments().for_process(process, index)
        };
        let threads = processes
            .iter()
            .enumerate()
            .map(|(index, process)| {
                let arguments = arguments(process, index as u32);
                let options = options.clone();
                let run = move || match arguments.process.as_str() {
                    "belief" => belief::run_with(&arguments, self_model()),
                    "human" => human::run_with(&arguments, Box::new(human())),
                    _ if options.method == PlannerMethod::None => {
                        planner::run(&arguments, &options)
                    }
                    _ => planner::run_with(&arguments, &options, &self_model()),
                };
                std::thread::spawn(run)
            })
            .collect();
        let mut node = Node::join(&arguments("test", 9)).expect("the test joins");
        let set_up = "a port";
        let (lidar, displays) = (
            node.output(topic::LIDAR).expect(set_up),
            node.output(topic::DISPLAY).expect(set_up),
        );
        let actions = node.output(topic::DRIVER_ACTION).expect(set_up);
        let robots = node.output(topic::ROBOT_BELIEF).expect(set_up);
        let people = node.output(topic::HUMAN_BELIEF).expect(set_up);
        let robot = node
            .input(topic::ROBOT_BELIEF, Receive::InOrder)
            .expect(set_up);
        let person = node
            .input(topic::HUMAN_BELIEF, Receive::InOrder)
            .expect(set_up);
        let decision = node
            .input(topic::COMM_ACTION, Receive::InOrder)
            .expect(set_up);
        launcher
            .wait_ready(processes, &[], now_ns() + 60_000_000_000)
            .expect("all are ready");
        launcher.start().expect("the start is sent");
        assert_eq!(node.ready().expect("the start is heard"), Wake::Message);
        Self {
            node,
            lidar,
            displays,
            actions,
            robots,
            people,
            robot,
            person,
            decision,
            threads,
            launcher,
            _root: root,
        }
    }

    pub fn publish(&mut self, frame: &LidarFrame, display: &Display, action: &DriverAction) {
        let stamp = Stamp::sensed(frame.header.episode, frame.header.step);
        self.lidar
            .send_with(stamp, |out| *out = *frame)
            .expect("sent");
        self.displays
            .send_with(stamp, |out| *out = *display)
            .expect("sent");
        self.actions
            .send_with(stamp, |out| *out = *action)
            .expect("sent");
    }

    /// The last frame of an episode, on which nobody acts.
    pub fn publish_unanswered(&mut self, frame: &LidarFrame, display: &Display) {
        let stamp = Stamp::sensed(frame.header.episode, frame.header.step);
        self.lidar
            .send_with(stamp, |out| *out = *frame)
            .expect("sent");
        self.displays
            .send_with(stamp, |out| *out = *display)
            .expect("sent");
    }

    /// Publishes what the other processes would, for a planner that is alone.
    pub fn publish_beliefs(&mut self, episode: u32, step: u32, person: bool) {
        let stamp = Stamp::sensed(episode, step);
        let latent = self_model().sizes.latent as u32;
        if person {
            self.people
                .send_with(stamp, |out| out.latent = latent)
                .expect("sent");
        }
        self.robots
            .send_with(stamp, |out| out.latent = latent)
            .expect("sent");
    }

    pub fn robot(&mut self, episode: u32, step: u32) -> RobotBelief {
        wait(&mut self.node, &mut self.robot, episode, step)
    }

    pub fn person(&mut self, episode: u32, step: u32) -> HumanBelief {
        wait(&mut self.node, &mut self.person, episode, step)
    }

    pub fn decision(&mut self, episode: u32, step: u32) -> CommAction {
        wait(&mut self.node, &mut self.decision, episode, step)
    }

    /// Ends the processes, none of which may have failed, and returns their last reports.
    pub fn stop(mut self) -> Vec<Report> {
        self.launcher.stop().expect("the word is sent");
        let count = self.threads.len();
        for thread in self.threads {
            thread.join().expect("no panic").expect("no error");
        }
        let mut reports = Vec::new();
        while let Some(report) = self.launcher.next_report().expect("reports arrive") {
            if report.state() == Ok(ProcessState::Finished) {
                reports.push(report);
            }
        }
        assert_eq!(reports.len(), count);
        reports
    }
}

fn wait<M: Message>(node: &mut Node, input: &mut Input<M>, episode: u32, step: u32) -> M {
    let deadline_ns = Some(now_ns() + 60_000_000_000);
    let wake = node
        .wait_step(&mut [input], episode, step, deadline_ns)
        .expect("the wait works");
    assert_eq!(
        wake,
        Wake::Message,
        "no message for episode {episode} step {step}"
    );
    *input.message().expect("a message")
}
