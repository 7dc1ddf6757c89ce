//! A disk that takes nothing more: alone in its program, because the limit that stands in for it is the whole
//! process's.

use std::path::Path;

/// The process's limit on the length of files; none when dropped, so that the test's own output has room.
struct Limit;

impl Limit {
    fn set(bytes: libc::rlim_t) {
        let limit = libc::rlimit {
            rlim_cur: bytes,
            rlim_max: libc::RLIM_INFINITY,
        };
        // SAFETY: plain system calls with a live structure; no handler of ours is replaced.
        unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &raw const limit), 0);
        }
    }
}

impl Drop for Limit {
    fn drop(&mut self) {
        Self::set(libc::RLIM_INFINITY);
    }
}

#[test]
fn a_full_disk_changes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    for name in ["one", "two"] {
        std::fs::write(at(name), "old").expect("written");
    }
    std::fs::hard_link(at("two"), at("also two")).expect("linked");
    Limit::set(1000);
    let _limit = Limit;
    let refused = |path: &Path| {
        let error = files::write(path, &[b'x'; 2000]).expect_err("too much");
        assert!(
            error.to_string().contains(&path.display().to_string()),
            "{error}"
        );
    };
    refused(&at("new"));
    assert!(!at("new").exists());
    for name in ["one", "two"] {
        refused(&at(name));
        assert_eq!(std::fs::read_to_string(at(name)).expect("there"), "old");
        files::write(&at(name), b"small enough").expect("written");
    }
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("a folder").count(),
        3
    );
}
