//! Mutated files of every kind that users hand to this program: each is read or refused. No reader panics, hangs or asks
//! for memory that the file does not justify, and every message names the file.
//!
//! The mutations are the same in every run; `MIRROR_FUZZ=N` tries N times as many.

mod common;
#[path = "fuzz/mutate.rs"]
mod mutate;

use common::{mirror, run, told};
use domains::discrete::{self, Discrete, SimulatedPerson};
use domains::highway::modalities::layout;
use domains::highway::{self, Cockpit, Person, SimulatedDriver};
use models::{Kind, PersonalPolicy, Posterior, RecurrentPolicy, RecurrentSizes, SelfModel, Sizes};
use mutate::Mutator;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, Once};
use std::thread::ThreadId;
use std::time::Instant;

/// A reader that takes longer over a file of these sizes hangs.
const HANGS_S: u64 = 60;
/// Address space of this program: whoever believes a length that a file claims does not fit in.
const ADDRESS_SPACE: u64 = 6 << 30;

/// Reads a file as its user would, and uses what was read; the message of what was refused.
type Reader<'a> = &'a dyn Fn(&Path) -> Result<(), String>;

fn refusal<T>(result: Result<T, impl std::fmt::Display>) -> Result<T, String> {
    result.map_err(|error| error.to_string())
}

/// Files of one kind under `name`, in a folder of the test's own.
struct Fuzz {
    folder: tempfile::TempDir,
    name: &'static str,
    /// Files that were refused, for the program itself.
    refused: Vec<Vec<u8>>,
    read: usize,
}

impl Fuzz {
    fn new(name: &'static str) -> Self {
        // SAFETY: both calls only take a limit by reference.
        unsafe {
            let limit = libc::rlimit {
                rlim_cur: ADDRESS_SPACE,
                rlim_max: libc::RLIM_INFINITY,
            };
            libc::setrlimit(libc::RLIMIT_AS, &limit);
        }
        watch();
        Self {
            folder: tempfile::tempdir().unwrap(),
            name,
            refused: Vec::new(),
            read: 0,
        }
    }

    /// Reads `count` mutations of each original.
    fn read(&mut self, originals: &[Vec<u8>], count: u64, reader: Reader) {
        let path = self.folder.path().join(self.name);
        for original in originals {
            std::fs::write(&path, original).unwrap();
            reader(&path).unwrap_or_else(|error| panic!("not mutated: {error}"));
            for number in 0..count * times() {
                let mut mutator = Mutator::new(number);
                let bytes = match number % 3 {
                    0 => mutator.renumber(original),
                    _ => mutator.mutate(original),
                };
                std::fs::write(&path, &bytes).unwrap();
                begin(&format!(
                    "mutation {number} of a file of {} bytes, in {}",
                    original.len(),
                    path.display()
                ));
                let result = catch_unwind(AssertUnwindSafe(|| reader(&path)));
                end();
                let kept = || {
                    let kept = std::env::temp_dir().join(format!("fuzz-{number}-{}", self.name));
                    std::fs::write(&kept, &bytes).unwrap();
                    kept
                };
                match result {
                    Ok(Ok(())) => self.read += 1,
                    Ok(Err(said)) if said.contains(self.name) => self.refused.push(bytes),
                    Ok(Err(said)) => {
                        panic!("{} is refused without its name: {said}", kept().display())
                    }
                    Err(_) => panic!("{} makes its reader panic", kept().display()),
                }
            }
        }
        println!(
            "{}: {} read, {} refused",
            self.name,
            self.read,
            self.refused.len()
        );
    }

    /// Hands some of the refused files to the program: it refuses them as well, before anything starts.
    fn refuse_by_program(&self, arguments: &dyn Fn(&Path) -> Vec<String>) {
        let path = self.folder.path().join(self.name);
        let step = (self.refused.len() / 6).max(1);
        for bytes in self.refused.iter().step_by(step) {
            std::fs::write(&path, bytes).unwrap();
            let output = run(mirror().args(arguments(&path)));
            let error = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{}", told(&output));
            assert!(error.contains(self.name), "{}", told(&output));
            assert!(!error.contains("panicked"), "{}", told(&output));
        }
    }
}

fn times() -> u64 {
    std::env::var("MIRROR_FUZZ")
        .ok()
        .and_then(|times| times.parse().ok())
        .unwrap_or(1)
}

/// What is being read in each thread of this program, and since when.
static READING: Mutex<Vec<(ThreadId, String, Instant)>> = Mutex::new(Vec::new());

fn begin(what: &str) {
    let me = std::thread::current().id();
    READING
        .lock()
        .unwrap()
        .push((me, what.to_owned(), Instant::now()));
}

fn end() {
    let me = std::thread::current().id();
    READING.lock().unwrap().retain(|(reader, ..)| *reader != me);
}

/// Ends this program with a word if a reader hangs.
fn watch() {
    static WATCHED: Once = Once::new();
    WATCHED.call_once(|| {
        std::thread::spawn(|| {
            loop {
                std::thread::sleep(std::time::Duration::from_secs(1));
                for (_, what, since) in READING.lock().unwrap().iter() {
                    if since.elapsed().as_secs() > HANGS_S {
                        eprintln!("hangs: {what}");
                        std::process::exit(101);
                    }
                }
            }
        });
    });
}

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

fn shipped(paths: &[&str]) -> Vec<Vec<u8>> {
    paths
        .iter()
        .map(|path| std::fs::read(project(path)).unwrap())
        .collect()
}

/// Arguments that end with an error whatever the file under test holds: nothing is started for one that can be read.
fn up(option: &str, file: &Path, prefix: &str) -> Vec<String> {
    let file = format!("{prefix}{}", file.display());
    ["up", option, &file, "--record", "/nowhere/run.mcap"]
        .map(str::to_owned)
        .to_vec()
}

fn drive_highway(scene: highway::Scene, person: &Person) {
    let scene = Arc::new(highway::Scene {
        episode: highway::scene::Episode {
            max_steps: scene.episode.max_steps.min(6),
            ..scene.episode
        },
        ..scene
    });
    let Ok(mut world) = highway::World::new(scene.clone()) else {
        return;
    };
    world.reset(1, 0);
    let cockpit = Cockpit::new(&scene, world.road(), world.ego().at.s_m);
    let mut driver = SimulatedDriver::new(person, &scene.fog(), cockpit);
    driver.reset(1, 0);
    highway::episode::run(
        &mut world,
        &mut driver,
        |_, _| highway::Shown::default(),
        None,
    );
}

fn play(scene: &discrete::Scene, person: Option<&Path>) -> Result<(), String> {
    let domain = scene.domain();
    let words = models::words::shipped(domain).map_err(|error| error.to_string())?;
    let mut world = refusal(discrete::World::new(scene, &words))?;
    let mut mind = match person {
        None => refusal(SimulatedPerson::builtin(scene, 1, &words))?,
        Some(file) => refusal(SimulatedPerson::load(scene, file, &words))?,
    };
    training::rounds::Rounds::record(&mut world, &mut mind, 1, 0, 1);
    Ok(())
}

#[test]
fn scenes() {
    let mut fuzz = Fuzz::new("scene.toml");
    let read = |path: &Path| {
        let bytes = std::fs::read(path).unwrap();
        let text = String::from_utf8(bytes);
        let is_discrete = match &text {
            Ok(text) => refusal(discrete::Scene::is_discrete(path, text))?,
            Err(_) => false,
        };
        match is_discrete {
            true => play(&refusal(discrete::Scene::load(path))?, None),
            false => {
                let scene = refusal(highway::Scene::load(path))?;
                drive_highway(scene, &Person::builtin(1).unwrap());
                Ok(())
            }
        }
    };
    let originals = shipped(&[
        "launch/scenes/highway-fog.toml",
        "launch/scenes/driving-fog.toml",
        "launch/scenes/search-smoke.toml",
        "launch/scenes/bomb.toml",
    ]);
    fuzz.read(&originals, 100, &read);
    fuzz.refuse_by_program(&|path| up("--scene", path, ""));
}

#[test]
fn people() {
    let mut fuzz = Fuzz::new("person.toml");
    let read = |path: &Path| {
        let person = refusal(Person::load(path))?;
        drive_highway(highway::Scene::builtin("highway-fog").unwrap(), &person);
        Ok(())
    };
    fuzz.read(
        &shipped(&["shared/domains/people/highway/01.toml"]),
        200,
        &read,
    );
    for domain in discrete::Domain::ALL {
        let scene = discrete::Scene::of(domain, discrete::Setting::Transfer);
        let original = shipped(&[&format!("shared/domains/people/{}/01.toml", domain.name())]);
        fuzz.read(&original, 70, &|path| play(&scene, Some(path)));
    }
    fuzz.refuse_by_program(&|path| up("--driver", path, "sim:"));
}

#[test]
fn models_and_what_was_learned() {
    let mut fuzz = Fuzz::new("model.safetensors");
    let rng = &mut ChaCha8Rng::seed_from_u64(1);
    let file = fuzz.folder.path().join("original");
    let bytes_of = |write: &dyn Fn(&Path)| {
        write(&file);
        vec![std::fs::read(&file).unwrap()]
    };
    // The highway's: a self-model, implants, a policy.
    let highway = layout();
    let sizes = Sizes::of(&highway).with_hidden(4);
    let model = SelfModel::new(sizes, highway.clone(), rng);
    let implants = Posterior::neutral(&model, true);
    let policy_sizes = RecurrentSizes {
        hidden: 4,
        ..RecurrentSizes::of(&highway, 1)
    };
    let person = PersonalPolicy {
        policy: RecurrentPolicy::new(policy_sizes, &highway, rng),
        limits: vec![10.0; highway.perception.limits()],
        heard: 0,
    };
    let original = bytes_of(&|path| model.save(path, "tests").unwrap());
    fuzz.read(&original, 150, &|path| {
        refusal(SelfModel::load(path, highway.clone())).map(drop)
    });
    fuzz.refuse_by_program(&|path| up("--self-model", path, ""));
    fuzz.refused.clear();
    let original = bytes_of(&|path| implants.save(path, &model, 0, "tests").unwrap());
    fuzz.read(&original, 100, &|path| {
        refusal(Posterior::load(path, &model)).map(drop)
    });
    fuzz.refused.clear();
    let original = bytes_of(&|path| {
        let saved = person.save(path, Kind::Bc, &highway, "tests", &[]);
        saved.unwrap();
    });
    fuzz.read(&original, 100, &|path| {
        refusal(PersonalPolicy::load(path, Kind::Bc, &highway)).map(drop)
    });
    fuzz.refused.clear();
    // A gridworld's.
    let scene = discrete::Scene::of(discrete::Domain::Driving, discrete::Setting::Transfer);
    let layout = models::words::layout_of(&scene).unwrap();
    let original = shipped(&["shared/pretrained/driving-self.safetensors"]);
    fuzz.read(&original, 100, &|path| {
        refusal(SelfModel::load(path, layout.clone())).map(drop)
    });
    let model = SelfModel::load(
        &project("shared/pretrained/driving-self.safetensors"),
        layout,
    )
    .unwrap();
    let implants = Posterior::neutral(&model, true);
    let original = bytes_of(&|path| implants.save(path, &model, 0, "tests").unwrap());
    fuzz.refused.clear();
    fuzz.read(&original, 100, &|path| {
        refusal(Posterior::load(path, &model)).map(drop)
    });
}

/// What `--resume` goes on from; a gridworld's learns on for a phase, where it can be read.
#[test]
fn checkpoints_of_training() {
    let mut fuzz = Fuzz::new("run.safetensors");
    let file = fuzz.folder.path().join("original");
    let domain = discrete::Domain::Driving;
    let words = models::words::shipped(domain).unwrap();
    let scene = discrete::Scene::of(domain, discrete::Setting::Original);
    let world = || -> Box<dyn training::environment::Environment> {
        let world = discrete::World::new(&scene, &words).unwrap();
        Box::new(training::environment::Gridworld::from(world))
    };
    let settings = training::self_model::SelfModelSettings {
        rounds: 2,
        gradient_steps: 1,
        sequences: 4,
        length: 4,
        ..training::self_model::SelfModelSettings::of(domain.name())
    };
    let mut trainer = training::self_model::Trainer::new(world(), settings);
    trainer.phase();
    trainer.save(&file, "tests").unwrap();
    let original = vec![std::fs::read(&file).unwrap()];
    let read = |path: &Path| {
        let mut trainer = refusal(training::self_model::Trainer::resume(path, world()))?;
        // Not what was asked for instead: lengths that only take long.
        if trainer.settings == settings {
            trainer.phase();
        }
        Ok(())
    };
    fuzz.read(&original, 100, &read);
}

#[test]
fn demonstrations() {
    let mut fuzz = Fuzz::new("rounds.safetensors");
    let file = fuzz.folder.path().join("original");
    let highway = training::rounds::Rounds::record_drives_in(
        Arc::new(highway::Scene::builtin("highway-fog").unwrap()),
        &Person::builtin(1).unwrap(),
        1,
        0,
        2,
    );
    highway.unwrap().save(&file).unwrap();
    let original = vec![std::fs::read(&file).unwrap()];
    fuzz.read(&original, 150, &|path| {
        let layout = highway::modalities::layout();
        refusal(training::rounds::Rounds::load(path, &layout)).map(drop)
    });
    let train = |domain: &str, path: &Path| {
        [
            "train",
            "human",
            "--kind",
            "mirror",
            "--domain",
            domain,
            "--out",
            "/tmp/never.safetensors",
            "--demos",
            &path.display().to_string(),
        ]
        .map(str::to_owned)
        .to_vec()
    };
    fuzz.refuse_by_program(&|path| train("highway", path));
    fuzz.refused.clear();
    let scene = discrete::Scene::of(discrete::Domain::Driving, discrete::Setting::Transfer);
    let words = models::words::shipped(discrete::Domain::Driving).unwrap();
    let mut world = discrete::World::new(&scene, &words).unwrap();
    let layout = world.layout().clone();
    let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
    let rounds = training::rounds::Rounds::record(&mut world, &mut person, 1, 0, 3);
    rounds.save(&file).unwrap();
    let original = vec![std::fs::read(&file).unwrap()];
    fuzz.read(&original, 150, &|path| {
        refusal(training::rounds::Rounds::load(path, &layout)).map(drop)
    });
    fuzz.refuse_by_program(&|path| train("driving", path));
}

#[test]
fn recordings() {
    let mut fuzz = Fuzz::new("drive.mcap");
    let file = fuzz.folder.path().join("original.mcap");
    let about = recorder::recording::About {
        scene: "fog".to_owned(),
        run_id: 42,
        ..Default::default()
    };
    let recording = recorder::recording::Recording::create(&file, &about, &[]).unwrap();
    let mut queue =
        recorder::queue::Queue::start(recording, recorder::queue::WhenFull::Grow, 8).unwrap();
    for step in 0..4 {
        let mut action = messages::DriverAction::default();
        action.header.step = step;
        queue.push(&(&action).into());
    }
    let none = [0; recorder::topics::TOPICS.len()];
    queue.finish(&none, &none);
    let original = vec![std::fs::read(&file).unwrap()];
    fuzz.read(&original, 300, &|path| {
        refusal(recorder::read::read(path, |_| {})).map(drop)
    });
    fuzz.refuse_by_program(&|path| ["replay".to_owned(), path.display().to_string()].to_vec());
}

#[test]
fn scenarios() {
    let mut fuzz = Fuzz::new("scenario.xml");
    let person = Person::builtin(1).unwrap();
    let read = |path: &Path| {
        let scenario = refusal(domains::commonroad::Scenario::read(path))?;
        let scene = refusal(scenario.scene(Some(15.0), None))?;
        drive_highway(scene, &person);
        for id in scenario.seats() {
            drive_highway(refusal(scenario.scene(None, Some(id)))?, &person);
        }
        Ok(())
    };
    let folder = "shared/domains/tests/commonroad_data";
    let originals = shipped(&[
        &format!("{folder}/2018b.xml"),
        &format!("{folder}/2020a.xml"),
    ]);
    fuzz.read(&originals, 150, &read);
    fuzz.refuse_by_program(&|path| up("--scene", path, ""));
}

/// A study goes on from its table and its settings. A row that it would not have written is done again.
#[test]
fn tables_of_a_study() {
    let study = experiments::drive::Study {
        conditions: vec![experiments::drive::Condition::Clear],
        people: 1,
        seeds: 1,
        planned_seeds: 1,
        seed: 4,
        rounds: 6,
        settings: planning::Settings::default(),
    };
    let folder = tempfile::tempdir().unwrap();
    let run = |out: &Path| experiments::drive::run(&study, None, out, &|_, _| {});
    run(folder.path()).unwrap();
    for name in ["drive.csv", "drive.settings.json"] {
        let mut fuzz = Fuzz::new(name);
        let original = vec![std::fs::read(folder.path().join(name)).unwrap()];
        let other = ["drive.csv", "drive.settings.json"]
            .into_iter()
            .find(|other| *other != name)
            .unwrap();
        let beside = std::fs::read(folder.path().join(other)).unwrap();
        fuzz.read(&original, 100, &|path| {
            std::fs::write(path.with_file_name(other), &beside).unwrap();
            let report = run(path.parent().unwrap()).map_err(|error| format!("{error:#}"))?;
            serde_json::to_string(&report)
                .map(drop)
                .map_err(|error| error.to_string())
        });
    }
}

/// Tables of rounds are read by Python.
#[test]
fn tables_of_rounds() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let Some(python) = testing::python(directory, "python-plain", &[], "") else {
        testing::skipped("tables_of_rounds", "there is no Python");
        return;
    };
    let mut command = std::process::Command::new(&python);
    command
        .arg(project("tests/fuzz/rounds.py"))
        .arg(project("examples/python/rounds.py"));
    let output = run(command.arg((400 * times()).to_string()));
    assert!(output.status.success(), "{}", told(&output));
    println!(
        "rounds.csv: {}",
        String::from_utf8_lossy(&output.stdout).trim()
    );
}
