//! What a run trusts: directories and files of its own user alone; whom it ends: processes of its own; what it removes:
//! what it made.

mod support;

use runtime::{InstanceError, InstanceLock, RunArguments, instance};
use std::io::Read;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use support::{Child, roles};
use tempfile::TempDir;

testing::stand_in!(
    roles::play;
    a_process_that_outlived_its_launcher_is_ended,
    a_process_that_holds_no_node_is_never_signalled,
    a_link_in_the_place_of_a_root_or_an_instance_is_not_followed,
    a_directory_that_others_may_use_is_refused,
    another_users_directory_is_refused,
    only_what_the_program_made_is_removed,
    what_somebody_else_put_in_shared_memory_is_refused_and_stays,
);

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

/// A process with a node in this instance that no launcher ends, once it is there.
fn orphan(scratch: &TempDir, name: &str) -> Child {
    let arguments = RunArguments::new(scratch.path(), name, 7, runtime::ClockMode::Lockstep);
    let mut arguments = arguments.expect("a name").for_process("echo", 0);
    arguments.launcher_pid = 0;
    let directory = instance::directory(scratch.path(), name);
    std::fs::create_dir(&directory).expect("made");
    std::fs::set_permissions(&directory, PermissionsExt::from_mode(0o700)).expect("set");
    let child = Child::spawn("echo", &arguments);
    let lives = |node: &instance::NodeEntry| node.alive && node.pid == child.pid();
    while !instance::nodes(scratch.path(), name)
        .expect("nodes can be listed")
        .iter()
        .any(lives)
    {
        std::thread::yield_now();
    }
    child
}

fn has_ended(process: &impl AsRawFd) -> bool {
    let mut poll = libc::pollfd {
        fd: process.as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    };
    // SAFETY: one live structure.
    unsafe { libc::poll(&mut poll, 1, 0) == 1 }
}

fn a_process_that_outlived_its_launcher_is_ended() {
    let scratch = testing::private_directory();
    let orphan = orphan(&scratch, "orphan");
    let report = runtime::cleanup_dead(scratch.path(), "orphan").expect("cleaning works");
    assert_eq!(report.failed, 0);
    let process = runtime::process_descriptor(orphan.pid());
    assert!(process.is_err() || has_ended(&process.expect("a zombie")));
    assert!(!instance::directory(scratch.path(), "orphan").exists());
}

/// The process id that a node states may be somebody else's by now.
fn a_process_that_holds_no_node_is_never_signalled() {
    let scratch = testing::private_directory();
    let orphan = orphan(&scratch, "foreign");
    let mut innocent = Command::new("cat")
        .stdin(Stdio::piped())
        .spawn()
        .expect("a process of somebody else's");
    let nodes = instance::directory(scratch.path(), "foreign").join("nodes");
    let mut found = 0;
    for entry in std::fs::read_dir(nodes).expect("a folder").flatten() {
        let files = std::fs::read_dir(entry.path()).into_iter().flatten();
        for path in files.flatten().map(|file| file.path()) {
            if path.extension().is_some_and(|end| end == "details") {
                let mode = |mode| {
                    std::fs::set_permissions(&path, PermissionsExt::from_mode(mode)).expect("set");
                };
                let text = std::fs::read_to_string(&path).expect("readable");
                let stated = |pid| format!("process = {pid}\n");
                assert!(text.contains(&stated(orphan.pid())), "{text}");
                let text = text.replace(&stated(orphan.pid()), &stated(innocent.id()));
                mode(0o600);
                std::fs::write(&path, text).expect("written");
                mode(0o400);
                found += 1;
            }
        }
    }
    assert_eq!(found, 1);
    let claims = |node: &instance::NodeEntry| node.alive && node.pid == innocent.id();
    let listed = instance::nodes(scratch.path(), "foreign").expect("listed");
    assert!(listed.iter().any(claims), "{listed:?}");
    let report = runtime::cleanup_dead(scratch.path(), "foreign").expect("cleaning works");
    assert_eq!((report.nodes, report.failed), (1, 0));
    assert!(
        innocent.try_wait().expect("asked").is_none(),
        "it was ended"
    );
    let process = runtime::process_descriptor(orphan.pid());
    assert!(process.is_err() || has_ended(&process.expect("a zombie")));
    drop(innocent.stdin.take());
    assert!(innocent.wait().expect("ended").success());
}

/// Something that looks like a person's home.
fn home(scratch: &TempDir) -> std::path::PathBuf {
    let home = scratch.path().join("home");
    std::fs::create_dir_all(home.join("lab")).expect("made");
    std::fs::write(home.join("lab/thesis"), "years").expect("written");
    std::fs::write(home.join("lab/table.json"), "{}").expect("written");
    for path in [&home, &home.join("lab")] {
        std::fs::set_permissions(path, PermissionsExt::from_mode(0o700)).expect("set");
    }
    home
}

fn assert_untouched(home: &Path) {
    let mut thesis = String::new();
    std::fs::File::open(home.join("lab/thesis"))
        .and_then(|mut file| file.read_to_string(&mut thesis))
        .expect("still there");
    assert_eq!(thesis, "years");
    assert!(home.join("lab/table.json").exists());
    assert_eq!(
        std::fs::read_dir(home.join("lab")).expect("there").count(),
        2
    );
}

/// Every way to touch an instance, with the error that has to come of it.
fn refused_everywhere(root: &Path, what: &str, word: &str) {
    let arguments = RunArguments::new(root, "lab", 7, runtime::ClockMode::Lockstep);
    for refused in [
        InstanceLock::acquire(root, "lab").map(|_| ()),
        runtime::cleanup_dead(root, "lab").map(|_| ()),
        instance::nodes(root, "lab").map(|_| ()),
        arguments.expect("a name").write().map(|_| ()),
    ] {
        match refused.expect_err(what) {
            error @ InstanceError::Untrusted { .. } => {
                let said = error.to_string();
                assert!(said.contains(word), "{what}: {said}");
                assert!(said.contains(&root.display().to_string()), "{what}: {said}");
            }
            other => panic!("{what}: {other}"),
        }
    }
}

fn a_link_in_the_place_of_a_root_or_an_instance_is_not_followed() {
    let scratch = testing::private_directory();
    let home = home(&scratch);
    let root = scratch.path().join("root");
    symlink(&home, &root).expect("linked");
    refused_everywhere(&root, "the root is a link", "symbolic link");
    runtime::list_instances(&root).expect_err("the root is a link");
    assert_eq!(instance::launcher(&root, "lab"), None);
    std::fs::remove_file(&root).expect("ours");
    std::fs::create_dir(&root).expect("made");
    std::fs::set_permissions(&root, PermissionsExt::from_mode(0o700)).expect("set");
    symlink(home.join("lab"), root.join("lab")).expect("linked");
    refused_everywhere(&root, "the instance is a link", "symbolic link");
    std::fs::remove_file(root.join("lab")).expect("ours");
    std::fs::remove_file(root.join("lab.lock")).expect("made by the attempt");
    symlink(home.join("lab/thesis"), root.join("lab.lock")).expect("linked");
    let error = InstanceLock::acquire(&root, "lab").expect_err("the lock is a link");
    assert!(error.to_string().contains("lab.lock"), "{error}");
    assert_untouched(&home);
}

fn a_directory_that_others_may_use_is_refused() {
    let scratch = testing::private_directory();
    let home = home(&scratch);
    for mode in [0o755, 0o710, 0o701, 0o777, 0o1777] {
        std::fs::set_permissions(&home, PermissionsExt::from_mode(mode)).expect("set");
        refused_everywhere(&home, "others may use it", "700");
    }
    std::fs::set_permissions(&home, PermissionsExt::from_mode(0o700)).expect("set");
    std::fs::set_permissions(home.join("lab"), PermissionsExt::from_mode(0o750)).expect("set");
    refused_everywhere(&home, "others may use the instance", "700");
    // What lies in a place where others may rename it is theirs to replace.
    std::fs::set_permissions(home.join("lab"), PermissionsExt::from_mode(0o700)).expect("set");
    std::fs::set_permissions(scratch.path(), PermissionsExt::from_mode(0o777)).expect("set");
    refused_everywhere(&home, "others may replace it", "sticky");
    std::fs::set_permissions(scratch.path(), PermissionsExt::from_mode(0o700)).expect("set");
    std::fs::write(scratch.path().join("file"), "").expect("written");
    refused_everywhere(&scratch.path().join("file"), "no directory", "no directory");
    assert_untouched(&home);
}

fn another_users_directory_is_refused() {
    // SAFETY: cannot fail.
    if unsafe { libc::geteuid() } != 0 {
        testing::skipped(
            "another_users_directory_is_refused",
            "only root can give a directory away",
        );
        return;
    }
    let scratch = testing::private_directory();
    let home = home(&scratch);
    std::os::unix::fs::chown(home.join("lab"), Some(65534), None).expect("given away");
    refused_everywhere(&home, "another's instance", "belongs to user 65534");
    std::os::unix::fs::chown(&home, Some(65534), None).expect("given away");
    refused_everywhere(&home, "another's root", "belongs to user 65534");
    assert_untouched(&home);
}

fn only_what_the_program_made_is_removed() {
    let scratch = testing::private_directory();
    let home = home(&scratch);
    let prefix = instance::prefix(scratch.path(), "mixed");
    let directory = instance::directory(scratch.path(), "mixed");
    let lock = InstanceLock::acquire(scratch.path(), "mixed").expect("free");
    let ours = ["world.0.json", "learned.0.safetensors", "launcher.sock"];
    for name in ours {
        std::fs::write(directory.join(name), "").expect("written");
    }
    std::fs::create_dir(directory.join("thesis")).expect("made");
    std::fs::write(directory.join("thesis/world.0.json"), "").expect("written");
    std::fs::write(directory.join("notes"), "").expect("written");
    symlink(&home, directory.join("services")).expect("linked");
    symlink(home.join("lab/thesis"), directory.join("link.json")).expect("linked");
    let shared = Path::new("/dev/shm").join(format!("{prefix}ours.data"));
    std::fs::write(&shared, "").expect("written");
    drop(lock);
    assert!(!shared.exists());
    for name in ours {
        assert!(!directory.join(name).exists(), "{name}");
    }
    for name in ["thesis/world.0.json", "notes", "services", "link.json"] {
        assert!(directory.join(name).symlink_metadata().is_ok(), "{name}");
    }
    assert_untouched(&home);
}

/// In shared memory everybody may put a file: one that is not ours would be taken for a message's.
fn what_somebody_else_put_in_shared_memory_is_refused_and_stays() {
    let scratch = testing::private_directory();
    let home = home(&scratch);
    let prefix = instance::prefix(scratch.path(), "planted");
    let planted = Path::new("/dev/shm").join(format!("{prefix}planted.data"));
    symlink(home.join("lab/thesis"), &planted).expect("linked");
    let error = InstanceLock::acquire(scratch.path(), "planted").expect_err("a link lies there");
    assert!(error.to_string().contains(&prefix), "{error}");
    assert!(planted.symlink_metadata().is_ok());
    std::fs::remove_file(&planted).expect("ours");
    assert_untouched(&home);
    // SAFETY: cannot fail.
    if unsafe { libc::geteuid() } != 0 {
        testing::skipped(
            "what_somebody_else_put_in_shared_memory_is_refused_and_stays",
            "only root can put another user's file into shared memory",
        );
        return;
    }
    std::fs::write(&planted, "").expect("written");
    std::os::unix::fs::chown(&planted, Some(65534), None).expect("given away");
    let refused = InstanceLock::acquire(scratch.path(), "planted").map(|_| ());
    let stays = planted.exists();
    std::fs::remove_file(&planted).expect("ours to remove, as root");
    let error = refused.expect_err("another's file lies there");
    assert!(error.to_string().contains("user 65534"), "{error}");
    assert!(stays);
}
