//! What can be driven and what cannot: repeated states, roads without traffic, bad lanelets, recordings that end too soon,
//! starts on no lane or in a car; and what is said of all that was passed over.

mod commonroad_data;
#[path = "commonroad_data/mini.rs"]
mod mini;

use commonroad_data::ngsim_files;
use domains::commonroad::Scenario;
use domains::highway::{End, Scene, World};
use mini::{Mini, bad_lanelet, car, drive, lanelet, parked, problem, state};
use std::path::Path;
use std::sync::Arc;

fn scene(mini: &Mini) -> Result<Scene, String> {
    Scenario::parse(mini.text().as_bytes(), "mini.xml")
        .and_then(|scenario| scenario.scene(None, None))
        .map_err(|error| error.to_string())
}

/// The scene's notes, having driven it to its end: straight on, as fast as at the start.
fn driven(mini: &Mini) -> (World, String) {
    let scene = scene(mini).unwrap_or_else(|error| panic!("{error}\n{}", mini.text()));
    let notes = scene.course.as_ref().unwrap().notes.join("; ");
    let mut world = World::new(Arc::new(scene)).unwrap();
    while world.end() == End::Running {
        world.step([0.05, 0.0]);
    }
    assert!(world.steps() > 1, "over after a step: {:?}", world.end());
    (world, notes)
}

/// Asserts that the scenario is refused with these words, at the line that begins with `at`.
fn refused(mini: &Mini, at: &str, words: &[&str]) {
    let error = scene(mini)
        .err()
        .unwrap_or_else(|| panic!("driven: {}", mini.text()));
    let text = mini.text();
    let line = 1 + text[..text.find(at).unwrap()].matches('\n').count();
    assert!(
        error.starts_with(&format!("mini.xml:{line}: ")),
        "not at line {line}: {error}"
    );
    for word in words {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
}

#[test]
fn the_mini_scenario_is_driven() {
    let (world, notes) = driven(&Mini::default());
    assert_eq!((world.end(), notes.as_str()), (End::OutOfTime, ""));
}

#[test]
fn an_equal_state_is_passed_over() {
    let mut states = drive(40.0, 10.0, 31);
    states.insert(1, states[0]);
    states.insert(20, states[19]);
    // Out of order, too.
    states.insert(25, states[7]);
    let again = Mini {
        obstacles: car(10, &states),
        ..Mini::default()
    };
    let (world, notes) = driven(&again);
    assert_eq!(notes, "left out: 3 states said again");
    let plain = driven(&Mini::default()).0;
    assert_eq!((world.steps(), world.ego()), (plain.steps(), plain.ego()));
    // One of the two may state no speed.
    let text = again.text().replacen(
        "<velocity><exact>10</exact></velocity></initialState>",
        "</initialState>",
        1,
    );
    let read = Scenario::parse(text.as_bytes(), "mini.xml").unwrap();
    assert_eq!(read.obstacles[0].states[0].speed_mps, 10.0);
    // Digits that programs write differently are no contradiction.
    states[1].1 += 0.0004;
    driven(&Mini {
        obstacles: car(10, &states),
        ..Mini::default()
    });
}

#[test]
fn states_that_contradict_each_other_are_refused() {
    for (x, speed) in [(40.5, 10.0), (40.0, 11.0)] {
        let mut states = drive(40.0, 10.0, 31);
        states.insert(1, (0, x, speed));
        let mini = Mini {
            obstacles: car(10, &states),
            ..Mini::default()
        };
        refused(&mini, "<state>", &["<state>", "contradicts", "time step 0"]);
    }
    // A time step that was not there before, out of order.
    let mut states = drive(40.0, 10.0, 31);
    states.remove(5);
    states.push((5, 45.0, 10.0));
    let error = scene(&Mini {
        obstacles: car(10, &states),
        ..Mini::default()
    })
    .unwrap_err();
    assert!(error.contains("time step 5 does not follow 30"), "{error}");
}

#[test]
fn a_road_without_traffic_is_driven_until_the_goals_last_time_step() {
    for obstacles in [String::new(), parked(10, 120.0)] {
        for closes in [10, 30, 57] {
            let problems = problem(900, [0.0, 0.0], [5, closes], "");
            let (world, notes) = driven(&Mini {
                obstacles: obstacles.clone(),
                problems,
                ..Mini::default()
            });
            let seconds = f64::from(closes) * 0.1;
            assert_eq!(world.end(), End::OutOfTime);
            assert!(
                (seconds..seconds + 0.15 + 1e-9).contains(&world.time_s()),
                "{}",
                world.time_s()
            );
            assert_eq!(
                notes,
                format!(
                    "no car moves: the round lasts until the goal's last time step, {seconds:.1} s"
                )
            );
        }
    }
    // The parked car is there.
    let problems = problem(900, [0.0, 0.0], [5, 100], "");
    let (world, _) = driven(&Mini {
        obstacles: parked(10, 50.0),
        problems,
        ..Mini::default()
    });
    assert_eq!(world.end(), End::Collision);
    // A goal that closes at once is no round.
    let problems = problem(900, [0.0, 0.0], [0, 3], "");
    let mini = Mini {
        obstacles: String::new(),
        problems,
        ..Mini::default()
    };
    refused(&mini, "<initialState>", &["closes 0.3 s after the start"]);
}

#[test]
fn a_recording_that_ends_before_the_goal_opens_is_refused() {
    for (count, goal, words) in [
        (
            2,
            [60, 70],
            ["0.1 s is recorded", "the goal opens at 6.0 s"],
        ),
        (
            1,
            [60, 70],
            ["0.0 s is recorded", "the goal opens at 6.0 s"],
        ),
        (
            50,
            [60, 70],
            ["4.9 s is recorded", "the goal opens at 6.0 s"],
        ),
        (
            10,
            [0, 9],
            ["0.9 s is recorded", "less than 1.0 s is no round"],
        ),
        (1, [0, 0], ["0.0 s is recorded", "nothing to replay"]),
    ] {
        let mini = Mini {
            obstacles: car(10, &drive(40.0, 10.0, count)),
            problems: problem(900, [0.0, 0.0], goal, ""),
            ..Mini::default()
        };
        let refused_at = format!("<initialState>{}", state([0.0, 0.0], 0.0, 0, 10.0));
        refused(&mini, &refused_at, &words);
    }
    for (count, goal) in [(11, [0, 9]), (61, [60, 70])] {
        let mini = Mini {
            obstacles: car(10, &drive(40.0, 10.0, count)),
            problems: problem(900, [0.0, 0.0], goal, ""),
            ..Mini::default()
        };
        let (world, _) = driven(&mini);
        assert!(world.time_s() >= f64::from(count - 1) * 0.1 - 1e-9);
    }
}

#[test]
fn a_bad_lanelet_is_left_out_and_named() {
    let whole = || lanelet(1, [-20.0, 180.0], 0.0, "");
    let bad = bad_lanelet(2, [-20.0, 180.0], "<successor ref=\"1\"/>");
    for lanelets in [format!("{}{bad}", whole()), format!("{bad}{}", whole())] {
        let (_, notes) = driven(&Mini {
            lanelets,
            ..Mini::default()
        });
        assert!(notes.starts_with("left out: lanelet 2 (line "), "{notes}");
        assert!(
            notes.contains("<rightBound>: the bound is 0.000"),
            "{notes}"
        );
    }
    // So is a link to itself, and nothing else of that lanelet.
    for (link, word) in [
        ("<predecessor ref=\"1\"/>", "predecessor"),
        ("<successor ref=\"1\"/>", "successor"),
        ("<adjacentLeft ref=\"1\" drivingDir=\"same\"/>", "neighbour"),
        (
            "<adjacentRight ref=\"1\" drivingDir=\"opposite\"/>",
            "neighbour",
        ),
    ] {
        let lanelets = lanelet(1, [-20.0, 180.0], 0.0, link);
        let (_, notes) = driven(&Mini {
            lanelets,
            ..Mini::default()
        });
        assert!(
            notes.starts_with(&format!("left out: lanelet 1 as its own {word} (line ")),
            "{notes}"
        );
    }
}

#[test]
fn a_bad_lanelet_that_the_route_needs_is_refused() {
    let first = |links: &str| lanelet(1, [-20.0, 60.0], 0.0, links);
    let last = || lanelet(3, [120.0, 180.0], 0.0, "");
    let to_2 = "<successor ref=\"2\"/>";
    let in_3 = problem(
        900,
        [0.0, 0.0],
        [25, 30],
        "<position><lanelet ref=\"3\"/></position>",
    );
    // Behind the start's, whichever of the two states the link.
    for lanelets in [
        format!("{}{}", first(to_2), bad_lanelet(2, [60.0, 120.0], "")),
        format!(
            "{}{}",
            first(""),
            bad_lanelet(2, [60.0, 120.0], "<predecessor ref=\"1\"/>")
        ),
    ] {
        let mini = Mini {
            lanelets,
            ..Mini::default()
        };
        refused(
            &mini,
            "<rightBound><point><x>300<",
            &["<rightBound>", "leads over lanelet 2"],
        );
    }
    // On the only way to the goal: the straight way on is another.
    let fork = first("<successor ref=\"2\"/><successor ref=\"4\"/>");
    let mini = Mini {
        lanelets: format!(
            "{fork}{}{}{}",
            bad_lanelet(2, [60.0, 120.0], "<successor ref=\"3\"/>"),
            last(),
            lanelet(4, [60.0, 180.0], 4.0, "")
        ),
        problems: in_3.clone(),
        ..Mini::default()
    };
    refused(
        &mini,
        "<rightBound><point><x>300<",
        &["leads over lanelet 2"],
    );
    // The goal itself.
    let mini = Mini {
        lanelets: format!(
            "{}{}",
            lanelet(1, [-20.0, 180.0], 0.0, ""),
            bad_lanelet(3, [120.0, 180.0], "")
        ),
        problems: in_3,
        ..Mini::default()
    };
    refused(
        &mini,
        "<rightBound><point><x>300<",
        &["lanelet 3 is the ego car's goal"],
    );
    // The start's: nothing else lies there.
    let mini = Mini {
        lanelets: format!(
            "{}{}",
            bad_lanelet(1, [-20.0, 60.0], ""),
            lanelet(3, [120.0, 180.0], 0.0, "")
        ),
        ..Mini::default()
    };
    refused(
        &mini,
        "<initialState><position><point><x>0<",
        &["on no lane", "left out: lanelet 1"],
    );
    // All there is.
    let mini = Mini {
        lanelets: bad_lanelet(1, [-20.0, 60.0], ""),
        ..Mini::default()
    };
    refused(
        &mini,
        "<rightBound><point><x>300<",
        &["<rightBound>", "m long"],
    );
}

#[test]
fn the_recorded_ego_car_is_left_out() {
    let others = car(11, &drive(50.0, 10.0, 31));
    for (x, speed) in [(0.0, 10.0), (0.2, 9.8)] {
        let obstacles = format!("{}{others}", car(10, &drive(x, speed, 31)));
        let (world, notes) = driven(&Mini {
            obstacles,
            ..Mini::default()
        });
        assert_eq!(world.end(), End::OutOfTime);
        assert_eq!(notes, "left out: car 10, the recorded ego car itself");
        assert_eq!(world.objects().len(), 1);
    }
    // Alone on the road it is no traffic: the round lasts until the goal's end.
    let (world, notes) = driven(&Mini {
        obstacles: car(10, &drive(0.0, 10.0, 2)),
        ..Mini::default()
    });
    assert!(
        world.time_s() >= 3.0 - 1e-9 && notes.contains("no car moves"),
        "{notes}"
    );
}

#[test]
fn anything_else_where_the_ego_car_starts_is_refused() {
    for obstacles in [
        // As fast and elsewhere; in the same place and slower.
        car(10, &drive(2.0, 10.0, 31)),
        car(10, &drive(0.0, 4.0, 31)),
        format!(
            "{}{}",
            car(9, &drive(0.0, 10.0, 31)),
            car(10, &drive(0.1, 10.0, 31))
        ),
    ] {
        let mini = Mini {
            obstacles,
            ..Mini::default()
        };
        refused(
            &mini,
            "<dynamicObstacle id=\"10\"",
            &["<dynamicObstacle>", "car 10", "where the ego car starts"],
        );
    }
    let mini = Mini {
        obstacles: parked(10, 3.0),
        ..Mini::default()
    };
    refused(
        &mini,
        "<staticObstacle",
        &["parkedVehicle 10", "where the ego car starts"],
    );
    // Not before the car comes, nor once it has left.
    let mut late = drive(-12.0, 10.0, 31);
    late.iter_mut().for_each(|state| state.0 += 12);
    let mini = Mini {
        obstacles: format!("{}{}", car(10, &drive(40.0, 10.0, 31)), car(12, &late)),
        ..Mini::default()
    };
    assert!(scene(&mini).is_ok());
}

#[test]
fn a_start_on_no_lane_is_refused() {
    for start in [
        [0.0, 200.0],
        [0.0, 2.3],
        [0.0, -9.0],
        [-24.0, 0.0],
        [400.0, 0.0],
    ] {
        let mini = Mini {
            problems: problem(900, start, [25, 30], ""),
            ..Mini::default()
        };
        refused(
            &mini,
            &format!("<initialState><position><point><x>{}<", start[0]),
            &["<initialState>", "on no lane"],
        );
    }
    let mini = Mini {
        problems: problem(900, [0.0, 2.05], [25, 30], ""),
        obstacles: String::new(),
        ..Mini::default()
    };
    assert!(scene(&mini).is_ok());
    let mini = Mini {
        problems: problem(900, [180.0, 0.0], [25, 30], ""),
        ..Mini::default()
    };
    refused(
        &mini,
        "<initialState><position><point><x>180<",
        &["where the map ends"],
    );
}

#[test]
fn what_is_passed_over_is_said_in_one_line() {
    let light = "<trafficLight id=\"50\"><cycle/></trafficLight>\n";
    let problems = format!(
        "{}{}",
        Mini::default().problems,
        problem(901, [80.0, 0.0], [25, 30], "")
    );
    let mini = Mini {
        others: light.to_owned(),
        problems: problems.clone(),
        ..Mini::default()
    };
    assert_eq!(driven(&mini).1, "problem 1 of 2; left out: 1 traffic light");
    let sign = |id: u32| format!("<trafficSign id=\"{id}\"/>");
    let stop = "<stopLine><lineMarking>solid</lineMarking></stopLine><trafficLightRef ref=\"50\"/><successor ref=\"77\"/>";
    let mini = Mini {
        lanelets: lanelet(1, [-20.0, 180.0], 0.0, stop),
        others: format!("{light}{}{}<intersection id=\"53\"/>", sign(51), sign(52)),
        ..Mini::default()
    };
    assert_eq!(
        driven(&mini).1,
        "left out: 1 traffic light, 2 traffic signs, 1 stop line, 1 intersection, 1 link to lanelets that the file lacks"
    );
}

/// The inputs beside the project that showed each of these.
#[test]
fn the_small_inputs_behave_as_they_should() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/cases/commonroad");
    if !folder.is_dir() {
        let why = format!("there is no {}", folder.display());
        testing::skipped("the_small_inputs_behave_as_they_should", &why);
        return;
    }
    for (file, said) in [
        ("ok.xml", ""),
        ("repeat-first.xml", "left out: 1 state said again"),
        (
            "static-only.xml",
            "no car moves: the round lasts until the goal's last time step, 3.0 s",
        ),
        (
            "empty-road.xml",
            "no car moves: the round lasts until the goal's last time step, 3.0 s",
        ),
        (
            "own-pred.xml",
            "left out: lanelet 1 as its own predecessor (line 3)",
        ),
        (
            "short-bound.xml",
            "left out: lanelet 2 (line 4: <rightBound>: the bound is 0.0009",
        ),
        (
            "start-in-car.xml",
            "left out: car 10, the recorded ego car itself",
        ),
        ("two-problems.xml", "problem 1 of 2"),
        ("redlight.xml", "left out: 1 traffic light, 1 stop line"),
    ] {
        let scene = Scene::load(&folder.join(file)).unwrap_or_else(|error| panic!("{error}"));
        let notes = scene.course.unwrap().notes.join("; ");
        assert!(notes.starts_with(said), "{file}: {notes}");
    }
    for (file, said) in [
        (
            "short.xml",
            "short.xml:5: <initialState>: 0.1 s is recorded after the start, and the goal opens at 6.0 s",
        ),
        (
            "off-road.xml",
            "off-road.xml:5: <initialState>: the ego car starts at (0, 200), which is on no lane",
        ),
    ] {
        let error = Scene::load(&folder.join(file)).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
}

#[test]
fn recorded_scenes_of_every_road_are_driven() {
    for file in ngsim_files() {
        let scene = Scene::load(&file).unwrap_or_else(|error| panic!("{error}"));
        println!(
            "{}: {}",
            scene.name,
            scene.course.as_ref().unwrap().notes.join("; ")
        );
        let mut world = World::new(Arc::new(scene)).unwrap();
        while world.end() == End::Running {
            world.step([0.0, 0.0]);
        }
        assert!(
            world.time_s() >= 0.9,
            "{}: {:?} after {} s",
            file.display(),
            world.end(),
            world.time_s()
        );
    }
}
