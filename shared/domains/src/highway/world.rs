//! The highway world: ego car, traffic, sensing and reward (the paper's appendix "CARLA").

mod case;
mod ego;
mod reward;
mod sense;

use std::sync::Arc;

use rand::RngExt;

use super::control::Cockpit;
use super::geometry::OrientedBox;
use super::lidar::Lidar;
use super::road::{Pose, Road, RoadPoint};
use super::scene::{CaseOrder, Scene};
use super::traffic::{CarState, Course, Motion, Participant};
use super::{Observation, random};
use crate::commonroad::GoalRegion;

pub use case::{Case, Misbehaviour};
pub use ego::EgoCar;
pub(crate) use ego::drive;
pub use reward::{End, NOTHING, Outcome, ROAD_EDGE};

/// Random stream of the world.
const STREAM: u64 = 1;
/// Along the road, cars farther than this from the ego car are neither sensed nor touched: the LIDAR's 40 m, half of the
/// longest vehicle, and what a bend adds.
const NEIGHBOUR_M: f64 = 60.0;
/// As [`NEIGHBOUR_M`], for touching: half of the ego car and of the longest vehicle.
const TOUCH_M: f64 = 20.0;
/// Cars in one lane keep this distance between bumpers.
const STANDSTILL_GAP_M: f64 = 2.0;

/// The highway. After [`World::reset`], neither stepping nor observing allocates.
#[derive(Clone, Debug)]
pub struct World {
    scene: Arc<Scene>,
    course: Arc<Course>,
    /// Whether traffic is the course's recording; otherwise it is drawn for the case.
    recorded: bool,
    /// The recorded car whose seat the ego car takes.
    seat: Option<Arc<Participant>>,
    participants: Vec<Participant>,
    /// Half of the longest participant: recorded ones can be long.
    longest_half_m: f64,
    cars: Vec<CarState>,
    /// Indices of `cars`, sorted by lane and then by s.
    order: Vec<u32>,
    ego: EgoCar,
    case: Case,
    lidar: Lidar,
    observation: Observation,
    time_s: f64,
    ticks: u64,
    step: u32,
    moving: bool,
    end: End,
    /// The step that [`World::tick`] has begun.
    begun: Option<BegunStep>,
}

/// A step between its first tick and its last.
#[derive(Clone, Copy, Debug)]
struct BegunStep {
    /// Ticks of it that are over.
    ticks: u32,
    lane_before: usize,
    touched: i32,
    throttle: f64,
    steer: f64,
}

impl World {
    /// The world of a scene: of its own road and cases, or of its recording, from a recorded car's seat if the scene names
    /// one.
    ///
    /// # Errors
    /// When the scene's road cannot be built; a scene that was read from a file always can.
    pub fn new(scene: Arc<Scene>) -> Result<Self, super::road::RoadError> {
        if let Some(course) = scene.course.clone() {
            let seat = scene
                .seat
                .and_then(|id| Self::seated(scene.clone(), course.clone(), id));
            return Ok(seat.unwrap_or_else(|| Self::with_course(scene, course)));
        }
        let course = Course {
            road: scene.road.build()?,
            traffic: Vec::new(),
            start: Pose::default(),
            start_speed_mps: 0.0,
            goal_s_m: scene.episode.goal_s_m,
            goal: GoalRegion::default(),
            duration_s: f64::INFINITY,
            notes: Vec::new(),
        };
        Ok(Self::build(scene, Arc::new(course), false, None))
    }

    /// The world of recorded traffic: the scene gives everything but road and traffic.
    pub fn with_course(scene: Arc<Scene>, course: Arc<Course>) -> Self {
        Self::build(scene, course, true, None)
    }

    /// The world of recorded traffic from the seat of one of its cars: the ego car takes that car's place and follows its
    /// recording, whatever the action given to [`World::step`]. Nothing if no car has that identity.
    pub fn seated(scene: Arc<Scene>, course: Arc<Course>, car: i32) -> Option<Self> {
        let seat = course
            .traffic
            .iter()
            .find(|participant| participant.id == car)?
            .clone();
        matches!(seat.motion, Motion::Recorded(_))
            .then(|| Self::build(scene, course, true, Some(Arc::new(seat))))
    }

    fn build(
        scene: Arc<Scene>,
        course: Arc<Course>,
        recorded: bool,
        seat: Option<Arc<Participant>>,
    ) -> Self {
        let mut world = Self {
            scene,
            course,
            recorded,
            seat,
            participants: Vec::new(),
            longest_half_m: 0.0,
            cars: Vec::new(),
            order: Vec::new(),
            ego: EgoCar::default(),
            case: Case::ALL[0],
            lidar: Lidar::default(),
            observation: Observation::default(),
            time_s: 0.0,
            ticks: 0,
            step: 0,
            moving: false,
            end: End::Running,
            begun: None,
        };
        world.reset(0, 0);
        world
    }

    /// Starts a round. Its case is the scene's `traffic.case` if there is one; otherwise `episode` modulo 6, or drawn,
    /// as the scene's `traffic.order` says.
    pub fn reset(&mut self, seed: u64, episode: u32) {
        let traffic = &self.scene.traffic;
        let case = traffic
            .case
            .and_then(Case::new)
            .unwrap_or_else(|| match traffic.order {
                CaseOrder::Cycle => Case::ALL[(episode % 6) as usize],
                CaseOrder::Drawn => {
                    Case::ALL[random(seed, episode, STREAM + (1 << 32)).random_range(0..6)]
                }
            });
        self.reset_case(seed, episode, case);
    }

    /// Starts a round of the given case. Recorded traffic has no cases: there it changes nothing.
    pub fn reset_case(&mut self, seed: u64, episode: u32, case: Case) {
        self.case = case;
        self.participants.clear();
        if self.recorded {
            let seat = self.seat.as_ref().map(|seat| seat.id);
            let others = self
                .course
                .traffic
                .iter()
                .filter(|car| Some(car.id) != seat);
            self.participants.extend(others.cloned());
        } else {
            case::draw_traffic(
                &self.scene.traffic,
                seed,
                episode,
                case,
                &mut self.participants,
            );
        }
        let halves = self
            .participants
            .iter()
            .map(|car| car.length_m.max(car.width_m) / 2.0);
        self.longest_half_m = halves.fold(0.0, f64::max);
        self.cars.clear();
        self.cars
            .resize(self.participants.len(), CarState::default());
        let start_s = match &self.seat {
            Some(seat) => recording_start_s(seat),
            None => 0.0,
        };
        for (participant, car) in self.participants.iter().zip(&mut self.cars) {
            participant.place(&self.course.road, car);
            if self.recorded {
                participant.advance(&self.course.road, start_s, 0.0, f64::INFINITY, car);
            }
        }
        self.order.clear();
        self.order.extend(0..self.cars.len() as u32);
        self.time_s = start_s;
        self.begun = None;
        (self.ticks, self.step, self.end, self.moving) = (0, 0, End::Running, self.recorded);
        self.place_ego(case);
        self.sort();
        self.sense();
    }

    fn place_ego(&mut self, case: Case) {
        let (road, spec) = (&self.course.road, &self.scene.ego);
        let mut ego = EgoCar {
            length_m: spec.length_m,
            width_m: spec.width_m,
            ..EgoCar::default()
        };
        if let Some(Participant {
            motion: Motion::Recorded(recording),
            length_m,
            width_m,
            ..
        }) = self.seat.as_deref()
        {
            let first = recording.poses.first().copied().unwrap_or_default();
            (ego.pose, ego.speed_mps) = (first.pose, first.speed_mps);
            (ego.length_m, ego.width_m) = (*length_m, *width_m);
            ego.at = road.project(ego.pose.x_m, ego.pose.y_m);
        } else if self.recorded {
            (ego.pose, ego.speed_mps) = (self.course.start, self.course.start_speed_mps);
            ego.at = road.project(ego.pose.x_m, ego.pose.y_m);
        } else {
            let lane = usize::from(case.ego_left());
            ego.at = RoadPoint {
                s_m: spec.start_s_m,
                d_m: road.lane_offset_m(lane, spec.start_s_m),
            };
            ego.pose = road.pose(ego.at);
        }
        ego.lane = road.lane_near(ego.at);
        self.ego = ego;
    }

    /// Moves the world by one control step. Past a round's end it stands still and gives no reward.
    pub fn step(&mut self, action: [f32; 2]) -> Outcome {
        while !self.tick(action) {}
        self.finish_step()
    }

    /// Moves the world by one physics tick of a control step, for a person at the wheel, whose action may change from
    /// tick to tick; true if it was the step's last, after which [`World::finish_step`] says what the step led to.
    pub fn tick(&mut self, action: [f32; 2]) -> bool {
        if self.end != End::Running {
            return true;
        }
        let finite = |value: f32| {
            if value.is_finite() {
                f64::from(value.clamp(-1.0, 1.0))
            } else {
                0.0
            }
        };
        let mut begun = match self.begun {
            Some(begun) => begun,
            None => BegunStep {
                ticks: 0,
                lane_before: self.ego.lane,
                touched: NOTHING,
                throttle: 0.0,
                steer: 0.0,
            },
        };
        match &self.seat {
            None => [begun.throttle, begun.steer] = action.map(finite),
            Some(seat) if begun.ticks == 0 => {
                [begun.throttle, begun.steer] = self
                    .course
                    .recorded_action(&self.scene, seat, self.time_s)
                    .map(f64::from);
            }
            Some(_) => {} // a recorded action is a whole step's
        }
        self.moving |= begun.throttle > 0.0;
        begun.touched = self.move_all(begun.throttle, begun.steer);
        begun.ticks += 1;
        self.begun = Some(begun);
        begun.touched != NOTHING || begun.ticks >= self.scene.clock.ticks_per_step
    }

    /// What the control step led to whose last tick is over; as [`World::step`] without another tick.
    pub fn finish_step(&mut self) -> Outcome {
        let Some(begun) = self.begun.take().filter(|_| self.end == End::Running) else {
            return Outcome {
                end: self.end,
                other: NOTHING,
                ..Outcome::default()
            };
        };
        let BegunStep {
            lane_before,
            touched,
            throttle,
            steer,
            ..
        } = begun;
        self.step += 1;
        self.sense();
        self.end = if touched != NOTHING {
            End::Collision
        } else if self.ego.at.s_m >= self.course.goal_s_m
            || self
                .course
                .goal
                .reached(&self.ego.pose, self.ego.speed_mps, self.time_s)
        {
            End::Goal
        } else if self.step >= self.scene.episode.max_steps || self.time_s >= self.course.duration_s
        {
            End::OutOfTime
        } else if self
            .seat
            .as_deref()
            .is_some_and(|seat| self.time_s + self.scene.step_s() > recording_end_s(seat) + 1e-6)
        {
            End::Goal
        } else {
            End::Running
        };
        self.score(throttle, steer, lane_before, touched)
    }

    /// One physics tick of everybody; what the ego car touched.
    fn move_all(&mut self, throttle: f64, steer: f64) -> i32 {
        let tick_s = 1.0 / self.scene.clock.tick_hz;
        if self.moving {
            self.ticks += 1;
            // Not summed: a million ticks later it is still on time.
            self.time_s = match &self.seat {
                Some(seat) => recording_start_s(seat),
                None => 0.0,
            } + self.ticks as f64 * tick_s;
            let road = &self.course.road;
            for position in (0..self.order.len()).rev() {
                let index = self.order[position] as usize;
                // The car ahead in the lane has already moved: walking backwards through the order.
                let mut limit_mps = f64::INFINITY;
                if !self.recorded
                    && let Some(&ahead) = self.order.get(position + 1)
                {
                    let (car, ahead) = (&self.cars[index], &self.cars[ahead as usize]);
                    if ahead.lane == car.lane {
                        let between =
                            ahead.at.s_m - car.at.s_m - ahead.half_length_m - car.half_length_m;
                        let room = (between - STANDSTILL_GAP_M).max(0.0);
                        let brake = self.scene.traffic.deceleration_mps2;
                        limit_mps = (ahead.speed_mps.powi(2) + 2.0 * brake * room).sqrt();
                        if room <= 0.0 {
                            limit_mps = limit_mps.min(0.9 * ahead.speed_mps);
                        }
                    }
                }
                let (participant, car) = (&self.participants[index], &mut self.cars[index]);
                participant.advance(road, self.time_s, tick_s, limit_mps, car);
            }
        }
        self.move_ego(throttle, steer, tick_s);
        self.sort();
        let ego_box = self.ego.oriented_box();
        let mut touched = NOTHING;
        self.neighbours(TOUCH_M.max(self.longest_half_m + 6.0), |car| {
            let other = OrientedBox {
                x_m: car.x_m,
                y_m: car.y_m,
                cos: car.cos,
                sin: car.sin,
                half_length_m: car.half_length_m,
                half_width_m: car.half_width_m,
            };
            if touched == NOTHING && ego_box.overlaps(&other) {
                touched = car.id;
            }
        });
        // Recorded boxes overlap by errors of measurement, and a recorded person may leave the mapped lanes; neither is a
        // collision.
        if self.seat.is_some() {
            return NOTHING;
        }
        if touched == NOTHING {
            let (right, left) = self.course.road.edges_m(self.ego.at.s_m);
            let (left_shoulder, right_shoulder) = self.course.road.shoulders_m();
            let half = self.ego.width_m / 2.0;
            let off_road = if self.recorded {
                // Lanelets map no shoulders: the car has left the road when its centre is outside all of them.
                !self.course.road.on_lane(self.ego.at)
            } else {
                self.ego.at.d_m + half > left + left_shoulder
                    || self.ego.at.d_m - half < right - right_shoulder
            };
            if off_road {
                touched = ROAD_EDGE;
            }
        }
        touched
    }

    fn move_ego(&mut self, throttle: f64, steer: f64, tick_s: f64) {
        let road = &self.course.road;
        if let Some(Participant {
            motion: Motion::Recorded(recording),
            ..
        }) = self.seat.as_deref()
        {
            if let Some(now) = recording.at(self.time_s) {
                (self.ego.pose, self.ego.speed_mps) = (now.pose, now.speed_mps);
            }
        } else {
            drive(&mut self.ego, &self.scene.ego, throttle, steer, tick_s);
        }
        let ego = &mut self.ego;
        ego.at = road.project_near(ego.pose.x_m, ego.pose.y_m, ego.at.s_m);
        ego.lane = road.lane_near(ego.at);
    }

    /// What the car senses now.
    pub fn observe(&self, observation: &mut Observation) {
        observation.clone_from(&self.observation);
    }

    /// What the car senses now, without a copy.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// True states of the traffic; those not `present` are not on the road now.
    pub fn objects(&self) -> &[CarState] {
        &self.cars
    }

    /// The participants behind [`World::objects`], in the same order.
    pub fn participants(&self) -> &[Participant] {
        &self.participants
    }

    /// The ego car.
    pub fn ego(&self) -> &EgoCar {
        &self.ego
    }

    /// The round's case (meaningless for recorded traffic).
    pub fn case(&self) -> Case {
        self.case
    }

    /// What everybody knows who sits in the ego car here.
    pub fn cockpit(&self) -> Cockpit {
        Cockpit::new(&self.scene, &self.course.road, self.ego.at.s_m)
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The road.
    pub fn road(&self) -> &Road {
        &self.course.road
    }

    /// Control steps since the round began.
    pub fn steps(&self) -> u32 {
        self.step
    }

    /// Seconds since traffic began to move; for recorded traffic, of the recording's clock.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Whether traffic moves.
    pub fn moving(&self) -> bool {
        self.moving
    }

    /// How the round stands.
    pub fn end(&self) -> End {
        self.end
    }

    /// The action that the recorded person in whose seat the world is takes in the coming step.
    pub fn recorded_action(&self) -> Option<[f32; 2]> {
        let seat = self.seat.as_deref()?;
        Some(self.course.recorded_action(&self.scene, seat, self.time_s))
    }
}

fn recording_start_s(seat: &Participant) -> f64 {
    match &seat.motion {
        Motion::Recorded(recording) => recording.start_s,
        Motion::Lane(_) => 0.0,
    }
}

fn recording_end_s(seat: &Participant) -> f64 {
    match &seat.motion {
        Motion::Recorded(recording) => recording.end_s(),
        Motion::Lane(_) => f64::INFINITY,
    }
}
