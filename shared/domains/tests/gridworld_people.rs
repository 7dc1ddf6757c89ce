//! Experts succeed; simulated people know what they perceived or were told, and nothing else.

use domains::Mask;
use domains::bomb_defusal::{self, Defuser};
use domains::discrete::{
    Discrete, Domain, End, Limits, Mind, Scene, Setting, SimulatedPerson, Words, World,
};
use domains::driving::{self, SimulatedDriver};
use domains::search_rescue::{self, Cell, Searcher, distances};

fn words_of(scene: &Scene) -> Words {
    Words::indicator(scene.sentences().len())
}

/// Plays rounds in all scenarios; returns (successes, collisions, reward, steps).
fn play(scene: &Scene, id: u32, rounds: u32, told: Mask) -> (u32, u32, f32, u32) {
    let words = words_of(scene);
    let mut world = World::new(scene, &words).unwrap();
    let mut person = SimulatedPerson::builtin(scene, id, &words).unwrap();
    let layout = world.layout().clone();
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut sums = (0, 0, 0.0, 0);
    for round in 0..rounds {
        world.reset(9, round, round);
        person.reset(9, round);
        while world.end().is_running() {
            world.observe(&mut visual, &mut verbal);
            let seen = person.look(&visual);
            person.perceive(&visual, &verbal, seen | told);
            let outcome = world.step(person.act());
            sums.1 += u32::from(outcome.collided);
            sums.2 += outcome.reward;
            sums.3 += 1;
        }
        sums.0 += u32::from(world.end() == End::Success);
    }
    sums
}

#[test]
fn experts_succeed_in_every_scenario() {
    for domain in Domain::ALL {
        for setting in [Setting::Original, Setting::Transfer] {
            let scene = Scene::of(domain, setting);
            let mut world = World::new(&scene, &words_of(&scene)).unwrap();
            for episode in 0..50 {
                for scenario in 0..world.scenarios() {
                    world.reset(7, episode, scenario);
                    while world.end().is_running() {
                        let action = world.expert();
                        assert!(world.legal(action));
                        world.step(action);
                    }
                    assert_eq!(world.end(), End::Success, "{domain:?} {episode} {scenario}");
                }
            }
        }
    }
}

#[test]
fn the_searching_expert_takes_the_shortest_way_and_the_defusing_one_three_steps() {
    let scene = Scene::of(Domain::SearchRescue, Setting::Original);
    let World::SearchRescue(mut world) = World::new(&scene, &words_of(&scene)).unwrap() else {
        unreachable!()
    };
    for scenario in 0..9 {
        world.reset(0, 0, scenario);
        let blocked = world.obstacle().blocked();
        let there = distances(Cell::PLACES[world.place()], blocked)[Cell::ENTRANCE.index()];
        let mut reward = 0.0;
        while world.end().is_running() {
            reward += world.step(world.expert()).reward;
        }
        assert_eq!(world.steps(), 2 * u32::from(there));
        assert!((reward - (16.0 - 0.1 * world.steps() as f32)).abs() < 1e-4);
    }
    let scene = Scene::of(Domain::BombDefusal, Setting::Original);
    let World::BombDefusal(mut world) = World::new(&scene, &words_of(&scene)).unwrap() else {
        unreachable!()
    };
    let rewards: Vec<f32> = (0..3).map(|_| world.step(world.expert()).reward).collect();
    assert_eq!((rewards, world.end()), (vec![4.0; 3], End::Success));
}

/// The effect that an assistant is for, as differences over all ten people; the numbers are printed by
/// `examples/measure_gridworlds.rs`.
#[test]
fn fog_and_smoke_hurt_and_being_told_helps() {
    for domain in [Domain::Driving, Domain::SearchRescue] {
        let reward = |setting, told: bool| -> f32 {
            let scene = Scene::of(domain, setting);
            let mask = match told {
                true => {
                    World::new(&scene, &words_of(&scene))
                        .unwrap()
                        .layout()
                        .communicable
                }
                false => Mask::NONE,
            };
            (1..=10).map(|id| play(&scene, id, 72, mask).2).sum()
        };
        let clear = reward(Setting::Original, false);
        let hidden = reward(Setting::Transfer, false);
        let told = reward(Setting::Transfer, true);
        assert!(
            clear > hidden && told > hidden,
            "{domain:?}: {clear} {hidden} {told}"
        );
    }
    let scene = Scene::of(Domain::BombDefusal, Setting::Transfer);
    let everything = Mask {
        visual: 0x3f,
        verbal: 1,
    };
    for id in 1..=10 {
        let (alone, told) = (
            play(&scene, id, 20, Mask::NONE),
            play(&scene, id, 20, everything),
        );
        assert_eq!(
            told.0, 20,
            "who is shown and told all presses three right buttons"
        );
        assert_eq!(told.3, 60, "at once");
        assert!(told.2 > alone.2);
    }
}

#[test]
fn searchers_see_obstacles_before_they_run_into_them() {
    for setting in [Setting::Original, Setting::Transfer] {
        for id in 1..=10 {
            let (successes, collisions, ..) = play(
                &Scene::of(Domain::SearchRescue, setting),
                id,
                90,
                Mask::NONE,
            );
            assert_eq!((successes, collisions), (90, 0), "person {id}");
        }
    }
}

#[test]
fn a_driver_who_was_told_once_remembers() {
    let Scene::Driving(scene) = Scene::of(Domain::Driving, Setting::Transfer) else {
        unreachable!()
    };
    let person = driving::Person::builtin(1).unwrap();
    let mut driver = SimulatedDriver::new(&person, &scene);
    driver.reset(1, 1);
    // A car rushes up behind in the own (left) lane, 4 cells away; nothing else is known.
    let visual = [-1.0, 0.9, 0.9, -0.4, -0.9];
    let verbal = [0.9, 0.0, 0.9, 0.0, -0.4, 1.0, -0.9, 0.0];
    let mut unaware = driver.clone();
    let rear_left = Mask {
        visual: 0,
        verbal: 0b0100,
    };
    assert_eq!(driver.look(&visual), Mask::NONE, "fog hides all of them");
    driver.perceive(&visual, &verbal, rear_left);
    unaware.perceive(&visual, &verbal, Mask::NONE);
    assert_eq!(driver.believed_cells(), [None, None, Some(-4.0), None]);
    for step in 1..=3 {
        driver.acted(driving::STAY);
        unaware.acted(driving::STAY);
        driver.perceive(&visual, &verbal, Mask::NONE);
        unaware.perceive(&visual, &verbal, Mask::NONE);
        assert_eq!(driver.believed_cells()[2], Some(step as f32 - 4.0));
    }
    let (mut p, mut q) = ([0.0; 2], [0.0; 2]);
    driver.probabilities(&mut p);
    unaware.probabilities(&mut q);
    assert!(p[driving::SWITCH] > 0.8, "{p:?}");
    // (This person likes the right lane anyway.)
    assert!(q[driving::SWITCH] < p[driving::SWITCH] - 0.2, "{q:?} {p:?}");
}

/// Seeing a car twice tells its speed; not seeing it where it should be tells that it is not there.
#[test]
fn a_driver_infers_speed_and_absence() {
    let Scene::Driving(scene) = Scene::of(Domain::Driving, Setting::Original) else {
        unreachable!()
    };
    let mut driver = SimulatedDriver::new(&driving::Person::builtin(2).unwrap(), &scene);
    driver.reset(1, 1);
    let front_left = Mask {
        visual: 1,
        verbal: 0,
    };
    driver.perceive(&[-1.0, 0.6, 0.0, 0.0, 0.0], &[0.0; 8], front_left);
    driver.acted(driving::STAY);
    driver.perceive(&[-1.0, 0.5, 0.0, 0.0, 0.0], &[0.0; 8], front_left);
    driver.acted(driving::STAY);
    assert_eq!(
        driver.believed_cells()[0],
        Some(4.0),
        "it loses a cell a step"
    );
    // In clear weather everything is in sight, so what is not seen is gone.
    driver.perceive(&[-1.0, 0.4, 0.0, 0.0, 0.0], &[0.0; 8], Mask::NONE);
    assert_eq!(driver.believed_cells()[0], None);
}

#[test]
fn a_searcher_who_was_told_goes_straight_there() {
    let Scene::SearchRescue(scene) = Scene::of(Domain::SearchRescue, Setting::Transfer) else {
        unreachable!()
    };
    let words = Words::indicator(search_rescue::SENTENCES.len());
    let mut world = search_rescue::World::new(&scene, &words).unwrap();
    let mut person = search_rescue::Person::builtin(1).unwrap();
    person.slip = 0.0;
    let mut searcher = Searcher::new(&person, &scene, &words).unwrap();
    let (mut visual, mut verbal) = (
        vec![0.0; world.layout().visual],
        vec![0.0; world.layout().verbal],
    );
    // One utterance about the victim's place and one about the blocked corridor, at the start only.
    for scenario in 0..9u32 {
        world.reset(0, 0, scenario);
        searcher.reset(u64::from(scenario), 0);
        let mut told = Mask {
            visual: 0,
            verbal: 1 << world.place() | 0b11000,
        };
        while world.end().is_running() {
            world.observe(&mut visual, &mut verbal);
            let seen = searcher.look(&visual);
            searcher.perceive(&visual, &verbal, seen | told);
            if !world.found() {
                assert_eq!(searcher.victim_known()[world.place()], Some(true));
            }
            told = Mask::NONE;
            world.step(searcher.act());
        }
        let place = Cell::PLACES[world.place()];
        let open = world.obstacle().blocked();
        let by = |corridor: usize| {
            let other = 1 << (1 - corridor) | open;
            u32::from(distances(place, other)[Cell::ENTRANCE.index()])
        };
        let longest = (0..2).filter(|c| open >> c & 1 == 0).map(by).max().unwrap();
        assert!(
            world.steps() <= 2 * longest,
            "scenario {scenario}: {}",
            world.steps()
        );
        assert_eq!(world.end(), End::Success);
    }
}

/// The draws of `act` follow `probabilities`, also where the next subgoal is not chosen yet.
#[test]
fn acts_follow_their_probabilities() {
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let words = words_of(&scene);
        let mut world = World::new(&scene, &words).unwrap();
        world.reset(1, 2, 1);
        let layout = world.layout().clone();
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        world.observe(&mut visual, &mut verbal);
        let mut person = SimulatedPerson::builtin(&scene, 3, &words).unwrap();
        person.reset(1, 2);
        let seen = Mask {
            visual: layout.everything().visual,
            verbal: 0,
        };
        person.perceive(&visual, &verbal, seen);
        let mut p = vec![0.0; layout.actions.rows()];
        person.clone().probabilities(&mut p);
        let draws = 4000;
        let mut counts = vec![0u32; layout.actions.rows()];
        for draw in 0..draws {
            let mut copy = person.clone();
            copy.reseed(11, 0, draw);
            counts[copy.act()] += 1;
        }
        for (count, p) in counts.iter().zip(&p) {
            let deviation = (f64::from(*p) * (1.0 - f64::from(*p)) / draws as f64).sqrt();
            let off = (f64::from(*count) / draws as f64 - f64::from(*p)).abs();
            // The cross-entropy method searches anew in every draw: a driver's probabilities move a little with it.
            let search = if domain == Domain::Driving { 0.02 } else { 0.0 };
            assert!(
                off <= 5.0 * deviation + search,
                "{domain:?}: {counts:?} {p:?}"
            );
        }
    }
}

/// Somebody's actions over some rounds.
fn actions_of(scene: &Scene, person: &mut dyn Mind) -> Vec<usize> {
    let mut world = World::new(scene, &words_of(scene)).unwrap();
    let layout = world.layout().clone();
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut actions = Vec::new();
    for round in 0..12 {
        world.reset(9, round, round);
        person.reset(9, round);
        while world.end().is_running() {
            world.observe(&mut visual, &mut verbal);
            let seen = person.look(&visual);
            person.perceive(&visual, &verbal, seen);
            actions.push(person.act());
            world.step(actions[actions.len() - 1]);
        }
    }
    actions
}

/// Person 1 by another number.
fn first_as(id: u32, scene: &Scene) -> Box<dyn Mind> {
    let words = words_of(scene);
    match scene {
        Scene::Driving(scene) => {
            let mut person = driving::Person::builtin(1).unwrap();
            person.id = id;
            Box::new(SimulatedDriver::new(&person, scene))
        }
        Scene::SearchRescue(scene) => {
            let mut person = search_rescue::Person::builtin(1).unwrap();
            person.id = id;
            Box::new(Searcher::new(&person, scene, &words).unwrap())
        }
        Scene::BombDefusal(scene) => {
            let mut person = bomb_defusal::Person::builtin(1).unwrap();
            person.id = id;
            Box::new(Defuser::new(&person, scene, &words).unwrap())
        }
    }
}

#[test]
fn people_of_the_same_parameters_are_different_people() {
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let play = |id: u32| actions_of(&scene, first_as(id, &scene).as_mut());
        let all: Vec<_> = (1..=10).map(play).collect();
        for (i, one) in all.iter().enumerate() {
            assert_eq!(*one, play(1 + i as u32), "{domain:?} is not repeatable");
            for (j, other) in all.iter().enumerate().skip(i + 1) {
                assert_ne!(one, other, "{} and {} in {domain:?}", i + 1, j + 1);
            }
        }
    }
}

#[test]
fn terminals_are_found_after_a_geometric_time() {
    let Scene::BombDefusal(scene) = Scene::of(Domain::BombDefusal, Setting::Transfer) else {
        unreachable!()
    };
    let words = Words::indicator(2);
    let world = bomb_defusal::World::new(&scene, &words).unwrap();
    let person = bomb_defusal::Person::builtin(4).unwrap();
    let p = f64::from(person.notice);
    let mut defuser = Defuser::new(&person, &scene, &words).unwrap();
    assert!(matches!(defuser.sight().limits, Limits::Probabilities(q) if q == [person.notice; 6]));
    let (mut visual, mut verbal) = (vec![0.0; world.layout().visual], vec![0.0; 2]);
    world.observe(&mut visual, &mut verbal);
    let rounds = 3000;
    let mut total = 0u32;
    for round in 0..rounds {
        defuser.reset(5, round);
        while defuser.live_known().is_none() {
            let seen = defuser.look(&visual);
            defuser.perceive(&visual, &verbal, seen);
            let mut waits = [0.0; 4];
            defuser.probabilities(&mut waits);
            assert_eq!(
                waits[bomb_defusal::WAIT] == 1.0,
                defuser.live_known().is_none()
            );
            total += 1;
        }
        assert_eq!(defuser.live_known(), Some(world.live()));
        let mut presses = [0.0; 4];
        defuser.probabilities(&mut presses);
        for kind in 0..2 {
            assert_eq!(
                presses[scene.rules.newer[kind][world.live()] as usize],
                0.5,
                "the type is guessed"
            );
        }
    }
    let mean = f64::from(total) / f64::from(rounds);
    let error = ((1.0 - p).sqrt() / p) / f64::from(rounds).sqrt();
    assert!(
        (mean - 1.0 / p).abs() < 4.0 * error,
        "{mean} for {}",
        1.0 / p
    );
}

#[test]
fn perceptual_truths_are_the_papers() {
    for (setting, cells, radius) in [
        (Setting::Original, [10.0; 4], 18.0),
        (Setting::Transfer, [2.0, 2.0, 0.0, 0.0], 1.5),
    ] {
        let sight = |domain| {
            let scene = Scene::of(domain, setting);
            *SimulatedPerson::builtin(&scene, 1, &words_of(&scene))
                .unwrap()
                .sight()
        };
        assert_eq!(sight(Domain::Driving).limits, Limits::Thresholds(cells));
        let search = sight(Domain::SearchRescue);
        assert_eq!(search.limits, Limits::Radius(radius));
        let hears_all = setting == Setting::Original;
        assert_eq!(search.heard, if hears_all { 0x1f } else { 0 });
    }
}
