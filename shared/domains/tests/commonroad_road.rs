//! Roads made of lanelets: which lanes belong to them, where they lead, where they end; goals and collisions on them.

mod commonroad_data;

use commonroad_data::{FIXTURE_2020A, real_files};
use domains::commonroad::Scenario;
use domains::highway::{End, World};
use std::sync::Arc;

#[test]
fn a_lane_that_begins_does_not_shift_the_roads_centre() {
    // On the A9, a fifth lane begins 35 m ahead of the ego car.
    for file in real_files()
        .iter()
        .filter(|file| file.to_string_lossy().contains("DEU_A9"))
    {
        let course = Scenario::read(file).unwrap().course(None).unwrap();
        let s_m = course.road.project(course.start.x_m, course.start.y_m).s_m;
        let (before, after) = (course.road.edges_m(s_m), course.road.edges_m(s_m + 60.0));
        assert!(
            (before.1 - before.0) + 3.5 < after.1 - after.0,
            "{before:?} {after:?}"
        );
        for ahead in 0..200 {
            let moved = course.road.center_m(s_m + f64::from(ahead)) - course.road.center_m(s_m);
            assert!(moved.abs() < 0.3, "{moved} m at {ahead} m");
        }
    }
}

/// The 2020a fixture with its ego car elsewhere.
fn started_at(x: &str, y: &str, heading: &str) -> Scenario {
    let (before, problem) = FIXTURE_2020A.split_at(FIXTURE_2020A.find("<planningProblem").unwrap());
    let moved = problem
        .replacen(
            "<x>10.0</x><y>5.25</y>",
            &format!("<x>{x}</x><y>{y}</y>"),
            1,
        )
        .replacen(
            "<orientation><exact>0.0",
            &format!("<orientation><exact>{heading}"),
            1,
        );
    Scenario::parse(format!("{before}{moved}").as_bytes(), "moved.xml").unwrap()
}

fn drive(scenario: &Scenario, action: [f32; 2]) -> World {
    let mut world = World::new(Arc::new(scenario.scene(None, None).unwrap())).unwrap();
    while world.end() == End::Running {
        world.step(action);
    }
    world
}

#[test]
fn the_goal_is_a_place_within_its_time() {
    // The goal is lanelet 2, from x = 100 m, between 0.5 and 2 s; the car drives 9 m/s.
    let reached = drive(&started_at("92.0", "1.75", "0.0"), [0.1, 0.0]);
    assert_eq!(reached.end(), End::Goal);
    assert!(reached.ego().pose.x_m >= 100.0 && reached.time_s() >= 0.5);
    let already_there = drive(&started_at("140.0", "1.75", "0.0"), [0.1, 0.0]);
    assert!(
        already_there.time_s() >= 0.5 && already_there.time_s() < 0.7,
        "{}",
        already_there.time_s()
    );
    let other_lane = drive(&started_at("92.0", "5.25", "0.0"), [0.1, 0.0]);
    assert_eq!(other_lane.end(), End::OutOfTime);
    assert!(other_lane.time_s() >= 2.0);
}

#[test]
fn outside_all_lanelets_is_off_the_road() {
    // Heads right at 0.3 rad from the right lane, whose edge is y = 0.
    let left = drive(&started_at("40.0", "1.75", "-0.3"), [0.0, 0.0]);
    assert_eq!(left.end(), End::Collision);
    let y = left.ego().pose.y_m;
    assert!((-0.5..=0.0).contains(&y), "left the road at y = {y}");
}

#[test]
fn the_ego_car_collides_with_recorded_and_with_parked_cars() {
    // Car 11 is at x = 20 m at first and drives 10 m/s; the ego car drives 9 m/s ahead of it, and brakes.
    let hit = drive(&started_at("30.0", "1.75", "0.0"), [-1.0, 0.0]);
    assert_eq!(hit.end(), End::Collision);
    let free = drive(&started_at("30.0", "5.25", "0.0"), [0.0, 0.0]);
    assert_eq!(free.end(), End::OutOfTime);
    // A disc of 1 m around x = 250 m.
    let parked = drive(&started_at("243.0", "1.75", "0.0"), [1.0, 0.0]);
    assert_eq!(parked.end(), End::Collision);
}

/// A lanelet 3.5 m wide around a line.
fn lanelet(id: u32, center: &[[f64; 2]], links: &str) -> String {
    let side = |shift: f64| -> String {
        let count = center.len();
        (0..count)
            .map(|i| {
                let (a, b) = (center[i.saturating_sub(1)], center[(i + 1).min(count - 1)]);
                let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                let [x, y] = center[i];
                let (x, y) = (
                    x - shift * (b[1] - a[1]) / length,
                    y + shift * (b[0] - a[0]) / length,
                );
                format!("<point><x>{x:.4}</x><y>{y:.4}</y></point>")
            })
            .collect()
    };
    format!(
        "<lanelet id=\"{id}\"><leftBound>{}</leftBound><rightBound>{}</rightBound>{links}</lanelet>\n",
        side(1.75),
        side(-1.75)
    )
}

/// A crossing: lanelet 1 leads straight on (2) and by a left turn of 30 m radius (3) to a street northwards (4); 5 is
/// the oncoming lane beside 1, 6 a street across.
fn crossing(goal: u32) -> Scenario {
    let line = |from: [f64; 2], to: [f64; 2]| -> Vec<[f64; 2]> {
        let at = |i: u32, axis: usize| from[axis] + (to[axis] - from[axis]) * f64::from(i) / 10.0;
        (0..=10).map(|i| [at(i, 0), at(i, 1)]).collect()
    };
    let turn: Vec<[f64; 2]> = (0..=10)
        .map(|i| f64::from(i) * std::f64::consts::FRAC_PI_2 / 10.0)
        .map(|angle| [100.0 + 30.0 * angle.sin(), 30.0 - 30.0 * angle.cos()])
        .collect();
    let lanelets = [
        lanelet(
            1,
            &line([0.0, 0.0], [100.0, 0.0]),
            "<successor ref=\"2\"/><successor ref=\"3\"/><adjacentLeft ref=\"5\" drivingDir=\"opposite\"/>",
        ),
        lanelet(
            2,
            &line([100.0, 0.0], [200.0, 0.0]),
            "<predecessor ref=\"1\"/>",
        ),
        lanelet(3, &turn, "<predecessor ref=\"1\"/><successor ref=\"4\"/>"),
        lanelet(
            4,
            &line([130.0, 30.0], [130.0, 130.0]),
            "<predecessor ref=\"3\"/>",
        ),
        lanelet(5, &line([100.0, 3.5], [0.0, 3.5]), ""),
        lanelet(6, &line([115.0, 60.0], [115.0, -60.0]), ""),
    ];
    let text = FIXTURE_2020A.replace(
        "<lanelet ref=\"2\"/>",
        &format!("<lanelet ref=\"{goal}\"/>"),
    );
    let text = text.replace("<x>10.0</x><y>5.25</y>", "<x>50.0</x><y>0.0</y>");
    let (start, end) = (
        text.find("<lanelet id").unwrap(),
        text.rfind("</lanelet>").unwrap() + 10,
    );
    let text = format!("{}{}{}", &text[..start], lanelets.concat(), &text[end..]);
    Scenario::parse(text.as_bytes(), "crossing.xml").unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn the_road_follows_the_way_to_the_goal() {
    let straight = crossing(2).course(None).unwrap().road;
    let end = straight.pose(straight.project(190.0, 0.0));
    assert!((straight.length_m() - 200.0).abs() < 0.5 && end.heading_rad.abs() < 0.01);
    // The left turn lies beside the straight way until it bends away; the street across and the oncoming lane never do.
    assert!(!straight.on_lane(straight.project(50.0, 3.5)));
    assert!(!straight.on_lane(straight.project(115.0, 40.0)));

    let left = crossing(4).course(None).unwrap().road;
    let quarter = 30.0 * std::f64::consts::FRAC_PI_2;
    assert!(
        (left.length_m() - 200.0 - quarter).abs() < 0.5,
        "{}",
        left.length_m()
    );
    let at = left.project(130.0, 100.0);
    assert!(
        (at.d_m - left.lane_offset_m(left.lane_near(at), at.s_m)).abs() < 0.05,
        "{at:?}"
    );
    assert!(
        (left.heading_rad(at.s_m) - left.heading_rad(50.0) - std::f64::consts::FRAC_PI_2).abs()
            < 0.02
    );
    // In the middle of the turn, the road ahead bends by 10 m / 30 m.
    let turning = left.project(100.0 + 30.0 * 0.7f64.sin(), 30.0 - 30.0 * 0.7f64.cos());
    assert!((left.turn_ahead_rad(turning.s_m, 10.0) - 1.0 / 3.0).abs() < 0.05);
    assert!(left.on_lane(turning));
}
