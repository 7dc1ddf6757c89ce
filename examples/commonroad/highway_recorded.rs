//! Makes `highway-recorded.xml`, the CommonRoad scenario that ships: a straight motorway of three lanes, dense traffic,
//! twelve seconds. Nobody was recorded: a truck and nine cars drive by the Intelligent Driver Model; two change lanes
//! at set times, and one slows down for a while. An eleventh keeps the place of the ego car: it is simulated, so that
//! the others leave it room, and only its start is written, as that of the planning problem.
//!
//! ```sh
//! cargo run --release -p mirror --example highway_recorded > examples/commonroad/highway-recorded.xml
//! ```
//!
//! The file is the same to the last byte on every machine: nothing but sums, products, quotients and square roots is
//! computed, and `tests/recorded.rs` compares it.

use std::fmt::Write;

/// Seconds between recorded instants, as in most public scenarios.
const STEP_S: f64 = 0.1;
/// The last recorded instant, in steps.
const LAST_STEP: u32 = 120;
/// Physics ticks in a step.
const TICKS: u32 = 10;
/// Length of the road.
const ROAD_M: f64 = 450.0;
/// Width of a lane.
const LANE_M: f64 = 3.5;
/// How long a lane change takes.
const CHANGE_S: f64 = 4.0;
/// Identity of the car that is not written.
const EGO: u32 = 0;

/// A driver of the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000), and what is set for them.
#[derive(Clone, Copy)]
struct Car {
    id: u32,
    kind: &'static str,
    size_m: [f64; 2],
    /// 0 is the right lane.
    lane: usize,
    /// The middle of the car, along the road.
    x_m: f64,
    speed_mps: f64,
    desired_mps: f64,
    /// Time headway T.
    headway_s: f64,
    /// When they begin to change to which lane.
    change: Option<(f64, usize)>,
    /// From when to when they want to drive how fast.
    slow: Option<([f64; 2], f64)>,
}

/// Standstill gap s0, acceleration a and comfortable deceleration b.
const STANDSTILL_M: f64 = 2.0;
const ACCELERATION_MPS2: f64 = 1.5;
const DECELERATION_MPS2: f64 = 2.0;

fn cars() -> Vec<Car> {
    let car = |id, lane, x_m, speed_mps, desired_mps, headway_s| Car {
        id,
        kind: "car",
        size_m: [4.6, 1.85],
        lane,
        x_m,
        speed_mps,
        desired_mps,
        headway_s,
        change: None,
        slow: None,
    };
    vec![
        Car {
            kind: "truck",
            size_m: [9.0, 2.5],
            ..car(11, 0, 150.0, 9.0, 9.0, 1.5)
        },
        Car {
            change: Some((5.0, 1)),
            ..car(12, 0, 118.0, 10.5, 12.5, 1.1)
        },
        car(13, 0, 60.0, 11.0, 11.0, 1.3),
        Car {
            slow: Some(([3.0, 6.0], 6.0)),
            ..car(14, 1, 168.0, 12.0, 12.0, 1.2)
        },
        car(15, 1, 132.0, 12.0, 13.0, 1.0),
        car(EGO, 1, 98.0, 11.0, 11.5, 1.2),
        car(16, 1, 64.0, 12.0, 12.5, 1.1),
        Car {
            change: Some((2.0, 2)),
            ..car(17, 1, 30.0, 13.0, 15.0, 1.0)
        },
        car(18, 2, 172.0, 13.0, 13.5, 1.2),
        car(19, 2, 112.0, 14.0, 14.5, 1.1),
        // Comes from behind, faster than everybody.
        car(20, 2, 12.0, 15.0, 18.0, 0.9),
    ]
}

impl Car {
    /// The lanes that the car is in at a time: two while it changes.
    fn lanes(&self, time_s: f64) -> [usize; 2] {
        match self.change {
            Some((from_s, to)) if time_s >= from_s + CHANGE_S => [to, to],
            Some((from_s, to)) if time_s >= from_s => [self.lane, to],
            _ => [self.lane, self.lane],
        }
    }

    /// The speed that they want at a time.
    fn wants_mps(&self, time_s: f64) -> f64 {
        match self.slow {
            Some(([from_s, to_s], speed_mps)) if (from_s..to_s).contains(&time_s) => speed_mps,
            _ => self.desired_mps,
        }
    }

    /// Acceleration behind `leader`, which is that far ahead from bumper to bumper and drives so fast.
    fn acceleration_mps2(&self, time_s: f64, leader: Option<(f64, f64)>) -> f64 {
        let wanted = self.speed_mps / self.wants_mps(time_s);
        let free = 1.0 - wanted * wanted * wanted * wanted;
        let blocked = leader.map_or(0.0, |(gap_m, leader_mps)| {
            let closing = self.speed_mps * (self.speed_mps - leader_mps);
            let braking = closing / (2.0 * (ACCELERATION_MPS2 * DECELERATION_MPS2).sqrt());
            let gap = STANDSTILL_M + (self.speed_mps * self.headway_s + braking).max(0.0);
            let share = gap / gap_m.max(0.1);
            share * share
        });
        (ACCELERATION_MPS2 * (free - blocked)).clamp(-4.0, ACCELERATION_MPS2)
    }

    /// Place across the road and speed across it: a lane change is a fifth-degree polynomial, smooth at both ends.
    fn across(&self, time_s: f64) -> [f64; 2] {
        let middle = |lane: usize| (lane as f64 + 0.5) * LANE_M;
        let Some((from_s, to)) = self.change else {
            return [middle(self.lane), 0.0];
        };
        let (from, way) = (middle(self.lane), middle(to) - middle(self.lane));
        let t = ((time_s - from_s) / CHANGE_S).clamp(0.0, 1.0);
        let place = t * t * t * (10.0 - 15.0 * t + 6.0 * t * t);
        let speed = 30.0 * t * t * (1.0 - t) * (1.0 - t) / CHANGE_S;
        [from + way * place, way * speed]
    }

    /// The inside of a state.
    fn state(&self, step: u32) -> String {
        let [y_m, across_mps] = self.across(f64::from(step) * STEP_S);
        // The arc tangent of a small slope, by its series: exact to the last digit written, and the same everywhere.
        let slope = across_mps / self.speed_mps.max(1.0);
        let square = slope * slope;
        let heading = slope * (1.0 - square * (1.0 / 3.0 - square * (1.0 / 5.0 - square / 7.0)));
        let speed_mps = (self.speed_mps * self.speed_mps + across_mps * across_mps).sqrt();
        format!(
            "<position><point><x>{:.3}</x><y>{y_m:.3}</y></point></position><orientation><exact>{heading:.5}</exact></orientation><time><exact>{step}</exact></time><velocity><exact>{speed_mps:.3}</exact></velocity>",
            self.x_m
        )
    }
}

/// Distance from bumper to bumper, and speed, of the next car ahead in a lane of `car`'s.
fn leader(cars: &[Car], car: &Car, time_s: f64) -> Option<(f64, f64)> {
    let mine = car.lanes(time_s);
    let ahead = cars.iter().filter(|other| {
        other.x_m > car.x_m && other.lanes(time_s).iter().any(|lane| mine.contains(lane))
    });
    let next = ahead.min_by(|a, b| a.x_m.total_cmp(&b.x_m))?;
    let gap_m = next.x_m - car.x_m - (next.size_m[0] + car.size_m[0]) / 2.0;
    Some((gap_m, next.speed_mps))
}

/// The whole file.
pub fn scenario() -> String {
    let mut cars = cars();
    let mut states: Vec<Vec<String>> = cars.iter().map(|car| vec![car.state(0)]).collect();
    let tick_s = STEP_S / f64::from(TICKS);
    for step in 1..=LAST_STEP {
        for tick in 0..TICKS {
            let time_s = f64::from((step - 1) * TICKS + tick) * tick_s;
            let accelerations: Vec<f64> = cars
                .iter()
                .map(|car| car.acceleration_mps2(time_s, leader(&cars, car, time_s)))
                .collect();
            for (car, acceleration) in cars.iter_mut().zip(accelerations) {
                car.speed_mps = (car.speed_mps + acceleration * tick_s).max(0.0);
                car.x_m += car.speed_mps * tick_s;
            }
        }
        for (car, states) in cars.iter().zip(&mut states) {
            states.push(car.state(step));
        }
    }

    let mut text = String::new();
    write_head(&mut text);
    for lane in 0..3 {
        write_lanelet(&mut text, lane);
    }
    for (car, states) in cars.iter().zip(&states).filter(|(car, _)| car.id != EGO) {
        write_car(&mut text, car, states);
    }
    for (car, states) in cars.iter().zip(&states).filter(|(car, _)| car.id == EGO) {
        write_problem(&mut text, car, &states[0]);
    }
    text + "</commonRoad>\n"
}

fn write_head(text: &mut String) {
    *text += "<?xml version='1.0' encoding='UTF-8'?>\n";
    *text += "<!-- Made by examples/commonroad/highway_recorded.rs; simulated, not recorded from anybody. MIT OR Apache-2.0. -->\n";
    *text += "<commonRoad timeStepSize=\"0.1\" commonRoadVersion=\"2020a\" author=\"MIRROR\" affiliation=\"\" source=\"simulated: Intelligent Driver Model\" benchmarkID=\"ZAM_Recorded-1_1_T-1\" date=\"2026-11-28\">\n";
    *text += "<location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude><gpsLongitude>999</gpsLongitude></location>\n";
    *text +=
        "<scenarioTags><highway/><multi_lane/><no_oncoming_traffic/><simulated/></scenarioTags>\n";
}

/// A lane, from 1 on the right.
fn write_lanelet(text: &mut String, lane: usize) {
    let id = lane + 1;
    let _ = writeln!(text, "<lanelet id=\"{id}\">");
    for (side, edge) in [("left", lane + 1), ("right", lane)] {
        let y_m = edge as f64 * LANE_M;
        let points: Vec<String> = (0..=9)
            .map(|part| f64::from(part) / 9.0 * ROAD_M)
            .map(|x_m| format!("<point><x>{x_m:.1}</x><y>{y_m:.2}</y></point>"))
            .collect();
        let _ = writeln!(text, "<{side}Bound>{}</{side}Bound>", points.concat());
    }
    if lane < 2 {
        let _ = writeln!(
            text,
            "<adjacentLeft ref=\"{}\" drivingDir=\"same\"/>",
            id + 1
        );
    }
    if lane > 0 {
        let _ = writeln!(
            text,
            "<adjacentRight ref=\"{}\" drivingDir=\"same\"/>",
            id - 1
        );
    }
    *text += "<laneletType>highway</laneletType>\n<userOneWay>car</userOneWay>\n</lanelet>\n";
}

fn write_car(text: &mut String, car: &Car, states: &[String]) {
    let Car {
        id,
        kind,
        size_m: [length_m, width_m],
        ..
    } = car;
    let _ = writeln!(
        text,
        "<dynamicObstacle id=\"{id}\">\n<type>{kind}</type>\n<shape><rectangle><length>{length_m}</length><width>{width_m}</width></rectangle></shape>"
    );
    let _ = writeln!(
        text,
        "<initialState>{}</initialState>\n<trajectory>",
        states[0]
    );
    for state in &states[1..] {
        let _ = writeln!(text, "<state>{state}</state>");
    }
    *text += "</trajectory>\n</dynamicObstacle>\n";
}

/// From where the car that is not written starts, to about where it ends, at any time of the last four seconds.
fn write_problem(text: &mut String, car: &Car, start: &str) {
    let _ = writeln!(
        text,
        "<planningProblem id=\"100\">\n<initialState>{start}<yawRate><exact>0.0</exact></yawRate><slipAngle><exact>0.0</exact></slipAngle></initialState>"
    );
    let (from, to) = (LAST_STEP - 40, LAST_STEP);
    let (x_m, y_m) = (car.x_m, 1.5 * LANE_M);
    let _ = writeln!(
        text,
        "<goalState><position><rectangle><length>40.0</length><width>{:.1}</width><orientation>0.0</orientation><center><x>{x_m:.1}</x><y>{y_m:.2}</y></center></rectangle></position><time><intervalStart>{from}</intervalStart><intervalEnd>{to}</intervalEnd></time></goalState>\n</planningProblem>",
        3.0 * LANE_M
    );
}

#[allow(dead_code, reason = "a test takes the text alone")]
fn main() {
    print!("{}", scenario());
}
