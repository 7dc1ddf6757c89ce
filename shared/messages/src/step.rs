//! The messages that every domain has, in the order in which a step produces them. They hold what the largest domain
//! needs, and say how much of it is used; what one domain alone has, such as the highway's LIDAR, has a message of its
//! own.

use crate::Header;
use crate::message::message;

/// Directions that can be communicated about.
pub const SECTORS: usize = 6;
/// Numbers that the verbal modality carries: per sector 19 of the utterance's embedding, and the range.
pub const VERBAL: usize = SECTORS * 20;
/// Size of the latent state z.
pub const LATENT: usize = 128;
/// Throttle/brake and steer.
pub const ACTIONS: usize = 2;
/// Most discrete actions that a domain has.
pub const CHOICES: usize = 4;
/// Most numbers of a visual modality; search and rescue has 246, the highway 113.
pub const VISUAL_NUMBERS: usize = 256;
/// Most numbers of a verbal modality; the highway has 120.
pub const VERBAL_NUMBERS: usize = 128;
/// Most visual items that can be communicated: search and rescue's nine portions, the highway's six sectors.
pub const VISUAL_ITEMS: usize = 16;
/// Most verbal items that can be communicated: the highway's six sectors.
pub const VERBAL_ITEMS: usize = 8;
/// Most terms of a gridworld's reward.
pub const TERMS: usize = 4;
/// Most imagined people in one question to the human model.
pub const MAX_GROUP: usize = 512;

/// Topic names. Questions to the human model travel on [`topic::IMAGINE`], its answers on [`topic::IMAGINE_ANSWER`].
pub mod topic {
    /// [`LidarFrame`](crate::LidarFrame): highway → belief, human, driver, renderer, recorder.
    pub const LIDAR: &str = "world/lidar";
    /// [`Observation`](crate::Observation): gridworlds → belief, human, driver, renderer, recorder.
    pub const OBSERVATION: &str = "world/observation";
    /// [`Picture`](crate::Picture): gridworlds → renderer, recorder.
    pub const PICTURE: &str = "world/picture";
    /// [`Scene`](crate::Scene): highway → renderer, recorder.
    pub const SCENE: &str = "world/scene";
    /// [`Scene`](crate::Scene) between the steps, where a person is at the wheel: highway → driver.
    pub const MOTION: &str = "world/motion";
    /// [`Outcome`](crate::Outcome): world → all.
    pub const OUTCOME: &str = "world/outcome";
    /// [`RobotBelief`](crate::RobotBelief): belief → planner, renderer.
    pub const ROBOT_BELIEF: &str = "belief/robot";
    /// [`HumanBelief`](crate::HumanBelief): human → planner, renderer.
    pub const HUMAN_BELIEF: &str = "belief/human";
    /// [`CommAction`](crate::CommAction): planner → renderer, human.
    pub const COMM_ACTION: &str = "comm/action";
    /// [`Display`](crate::Display): renderer → driver, human, planner.
    pub const DISPLAY: &str = "comm/display";
    /// [`DriverAction`](crate::DriverAction): driver → world, human, belief, planner.
    pub const DRIVER_ACTION: &str = "driver/action";
    /// [`Cockpit`](crate::Cockpit): a person's cockpit → world, recorder.
    pub const COCKPIT: &str = "driver/cockpit";
    /// [`ImagineRequest`](crate::ImagineRequest): planner → human.
    pub const IMAGINE: &str = "human/imagine";
    /// [`ImagineAnswer`](crate::ImagineAnswer): human → planner.
    pub const IMAGINE_ANSWER: &str = "human/imagine/answer";
    /// [`Control`](crate::Control): launcher → all.
    pub const CONTROL: &str = "run/control";
    /// [`Report`](crate::Report): all → launcher.
    pub const REPORT: &str = "run/report";
    /// [`Progress`](crate::Progress): launcher and recorder → world.
    pub const PROGRESS: &str = "run/progress";
}

message! {
    /// What step k−1's action led to: reward by term, collision, end. The named terms are the highway's.
    pub struct Outcome, "2" {
        /// Header.
        pub header: Header,
        /// Sum of the terms.
        pub reward: f32,
        /// r^speed.
        pub speed: f32,
        /// r^brake.
        pub brake: f32,
        /// r^steer.
        pub steer: f32,
        /// r^change.
        pub change: f32,
        /// r^center.
        pub center: f32,
        /// r^proximity.
        pub proximity: f32,
        /// r^road.
        pub road: f32,
        /// Collision penalty.
        pub collision: f32,
        /// A gridworld's terms, in the order of `domains::Layout::terms`.
        pub terms: [f32; TERMS],
        /// 1 if the ego car touched another car or left the road in this step, or a person ran into an obstacle.
        pub collided: u32,
        /// [`EpisodeEnd`](crate::EpisodeEnd): 0 running, 1 goal reached, 2 collision, 3 out of time.
        pub end: u32,
        /// Identity of the car that was touched; −1 for none, −2 for the road's edge.
        pub other: i32,
    } header: yes
}

message! {
    /// The robot's belief z^R_k and the observation that it decodes to.
    pub struct RobotBelief, "2" {
        /// Header.
        pub header: Header,
        /// Mean of z^R.
        pub mean: [f32; LATENT],
        /// Deviation of z^R.
        pub deviation: [f32; LATENT],
        /// Decoded mean of the visual modality; on the highway 108 ranges and 5 ego values.
        pub visual: [f32; VISUAL_NUMBERS],
        /// Decoded mean of the verbal modality.
        pub verbal: [f32; VERBAL_NUMBERS],
        /// Decoded mean of the reward.
        pub reward: f32,
        /// Mean squared error between what was decoded and what was sensed.
        pub surprise: f32,
        /// How much of `mean` is used.
        pub latent: u32,
        /// How much of `visual` is used.
        pub visual_len: u32,
        /// How much of `verbal` is used.
        pub verbal_len: u32,
        /// Which domain; see [`DomainNumber`](crate::DomainNumber).
        pub domain: u32,
    } header: yes
}

message! {
    /// What the human model believes that the person believes, z^H_k, and expects them to do.
    pub struct HumanBelief, "2" {
        /// Header.
        pub header: Header,
        /// Mean of z^H.
        pub mean: [f32; LATENT],
        /// Deviation of z^H.
        pub deviation: [f32; LATENT],
        /// Mean of the predicted action (throttle/brake and steer).
        pub action_mean: [f32; ACTIONS],
        /// Deviation of the predicted action, before the tanh.
        pub action_deviation: [f32; ACTIONS],
        /// Probability of each discrete action.
        pub probability: [f32; CHOICES],
        /// Which model speaks; in memory, zero-padded UTF-8.
        pub kind: [u8; 16] as text,
        /// How much of `mean` is used; for recurrent models, of their hidden state.
        pub latent: u32,
        /// Log-likelihood, under the prediction made at k−1, of the action that the person then took.
        pub log_likelihood: f32,
    } header: yes
}

message! {
    /// What to communicate at step k, decided at k−1.
    pub struct CommAction, "3" {
        /// Header.
        pub header: Header,
        /// Probability of each visual item after the cross-entropy method's last iteration; from the other planners, 1 for
        /// what is shown and 0 for what is not.
        pub visual_probability: [f32; VISUAL_ITEMS],
        /// The same of each verbal item.
        pub verbal_probability: [f32; VERBAL_ITEMS],
        /// A bit per visual item to show; on the highway, per sector to highlight.
        pub visual: u32,
        /// A bit per verbal item to say; on the highway, per sector to speak about.
        pub verbal: u32,
        /// Predicted value of the plan.
        pub value: f32,
        /// Predicted value of saying nothing.
        pub value_silent: f32,
        /// Communication cost of this step.
        pub cost: f32,
        /// What the best way of communicating something now gains over silence, less its cost (`race`).
        pub gain_now: f32,
        /// What the best way of waiting with it gains over silence, less its cost (`race`).
        pub gain_later: f32,
        /// Standard error of the difference that decided (`race`).
        pub gain_error: f32,
        /// [`DecisionReason`](crate::DecisionReason): 0 planned, 1 no planner, 2 the human model gave no answer, 3
        /// late.
        pub reason: u32,
        /// Imagined rounds of all candidates together: the people that the human model was asked about.
        pub samples: u32,
        /// Iterations of the cross-entropy method, or rounds of the race.
        pub iterations: u32,
        /// Futures that what was decided rests on: in `race`, those that the last candidates lived through.
        pub futures: u32,
    } header: yes
}

message! {
    /// Something spoken.
    pub struct Utterance, "2" {
        /// What is said; in memory, zero-padded UTF-8.
        pub text: [u8; 64] as text,
        /// The verbal item: on the highway, the sector it is about. `u32::MAX` for a notice.
        pub item: u32,
        /// [`UtteranceContent`](crate::UtteranceContent): 0 nothing there, 1 slow, 2 fast; 3 what the text says
        /// (gridworlds); 4 a notice about the assistant itself.
        pub kind: u32,
        /// Highway: range of the nearest car there in m; 40 for none.
        pub range_m: f32,
        /// Highway: its speed.
        pub speed_mps: f32,
    } header: no
}

message! {
    /// What the person is shown and told at step k.
    pub struct Display, "2" {
        /// Header.
        pub header: Header,
        /// Utterances that start now.
        pub utterances: [Utterance; VERBAL_ITEMS],
        /// How many of `utterances` are filled.
        pub utterance_count: u32,
        /// A bit per visual item that is shown; on the highway, per highlighted sector.
        pub highlighted: u32,
        /// Objects with a box around them; −1 for unused places.
        pub objects: [i32; 16],
        /// How many of `objects` are filled.
        pub object_count: u32,
        /// Seconds until the next utterance may start.
        pub speech_ready_s: f32,
    } header: yes
}

message! {
    /// What the person does at step k.
    pub struct DriverAction, "2" {
        /// Header.
        pub header: Header,
        /// Throttle (positive) or brake (negative), in [−1, 1].
        pub throttle: f32,
        /// Steer, left positive, in [−1, 1].
        pub steer: f32,
        /// The discrete action, where `is_choice` says that there is one.
        pub choice: u32,
        /// 1 if the action is `choice`, 0 if it is throttle and steer.
        pub is_choice: u32,
    } header: yes
}

message! {
    /// What the page of a person at the wheel tells of itself: whether they are there, how old their input is, and when
    /// they saw and heard what was sent.
    pub struct Cockpit, "1" {
        /// Header; episode and step are those that it is about.
        pub header: Header,
        /// When it happened: for a sentence its onset, for a display when it was first drawn; in nanoseconds, as
        /// `Header::sent_ns`.
        pub happened_ns: u64,
        /// How long ago the newest input arrived; 0 where there was none.
        pub input_age_ns: u64,
        /// From sending a state to hearing that it was drawn, as last measured; 0 where it was not.
        pub round_trip_ns: u64,
        /// The sentence; in memory, zero-padded UTF-8.
        pub text: [u8; 64] as text,
        /// The sentence's item, as in [`Utterance::item`](crate::Utterance::item).
        pub item: u32,
        /// [`CockpitEvent`](crate::CockpitEvent): 0 presence, 1 a sentence is heard, 2 is not heard, 3 a display is
        /// seen.
        pub event: u32,
        /// [`Presence`](crate::Presence): 0 absent, 1 present, 2 given up.
        pub presence: u32,
        /// Pages that are open.
        pub pages: u32,
    } header: yes
}

message! {
    /// A question to the human model: "if this group of imagined people saw this, what would they do?"
    pub struct ImagineRequest, "4" {
        /// Header; `step` is the step planned from.
        pub header: Header,
        /// Seed of this question's noise; with it the answer is a pure function of the belief and the question.
        pub seed: u64,
        /// Group of imagined people; the human model keeps each group's beliefs from question to question.
        pub group: u32,
        /// [`ImaginePhase`](crate::ImaginePhase). 0: start from the current belief. 1: perceive what is below, then
        /// act; people beyond the group's until now have been as the first of their future. 2: forget the group. 3: no group, but how far from the robot's belief would the person's be, had they
        /// perceived what is below after `action`?
        pub phase: u32,
        /// People in the group.
        pub rows: u32,
        /// Number of the group's first future among those of all groups (phase 0).
        pub first_future: u32,
        /// Futures of the group (phase 0): person j lives in future j modulo this, and what is left to chance in a future
        /// is the same for everybody in it.
        pub futures: u32,
        /// 1 if `action` is what the person really does at this step (phases 0 and 3).
        pub action_known: u32,
        /// See `action_known`: throttle/brake and steer, or a 1 in the place of a discrete action.
        pub action: [f32; CHOICES],
        /// Numbers of `visual` for each person.
        pub visual_width: u32,
        /// Numbers of `verbal` for each person.
        pub verbal_width: u32,
        /// Communicated items of each person: visual in bits 0–7 and 16–23, verbal in bits 8–15.
        pub communicated: [u32; MAX_GROUP],
        /// Imagined visual modality x̂, a person after the other without gaps, as models see it. Highway: 108 ×
        /// nearness (1 − range/40 m), then the ego values times 60, 2, 2, 2, 60.
        pub visual: [f32; MAX_GROUP * VISUAL_NUMBERS],
        /// Imagined verbal modality x̂, a person after the other without gaps. Where people hear nobody but the assistant,
        /// what stands here for those who are told nothing has no meaning.
        pub verbal: [f32; MAX_GROUP * VERBAL_NUMBERS],
        /// Mean of z^R at the step after (phase 3).
        pub robot_mean: [f32; LATENT],
        /// Its deviation.
        pub robot_deviation: [f32; LATENT],
    } header: yes
}

message! {
    /// The human model's answer: the group's next actions, or distances between beliefs.
    pub struct ImagineAnswer, "3" {
        /// Header; episode and step are the question's.
        pub header: Header,
        /// The question's group.
        pub group: u32,
        /// People in the group.
        pub rows: u32,
        /// [`ImagineStatus`](crate::ImagineStatus): 0 answered, 1 no belief for that step, 2 no such group, 3 no belief
        /// that could be compared with the robot's.
        pub status: u32,
        /// The question's phase; see [`ImaginePhase`](crate::ImaginePhase).
        pub phase: u32,
        /// Actions of the people, one after the other without gaps: throttle/brake and steer, or as many numbers as
        /// there are discrete actions, a 1 in the place of the one that is taken.
        pub action: [f32; MAX_GROUP * CHOICES],
        /// KL[z^H ‖ z^R] of each row (phase 3).
        pub divergence: [f32; MAX_GROUP],
    } header: yes
}

message! {
    /// What the launcher asks of the processes.
    pub struct Control, "1" {
        /// Header.
        pub header: Header,
        /// [`ControlCommand`](crate::ControlCommand): 1 start, 2 stop, 3 take over from the header's episode and step
        /// on, 4 report, 5 connect to who joined, 6 be silent from the header's episode and step on.
        pub command: u32,
        /// Process addressed: index in launch order, or `u32::MAX` for all.
        pub process: u32,
        /// Argument of the command.
        pub argument: u64,
    } header: yes
}

message! {
    /// What one input of a process counted.
    pub struct PortCount, "1" {
        /// The topic; in memory, zero-padded UTF-8.
        pub topic: [u8; 24] as text,
        /// Messages received.
        pub received: u64,
        /// Messages lost: gaps in their senders' sequence numbers.
        pub lost: u64,
    } header: no
}

message! {
    /// What a process tells the launcher: at its start, on request, and at its end.
    pub struct Report, "2" {
        /// Header.
        pub header: Header,
        /// Process name; in memory, zero-padded UTF-8.
        pub process: [u8; 16] as text,
        /// A message for people; in memory, zero-padded UTF-8.
        pub text: [u8; 256] as text,
        /// The process's inputs in the order in which it made them.
        pub ports: [PortCount; 16],
        /// Compute time per step: p50, p90, p99, p99.9, max, in nanoseconds.
        pub compute_ns: [u64; 5],
        /// Steps done.
        pub steps: u64,
        /// Deadlines missed.
        pub missed_deadlines: u64,
        /// Messages that waited for the process to look up, because the transport lost the wake-up; 0 in a healthy run.
        pub lost_wakeups: u64,
        /// Heap allocations in the steady-state loop.
        pub allocations: u64,
        /// Those of them that iceoryx2 made for loaning messages.
        pub transport_allocations: u64,
        /// Digest of what was recorded; from the recorder only.
        pub digest: [u8; 32],
        /// How many of `ports` are filled.
        pub port_count: u32,
        /// The process's place in launch order.
        pub index: u32,
        /// Operating-system process id.
        pub pid: u32,
        /// [`ProcessState`](crate::ProcessState): 1 ready, 2 running, 3 finished, 4 failed, 5 caught up, 6 will take
        /// over or hand over as told, 7 too late for that, 8 silent from now on.
        pub state: u32,
    } header: yes
}

message! {
    /// How far those have come who take in what others send and answer nothing: in lockstep, the world waits for them.
    pub struct Progress, "1" {
        /// Header; episode and step are the newest that were taken in.
        pub header: Header,
        /// Who has come so far: place in launch order, or `u32::MAX` for the launcher.
        pub process: u32,
        /// From the launcher: place in launch order of the recorder to wait for, `u32::MAX` for none.
        pub recorder: u32,
    } header: yes
}
