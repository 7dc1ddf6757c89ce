//! A skipped test is seen, and fails where it is required.

use std::ffi::OsString;
use std::process::Output;
use testing::Stander;

testing::stand_in!(
    skip;
    the_line_is_seen_although_the_test_passes,
    a_required_test_fails_instead,
    a_program_that_stands_in_runs_no_test,
);

/// What a test does that cannot run here.
fn skip(test: &str, _: OsString) {
    testing::skipped(test, "there is no moon");
}

/// Skips a test in a process of its own.
fn skipped(require: Option<&str>) -> Output {
    let mut command = Stander::new("landing").command();
    command.env_remove("MIRROR_REQUIRE");
    if let Some(value) = require {
        command.env("MIRROR_REQUIRE", value);
    }
    command.output().unwrap()
}

fn the_line_is_seen_although_the_test_passes() {
    let output = skipped(None);
    assert!(output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(told, "skipped: landing: there is no moon\n");
}

fn a_required_test_fails_instead() {
    let output = skipped(Some("all"));
    assert!(!output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("there is no moon"), "{told}");
}

fn a_program_that_stands_in_runs_no_test() {
    let output = skipped(None);
    assert!(output.stdout.is_empty(), "{output:?}");
    let listed = std::process::Command::new(std::env::current_exe().unwrap())
        .arg("--list")
        .output()
        .unwrap();
    let listed = String::from_utf8(listed.stdout).unwrap();
    assert!(listed.contains("a_required_test_fails_instead"), "{listed}");
    assert!(!listed.contains("skip:"), "{listed}");
}
