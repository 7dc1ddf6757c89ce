//! Reads CommonRoad XML, formats 2018a, 2018b and 2020a.
//!
//! What is read: lanelets with their links; static and dynamic obstacles with rectangles, circles, polygons and groups
//! of them; trajectories; planning problems. What is left out and named in [`Scenario::left_out`]: traffic signs and
//! lights, stop lines, intersections (their lanelets are read), buildings, phantom obstacles, cars' light signals; links
//! to lanelets that the file does not contain, and of a lanelet to itself; lanelets with a bound of no length; a state
//! that stands a second time. What is refused, with the element's name and line: everything that would have to be
//! guessed, such as occupancy sets instead of trajectories, truck shapes, states that contradict each other, and elements
//! that the format does not know at the top level.

use super::error::{CommonRoadError, READ_VERSIONS, name_of};
use super::left_out::LeftOut;
use super::scenario::{Adjacent, BadLanelet, Lanelet, Mark, Place, Scenario};
use super::xml::{Element, Source, children, shown};
use roxmltree::{Document, ParsingOptions};
use std::collections::BTreeMap;
use std::path::Path;

/// The largest public scenarios are below 30 MB.
const LARGEST_FILE: u64 = 256 << 20;
/// A bound shorter than this, in m, is no bound.
const SHORTEST_BOUND_M: f64 = 1e-3;

/// A bound's points, or where it has no length: why.
type Bound = Result<Vec<[f64; 2]>, (Mark, String)>;

impl Scenario {
    /// Reads a file, or one that ships ([`super::shipped`]).
    pub fn read(path: &Path) -> Result<Self, CommonRoadError> {
        if let Some(text) = super::shipped::text(path) {
            return Self::parse(text.as_bytes(), &name_of(path));
        }
        let io = |source| CommonRoadError::Io {
            file: name_of(path),
            source,
        };
        let bytes = std::fs::metadata(path).map_err(io)?.len();
        if bytes > LARGEST_FILE {
            return Err(CommonRoadError::TooLarge {
                file: name_of(path),
                bytes,
                limit: LARGEST_FILE,
            });
        }
        Self::parse(&std::fs::read(path).map_err(io)?, &name_of(path))
    }

    /// Reads the bytes of a file; `file` is the name that errors carry.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, CommonRoadError> {
        let text = std::str::from_utf8(bytes).map_err(|error| CommonRoadError::Encoding {
            file: file.to_owned(),
            line: 1 + bytes[..error.valid_up_to()]
                .iter()
                .filter(|b| **b == b'\n')
                .count(),
            offset: error.valid_up_to(),
        })?;
        let options = ParsingOptions {
            allow_dtd: false,
            ..ParsingOptions::default()
        };
        let document =
            Document::parse_with_options(text, options).map_err(|error| CommonRoadError::Xml {
                file: file.to_owned(),
                line: error.pos().row as usize,
                reason: error.to_string(),
            })?;
        Source {
            file,
            document: &document,
        }
        .scenario()
    }
}

impl<'a> Source<'a> {
    fn scenario(&self) -> Result<Scenario, CommonRoadError> {
        let root = self.document.root_element();
        if root.tag_name().name() != "commonRoad" {
            return Err(self.error(root, "the file's outermost element is not <commonRoad>"));
        }
        let version = root.attribute("commonRoadVersion").unwrap_or_default();
        if !READ_VERSIONS.contains(&version) {
            return Err(CommonRoadError::Version {
                file: self.file.to_owned(),
                line: self.line(root),
                version: version.chars().take(40).collect(),
            });
        }
        let step: f64 = self
            .attribute(root, "timeStepSize")?
            .parse()
            .map_err(|_| self.error(root, "timeStepSize is not a number"))?;
        if !(0.001..=10.0).contains(&step) {
            return Err(self.error(
                root,
                format!("timeStepSize {step} is not between 0.001 and 10 s"),
            ));
        }
        let mut read = Scenario {
            file: self.file.to_owned(),
            benchmark_id: root.attribute("benchmarkID").unwrap_or_default().to_owned(),
            version: version.to_owned(),
            step_s: step,
            lanelets: Vec::new(),
            obstacles: Vec::new(),
            problems: Vec::new(),
            bad_lanelets: Vec::new(),
            left_out: Vec::new(),
        };
        let mut left_out = LeftOut::default();
        let mut seen: BTreeMap<i64, Element> = BTreeMap::new();
        let mut problems: BTreeMap<i64, Element> = BTreeMap::new();
        for element in root.children().filter(|node| node.is_element()) {
            match element.tag_name().name() {
                "lanelet" => {
                    self.claim(&mut seen, element)?;
                    left_out.count_in(element, &["stopLine"]);
                    match self.lanelet(element, &mut left_out)? {
                        Ok(lanelet) => read.lanelets.push(lanelet),
                        Err(bad) => read.bad_lanelets.push(bad),
                    }
                }
                "obstacle" if version != "2020a" => {
                    self.claim(&mut seen, element)?;
                    let role = self.child(element, "role")?;
                    let moving = match self.text(role)? {
                        "dynamic" => true,
                        "static" => false,
                        other => {
                            let problem = format!("{} is neither static nor dynamic", shown(other));
                            return Err(self.error(role, problem));
                        }
                    };
                    left_out.count_in(element, &["signalSeries"]);
                    let repeated = &mut left_out.repeated_states;
                    read.obstacles
                        .push(self.obstacle(element, moving, step, repeated)?);
                }
                name @ ("staticObstacle" | "dynamicObstacle") if version == "2020a" => {
                    self.claim(&mut seen, element)?;
                    let moving = name == "dynamicObstacle";
                    left_out.count_in(element, &["signalSeries"]);
                    let repeated = &mut left_out.repeated_states;
                    read.obstacles
                        .push(self.obstacle(element, moving, step, repeated)?);
                }
                "planningProblem" => {
                    self.claim(&mut problems, element)?;
                    read.problems.push(self.planning_problem(element)?);
                }
                "location" | "scenarioTags" => {}
                name if left_out.count(name) => {}
                _ => {
                    let problem = format!("is not an element that format {version} has here");
                    return Err(self.error(element, problem));
                }
            }
        }
        if read.lanelets.is_empty() {
            return Err(match read.bad_lanelets.first() {
                Some(bad) => read.refuses(&bad.mark, &*bad.problem),
                None => self.error(root, "<lanelet> is missing"),
            });
        }
        read.bad_lanelets.sort_by_key(|lanelet| lanelet.id);
        read.lanelets.sort_by_key(|lanelet| lanelet.id);
        read.obstacles.sort_by_key(|obstacle| obstacle.id);
        self.check_links(&mut read, &seen, &mut left_out);
        read.left_out = left_out.words(&read);
        self.check_goals(&read, &problems)?;
        Ok(read)
    }

    /// Notes an identity, or says where it stood before.
    fn claim(
        &self,
        seen: &mut BTreeMap<i64, Element<'a>>,
        element: Element<'a>,
    ) -> Result<(), CommonRoadError> {
        let id = self.identity(element, "id")?;
        if !(0..=i64::from(i32::MAX)).contains(&id) {
            return Err(self.error(
                element,
                format!("id {id} is not between 0 and {}", i32::MAX),
            ));
        }
        match seen.insert(id, element) {
            None => Ok(()),
            Some(first) => {
                let line = self.line(first);
                Err(self.error(element, format!("id {id} stands already at line {line}")))
            }
        }
    }

    /// A lanelet; or, where one of its bounds has no length, what is known of it.
    fn lanelet(
        &self,
        element: Element<'a>,
        left_out: &mut LeftOut,
    ) -> Result<Result<Lanelet, BadLanelet>, CommonRoadError> {
        let id = self.identity(element, "id")?;
        let mut links = |name: &str| -> Result<Vec<i64>, CommonRoadError> {
            let mut links = Vec::new();
            for link in children(element, name) {
                match self.identity(link, "ref")? {
                    own if own == id => left_out.own_link(id, name, self.line(link)),
                    other => links.push(other),
                }
            }
            Ok(links)
        };
        let (predecessors, successors) = (links("predecessor")?, links("successor")?);
        let left = self.bound(self.child(element, "leftBound")?)?;
        let right = self.bound(self.child(element, "rightBound")?)?;
        let left_neighbour = self.adjacent(element, "adjacentLeft")?;
        let right_neighbour = self.adjacent(element, "adjacentRight")?;
        let kinds = children(element, "laneletType")
            .map(|kind| self.text(kind).map(str::to_owned))
            .collect::<Result<_, _>>()?;
        let speed_limit_mps = match self.optional_child(element, "speedLimit")? {
            Some(limit) => {
                let value = self.number(limit)?;
                if value <= 0.0 {
                    return Err(self.error(limit, format!("{value} m/s is no speed limit")));
                }
                Some(value)
            }
            None => None,
        };
        Ok(match (left, right) {
            (Ok(left), Ok(right)) => Ok(Lanelet {
                id,
                left,
                right,
                predecessors,
                successors,
                left_neighbour,
                right_neighbour,
                kinds,
                speed_limit_mps,
            }),
            (Err((mark, problem)), _) | (_, Err((mark, problem))) => Err(BadLanelet {
                id,
                mark,
                problem,
                predecessors,
                successors,
            }),
        })
    }

    fn bound(&self, element: Element<'a>) -> Result<Bound, CommonRoadError> {
        let mut points: Vec<[f64; 2]> = Vec::new();
        for point in children(element, "point") {
            let point = self.point(point)?;
            if points.last() != Some(&point) {
                points.push(point);
            }
        }
        let length: f64 = points.windows(2).map(|w| distance(w[0], w[1])).sum();
        Ok(match length < SHORTEST_BOUND_M {
            true => Err((self.mark(element), format!("the bound is {length} m long"))),
            false => Ok(points),
        })
    }

    fn adjacent(
        &self,
        lanelet: Element<'a>,
        name: &str,
    ) -> Result<Option<Adjacent>, CommonRoadError> {
        let Some(element) = self.optional_child(lanelet, name)? else {
            return Ok(None);
        };
        let same_direction = match self.attribute(element, "drivingDir")? {
            "same" => true,
            "opposite" => false,
            other => {
                let problem = format!("drivingDir {} is neither same nor opposite", shown(other));
                return Err(self.error(element, problem));
            }
        };
        Ok(Some(Adjacent {
            id: self.identity(element, "ref")?,
            same_direction,
        }))
    }

    /// Drops links to lanelets that the file lacks (maps are cut out of larger ones), that make no lane, or from a lanelet
    /// to itself, and counts or names them.
    fn check_links(
        &self,
        read: &mut Scenario,
        seen: &BTreeMap<i64, Element<'a>>,
        left_out: &mut LeftOut,
    ) {
        let ids: Vec<i64> = read.lanelets.iter().map(|lanelet| lanelet.id).collect();
        let known = |id: i64| ids.binary_search(&id).is_ok();
        let bad = &mut read.bad_lanelets;
        for lanelet in &mut read.lanelets {
            let own = lanelet.id;
            // A link counts whichever of its two ends states it: bad lanelets hear of both.
            let mut keep = |id: i64, of: fn(&mut BadLanelet) -> &mut Vec<i64>| {
                let at = bad.binary_search_by_key(&id, |bad| bad.id);
                match at {
                    Ok(at) => of(&mut bad[at]).push(own),
                    Err(_) => left_out.loose_links += usize::from(!known(id)),
                }
                known(id)
            };
            lanelet
                .predecessors
                .retain(|id| keep(*id, |bad| &mut bad.successors));
            lanelet
                .successors
                .retain(|id| keep(*id, |bad| &mut bad.predecessors));
            for neighbour in [&mut lanelet.left_neighbour, &mut lanelet.right_neighbour] {
                match neighbour {
                    Some(adjacent) if adjacent.id == own => {
                        left_out.own_link(own, "neighbour", self.line(seen[&own]));
                        *neighbour = None;
                    }
                    Some(adjacent) if !known(adjacent.id) => {
                        let is_bad = bad.iter().any(|bad| bad.id == adjacent.id);
                        left_out.loose_links += usize::from(!is_bad);
                        *neighbour = None;
                    }
                    _ => {}
                }
            }
        }
    }

    fn check_goals(
        &self,
        read: &Scenario,
        problems: &BTreeMap<i64, Element<'a>>,
    ) -> Result<(), CommonRoadError> {
        for problem in &read.problems {
            let places = problem
                .goals
                .iter()
                .flat_map(|goal| goal.places.iter().flatten());
            for place in places {
                if let Place::Lanelet(id) = place
                    && read.lanelet(*id).is_none()
                    && read.bad_lanelet(*id).is_none()
                {
                    let said = format!("the goal is lanelet {id}, which the file lacks");
                    return Err(self.error(problems[&problem.id], said));
                }
            }
        }
        Ok(())
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}
