//! What the human process keeps of a person: belief, prediction and the groups of imagined people.

use domains::discrete::{Acting, Scene};
use domains::highway::AZIMUTHS;
use domains::highway::modalities::layout;
use human::{GROUPS, HumanOptions, ModelledPerson};
use messages::{
    Display, DriverAction, HumanBelief, ImagineAnswer, ImaginePhase, ImagineRequest, ImagineStatus,
    LidarFrame, MAX_GROUP, Message,
};
use models::utterances::UtteranceTable;
use models::{
    Kind, PersonalPolicy, Posterior, RecurrentPolicy, RecurrentSizes, SelfHuman, SelfModel, Sizes,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenario::Scenario;
use std::sync::Arc;

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn model() -> SelfModel {
    SelfModel::new(
        Sizes::of(&layout()).with_hidden(32),
        layout(),
        &mut ChaCha8Rng::seed_from_u64(4),
    )
}

fn implants(with_policy: bool) -> Posterior {
    Posterior::neutral(&model(), with_policy)
}

/// Somebody who sees 12 m, with an untrained policy.
fn policy() -> PersonalPolicy {
    let layout = layout();
    let rng = &mut ChaCha8Rng::seed_from_u64(4);
    PersonalPolicy {
        policy: RecurrentPolicy::new(RecurrentSizes::of(&layout, 3), &layout, rng),
        limits: vec![12.0; AZIMUTHS],
        heard: 0,
    }
}

fn person() -> ModelledPerson<UtteranceTable> {
    let human = SelfHuman::new(Arc::new(model()), Some(implants(true)), 0);
    ModelledPerson::new(
        Box::new(human),
        UtteranceTable::shipped().expect("the table ships"),
        1,
    )
}

/// A car 30 m ahead and one 30 m behind, both beyond what untrained implants let the person see.
fn frame(step: u32) -> LidarFrame {
    let mut frame = LidarFrame::ZERO;
    frame.header.step = step;
    frame.range = [1.0; messages::BEAMS];
    (frame.range[0], frame.range[18]) = (0.75, 0.75);
    frame
}

fn observe(
    person: &mut ModelledPerson<UtteranceTable>,
    step: u32,
    display: &Display,
    [throttle, steer]: [f32; 2],
) -> HumanBelief {
    let mut out = HumanBelief::ZERO;
    let taken = DriverAction {
        throttle,
        steer,
        ..DriverAction::ZERO
    };
    person.observe(&frame(step), display, Some(&taken), &mut out);
    out
}

const START: u32 = ImaginePhase::Start.wire();
const PERCEIVE: u32 = ImaginePhase::Perceive.wire();
const FORGET: u32 = ImaginePhase::Forget.wire();
const COMPARE: u32 = ImaginePhase::Compare.wire();

fn question(step: u32, group: u32, phase: u32, rows: u32) -> Box<ImagineRequest> {
    let mut question = Box::new(ImagineRequest::ZERO);
    question.header.step = step;
    (question.group, question.phase, question.rows, question.seed) = (group, phase, rows, 77);
    question.futures = rows.clamp(1, MAX_GROUP as u32);
    (question.visual_width, question.verbal_width) = (113, 120);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for value in &mut question.visual {
        *value = rng.random();
    }
    question
}

fn ask(
    person: &mut ModelledPerson<UtteranceTable>,
    question: &ImagineRequest,
) -> Box<ImagineAnswer> {
    let mut answer = Box::new(ImagineAnswer::ZERO);
    (answer.group, answer.phase, answer.rows) = (question.group, question.phase, question.rows);
    person.answer(question, &mut answer);
    answer
}

#[test]
fn what_is_shown_and_said_reaches_the_person() {
    let with = |write: fn(&mut Display)| {
        let mut display = Display::ZERO;
        write(&mut display);
        observe(&mut person(), 0, &display, [0.0; 2]).mean
    };
    let nothing = with(|_| {});
    assert_ne!(
        nothing,
        with(|d| d.highlighted = 1),
        "the car ahead is shown"
    );
    assert_eq!(
        nothing,
        with(|d| d.highlighted = 1 << 3),
        "the display does not reach behind"
    );
    assert_eq!(
        nothing,
        with(|d| d.highlighted = 1 << 1),
        "there is no car to draw a box around"
    );
    let said = |kind: u32, range_m: f32, sector: u32| {
        let mut display = Display::ZERO;
        display.utterance_count = 1;
        let words = &mut display.utterances[0];
        (words.kind, words.range_m, words.item) = (kind, range_m, sector);
        observe(&mut person(), 0, &display, [0.0; 2]).mean
    };
    assert_ne!(nothing, said(2, 30.0, 3));
    assert_ne!(said(1, 30.0, 3), said(2, 30.0, 3), "slow is not fast");
    assert_ne!(said(2, 10.0, 3), said(2, 30.0, 3), "near is not far");
    assert_ne!(said(2, 30.0, 2), said(2, 30.0, 3));
    // Words of another vocabulary, and sectors that there are not, are passed over.
    assert_eq!(nothing, said(7, 30.0, 3));
    assert_eq!(nothing, said(2, 30.0, 6));
}

#[test]
fn the_likelihood_is_that_of_the_action_under_the_prediction_before() {
    let likelihood = |taken: fn(&HumanBelief) -> [f32; 2]| {
        let mut person = person();
        let first = observe(&mut person, 0, &Display::ZERO, [0.0; 2]);
        assert_eq!(first.log_likelihood, 0.0);
        let second = observe(&mut person, 1, &Display::ZERO, taken(&first));
        (first, second.log_likelihood)
    };
    let (first, expected) = likelihood(|before| before.action_mean);
    let by_hand: f32 = (0..2)
        .map(|i| {
            let (a, d) = (first.action_mean[i], first.action_deviation[i]);
            -d.ln() - 0.5 * (2.0 * std::f32::consts::PI).ln() - (1.0 - a * a).ln()
        })
        .sum();
    assert!(
        (expected - by_hand).abs() < 1e-3,
        "{expected} and {by_hand}"
    );
    let (_, surprising) = likelihood(|before| {
        before
            .action_mean
            .map(|a| if a > 0.0 { -0.95 } else { 0.95 })
    });
    assert!(surprising < expected - 0.5);
    assert_eq!(runtime::text_of(&first.kind), "mirror");
}

#[test]
fn questions_that_cannot_be_answered_say_why() {
    let mut person = person();
    assert_eq!(
        ask(&mut person, &question(0, 0, START, 5)).status(),
        Ok(ImagineStatus::NoBelief),
        "nothing is believed yet"
    );
    for step in 0..6 {
        observe(&mut person, step, &Display::ZERO, [0.1; 2]);
    }
    assert_eq!(
        ask(&mut person, &question(5, 0, PERCEIVE, 5)).status(),
        Ok(ImagineStatus::NoGroup),
        "the group was not started"
    );
    assert_eq!(
        ask(&mut person, &question(0, 0, START, 5)).status(),
        Ok(ImagineStatus::NoBelief),
        "too long ago"
    );
    assert_eq!(
        ask(&mut person, &question(9, 0, START, 5)).status(),
        Ok(ImagineStatus::NoBelief),
        "not yet"
    );
    let mut elsewhere = question(5, 0, START, 5);
    elsewhere.header.episode = 1;
    assert_eq!(
        ask(&mut person, &elsewhere).status(),
        Ok(ImagineStatus::NoBelief)
    );
    // A plan may have begun a step ago.
    for step in [4, 5] {
        assert_eq!(
            ask(&mut person, &question(step, 0, START, 5)).status(),
            Ok(ImagineStatus::Answered)
        );
    }
    assert_eq!(
        ask(&mut person, &question(5, 0, PERCEIVE, 5)).status(),
        Ok(ImagineStatus::Answered)
    );
    for (group, phase, rows) in [
        (GROUPS as u32, START, 5),
        (u32::MAX, PERCEIVE, 5),
        (0, START, 0),
        (0, START, MAX_GROUP as u32 + 1),
        (0, PERCEIVE, 4),
        (0, PERCEIVE, MAX_GROUP as u32 + 1),
        (0, PERCEIVE, u32::MAX),
        (0, 4, 5),
    ] {
        assert_eq!(
            ask(&mut person, &question(5, group, phase, rows)).status(),
            Ok(ImagineStatus::NoGroup),
            "{group} {phase} {rows}"
        );
    }
    assert_eq!(
        ask(&mut person, &question(5, 0, FORGET, 0)).status(),
        Ok(ImagineStatus::Answered)
    );
    assert_eq!(
        ask(&mut person, &question(5, 0, PERCEIVE, 5)).status(),
        Ok(ImagineStatus::NoGroup),
        "the group was forgotten"
    );
}

/// Two rows of one future differ by what they are told alone; who comes later has been as the first of their future.
#[test]
fn people_of_one_future_share_its_chance() {
    let two_futures = |phase, rows| {
        let mut question = question(0, 0, phase, rows);
        question.futures = 2;
        // Everybody sees the same.
        for j in 1..MAX_GROUP {
            question.visual.copy_within(..113, j * 113);
        }
        question
    };
    let mut person = person();
    observe(&mut person, 0, &Display::ZERO, [0.0; 2]);
    let of = |answer: &ImagineAnswer, j: usize| [answer.action[2 * j], answer.action[2 * j + 1]];
    for (phase, rows) in [(START, 4), (PERCEIVE, 4), (PERCEIVE, 7)] {
        let answer = ask(&mut person, &two_futures(phase, rows));
        assert_eq!(answer.status(), Ok(ImagineStatus::Answered));
        assert_ne!(of(&answer, 0), of(&answer, 1), "futures differ");
        for j in 2..rows as usize {
            assert_eq!(of(&answer, j), of(&answer, j % 2), "row {j} of {rows}");
        }
    }
    let mut told = two_futures(PERCEIVE, 7);
    told.communicated[6] = 1 << 8;
    told.verbal[6 * 120..6 * 120 + 20].fill(0.7);
    let answer = ask(&mut person, &told);
    assert_ne!(
        of(&answer, 6),
        of(&answer, 0),
        "who is told something acts otherwise"
    );
    assert_eq!(of(&answer, 5), of(&answer, 1));
}

#[test]
fn an_answer_depends_on_belief_and_question_alone() {
    let answers = |between: bool| {
        let mut person = person();
        observe(&mut person, 0, &Display::ZERO, [0.0; 2]);
        let rows = 30;
        let mut all = Vec::new();
        for phase in [START, PERCEIVE, PERCEIVE] {
            if between {
                for phase in [START, PERCEIVE] {
                    ask(&mut person, &question(0, 1, phase, 300));
                }
            }
            let answer = ask(&mut person, &question(0, 0, phase, rows));
            assert_eq!(answer.status(), Ok(ImagineStatus::Answered));
            all.extend_from_slice(&answer.action[..2 * rows as usize]);
        }
        all
    };
    assert_eq!(answers(false), answers(true), "other groups leave no trace");
    assert!(answers(false).iter().all(|a| (-1.0..=1.0).contains(a)));
    // A known action is what everybody does now.
    let mut person = person();
    observe(&mut person, 0, &Display::ZERO, [0.0; 2]);
    let mut known = question(0, 0, START, 9);
    (known.action_known, known.action) = (1, [0.25, -0.5, 0.0, 0.0]);
    let answer = ask(&mut person, &known);
    assert_eq!(answer.action[..18], *[[0.25, -0.5]; 9].as_flattened());
}

#[test]
fn it_allocates_nothing_once_it_is_warm() {
    let mut person = person();
    let questions: Vec<_> = (0..4)
        .map(|i| question(0, i / 2, [START, PERCEIVE][i as usize % 2], 64))
        .collect();
    let mut answer = Box::new(ImagineAnswer::ZERO);
    let mut before = 0;
    for round in 0..3 {
        if round == 2 {
            before = runtime::alloc_count::allocations();
        }
        for step in 0..3 {
            observe(&mut person, step, &Display::ZERO, [0.1; 2]);
            for question in &questions {
                person.answer(question, &mut answer);
                assert_eq!(answer.status(), Ok(ImagineStatus::Answered));
            }
        }
    }
    assert_eq!(runtime::alloc_count::allocations(), before);
}

#[test]
fn every_kind_loads_what_it_needs_and_refuses_the_rest() {
    let folder = tempfile::tempdir_in("/tmp").expect("a temporary directory");
    let path = |name: &str| folder.path().join(name);
    model().save(&path("self"), "test").expect("written");
    for (name, with_policy) in [("both", true), ("perception", false)] {
        let implants = implants(with_policy);
        let saved = implants.save(&path(name), &model(), 0, "test");
        saved.expect("written");
    }
    let saved = policy().save(&path("bc"), Kind::Bc, &layout(), "test", &[]);
    saved.expect("written");
    let load = |kind: Kind, implants: Option<&str>| {
        let options = HumanOptions {
            kind,
            model: path("self"),
            implants: implants.map(path),
            person: None,
            scenario: Scenario::Highway(()),
            seed: 1,
        };
        options
            .load()
            .map(|model| model.kind())
            .map_err(|error| format!("{error:#}"))
    };
    assert_eq!(load(Kind::Myself, None), Ok("self"));
    assert_eq!(load(Kind::Mirror, Some("both")), Ok("mirror"));
    assert_eq!(load(Kind::MirrorP, Some("perception")), Ok("mirror-p"));
    assert_eq!(load(Kind::Bc, Some("bc")), Ok("bc"));
    for (kind, implants, word) in [
        (Kind::Bc, None, "`bc` needs a file"),
        (Kind::Bc, Some("both"), "both"),
        (Kind::Sqil, Some("bc"), "kind `bc`"),
        (Kind::Mirror, Some("bc"), "policy"),
        (Kind::Mirror, None, "`mirror` needs a file"),
        (Kind::Mirror, Some("perception"), "perception"),
        (Kind::MirrorP, Some("both"), "both"),
        (Kind::Mirror, Some("absent"), "absent"),
        (Kind::Mirror, Some("self"), "self"),
        (Kind::Ideal, None, "for the gridworlds"),
    ] {
        let error = load(kind, implants).expect_err("refused");
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn the_ideal_model_is_that_of_a_named_person() {
    let ideal = |person| HumanOptions {
        kind: Kind::Ideal,
        model: "the ideal model needs no self-model".into(),
        implants: None,
        person,
        scenario: Scenario::Gridworld(Scene::builtin("bomb").expect("it ships")),
        seed: 1,
    };
    let load = |person| ideal(person).load().map_err(|error| format!("{error:#}"));
    assert_eq!(
        load(Some(Acting::Shipped(10))).map(|model| model.kind()),
        Ok("ideal")
    );
    for (person, word) in [
        (Some(Acting::Shipped(11)), "11"),
        (Some(Acting::File("absent.toml".into())), "absent.toml"),
        (None, "whose it is"),
    ] {
        let error = load(person).err().expect("refused");
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn it_says_how_far_beliefs_are_apart_if_it_can() {
    let mut compare = question(0, 0, COMPARE, 5);
    compare.robot_deviation.fill(1.0);
    compare.communicated[3] = 1 << 8;
    let mut person = person();
    assert_eq!(
        ask(&mut person, &compare).status(),
        Ok(ImagineStatus::NoBelief),
        "nothing is believed yet"
    );
    observe(&mut person, 0, &Display::ZERO, [0.0; 2]);
    // What each is told decides, if they see the same.
    for row in 1..5 {
        compare.visual.copy_within(..113, 113 * row);
    }
    let answer = ask(&mut person, &compare);
    assert_eq!(answer.status(), Ok(ImagineStatus::Answered));
    let apart = &answer.divergence[..5];
    assert!(
        apart.iter().all(|kl| kl.is_finite() && *kl > 0.0),
        "{apart:?}"
    );
    assert!(
        apart[0] == apart[1] && apart[0] == apart[4] && apart[0] != apart[3],
        "{apart:?}"
    );
    assert_eq!(
        ask(&mut person, &compare).divergence[..5],
        *apart,
        "twice the same"
    );

    let policy = policy().human(Kind::Bc, &layout());
    let table = UtteranceTable::shipped().expect("the table ships");
    let mut other = ModelledPerson::new(Box::new(policy), table, 1);
    observe(&mut other, 0, &Display::ZERO, [0.0; 2]);
    assert_eq!(
        ask(&mut other, &compare).status(),
        Ok(ImagineStatus::Incomparable),
        "a belief of another kind"
    );
}
