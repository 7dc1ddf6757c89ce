//! The highway world: ego car, traffic, sensing and reward (DESIGN §4; the paper's appendix "CARLA").

use std::sync::Arc;

use rand::RngExt;

use super::geometry::OrientedBox;
use super::lidar::Lidar;
use super::road::{Pose, Road, RoadPoint, wrap_angle};
use super::scene::{CaseOrder, Scene};
use super::traffic::{CarState, Course, Kind, LaneMotion, Motion, Participant};
use crate::commonroad::GoalRegion;
use super::{
    AZIMUTHS, EGO_AHEAD_M, EGO_LANE_M, EGO_ROAD_M, EGO_SPEED_MPS, LIDAR_RANGE_M, Observation, random,
};

/// Random stream of the world.
const STREAM: u64 = 1;
/// Along the road, cars farther than this from the ego car are neither sensed nor touched: the LIDAR's 40 m, half of the
/// longest vehicle, and what a bend adds.
const NEIGHBOUR_M: f64 = 60.0;
/// As [`NEIGHBOUR_M`], for touching: half of the ego car and of the longest vehicle.
const TOUCH_M: f64 = 20.0;
/// Cars in one lane keep this distance between bumpers.
const STANDSTILL_GAP_M: f64 = 2.0;

/// One of the six cases: the ego car's lane, and which car misbehaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misbehaviour {
    /// The car ahead in the ego car's lane slows down.
    FrontSlows,
    /// The car behind in the ego car's lane rushes.
    RearRushes,
    /// The car behind in the other lane rushes.
    OtherRearRushes,
}

/// One of the six cases, 1 to 6: (1) ego left, left-front slows; (2) ego left, left-rear rushes; (3) ego left, right-rear
/// rushes; (4–6) the mirror images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case(u32);

impl Case {
    /// All of them.
    pub const ALL: [Self; 6] = [Self(1), Self(2), Self(3), Self(4), Self(5), Self(6)];

    /// The case of that number, 1 to 6.
    pub fn new(number: u32) -> Option<Self> {
        (1..=6).contains(&number).then_some(Self(number))
    }

    /// Its number, 1 to 6.
    pub fn number(self) -> u32 {
        self.0
    }

    /// Whether the ego car starts in the left lane.
    pub fn ego_left(self) -> bool {
        self.0 <= 3
    }

    /// What happens.
    pub fn misbehaviour(self) -> Misbehaviour {
        match (self.0 - 1) % 3 {
            0 => Misbehaviour::FrontSlows,
            1 => Misbehaviour::RearRushes,
            _ => Misbehaviour::OtherRearRushes,
        }
    }
}

/// How a round stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum End {
    /// It goes on.
    #[default]
    Running = 0,
    /// The goal line was passed.
    Goal = 1,
    /// The ego car touched another car or left the road.
    Collision = 2,
    /// Time is up.
    OutOfTime = 3,
}

/// Identity in [`Outcome::other`] of the road's edge.
pub const ROAD_EDGE: i32 = -2;
/// Identity in [`Outcome::other`] of nothing.
pub const NOTHING: i32 = -1;

/// What a step led to: the reward's terms, already weighted, and how the round stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
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
    /// Whether the ego car touched another car or left the road in this step.
    pub collided: bool,
    /// How the round stands.
    pub end: End,
    /// Identity of the car that was touched; [`NOTHING`] or [`ROAD_EDGE`].
    pub other: i32,
}

/// The ego car.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EgoCar {
    /// Centre of the box, and direction.
    pub pose: Pose,
    /// Along the road.
    pub at: RoadPoint,
    /// Speed in m/s, never negative.
    pub speed_mps: f64,
    /// Angle of the front wheels, left positive.
    pub wheel_rad: f64,
    /// Lane that its centre is in.
    pub lane: usize,
    /// Box length.
    pub length_m: f64,
    /// Box width.
    pub width_m: f64,
}

impl EgoCar {
    /// Its box.
    pub fn oriented_box(&self) -> OrientedBox {
        let (sin, cos) = self.pose.heading_rad.sin_cos();
        OrientedBox {
            x_m: self.pose.x_m,
            y_m: self.pose.y_m,
            cos,
            sin,
            half_length_m: self.length_m / 2.0,
            half_width_m: self.width_m / 2.0,
        }
    }
}

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
}

impl World {
    /// The world of a scene: of its own road and cases, or of its recording, from a recorded car's seat if the scene names
    /// one.
    ///
    /// # Errors
    /// When the scene's road cannot be built; a scene that was read from a file always can.
    pub fn new(scene: Arc<Scene>) -> Result<Self, super::road::RoadError> {
        if let Some(course) = scene.course.clone() {
            let seat = scene.seat.and_then(|id| Self::seated(scene.clone(), course.clone(), id));
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
        let seat = course.traffic.iter().find(|participant| participant.id == car)?.clone();
        matches!(seat.motion, Motion::Recorded(_))
            .then(|| Self::build(scene, course, true, Some(Arc::new(seat))))
    }

    fn build(scene: Arc<Scene>, course: Arc<Course>, recorded: bool, seat: Option<Arc<Participant>>) -> Self {
        let mut world = Self {
            scene,
            course,
            recorded,
            seat,
            participants: Vec::new(),
            cars: Vec::new(),
            order: Vec::new(),
            ego: EgoCar::default(),
            case: Case(1),
            lidar: Lidar::default(),
            observation: Observation::default(),
            time_s: 0.0,
            ticks: 0,
            step: 0,
            moving: false,
            end: End::Running,
        };
        world.reset(0, 0);
        world
    }

    /// Starts a round. Its case is the scene's `traffic.case` if there is one; otherwise `episode` modulo 6, or drawn,
    /// as the scene's `traffic.order` says.
    pub fn reset(&mut self, seed: u64, episode: u32) {
        let traffic = &self.scene.traffic;
        let case = traffic.case.and_then(Case::new).unwrap_or_else(|| match traffic.order {
            CaseOrder::Cycle => Case(episode % 6 + 1),
            CaseOrder::Drawn => Case(random(seed, episode, STREAM + (1 << 32)).random_range(1..=6)),
        });
        self.reset_case(seed, episode, case);
    }

    /// Starts a round of the given case. Recorded traffic has no cases: there it changes nothing.
    pub fn reset_case(&mut self, seed: u64, episode: u32, case: Case) {
        self.case = case;
        self.participants.clear();
        if self.recorded {
            let seat = self.seat.as_ref().map(|seat| seat.id);
            let others = self.course.traffic.iter().filter(|car| Some(car.id) != seat);
            self.participants.extend(others.cloned());
        } else {
            self.draw_traffic(seed, episode, case);
        }
        self.cars.clear();
        self.cars.resize(self.participants.len(), CarState::default());
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
        (self.ticks, self.step, self.end, self.moving) = (0, 0, End::Running, self.recorded);
        self.place_ego(case);
        self.sort();
        self.sense();
    }

    fn place_ego(&mut self, case: Case) {
        let (road, spec) = (&self.course.road, &self.scene.ego);
        let mut ego = EgoCar { length_m: spec.length_m, width_m: spec.width_m, ..EgoCar::default() };
        if let Some(Participant { motion: Motion::Recorded(recording), length_m, width_m, .. }) =
            self.seat.as_deref()
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
            ego.at = RoadPoint { s_m: spec.start_s_m, d_m: road.lane_offset_m(lane, spec.start_s_m) };
            ego.pose = road.pose(ego.at);
        }
        ego.lane = road.lane_near(ego.at);
        self.ego = ego;
    }

    /// Cars of a case: identities 0 left-rear, 1 right-rear, 2 left-front, 3 right-front, then the scene's extra cars.
    fn draw_traffic(&mut self, seed: u64, episode: u32, case: Case) {
        let traffic = &self.scene.traffic;
        let mut random = random(seed, episode, STREAM);
        let mut draw = |[low, high]: [f64; 2]| low + (high - low) * random.random::<f64>();
        let reference = traffic.reference_kmh / 3.6;
        // Everything is drawn whether the case uses it or not, so that cases of one seed differ in nothing else.
        let starts: [f64; 4] = [
            draw(traffic.rear_s_m),
            draw(traffic.rear_s_m),
            draw(traffic.front_s_m),
            draw(traffic.front_s_m),
        ];
        let rush = draw(traffic.rush_factor) * reference;
        let (slows_at_m, slow) = (draw(traffic.slow_s_m), draw(traffic.slow_factor) * reference);
        let ego_lane = usize::from(case.ego_left());
        let car = |id: usize, lane: usize, start_s_m: f64, speed_mps: f64| Participant {
            id: id as i32,
            length_m: traffic.length_m,
            width_m: traffic.width_m,
            kind: Kind::Car,
            motion: Motion::Lane(LaneMotion {
                lane,
                start_s_m,
                speed_mps,
                slows_at_m: f64::INFINITY,
                slow_speed_mps: speed_mps,
                acceleration_mps2: traffic.acceleration_mps2,
                deceleration_mps2: traffic.deceleration_mps2,
                delay_s: 0.0,
            }),
        };
        for (id, start_s_m) in starts.into_iter().enumerate() {
            // Lane 1 is the left one.
            let lane = 1 - id % 2;
            let rear = id < 2;
            let factor = if rear { traffic.rear_factor } else { traffic.front_factor };
            let mut drawn = car(id, lane, start_s_m, factor * reference);
            if let Motion::Lane(motion) = &mut drawn.motion {
                let own = lane == ego_lane;
                match case.misbehaviour() {
                    Misbehaviour::FrontSlows if !rear && own => {
                        (motion.slows_at_m, motion.slow_speed_mps) = (slows_at_m, slow);
                    }
                    Misbehaviour::RearRushes if rear && own => {
                        (motion.speed_mps, motion.acceleration_mps2) = (rush, traffic.rush_acceleration_mps2);
                    }
                    Misbehaviour::OtherRearRushes if rear && !own => {
                        (motion.speed_mps, motion.acceleration_mps2) = (rush, traffic.rush_acceleration_mps2);
                    }
                    _ => {}
                }
            }
            self.participants.push(drawn);
        }
        for (index, extra) in traffic.extra.iter().enumerate() {
            self.participants.push(car(4 + index, extra.lane, extra.start_s_m, extra.speed_kmh / 3.6));
        }
    }

    /// Moves the world by one control step. Past a round's end it stands still and gives no reward.
    pub fn step(&mut self, action: [f32; 2]) -> Outcome {
        if self.end != End::Running {
            return Outcome { end: self.end, other: NOTHING, ..Outcome::default() };
        }
        let finite = |value: f32| if value.is_finite() { f64::from(value.clamp(-1.0, 1.0)) } else { 0.0 };
        let [throttle, steer] = match &self.seat {
            Some(seat) => self.course.recorded_action(&self.scene, seat, self.time_s).map(f64::from),
            None => action.map(finite),
        };
        self.moving |= throttle > 0.0;
        let lane_before = self.ego.lane;
        let mut touched = NOTHING;
        for _ in 0..self.scene.clock.ticks_per_step {
            touched = self.tick(throttle, steer);
            if touched != NOTHING {
                break;
            }
        }
        self.step += 1;
        self.sense();
        self.end = if touched != NOTHING {
            End::Collision
        } else if self.ego.at.s_m >= self.course.goal_s_m
            || self.course.goal.reached(&self.ego.pose, self.ego.speed_mps, self.time_s)
        {
            End::Goal
        } else if self.step >= self.scene.episode.max_steps || self.time_s >= self.course.duration_s {
            End::OutOfTime
        } else if self.seat.as_deref().is_some_and(|seat| self.time_s + self.scene.step_s() > recording_end_s(seat) + 1e-6) {
            End::Goal
        } else {
            End::Running
        };
        self.score(throttle, steer, lane_before, touched)
    }

    /// One physics tick; what the ego car touched.
    fn tick(&mut self, throttle: f64, steer: f64) -> i32 {
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
                        let between = ahead.at.s_m - car.at.s_m - ahead.half_length_m - car.half_length_m;
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
        self.neighbours(TOUCH_M, |car| {
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
                self.ego.at.d_m + half > left + left_shoulder || self.ego.at.d_m - half < right - right_shoulder
            };
            if off_road {
                touched = ROAD_EDGE;
            }
        }
        touched
    }

    fn move_ego(&mut self, throttle: f64, steer: f64, tick_s: f64) {
        let road = &self.course.road;
        if let Some(Participant { motion: Motion::Recorded(recording), .. }) = self.seat.as_deref() {
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

    /// Insertion sort: from tick to tick, hardly anything moves.
    fn sort(&mut self) {
        let key = |index: u32| {
            let car = &self.cars[index as usize];
            (car.lane, car.at.s_m)
        };
        for end in 1..self.order.len() {
            let moved = self.order[end];
            let moved_key = key(moved);
            let mut place = end;
            while place > 0 && key(self.order[place - 1]) > moved_key {
                self.order[place] = self.order[place - 1];
                place -= 1;
            }
            self.order[place] = moved;
        }
    }

    /// Visits the cars within `reach_m` along the road, by lane.
    fn neighbours<'a>(&'a self, reach_m: f64, mut visit: impl FnMut(&'a CarState)) {
        let (low, high) = (self.ego.at.s_m - reach_m, self.ego.at.s_m + reach_m);
        for lane in 0..self.course.road.lanes().len() {
            let start = self.order.partition_point(|&index| {
                let car = &self.cars[index as usize];
                (car.lane, car.at.s_m) < (lane, low)
            });
            for &index in &self.order[start..] {
                let car = &self.cars[index as usize];
                if car.lane != lane || car.at.s_m > high {
                    break;
                }
                if car.present {
                    visit(car);
                }
            }
        }
    }

    /// Fills `self.observation`.
    fn sense(&mut self) {
        let mut out = std::mem::take(&mut self.observation);
        Lidar::clear(&mut out);
        let (sin, cos) = self.ego.pose.heading_rad.sin_cos();
        let (x, y) = (self.ego.pose.x_m, self.ego.pose.y_m);
        self.neighbours(NEIGHBOUR_M, |car| self.lidar.cast(x, y, cos, sin, car, &mut out));
        let (road, ego) = (&self.course.road, &self.ego);
        let lane_heading = road.lane_heading_rad(ego.lane, ego.at.s_m);
        let pi = std::f64::consts::PI;
        out.ego = [
            (wrap_angle(ego.pose.heading_rad - lane_heading) / pi) as f32,
            ego.speed_mps as f32 / EGO_SPEED_MPS,
            (ego.at.d_m - road.lane_offset_m(ego.lane, ego.at.s_m)) as f32 / EGO_LANE_M,
            (ego.at.d_m - road.center_m(ego.at.s_m)) as f32 / EGO_ROAD_M,
            ((road.lane_heading_rad(ego.lane, ego.at.s_m + EGO_AHEAD_M) - lane_heading) / pi) as f32,
        ];
        out.moving = self.moving;
        self.observation = out;
    }

    /// The reward's terms (the paper's appendix, "CARLA").
    fn score(&self, throttle: f64, steer: f64, lane_before: usize, touched: i32) -> Outcome {
        let weights = &self.scene.reward;
        let (road, ego) = (&self.course.road, &self.ego);
        let top = weights.top_speed_kmh / 3.6;
        let speed = if ego.speed_mps <= top { ego.speed_mps / top } else { top - ego.speed_mps };
        let half_lane = road.lane_width_m(ego.lane, ego.at.s_m) / 2.0;
        let off_centre = (ego.at.d_m - road.lane_offset_m(ego.lane, ego.at.s_m)).abs() / half_lane;
        let ahead = self.observation.nearest_m(0).min(self.observation.nearest_m(AZIMUTHS / 2));
        let around = self.observation.range.iter().copied().fold(1.0, f32::min) * LIDAR_RANGE_M;
        let mut proximity = 0.0;
        if f64::from(ahead) < weights.far_m {
            proximity -= weights.proximity_far;
        }
        if f64::from(around) < weights.near_m {
            proximity -= weights.proximity_near;
        }
        let (right, left) = road.edges_m(ego.at.s_m);
        let on_shoulder = ego.at.d_m < right || ego.at.d_m > left;
        let flag = |condition: bool, weight: f64| if condition { -weight as f32 } else { 0.0 };
        let mut outcome = Outcome {
            reward: 0.0,
            speed: speed as f32,
            brake: (-weights.brake * (-throttle).max(0.0)) as f32,
            steer: (-weights.steer * steer.abs()) as f32,
            change: flag(ego.lane != lane_before, weights.change),
            center: (-weights.center * off_centre) as f32,
            proximity: proximity as f32,
            road: flag(on_shoulder, weights.road),
            collision: flag(touched != NOTHING, weights.collision),
            collided: touched != NOTHING,
            end: self.end,
            other: touched,
        };
        outcome.reward = outcome.speed
            + outcome.brake
            + outcome.steer
            + outcome.change
            + outcome.center
            + outcome.proximity
            + outcome.road
            + outcome.collision;
        outcome
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

/// Kinematic bicycle: the centre's slip angle is β = atan(½ tan δ) with the centre midway between the axles, the heading
/// turns at v·sin β / (L/2), and tyres limit v² times that curvature.
pub(crate) fn drive(ego: &mut EgoCar, spec: &super::scene::Ego, throttle: f64, steer: f64, tick_s: f64) {
    let wanted = steer * spec.steer_deg.to_radians();
    let turn = spec.steer_rate_deg_s.to_radians() * tick_s;
    ego.wheel_rad += (wanted - ego.wheel_rad).clamp(-turn, turn);
    let push = if throttle >= 0.0 {
        let limited = ego.speed_mps >= spec.throttle_limit_kmh / 3.6;
        if limited { 0.0 } else { throttle * spec.acceleration_mps2 }
    } else {
        throttle * spec.brake_mps2
    };
    let drag = spec.drag_mps2 * ego.speed_mps / 10.0;
    ego.speed_mps = (ego.speed_mps + (push - drag) * tick_s).max(0.0);
    let slip = (0.5 * ego.wheel_rad.tan()).atan();
    let limit = spec.lateral_limit_mps2 / ego.speed_mps.powi(2).max(1e-3);
    let curvature = (slip.sin() / (spec.wheelbase_m / 2.0)).clamp(-limit, limit);
    let distance = ego.speed_mps * tick_s;
    let direction = ego.pose.heading_rad + slip + 0.5 * curvature * distance;
    ego.pose.x_m += distance * direction.cos();
    ego.pose.y_m += distance * direction.sin();
    ego.pose.heading_rad = wrap_angle(ego.pose.heading_rad + curvature * distance);
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
