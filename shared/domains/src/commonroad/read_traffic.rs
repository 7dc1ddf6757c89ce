//! Reads what is on the road: obstacles with their shapes and recorded states, planning problems with their goals.

use super::error::CommonRoadError;
use super::scenario::{Goal, Obstacle, Place, PlanningProblem, Shape, State, wrap};
use super::xml::{Element, Source, children};

/// No vehicle or area in a scenario is larger, in m.
const LARGEST_SIZE_M: f64 = 10_000.0;
/// No car is faster, in m/s.
const LARGEST_SPEED_MPS: f64 = 200.0;
/// Longest gap in an obstacle's record that is bridged.
const LONGEST_GAP_STEPS: u32 = 1000;
/// Shapes in shapes in shapes.
const DEEPEST_GROUP: usize = 8;

impl<'a> Source<'a> {
    /// `obstacle`, `staticObstacle` or `dynamicObstacle`. Adds the states that stand there twice to `repeated`.
    pub fn obstacle(
        &self,
        element: Element<'a>,
        moving: bool,
        step_s: f64,
        repeated: &mut usize,
    ) -> Result<Obstacle, CommonRoadError> {
        for name in ["occupancySet", "probabilityDistribution", "movementHistory"] {
            if let Some(prediction) = children(element, name).next() {
                let problem = "is not a recorded trajectory, so there is nothing to replay";
                return Err(self.error(prediction, problem));
            }
        }
        let trajectory = self.optional_child(element, "trajectory")?;
        if let (false, Some(trajectory)) = (moving, trajectory) {
            return Err(self.error(trajectory, "belongs to a static obstacle"));
        }
        let mut states: Vec<State> = Vec::new();
        let mut speeds: Vec<Option<f64>> = Vec::new();
        let recorded = trajectory.into_iter().flat_map(|t| children(t, "state"));
        for state in std::iter::once(self.child(element, "initialState")?).chain(recorded) {
            let (state_read, speed) = self.state(state)?;
            let step = state_read.step;
            if let Ok(index) = states.binary_search_by_key(&step, |known| known.step) {
                // Editors and simulators repeat the initial state as the trajectory's first.
                if !is_repetition((&states[index], speeds[index]), (&state_read, speed)) {
                    let problem = format!("contradicts an earlier state at time step {step}");
                    return Err(self.error(state, problem));
                }
                states[index].speed_mps = speeds[index].or(speed).unwrap_or(0.0);
                speeds[index] = speeds[index].or(speed);
                *repeated += 1;
                continue;
            }
            if let Some(last) = states.last()
                && !(1..=LONGEST_GAP_STEPS).contains(&step.saturating_sub(last.step))
            {
                let before = last.step;
                let problem = format!(
                    "time step {step} does not follow {before} within {LONGEST_GAP_STEPS} steps"
                );
                return Err(self.error(state, problem));
            }
            states.push(state_read);
            speeds.push(speed);
        }
        fill_speeds(&mut states, &speeds, step_s);
        let kind = self.text(self.child(element, "type")?)?.to_owned();
        Ok(Obstacle {
            id: self.identity(element, "id")? as i32,
            kind,
            moving,
            shape: self.shape(self.child(element, "shape")?, 0)?,
            states,
            mark: self.mark(element),
        })
    }

    /// A state, and its speed where it has one.
    fn state(&self, element: Element<'a>) -> Result<(State, Option<f64>), CommonRoadError> {
        let position = self.child(element, "position")?;
        let [x_m, y_m] = match self.optional_child(position, "point")? {
            Some(point) => self.point(point)?,
            None => self.shape(position, 0)?.middle(),
        };
        let time = self.child(element, "time")?;
        let [step, last] = self.steps(time)?;
        if step != last {
            return Err(self.error(
                time,
                "is an interval, so there is no instant to replay the state at",
            ));
        }
        let speed = match self.optional_child(element, "velocity")? {
            Some(velocity) => {
                let [low, high] = self.interval(velocity)?;
                let value = (low + high) / 2.0;
                if value.abs() > LARGEST_SPEED_MPS {
                    return Err(self.error(velocity, format!("{value} m/s is out of range")));
                }
                Some(value)
            }
            None => None,
        };
        let heading = self.interval(self.child(element, "orientation")?)?;
        let state = State {
            step,
            x_m,
            y_m,
            heading_rad: wrap((heading[0] + heading[1]) / 2.0),
            speed_mps: speed.unwrap_or(0.0),
        };
        Ok((state, speed))
    }

    /// The shapes in `parent`, which is a `shape`, a `position` or a group.
    fn shape(&self, parent: Element<'a>, depth: usize) -> Result<Shape, CommonRoadError> {
        if depth > DEEPEST_GROUP {
            return Err(self.error(
                parent,
                format!("groups are nested deeper than {DEEPEST_GROUP}"),
            ));
        }
        let mut shapes = Vec::new();
        for element in parent.children().filter(|node| node.is_element()) {
            shapes.push(match element.tag_name().name() {
                "rectangle" => {
                    if let Some(shift) = self.optional_child(element, "originXShift")?
                        && self.number(shift)? != 0.0
                    {
                        return Err(self.error(shift, "a shifted origin is not supported"));
                    }
                    Shape::Rectangle {
                        length_m: self.size_in(element, "length", LARGEST_SIZE_M)?,
                        width_m: self.size_in(element, "width", LARGEST_SIZE_M)?,
                        orientation_rad: match self.optional_child(element, "orientation")? {
                            Some(orientation) => wrap(self.number(orientation)?),
                            None => 0.0,
                        },
                        center: self.center(element)?,
                    }
                }
                "circle" => Shape::Circle {
                    radius_m: self.size_in(element, "radius", LARGEST_SIZE_M)?,
                    center: self.center(element)?,
                },
                "polygon" => {
                    let corners = children(element, "point")
                        .map(|point| self.point(point))
                        .collect::<Result<Vec<_>, _>>()?;
                    // Twice the area, by the shoelace formula.
                    let area: f64 = (0..corners.len())
                        .map(|i| {
                            let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                            a[0] * b[1] - b[0] * a[1]
                        })
                        .sum();
                    if corners.len() < 3 || area == 0.0 {
                        return Err(self.error(element, "has no area"));
                    }
                    Shape::Polygon(corners)
                }
                "shapeGroup" | "absoluteShapeGroup" | "shape" => self.shape(element, depth + 1)?,
                _ => return Err(self.error(element, "is not a shape that is read")),
            });
        }
        match (shapes.pop(), shapes.is_empty()) {
            (None, _) => Err(self.error(parent, "has no shape in it")),
            (Some(only), true) => Ok(only),
            (Some(last), false) => {
                shapes.push(last);
                Ok(Shape::Group(shapes))
            }
        }
    }

    fn center(&self, shape: Element<'a>) -> Result<[f64; 2], CommonRoadError> {
        match self.optional_child(shape, "center")? {
            Some(center) => self.point(center),
            None => Ok([0.0, 0.0]),
        }
    }

    /// `planningProblem`.
    pub fn planning_problem(
        &self,
        element: Element<'a>,
    ) -> Result<PlanningProblem, CommonRoadError> {
        let start = self.child(element, "initialState")?;
        let (state, speed) = self.state(start)?;
        if speed.is_none() {
            return Err(self.error(start, "<velocity> is missing"));
        }
        let goals = children(element, "goalState")
            .map(|goal| self.goal(goal))
            .collect::<Result<Vec<_>, _>>()?;
        if goals.is_empty() {
            return Err(self.error(element, "<goalState> is missing"));
        }
        Ok(PlanningProblem {
            id: self.identity(element, "id")?,
            start: state,
            goals,
            mark: self.mark(start),
        })
    }

    fn goal(&self, element: Element<'a>) -> Result<Goal, CommonRoadError> {
        let interval = |name| match self.optional_child(element, name)? {
            Some(child) => self.interval(child).map(Some),
            None => Ok(None),
        };
        let places = match self.optional_child(element, "position")? {
            None => None,
            Some(position) => {
                let mut places = Vec::new();
                for link in children(position, "lanelet") {
                    places.push(Place::Lanelet(self.identity(link, "ref")?));
                }
                if places.is_empty() {
                    if let Some(point) = children(position, "point").next() {
                        return Err(self.error(point, "a single point cannot be driven into"));
                    }
                    places.push(Place::Area(self.shape(position, 0)?));
                }
                Some(places)
            }
        };
        Ok(Goal {
            steps: self.steps(self.child(element, "time")?)?,
            places,
            speed_mps: interval("velocity")?,
            heading_rad: interval("orientation")?,
        })
    }
}

/// Whether a state says nothing that another of the same time step contradicts: equal but for the digits that programs write
/// (1 mm, 1 mrad, 1 mm/s). A speed that one of them does not state contradicts none.
fn is_repetition(known: (&State, Option<f64>), new: (&State, Option<f64>)) -> bool {
    const SAME: f64 = 1e-3;
    let ((known, known_speed), (new, new_speed)) = (known, new);
    (known.x_m - new.x_m).abs() <= SAME
        && (known.y_m - new.y_m).abs() <= SAME
        && wrap(known.heading_rad - new.heading_rad).abs() <= SAME
        && known_speed
            .zip(new_speed)
            .is_none_or(|(known, new)| (known - new).abs() <= SAME)
}

/// Speeds that the file does not state, from the way to the next state (for the last: from the one before).
fn fill_speeds(states: &mut [State], stated: &[Option<f64>], step_s: f64) {
    for index in 0..states.len() {
        if stated[index].is_some() {
            continue;
        }
        let next = (index + 1).min(states.len() - 1);
        let previous = if next == index {
            index.saturating_sub(1)
        } else {
            index
        };
        let (a, b) = (states[previous], states[next]);
        if b.step > a.step {
            let time_s = f64::from(b.step - a.step) * step_s;
            let along =
                (b.x_m - a.x_m) * a.heading_rad.cos() + (b.y_m - a.y_m) * a.heading_rad.sin();
            states[index].speed_mps = (along / time_s).clamp(-LARGEST_SPEED_MPS, LARGEST_SPEED_MPS);
        }
    }
}
