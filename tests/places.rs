//! Where a set lives on a machine that others use too: what another user can do to it, and what the machine lacks.

mod common;

use common::others::{NOBODY, Shared, can_be_two_users, is_root};
use common::{Bench, Live, assert_nothing_left, instance, mirror, run, told};
use runtime::instance::{lookup_roots, prefix, root_for};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Somebody's home, with something of theirs in it that has an instance's name.
fn home_of(shared: &Shared, owner: u32) -> PathBuf {
    let home = shared.path("home");
    std::fs::create_dir_all(home.join("lab")).unwrap();
    std::fs::write(home.join("lab/thesis.json"), "years").unwrap();
    for path in [home.clone(), home.join("lab"), home.join("lab/thesis.json")] {
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o700)).unwrap();
        if is_root() {
            chown(path, Some(owner), Some(owner)).unwrap();
        }
    }
    home
}

fn assert_refused(output: &Output, words: &[&str]) {
    assert_eq!(output.status.code(), Some(2), "{}", told(output));
    let error = String::from_utf8_lossy(&output.stderr);
    for word in words {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
}

fn assert_untouched(home: &Path) {
    assert_eq!(
        std::fs::read_to_string(home.join("lab/thesis.json")).unwrap(),
        "years"
    );
    assert_eq!(std::fs::read_dir(home.join("lab")).unwrap().count(), 1);
}

/// Every command that looks into the run directory.
const COMMANDS: [&[&str]; 6] = [
    &[
        "up",
        "--planner",
        "none",
        "--human",
        "self",
        "--episodes",
        "1",
        "--instance",
        "lab",
    ],
    &["swap", "planner", "none", "--instance", "lab"],
    &["profile", "--attach", "lab"],
    &["doctor"],
    &["doctor", "--clean"],
    &["ls"],
];

#[test]
fn a_link_in_the_place_of_the_run_directory_is_refused_by_every_command() {
    let shared = Shared::new();
    // SAFETY: cannot fail.
    let home = home_of(&shared, unsafe { libc::geteuid() });
    let runtime = shared.path("runtime");
    std::fs::create_dir(&runtime).unwrap();
    std::fs::set_permissions(&runtime, PermissionsExt::from_mode(0o700)).unwrap();
    symlink(&home, runtime.join("mirror")).unwrap();
    for words in COMMANDS {
        let output = run(mirror().args(words).env("XDG_RUNTIME_DIR", &runtime));
        assert_refused(&output, &["runtime/mirror", "symbolic link"]);
        assert_untouched(&home);
    }
}

/// What another user puts under our name in `/tmp`, before we are there.
#[test]
fn what_others_put_in_the_place_of_the_run_directory_is_refused() {
    if !can_be_two_users("what_others_put_in_the_place_of_the_run_directory_is_refused") {
        return;
    }
    // A user whom nobody has.
    let (user, other) = (4_000_000_000 + std::process::id() % 1_000_000, NOBODY);
    let place = PathBuf::from(format!("/tmp/mirror-{user}"));
    let shared = Shared::new();
    let home = home_of(&shared, user);
    let attempt = |reason: &str| {
        for command in COMMANDS {
            let output = run(shared.mirror_as(user).args(command));
            assert_refused(&output, &[&place.display().to_string(), reason]);
        }
    };
    symlink(&home, &place).unwrap();
    attempt("symbolic link");
    std::fs::remove_file(&place).unwrap();
    assert_untouched(&home);
    std::fs::create_dir(&place).unwrap();
    std::fs::set_permissions(&place, PermissionsExt::from_mode(0o777)).unwrap();
    chown(&place, Some(other), None).unwrap();
    symlink(home.join("lab"), place.join("lab")).unwrap();
    attempt(&format!("belongs to user {other}"));
    chown(&place, Some(user), None).unwrap();
    attempt("700");
    std::fs::set_permissions(&place, PermissionsExt::from_mode(0o700)).unwrap();
    let output = run(shared.mirror_as(user).args(COMMANDS[0]));
    std::fs::remove_dir_all(&place).unwrap();
    assert_refused(&output, &["lab", "symbolic link"]);
    assert_untouched(&home);
}

#[test]
fn another_user_can_neither_open_nor_list_anything_of_a_running_set() {
    if !can_be_two_users("another_user_can_neither_open_nor_list_anything_of_a_running_set") {
        return;
    }
    let (bench, name) = (Bench::new(), instance("closed"));
    let up = bench.up(&name);
    // With a mask that forbids others nothing.
    let mut command = Command::new("/bin/sh");
    command.args(["-c", "umask 000; exec \"$0\" \"$@\""]);
    command.arg(up.get_program()).args(up.get_args());
    command.args(["--episodes", "1000000"]);
    let mut live = Live::start(&mut command, &name);
    let root = root_for(&name);
    let ours = prefix(&root, &name);
    let files: Vec<PathBuf> = std::fs::read_dir("/dev/shm")
        .unwrap()
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&ours))
        .map(|entry| entry.path())
        .collect();
    assert!(files.len() > 50, "{files:?}");
    let script = r#"
        directory="$1"; shift
        for file in "$@"; do
            (: < "$file") 2>/dev/null && echo "can read $file"
            (: >> "$file") 2>/dev/null && echo "can write $file"
            rm -f "$file" 2>/dev/null; [ -e "$file" ] || echo "can remove $file"
        done
        ls "$directory" 2>/dev/null && echo "can list $directory"
        ls "$directory/launcher.sock" 2>/dev/null && echo "can reach the socket"
        echo done
    "#;
    let mut other = Command::new("/bin/sh");
    other
        .args(["-c", script, "sh"])
        .arg(root.join(&name))
        .args(&files);
    let output = run(other.uid(NOBODY).gid(NOBODY));
    live.interrupt();
    live.wait();
    assert_eq!(String::from_utf8_lossy(&output.stdout), "done\n");
    assert_nothing_left(&name);
}

/// Another user knows where our files will be, and is there first.
#[test]
fn what_another_user_puts_into_shared_memory_is_refused_and_stays() {
    if !can_be_two_users("what_another_user_puts_into_shared_memory_is_refused_and_stays") {
        return;
    }
    let (bench, name) = (Bench::new(), instance("first"));
    let planted = Path::new("/dev/shm").join(format!("{}x.data", prefix(&root_for(&name), &name)));
    let script = format!("umask 000; echo planted > {}", planted.display());
    let mut other = Command::new("/bin/sh");
    assert!(
        run(other.args(["-c", &script]).uid(NOBODY).gid(NOBODY))
            .status
            .success()
    );
    let output = run(bench.up(&name).args(["--episodes", "1"]));
    let cleaned = runtime::cleanup_dead(&root_for(&name), &name);
    let stays = std::fs::read_to_string(&planted);
    std::fs::remove_file(&planted).unwrap();
    assert_refused(
        &output,
        &[planted.to_str().unwrap(), "user 65534", "--instance"],
    );
    assert_eq!(stays.unwrap(), "planted\n");
    assert_eq!(cleaned.unwrap().files, 0);
    let output = run(bench.up(&name).args(["--episodes", "1", "--quiet"]));
    assert!(output.status.success(), "{}", told(&output));
}

#[test]
fn a_runtime_directory_is_preferred_and_a_set_in_it_is_found() {
    let (bench, name) = (Bench::new(), instance("xdg"));
    let runtime = tempfile::tempdir_in("/tmp").unwrap();
    std::fs::set_permissions(runtime.path(), PermissionsExt::from_mode(0o700)).unwrap();
    let mut command = bench.up(&name);
    command.env("XDG_RUNTIME_DIR", runtime.path());
    command.args(["--episodes", "1000000", "--quiet"]);
    let mut child = command.spawn().unwrap();
    let directory = runtime.path().join("mirror").join(&name);
    while !directory.join("launcher.sock").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it did not start");
        std::thread::yield_now();
    }
    let mut doctor = mirror();
    let listed = run(doctor.arg("doctor").env("XDG_RUNTIME_DIR", runtime.path()));
    // SAFETY: signals our own child, which was not waited for.
    unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGINT) };
    child.wait().unwrap();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    assert!(
        listed.contains(&format!("{name}: runs under process {}", child.id())),
        "{listed}"
    );
    assert!(!directory.exists());
    for root in lookup_roots() {
        assert!(!root.join(&name).exists());
    }
}

#[test]
fn names_that_a_shell_or_a_path_would_misread_are_refused() {
    let bench = Bench::new();
    for name in [
        "-x", "--clean", "", ".", "..", "a/b", "a b", "*", "~", "$HOME", "a;b", "ä",
    ] {
        let mut command = mirror();
        command.args([
            "up",
            "--episodes",
            "1",
            "--planner",
            "none",
            "--human",
            "self",
        ]);
        command.arg(format!("--instance={name}"));
        command
            .arg("--self-model")
            .arg(bench.path("self.safetensors"));
        assert_refused(&run(&mut command), &[&format!("{name:?}"), "letters"]);
    }
}

#[test]
fn too_few_open_files_are_refused_in_words() {
    let (bench, name) = (Bench::new(), instance("files"));
    let up = bench.up(&name);
    let mut command = Command::new("/bin/sh");
    command.args(["-c", "ulimit -n 100; exec \"$0\" \"$@\""]);
    command.arg(up.get_program()).args(up.get_args());
    assert_refused(&run(&mut command), &["100", "256", "ulimit -n"]);
    let mut doctor = Command::new("/bin/sh");
    doctor
        .args(["-c", "ulimit -n 100; exec \"$0\" doctor"])
        .arg(env!("CARGO_BIN_EXE_mirror"));
    let output = run(&mut doctor);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert!(told(&output).contains("TOO LOW"), "{}", told(&output));
}

/// Runs a script in which mounts are its own; none where that is not permitted.
fn in_own_mounts(script: &str, program: &Path, arguments: &[&str]) -> Option<Output> {
    let mut probe = Command::new("unshare");
    let probe = probe
        .args(["-m", "sh", "-c", "mount -t tmpfs none /dev/shm"])
        .output();
    if !probe.is_ok_and(|probe| probe.status.success()) {
        return None;
    }
    let mut command = Command::new("unshare");
    command
        .args(["-m", "sh", "-ec", script])
        .arg(program)
        .args(arguments);
    Some(run(&mut command))
}

#[test]
fn shared_memory_that_is_small_or_cannot_be_used_is_refused_in_words() {
    let (bench, name) = (Bench::new(), instance("shm"));
    let up = bench.up(&name);
    let arguments: Vec<&str> = up.get_args().map(|word| word.to_str().unwrap()).collect();
    let arguments = [&arguments[..], &["--episodes", "1", "--quiet"][..]].concat();
    let with = |options: &str| {
        let script = format!("mount -t tmpfs -o {options} none /dev/shm; exec \"$0\" \"$@\"");
        in_own_mounts(&script, Path::new(env!("CARGO_BIN_EXE_mirror")), &arguments)
    };
    let Some(output) = with("size=1m") else {
        testing::skipped(
            "shared_memory_that_is_small_or_cannot_be_used_is_refused_in_words",
            "a file system cannot be mounted here",
        );
        return;
    };
    assert_refused(
        &output,
        &["/dev/shm has", "1024 KiB", "mirror doctor --clean"],
    );
    let output = with("ro").unwrap();
    assert_refused(&output, &["/dev/shm", "read-only"]);
    // What every container has, and less.
    for size in ["size=64m", "size=8m"] {
        let output = with(size).unwrap();
        assert!(output.status.success(), "{size}: {}", told(&output));
    }
}

/// A dead run's files are in the way of the next one only until it looks.
#[test]
fn what_a_dead_run_left_is_cleaned_before_room_is_looked_for() {
    let root = root_for("dead");
    let prefix = prefix(&root, "dead");
    // Other runs of this user, which know nothing of these mounts, are hidden with the rest of /tmp.
    let script = format!(
        "mount -t tmpfs -o size=16m none /dev/shm; mount -t tmpfs none /tmp; umask 077; mkdir -p {root}/dead; : > {root}/dead.lock; \
         head -c 15m /dev/zero > /dev/shm/{prefix}left.data; \"$0\" \"$@\"; ls /dev/shm {root}",
        root = root.display()
    );
    let program = Path::new(env!("CARGO_BIN_EXE_mirror"));
    let words = "up --planner none --human self --episodes 1 --quiet --instance after";
    let words: Vec<&str> = words.split(' ').collect();
    let Some(output) = in_own_mounts(&script, program, &words) else {
        testing::skipped(
            "what_a_dead_run_left_is_cleaned_before_room_is_looked_for",
            "a file system cannot be mounted here",
        );
        return;
    };
    assert!(output.status.success(), "{}", told(&output));
    let left = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(!left.contains(&prefix), "{left}");
    assert!(!left.lines().any(|line| line == "dead"), "{left}");
}

#[test]
fn a_program_that_was_moved_away_from_its_sources_works() {
    let shared = Shared::new();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let hide = format!(
        "mount -t tmpfs none {}; cd /; exec \"$0\" \"$@\"",
        repository.display()
    );
    let out = shared.path("rounds.safetensors");
    let drive = shared.path("drive.mcap");
    let (out, drive) = (out.to_str().unwrap(), drive.to_str().unwrap());
    let (first, second) = (instance("moved"), instance("moved-grid"));
    let short = [
        "--planner",
        "none",
        "--human",
        "self",
        "--episodes",
        "1",
        "--quiet",
    ];
    let commands: [Vec<&str>; 5] = [
        [
            &["up", "--instance", first.as_str(), "--record", drive][..],
            &short[..],
        ]
        .concat(),
        [
            &[
                "up",
                "--instance",
                second.as_str(),
                "--scene",
                "search-smoke",
                "--driver",
                "sim:2",
            ][..],
            &short[..],
        ]
        .concat(),
        vec!["replay", drive],
        vec!["demos", "--person", "3", "--rounds", "1", "--out", out],
        vec![
            "demos", "--domain", "driving", "--person", "3", "--rounds", "8", "--out", out,
        ],
    ];
    for command in commands {
        let Some(output) = in_own_mounts(&hide, &shared.path("mirror"), &command) else {
            testing::skipped(
                "a_program_that_was_moved_away_from_its_sources_works",
                "the sources cannot be hidden here",
            );
            return;
        };
        assert!(output.status.success(), "{command:?}: {}", told(&output));
    }
}
