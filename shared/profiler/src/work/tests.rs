use super::*;
use crate::metrics::{self, Samples};
use messages::{CommAction, DecisionReason, Header, Message};

fn decision(header: Header, reason: DecisionReason) -> CommAction {
    let mut decision = CommAction::ZERO;
    (decision.header, decision.reason) = (header, reason.wire());
    decision
}

fn add(table: &mut StepTable, topic: GraphTopic, step: u32, sent_ns: u64, compute_ns: u64) {
    let header = Header {
        step,
        sent_ns,
        compute_ns,
        cause_ns: 100,
        ..Header::default()
    };
    match topic {
        GraphTopic::Decision => table.add_decision(&decision(header, DecisionReason::NoPlanner)),
        _ => table.add(topic, &header),
    }
}

/// Frame 0 at 100, display at 130 (10), action at 200 (50, of which 5 before the display came), frame 1 at 260 (40).
fn two_steps() -> StepTable {
    let mut table = StepTable::default();
    add(&mut table, GraphTopic::Lidar, 0, 100, 20);
    add(&mut table, GraphTopic::Display, 0, 130, 10);
    add(&mut table, GraphTopic::Action, 0, 200, 50);
    add(&mut table, GraphTopic::Lidar, 1, 260, 40);
    table
}

const LOCKSTEP: ClockMode = ClockMode::Lockstep;

#[test]
fn a_message_waits_from_its_sending_until_the_receiver_begins() {
    let table = two_steps();
    let reader = StepReader {
        table: &table,
        clock: LOCKSTEP,
    };
    let display = reader.work(GraphTopic::Display, 0, 0).unwrap();
    assert_eq!(
        (display.began, display.sent, display.clamped),
        (120, 130, false)
    );
    let action = reader.work(GraphTopic::Action, 0, 0).unwrap();
    assert_eq!(action.began, 150);
    let newest = action.newest().unwrap();
    assert_eq!(EDGES[newest.edge].from, GraphTopic::Display);
    let samples = Samples::new(&reader);
    assert_eq!(samples.of("hop comm/display → driver"), [20]);
    assert_eq!(samples.of("wait world/lidar → driver"), [50]);
    assert!(samples.of("hop world/lidar → driver").is_empty());
    assert_eq!(samples.of("compute driver"), [50]);
    assert_eq!(samples.of(metrics::TICK), [160]);
    assert_eq!(samples.of(metrics::TO_DISPLAY), [30]);
}

#[test]
fn the_critical_path_has_no_gaps_and_adds_up_to_the_tick() {
    let table = two_steps();
    let reader = StepReader {
        table: &table,
        clock: LOCKSTEP,
    };
    let path = reader.path(GraphTopic::Lidar, 0, 1, 100);
    let ends: Vec<_> = path.iter().map(|s| (s.process, s.from, s.to)).collect();
    assert_eq!(
        ends,
        [
            (5, 100, 120),
            (5, 120, 130),
            (1, 130, 150),
            (1, 150, 200),
            (0, 200, 220),
            (0, 220, 260)
        ]
    );
    let parts = metrics::path_parts(&reader);
    let sum: f64 = parts.iter().map(|part| part.mean_ns).sum();
    assert_eq!(sum, 160.0);
}

#[test]
fn a_missing_message_is_said_to_be_unknown() {
    let mut table = StepTable::default();
    add(&mut table, GraphTopic::Lidar, 0, 100, 20);
    add(&mut table, GraphTopic::Lidar, 1, 260, 40);
    let reader = StepReader {
        table: &table,
        clock: LOCKSTEP,
    };
    let path = reader.path(GraphTopic::Lidar, 0, 1, 100);
    assert_eq!(path[0].kind, StretchKind::Unknown);
    assert_eq!((path[0].from, path[0].to), (100, 220));
}

#[test]
fn computing_before_the_newest_input_clamps_the_wait() {
    let mut table = StepTable::default();
    add(&mut table, GraphTopic::Lidar, 0, 100, 20);
    // It looked at the frame for 30, waited for the display, and computed 40 more.
    add(&mut table, GraphTopic::Display, 0, 150, 10);
    add(&mut table, GraphTopic::Action, 0, 195, 70);
    let reader = StepReader {
        table: &table,
        clock: LOCKSTEP,
    };
    let action = reader.work(GraphTopic::Action, 0, 0).unwrap();
    assert!(action.clamped);
    assert_eq!(action.began, 150);
    assert_eq!(
        metrics::Samples::new(&reader).of("hop comm/display → driver"),
        [0]
    );
}

#[test]
fn a_plan_is_cut_at_its_questions_and_the_human_models_time_at_its_answers() {
    let mut table = StepTable::default();
    add(&mut table, GraphTopic::RobotBelief, 0, 1_000, 10);
    add(&mut table, GraphTopic::HumanBelief, 0, 1_010, 10);
    let imagined = |table: &mut StepTable, sent_ns, compute_ns, is_answer| {
        let header = Header {
            sent_ns,
            compute_ns,
            ..Header::default()
        };
        table.add_imagination(&header, 0, is_answer);
    };
    // Begins at 1 020, asks at 1 050; answered 1 060–1 100; goes on at 1 110, asks at 1 130; answered 1 135–1 175.
    imagined(&mut table, 1_050, 30, false);
    imagined(&mut table, 1_100, 40, true);
    imagined(&mut table, 1_130, 50, false);
    imagined(&mut table, 1_175, 80, true);
    let decided = Header {
        step: 1,
        sent_ns: 1_200,
        compute_ns: 70,
        ..Header::default()
    };
    table.add_decision(&decision(decided, DecisionReason::Planned));
    // The human model's next step: 15 beyond its answers.
    add(&mut table, GraphTopic::HumanBelief, 1, 1_300, 95);
    // A last plan of this episode, answered before the next one's first step: 30 beyond its answer.
    let last = Header {
        step: 1,
        sent_ns: 1_400,
        compute_ns: 60,
        ..Header::default()
    };
    table.add_imagination(&last, 0, true);
    let first = Header {
        episode: 1,
        sent_ns: 1_500,
        compute_ns: 90,
        ..Header::default()
    };
    table.add(GraphTopic::HumanBelief, &first);
    let reader = StepReader {
        table: &table,
        clock: LOCKSTEP,
    };
    let work = reader.work(GraphTopic::Decision, 0, 1).unwrap();
    assert_eq!((work.began, work.awaited), (1_020, 110));
    let stretches = reader.stretches(0, &work);
    let waited: u64 = stretches
        .iter()
        .filter(|stretch| stretch.kind == StretchKind::AwaitAnswers)
        .map(|stretch| stretch.to - stretch.from)
        .sum();
    assert_eq!(waited, 110);
    assert_eq!(reader.answers(0, 0), [(1_060, 1_100), (1_135, 1_175)]);
    let samples = Samples::new(&reader);
    assert_eq!(samples.of("compute human"), [10, 15, 30]);
    assert_eq!(samples.of(metrics::ANSWERS), [80, 60]);
    assert_eq!(samples.of(metrics::QUESTION), [10, 5]);
    assert_eq!(samples.of(metrics::AWAITED), [110]);
}

#[test]
fn in_real_time_the_newest_input_that_was_there_counts() {
    let mut table = StepTable::default();
    add(&mut table, GraphTopic::Lidar, 0, 100, 20);
    add(&mut table, GraphTopic::Action, 0, 150, 20);
    add(&mut table, GraphTopic::Lidar, 1, 200, 20);
    // Came after the belief of step 2 had begun.
    add(&mut table, GraphTopic::Action, 1, 290, 20);
    add(&mut table, GraphTopic::Lidar, 2, 250, 20);
    add(&mut table, GraphTopic::RobotBelief, 2, 300, 30);
    let reader = StepReader {
        table: &table,
        clock: ClockMode::RealTime,
    };
    let work = reader.work(GraphTopic::RobotBelief, 0, 2).unwrap();
    let action = work
        .inputs
        .iter()
        .find(|used| EDGES[used.edge].from == GraphTopic::Action);
    assert_eq!(action.unwrap().step, 0);
    assert_eq!((work.began, work.clamped), (270, false));
}
