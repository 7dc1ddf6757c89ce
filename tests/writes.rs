//! Where results go: whatever a path names that the user gave, a link stays a link, a mode stays a mode, and a device
//! or a pipe is never replaced by a file.

mod common;

use common::{Bench, Live, instance, mirror, run, told};
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A command that writes one file.
struct Writer {
    what: &'static str,
    /// Its words; `FILE` stands for the file.
    words: Vec<String>,
    /// Whether what it writes can run through a pipe: not if it is read again, or continued.
    is_stream: bool,
}

impl Writer {
    fn run(&self, file: &Path) -> Output {
        let file = file.to_str().unwrap();
        let words = self.words.iter().map(|word| match word.as_str() {
            "FILE" => file,
            word => word,
        });
        run(mirror().args(words))
    }
}

/// Every command that writes a file of the user's choice, with what it needs, in a folder of its own.
fn writers(bench: &Bench) -> Vec<Writer> {
    let path = |name: &str| bench.path(name).to_str().unwrap().to_owned();
    let (model, demos, drive) = (path("self.safetensors"), path("demos"), path("drive.mcap"));
    let (folder, trained) = (path("folder"), path("trained.safetensors"));
    let writer = |what, is_stream, words: &str| {
        let words = words.split(' ').map(|word| match word {
            "MODEL" => model.clone(),
            "DEMOS" => demos.clone(),
            "DRIVE" => drive.clone(),
            "FOLDER" => folder.clone(),
            "TRAINED" => trained.clone(),
            word => word.to_owned(),
        });
        Writer {
            what,
            words: words.collect(),
            is_stream,
        }
    };
    let made = |words: &str, file: &str| {
        let output = writer("", true, words).run(&bench.path(file));
        assert!(output.status.success(), "{words}: {}", told(&output));
    };
    made(
        "demos --domain driving --person 3 --rounds 8 --out FILE",
        "demos",
    );
    let up = "up --planner none --human self --episodes 1 --quiet --self-model MODEL";
    made(&format!("{up} --record FILE"), "drive.mcap");
    vec![
        writer("rounds", true, "demos --person 3 --rounds 1 --out FILE"),
        writer(
            "a gridworld's rounds",
            true,
            "demos --domain driving --person 3 --rounds 8 --out FILE",
        ),
        writer(
            "a human model",
            true,
            "train human --domain driving --kind mirror --demos DEMOS --out FILE",
        ),
        writer(
            "a self-model",
            false,
            "train self --domain driving --phases 1 --out FILE",
        ),
        writer(
            "metrics",
            true,
            "train self --domain driving --phases 1 --out TRAINED --metrics FILE",
        ),
        writer("a summary", true, &format!("{up} --summary FILE")),
        writer("a recording", false, &format!("{up} --record FILE")),
        writer(
            "a replay's summary",
            true,
            "replay DRIVE --self-model MODEL --summary FILE",
        ),
        writer(
            "a picture",
            true,
            "profile --planner none --human self --episodes 1 --own-cost 0 --self-model MODEL --out FOLDER --picture FILE",
        ),
        writer(
            "results",
            false,
            "evaluate implants --domain driving --quick --people 1 --out FOLDER --results FILE",
        ),
    ]
}

#[test]
fn a_link_stays_a_link_and_its_target_keeps_its_mode() {
    let bench = Bench::new();
    for (index, writer) in writers(&bench).iter().enumerate() {
        let (file, link) = (
            bench.path(&format!("file{index}")),
            bench.path(&format!("link{index}")),
        );
        std::fs::write(&file, "old").unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o640)).unwrap();
        symlink(&file, &link).unwrap();
        let output = writer.run(&link);
        assert!(
            output.status.success(),
            "{}: {}",
            writer.what,
            told(&output)
        );
        assert!(
            link.symlink_metadata().unwrap().is_symlink(),
            "{}",
            writer.what
        );
        let now = file.symlink_metadata().unwrap();
        assert!(now.is_file() && now.len() > 3, "{}", writer.what);
        assert_eq!(now.mode() & 0o7777, 0o640, "{}", writer.what);
        let kept = bench.path(&format!("file{index}.before"));
        assert!(!kept.exists(), "{}", writer.what);
    }
}

#[test]
fn an_earlier_recording_survives_a_run_that_does_not_start() {
    let bench = Bench::new();
    let file = bench.path("drive.mcap");
    std::fs::write(&file, "an earlier drive").unwrap();
    let mut command = bench.up(&instance("writes-kept"));
    let output = run(command
        .args(["--episodes", "1", "--exec", "recorder=false", "--record"])
        .arg(&file));
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert_eq!(std::fs::read(&file).unwrap(), b"an earlier drive");
    assert!(!bench.path("drive.mcap.before").exists());
}

#[test]
fn a_pipe_is_written_through_or_refused() {
    let bench = Bench::new();
    for (index, writer) in writers(&bench).iter().enumerate() {
        let pipe = bench.path(&format!("pipe{index}"));
        let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        let (output, read) = std::thread::scope(|scope| {
            let reader = scope.spawn(|| {
                let mut read = Vec::new();
                std::fs::File::open(&pipe)
                    .unwrap()
                    .read_to_end(&mut read)
                    .unwrap();
                read
            });
            let output = writer.run(&pipe);
            // A reader to whom nobody came is let go.
            while !reader.is_finished() {
                let mut end = std::fs::OpenOptions::new();
                let _ = end.write(true).custom_flags(libc::O_NONBLOCK).open(&pipe);
            }
            (output, reader.join().unwrap())
        });
        assert!(
            pipe.symlink_metadata().unwrap().file_type().is_fifo(),
            "{}",
            writer.what
        );
        assert_allowed(writer, &output, &pipe);
        assert_eq!(!read.is_empty(), writer.is_stream, "{}", writer.what);
    }
}

fn assert_allowed(writer: &Writer, output: &Output, file: &Path) {
    let expected = if writer.is_stream { 0 } else { 2 };
    assert_eq!(
        output.status.code(),
        Some(expected),
        "{}: {}",
        writer.what,
        told(output)
    );
    if !writer.is_stream {
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            error.contains(file.to_str().unwrap()),
            "{}: {error}",
            writer.what
        );
    }
}

/// A device like `/dev/null`: for root one that may be lost.
fn null(bench: &Bench) -> Option<PathBuf> {
    // SAFETY: cannot fail.
    if unsafe { libc::geteuid() } != 0 {
        return Some(PathBuf::from("/dev/null"));
    }
    let device = bench.path("null");
    let made = Command::new("mknod")
        .arg(&device)
        .args(["c", "1", "3"])
        .status();
    let works = made.is_ok_and(|made| made.success()) && std::fs::write(&device, "x").is_ok();
    works.then_some(device)
}

#[test]
fn a_device_stays_a_device() {
    let bench = Bench::new();
    let Some(null) = null(&bench) else {
        testing::skipped("a_device_stays_a_device", "root cannot make a device here");
        return;
    };
    for writer in writers(&bench) {
        let output = writer.run(&null);
        let kind = null.symlink_metadata().unwrap().file_type();
        assert!(kind.is_char_device(), "{}: {}", writer.what, told(&output));
        assert_allowed(&writer, &output, &null);
    }
}

#[test]
fn a_directory_is_refused_before_anything_is_done() {
    let bench = Bench::new();
    let directory = bench.path("directory");
    std::fs::create_dir(&directory).unwrap();
    for writer in writers(&bench) {
        let output = writer.run(&directory);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{}: {}",
            writer.what,
            told(&output)
        );
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(error.contains("a directory"), "{}: {error}", writer.what);
        assert!(
            error.contains(directory.to_str().unwrap()),
            "{}: {error}",
            writer.what
        );
    }
    assert_eq!(std::fs::read_dir(&directory).unwrap().count(), 0);
}

/// Files in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().flatten();
    let mut names: Vec<_> = entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn links_in_a_folder_of_results_stay_links() {
    let bench = Bench::new();
    let model = bench.path("self.safetensors");
    let model = model.to_str().unwrap();
    let profile = "profile --planner none --human self --episodes 1 --own-cost 0 --self-model";
    let profile: Vec<&str> = profile.split(' ').chain([model]).collect();
    let evaluate = |words: &'static str| words.split(' ').collect::<Vec<&str>>();
    let commands = [
        profile,
        evaluate("evaluate implants --domain driving --quick --people 1"),
        evaluate("evaluate implants --domain highway --quick --people 1"),
        evaluate("evaluate fit --domain driving --quick --people 2 --fractions 20"),
    ];
    for (index, words) in commands.iter().enumerate() {
        let at = |name: &str| bench.path(&format!("{name}{index}"));
        let (plain, linked, far) = (at("plain"), at("linked"), at("far"));
        let to = |folder: &Path| {
            let output = run(mirror().args(words).arg("--out").arg(folder));
            assert!(output.status.success(), "{words:?}: {}", told(&output));
        };
        to(&plain);
        std::fs::create_dir(&linked).unwrap();
        std::fs::create_dir(&far).unwrap();
        let expected = names(&plain);
        assert!(expected.len() >= 3, "{expected:?}");
        for name in &expected {
            symlink(far.join(name), linked.join(name)).unwrap();
        }
        to(&linked);
        assert_eq!(names(&linked), expected);
        for name in &expected {
            assert!(
                linked.join(name).symlink_metadata().unwrap().is_symlink(),
                "{name}"
            );
            assert!(far.join(name).metadata().unwrap().len() > 0, "{name}");
        }
    }
}

#[test]
fn a_table_that_is_a_pipe_is_refused_and_not_waited_for() {
    let bench = Bench::new();
    let out = bench.path("out");
    std::fs::create_dir(&out).unwrap();
    let pipe = out.join("implants-driving.csv");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    let words = [
        "evaluate", "implants", "--domain", "driving", "--quick", "--people", "1",
    ];
    let output = run(mirror().args(words).arg("--out").arg(&out));
    assert!(!output.status.success(), "{}", told(&output));
    assert!(
        told(&output).contains("implants-driving.csv"),
        "{}",
        told(&output)
    );
    assert!(pipe.symlink_metadata().unwrap().file_type().is_fifo());
}

#[test]
fn the_report_of_a_swap_goes_through_its_link() {
    let (bench, name) = (Bench::new(), instance("report"));
    let (file, link) = (bench.path("report.json"), bench.path("link.json"));
    symlink(&file, &link).unwrap();
    let mut live = Live::start(bench.up(&name).args(["--episodes", "1000000"]), &name);
    let words = ["swap", "belief", "same", "--instance", &name, "--report"];
    let output = run(mirror().args(words).arg(&link));
    live.interrupt();
    live.wait();
    assert!(output.status.success(), "{}", told(&output));
    assert!(link.symlink_metadata().unwrap().is_symlink());
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    assert_eq!(report["process"], "belief");
}
