//! Documents do not rot: every command in a fenced block of a page is run, page by page and in order, links lead somewhere,
//! and paths and functions that are named are there.
//!
//! A page's commands run in a directory of their own, so that files made by an earlier command are there for later ones.
//! What would take minutes is run in a short form ([`SHORTER`]); of what cannot be run at all the command line is parsed
//! ([`PARSED`]), or it is none of ours ([`OTHERS`]). Every command that is not run is printed with its reason.

mod common;

use common::{status_in, told};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// A page that is not in this list fails `every_page_is_tested`.
macro_rules! pages {
    ($($test:ident: $page:literal,)*) => {
        const PAGES: &[&str] = &[$($page),*];
        mod commands_of {
            $(#[test]
            fn $test() {
                super::run_page($page);
            })*
        }
    };
}

pages! {
    readme: "README.md",
    architecture: "ARCHITECTURE.md",
    contributing: "CONTRIBUTING.md",
    changelog: "CHANGELOG.md",
    adding_a_domain: "docs/adding-a-domain.md",
    adding_a_human_model: "docs/adding-a-human-model.md",
    benchmarks: "docs/benchmarks.md",
    drive_yourself: "docs/drive-yourself.md",
    failures: "docs/failures.md",
    known_issues: "docs/known-issues.md",
    learn: "docs/learn.md",
    messages: "docs/messages.md",
    profile: "docs/profile.md",
    replay: "docs/replay.md",
    reproduce: "docs/reproduce.md",
    run: "docs/run.md",
    same_bytes: "docs/same-bytes.md",
    view: "docs/view.md",
}

/// A command as it is documented, and what is run here in its place: fewer episodes, no planning, fewer people.
/// `fast.toml` is the highway at a hundred times its pace. A set in the background drives until the page ends.
const SHORTER: &[(&str, &str)] = &[
    (
        "mirror up",
        "mirror up --episodes 1 --planner none --human self",
    ),
    (
        "mirror up --driver sim:7 --episodes 6 --record drive.mcap --summary drive.json",
        "mirror up --driver sim:7 --episodes 6 --planner none --human self --record drive.mcap --summary drive.json",
    ),
    (
        "mirror up --planner none",
        "mirror up --planner none --human self",
    ),
    (
        "mirror up --view",
        "mirror up --view --episodes 1 --planner none --human self",
    ),
    (
        "mirror --vectors 8 up --episodes 1 --summary run.json",
        "mirror --vectors 8 up --episodes 1 --planner none --human self --summary run.json",
    ),
    (
        "mirror up --clock realtime",
        "mirror up --clock realtime --scene fast.toml --episodes 1 --planner none --human self",
    ),
    (
        "mirror up --scene highway-recorded --driver sim:1 --fog 15",
        "mirror up --scene highway-recorded --driver sim:1 --fog 15 --planner none --human self",
    ),
    (
        "mirror up --scene highway-recorded --driver recorded:11",
        "mirror up --scene highway-recorded --driver recorded:11 --planner none --human self",
    ),
    (
        "mirror up --human bc",
        "mirror up --human bc --scene driving-fog",
    ),
    (
        "mirror up --planner ce",
        "mirror up --planner ce --scene driving-fog",
    ),
    (
        "mirror up --planner kl",
        "mirror up --planner kl --scene driving-fog",
    ),
    (
        "mirror up --episodes 100 --instance lab &",
        "mirror up --episodes 1000000 --planner none --human self --quiet --instance lab &",
    ),
    (
        "mirror swap human bc --instance lab",
        "mirror swap human self --instance lab",
    ),
    (
        "mirror swap planner none",
        "mirror swap planner none --instance lab",
    ),
    (
        "mirror swap driver sim:3",
        "mirror swap driver sim:3 --instance lab",
    ),
    (
        "mirror swap belief same",
        "mirror swap belief same --instance lab",
    ),
    (
        "mirror swap human --exec \"my_human_model --verbose\"",
        "mirror swap human --exec \"my_human_model --verbose\" --instance lab",
    ),
    (
        "mirror up --planner none --human self --episodes 1000 --instance lab &",
        "mirror up --planner none --human self --episodes 1000000 --quiet --instance lab &",
    ),
    (
        "mirror up --planner none --episodes 500 --instance lab --summary deaths.json &",
        "mirror up --planner none --human self --episodes 1000000 --quiet --instance lab --summary deaths.json &",
    ),
    (
        "mirror train self --domain highway --out self.safetensors",
        "mirror train self --domain highway --episodes 1 --out self.safetensors",
    ),
    (
        "mirror up --driver sim:3 --implants implants.safetensors",
        "mirror up --driver sim:3 --implants implants.safetensors --episodes 1 --planner none",
    ),
    (
        "mirror train self --domain driving --phases 4 --out driving-self.safetensors",
        "mirror train self --domain driving --phases 1 --out driving-self.safetensors",
    ),
    (
        "mirror train self --domain driving --phases 8 --resume --out driving-self.safetensors",
        "mirror train self --domain driving --phases 2 --resume --out driving-self.safetensors",
    ),
    (
        "mirror train self --domain bomb_defusal --out bomb-self.safetensors",
        "mirror train self --domain bomb_defusal --phases 1 --out bomb-self.safetensors",
    ),
    (
        "mirror up --scene driving-fog --human self --episodes 500 --instance own &",
        "mirror up --scene driving-fog --human self --planner none --episodes 1000000 --quiet --instance own &",
    ),
    (
        "mirror profile --planner none --human self --out out/profile",
        "mirror profile --planner none --human self --own-cost 0 --out out/profile",
    ),
    (
        "mirror profile --attach lab --seconds 10 --against out/profile/profile.json",
        "mirror profile --attach lab --seconds 1 --own-cost 0 --against out/profile/profile.json",
    ),
    (
        "mirror profile --episodes 1 --own-cost 0 --picture step.svg",
        "mirror profile --episodes 1 --planner none --human self --own-cost 0 --picture step.svg",
    ),
    (
        "mirror up --record drive.mcap",
        "mirror up --record drive.mcap --episodes 1 --planner none --human self",
    ),
    (
        "mirror replay drive.mcap --human bc --summary bc.json",
        "mirror replay drive.mcap --human self --summary bc.json",
    ),
    (
        "mirror evaluate fit --domain driving --out docs/gridworlds --results RESULTS.md",
        "mirror evaluate fit --quick --people 1 --fractions 20 --domain driving --out docs/gridworlds --results RESULTS.md",
    ),
    (
        "mirror evaluate communicate --domain driving --out docs/gridworlds --results RESULTS.md",
        "mirror evaluate communicate --quick --people 1 --conditions nc,mirror --fractions 20 --domain driving --out docs/gridworlds --results RESULTS.md",
    ),
    (
        "mirror evaluate implants --domain driving --out docs/gridworlds --results RESULTS.md",
        "mirror evaluate implants --quick --people 1 --domain driving --out docs/gridworlds --results RESULTS.md",
    ),
    (
        "mirror evaluate implants --out out/implants",
        "mirror evaluate implants --quick --people 1 --out out/implants",
    ),
    (
        "mirror evaluate foresight --out out/foresight",
        "mirror evaluate foresight --quick --people 1 --out out/foresight",
    ),
    (
        "mirror evaluate unaided --out out/unaided",
        "mirror evaluate unaided --quick --people 1 --out out/unaided",
    ),
    (
        "mirror evaluate drive --out docs/drive --results RESULTS.md",
        "mirror evaluate drive --quick --people 1 --conditions clear,silent --out docs/drive --results RESULTS.md",
    ),
];

/// Commands whose command line is parsed alone, and why.
const PARSED: &[(&str, &str)] = &[
    (
        "mirror replay drive.mcap --human bc --view",
        "serves a page until it is ended; tests/pages.rs looks at it",
    ),
    (
        "mirror up --driver browser",
        "waits for a person at a page; tests/pages.rs drives there",
    ),
    (
        "mirror up --driver browser --view",
        "waits for a person at a page; tests/pages.rs drives there",
    ),
    (
        "mirror up --driver browser --scene search-smoke",
        "waits for a person at a page; tests/pages.rs acts there",
    ),
    (
        "mirror doctor --clean",
        "it would remove what others' dead runs left on this machine; tests/places.rs runs it",
    ),
    (
        "mirror evaluate real --data commonroad --out docs/real --results RESULTS.md",
        "external data: a folder of CommonRoad scenarios with recorded drivers",
    ),
    (
        "mirror up --scene USA_US101-4_1_T-1.xml --driver sim:1 --fog 15",
        "external data: a CommonRoad scenario",
    ),
    (
        "mirror evaluate real --quick --out out/real",
        "a minute; tests/evaluate.rs runs the study",
    ),
    (
        "mirror evaluate all --out out/all",
        "two hours; its studies stand above it on the page",
    ),
    (
        "mirror evaluate all --quick --out out/quick",
        "five minutes; its studies stand above it on the page",
    ),
    (
        "mirror up --exec human=\"python3 examples/python/human_model.py\"",
        "needs iceoryx2's Python package; tests/foreign.rs installs it and runs this",
    ),
    (
        "mirror swap human --exec \"python3 examples/python/human_model.py\" --instance lab",
        "needs iceoryx2's Python package; tests/foreign.rs installs it and runs this",
    ),
];

/// Commands that are not ours, and why they are not run.
const OTHERS: &[(&str, &str)] = &[
    ("cargo test --release --workspace", "runs this test"),
    (".ci/run", "runs this test"),
    (
        "cargo run --release -p training --example gridworld -- bomb_defusal shared/pretrained/bomb-defusal-self.safetensors measure",
        "builds an example, and plays hundreds of rounds",
    ),
    (
        "cargo run -p messages --example python_layouts > examples/python/mirror_messages.py",
        "writes into the repository; shared/messages/tests/definitions.rs compares that file",
    ),
];

/// Commands that have to be refused here, and a part of what they say.
const REFUSED: &[(&str, &str)] = &[(
    "mirror swap human --exec \"my_human_model --verbose\"",
    "human stays as it is",
)];

/// No command may take longer.
const LIMIT: Duration = Duration::from_secs(120);

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

fn text_of(page: &str) -> String {
    fs::read_to_string(root().join(page)).unwrap_or_else(|error| panic!("{page}: {error}"))
}

/// A page's lines with their numbers, from 1, and whether they stand in a fenced block; the fences themselves are left out.
fn lines(text: &str) -> Vec<(usize, Option<&str>, &str)> {
    let mut language = None;
    let mut found = Vec::new();
    for (i, line) in text.lines().enumerate() {
        if let Some(fence) = line.trim_start().strip_prefix("```") {
            language = match language {
                None => Some(fence.trim()),
                Some(_) => None,
            };
        } else {
            found.push((i + 1, language, line));
        }
    }
    assert!(language.is_none(), "a fence is not closed");
    found
}

/// The commands of a page's shell blocks, with their line; comments are left out, here-documents belong to their command,
/// and `cargo run --release --` stands for `mirror`.
fn commands(page: &str) -> Vec<(usize, String)> {
    let text = text_of(page);
    let mut found: Vec<(usize, String)> = Vec::new();
    // The word that ends a here-document.
    let mut until: Option<String> = None;
    for (number, language, line) in lines(&text) {
        if let Some(end) = &until {
            let command = &mut found.last_mut().unwrap().1;
            command.push('\n');
            command.push_str(line);
            if line == end {
                until = None;
            }
            continue;
        }
        let command = line.split(" #").next().unwrap_or_default().trim();
        match language {
            Some("sh") if !command.is_empty() && !command.starts_with('#') => {
                let here = command.split("<<").nth(1);
                until = here.map(|word| word.trim_matches('\'').to_owned());
                let command = command.replace("cargo run --release --", "mirror");
                found.push((number, command));
            }
            Some("sh" | "") | None => {
                let ours = command.starts_with("mirror ") || command.starts_with("cargo ");
                assert!(
                    language.is_none() || !ours,
                    "{page}:{number}: a command outside a block marked `sh`"
                );
            }
            Some(other) => panic!("{page}:{number}: a block in `{other}`, which nobody checks"),
        }
    }
    found
}

/// Code between backticks, in prose and tables: line and text.
fn code_spans(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, language, line) in lines(text) {
        if language.is_none() {
            let ticks = line.matches('`').count();
            assert!(
                ticks % 2 == 0,
                "line {number}: code goes on in the next line"
            );
            let spans = line.split('`').skip(1).step_by(2);
            found.extend(spans.map(|span| (number, span.to_owned())));
        }
    }
    found
}

fn listed<'a>(table: &[(&'a str, &'a str)], command: &str) -> Option<&'a str> {
    let entry = table.iter().find(|(documented, _)| *documented == command);
    entry.map(|(_, other)| *other)
}

/// Says something although the test passes: see `testing::skipped`.
fn say(line: &str) {
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// Where a page's commands run.
struct Bench {
    page: &'static str,
    directory: tempfile::TempDir,
    /// Sets that drive in the background, by instance.
    background: Vec<(String, Started)>,
    /// Commands so far: each has files of its own for what it prints.
    count: usize,
}

/// A command that was started.
struct Started {
    child: Child,
    number: usize,
}

impl Bench {
    fn new(page: &'static str) -> Self {
        let directory = tempfile::Builder::new()
            .prefix("docs")
            .tempdir_in("/tmp")
            .unwrap();
        for name in ["here", "run"] {
            let made = directory.path().join(name);
            fs::create_dir(&made).unwrap();
            fs::set_permissions(&made, PermissionsExt::from_mode(0o700)).unwrap();
        }
        let bench = Self {
            page,
            directory,
            background: Vec::new(),
            count: 0,
        };
        for name in ["examples", "shared", "tools"] {
            symlink(root().join(name), bench.here().join(name)).unwrap();
        }
        fs::write(bench.here().join("fast.toml"), "[clock]\nrate = 100.0\n").unwrap();
        bench
    }

    fn here(&self) -> PathBuf {
        self.directory.path().join("here")
    }

    /// Where the instances of this page's commands are.
    fn instances(&self) -> PathBuf {
        self.directory.path().join("run/mirror")
    }

    /// Starts a command in a shell, in a process group of its own; its output goes to files.
    fn start(&mut self, command: &str) -> Started {
        let program = Path::new(env!("CARGO_BIN_EXE_mirror")).parent().unwrap();
        let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
        self.count += 1;
        let number = self.count;
        let output = |name: &str| File::create(self.printed(number, name)).unwrap();
        let child = Command::new("sh")
            .args(["-c", &format!("exec {command}")])
            .current_dir(self.here())
            .env("PATH", path)
            .env("XDG_RUNTIME_DIR", self.directory.path().join("run"))
            .stdin(Stdio::null())
            .stdout(output("stdout"))
            .stderr(output("stderr"))
            .process_group(0)
            .spawn()
            .unwrap();
        Started { child, number }
    }

    /// Where a command's output is.
    fn printed(&self, number: usize, name: &str) -> PathBuf {
        self.directory.path().join(format!("{number}.{name}"))
    }

    /// Waits for a command's end.
    fn wait(&self, mut started: Started, command: &str) -> Output {
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = started.child.try_wait().unwrap() {
                break status;
            }
            if begun.elapsed() > LIMIT {
                let told = self.stop(&mut started);
                panic!(
                    "{}: `{command}` takes longer than {LIMIT:?}: {told}",
                    self.page
                );
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        self.output(started.number, status)
    }

    /// Kills a command, if it still runs; what it printed.
    fn stop(&self, started: &mut Started) -> String {
        if started.child.try_wait().unwrap().is_none() {
            signal(&started.child, libc::SIGKILL);
        }
        let status = started.child.wait().unwrap();
        told(&self.output(started.number, status))
    }

    fn output(&self, number: usize, status: ExitStatus) -> Output {
        let read = |name: &str| fs::read(self.printed(number, name)).unwrap();
        Output {
            status,
            stdout: read("stdout"),
            stderr: read("stderr"),
        }
    }

    /// Starts a set in the background, and waits until it drives.
    fn start_in_background(&mut self, command: &str) {
        let mut words = command.split(' ').skip_while(|word| *word != "--instance");
        let instance = words.nth(1).unwrap_or_else(|| {
            panic!(
                "{}: `{command} &` has no --instance to be followed by",
                self.page
            )
        });
        self.end(instance);
        let mut started = self.start(command);
        let drives = |status: serde_json::Value| status["steps"].as_u64() > Some(0);
        let begun = Instant::now();
        while !status_in(&self.instances(), instance).is_some_and(drives) {
            let ended = started.child.try_wait().unwrap();
            if ended.is_some() || begun.elapsed() > LIMIT {
                let told = self.stop(&mut started);
                panic!("{}: `{command} &` does not drive: {told}", self.page);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.background.push((instance.to_owned(), started));
    }

    /// Ends a set in the background as Ctrl-C does, if there is one of this name.
    fn end(&mut self, instance: &str) {
        let at = self
            .background
            .iter()
            .position(|(name, _)| name == instance);
        if let Some((_, mut started)) = at.map(|at| self.background.remove(at)) {
            if started.child.try_wait().unwrap().is_some() {
                let told = self.stop(&mut started);
                panic!(
                    "{}: the set `{instance}` ended while the page went on: {told}",
                    self.page
                );
            }
            signal(&started.child, libc::SIGINT);
            self.wait(started, &format!("the set {instance}"));
        }
    }
}

/// A test that fails must not leave a set behind.
impl Drop for Bench {
    fn drop(&mut self) {
        for (_, started) in &mut self.background {
            signal(&started.child, libc::SIGKILL);
            let _ = started.child.wait();
        }
    }
}

/// Sends a signal to a command and what it started.
fn signal(child: &Child, signal: libc::c_int) {
    // SAFETY: signals the process group of our own child, which was not waited for.
    unsafe { libc::kill(-(child.id() as libc::pid_t), signal) };
}

/// Runs a page's commands one after the other.
fn run_page(page: &'static str) {
    let mut bench = Bench::new(page);
    for (number, command) in commands(page) {
        let place = format!("{page}:{number}");
        if let Some(why) = listed(OTHERS, &command) {
            say(&format!("not run: {place}: {command}: {why}"));
            continue;
        }
        if let Some(why) = listed(PARSED, &command) {
            say(&format!("not run, only parsed: {place}: {command}: {why}"));
            parse(&place, &command);
            continue;
        }
        if command.starts_with("python3 ") && !has_python() {
            testing::skipped(
                page,
                &format!("there is no python3 for line {number}, on which later lines depend"),
            );
            return;
        }
        let ours = ["mirror ", "python3 ", "cat "];
        assert!(
            ours.iter().any(|program| command.starts_with(program)),
            "{place}: `{command}` is in none of the tables of tests/documents.rs"
        );
        let run = listed(SHORTER, &command).unwrap_or(&command);
        match run.strip_suffix(" &") {
            Some(set) => bench.start_in_background(set),
            None => {
                let begun = Instant::now();
                let started = bench.start(run);
                let output = bench.wait(started, run);
                let seconds = begun.elapsed().as_secs_f64();
                println!("{seconds:6.1} s {place}: {run}");
                let refused = listed(REFUSED, &command);
                // The doctor's status is about the machine, and what others left on it.
                let is_report = command == "mirror doctor" && output.status.code() == Some(1);
                assert_eq!(
                    output.status.success() || is_report,
                    refused.is_none(),
                    "{place}: {run}: {}",
                    told(&output)
                );
                if let Some(words) = refused {
                    assert!(told(&output).contains(words), "{place}: {}", told(&output));
                }
            }
        }
    }
    let sets: Vec<String> = bench
        .background
        .iter()
        .map(|(name, _)| name.clone())
        .collect();
    for instance in sets {
        bench.end(&instance);
    }
}

fn has_python() -> bool {
    Command::new("python3")
        .args(["-c", ""])
        .status()
        .is_ok_and(|status| status.success())
}

/// Asserts that a command line of ours parses; names of files in it need not be there.
fn parse(place: &str, command: &str) {
    let arguments = command
        .strip_prefix("mirror ")
        .unwrap_or_else(|| panic!("{place}: only `mirror` can be parsed: {command}"));
    let output = Command::new("sh")
        .args(["-c", &format!("exec \"$0\" {arguments} --help")])
        .arg(env!("CARGO_BIN_EXE_mirror"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{place}: {command}: {}",
        told(&output)
    );
}

#[test]
fn every_page_is_tested() {
    let mut found: BTreeSet<String> = BTreeSet::new();
    for (folder, before) in [(root(), ""), (root().join("docs"), "docs/")] {
        for entry in fs::read_dir(folder).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            if name.ends_with(".md") && name != "RESULTS.md" {
                found.insert(format!("{before}{name}"));
            }
        }
    }
    let tested: BTreeSet<String> = PAGES.iter().map(|page| (*page).to_owned()).collect();
    assert_eq!(found, tested);
}

#[test]
fn every_entry_of_the_tables_is_documented() {
    let documented: BTreeSet<String> = PAGES
        .iter()
        .flat_map(|page| commands(page))
        .map(|(_, command)| command)
        .collect();
    for table in [SHORTER, PARSED, OTHERS, REFUSED] {
        for (command, _) in table {
            assert!(
                documented.contains(*command),
                "no page has `{command}` any more: take it out of tests/documents.rs"
            );
        }
    }
    for (documented, run) in SHORTER {
        assert_eq!(
            documented.ends_with(" &"),
            run.ends_with(" &"),
            "`{documented}` and its short form do not both run in the background"
        );
    }
}

/// `mirror …` in prose and tables.
#[test]
fn commands_in_prose_parse() {
    for page in PAGES {
        for (number, span) in code_spans(&text_of(page)) {
            if span.starts_with("mirror ") && !span.contains('…') {
                parse(&format!("{page}:{number}"), &span);
            }
        }
    }
}

/// `cargo … -p CRATE --test|--bench|--example NAME`, in blocks, prose and tables.
#[test]
fn cargo_commands_name_what_is_there() {
    let packages = packages();
    let mut seen = 0;
    for page in PAGES {
        let in_blocks = commands(page).into_iter();
        let mut all: Vec<(usize, String)> = in_blocks.chain(code_spans(&text_of(page))).collect();
        all.retain(|(_, command)| command.contains("cargo "));
        for (number, command) in all {
            let after = |option: &str| {
                let mut words = command.split(' ').skip_while(|word| *word != option);
                words.nth(1)
            };
            let folder = match after("-p") {
                None => root().join("launch"),
                Some(name) => packages
                    .iter()
                    .find(|(package, _)| package == name)
                    .unwrap_or_else(|| panic!("{page}:{number}: no package `{name}`: {command}"))
                    .1
                    .clone(),
            };
            let kinds = [
                ("--test", "tests"),
                ("--bench", "benches"),
                ("--example", "examples"),
            ];
            for (option, of) in kinds {
                // NAME in capitals stands for any.
                let name = after(option).filter(|name| *name != "NAME");
                let Some(name) = name else { continue };
                let file = format!("{name}.rs");
                let is_there = folder.join(of).join(&file).exists()
                    || (option == "--test" && root().join("tests").join(&file).exists());
                assert!(is_there, "{page}:{number}: no {of}/{file}: {command}");
                seen += 1;
            }
        }
    }
    assert!(seen > 5, "too few commands were found: {seen}");
}

/// Name and folder of every package of the workspace.
fn packages() -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    let mut folders = vec![root().join("launch")];
    for parent in ["shared", "processes"] {
        let entries = fs::read_dir(root().join(parent)).unwrap();
        folders.extend(entries.map(|entry| entry.unwrap().path()));
    }
    for folder in folders {
        let Ok(text) = fs::read_to_string(folder.join("Cargo.toml")) else {
            continue; // what ships is no package
        };
        let name = text.lines().find_map(|line| line.strip_prefix("name = "));
        found.push((name.unwrap().trim_matches('"').to_owned(), folder));
    }
    found
}

/// What a heading is called in a link: as GitHub makes it.
fn anchors(text: &str) -> Vec<String> {
    let headings = lines(text)
        .into_iter()
        .filter(|(_, language, line)| language.is_none() && line.starts_with('#'));
    headings
        .map(|(_, _, line)| {
            let title = line.trim_start_matches('#').trim().to_lowercase();
            let kept = title
                .chars()
                .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
            kept.map(|c| if c == ' ' { '-' } else { c }).collect()
        })
        .collect()
}

/// The targets of links and pictures: line and target.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, language, line) in lines(text) {
        if language.is_none() {
            let targets = line.split("](").skip(1);
            let targets = targets.filter_map(|rest| rest.split(')').next());
            found.extend(targets.map(|target| (number, target.to_owned())));
        }
    }
    found
}

#[test]
fn links_lead_somewhere() {
    let mut seen = 0;
    for page in PAGES.iter().chain(&["RESULTS.md", "tools/README.md"]) {
        let text = text_of(page);
        for (number, target) in links(&text) {
            if target.contains("://") {
                continue;
            }
            seen += 1;
            let (file, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let path = match file {
                "" => root().join(page),
                _ => root().join(page).parent().unwrap().join(file),
            };
            assert!(path.exists(), "{page}:{number}: no {target}");
            if !anchor.is_empty() {
                let there = anchors(&fs::read_to_string(&path).unwrap());
                assert!(
                    there.iter().any(|known| known == anchor),
                    "{page}:{number}: no {target} among {there:?}"
                );
            }
        }
    }
    assert!(seen > 50, "too few links were found: {seen}");
}

/// Whether a word between backticks means a file or folder of the repository.
fn is_path(word: &str) -> bool {
    const FOLDERS: [&str; 8] = [
        ".ci",
        "docs",
        "examples",
        "launch",
        "processes",
        "shared",
        "tests",
        "tools",
    ];
    let first = word.split_once('/').map(|(first, _)| first);
    let in_root = !word.contains('/') && word.ends_with(".md");
    in_root || first.is_some_and(|first| FOLDERS.contains(&first))
}

#[test]
fn paths_and_functions_are_there() {
    let (mut paths, mut functions) = (0, 0);
    for page in PAGES.iter().chain(&["tools/README.md"]) {
        let text = text_of(page);
        for (number, span) in code_spans(&text) {
            for word in span.split_whitespace().filter(|word| is_path(word)) {
                let path = root().join(word);
                assert!(path.exists(), "{page}:{number}: no {word}");
                paths += 1;
            }
        }
        // `path` (`function`, `type`)
        for (number, language, line) in lines(&text) {
            if language.is_some() {
                continue;
            }
            let pieces: Vec<&str> = line.split('`').collect();
            for (at, path) in pieces.iter().enumerate().skip(1).step_by(2) {
                let opens = pieces.get(at + 1).is_some_and(|between| *between == " (");
                if !(opens && path.ends_with(".rs") && is_path(path)) {
                    continue;
                }
                let source = fs::read_to_string(root().join(path)).unwrap();
                let words: BTreeSet<&str> = source
                    .split(|c: char| !(c.is_alphanumeric() || c == '_'))
                    .collect();
                let mut next = at + 2;
                while let Some(name) = pieces.get(next) {
                    let last = name.rsplit("::").next().unwrap();
                    assert!(words.contains(last), "{page}:{number}: no {name} in {path}");
                    functions += 1;
                    if pieces.get(next + 1) != Some(&", ") {
                        break;
                    }
                    next += 2;
                }
            }
        }
    }
    assert!(paths > 80, "too few paths were found: {paths}");
    assert!(functions > 20, "too few functions were found: {functions}");
}

#[test]
fn the_readme_is_short() {
    let lines = text_of("README.md").lines().count();
    assert!(lines <= 150, "README.md has {lines} lines");
}

/// Tables, blocks, and where links lead to do not count.
#[test]
fn prose_wraps_at_120_columns() {
    for page in PAGES.iter().chain(&["tools/README.md"]) {
        for (number, language, line) in lines(&text_of(page)) {
            if language.is_some() || line.starts_with('|') {
                continue;
            }
            let mut columns = 0;
            for (i, piece) in line.split("](").enumerate() {
                let seen = match i {
                    0 => piece,
                    _ => piece.split_once(')').map_or(piece, |(_, rest)| rest),
                };
                columns += seen.chars().count() + usize::from(i > 0);
            }
            assert!(columns <= 120, "{page}:{number}: {columns} columns: {line}");
        }
    }
}

/// A clone has to be all that its reader needs.
#[test]
fn nothing_outside_the_repository_is_cited() {
    let mut folders = vec![root()];
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !["target", "out", ".git", "__pycache__"].contains(&name.as_str()) {
                    folders.push(path);
                }
                continue;
            }
            let endings = [".rs", ".md", ".toml", ".py", ".sh", ".cff", ".txt"];
            if name == "documents.rs"
                || name != "run" && !endings.iter().any(|ending| name.ends_with(ending))
            {
                continue;
            }
            let text = String::from_utf8_lossy(&fs::read(&path).unwrap()).into_owned();
            seen += 1;
            // Programs know where data of others may lie; what they say of it must not need it.
            let outside = match name.ends_with(".rs") {
                true => &["DESIGN"][..],
                false => &["DESIGN", "../shared/data", "../../shared"][..],
            };
            for outside in outside {
                assert!(
                    !text.contains(outside),
                    "{} cites {outside}",
                    path.display()
                );
            }
        }
    }
    assert!(seen > 50, "too few files were found: {seen}");
}
