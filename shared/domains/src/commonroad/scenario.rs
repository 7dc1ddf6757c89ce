//! A CommonRoad scenario as read: lanelets, obstacles with their recorded states, planning problems. SI units and
//! radians throughout; positions in the file's own frame.

use super::error::CommonRoadError;

/// A scenario: a piece of road, what was recorded on it, and a start and goal for the ego car.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// The file that it was read from, for messages.
    pub file: String,
    /// The file's `benchmarkID`; empty where it has none.
    pub benchmark_id: String,
    /// The format version, such as `2020a`.
    pub version: String,
    /// Seconds between recorded instants.
    pub step_s: f64,
    /// By ascending identity.
    pub lanelets: Vec<Lanelet>,
    /// By ascending identity.
    pub obstacles: Vec<Obstacle>,
    /// In the file's order.
    pub problems: Vec<PlanningProblem>,
    /// Lanelets that make no lane, by ascending identity; a route that needs one is refused.
    pub bad_lanelets: Vec<BadLanelet>,
    /// What was left out, in words: traffic lights and signs, buildings, links to lanelets that the file lacks, lanelets
    /// that make no lane, states that stand twice.
    pub left_out: Vec<String>,
}

/// Where something stands in the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// Line, from 1.
    pub line: usize,
    /// The element's name.
    pub element: String,
}

impl Scenario {
    /// The lanelet with this identity.
    pub fn lanelet(&self, id: i64) -> Option<&Lanelet> {
        self.lanelet_index(id).map(|index| &self.lanelets[index])
    }

    /// Place of the lanelet with this identity in [`Scenario::lanelets`].
    pub fn lanelet_index(&self, id: i64) -> Option<usize> {
        self.lanelets.binary_search_by_key(&id, |l| l.id).ok()
    }

    /// The obstacle with this identity.
    pub fn obstacle(&self, id: i32) -> Option<&Obstacle> {
        let index = self.obstacles.binary_search_by_key(&id, |o| o.id).ok()?;
        Some(&self.obstacles[index])
    }

    /// The planning problem that the ego car drives: the file's first.
    pub fn problem(&self) -> Result<&PlanningProblem, CommonRoadError> {
        self.problems
            .first()
            .ok_or_else(|| self.lacks("no <planningProblem>, so nowhere for the ego car to start"))
    }

    /// The last recorded time step of any moving obstacle, in steps.
    pub fn last_step(&self) -> u32 {
        self.obstacles
            .iter()
            .filter(|o| o.moving)
            .filter_map(|o| o.states.last())
            .map(|s| s.step)
            .max()
            .unwrap_or(0)
    }

    /// The lanelet with this identity among those that make no lane.
    pub fn bad_lanelet(&self, id: i64) -> Option<&BadLanelet> {
        let index = self.bad_lanelets.binary_search_by_key(&id, |l| l.id).ok()?;
        Some(&self.bad_lanelets[index])
    }

    /// An error at an element.
    pub(crate) fn refuses(&self, mark: &Mark, problem: impl Into<String>) -> CommonRoadError {
        CommonRoadError::Element {
            file: self.file.clone(),
            line: mark.line,
            element: mark.element.clone(),
            problem: problem.into(),
        }
    }

    pub(crate) fn lacks(&self, problem: impl Into<String>) -> CommonRoadError {
        CommonRoadError::Scenario {
            file: self.file.clone(),
            problem: problem.into(),
        }
    }
}

/// A piece of lane between two polylines; traffic runs from their first points to their last.
#[derive(Clone, Debug, PartialEq)]
pub struct Lanelet {
    /// Identity, unique among lanelets and obstacles.
    pub id: i64,
    /// Left bound, x and y in m; neighbouring points differ.
    pub left: Vec<[f64; 2]>,
    /// Right bound, likewise.
    pub right: Vec<[f64; 2]>,
    /// Lanelets that lead into this one. May contain cycles over several lanelets, as roundabouts do.
    pub predecessors: Vec<i64>,
    /// Lanelets that this one leads into.
    pub successors: Vec<i64>,
    /// The lanelet beside it on the left.
    pub left_neighbour: Option<Adjacent>,
    /// The lanelet beside it on the right.
    pub right_neighbour: Option<Adjacent>,
    /// `laneletType`s, such as `mainCarriageWay`; empty in 2018 files.
    pub kinds: Vec<String>,
    /// `speedLimit` of 2018 files, in m/s.
    pub speed_limit_mps: Option<f64>,
}

/// A lanelet that makes no lane: one of its bounds has no length.
#[derive(Clone, Debug, PartialEq)]
pub struct BadLanelet {
    /// Identity.
    pub id: i64,
    /// The element that is to blame.
    pub mark: Mark,
    /// What is wrong with it.
    pub problem: String,
    /// Lanelets that lead into it.
    pub predecessors: Vec<i64>,
    /// Lanelets that it leads into.
    pub successors: Vec<i64>,
}

impl BadLanelet {
    /// Which lanelet, and what is wrong with it.
    pub fn words(&self) -> String {
        let Mark { line, element } = &self.mark;
        format!(
            "lanelet {} (line {line}: <{element}>: {})",
            self.id, self.problem
        )
    }
}

/// A lanelet beside another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Adjacent {
    /// The neighbour.
    pub id: i64,
    /// Whether traffic on it runs the same way.
    pub same_direction: bool,
}

/// Something on the road.
#[derive(Clone, Debug, PartialEq)]
pub struct Obstacle {
    /// Identity, unique among lanelets and obstacles.
    pub id: i32,
    /// `type`: `car`, `truck`, `parkedVehicle`, …
    pub kind: String,
    /// Dynamic (recorded, exists within its states' times) or static (always there, at its one state).
    pub moving: bool,
    /// Its outline around its position.
    pub shape: Shape,
    /// At least one; times rise strictly.
    pub states: Vec<State>,
    /// Its element.
    pub mark: Mark,
}

/// An outline in the frame of what it belongs to: x along the heading, y to the left.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A box.
    Rectangle {
        /// Along its own x axis, m.
        length_m: f64,
        /// Across it, m.
        width_m: f64,
        /// Turned by this.
        orientation_rad: f64,
        /// Its middle.
        center: [f64; 2],
    },
    /// A disc.
    Circle {
        /// Radius, m.
        radius_m: f64,
        /// Its middle.
        center: [f64; 2],
    },
    /// Corners of a closed line.
    Polygon(Vec<[f64; 2]>),
    /// Several outlines together.
    Group(Vec<Shape>),
}

/// A box around a shape, in the frame of the obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalBox {
    /// Along its own x axis, m.
    pub length_m: f64,
    /// Across it, m.
    pub width_m: f64,
    /// Turned by this against the obstacle's heading.
    pub turn_rad: f64,
    /// Its middle.
    pub center: [f64; 2],
}

impl Shape {
    /// The box that stands for the shape in collisions and LIDAR: a rectangle is itself; a circle becomes the square
    /// around it; polygons and groups become the smallest box along the obstacle's axes.
    pub fn local_box(&self) -> LocalBox {
        if let Shape::Rectangle {
            length_m,
            width_m,
            orientation_rad,
            center,
        } = *self
        {
            return LocalBox {
                length_m,
                width_m,
                turn_rad: orientation_rad,
                center,
            };
        }
        let (low, high) = self.extent();
        LocalBox {
            length_m: high[0] - low[0],
            width_m: high[1] - low[1],
            turn_rad: 0.0,
            center: [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0],
        }
    }

    /// The middle of the shape's extent.
    pub fn middle(&self) -> [f64; 2] {
        match self {
            Shape::Rectangle { center, .. } | Shape::Circle { center, .. } => *center,
            _ => {
                let (low, high) = self.extent();
                [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0]
            }
        }
    }

    /// Whether a point lies inside or on the outline.
    pub fn contains(&self, point: [f64; 2]) -> bool {
        match self {
            Shape::Rectangle {
                length_m,
                width_m,
                orientation_rad,
                center,
            } => {
                let (sin, cos) = orientation_rad.sin_cos();
                let d = [point[0] - center[0], point[1] - center[1]];
                (d[0] * cos + d[1] * sin).abs() <= length_m / 2.0
                    && (d[1] * cos - d[0] * sin).abs() <= width_m / 2.0
            }
            Shape::Circle { radius_m, center } => {
                (point[0] - center[0]).hypot(point[1] - center[1]) <= *radius_m
            }
            Shape::Polygon(corners) => inside(corners, point),
            Shape::Group(shapes) => shapes.iter().any(|shape| shape.contains(point)),
        }
    }

    fn extent(&self) -> ([f64; 2], [f64; 2]) {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        self.each_corner(&mut |corner| {
            for axis in 0..2 {
                low[axis] = low[axis].min(corner[axis]);
                high[axis] = high[axis].max(corner[axis]);
            }
        });
        (low, high)
    }

    fn each_corner(&self, visit: &mut dyn FnMut([f64; 2])) {
        match self {
            Shape::Rectangle {
                length_m,
                width_m,
                orientation_rad,
                center,
            } => {
                let (sin, cos) = orientation_rad.sin_cos();
                for (a, b) in [(0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)] {
                    let (x, y) = (a * length_m, b * width_m);
                    visit([center[0] + x * cos - y * sin, center[1] + x * sin + y * cos]);
                }
            }
            Shape::Circle { radius_m, center } => {
                visit([center[0] - radius_m, center[1] - radius_m]);
                visit([center[0] + radius_m, center[1] + radius_m]);
            }
            Shape::Polygon(corners) => corners.iter().copied().for_each(visit),
            Shape::Group(shapes) => {
                for shape in shapes {
                    shape.each_corner(visit);
                }
            }
        }
    }
}

/// Whether `point` lies inside a closed polyline (even-odd rule).
pub(crate) fn inside(corners: &[[f64; 2]], point: [f64; 2]) -> bool {
    let mut within = false;
    let mut previous = match corners.last() {
        Some(last) => *last,
        None => return false,
    };
    for &corner in corners {
        if (corner[1] > point[1]) != (previous[1] > point[1]) {
            let t = (point[1] - corner[1]) / (previous[1] - corner[1]);
            if point[0] < corner[0] + t * (previous[0] - corner[0]) {
                within = !within;
            }
        }
        previous = corner;
    }
    within
}

/// Where something was at one recorded instant. An interval in the file is read as its middle, a region as the middle
/// of its extent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Time in recorded steps.
    pub step: u32,
    /// Position, m.
    pub x_m: f64,
    /// See `x_m`.
    pub y_m: f64,
    /// In (−π, π], anticlockwise from the x axis.
    pub heading_rad: f64,
    /// Along the heading, negative backwards; where the file gives none, from the positions.
    pub speed_mps: f64,
}

/// Where the ego car starts, and what counts as arriving.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanningProblem {
    /// Identity.
    pub id: i64,
    /// The start.
    pub start: State,
    /// Any of these is the goal.
    pub goals: Vec<Goal>,
    /// The element of its start.
    pub mark: Mark,
}

/// A set of states that count as arriving.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// First and last time step.
    pub steps: [u32; 2],
    /// Any of these places; `None` where the goal is a time alone.
    pub places: Option<Vec<Place>>,
    /// Lowest and highest speed, m/s.
    pub speed_mps: Option<[f64; 2]>,
    /// From and to, anticlockwise.
    pub heading_rad: Option<[f64; 2]>,
}

/// A place that can be a goal.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// An area in the file's frame.
    Area(Shape),
    /// A lanelet.
    Lanelet(i64),
}

/// The same angle in (−π, π].
pub fn wrap(angle_rad: f64) -> f64 {
    let turned = angle_rad.rem_euclid(std::f64::consts::TAU);
    if turned > std::f64::consts::PI {
        turned - std::f64::consts::TAU
    } else {
        turned
    }
}
