//! Belief, human and planner over shared memory, each with its own node, decide what the same libraries decide in one
//! process: bit for bit, twice, and without allocating.

mod support;

use domains::highway::modalities::write_visual;
use human::ModelledPerson;
use messages::{
    CommAction, DriverAction, HumanBelief, ImaginePhase, ImagineStatus, Message, RobotBelief,
};
use models::imagined::ImaginedGroups;
use models::utterances::{Said, UtteranceTable};
use models::{Beliefs, Communicated, HumanModel, Observations};
use nn::Tensor;
use planner::{PlannerMethod, PlannerOptions, PlannerState};
use planning::LocalPeople;
use planning::planner::GROUPS;
use support::{Script, Set};

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

const EPISODES: u32 = 2;
const STEPS: u32 = 14;

/// What one run sent, without the times in the headers.
#[derive(Default)]
struct Sent {
    decisions: Vec<CommAction>,
    people: Vec<HumanBelief>,
    robots: Vec<RobotBelief>,
}

fn without_header<M: Message>(message: &M) -> &[u8] {
    &message.bytes()[size_of::<messages::Header>()..]
}

fn in_processes(method: PlannerMethod) -> Sent {
    let processes = ["belief", "human", "planner"];
    let clock = runtime::ClockMode::Lockstep;
    let mut set = Set::start_with(clock, &processes, options_of(method));
    let mut sent = Sent::default();
    for episode in 0..EPISODES {
        let mut script = Script::new(episode);
        for step in 0..STEPS {
            let (frame, display, action) = script.next(step, sent.decisions.last());
            set.publish(&frame, &display, &action);
            sent.robots.push(set.robot(episode, step));
            sent.people.push(set.person(episode, step));
            sent.decisions.push(set.decision(episode, step + 1));
        }
    }
    for report in set.stop() {
        let process = runtime::text_of(&report.process);
        assert_eq!(report.allocations, 0, "{process} allocated in its loop");
        assert_eq!(report.steps, u64::from(EPISODES * STEPS), "{process}");
        for port in &report.ports[..report.port_count as usize] {
            assert_eq!(
                port.lost,
                0,
                "{process} lost {}",
                runtime::text_of(&port.topic)
            );
        }
    }
    sent
}

/// The same without any process: written against the libraries, not against the processes' own code.
fn in_process(method: PlannerMethod) -> (Vec<CommAction>, Vec<Beliefs>) {
    let options = options_of(method);
    let model = support::self_model();
    let mut human = support::human();
    let mut tracker = belief::Tracker::new(support::self_model());
    let mut state = PlannerState::highway(&options, model.clone());
    let table = UtteranceTable::shipped().expect("the table ships");
    let rows = options.settings.most_rows();
    let mut groups = ImaginedGroups::new(&human, GROUPS, rows);
    let mut pending = vec![Tensor::new(2, rows); GROUPS];
    let shape = model.sizes.shape;
    let (mut decisions, mut people) = (Vec::new(), Vec::new());
    for episode in 0..EPISODES {
        let mut script = Script::new(episode);
        let mut person = Beliefs::new(human.latent(), 1);
        let mut before: Option<DriverAction> = None;
        for step in 0..STEPS {
            let (frame, display, action) = script.next(step, decisions.last());
            let mut robot = RobotBelief::ZERO;
            tracker.observe(&frame, before.as_ref(), &mut robot);
            (robot.header.episode, robot.header.step) = (episode, step);

            let mut seen = Observations::new(&shape, 1);
            write_visual(&frame.range, &frame.ego, seen.visual.column_mut(0));
            let mut verbal = 0;
            for utterance in &display.utterances[..display.utterance_count as usize] {
                let said = [Said::Nothing, Said::Slow, Said::Fast][utterance.kind as usize];
                let sector = utterance.item as usize;
                table.encode(sector, said, utterance.range_m, seen.verbal.column_mut(0));
                verbal |= 1 << sector;
            }
            let communicated = [Communicated::new(display.highlighted, verbal)];
            let taken = before.map_or([0.0; 2], |before| [before.throttle, before.steer]);
            let taken = Tensor::from_slice(2, 1, &taken);
            human.perceive(&mut person, &taken, &seen, &communicated, None);
            people.push(person.clone());

            let mut local = LocalPeople {
                model: &mut human,
                person: &person,
                groups: &mut groups,
                pending: &mut pending,
            };
            let ready_s = display.speech_ready_s;
            state
                .plan(&robot, Some(&action), ready_s, None, &mut local)
                .expect("local people answer");
            before = Some(action);
            let mut out = CommAction::ZERO;
            state.write(false, &mut out);
            decisions.push(out);
        }
    }
    (decisions, people)
}

fn options_of(method: PlannerMethod) -> PlannerOptions {
    let mut options = PlannerOptions {
        method,
        ..support::options()
    };
    if method == PlannerMethod::Race {
        // An untrained model's gains are as small as they are accidental.
        (options.settings.visual_cost, options.settings.verbal_cost) = (0.0, 0.0);
        options.settings.race.certainty = 0.0;
    }
    options
}

#[test]
fn processes_race_as_one_process_does() {
    decide_the_same(PlannerMethod::Race);
}

#[test]
fn processes_decide_what_one_process_decides() {
    decide_the_same(PlannerMethod::Ce);
}

fn decide_the_same(method: PlannerMethod) {
    let first = in_processes(method);
    let second = in_processes(method);
    let (decisions, people) = in_process(method);
    let count = (EPISODES * STEPS) as usize;
    assert_eq!(
        [
            first.decisions.len(),
            second.decisions.len(),
            decisions.len()
        ],
        [count; 3]
    );
    for i in 0..count {
        assert_eq!(
            without_header(&first.decisions[i]),
            without_header(&decisions[i]),
            "decision {i}"
        );
        assert_eq!(
            first.people[i].mean[..],
            *people[i].mean.column(0),
            "belief of the person {i}"
        );
        assert_eq!(
            without_header(&first.decisions[i]),
            without_header(&second.decisions[i])
        );
        assert_eq!(
            without_header(&first.people[i]),
            without_header(&second.people[i])
        );
        assert_eq!(
            without_header(&first.robots[i]),
            without_header(&second.robots[i])
        );
    }
    // The comparison means something only where something was said and shown, and something was not.
    let bits = |d: &CommAction| (d.visual | d.verbal << 8).count_ones();
    assert!(
        decisions.iter().any(|d| bits(d) > 0),
        "nothing was ever communicated"
    );
    assert!(
        decisions.iter().any(|d| bits(d) < 12),
        "everything was always communicated"
    );
    assert!(first.people.iter().any(|p| p.log_likelihood != 0.0));
}

#[test]
fn another_seed_decides_otherwise() {
    let gains = |seed| {
        let mut options = support::options();
        options.seed = seed;
        let model = support::self_model();
        let mut human = support::human();
        let mut state = PlannerState::highway(&options, model.clone());
        let rows = options.settings.most_rows();
        let mut groups = ImaginedGroups::new(&human, GROUPS, rows);
        let mut pending = vec![Tensor::new(2, rows); GROUPS];
        let mut person = Beliefs::new(human.latent(), 1);
        person.fresh = false;
        let robot = RobotBelief::ZERO;
        let mut local = LocalPeople {
            model: &mut human,
            person: &person,
            groups: &mut groups,
            pending: &mut pending,
        };
        state
            .plan(&robot, None, 0.0, None, &mut local)
            .expect("local people answer");
        let mut out = CommAction::ZERO;
        state.write(false, &mut out);
        (out.gain_now, out.gain_error)
    };
    assert_eq!(gains(1), gains(1));
    assert_ne!(gains(1), gains(2));
}

/// [`ModelledPerson`] is what the process keeps; its beliefs do not depend on the questions that it answers in between.
#[test]
fn questions_leave_the_person_untouched() {
    let table = || UtteranceTable::shipped().expect("the table ships");
    let mut asked = ModelledPerson::new(Box::new(support::human()), table(), 1);
    let mut alone = ModelledPerson::new(Box::new(support::human()), table(), 1);
    let mut script = Script::new(3);
    let mut question = Box::new(messages::ImagineRequest::ZERO);
    (question.visual_width, question.verbal_width) = (113, 120);
    let mut answer = Box::new(messages::ImagineAnswer::ZERO);
    for step in 0..4 {
        let (frame, display, action) = script.next(step, None);
        let taken = Some(&action);
        let (mut first, mut second) = (HumanBelief::ZERO, HumanBelief::ZERO);
        asked.observe(&frame, &display, taken, &mut first);
        alone.observe(&frame, &display, taken, &mut second);
        assert_eq!(first.bytes(), second.bytes());
        (question.header.episode, question.header.step) = (frame.header.episode, step);
        for phase in [ImaginePhase::Start, ImaginePhase::Perceive] {
            (question.phase, question.rows, question.seed) = (phase.wire(), 7, u64::from(step));
            question.futures = 7;
            asked.answer(&question, &mut answer);
            assert_eq!(answer.status(), Ok(ImagineStatus::Answered));
        }
    }
}
