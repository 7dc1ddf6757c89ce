//! What becomes of links, modes, owners, pipes and devices when something is written to them.

use std::io::Read;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("readable")
}

/// Names in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder").flatten();
    let mut names: Vec<_> = entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn fifo(path: PathBuf) -> PathBuf {
    rustix::fs::mkfifoat(rustix::fs::CWD, &path, 0o600.into()).expect("a pipe");
    path
}

#[test]
fn a_new_file_gets_the_usual_mode_and_nothing_lies_beside_it() {
    let folder = folder();
    let (ours, usual) = (folder.path().join("ours"), folder.path().join("usual"));
    files::write(&ours, b"one").expect("written");
    std::fs::write(&usual, "").expect("written");
    let mode = |path| std::fs::metadata(path).expect("there").mode();
    assert_eq!(read(&ours), "one");
    assert_eq!(mode(&ours), mode(&usual));
    assert_eq!(names(folder.path()), ["ours", "usual"]);
}

#[test]
fn a_link_stays_a_link_and_its_target_gets_the_contents() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("far")).expect("made");
    std::fs::write(at("far/file"), "old").expect("written");
    symlink("far/file", at("near")).expect("linked");
    symlink("near", at("nearer")).expect("linked");
    files::write(&at("nearer"), b"new").expect("written");
    assert_eq!(read(&at("far/file")), "new");
    for link in ["near", "nearer"] {
        let kind = std::fs::symlink_metadata(at(link)).expect("there");
        assert!(kind.is_symlink(), "{link}");
    }
    // One that leads to nothing yet.
    symlink("far/later", at("dangling")).expect("linked");
    files::check(&at("dangling")).expect("can be written");
    assert!(!at("far/later").exists(), "asking makes nothing");
    files::write(&at("dangling"), b"later").expect("written");
    assert_eq!(read(&at("far/later")), "later");
    assert_eq!(names(&at("far")), ["file", "later"]);
    // One that leads nowhere, and one that leads to itself.
    symlink("no/where", at("nowhere")).expect("linked");
    symlink("round", at("round")).expect("linked");
    for link in ["nowhere", "round"] {
        let error = files::write(&at(link), b"").expect_err("refused");
        assert!(error.to_string().contains(link), "{error}");
        assert!(files::check(&at(link)).is_err(), "{link}");
    }
}

#[test]
fn mode_and_names_of_a_file_stay() {
    let folder = folder();
    let (path, second) = (folder.path().join("file"), folder.path().join("second"));
    std::fs::write(&path, "old").expect("written");
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o640)).expect("set");
    files::write(&path, b"new").expect("written");
    assert_eq!(
        std::fs::metadata(&path).expect("there").mode() & 0o7777,
        0o640
    );
    std::fs::hard_link(&path, &second).expect("linked");
    for contents in ["a longer text than before", "short"] {
        files::write(&path, contents.as_bytes()).expect("written");
        assert_eq!(read(&second), contents);
    }
    assert_eq!(std::fs::metadata(&path).expect("there").nlink(), 2);
}

#[test]
fn the_owner_of_a_file_stays() {
    if !rustix::process::geteuid().is_root() {
        testing::skipped(
            "the_owner_of_a_file_stays",
            "only root can write to a file and leave it to its owner",
        );
        return;
    }
    let folder = folder();
    let path = folder.path().join("file");
    std::fs::write(&path, "old").expect("written");
    std::os::unix::fs::chown(&path, Some(65534), Some(65534)).expect("given away");
    files::write(&path, b"new").expect("written");
    let now = std::fs::metadata(&path).expect("there");
    assert_eq!((now.uid(), now.gid()), (65534, 65534));
    assert_eq!(read(&path), "new");
}

#[test]
fn what_comes_to_a_pipe_runs_through_it() {
    let folder = folder();
    let path = fifo(folder.path().join("pipe"));
    files::check(&path).expect("can be written to");
    files::check_regular(&path).expect_err("cannot be read back");
    let big = vec![b'x'; 300_000];
    let read = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut read = Vec::new();
            let mut pipe = std::fs::File::open(&path).expect("opened");
            pipe.read_to_end(&mut read).expect("read");
            read
        });
        files::write(&path, &big).expect("written");
        reader.join().expect("a reader")
    });
    assert_eq!(read, big);
    let kind = std::fs::symlink_metadata(&path).expect("there").file_type();
    assert!(kind.is_fifo());
}

#[test]
fn a_device_stays_a_device() {
    let null = Path::new("/dev/null");
    files::write(null, b"lost").expect("written");
    files::log(null, false).expect("opened");
    let full = files::write(Path::new("/dev/full"), b"lost").expect_err("full");
    assert!(full.to_string().contains("/dev/full"), "{full}");
    for device in ["/dev/null", "/dev/full"] {
        let kind = std::fs::symlink_metadata(device)
            .expect("there")
            .file_type();
        assert!(kind.is_char_device(), "{device}");
    }
}

#[test]
fn what_is_no_file_is_refused_in_words() {
    let folder = folder();
    let socket = folder.path().join("socket");
    let _listener = std::os::unix::net::UnixListener::bind(&socket).expect("bound");
    for (path, word) in [(folder.path(), "a directory"), (&socket, "a socket")] {
        for refused in [
            files::write(path, b"").expect_err("refused"),
            files::check(path).expect_err("refused"),
            files::log(path, true).expect_err("refused"),
        ] {
            let said = refused.to_string();
            assert!(said.contains(word), "{said}");
            assert!(said.contains(&path.display().to_string()), "{said}");
        }
    }
    let missing = folder.path().join("no/file");
    let said = files::check(&missing).expect_err("refused").to_string();
    assert!(
        said.contains("no/file") && said.contains("directory"),
        "{said}"
    );
}

#[test]
fn a_log_goes_on_or_begins_anew_through_its_link() {
    use std::io::Write;
    let folder = folder();
    let (path, link) = (folder.path().join("log"), folder.path().join("link"));
    symlink("log", &link).expect("linked");
    for (keep, expected) in [(false, "a\n"), (true, "a\na\n"), (false, "a\n")] {
        let mut log = files::log(&link, keep).expect("opened");
        log.write_all(b"a\n").expect("written");
        assert_eq!(read(&path), expected);
    }
}
