//! The planner against people whose reactions are known, in a world small enough to compute by hand: the reward of a step
//! is the throttle of the step before.

mod support;

use domains::highway::SECTORS;
use domains::highway::modalities::layout;
use models::imagined::ImaginedGroups;
use models::{Beliefs, Communicated, Posterior, SelfHuman, SelfModel, Sizes};
use nn::Tensor;
use planning::planner::{BITS, GROUPS, Planner};
use planning::{Decision, LocalPeople, PeopleError, RaceSettings, Settings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use support::{Answers, Start, World, allocations};

fn settings() -> Settings {
    // Costs that a few iterations can tell from nothing.
    let costs = Settings {
        visual_cost: 0.5,
        verbal_cost: 0.4,
        ..Settings::default()
    };
    Settings {
        samples: 200,
        futures: 1,
        iterations: 6,
        elites: 30,
        terminal_value: false,
        ..costs
    }
}

fn decide(settings: Settings, people: &mut Answers, start: Start) -> Decision {
    decide_in(&World::new(), settings, people, start)
}

fn decide_in(world: &World, settings: Settings, people: &mut Answers, start: Start) -> Decision {
    let mut planner = Planner::new(settings, &world.model);
    planner
        .plan(&world.model, world.from(start), people)
        .expect("these people answer")
}

#[test]
fn what_helps_is_said_and_nothing_else() {
    for sector in 0..SECTORS {
        let said = decide(
            settings(),
            &mut Answers::listening_for(Communicated::new(0, 1 << sector)),
            Start::default(),
        );
        assert_eq!(
            said.communicated,
            Communicated::new(0, 1 << sector),
            "{said:?}"
        );
        assert!((said.cost - 0.4).abs() < 1e-6);
    }
    // The display reaches the front half only.
    for (sector, azimuths) in [(0, 1.0), (1, 9.0), (5, 9.0)] {
        let shown = decide(
            settings(),
            &mut Answers::listening_for(Communicated::new(1 << sector, 0)),
            Start::default(),
        );
        assert_eq!(
            shown.communicated,
            Communicated::new(1 << sector, 0),
            "{shown:?}"
        );
        assert!((shown.cost - 0.5 * azimuths).abs() < 1e-6);
    }
    for sector in [2, 3, 4] {
        let shown = decide(
            settings(),
            &mut Answers::listening_for(Communicated::new(1 << sector, 0)),
            Start::default(),
        );
        assert_eq!(shown.communicated, Communicated::default(), "{shown:?}");
    }
}

#[test]
fn help_that_costs_more_than_it_brings_is_not_given() {
    let listening = || Answers::listening_for(Communicated::new(0, 1 << 2));
    let dear = Settings {
        verbal_cost: 1e4,
        visual_cost: 1e4,
        ..settings()
    };
    let decision = decide(dear, &mut listening(), Start::default());
    assert_eq!(
        decision.communicated,
        Communicated::default(),
        "{decision:?}"
    );
    assert_eq!(decision.cost, 0.0);
    let worthless = Settings {
        reward_weight: 0.0,
        ..settings()
    };
    let decision = decide(worthless, &mut listening(), Start::default());
    assert_eq!(
        decision.communicated,
        Communicated::default(),
        "{decision:?}"
    );
}

#[test]
fn people_who_do_not_listen_are_left_in_peace() {
    let decision = decide(settings(), &mut Answers::deaf(), Start::default());
    assert_eq!(
        decision.communicated,
        Communicated::default(),
        "{decision:?}"
    );
}

/// Two in five of these people are lucky: who values a candidate by one future takes their luck for its merit.
#[test]
fn luck_is_not_taken_for_help() {
    for (futures, elites, tells) in [(1, 30, true), (10, 3, false)] {
        let mut people = Answers::listening_for(Communicated::new(0, 1 << 2));
        people.gamble = true;
        let settings = Settings {
            futures,
            elites,
            ..settings()
        };
        let decision = decide(settings, &mut people, Start::default());
        let told = decision.communicated.verbal(2);
        assert_eq!(told, tells, "{futures} futures: {decision:?}");
    }
}

#[test]
fn nothing_is_communicated_of_what_is_not_there() {
    let everything = Communicated::new(0x3f, 0x3f);
    let world = World::empty();
    let mut people = Answers::listening_for(everything);
    let mut planner = Planner::new(settings(), &world.model);
    let decision = planner
        .plan(&world.model, world.from(Start::default()), &mut people)
        .expect("these people answer");
    assert_eq!(decision.probability, [0.0; BITS]);
    let told = |asked: &support::Asked| asked.communicated.iter().any(|c| c.0 != 0);
    assert!(!people.asked.iter().any(told));
}

#[test]
fn nothing_is_said_while_an_utterance_is_running() {
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 4));
    let start = Start {
        speech_ready_steps: 100,
        ..Start::default()
    };
    let decision = decide(settings(), &mut people, start);
    assert_eq!(decision.communicated.verbal_bits(), 0);
    assert_eq!(decision.probability[SECTORS..], [0.0; SECTORS]);
    assert!(
        people
            .asked
            .iter()
            .all(|asked| asked.communicated.iter().all(|c| c.verbal_bits() == 0))
    );
    // With two steps to wait, the first decision is silent and the second, two steps later, may speak.
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 4));
    let start = Start {
        speech_ready_steps: 2,
        ..Start::default()
    };
    let decision = decide(settings(), &mut people, start);
    assert_eq!(decision.communicated.verbal_bits(), 0);
    let spoken_at: Vec<usize> = (1..=8).filter(|t| people.spoken_at(*t)).collect();
    assert_eq!(spoken_at, [3, 5, 7]);
}

#[test]
fn an_utterance_is_heard_once_and_a_highlight_stays() {
    let mut people = Answers::deaf();
    let settings = settings();
    decide(settings, &mut people, Start::default());
    assert_eq!(
        (1..=8).filter(|t| people.spoken_at(*t)).collect::<Vec<_>>(),
        [1, 3, 5, 7]
    );
    assert_eq!(people.starts.len(), GROUPS * settings.iterations);
    assert_eq!(
        people.asked.len(),
        (GROUPS * settings.iterations) * 7,
        "the last step's answer is not needed"
    );
    for asked in people.asked.iter().filter(|asked| asked.step % 2 == 0) {
        let first = people
            .asked
            .iter()
            .find(|a| (a.start, a.group, a.step) == (asked.start, asked.group, asked.step - 1));
        let first = &first.expect("every step follows one").communicated;
        for (now, before) in asked.communicated.iter().zip(first) {
            assert_eq!(now.visual_bits(), before.visual_bits());
        }
    }
    // No two questions of a plan share their noise.
    let mut seeds: Vec<u64> = people
        .asked
        .iter()
        .map(|a| a.seed)
        .chain(people.starts.iter().map(|s| s.seed))
        .collect();
    seeds.sort_unstable();
    seeds.dedup();
    assert_eq!(seeds.len(), people.asked.len() + people.starts.len());
}

/// Σ γ^{t−1} · w · (throttle at t − 1): the known action first, then full brake, which is what silent people do here.
#[test]
fn the_value_of_silence_is_the_discounted_reward() {
    for throttle in [0.5, -0.25] {
        let start = Start {
            throttle,
            ..Start::default()
        };
        let decision = decide(
            settings(),
            &mut Answers::listening_for(Communicated::new(0, 1)),
            start,
        );
        let expected: f32 = (1..=8)
            .map(|t| 10.0 * 0.9_f32.powi(t - 1) * if t == 1 { throttle } else { -1.0 })
            .sum();
        assert!(
            (decision.value_silent - expected).abs() < 0.05,
            "{} for {expected}",
            decision.value_silent
        );
        assert!(decision.value > decision.value_silent + 10.0);
    }
}

/// A round that has ended earns nothing more; one that may have ended, as much less.
#[test]
fn what_has_ended_earns_nothing() {
    for probability in [0.25, 0.999_99] {
        let decision = decide_in(
            &World::ending(probability),
            settings(),
            &mut Answers::deaf(),
            Start::default(),
        );
        let going = 1.0 - probability;
        let expected: f32 = (2..=8).map(|t| -10.0 * (0.9 * going).powi(t - 1)).sum();
        assert!(
            (decision.value_silent - expected).abs() < 0.05,
            "{} for {expected}",
            decision.value_silent
        );
    }
}

/// Whatever the network says, no imagined reward is more than was ever earned.
#[test]
fn imagined_rewards_stay_within_what_was_earned() {
    let start = Start {
        throttle: 0.5,
        ..Start::default()
    };
    let of = |world: &World| decide_in(world, settings(), &mut Answers::deaf(), start).value_silent;
    let difference = of(&World::new()) - of(&World::earning_at_most(0.2));
    assert!((difference - 3.0).abs() < 0.05, "{difference}");
}

#[test]
fn a_plan_depends_on_seed_episode_step_and_the_last_plan_alone() {
    let people = || Answers::listening_for(Communicated::new(0, 2));
    let world = World::new();
    let settings = Settings {
        iterations: 1,
        ..settings()
    };
    let at = |seed, episode, step| Start {
        seed,
        episode,
        step,
        ..Start::default()
    };
    let fresh = |start| decide(settings, &mut people(), start);
    assert_eq!(fresh(at(1, 0, 4)), fresh(at(1, 0, 4)));
    for other in [at(2, 0, 4), at(1, 1, 4), at(1, 0, 5)] {
        assert_ne!(fresh(at(1, 0, 4)).probability, fresh(other).probability);
    }
    let after = |before| {
        let mut planner = Planner::new(settings, &world.model);
        let mut plan = |start| {
            planner
                .plan(&world.model, world.from(start), &mut people())
                .expect("these people answer")
        };
        plan(before);
        plan(at(1, 0, 4))
    };
    // The step before warms the start; any other plan does not.
    assert_ne!(
        after(at(1, 0, 3)).probability,
        fresh(at(1, 0, 4)).probability
    );
    assert_eq!(after(at(1, 0, 2)), fresh(at(1, 0, 4)));
    assert_eq!(after(at(1, 1, 3)), fresh(at(1, 0, 4)));
}

#[test]
fn people_who_do_not_answer_are_an_error_that_leaves_no_trace() {
    let world = World::new();
    let start = |step| Start {
        step,
        ..Start::default()
    };
    for silent_after in [0, 1, 5] {
        let mut planner = Planner::new(settings(), &world.model);
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        people.silent_after = Some(silent_after);
        let result = planner.plan(&world.model, world.from(start(0)), &mut people);
        assert!(matches!(result, Err(PeopleError::NoBelief)), "{result:?}");
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        let next = planner
            .plan(&world.model, world.from(start(1)), &mut people)
            .expect("these people answer");
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        assert_eq!(next, decide(settings(), &mut people, start(1)));
    }
}

#[test]
fn impossible_settings_have_a_problem() {
    assert_eq!(Settings::default().problem(), None);
    let d = Settings::default;
    let race = |change: fn(&mut RaceSettings)| {
        let mut settings = d();
        change(&mut settings.race);
        settings
    };
    for (settings, word) in [
        (Settings { horizon: 0, ..d() }, "horizon"),
        (Settings { hold: 65, ..d() }, "hold"),
        (
            Settings {
                iterations: 0,
                ..d()
            },
            "iterations",
        ),
        (Settings { samples: 3, ..d() }, "samples"),
        (
            Settings {
                samples: 1026,
                ..d()
            },
            "samples",
        ),
        (Settings { futures: 0, ..d() }, "futures"),
        (Settings { futures: 3, ..d() }, "futures"),
        (
            Settings {
                futures: 10,
                elites: 101,
                ..d()
            },
            "elites",
        ),
        (Settings { elites: 0, ..d() }, "elites"),
        (Settings { elites: 201, ..d() }, "elites"),
        (
            Settings {
                silent: 1000,
                ..d()
            },
            "silent",
        ),
        (
            Settings {
                smoothing: 1.5,
                ..d()
            },
            "smoothing",
        ),
        (
            Settings {
                discount: f32::NAN,
                ..d()
            },
            "discount",
        ),
        (
            Settings {
                first_probability: -0.1,
                ..d()
            },
            "first_probability",
        ),
        (
            Settings {
                reward_weight: f32::INFINITY,
                ..d()
            },
            "reward_weight",
        ),
        (
            Settings {
                verbal_cost: -1.0,
                ..d()
            },
            "costs",
        ),
        (race(|race| race.steps = 0), "race_steps"),
        (race(|race| race.first = 1), "race_first"),
        (race(|race| race.futures = 4), "race_futures"),
        (race(|race| race.certainty = -1.0), "race_certainty"),
        (race(|race| race.budget = 0.0), "budget"),
    ] {
        let problem = settings.problem().expect("a problem");
        assert!(problem.contains(word), "{problem}");
    }
}

/// A whole plan with a real human model allocates nothing once the first is done, and gives the same bytes again.
#[test]
fn plans_with_a_human_model_allocate_nothing_and_repeat() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let model = Arc::new(SelfModel::new(
        Sizes::of(&layout()).with_hidden(32),
        layout(),
        &mut rng,
    ));
    let latent = model.sizes.latent;
    let implants = Posterior::neutral(&model, true);
    let settings = Settings {
        samples: 40,
        futures: 1,
        elites: 8,
        silent: 4,
        ..Settings::default()
    };
    let rows = settings.samples / GROUPS;
    let run = || {
        let mut human = SelfHuman::new(model.clone(), Some(implants.clone()), 0);
        let mut groups = ImaginedGroups::new(&human, GROUPS, rows);
        let mut pending = vec![Tensor::new(2, rows); GROUPS];
        let mut person = Beliefs::new(latent, 1);
        person.fresh = false;
        person.deviation.fill(0.5);
        let (mean, deviation) = (Tensor::new(latent, 1), person.deviation.clone());
        let mut planner = Planner::new(settings, &model);
        let mut decisions = Vec::with_capacity(4);
        let mut before = 0;
        for step in 0..4 {
            if step == 1 {
                before = allocations();
            }
            let mut people = LocalPeople {
                model: &mut human,
                person: &person,
                groups: &mut groups,
                pending: &mut pending,
            };
            let start = Start {
                step,
                ..Start::default()
            };
            let from = start.from(&mean, &deviation);
            decisions.push(
                planner
                    .plan(&model, from, &mut people)
                    .expect("local people answer"),
            );
        }
        assert_eq!(allocations() - before, 0);
        decisions
    };
    let decisions = run();
    assert_eq!(decisions, run());
    assert!(
        decisions
            .iter()
            .all(|d| d.value.is_finite() && d.value_silent.is_finite())
    );
    assert_eq!(decisions[0].probability.len(), BITS);
    assert_ne!(decisions[0].probability, decisions[1].probability);
}
