//! A study that was cut off anywhere and started again ends with the same table as one that was not.

use experiments::drive::{Condition, Study, run};
use planning::Settings;
use std::path::Path;

fn study(rounds: usize) -> Study {
    Study {
        conditions: vec![Condition::Clear, Condition::Silent],
        people: 2,
        seeds: 1,
        planned_seeds: 1,
        seed: 4,
        rounds,
        settings: Settings::default(),
    }
}

fn table(out: &Path) -> String {
    std::fs::read_to_string(out.join("drive.csv")).expect("the table")
}

#[test]
fn a_study_that_was_cut_off_ends_with_the_same_table() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = folder.path().join("whole");
    let report = run(&study(6), None, &whole, &|_, _| {}).expect("run");
    let text = table(&whole);
    assert_eq!(text.lines().count(), 1 + 2 * 2 * 6);
    assert_eq!(report.conditions.len(), 2);
    // What a SIGKILL leaves: rows in the order in which they were ready, the last one perhaps in half.
    let lines: Vec<&str> = text.lines().collect();
    for cut in [0, lines[0].len() + 3, text.len() / 2, text.len() - 3] {
        let out = folder.path().join(format!("cut-{cut}"));
        std::fs::create_dir(&out).expect("made");
        std::fs::write(out.join("drive.csv"), &text[..cut]).expect("written");
        run(&study(6), None, &out, &|_, _| {}).expect("run");
        assert_eq!(table(&out), text, "cut at {cut}");
    }
    // Twice the same, nothing left to do.
    run(&study(6), None, &whole, &|done, all| {
        assert_eq!((done, all), (0, 0))
    })
    .expect("run");
    assert_eq!(table(&whole), text);
    let error = run(&study(5), None, &whole, &|_, _| {}).expect_err("other settings");
    assert!(error.to_string().contains("drive.settings.json"), "{error}");
}
