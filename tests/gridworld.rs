//! Gridworlds across real processes: a set decides what one process decides, bit for bit; everything else that a set can do, it
//! can do there too.

mod common;

use common::{
    Bench, Live, assert_no_message_lost, assert_nothing_left, instance, mirror, run, summary, told,
};
use domains::discrete::{Discrete, Mind, Scene, SimulatedPerson, Words, World};
use domains::{Layout, Mask};
use models::{Communicated, HumanModel, IdealHuman, Kind, Posterior, SelfModel, Sizes, load_human};
use planning::items::settings_of;
use planning::round::{Advice, play};
use planning::{Assistant, Method, PlanMoment};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use replay::Drive;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// A scene in which planning takes moments, and something is said now and then; `search_rescue original` is the clear setting.
fn quick(domain: &str, rate: f64, cost: f64) -> String {
    let (domain, setting) = domain.split_once(' ').unwrap_or((domain, "transfer"));
    format!(
        "name = \"quick\"\ndomain = \"{domain}\"\nsetting = \"{setting}\"\n\
         [communication]\nvisual_cost = {cost:?}\nverbal_cost = {cost:?}\n\
         [planning]\nhorizon = 2\nsamples = 60\nelites = 12\niterations = 2\n\
         visual_threshold = 0.3\nverbal_threshold = 0.3\n\
         race_steps = 4\nrace_first = 4\nrace_futures = 16\nrace_certainty = 0.0\n\
         [episode]\nmax_steps = 9\n[clock]\nrate = {rate:?}\n"
    )
}

/// A scene, and models that never learned anything: what these tests ask does not depend on that.
struct Grid {
    bench: Bench,
    file: PathBuf,
    scene: Scene,
    words: Words,
    model: Arc<SelfModel>,
}

impl Grid {
    fn new(domain: &str, rate: f64) -> Self {
        Self::with_cost(domain, rate, 0.001)
    }

    /// Where an item costs so much.
    fn with_cost(domain: &str, rate: f64, cost: f64) -> Self {
        let bench = Bench::new();
        let file = bench.write("quick.toml", quick(domain, rate, cost));
        let scene = Scene::load(&file).unwrap();
        let words = models::words::shipped(scene.domain()).unwrap();
        let layout = models::words::layout_of(&scene).unwrap();
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        let model = SelfModel::new(Sizes::of(&layout), layout, rng);
        let (of_robot, of_person) = (bench.path("grid.safetensors"), bench.path("person"));
        model.save(&of_robot, "tests").unwrap();
        let implants = Posterior::neutral(&model, true);
        implants.save(&of_person, &model, 0, "tests").unwrap();
        Self {
            bench,
            file,
            scene,
            words,
            model: Arc::new(model),
        }
    }

    /// `mirror up` there.
    fn up(&self, instance: &str, human: &str, planner: &str) -> Command {
        let mut command = mirror();
        command
            .args(["up", "--instance", instance, "--human", human])
            .args(["--planner", planner, "--seed", "5", "--scene"])
            .arg(&self.file)
            .arg("--self-model")
            .arg(self.bench.path("grid.safetensors"));
        if human.starts_with("mirror") {
            command.arg("--implants").arg(self.bench.path("person"));
        }
        command
    }

    fn world(&self) -> World {
        World::new(&self.scene, &self.words).unwrap()
    }

    fn person(&self) -> SimulatedPerson {
        SimulatedPerson::builtin(&self.scene, 1, &self.words).unwrap()
    }

    fn human(&self, kind: &str) -> Box<dyn HumanModel> {
        if kind == "ideal" {
            let actions = self.model.layout.actions.rows();
            return Box::new(IdealHuman::new(self.person(), actions));
        }
        let file = self.bench.path("person");
        load_human(Some(&file), Kind::Mirror, &self.model).unwrap()
    }

    fn assistant(&self, (kind, planner): (&str, &str)) -> Assistant<Arc<Layout>> {
        let settings = settings_of(self.scene.planning());
        let method = match planner {
            "kl" => Method::Kl,
            "ce" => Method::Ce,
            _ => Method::Race,
        };
        let (model, layout) = (Arc::clone(&self.model), Arc::clone(&self.model.layout));
        Assistant::new(model, self.human(kind), settings, method, layout)
    }
}

/// What happens at a step.
#[derive(Debug, PartialEq)]
struct Step {
    choice: u32,
    told: Mask,
    /// The decision after it: items, and the bits of their probabilities.
    decided: Mask,
    probabilities: Vec<u32>,
    /// Bits of the log-likelihood of the action before.
    log_likelihood: Option<u32>,
}

/// An episode without any process, with the order of a step as `planning::round::play` has it.
fn in_one_process(grid: &Grid, who: (&str, &str), episode: u32) -> (Vec<Step>, f32) {
    const SEED: u64 = 5;
    let (mut world, mut person, mut assistant) = (grid.world(), grid.person(), grid.assistant(who));
    let layout = world.layout().clone();
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    world.reset(SEED, episode, episode);
    person.reset(SEED, episode);
    let (mut steps, mut told) = (Vec::new(), Mask::NONE);
    let mut taken = vec![0.0; layout.actions.rows()];
    let (mut reward, mut log_likelihood) = (0.0, None);
    while world.end().is_running() {
        let step = steps.len() as u32;
        world.observe(&mut visual, &mut verbal);
        let seen = person.look(&visual);
        person.perceive(&visual, &verbal, seen | told);
        let choice = person.act();
        let at = [SEED, u64::from(episode), u64::from(step)];
        let items = Communicated::items(told);
        assistant.observe(&visual, &verbal, items, &taken, at);
        let expected = assistant.expected_action().log_probability().unwrap();
        let next = expected.column(0)[choice];
        taken.fill(0.0);
        taken[choice] = 1.0;
        let moment = PlanMoment {
            seed: SEED,
            episode,
            step,
            speech_ready_steps: 0,
        };
        let plan = assistant.search(Some(&taken), moment).unwrap();
        let items = 0..layout.regions + layout.utterances;
        let decided = plan.communicated.mask();
        steps.push(Step {
            choice: choice as u32,
            told,
            decided,
            probabilities: items
                .map(|item| assistant.probability(item).to_bits())
                .collect(),
            log_likelihood,
        });
        log_likelihood = Some(f32::to_bits(next));
        reward += world.step(choice).reward;
        told = decided;
    }
    (steps, reward)
}

/// An episode of a recording.
fn recorded(grid: &Grid, drive: &Drive, episode: u32) -> (Vec<Step>, f32) {
    let (regions, utterances) = {
        let world = grid.world();
        (world.layout().regions, world.layout().utterances)
    };
    let (mut steps, mut reward) = (Vec::new(), 0.0);
    for ((_, number), step) in drive.steps.range((episode, 0)..(episode + 1, 0)) {
        let outcome = step.outcome.as_ref().unwrap();
        if *number > 0 {
            reward += outcome.reward;
        }
        if outcome.end != 0 {
            break;
        }
        let display = step.display.as_ref().unwrap();
        let action = step.action.unwrap();
        assert_eq!(action.is_choice, 1);
        let next = drive.steps[&(episode, number + 1)].decision.unwrap();
        let visual = next.visual_probability[..regions].iter();
        let both = visual.chain(&next.verbal_probability[..utterances]);
        let likelihood = step.human.unwrap().log_likelihood.to_bits();
        steps.push(Step {
            choice: action.choice,
            told: Mask {
                visual: u64::from(display.highlighted),
                verbal: display.said(),
            },
            decided: Mask {
                visual: u64::from(next.visual),
                verbal: next.verbal,
            },
            probabilities: both.map(|p| p.to_bits()).collect(),
            log_likelihood: (*number > 0).then_some(likelihood),
        });
    }
    (steps, reward)
}

/// Runs two episodes in a set with a human model and a planner, and compares every step with the same in one process.
fn decides_what_one_process_decides(domain: &str, who: (&str, &str)) {
    // What untrained models gain by words in one future is as small as it is accidental.
    let cost = if who.1 == "race" { 0.0 } else { 0.001 };
    let grid = Grid::with_cost(domain, 1.0, cost);
    let name = format!("{}{}-{}-{}", &domain[..4], domain.len(), who.0, who.1);
    let name = instance(&name);
    let (recording, file) = (grid.bench.path("drive.mcap"), grid.bench.path("up.json"));
    let mut command = grid.up(&name, who.0, who.1);
    command
        .args(["--episodes", "2", "--record"])
        .arg(&recording);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    assert_nothing_left(&name);
    let drive = Drive::read(&recording).unwrap();
    let found = summary(&file);
    let (mut told_of, mut silent) = (0, 0);
    for episode in 0..2 {
        let (expected, reward) = in_one_process(&grid, who, episode);
        let (steps, recorded_reward) = recorded(&grid, &drive, episode);
        assert_eq!(steps, expected, "{domain}, episode {episode}");
        assert_eq!(recorded_reward.to_bits(), reward.to_bits());
        told_of += expected.iter().filter(|s| s.told != Mask::NONE).count();
        silent += expected.iter().filter(|s| s.told == Mask::NONE).count();

        let (mut world, mut person) = (grid.world(), grid.person());
        let mut assistant = grid.assistant(who);
        let advice = Advice::Planned(&mut assistant);
        let played = play(&mut world, &mut person, advice, 5, episode).unwrap();
        let counted = &found["episode_list"][episode as usize];
        assert_eq!(counted["steps"], played.steps);
        assert_eq!(counted["visual_items"], played.visual_items);
        assert_eq!(counted["verbal_items"], played.verbal_items);
        let near = |key: &str, value: f32| {
            let found = counted[key].as_f64().unwrap();
            assert!(
                (found - f64::from(value)).abs() < 1e-4,
                "{key}: {found} {value}"
            );
        };
        near("reward", played.reward);
        near("communication_cost", played.cost);
    }
    // The comparison means something only where something was communicated; belief matching is seldom silent.
    let least = if who.1 == "kl" { 0 } else { 2 };
    assert!(
        told_of > 0 && silent > least,
        "{domain}: {told_of} {silent}"
    );
    assert_eq!(found["scene"], "quick");
    assert_eq!(found["missed_deadlines"], 0);
    for process in ["world", "driver", "belief", "human", "planner"] {
        assert_eq!(found["allocations"][process], 0, "{process}");
    }
    assert_no_message_lost(&found);
    replays(&grid, &recording, &name);
}

/// The recording gives the same beliefs and decisions again.
fn replays(grid: &Grid, recording: &Path, name: &str) {
    let file = grid.bench.path("replay.json");
    let mut command = mirror();
    command
        .arg("replay")
        .arg(recording)
        .args(["--instance", name]);
    let output = run(command.arg("--summary").arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    let report = summary(&file);
    assert_eq!(report["reproduced"], true, "{}", told(&output));
    assert!(report["decisions"]["compared"].as_u64().unwrap() > 2);
}

#[test]
fn driving_in_a_set_is_driving_in_one_process() {
    decides_what_one_process_decides("driving", ("mirror", "ce"));
}

#[test]
fn searching_in_a_set_is_searching_in_one_process() {
    decides_what_one_process_decides("search_rescue", ("mirror", "ce"));
}

#[test]
fn defusing_in_a_set_is_defusing_in_one_process() {
    decides_what_one_process_decides("bomb_defusal", ("mirror", "ce"));
}

#[test]
fn candidates_race_in_a_set_as_in_one_process() {
    decides_what_one_process_decides("driving", ("ideal", "race"));
}

/// The simulated person's own model, to whom it is chance what the person notices.
#[test]
fn the_ideal_model_in_a_set_is_the_ideal_model_in_one_process() {
    decides_what_one_process_decides("bomb_defusal", ("ideal", "ce"));
}

/// In clear air searchers hear what is so without an assistant; their imagined selves do, too.
#[test]
fn people_who_hear_by_themselves_do_in_a_set_what_they_do_in_one_process() {
    decides_what_one_process_decides("search_rescue original", ("ideal", "ce"));
    decides_what_one_process_decides("search_rescue original", ("mirror", "kl"));
}

/// The person may be the caller's: a recording has them attached, and replays when their file is gone. A recording of another
/// human model can be asked what theirs would have said.
#[test]
fn the_ideal_model_is_replayed_from_the_recording_alone() {
    let grid = Grid::new("bomb_defusal", 1.0);
    let person = grid.bench.write("me.toml", "id = 77\nnotice = 0.5\n");
    for (n, human) in ["ideal", "self"].into_iter().enumerate() {
        let name = instance(&format!("grid-attached-{n}"));
        let recording = grid.bench.path(&format!("{human}.mcap"));
        let mut command = grid.up(&name, human, "ce");
        command
            .args(["--quiet", "--episodes", "2", "--driver"])
            .arg(format!("sim:{}", person.display()))
            .arg("--record")
            .arg(&recording);
        let output = run(&mut command);
        assert!(output.status.success(), "{}", told(&output));
    }
    let file = grid.bench.path("replay.json");
    let replay = |recording: &str, more: &[&str]| {
        let mut command = mirror();
        command
            .arg("replay")
            .arg(grid.bench.path(recording))
            .args(["--instance", &instance("grid-attached")])
            .args(more);
        let output = run(command.arg("--summary").arg(&file));
        assert!(output.status.success(), "{}", told(&output));
        summary(&file)
    };
    std::fs::remove_file(person).unwrap();
    let other = replay("self.mcap", &["--human", "ideal"]);
    assert_eq!(other["now"]["human"], "ideal");
    let learned = replay("ideal.mcap", &["--human", "mirror-p"]);
    assert_eq!(learned["now"]["human"], "mirror-p");
    let same = replay("ideal.mcap", &[]);
    assert_eq!(same["reproduced"], true);
}

/// With 16,384 versions a step, in several questions.
#[test]
fn matching_beliefs_in_a_set_is_matching_them_in_one_process() {
    decides_what_one_process_decides("search_rescue", ("mirror", "kl"));
}

#[test]
fn equal_seeds_give_equal_digests() {
    let grid = Grid::new("bomb_defusal", 1.0);
    let digests = [1, 2].map(|n| {
        let name = instance(&format!("grid-digest-{n}"));
        let file = grid.bench.path(&format!("{n}.json"));
        let mut command = grid.up(&name, "self", "race");
        let output = run(command.args(["--quiet", "--summary"]).arg(&file));
        assert!(output.status.success(), "{}", told(&output));
        summary(&file)["digest"].as_str().unwrap().to_owned()
    });
    assert_eq!(digests[0].len(), 64);
    assert_eq!(digests[0], digests[1]);
}

/// Without a file of what was learned, the start records rounds and learns from them; short rounds of bomb defusal are more.
#[test]
fn human_models_are_learned_at_the_start() {
    let grid = Grid::new("bomb_defusal", 1.0);
    for kind in ["mirror-p", "bc"] {
        let name = instance(&format!("grid-learned-{kind}"));
        let file = grid.bench.path("learned.json");
        let mut command = mirror();
        command
            .args(["up", "--instance", &name, "--human", kind, "--planner"])
            .args(["none", "--episodes", "1", "--quiet", "--scene"])
            .arg(&grid.file)
            .arg("--self-model")
            .arg(grid.bench.path("grid.safetensors"));
        let output = run(command.arg("--summary").arg(&file));
        assert!(output.status.success(), "{kind}: {}", told(&output));
        assert_eq!(summary(&file)["human"], kind);
        assert_nothing_left(&name);
    }
}

#[test]
fn the_real_time_clock_runs_to_the_end_too() {
    let grid = Grid::new("search_rescue", 20.0);
    let name = instance("grid-realtime");
    let file = grid.bench.path("up.json");
    let mut command = grid.up(&name, "self", "race");
    command.args(["--clock", "realtime", "--episodes", "2", "--summary"]);
    let output = run(command.arg(&file));
    assert!(output.status.success(), "{}", told(&output));
    let summary = summary(&file);
    assert_eq!(summary["clock"], "realtime");
    assert_eq!(summary["episodes"], 2);
    assert_eq!(summary["steps"], 18, "two times nine, whoever was late");
    assert_nothing_left(&name);
}

#[test]
fn what_cannot_be_is_refused() {
    let grid = Grid::new("driving", 1.0);
    let highway = grid.bench.path("self.safetensors").display().to_string();
    let name = instance("grid-refused");
    for (arguments, told_of) in [
        (
            vec!["--planner", "kl", "--human", "ideal"],
            "belief matching",
        ),
        (
            vec!["--human", "ideal", "--implants", &highway],
            "`ideal` has none",
        ),
        (vec!["--fog", "20"], "--fog"),
        (vec!["--driver", "recorded:3"], "recorded:3"),
        (vec!["--driver", "sim:11"], "sim:11"),
        (vec!["--self-model", &highway], "self.safetensors"),
        (
            vec!["--implants", &highway, "--human", "mirror"],
            "self.safetensors",
        ),
    ] {
        let mut command = mirror();
        command.args(["up", "--instance", &name]);
        if !arguments.contains(&"--human") {
            command.args(["--human", "self"]);
        }
        command.arg("--scene").arg(&grid.file);
        if !arguments.contains(&"--self-model") {
            let model = grid.bench.path("grid.safetensors");
            command.arg("--self-model").arg(model);
        }
        let output = run(command.args(&arguments));
        assert_eq!(output.status.code(), Some(2), "{}", told(&output));
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(error.contains(told_of), "no {told_of:?} in {error}");
        assert!(!error.contains("panicked"), "{error}");
    }
    assert_nothing_left(&name);
}

#[test]
fn processes_change_places() {
    let grid = Grid::new("driving", 1.0);
    let name = instance("grid-swap");
    let mut command = grid.up(&name, "self", "none");
    // Quiet: nobody reads what it prints, and a full pipe would stop everybody.
    let mut live = Live::start_quietly(command.args(["--episodes", "1000000", "--quiet"]), &name);
    let implants = grid.bench.path("person").display().to_string();
    for arguments in [
        vec!["human", "mirror", "--implants", &implants],
        vec!["human", "self"],
        vec!["planner", "ce"],
        vec!["planner", "race"],
        vec!["driver", "sim:2"],
        vec!["planner", "kl"],
        vec!["planner", "race"],
        vec!["human", "ideal"],
    ] {
        let file = grid.bench.path("report.json");
        let mut swap = mirror();
        swap.arg("swap").args(&arguments);
        let output = run(swap.args(["--instance", &name, "--report"]).arg(&file));
        assert!(output.status.success(), "{arguments:?}: {}", told(&output));
        let report = summary(&file);
        assert_eq!(report["ticks_without_answer"], 0, "{report}");
        assert_eq!(report["lost_messages"], 0, "{report}");
    }
    let mut swap = mirror();
    let output = run(swap.args(["swap", "planner", "kl", "--instance", &name]));
    assert!(!output.status.success(), "{}", told(&output));
    assert!(told(&output).contains("belief matching"));
    live.interrupt();
    assert_eq!(live.wait().code(), Some(1), "interrupted");
    live.assert_all_ended();
    assert_nothing_left(&name);
}

#[test]
fn processes_that_die_are_replaced() {
    const EPISODES: u64 = 20;
    for process in ["world", "driver", "belief", "human", "planner", "renderer"] {
        let grid = Grid::new("driving", 1.0);
        let name = instance(&format!("grid-killed-{process}"));
        let file = grid.bench.path("up.json");
        let mut command = grid.up(&name, "self", "race");
        command.args(["--episodes", &EPISODES.to_string(), "--summary"]);
        let mut live = Live::start(command.arg(&file), &name);
        live.signal(process, libc::SIGKILL);
        assert!(live.wait().success(), "{process}");
        live.assert_all_ended();
        assert_nothing_left(&name);
        let summary = summary(&file);
        assert_eq!(summary["restarts"], 1, "{process}");
        assert_eq!(summary["deaths"][0]["process"], process);
        let void = u64::from(process == "world");
        assert_eq!(summary["episodes"], EPISODES - void, "{process}");
        assert_eq!(summary["completed"], true, "{process}");
    }
}
