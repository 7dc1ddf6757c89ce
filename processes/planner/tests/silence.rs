//! What the planner does when there is nobody to ask, and when the episode ends.

mod support;

use messages::{CommAction, DecisionReason, Display, DriverAction, LidarFrame, Message};
use planner::{PlannerMethod, PlannerOptions};
use runtime::ClockMode;
use support::{Script, Set};

fn said_nothing(decision: &CommAction, reason: DecisionReason) {
    assert_eq!(
        (decision.visual, decision.verbal, decision.reason()),
        (0, 0, Ok(reason))
    );
}

fn publish_rest(set: &mut Set, step: u32) {
    let (mut frame, mut display, mut action) =
        (LidarFrame::ZERO, Display::ZERO, DriverAction::ZERO);
    for header in [&mut frame.header, &mut display.header, &mut action.header] {
        header.step = step;
    }
    set.publish(&frame, &display, &action);
}

#[test]
fn without_a_planner_every_step_gets_an_empty_decision() {
    let options = PlannerOptions {
        method: PlannerMethod::None,
        ..support::options()
    };
    let mut set = Set::start_with(ClockMode::Lockstep, &["planner"], options);
    for step in 0..3 {
        set.publish_beliefs(0, step, false);
        said_nothing(&set.decision(0, step + 1), DecisionReason::NoPlanner);
    }
    set.stop();
}

#[test]
fn in_real_time_no_human_belief_means_silence_and_says_why() {
    let mut set = Set::start_with(ClockMode::RealTime, &["planner"], support::options());
    publish_rest(&mut set, 0);
    set.publish_beliefs(0, 0, false);
    said_nothing(&set.decision(0, 1), DecisionReason::HumanSilent);
    set.stop();
}

/// The human model died: its last belief is there, its answers never come.
#[test]
fn in_real_time_unanswered_questions_mean_silence() {
    let mut set = Set::start_with(ClockMode::RealTime, &["planner"], support::options());
    for step in 0..7 {
        publish_rest(&mut set, step);
        set.publish_beliefs(0, step, true);
        said_nothing(&set.decision(0, step + 1), DecisionReason::HumanSilent);
    }
    set.stop();
}

/// The last frame of an episode gets beliefs, but nobody acts on it: the planner goes on with the next episode.
#[test]
fn an_episode_may_end_between_belief_and_action() {
    let mut set = Set::start(ClockMode::Lockstep);
    for episode in 0..3 {
        let mut script = Script::new(episode);
        for step in 0..2 {
            let (frame, display, action) = script.next(step, None);
            set.publish(&frame, &display, &action);
            assert_eq!(
                set.decision(episode, step + 1).reason(),
                Ok(DecisionReason::Planned)
            );
        }
        let (frame, display, _) = script.next(2, None);
        set.publish_unanswered(&frame, &display);
        set.robot(episode, 2);
        set.person(episode, 2);
    }
    set.stop();
}

#[test]
fn impossible_options_are_refused_before_anything_starts() {
    let root = testing::private_directory();
    let arguments = runtime::RunArguments::new(root.path(), "never", 1, ClockMode::Lockstep)
        .expect("a good name");
    let refuses = |options: PlannerOptions, word: &str| {
        let error = planner::run(&arguments, &options)
            .expect_err("refused")
            .to_string();
        assert!(error.contains(word), "{error}");
    };
    let mut options = support::options();
    options.settings.elites = 1000;
    refuses(options, "elites");
    refuses(
        PlannerOptions {
            step_s: 0.0,
            ..support::options()
        },
        "step_s",
    );
    refuses(support::options(), "need a model");
    refuses(
        PlannerOptions {
            model: Some("/nowhere/self.safetensors".into()),
            ..support::options()
        },
        "/nowhere/self.safetensors",
    );
}
