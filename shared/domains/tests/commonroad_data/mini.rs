//! A small scenario that tests change: one straight lane from x = −20 to 180 m, 4 m wide, a car ahead that drives at 10 m/s,
//! and an ego car that starts at the origin as fast.
#![allow(dead_code, reason = "every test file uses a part")]

/// Parts of a scenario, each on lines of its own.
pub struct Mini {
    /// Lanelets.
    pub lanelets: String,
    /// Obstacles.
    pub obstacles: String,
    /// Traffic lights and the like.
    pub others: String,
    /// Planning problems.
    pub problems: String,
}

impl Default for Mini {
    fn default() -> Self {
        Self {
            lanelets: lanelet(1, [-20.0, 180.0], 0.0, ""),
            obstacles: car(10, &drive(40.0, 10.0, 31)),
            others: String::new(),
            problems: problem(900, [0.0, 0.0], [25, 30], ""),
        }
    }
}

impl Mini {
    /// The file.
    pub fn text(&self) -> String {
        let Self {
            lanelets,
            obstacles,
            others,
            problems,
        } = self;
        format!(
            "<?xml version=\"1.0\"?>\n<commonRoad commonRoadVersion=\"2020a\" benchmarkID=\"ZAM_Mini-1_1_T-1\" timeStepSize=\"0.1\">\n{lanelets}{others}{obstacles}{problems}</commonRoad>\n"
        )
    }
}

/// A straight lanelet along x, 4 m wide around y.
pub fn lanelet(id: u32, [from, to]: [f64; 2], y: f64, links: &str) -> String {
    let bound = |side: &str, y: f64| {
        format!(
            "<{side}Bound><point><x>{from}</x><y>{y}</y></point><point><x>{to}</x><y>{y}</y></point></{side}Bound>\n"
        )
    };
    let (left, right) = (bound("left", y + 2.0), bound("right", y - 2.0));
    format!("<lanelet id=\"{id}\">\n{left}{right}{links}\n</lanelet>\n")
}

/// A lanelet whose right bound is shorter than a millimetre.
pub fn bad_lanelet(id: u32, along: [f64; 2], links: &str) -> String {
    let whole = lanelet(id, along, 0.0, links);
    let (before, after) = whole.split_once("<rightBound>").unwrap();
    let (_, after) = after.split_once("</rightBound>").unwrap();
    let point = |x: f64| format!("<point><x>{x}</x><y>-2</y></point>");
    format!(
        "{before}<rightBound>{}{}</rightBound>{after}",
        point(300.0),
        point(300.0009)
    )
}

/// A state along y = 0: time step, x, speed.
pub type At = (u32, f64, f64);

/// States of a car that drives on from `x` at `speed`, one a time step.
pub fn drive(x: f64, speed: f64, count: u32) -> Vec<At> {
    (0..count)
        .map(|step| (step, x + f64::from(step) * speed * 0.1, speed))
        .collect()
}

/// The inside of a state, at y, with a heading.
pub fn state([x, y]: [f64; 2], heading: f64, step: u32, speed: f64) -> String {
    format!(
        "<position><point><x>{x}</x><y>{y}</y></point></position><orientation><exact>{heading}</exact></orientation><time><exact>{step}</exact></time><velocity><exact>{speed}</exact></velocity>"
    )
}

/// A recorded car, 4.5 by 1.8 m, a line per state.
pub fn car(id: u32, states: &[At]) -> String {
    let lines: Vec<String> = states
        .iter()
        .map(|(step, x, speed)| state([*x, 0.0], 0.0, *step, *speed))
        .collect();
    let (first, rest) = lines.split_first().unwrap();
    let rest: String = rest
        .iter()
        .map(|line| format!("<state>{line}</state>\n"))
        .collect();
    format!(
        "<dynamicObstacle id=\"{id}\"><type>car</type>{}\n<initialState>{first}</initialState>\n<trajectory>\n{rest}</trajectory></dynamicObstacle>\n",
        BOX
    )
}

/// A parked car at (x, 0).
pub fn parked(id: u32, x: f64) -> String {
    format!(
        "<staticObstacle id=\"{id}\"><type>parkedVehicle</type>{BOX}\n<initialState>{}</initialState></staticObstacle>\n",
        state([x, 0.0], 0.0, 0, 0.0)
    )
}

const BOX: &str = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>";

/// A planning problem: start, the goal's time steps, and the goal's place.
pub fn problem(id: u32, start: [f64; 2], [from, to]: [u32; 2], place: &str) -> String {
    format!(
        "<planningProblem id=\"{id}\">\n<initialState>{}</initialState>\n<goalState><time><intervalStart>{from}</intervalStart><intervalEnd>{to}</intervalEnd></time>{place}</goalState>\n</planningProblem>\n",
        state(start, 0.0, 0, 10.0)
    )
}
