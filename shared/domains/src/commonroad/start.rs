//! Whether a planning problem can be driven: where its ego car starts, what stands there, and how long its round lasts.

use super::course::box_pose;
use super::error::CommonRoadError;
use super::lanes::LaneletMap;
use super::scenario::{BadLanelet, Obstacle, PlanningProblem, Scenario, State, wrap};
use crate::highway::geometry::OrientedBox;
use crate::highway::road::Road;
use crate::highway::{Scene, road::Pose};
use std::collections::{BTreeSet, VecDeque};

/// A start so near to a lanelet is on it: lanelets meet with gaps of centimetres.
const SEAM_M: f64 = 0.1;
/// A shorter round shows nobody's driving.
const SHORTEST_ROUND_S: f64 = 1.0;
/// A recorded car that stands within this of the planning problem's start, …
const SAME_PLACE_M: f64 = 0.5;
/// … heads the same way within this, …
const SAME_HEADING_RAD: f64 = 0.1;
/// … and drives as fast within this, is the ego car itself: it is recorded twice.
const SAME_SPEED_MPS: f64 = 0.5;

impl Scenario {
    /// Refuses a start that is on no lane: the round would end with its first step.
    pub(super) fn check_start(
        &self,
        map: &LaneletMap,
        road: &Road,
        problem: &PlanningProblem,
    ) -> Result<(), CommonRoadError> {
        let State { x_m, y_m, .. } = problem.start;
        let on_lanelet = (0..self.lanelets.len()).any(|index| map.near(index, [x_m, y_m], SEAM_M));
        if on_lanelet && road.on_lane(road.project(x_m, y_m)) {
            return Ok(());
        }
        let mut said = format!("the ego car starts at ({x_m}, {y_m}), which is on no lane");
        for lanelet in &self.bad_lanelets {
            said += &format!("; left out: {}", lanelet.words());
        }
        Err(self.refuses(&problem.mark, said))
    }

    /// Refuses a route that leads over a lanelet which was left out: to one of `goals`, where there is no other way, or on
    /// from the route's last lanelet, where nothing else follows.
    pub(super) fn check_route(
        &self,
        map: &LaneletMap,
        start: usize,
        route: &[usize],
        goals: &[usize],
    ) -> Result<(), CommonRoadError> {
        let needs = |bad: &BadLanelet| {
            let problem = format!(
                "{}; the ego car's way leads over lanelet {}",
                bad.problem, bad.id
            );
            Err(self.refuses(&bad.mark, problem))
        };
        if let Some(last) = route
            .last()
            .filter(|last| map.successors(**last).is_empty())
        {
            let id = self.lanelets[*last].id;
            let mut following = self.bad_lanelets.iter();
            if let Some(bad) = following.find(|bad| bad.predecessors.contains(&id)) {
                return needs(bad);
            }
        }
        if goals.is_empty() || goals.iter().any(|goal| route.contains(goal)) {
            return Ok(());
        }
        let goals: Vec<i64> = goals.iter().map(|goal| self.lanelets[*goal].id).collect();
        // Breadth first over all lanelets: the bad ones on the way to each.
        let mut queue = VecDeque::from([(self.lanelets[start].id, None)]);
        let mut seen = BTreeSet::from([self.lanelets[start].id]);
        while let Some((id, first_bad)) = queue.pop_front() {
            let first_bad = first_bad.or(self.bad_lanelet(id));
            if let Some(bad) = first_bad.filter(|_| goals.contains(&id)) {
                return needs(bad);
            }
            let good = self.lanelet_index(id).into_iter();
            let onward = good
                .flat_map(|index| map.successors(index))
                .map(|next| self.lanelets[*next].id);
            let into_bad = self
                .bad_lanelets
                .iter()
                .filter(|bad| bad.predecessors.contains(&id));
            let from_bad = self
                .bad_lanelet(id)
                .into_iter()
                .flat_map(|bad| &bad.successors);
            for next in onward
                .chain(into_bad.map(|bad| bad.id))
                .chain(from_bad.copied())
            {
                if seen.insert(next) {
                    queue.push_back((next, first_bad));
                }
            }
        }
        Ok(())
    }

    /// The recorded car that is the ego car itself, if there is one.
    ///
    /// # Errors
    /// When anything else stands where the ego car starts.
    pub(super) fn own_car(
        &self,
        problem: &PlanningProblem,
    ) -> Result<Option<i32>, CommonRoadError> {
        let (start, spec) = (problem.start, Scene::default().ego);
        let here = Pose {
            x_m: start.x_m,
            y_m: start.y_m,
            heading_rad: start.heading_rad,
        };
        let ego = oriented(here, spec.length_m, spec.width_m);
        let mut own = None;
        for obstacle in &self.obstacles {
            let Some(state) = self.state_at(obstacle, start.step) else {
                continue;
            };
            let outline = obstacle.shape.local_box();
            let pose = box_pose(obstacle, &state);
            if !ego.overlaps(&oriented(pose, outline.length_m, outline.width_m)) {
                continue;
            }
            if obstacle.moving && own.is_none() && is_same(&state, &start) {
                own = Some(obstacle.id);
                continue;
            }
            let said = format!(
                "{} {} stands at ({}, {}), where the ego car starts (line {})",
                obstacle.kind, obstacle.id, state.x_m, state.y_m, problem.mark.line
            );
            return Err(self.refuses(&obstacle.mark, said));
        }
        Ok(own)
    }

    /// The state of an obstacle at a time step; nothing where it is not there.
    fn state_at(&self, obstacle: &Obstacle, step: u32) -> Option<State> {
        if !obstacle.moving {
            return obstacle.states.first().copied();
        }
        let after = obstacle.states.partition_point(|s| s.step < step);
        let next = obstacle.states.get(after)?;
        if next.step == step {
            return Some(*next);
        }
        let before = obstacle.states.get(after.checked_sub(1)?)?;
        let t = f64::from(step - before.step) / f64::from(next.step - before.step);
        Some(super::between(before, next, t))
    }

    /// The last time step of the round, and whether that is the goal's for want of moving traffic. `own` does not count.
    ///
    /// # Errors
    /// When the recording ends before the goal opens, or the round would last less than a second.
    pub(super) fn last_round_step(
        &self,
        problem: &PlanningProblem,
        own: Option<i32>,
    ) -> Result<(u32, bool), CommonRoadError> {
        let from = problem.start.step;
        let seconds = |step: u32| f64::from(step.saturating_sub(from)) * self.step_s;
        let goals = || problem.goals.iter().map(|goal| goal.steps);
        let opens = goals().map(|[first, _]| first).min().unwrap_or(from);
        let closes = goals().map(|[_, last]| last).max().unwrap_or(from);
        let recorded = self
            .obstacles
            .iter()
            .filter(|o| o.moving && Some(o.id) != own)
            .filter_map(|o| o.states.last())
            .map(|state| state.step)
            .max();
        let refused = |said: String| Err(self.refuses(&problem.mark, said));
        let Some(last) = recorded else {
            if seconds(closes) < SHORTEST_ROUND_S {
                let said = format!(
                    "no car moves, and the goal closes {:.1} s after the start: less than {SHORTEST_ROUND_S:.1} s is no round",
                    seconds(closes)
                );
                return refused(said);
            }
            return Ok((closes, true));
        };
        if last <= from {
            return refused(format!(
                "0.0 s is recorded after the start at time step {from}, and the goal opens at {:.1} s: there is nothing to replay",
                seconds(opens)
            ));
        }
        if last < opens {
            return refused(format!(
                "{:.1} s is recorded after the start, and the goal opens at {:.1} s: there is nothing to replay between",
                seconds(last),
                seconds(opens)
            ));
        }
        // Not by the seconds' last bit.
        if seconds(last) < SHORTEST_ROUND_S - 1e-9 {
            return refused(format!(
                "{:.1} s is recorded after the start: less than {SHORTEST_ROUND_S:.1} s is no round",
                seconds(last)
            ));
        }
        Ok((last, false))
    }

    /// What a drive of this scenario passes over, for people: which of several planning problems it is, how long the round
    /// lasts where nothing moves, and what the file holds that has no part in it.
    pub(super) fn notes(&self, own: Option<i32>, still_s: Option<f64>) -> Vec<String> {
        let mut notes = Vec::new();
        if self.problems.len() > 1 {
            notes.push(format!("problem 1 of {}", self.problems.len()));
        }
        let own = own.map(|id| format!("car {id}, the recorded ego car itself"));
        let left_out: Vec<String> = self.left_out.iter().cloned().chain(own).collect();
        if !left_out.is_empty() {
            notes.push(format!("left out: {}", left_out.join(", ")));
        }
        if let Some(seconds) = still_s {
            notes.push(format!(
                "no car moves: the round lasts until the goal's last time step, {seconds:.1} s"
            ));
        }
        notes
    }
}

fn is_same(car: &State, start: &State) -> bool {
    (car.x_m - start.x_m).hypot(car.y_m - start.y_m) <= SAME_PLACE_M
        && wrap(car.heading_rad - start.heading_rad).abs() <= SAME_HEADING_RAD
        && (car.speed_mps - start.speed_mps).abs() <= SAME_SPEED_MPS
}

fn oriented(pose: Pose, length_m: f64, width_m: f64) -> OrientedBox {
    let (sin, cos) = pose.heading_rad.sin_cos();
    OrientedBox {
        x_m: pose.x_m,
        y_m: pose.y_m,
        cos,
        sin,
        half_length_m: length_m / 2.0,
        half_width_m: width_m / 2.0,
    }
}
