//! Scene and person files of the gridworlds: what ships, and what is said of files that are wrong.

use std::path::Path;

use domains::discrete::{Domain, Scene, Setting, SimulatedPerson, Words};
use domains::highway::FileError;
use domains::{bomb_defusal, driving, search_rescue};
use proptest::prelude::*;

fn scene(text: &str) -> Result<Scene, FileError> {
    Scene::from_toml(Path::new("some/scene.toml"), text)
}

fn message(text: &str) -> String {
    scene(text).unwrap_err().to_string()
}

const FOG: &str = include_str!("../../../launch/scenes/driving-fog.toml");
const SMOKE: &str = include_str!("../../../launch/scenes/search-smoke.toml");
const BOMB: &str = include_str!("../../../launch/scenes/bomb.toml");

/// The full files hold every key, with the values of the defaults in code.
#[test]
fn shipped_scenes_hold_the_defaults() {
    for (text, domain) in [
        (FOG, Domain::Driving),
        (SMOKE, Domain::SearchRescue),
        (BOMB, Domain::BombDefusal),
    ] {
        let scene = scene(text).unwrap();
        let default = Scene::of(domain, Setting::Transfer);
        let (written, expected) = match (&scene, &default) {
            (Scene::Driving(a), Scene::Driving(b)) => (to_table(&**a), to_table(&**b)),
            (Scene::SearchRescue(a), Scene::SearchRescue(b)) => (to_table(&**a), to_table(&**b)),
            (Scene::BombDefusal(a), Scene::BombDefusal(b)) => (to_table(&**a), to_table(&**b)),
            _ => unreachable!("same domain"),
        };
        let file: toml::Table = toml::from_str(text).unwrap();
        for (key, value) in &written {
            assert!(file.contains_key(key), "{key} is not in the file");
            if let (toml::Value::Table(inner), toml::Value::Table(in_file)) = (value, &file[key]) {
                assert!(inner.keys().eq(in_file.keys()), "[{key}] lacks a key");
            }
            if key != "name" {
                assert_eq!(value, &expected[key], "{key}");
            }
        }
    }
    let settings = ["driving", "driving-fog", "search", "search-smoke", "bomb"]
        .map(|name| Scene::builtin(name).unwrap())
        .map(|scene| (scene.name().to_owned(), scene.setting()));
    for (name, setting) in settings {
        let transfer = name != "driving" && name != "search";
        assert_eq!(setting == Setting::Transfer, transfer, "{name}");
    }
}

fn to_table<T: serde::Serialize>(value: &T) -> toml::Table {
    toml::from_str(&toml::to_string(value).unwrap()).unwrap()
}

#[test]
fn wrong_scenes_are_named_with_their_place() {
    let fog = |from: &str, to: &str| {
        assert!(FOG.contains(from));
        message(&FOG.replace(from, to))
    };
    let line = FOG.lines().position(|l| l.starts_with("wander")).unwrap() + 1;
    let unknown = fog("wander", "wonder");
    assert!(
        unknown.starts_with(&format!("some/scene.toml:{line}:1: unknown field `wonder`")),
        "{unknown}"
    );
    let range = fog("wander = 0.1", "wander = 1.5");
    assert_eq!(
        range,
        "some/scene.toml: traffic.wander is 1.5, expected 0 to 1"
    );
    let order = fog("farthest_cells = 8", "farthest_cells = 2");
    assert_eq!(
        order,
        "some/scene.toml: traffic.farthest_cells is 2, expected 4 to 10"
    );
    let elites = fog("elites = 20", "elites = 2000");
    assert_eq!(
        elites,
        "some/scene.toml: planning.elites is 2000, expected 1 to 100"
    );
    let domain = fog("\"driving\"", "\"sailing\"");
    assert!(
        domain.contains("some/scene.toml:4:10: unknown variant `sailing`"),
        "{domain}"
    );
    let button = message(&BOMB.replace("older = [[0, 1, 2", "older = [[0, 1, 3"));
    assert_eq!(
        button,
        "some/scene.toml: rules.older[0][2] is 3, expected 0 to 2"
    );
    let smoke = message(&SMOKE.replace("radius_cells = 1.5", "radius_cells = nan"));
    assert!(smoke.contains("smoke.radius_cells is NaN"), "{smoke}");
    assert!(message("name = 'x'").contains("missing field `domain`"));
    let absent = Scene::load(Path::new("no/such.toml"))
        .unwrap_err()
        .to_string();
    assert!(absent.starts_with("no/such.toml: "), "{absent}");
    let nobody = Scene::builtin("moon").unwrap_err().to_string();
    assert!(
        nobody.contains("highway-fog") && nobody.contains("search-smoke"),
        "{nobody}"
    );
}

#[test]
fn highway_scenes_are_told_apart() {
    let file = Path::new("x.toml");
    assert!(Scene::is_discrete(file, FOG).unwrap());
    let highway = include_str!("../../../launch/scenes/highway-fog.toml");
    assert!(!Scene::is_discrete(file, highway).unwrap());
    assert!(Scene::is_discrete(file, "domain = 3 = 4").is_err());
}

#[test]
fn all_people_load_and_nobody_else() {
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let words = Words::indicator(scene.sentences().len());
        for id in 1..=10 {
            SimulatedPerson::builtin(&scene, id, &words).unwrap();
        }
        for id in [0, 11, u32::MAX] {
            let error = SimulatedPerson::builtin(&scene, id, &words)
                .unwrap_err()
                .to_string();
            assert_eq!(
                error,
                format!("simulated people: id is {id}, expected 1 to 10")
            );
        }
        let too_few = Words::indicator(scene.sentences().len() + 1);
        assert!(SimulatedPerson::builtin(&scene, 1, &too_few).is_err());
    }
}

#[test]
fn wrong_people_are_named_with_their_place() {
    let file = Path::new("me.toml");
    let driver = include_str!("../people/driving/01.toml");
    let error = |text: String| {
        driving::Person::from_toml(file, &text)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        error(driver.replace("horizon = 8", "horizon = 17")),
        "me.toml: planning.horizon is 17, expected 1 to 16"
    );
    assert!(error(driver.replace("slip = ", "slap = ")).starts_with("me.toml:6:1: "));
    let searcher = include_str!("../people/search_rescue/01.toml");
    let text = searcher.replacen("[0.0000,", "[0.5000,", 1);
    let error = search_rescue::Person::from_toml(file, &text)
        .unwrap_err()
        .to_string();
    assert_eq!(error, "me.toml: searching[0][0] is 0.5, expected 0 to 0");
    let error = bomb_defusal::Person::from_toml(file, "id = 1\nnotice = 1.5").unwrap_err();
    assert_eq!(error.to_string(), "me.toml: notice is 1.5, expected 0 to 1");
}

#[test]
fn words_that_do_not_fit_are_refused() {
    assert!(Words::new(0, &[]).is_err());
    assert!(Words::new(3, &[0.0; 4]).is_err());
    let error = Words::new(2, &[0.0, 1.0, f32::NAN, 0.0])
        .unwrap_err()
        .to_string();
    assert_eq!(error, "words: NaN in sentence 1");
    let words = Words::new(2, &[0.0, 0.0, 1.0, 1.0]).unwrap();
    assert_eq!(
        (words.len(), words.width(), words.nearest(0..2, &[0.9, 0.7])),
        (2, 2, 1)
    );
}

proptest! {
    /// Whatever a file holds, it is read or refused; nothing panics.
    #[test]
    fn any_text_is_read_or_refused(text in ".{0,200}", cut in any::<prop::sample::Index>(), byte in any::<char>()) {
        let file = Path::new("x.toml");
        let _ = scene(&text);
        for good in [FOG, SMOKE, BOMB] {
            let mut broken: Vec<char> = good.chars().collect();
            let at = cut.index(broken.len());
            broken[at] = byte;
            let broken: String = broken.into_iter().collect();
            if let Ok(scene) = scene(&broken) {
                let words = Words::indicator(scene.sentences().len());
                prop_assert!(domains::discrete::World::new(&scene, &words).is_ok());
            }
        }
        let _ = driving::Person::from_toml(file, &text);
        let _ = search_rescue::Person::from_toml(file, &text);
        let _ = bomb_defusal::Person::from_toml(file, &text);
    }
}
