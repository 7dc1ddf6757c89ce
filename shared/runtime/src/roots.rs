//! Where this user's instances are.
//!
//! A new one goes to `$XDG_RUNTIME_DIR/mirror`, where that variable names a directory of this user's alone and the
//! paths of sockets below it are not too long, and to `/tmp/mirror-<uid>` otherwise. A session without the variable
//! (cron, `su`, a container's shell) has to find what another one started, so whoever looks for an instance looks in
//! all of them.

use crate::held::launcher;
use crate::paths::fits;
use crate::private;
use std::path::{Path, PathBuf};

/// The root for a new instance of this name.
pub fn root_for(instance: &str) -> PathBuf {
    let named = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    choose(named.as_deref(), instance)
}

fn choose(named: Option<&Path>, instance: &str) -> PathBuf {
    named
        .and_then(below)
        .filter(|root| fits(root, instance))
        .unwrap_or_else(temporary)
}

/// All roots in which an instance of this user's can be, the preferred one first.
pub fn lookup_roots() -> Vec<PathBuf> {
    let named = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let usual = PathBuf::from(format!("/run/user/{}", private::me()));
    let mut roots: Vec<PathBuf> = [named, Some(usual)]
        .into_iter()
        .flatten()
        .filter_map(|directory| below(&directory))
        .collect();
    roots.dedup();
    // What somebody else has put under our name in /tmp is none of our instances, if we have another place for them.
    if roots.is_empty() || private::open(&temporary()).is_ok() {
        roots.push(temporary());
    }
    roots
}

/// The root in which an instance runs, or else the one for a new instance of this name.
pub fn root_of(instance: &str) -> PathBuf {
    lookup_roots()
        .into_iter()
        .find(|root| launcher(root, instance).is_some())
        .unwrap_or_else(|| root_for(instance))
}

/// The root in a runtime directory, if that is one: absolute, there, and this user's alone.
fn below(directory: &Path) -> Option<PathBuf> {
    let is_ours = directory.is_absolute() && matches!(private::open(directory), Ok(Some(_)));
    is_ours.then(|| directory.join("mirror"))
}

fn temporary() -> PathBuf {
    PathBuf::from(format!("/tmp/mirror-{}", private::me()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_runtime_directory_is_used_if_it_is_ours_alone_and_short_enough() {
        let own = testing::private_directory();
        let (ours, tmp) = (own.path().join("mirror"), temporary());
        assert_eq!(choose(Some(own.path()), "lab"), ours);
        assert_eq!(choose(None, "lab"), tmp);
        assert_eq!(choose(Some(Path::new("relative")), "lab"), tmp);
        assert_eq!(choose(Some(Path::new("/nowhere/at/all")), "lab"), tmp);
        let long = "x".repeat(32);
        let deep = own.path().join("deep");
        std::fs::create_dir(&deep).expect("made");
        std::fs::set_permissions(&deep, PermissionsExt::from_mode(0o700)).expect("set");
        assert_eq!(choose(Some(&deep), "lab"), deep.join("mirror"));
        assert_eq!(choose(Some(&deep), &long), tmp, "no socket would fit");
        let link = own.path().join("link");
        std::os::unix::fs::symlink(&deep, &link).expect("linked");
        assert_eq!(choose(Some(&link), "lab"), tmp);
        std::fs::set_permissions(&deep, PermissionsExt::from_mode(0o750)).expect("set");
        assert_eq!(choose(Some(&deep), "lab"), tmp);
    }
}
