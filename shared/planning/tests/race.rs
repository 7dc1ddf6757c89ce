//! The race of candidates, against people whose reactions are known and with real models: what it decides, that all candidates
//! live through the same futures, and that it is deterministic, in time and free of allocation.

mod support;

use domains::highway::modalities::layout;
use models::imagined::ImaginedGroups;
use models::{Beliefs, Communicated, Posterior, SelfHuman, SelfModel, Sizes};
use nn::Tensor;
use planning::candidates::Candidate;
use planning::items::{Items, Sectors};
use planning::planner::{From, GROUPS, Plan};
use planning::race::{Race, Round, Simulation, Start as RaceStart};
use planning::settings::MOST_ROWS;
use planning::{LocalPeople, PeopleError, RacePlanner, RaceSettings, Settings, ThreadedPeople};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::{Duration, Instant};
use support::{Answers, Start, World, allocations};

fn settings() -> Settings {
    Settings {
        visual_cost: 0.5,
        race: RaceSettings {
            steps: 12,
            first: 4,
            futures: 16,
            ..RaceSettings::default()
        },
        ..Settings::default()
    }
}

fn planner(settings: Settings, model: &SelfModel) -> RacePlanner {
    RacePlanner::with_items(settings, model, Sectors)
}

fn decide_in(world: &World, settings: Settings, people: &mut Answers, start: Start) -> Plan {
    planner(settings, &world.model)
        .search(&world.model, &world.from(start), people)
        .expect("these people answer")
}

fn decide(people: &mut Answers, start: Start) -> Plan {
    decide_in(&World::new(), settings(), people, start)
}

#[test]
fn what_helps_most_now_is_said_or_shown_and_nothing_else() {
    for told in [
        Communicated::new(0, 1 << 3),
        Communicated::new(1 << 1, 0),
        Communicated::new(1, 0),
    ] {
        let plan = decide(&mut Answers::listening_for(told), Start::default());
        assert_eq!(plan.communicated, told, "{plan:?}");
        assert!(plan.reasons.gain_now > plan.reasons.gain_later + 10.0);
        assert!(plan.reasons.futures >= 4 && plan.reasons.rows > 40);
        assert!((plan.value - plan.value_silent - plan.reasons.gain_now).abs() < 0.01);
    }
    let plan = decide(&mut Answers::deaf(), Start::default());
    assert_eq!(plan.communicated, Communicated::default());
    let dear = Settings {
        verbal_cost: 1e4,
        visual_cost: 1e4,
        ..settings()
    };
    let mut people = Answers::listening_for(Communicated::new(0b11, 0b11));
    let plan = decide_in(&World::new(), dear, &mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::default());
}

/// They listen from the fifth step on: who says it now says it in vain.
#[test]
fn what_helps_more_later_waits() {
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 3));
    people.listens = 5..=64;
    let plan = decide(&mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::default(), "{plan:?}");
    assert!(plan.reasons.gain_now < 0.0);
    // It listens now and later, but for another sentence that would then have to wait.
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 3 | 1 << 1));
    people.listens = 1..=1;
    let plan = decide(&mut people, Start::default());
    assert_eq!(plan.communicated.verbal_bits().count_ones(), 1, "{plan:?}");
}

#[test]
fn two_things_that_help_are_both_communicated_and_one_sentence_is_enough() {
    // Half of them is helped by a sentence, half by a highlight.
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 3));
    people.others_listen_for = Some(Communicated::new(1 << 1, 0));
    let plan = decide(&mut people, Start::default());
    assert_eq!(
        plan.communicated,
        Communicated::new(1 << 1, 1 << 3),
        "{plan:?}"
    );
    // One sentence helps everybody, another half of them.
    people.others_listen_for = Some(Communicated::new(0, 1 << 2 | 1 << 3));
    let plan = decide(&mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::new(0, 1 << 3), "{plan:?}");
}

#[test]
fn luck_is_not_taken_for_help() {
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 2));
    people.gamble = true;
    let plan = decide(&mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::default(), "{plan:?}");
}

#[test]
fn what_is_not_there_cannot_be_highlighted() {
    let mut people = Answers::listening_for(Communicated::new(0x3f, 0));
    let plan = decide_in(&World::empty(), settings(), &mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::default());
    let shown = |asked: &support::Asked| asked.communicated.iter().any(|c| c.visual_bits() != 0);
    assert!(!people.asked.is_empty() && !people.asked.iter().any(shown));
    // Behind the display's edge there are cars, and no highlights either.
    let mut people = Answers::listening_for(Communicated::new(0b01_1100, 0));
    let plan = decide(&mut people, Start::default());
    assert_eq!(plan.communicated, Communicated::default());
}

#[test]
fn nothing_is_said_while_an_utterance_is_running() {
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 4));
    let start = Start {
        speech_ready_steps: 2,
        ..Start::default()
    };
    let plan = decide(&mut people, start);
    assert_eq!(plan.communicated, Communicated::default());
    assert!(!people.spoken_at(1) && !people.spoken_at(2));
    // Where there is nothing to show either, nobody has to imagine anything.
    let mut people = Answers::listening_for(Communicated::new(0, 1 << 4));
    let plan = decide_in(&World::empty(), settings(), &mut people, start);
    assert_eq!((plan.reasons.rows, people.asked.len()), (0, 0));
}

/// People whom nothing reaches do the same whatever they are told: not a bit may differ between candidates.
#[test]
fn candidates_that_do_nothing_gain_exactly_nothing() {
    let plan = decide(&mut Answers::deaf(), Start::default());
    assert_eq!(plan.reasons.gain_error, 0.0);
    // A sentence, the cheapest of all.
    assert!((plan.reasons.gain_now + 0.4).abs() < 1e-5, "{plan:?}");

    // With real networks: who sees everything is shown nothing new. Every width of a batch is tried.
    let robot = Robot::new();
    let mut human = SelfHuman::new(robot.model.clone(), None, 0);
    for first in [2, 4, 6, 10, 34] {
        let mut settings = settings();
        settings.race.first = first;
        settings.race.futures = 64;
        let start = Start {
            speech_ready_steps: 100,
            ..Start::default()
        };
        let plan = robot.plan(settings, &mut human, start);
        assert_eq!(plan.reasons.gain_error, 0.0, "{first} futures: {plan:?}");
        // A highlight of the front, in two steps.
        assert!((plan.reasons.gain_now + 0.5 * 1.9).abs() < 1e-5, "{plan:?}");
        assert_eq!(plan.reasons.futures as usize, first);
    }
}

/// A robot of untrained networks that believes in cars all around, and does not know much else.
struct Robot {
    model: Arc<SelfModel>,
    mean: Tensor,
    deviation: Tensor,
    person: Beliefs,
}

impl Robot {
    fn new() -> Self {
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        let sizes = Sizes::of(&layout()).with_hidden(32);
        let mut model = SelfModel::new(sizes, layout(), rng);
        let bias = model.visual.layers[2].bias;
        model.parameters.get_mut(bias).fill(0.5);
        let mut mean = Tensor::new(sizes.latent, 1);
        nn::noise::fill(mean.data_mut(), 5, 0);
        let mut deviation = Tensor::new(sizes.latent, 1);
        deviation.fill(0.5);
        let mut person = Beliefs::new(sizes.latent, 1);
        person.fresh = false;
        person.mean.copy_from(&mean);
        person.deviation.copy_from(&deviation);
        Self {
            model: Arc::new(model),
            mean,
            deviation,
            person,
        }
    }

    /// Somebody who sees half of what is there, and whom it is cheap to tell.
    fn human(&self) -> SelfHuman {
        let posterior = Posterior::neutral(&self.model, true);
        SelfHuman::new(self.model.clone(), Some(posterior), 0)
    }

    fn from(&self, start: Start) -> From<'_> {
        start.from(&self.mean, &self.deviation)
    }

    fn plan(&self, settings: Settings, human: &mut SelfHuman, start: Start) -> Plan {
        let mut planner = planner(settings, &self.model);
        self.local(human, |people| {
            planner
                .search(&self.model, &self.from(start), people)
                .expect("local people answer")
        })
    }

    fn local<R>(&self, human: &mut SelfHuman, with: impl FnOnce(&mut LocalPeople) -> R) -> R {
        let shape = self.model.sizes.shape;
        let mut groups = ImaginedGroups::new(human, GROUPS, MOST_ROWS);
        groups.warm(human, &shape, MOST_ROWS);
        let mut pending = vec![Tensor::new(2, MOST_ROWS); GROUPS];
        with(&mut LocalPeople {
            model: human,
            person: &self.person,
            groups: &mut groups,
            pending: &mut pending,
        })
    }
}

/// Costs at which an untrained model sometimes says something.
fn cheap() -> Settings {
    Settings {
        visual_cost: 1e-5,
        verbal_cost: 1e-5,
        ..settings()
    }
}

#[test]
fn threads_and_vectors_decide_the_same_bit_for_bit() {
    let robot = Robot::new();
    let shape = robot.model.sizes.shape;
    let (mut human, other) = (robot.human(), robot.human());
    let mut threaded = ThreadedPeople::spawn(other, robot.person.clone(), MOST_ROWS, &shape);
    let mut planner_of_two = planner(cheap(), &robot.model);
    let mut decided = Vec::new();
    for step in 0..6 {
        let start = Start {
            step,
            speech_ready_steps: if step < 3 { 0 } else { 4 },
            ..Start::default()
        };
        let alone = robot.plan(cheap(), &mut human, start);
        let two = planner_of_two
            .search(&robot.model, &robot.from(start), &mut threaded)
            .expect("the other thread answers");
        assert_eq!(alone, two, "step {step}");
        assert_eq!(alone, robot.plan(cheap(), &mut human, start));
        decided.push(alone);
    }
    assert!(
        decided.iter().any(|plan| plan.reasons.futures > 4),
        "{decided:?}"
    );
    assert!(decided.windows(2).all(|two| two[0].value != two[1].value));
}

#[test]
fn a_plan_stands_when_it_has_to() {
    let robot = Robot::new();
    let mut human = robot.human();
    let mut settings = cheap();
    settings.race.steps = 64;
    settings.race.first = 64;
    settings.race.futures = 512;
    let mut planner = planner(settings, &robot.model);
    robot.local(&mut human, |people| {
        let mut plan = |until| {
            let from = From {
                until,
                ..robot.from(Start::default())
            };
            let began = Instant::now();
            let plan = planner.search(&robot.model, &from, people);
            (plan.expect("local people answer"), began.elapsed())
        };
        let (whole, takes) = plan(None);
        let (none, _) = plan(Some(Instant::now()));
        assert_eq!(none.communicated, Communicated::default());
        assert_eq!(none.reasons.futures, 0);
        // A tenth of the time: the decision stands then, on fewer futures; a step of a question may still be under way.
        let budget = takes / 10;
        let mut futures = Vec::new();
        for _ in 0..4 {
            let (part, took) = plan(Some(Instant::now() + budget));
            assert!(
                took < budget + takes / 10 + Duration::from_millis(20),
                "{took:?}"
            );
            assert!(part.reasons.rows < whole.reasons.rows);
            futures.push(part.reasons.futures);
        }
        assert!(futures.iter().any(|futures| *futures > 0), "{futures:?}");
        // With all the time in the world nothing is left out.
        let (later, _) = plan(Some(Instant::now() + Duration::from_secs(3600)));
        assert_eq!(later.reasons, whole.reasons);
    });
}

/// Candidates of known value, with a future's luck added that all of them share.
struct Known {
    value: fn(&Candidate, usize) -> f32,
    lived: Vec<(Vec<Candidate>, Round)>,
}

impl Simulation for Known {
    fn live(
        &mut self,
        candidates: &[Candidate],
        round: Round,
        values: &mut [f32],
    ) -> Result<bool, PeopleError> {
        self.lived.push((candidates.to_vec(), round));
        for (candidate, values) in candidates.iter().zip(values.chunks_exact_mut(round.count)) {
            for (f, value) in values.iter_mut().enumerate() {
                *value = (self.value)(candidate, round.first + f);
            }
        }
        Ok(true)
    }

    fn most_rows(&self) -> usize {
        GROUPS * MOST_ROWS
    }
}

#[test]
fn halving_keeps_silence_and_the_best_and_spends_futures_on_few() {
    // Sentence 3 is a little better than all others, in a world that differs much from future to future.
    let value = |candidate: &Candidate, future: usize| {
        let luck = ((future * 7919) % 101) as f32;
        let own = ((future * 31) % 7) as f32;
        match (candidate.decision(6 + 3), candidate.begins()) {
            (Some(0), _) => luck + 20.0 + own,
            (Some(later), _) => luck + 19.5 - later as f32,
            (_, Some(_)) => luck + 10.0 - own,
            (_, None) => luck,
        }
    };
    let mut known = Known {
        value,
        lived: Vec::new(),
    };
    let settings = Settings::default();
    let mut race = Race::new(settings, Sectors);
    let start = RaceStart {
        held: Sectors.possible(),
        speech_ready_steps: 0,
        seed: 1,
    };
    let plan = race.decide(&mut known, start).expect("it is known");
    assert_eq!(plan.communicated.verbal_bits(), 1 << 3, "{plan:?}");
    let mut before = usize::MAX;
    for (candidates, round) in &known.lived {
        assert_eq!(candidates[0], Candidate::SILENCE);
        assert!(
            candidates
                .windows(2)
                .all(|two| two[0].begins() <= two[1].begins())
        );
        if round.first > 0 && candidates.iter().all(|c| c.told(0, 6).0.count_ones() < 2) {
            assert!(candidates.len() <= before, "nobody comes back");
            assert!(candidates.contains(&Candidate::SILENCE.with(9, 0)));
            before = candidates.len();
        }
    }
    // All rounds of a plan differ in their chance.
    let seed = |first: usize| {
        known
            .lived
            .iter()
            .find(|(_, r)| r.first == first)
            .map(|(_, r)| r.seed)
    };
    assert_ne!(seed(0), seed(settings.race.first));
    // A difference that is not beyond its standard error does not count.
    let mut known = Known {
        value: |candidate, future| match candidate.begins() {
            None => 0.0,
            Some(_) => [9.0, -8.0][future % 2],
        },
        lived: Vec::new(),
    };
    let plan = race.decide(&mut known, start).expect("it is known");
    assert_eq!(plan.communicated, Communicated::default(), "{plan:?}");
}

#[test]
fn plans_allocate_nothing_and_repeat() {
    let robot = Robot::new();
    let run = || {
        let mut human = robot.human();
        let mut planner = planner(cheap(), &robot.model);
        let mut plans = Vec::with_capacity(8);
        robot.local(&mut human, |people| {
            let before = allocations();
            for step in 0..6 {
                let start = Start {
                    step,
                    speech_ready_steps: step as usize % 3,
                    ..Start::default()
                };
                let plan = planner.search(&robot.model, &robot.from(start), people);
                plans.push(plan.expect("local people answer"));
            }
            assert_eq!(allocations() - before, 0, "{plans:?}");
        });
        plans
    };
    let plans = run();
    assert_eq!(plans, run());
    assert!(plans.iter().any(|plan| plan.reasons.futures > 4));
    assert!(plans.iter().all(|plan| plan.value.is_finite()));
}

#[test]
fn people_who_do_not_answer_are_an_error_that_leaves_no_trace() {
    let world = World::new();
    for silent_after in [0, 1, 5, 40] {
        let mut planner = planner(settings(), &world.model);
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        people.silent_after = Some(silent_after);
        let result = planner.search(&world.model, &world.from(Start::default()), &mut people);
        assert!(matches!(result, Err(PeopleError::NoBelief)), "{result:?}");
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        let next = planner
            .search(&world.model, &world.from(Start::default()), &mut people)
            .expect("these people answer");
        let mut people = Answers::listening_for(Communicated::new(0, 1));
        assert_eq!(next, decide(&mut people, Start::default()));
    }
}
