//! What the numbers in messages mean: the enums of [`number`](crate::number) as the messages' own accessors, and the
//! numbers that stand for nobody and nothing.

use crate::{
    Cockpit, CockpitEvent, CommAction, Control, ControlCommand, DecisionReason, DriverAction,
    EpisodeEnd, ImagineAnswer, ImaginePhase, ImagineRequest, ImagineStatus, LidarFrame, ObjectPose,
    Outcome, Presence, ProcessState, Progress, Report, UnknownNumber, Utterance, UtteranceContent,
};

impl LidarFrame {
    /// [`LidarFrame::object`] where an azimuth has no return.
    pub const NO_OBJECT: i32 = -1;
}

impl ObjectPose {
    /// [`ObjectPose::id`] of the ego car.
    pub const EGO: i32 = -1;
}

impl Outcome {
    /// [`Outcome::other`] where nothing was touched.
    pub const NOTHING_TOUCHED: i32 = -1;
    /// [`Outcome::other`] of the road's edge.
    pub const ROAD_EDGE: i32 = -2;

    /// Whether the episode goes on, and how it ended.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn end(&self) -> Result<EpisodeEnd, UnknownNumber> {
        EpisodeEnd::from_wire(self.end)
    }
}

impl CommAction {
    /// How the decision came about.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn reason(&self) -> Result<DecisionReason, UnknownNumber> {
        DecisionReason::from_wire(self.reason)
    }

    /// Whether somebody decided this, early or late: there is a planner, and the human model answered it.
    pub fn is_decided(&self) -> bool {
        !matches!(
            self.reason(),
            Ok(DecisionReason::NoPlanner | DecisionReason::HumanSilent)
        )
    }
}

impl Utterance {
    /// [`Utterance::item`] of a notice, which is about no item.
    pub const NO_ITEM: u32 = u32::MAX;

    /// What it says.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn content(&self) -> Result<UtteranceContent, UnknownNumber> {
        UtteranceContent::from_wire(self.kind)
    }

    /// Whether the text is about the assistant itself.
    pub fn is_notice(&self) -> bool {
        self.content() == Ok(UtteranceContent::Notice)
    }
}

impl DriverAction {
    /// The discrete action, if it is one; otherwise the action is throttle and steer.
    pub fn discrete(&self) -> Option<u32> {
        (self.is_choice != 0).then_some(self.choice)
    }
}

impl Cockpit {
    /// What it tells.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn event(&self) -> Result<CockpitEvent, UnknownNumber> {
        CockpitEvent::from_wire(self.event)
    }

    /// Whether somebody is there.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn presence(&self) -> Result<Presence, UnknownNumber> {
        Presence::from_wire(self.presence)
    }
}

impl ImagineRequest {
    /// What it asks.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn phase(&self) -> Result<ImaginePhase, UnknownNumber> {
        ImaginePhase::from_wire(self.phase)
    }
}

impl ImagineAnswer {
    /// How the question was answered.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn status(&self) -> Result<ImagineStatus, UnknownNumber> {
        ImagineStatus::from_wire(self.status)
    }

    /// What the question asked.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn phase(&self) -> Result<ImaginePhase, UnknownNumber> {
        ImaginePhase::from_wire(self.phase)
    }
}

impl Control {
    /// [`Control::process`] that addresses all of them.
    pub const EVERYBODY: u32 = u32::MAX;

    /// What is asked.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn command(&self) -> Result<ControlCommand, UnknownNumber> {
        ControlCommand::from_wire(self.command)
    }
}

impl Report {
    /// Why the process reports.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn state(&self) -> Result<ProcessState, UnknownNumber> {
        ProcessState::from_wire(self.state)
    }
}

impl Progress {
    /// [`Progress::process`] of the launcher.
    pub const LAUNCHER: u32 = u32::MAX;
    /// [`Progress::recorder`] where there is none to wait for.
    pub const NO_RECORDER: u32 = u32::MAX;
}
