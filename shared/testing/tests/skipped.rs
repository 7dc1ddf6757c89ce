//! A skipped test is seen, and fails where it is required.

use std::process::{Command, Output};

/// This program's test of that name, run by itself.
fn run(test: &str, require: Option<&str>) -> Output {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--ignored"]);
    command.env_remove("MIRROR_REQUIRE");
    if let Some(value) = require {
        command.env("MIRROR_REQUIRE", value);
    }
    command.output().unwrap()
}

/// What the others run.
#[test]
#[ignore = "run by the other tests of this file"]
fn one_that_is_skipped() {
    testing::skipped("one_that_is_skipped", "there is no moon");
}

#[test]
fn the_line_is_seen_although_the_test_passes() {
    let output = run("one_that_is_skipped", None);
    assert!(output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(told, "skipped: one_that_is_skipped: there is no moon\n");
}

#[test]
fn a_required_test_fails_instead() {
    let output = run("one_that_is_skipped", Some("all"));
    assert!(!output.status.success());
    let told = String::from_utf8(output.stdout).unwrap();
    assert!(told.contains("there is no moon"), "{told}");
}
