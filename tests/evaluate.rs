//! Studies: killed in the middle and started again they end with the same tables; what cannot be used is refused.

mod common;

use common::{mirror, run, told};
use domains::discrete::{Discrete, Domain, Scene, Setting, World};
use models::{SelfModel, Sizes};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

/// The recorded scene that ships.
const RECORDED: &str = include_str!("../examples/commonroad/highway-recorded.xml");

/// A folder with a self-model of gridworld driving that never learned anything: what these tests ask does not depend on that.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.learn_nothing_again(1);
        folder
    }

    /// Other weights for every seed.
    fn learn_nothing_again(&self, seed: u64) {
        let words = models::words::shipped(Domain::Driving).unwrap();
        let world = World::new(&Scene::of(Domain::Driving, Setting::Original), &words).unwrap();
        let layout = Arc::new(world.layout().clone());
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let model = SelfModel::new(Sizes::of(&layout), layout, rng);
        model.save(&self.path("self.safetensors"), "tests").unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A short study of `mirror evaluate`.
    fn study(&self, words: &[&str], out: &Path) -> Command {
        let mut command = mirror();
        command.arg("evaluate").args(words).arg("--quick");
        command.args(["--domain", "driving", "--people", "2", "--self-model"]);
        command
            .arg(self.path("self.safetensors"))
            .arg("--out")
            .arg(out);
        command
    }
}

/// Lines of a table, its head included.
fn lines(table: &Path) -> usize {
    let text = std::fs::read_to_string(table).unwrap_or_default();
    text.lines().count()
}

/// Runs a study, which writes into the folder it is given, to its end, and another that is killed (SIGKILL) when a third of it is
/// done and then started again. The latter's folder.
fn killed_and_continued(folder: &Folder, study: &dyn Fn(&Path) -> Command, table: &str) -> PathBuf {
    let (whole, cut) = (folder.path("whole"), folder.path("cut"));
    let output = run(&mut study(&whole));
    assert!(output.status.success(), "{}", told(&output));
    let expected = std::fs::read(whole.join(table)).unwrap();

    let mut child = study(&cut)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut told_so_far = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    loop {
        line.clear();
        assert_ne!(
            told_so_far.read_line(&mut line).unwrap(),
            0,
            "ended by itself"
        );
        // "pieces, by effort: 40/120 about 3 s left"
        let counts = line
            .split_whitespace()
            .find_map(|word| word.split_once('/'));
        let Some((done, all)) = counts else { continue };
        let (done, all): (f64, f64) = (done.parse().unwrap(), all.parse().unwrap());
        if done >= all / 3.0 {
            break;
        }
    }
    child.kill().unwrap();
    let status = child.wait().unwrap();
    assert!(!status.success(), "it ended before it was killed");
    // Nobody writes any more.
    told_so_far.read_to_string(&mut line).unwrap();
    let (left, all) = (lines(&cut.join(table)), lines(&whole.join(table)));
    assert!(left > 1, "nothing was written before the end");
    assert!(left < all, "everything was written already");

    let output = run(&mut study(&cut));
    assert!(output.status.success(), "{}", told(&output));
    assert_eq!(std::fs::read(cut.join(table)).unwrap(), expected);
    let study = table.trim_end_matches(".csv");
    for file in ["json", "svg", "png", "settings.json"] {
        let path = cut.join(format!("{study}.{file}"));
        assert!(path.is_file(), "{}", path.display());
    }
    let results = std::fs::read_to_string(cut.join("RESULTS.md")).unwrap();
    assert!(
        results.contains(&format!("mirror:{study} begin")),
        "{results}"
    );
    cut
}

/// The same in gridworld driving, where another self-model is another study.
fn killed_and_continued_in_a_gridworld(words: &[&str], table: &str) {
    let folder = Folder::new();
    let cut = killed_and_continued(&folder, &|out| folder.study(words, out), table);
    let results = std::fs::read_to_string(cut.join("RESULTS.md")).unwrap();
    assert!(results.contains("## The paper's claims"), "{results}");
    folder.learn_nothing_again(2);
    let output = run(&mut folder.study(words, &cut));
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    let settings = table.replace(".csv", ".settings.json");
    assert!(error.contains(&settings), "{error}");
}

/// A study of the highway, with the self-model that ships.
fn highway_study(words: &[&str], out: &Path) -> Command {
    let mut command = mirror();
    command.arg("evaluate").args(words).arg("--quick");
    command.arg("--out").arg(out);
    command
}

#[test]
fn drive_goes_on_where_it_was_killed() {
    let words = [
        "drive",
        "--people",
        "1",
        "--conditions",
        "clear,silent,mirror-kl",
    ];
    let study = |out: &Path| highway_study(&words, out);
    killed_and_continued(&Folder::new(), &study, "drive.csv");
}

#[test]
fn real_goes_on_where_it_was_killed() {
    // Six of its ten cars: the fewest that can be studied.
    let folder = Folder::new();
    let cars: Vec<usize> = RECORDED
        .match_indices("<dynamicObstacle")
        .map(|(at, _)| at)
        .collect();
    let rest = RECORDED.find("<planningProblem").unwrap();
    let six = [&RECORDED[..cars[6]], &RECORDED[rest..]].concat();
    let data = folder.path("six.xml");
    std::fs::write(&data, six).unwrap();
    let study = |out: &Path| highway_study(&["real", "--data", data.to_str().unwrap()], out);
    killed_and_continued(&folder, &study, "real.csv");
}

#[test]
fn fit_goes_on_where_it_was_killed() {
    killed_and_continued_in_a_gridworld(&["fit", "--fractions", "20"], "fit-driving.csv");
}

#[test]
fn communicate_goes_on_where_it_was_killed() {
    let words = [
        "communicate",
        "--fractions",
        "20",
        "--conditions",
        "nc,ideal,mirror,bc",
    ];
    killed_and_continued_in_a_gridworld(&words, "communicate-driving.csv");
}

#[test]
fn implants_go_on_where_they_were_killed() {
    killed_and_continued_in_a_gridworld(&["implants"], "implants-driving.csv");
}

fn refused(command: &mut Command, words: &[&str]) {
    let output = run(command);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    for word in words {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
    assert!(!error.contains("panicked"), "{error}");
}

#[test]
fn what_cannot_be_used_is_refused() {
    let folder = Folder::new();
    let out = folder.path("out");
    let study = |words: &[&str]| {
        let mut command = mirror();
        command.arg("evaluate").args(words).arg("--out").arg(&out);
        command
    };
    refused(
        &mut study(&["fit", "--domain", "highway"]),
        &["highway", "drive"],
    );
    refused(
        &mut study(&["drive", "--domain", "driving"]),
        &["communicate"],
    );
    refused(
        &mut study(&[
            "fit",
            "--domain",
            "driving",
            "--self-model",
            "/nowhere/s.safetensors",
        ]),
        &["/nowhere/s.safetensors"],
    );
    let own = folder.path("self.safetensors");
    let own = own.to_str().unwrap();
    refused(
        &mut study(&["fit", "--domain", "search_rescue", "--self-model", own]),
        &["self.safetensors", "driving", "search_rescue"],
    );
    let nobody = ["--domain", "driving", "--self-model", own];
    refused(
        study(&["communicate", "--conditions", "nobody"]).args(nobody),
        &["nobody", "mirror-p"],
    );
    refused(study(&["implants", "--people", "11"]).args(nobody), &["11"]);
    refused(
        study(&["implants", "--rounds", "21"]).args(nobody),
        &["21", "20"],
    );
    assert!(!out.exists(), "something was begun");
}

/// Rounds, and what was learned from them, are of one domain.
#[test]
fn files_of_another_domain_are_refused() {
    let folder = Folder::new();
    let path = |name: &str| folder.path(name).display().to_string();
    let (own, demos) = (path("self.safetensors"), path("demos.safetensors"));
    let record = |words: &[&str]| {
        let mut command = mirror();
        command.arg("demos").args(words);
        command
    };
    let driving = ["--domain", "driving", "--person", "2", "--out", &demos];
    let output = run(record(&driving).args(["--rounds", "5"]));
    assert!(output.status.success(), "{}", told(&output));
    refused(
        &mut record(&["--domain", "driving", "--person", "11", "--out", &demos]),
        &["--person 11"],
    );
    let train = |words: &[&str]| {
        let mut command = mirror();
        let out = path("out.safetensors");
        command.args(["train", "human", "--demos", &demos, "--out", &out]);
        command.args(words);
        command
    };
    refused(
        &mut train(&["--domain", "highway"]),
        &["demos.safetensors", "driving", "highway"],
    );
    refused(
        &mut train(&[
            "--domain",
            "driving",
            "--kind",
            "self",
            "--self-model",
            &own,
        ]),
        &["--kind self"],
    );
    let original = [
        "--domain",
        "driving",
        "--kind",
        "bc",
        "--self-model",
        &own,
        "--original",
        &demos,
    ];
    refused(&mut train(&original), &["--original", "transfer"]);
    for kind in ["mirror", "mirror-p", "bc", "sqil"] {
        let words = ["--domain", "driving", "--kind", kind, "--self-model", &own];
        let output = run(&mut train(&words));
        assert!(output.status.success(), "{}", told(&output));
    }
    // Rounds of another domain than the one asked for.
    let search = [
        "--domain",
        "search_rescue",
        "--person",
        "1",
        "--out",
        &demos,
    ];
    assert!(
        run(record(&search).args(["--rounds", "1"]))
            .status
            .success()
    );
    refused(
        &mut train(&["--domain", "driving", "--self-model", &own]),
        &["demos.safetensors", "search_rescue", "driving"],
    );
}
