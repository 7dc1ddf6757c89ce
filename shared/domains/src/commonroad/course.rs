//! A scenario as a [`Course`] for the highway world: road, recorded traffic, the ego car's start, goal and time.
//!
//! Every lane is a chain of lanelets through their successors; the road's reference line runs through the centres of
//! the lanelets ahead of and behind the ego car. Recorded cars exist within the time that they were recorded and react
//! to nothing. Static obstacles stand there all the time. Lanes of oncoming traffic are no part of the road.
//!
//! A round lasts as long as cars were recorded. It is refused where that is less than a second, or ends before the goal
//! opens: what follows would be an empty road that nobody recorded. Where no car moves, or there is none, nothing is
//! missing, and the round lasts until the goal's last time step (`start.rs`).

use super::error::CommonRoadError;
use super::lanes::{LaneletMap, edges};
use super::scenario::{Goal, Obstacle, Place, Scenario, Shape, State, wrap};
use crate::highway::road::{Pose, Road};
use crate::highway::traffic::{Course, Kind, Motion, Participant, RecordedPose, Recording};

/// The speed limit that a recording is given is at least the highway scene's own, 37 km/h.
const LEAST_SPEED_LIMIT_MPS: f64 = 37.0 / 3.6;
/// And at most what a scene file may say.
const MOST_SPEED_LIMIT_MPS: f64 = 300.0 / 3.6;
/// Head-room over the fastest recorded car, so that a person at the wheel can do what the recorded people did.
const SPEED_HEADROOM: f64 = 1.1;
/// Lanes of a map end within this of each other along the road, because it is cut at an angle.
const MAP_EDGE_M: f64 = 20.0;
/// No shoulders are mapped: the ego car has left the road when its centre is outside all lanes.
const SHOULDER_M: f64 = 0.0;

/// The goals of a planning problem, with lanelets turned into areas and times into seconds of the episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GoalRegion {
    goals: Vec<TimedGoal>,
}

#[derive(Clone, Debug, PartialEq)]
struct TimedGoal {
    from_s: f64,
    to_s: f64,
    areas: Vec<Shape>,
    speed_mps: Option<[f64; 2]>,
    heading_rad: Option<[f64; 2]>,
}

impl GoalRegion {
    /// Whether a car that is here now has arrived: in one of the places, within its time, speed and heading. A goal
    /// without a place is only a time limit and is never reached by driving.
    pub fn reached(&self, pose: &Pose, speed_mps: f64, time_s: f64) -> bool {
        const SLACK_S: f64 = 1e-6;
        self.goals.iter().any(|goal| {
            (goal.from_s - SLACK_S..=goal.to_s + SLACK_S).contains(&time_s)
                && goal
                    .speed_mps
                    .is_none_or(|[low, high]| (low..=high).contains(&speed_mps))
                && goal.heading_rad.is_none_or(|[from, to]| {
                    (pose.heading_rad - from).rem_euclid(std::f64::consts::TAU) <= to - from
                })
                && goal
                    .areas
                    .iter()
                    .any(|area| area.contains([pose.x_m, pose.y_m]))
        })
    }
}

impl Scenario {
    /// The course for the ego car of the first planning problem or, with `seat`, for the recorded car of that identity:
    /// then the road's reference line runs where that car drives. Times count from the planning problem's start.
    ///
    /// # Errors
    /// When there is no planning problem, no such car, no road, or nothing is recorded over time; when the ego car starts
    /// on no lane or in something that is not itself, or its way leads over a lanelet that was left out.
    pub fn course(&self, seat: Option<i32>) -> Result<Course, CommonRoadError> {
        let from_step = self
            .problems
            .first()
            .map_or(0, |problem| problem.start.step);
        let (start, pose) = match seat {
            None => {
                let start = self.problem()?.start;
                (
                    start,
                    Pose {
                        x_m: start.x_m,
                        y_m: start.y_m,
                        heading_rad: start.heading_rad,
                    },
                )
            }
            Some(id) => {
                let car = self.seat(id)?;
                (car.states[0], box_pose(car, &car.states[0]))
            }
        };
        let map = LaneletMap::new(self);
        let goals = if seat.is_none() {
            self.goal_lanelets(&map)?
        } else {
            Vec::new()
        };
        let under = map.under([pose.x_m, pose.y_m], pose.heading_rad);
        let route = map.route(under, &goals);
        let road = self.road(&map, &route)?;
        let start_s_m = road.project(pose.x_m, pose.y_m).s_m;
        let road = road.with_core_at(start_s_m);
        let mut own = None;
        let mut still_s = None;
        let last_step = match seat {
            None => {
                let problem = self.problem()?;
                self.check_start(&map, &road, problem)?;
                own = self.own_car(problem)?;
                let (last, is_still) = self.last_round_step(problem, own)?;
                still_s = is_still.then(|| f64::from(last - from_step) * self.step_s);
                last
            }
            Some(_) => self.last_step(),
        };
        self.check_route(&map, under, &route, &goals)?;
        if last_step <= from_step {
            return Err(
                self.lacks("no obstacle moves after the start, so there is nothing to replay")
            );
        }
        // Past the place where the first of the lanes that reach the map's edge ends, nothing is known.
        let length = road.length_m();
        let ends = road
            .lanes()
            .iter()
            .map(|lane| lane.to_m)
            .filter(|to_m| *to_m > length - MAP_EDGE_M);
        let edge_s_m = ends.fold(length, f64::min);
        if seat.is_none() && start_s_m >= edge_s_m {
            let said = format!(
                "the ego car starts at ({}, {}), where the map ends",
                pose.x_m, pose.y_m
            );
            return Err(self.refuses(&self.problem()?.mark, said));
        }
        let traffic: Vec<_> = self
            .obstacles
            .iter()
            .filter(|obstacle| Some(obstacle.id) != own)
            .filter_map(|obstacle| self.participant(obstacle, from_step, last_step))
            .collect();
        if let Some(id) = seat.filter(|id| traffic.iter().all(|car| car.id != *id)) {
            return Err(self.lacks(format!(
                "car {id} is gone before the planning problem starts"
            )));
        }
        Ok(Course {
            goal_s_m: if seat.is_none() {
                edge_s_m
            } else {
                f64::INFINITY
            },
            goal: if seat.is_none() {
                self.goal_region(from_step)?
            } else {
                GoalRegion::default()
            },
            traffic,
            road,
            start: pose,
            start_speed_mps: start.speed_mps.max(0.0),
            duration_s: f64::from(last_step - from_step) * self.step_s,
            notes: self.notes(own, still_s),
        })
    }

    /// The road around a route: its centre as reference line, and a lane for every chain of lanelets beside it.
    fn road(&self, map: &LaneletMap, route: &[usize]) -> Result<Road, CommonRoadError> {
        let reference = map.line(route);
        let mut sorted = route.to_vec();
        sorted.sort_unstable();
        let build = |members: &[usize]| {
            let lanes: Vec<_> = map
                .chains(members)
                .iter()
                .map(|chain| edges(self, chain))
                .collect();
            Road::from_polylines(&reference, &lanes, SHOULDER_M, SHOULDER_M)
                .map_err(|error| self.lacks(format!("its lanelets make no road: {error}")))
        };
        let draft = build(&sorted)?;
        let heading_at = |[x, y]: [f64; 2]| draft.heading_rad(draft.project(x, y).s_m);
        build(&map.carriageway(route, heading_at))
    }

    /// The recorded cars that can be the driver's seat: moving, with at least three recorded instants.
    pub fn seats(&self) -> Vec<i32> {
        self.obstacles
            .iter()
            .filter(|o| o.moving && o.states.len() >= 3)
            .map(|o| o.id)
            .collect()
    }

    /// The obstacle whose seat is asked for.
    ///
    /// # Errors
    /// When there is no such obstacle, or it does not move, with the identities that can be chosen.
    pub fn seat(&self, id: i32) -> Result<&Obstacle, CommonRoadError> {
        self.obstacle(id)
            .filter(|o| o.moving && o.states.len() >= 3)
            .ok_or_else(|| {
                let ids: Vec<String> = self.seats().iter().map(i32::to_string).collect();
                self.lacks(format!(
                    "no recorded car {id} to drive as; there are {}",
                    ids.join(", ")
                ))
            })
    }

    /// The speed above which the ego car's throttle does nothing: the highest of 37 km/h, the lanelets' speed limits,
    /// the planned start and 1.1 times the fastest recorded car; at most 300 km/h, as in scene files.
    pub fn speed_limit_mps(&self) -> f64 {
        let recorded = self
            .obstacles
            .iter()
            .flat_map(|o| &o.states)
            .map(|s| s.speed_mps * SPEED_HEADROOM);
        let signed = self
            .lanelets
            .iter()
            .filter_map(|lanelet| lanelet.speed_limit_mps);
        let planned = self.problems.iter().map(|problem| problem.start.speed_mps);
        recorded
            .chain(signed)
            .chain(planned)
            .fold(LEAST_SPEED_LIMIT_MPS, f64::max)
            .min(MOST_SPEED_LIMIT_MPS)
    }

    /// A moving obstacle's poses at every recorded step from `from_step` on; `None` where it was gone by then. Gaps in
    /// the record are filled linearly.
    pub fn recording(&self, obstacle: &Obstacle, from_step: u32) -> Option<Recording> {
        let mut poses: Vec<RecordedPose> = Vec::new();
        let mut first = None;
        for (index, state) in obstacle.states.iter().enumerate() {
            let next = obstacle.states.get(index + 1);
            let until = next.map_or(state.step + 1, |next| next.step);
            for step in state.step..until {
                if step < from_step {
                    continue;
                }
                let t = next.map_or(0.0, |n| {
                    f64::from(step - state.step) / f64::from(n.step - state.step)
                });
                let now = next.map_or(*state, |next| between(state, next, t));
                first.get_or_insert(step);
                poses.push(RecordedPose {
                    pose: box_pose(obstacle, &now),
                    speed_mps: now.speed_mps.abs(),
                });
            }
        }
        Some(Recording {
            start_s: f64::from(first? - from_step) * self.step_s,
            period_s: self.step_s,
            poses,
        })
    }

    fn participant(
        &self,
        obstacle: &Obstacle,
        from_step: u32,
        last_step: u32,
    ) -> Option<Participant> {
        let outline = obstacle.shape.local_box();
        let recording = if obstacle.moving {
            self.recording(obstacle, from_step)?
        } else {
            let still = RecordedPose {
                pose: box_pose(obstacle, &obstacle.states[0]),
                speed_mps: 0.0,
            };
            let period_s = f64::from(last_step.max(1)) * self.step_s + 1e6;
            Recording {
                start_s: 0.0,
                period_s,
                poses: vec![still; 2],
            }
        };
        Some(Participant {
            id: obstacle.id,
            length_m: outline.length_m,
            width_m: outline.width_m,
            kind: match obstacle.kind.as_str() {
                "car" | "parkedVehicle" | "taxi" | "priorityVehicle" => Kind::Car,
                _ => Kind::Other,
            },
            motion: Motion::Recorded(recording),
        })
    }

    /// The lanelets that a goal lies on.
    fn goal_lanelets(&self, map: &LaneletMap) -> Result<Vec<usize>, CommonRoadError> {
        let places = self
            .problem()?
            .goals
            .iter()
            .flat_map(|goal| goal.places.iter().flatten());
        let (mut found, mut bad) = (Vec::new(), None);
        for place in places {
            match place {
                Place::Lanelet(id) => {
                    bad = bad.or(self.bad_lanelet(*id));
                    found.extend(self.lanelet_index(*id));
                }
                Place::Area(shape) => {
                    let middle = shape.middle();
                    let all = 0..self.lanelets.len();
                    found.extend(all.filter(|index| map.contains(*index, middle)));
                }
            }
        }
        match bad.filter(|_| found.is_empty()) {
            None => Ok(found),
            Some(bad) => {
                let said = format!("{}; lanelet {} is the ego car's goal", bad.problem, bad.id);
                Err(self.refuses(&bad.mark, said))
            }
        }
    }

    fn goal_region(&self, from_step: u32) -> Result<GoalRegion, CommonRoadError> {
        let seconds = |step: u32| (f64::from(step) - f64::from(from_step)) * self.step_s;
        let timed = |goal: &Goal| TimedGoal {
            from_s: seconds(goal.steps[0]),
            to_s: seconds(goal.steps[1]),
            areas: goal
                .places
                .iter()
                .flatten()
                .filter_map(|place| match place {
                    Place::Area(shape) => Some(shape.clone()),
                    Place::Lanelet(id) => self.lanelet(*id).map(|lanelet| {
                        Shape::Polygon(
                            lanelet
                                .left
                                .iter()
                                .chain(lanelet.right.iter().rev())
                                .copied()
                                .collect(),
                        )
                    }),
                })
                .collect(),
            speed_mps: goal.speed_mps,
            heading_rad: goal.heading_rad,
        };
        Ok(GoalRegion {
            goals: self.problem()?.goals.iter().map(timed).collect(),
        })
    }
}

/// Where an obstacle's box is when the obstacle is in `state`.
pub fn box_pose(obstacle: &Obstacle, state: &State) -> Pose {
    let outline = obstacle.shape.local_box();
    let (sin, cos) = state.heading_rad.sin_cos();
    let [x, y] = outline.center;
    Pose {
        x_m: state.x_m + x * cos - y * sin,
        y_m: state.y_m + x * sin + y * cos,
        heading_rad: wrap(state.heading_rad + outline.turn_rad),
    }
}

/// A fraction `t` of the way from one state to another; the heading goes the short way.
pub fn between(a: &State, b: &State, t: f64) -> State {
    State {
        step: a.step,
        x_m: a.x_m + t * (b.x_m - a.x_m),
        y_m: a.y_m + t * (b.y_m - a.y_m),
        heading_rad: wrap(a.heading_rad + t * wrap(b.heading_rad - a.heading_rad)),
        speed_mps: a.speed_mps + t * (b.speed_mps - a.speed_mps),
    }
}
