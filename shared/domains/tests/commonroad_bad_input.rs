//! What cannot be read is refused with file, line and element: broken, hostile and mutated files never panic or hang.

mod commonroad_data;

use commonroad_data::{FIXTURE_2018B, FIXTURE_2020A, real_files};
use domains::commonroad::{CommonRoadError, Scenario};
use domains::highway::{End, World};
use proptest::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// The error that a changed fixture gives; `{}` shows file, line and element.
fn refused(text: &str) -> String {
    match Scenario::parse(text.as_bytes(), "some.xml") {
        Ok(_) => panic!("was read"),
        Err(error) => error.to_string(),
    }
}

fn changed(from: &str, to: &str) -> String {
    assert!(FIXTURE_2020A.contains(from), "the fixture has no {from:?}");
    FIXTURE_2020A.replacen(from, to, 1)
}

fn line_of(text: &str, part: &str) -> usize {
    1 + text[..text.find(part).unwrap()].matches('\n').count()
}

#[test]
fn errors_name_file_line_and_element() {
    for (from, to, element, said) in [
        ("<x>50.0</x>", "<x>fifty</x>", "x", "not a number"),
        ("<x>50.0</x>", "<x>NaN</x>", "x", "out of range"),
        ("<x>50.0</x>", "<x>inf</x>", "x", "out of range"),
        ("<x>50.0</x>", "<x>1e300</x>", "x", "out of range"),
        ("<x>50.0</x>", "<x></x>", "x", "is empty"),
        ("<point><x>50.0</x>", "<point>", "point", "<x> is missing"),
        (
            "<successor ref=\"2\"/>",
            "<successor ref=\"two\"/>",
            "successor",
            "not a whole number",
        ),
        (
            "<successor ref=\"2\"/>",
            "<successor/>",
            "successor",
            "\"ref\" is missing",
        ),
        (
            "drivingDir=\"same\"",
            "drivingDir=\"up\"",
            "adjacentLeft",
            "neither same nor opposite",
        ),
        (
            "<lanelet id=\"2\">",
            "<lanelet id=\"1\">",
            "lanelet",
            "stands already at line 3",
        ),
        (
            "<dynamicObstacle id=\"11\">",
            "<dynamicObstacle id=\"1\">",
            "dynamicObstacle",
            "stands already",
        ),
        (
            "<dynamicObstacle id=\"11\">",
            "<dynamicObstacle id=\"-4\">",
            "dynamicObstacle",
            "not between 0",
        ),
        (
            "<dynamicObstacle id=\"11\">",
            "<dynamicObstacle id=\"99999999999\">",
            "dynamicObstacle",
            "not between",
        ),
        (
            "<length>4.5</length>",
            "<length>0</length>",
            "length",
            "not between 0",
        ),
        (
            "<length>4.5</length>",
            "<length>-1</length>",
            "length",
            "not between 0",
        ),
        (
            "<rectangle><length>4.5</length>",
            "<rectangle>",
            "rectangle",
            "<length> is missing",
        ),
        (
            "<orientation><exact>0.0</exact></orientation>",
            "",
            "initialState",
            "<orientation> is missing",
        ),
        (
            "<time><exact>1</exact></time>",
            "<time><exact>0</exact></time>",
            "state",
            "contradicts an earlier state at time step 0",
        ),
        (
            "<time><exact>1</exact></time>",
            "<time><exact>1.5</exact></time>",
            "time",
            "not a time step",
        ),
        (
            "<time><exact>1</exact></time>",
            "<time><exact>1e7</exact></time>",
            "time",
            "not a time step",
        ),
        (
            "<velocity><exact>10.0</exact>",
            "<velocity><exact>1000</exact>",
            "velocity",
            "out of range",
        ),
        (
            "timeStepSize=\"0.1\"",
            "timeStepSize=\"0\"",
            "commonRoad",
            "not between",
        ),
        ("timeStepSize=\"0.1\"", "", "commonRoad", "missing"),
        (
            "<trajectory>",
            "<occupancySet/><trajectory>",
            "occupancySet",
            "nothing to replay",
        ),
        (
            "<circle>",
            "<truckShape/><circle>",
            "truckShape",
            "not a shape",
        ),
        (
            "<intervalStart>5</intervalStart>",
            "<intervalStart>50</intervalStart>",
            "time",
            "is empty",
        ),
        (
            "<lanelet ref=\"2\"/>",
            "<lanelet ref=\"77\"/>",
            "planningProblem",
            "lacks",
        ),
        (
            "<scenarioTags>",
            "<teapot/><scenarioTags>",
            "teapot",
            "not an element",
        ),
    ] {
        let text = changed(from, to);
        let message = refused(&text);
        assert!(message.starts_with("some.xml:"), "{message}");
        assert!(
            message.contains(&format!("<{element}>")),
            "{to:?}: {message}"
        );
        assert!(message.contains(said), "{to:?}: {message}");
        let line: usize = message.split(':').nth(1).unwrap().parse().unwrap();
        assert!(line >= 1 && line <= text.lines().count(), "{message}");
        if !to.is_empty() && to.starts_with('<') && element == "x" {
            assert_eq!(line, line_of(&text, to), "{message}");
        }
    }
}

#[test]
fn a_start_on_a_lanelet_without_length_is_refused() {
    let from = FIXTURE_2020A.find("<leftBound>").unwrap();
    let to = FIXTURE_2020A.find("</leftBound>").unwrap();
    let point = "<point><x>1</x><y>2</y></point>";
    let text = format!(
        "{}<leftBound>{point}{point}{}",
        &FIXTURE_2020A[..from],
        &FIXTURE_2020A[to..]
    );
    // Lanelet 1 goes; the ego car starts on 3, and no longer where 1 was.
    let read = Scenario::parse(text.as_bytes(), "some.xml").unwrap();
    assert!(
        read.left_out
            .iter()
            .any(|words| words.contains("lanelet 1") && words.contains("0 m long"))
    );
    assert!(read.course(None).is_ok());
    let moved = text.replace("<x>10.0</x><y>5.25</y>", "<x>10.0</x><y>1.75</y>");
    let read = Scenario::parse(moved.as_bytes(), "some.xml").unwrap();
    let message = read.course(None).unwrap_err().to_string();
    assert!(
        message.contains("<initialState>") && message.contains("lanelet 1"),
        "{message}"
    );
}

#[test]
fn other_versions_are_refused_by_name() {
    for version in ["2017a", "2021a", "", "2020A"] {
        let message = refused(&changed("\"2020a\"", &format!("\"{version}\"")));
        assert!(
            message.contains(&format!("{version:?}")) && message.contains("2018b"),
            "{message}"
        );
    }
}

#[test]
fn a_missing_file_and_other_documents_are_refused() {
    let error = Scenario::read(Path::new("/nowhere/some.xml")).unwrap_err();
    assert!(
        matches!(error, CommonRoadError::Io { .. })
            && error.to_string().contains("/nowhere/some.xml")
    );
    assert!(refused("<svg/>").contains("<svg>"));
    assert!(refused("").contains("some.xml:1"));
    // A document type could define entities that blow up.
    assert!(refused("<!DOCTYPE a [<!ENTITY b 'c'>]><commonRoad/>").contains("XML"));
    let error = Scenario::parse(b"<commonRoad>\n\xff\xfe</commonRoad>", "some.xml").unwrap_err();
    assert_eq!(error.to_string(), "some.xml:2: byte 13 is not UTF-8");
}

#[test]
fn deep_nesting_does_not_exhaust_the_stack() {
    let deep = |name: &str, times: usize| {
        format!(
            "{}{}",
            format!("<{name}>").repeat(times),
            format!("</{name}>").repeat(times)
        )
    };
    refused(&deep("a", 200_000));
    let group = deep("shapeGroup", 10_000);
    let message = refused(&changed("<circle><radius>1.0</radius></circle>", &group));
    assert!(message.contains("nested deeper"), "{message}");
}

#[test]
fn rings_of_lanelets_end() {
    // 1 → 2 → 1, as in a roundabout: read, and driven to the end of the recording.
    let text = changed(
        "<predecessor ref=\"1\"/>",
        "<predecessor ref=\"1\"/><successor ref=\"1\"/>",
    );
    run(&Scenario::parse(text.as_bytes(), "ring.xml").unwrap());
}

#[test]
fn a_scenario_that_cannot_be_driven_says_why() {
    let start = FIXTURE_2020A.find("<planningProblem").unwrap();
    let without = format!("{}</commonRoad>", &FIXTURE_2020A[..start]);
    let scenario = Scenario::parse(without.as_bytes(), "some.xml").unwrap();
    let message = scenario.course(None).unwrap_err().to_string();
    assert!(
        message.contains("some.xml") && message.contains("planningProblem"),
        "{message}"
    );
    let message = scenario.course(Some(4)).unwrap_err().to_string();
    assert!(
        message.contains("no recorded car 4") && message.contains("11"),
        "{message}"
    );
    assert!(scenario.course(Some(11)).is_ok());
    // The planning problem starts at step 15 or 20; car 13 is there from 4 to 14, car 11 until 20.
    let problem = FIXTURE_2020A.rfind("<time><exact>0</exact>").unwrap();
    let later = |step: u32| {
        let (before, after) = FIXTURE_2020A.split_at(problem);
        let text = format!("{before}{}", after.replacen(">0<", &format!(">{step}<"), 1));
        Scenario::parse(text.as_bytes(), "some.xml").unwrap()
    };
    let message = later(15).course(Some(13)).unwrap_err().to_string();
    assert!(message.contains("car 13 is gone"), "{message}");
    assert!((later(15).course(Some(11)).unwrap().duration_s - 0.5).abs() < 1e-9);
    let message = later(20).course(None).unwrap_err().to_string();
    assert!(message.contains("nothing to replay"), "{message}");
}

/// Drives a scenario to its end where it can be driven.
fn run(scenario: &Scenario) {
    for seat in [None, scenario.seats().first().copied()] {
        let Ok(mut scene) = scenario.scene(Some(15.0), seat) else {
            continue;
        };
        scene.episode.max_steps = scene.episode.max_steps.min(40);
        let mut world = World::new(Arc::new(scene)).unwrap();
        while world.end() == End::Running {
            world.step([0.5, 0.1]);
            assert!(
                world
                    .observation()
                    .ego
                    .iter()
                    .chain(&world.observation().range)
                    .all(|v| v.is_finite())
            );
        }
    }
    for id in scenario.seats().into_iter().take(2) {
        if let Ok(scene) = scenario.scene(None, Some(id)) {
            let found = scenario.recorded_actions(id, &scene).unwrap();
            assert!(
                found
                    .actions
                    .iter()
                    .flatten()
                    .all(|value| value.is_finite())
            );
        }
    }
}

/// What is read after a mutation must still run; what is not must say where.
fn survives(bytes: &[u8]) {
    match Scenario::parse(bytes, "mutated.xml") {
        Ok(scenario) => run(&scenario),
        Err(error) => assert!(error.to_string().starts_with("mutated.xml:"), "{error}"),
    }
}

fn mutated(original: &[u8], changes: &[(usize, u8)], cut: Option<usize>) -> Vec<u8> {
    let mut bytes = original.to_vec();
    for &(at, value) in changes {
        let at = at % bytes.len();
        bytes[at] = value;
    }
    if let Some(cut) = cut {
        bytes.truncate(cut % bytes.len());
    }
    bytes
}

/// Bytes that turn numbers into other numbers and tags into other tags.
fn telling_byte() -> impl Strategy<Value = u8> {
    prop_oneof![
        any::<u8>(),
        prop::sample::select(b"0123456789.-+eE<>/\"= \nNainf".to_vec())
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        prop_assert!(Scenario::parse(&bytes, "random.xml").is_err());
    }

    #[test]
    fn mutated_fixtures_never_panic(
        changes in prop::collection::vec((any::<usize>(), telling_byte()), 1..6),
        cut in prop::option::weighted(0.2, any::<usize>()),
        first in any::<bool>(),
    ) {
        let original = if first { FIXTURE_2018B } else { FIXTURE_2020A };
        survives(&mutated(original.as_bytes(), &changes, cut));
    }

    #[test]
    fn numbers_of_any_size_never_panic(which in any::<usize>(), number in prop_oneof![
        any::<f64>().prop_map(|v| v.to_string()),
        (-400i32..400).prop_map(|e| format!("-1e{e}")),
        Just("0".to_owned()), Just("-0.0".to_owned()), Just("1e8".to_owned()), Just("99999999".to_owned()),
    ]) {
        // Replaces the text of one element of the fixture.
        let places: Vec<_> = FIXTURE_2018B.match_indices("</").filter(|(at, _)| {
            FIXTURE_2018B[..*at].ends_with(|c: char| c.is_ascii_digit())
        }).map(|(at, _)| at).collect();
        let end = places[which % places.len()];
        let start = FIXTURE_2018B[..end].rfind('>').unwrap() + 1;
        survives(format!("{}{number}{}", &FIXTURE_2018B[..start], &FIXTURE_2018B[end..]).as_bytes());
    }
}

#[test]
fn mutated_recordings_never_panic() {
    use proptest::test_runner::{Config, TestRunner};
    for file in real_files() {
        let original = std::fs::read(&file).unwrap();
        let strategy = (
            prop::collection::vec((any::<usize>(), telling_byte()), 1..4),
            prop::option::weighted(0.3, any::<usize>()),
        );
        let config = Config {
            cases: 40,
            failure_persistence: None,
            ..Config::default()
        };
        TestRunner::new(config)
            .run(&strategy, |(changes, cut)| {
                survives(&mutated(&original, &changes, cut));
                Ok(())
            })
            .unwrap();
        for cut in (0..original.len()).step_by(original.len() / 23) {
            assert!(Scenario::parse(&original[..cut], "cut.xml").is_err());
        }
    }
}
