//! The message graph: which process answers which messages with which.

use messages::PROCESSES;
use messages::topic;
use runtime::ClockMode;

/// A topic on which a step leaves exactly one message, which ends a process's step: one for every process but the
/// recorder. What the world sends besides, `world/outcome` and `world/scene`, is not watched: it goes out just before
/// the frame, and every subscriber costs its sender something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GraphTopic {
    /// world/lidar
    Lidar,
    /// belief/robot
    RobotBelief,
    /// belief/human
    HumanBelief,
    /// comm/action
    Decision,
    /// comm/display
    Display,
    /// driver/action
    Action,
    /// world/observation, in a gridworld in place of world/lidar
    Observation,
}

/// How many topics.
pub const TOPICS: usize = 7;

/// Places of the processes in launch order.
pub const WORLD: usize = 0;
const DRIVER: usize = 1;
const BELIEF: usize = 2;
/// See [`WORLD`].
pub const HUMAN: usize = 3;
/// See [`WORLD`].
pub const PLANNER: usize = 4;
const RENDERER: usize = 5;

impl GraphTopic {
    /// As iceoryx2 knows it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lidar => topic::LIDAR,
            Self::Observation => topic::OBSERVATION,
            Self::RobotBelief => topic::ROBOT_BELIEF,
            Self::HumanBelief => topic::HUMAN_BELIEF,
            Self::Decision => topic::COMM_ACTION,
            Self::Display => topic::DISPLAY,
            Self::Action => topic::DRIVER_ACTION,
        }
    }

    /// Who sends it: a place in [`PROCESSES`].
    pub fn sender(self) -> usize {
        match self {
            Self::Lidar | Self::Observation => WORLD,
            Self::RobotBelief => BELIEF,
            Self::HumanBelief => HUMAN,
            Self::Decision => PLANNER,
            Self::Display => RENDERER,
            Self::Action => DRIVER,
        }
    }
}

/// All of them.
pub const STEP_ENDS: [GraphTopic; TOPICS] = [
    GraphTopic::Lidar,
    GraphTopic::Observation,
    GraphTopic::Action,
    GraphTopic::RobotBelief,
    GraphTopic::HumanBelief,
    GraphTopic::Decision,
    GraphTopic::Display,
];

/// When an edge counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum When {
    Always,
    /// Only where everybody waits for everybody.
    Lockstep,
    /// Only where the planner imagines.
    Planning,
}

/// A message that a process needs before it can send another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// What is needed.
    pub from: GraphTopic,
    /// Of which step, counted from the step of the message that is sent.
    pub step: i32,
    /// What is sent.
    pub to: GraphTopic,
    /// Whether the sent message takes its step from this one, so that it is known which one it was; of others, the
    /// newest that was there is assumed in real time.
    pub stamps: bool,
    when: When,
}

const fn edge(from: GraphTopic, step: i32, to: GraphTopic, stamps: bool, when: When) -> Edge {
    Edge {
        from,
        step,
        to,
        stamps,
        when,
    }
}

/// Steps that the world lets the human model be behind in lockstep (`processes/world/src/ports.rs`).
const MOST_BEHIND: i32 = 16;

/// Every edge of the graph. A set has either frames or observations; the other's edges carry nothing.
pub const EDGES: [Edge; 21] = [
    edge(
        GraphTopic::Action,
        -1,
        GraphTopic::Lidar,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::HumanBelief,
        -MOST_BEHIND,
        GraphTopic::Lidar,
        false,
        When::Lockstep,
    ),
    edge(
        GraphTopic::Lidar,
        0,
        GraphTopic::RobotBelief,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Action,
        -1,
        GraphTopic::RobotBelief,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::Lidar,
        0,
        GraphTopic::HumanBelief,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Display,
        0,
        GraphTopic::HumanBelief,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::Action,
        -1,
        GraphTopic::HumanBelief,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::RobotBelief,
        -1,
        GraphTopic::Decision,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::HumanBelief,
        -1,
        GraphTopic::Decision,
        false,
        When::Planning,
    ),
    edge(
        GraphTopic::Action,
        -1,
        GraphTopic::Decision,
        false,
        When::Planning,
    ),
    edge(
        GraphTopic::Display,
        -1,
        GraphTopic::Decision,
        false,
        When::Planning,
    ),
    edge(
        GraphTopic::Lidar,
        0,
        GraphTopic::Display,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Decision,
        0,
        GraphTopic::Display,
        false,
        When::Always,
    ),
    edge(GraphTopic::Lidar, 0, GraphTopic::Action, true, When::Always),
    edge(
        GraphTopic::Display,
        0,
        GraphTopic::Action,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::Action,
        -1,
        GraphTopic::Observation,
        false,
        When::Always,
    ),
    edge(
        GraphTopic::HumanBelief,
        -MOST_BEHIND,
        GraphTopic::Observation,
        false,
        When::Lockstep,
    ),
    edge(
        GraphTopic::Observation,
        0,
        GraphTopic::RobotBelief,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Observation,
        0,
        GraphTopic::HumanBelief,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Observation,
        0,
        GraphTopic::Display,
        true,
        When::Always,
    ),
    edge(
        GraphTopic::Observation,
        0,
        GraphTopic::Action,
        true,
        When::Always,
    ),
];

impl Edge {
    /// Whether the edge counts in such a run.
    pub fn counts(&self, clock: ClockMode, planning: bool) -> bool {
        match self.when {
            When::Always => true,
            When::Lockstep => clock == ClockMode::Lockstep,
            When::Planning => planning,
        }
    }

    /// Whether it only limits how far a process may be behind, so that it is waited for only where that happens.
    pub fn is_limit(&self) -> bool {
        self.step < -1
    }

    /// Such as `comm/display → driver`.
    pub fn name(&self) -> String {
        format!("{} → {}", self.from.name(), PROCESSES[self.to.sender()])
    }
}
