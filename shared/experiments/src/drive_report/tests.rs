//! Claims and numbers follow from the rows.

use super::*;
use crate::results::Verdict;

/// Rows of four people: collisions by condition and case, highlighted steps, utterances.
fn rows(of: &[(Condition, [u32; 4], u32, u32)]) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for (condition, hits, highlighted, utterances) in of {
        for person in 1..=4_u32 {
            for case in 1..=6_u32 {
                let hit = u32::from(case <= hits[person as usize - 1]);
                // Nobody is told exactly as much as anybody else.
                let more = person + case;
                let row = format!(
                    "{},{person},1,{case},100,{hit},{},3,{},{},0.5",
                    condition.name(),
                    150 - 100 * hit + person,
                    highlighted * more / 8,
                    utterances * more / 8,
                );
                rows.push(row.split(',').map(str::to_owned).collect());
            }
        }
    }
    rows
}

const FOUR: [Condition; 4] = [
    Condition::Silent,
    Condition::Bc,
    Condition::Mirror,
    Condition::MirrorKl,
];

fn report(mirror: [u32; 4], kl: ([u32; 4], u32, u32)) -> Report {
    let rows = rows(&[
        (Condition::Silent, [5, 5, 6, 6], 0, 0),
        (Condition::Bc, [5, 6, 5, 6], 16, 16),
        (Condition::Mirror, mirror, 8, 8),
        (Condition::MirrorKl, kl.0, kl.1, kl.2),
    ]);
    Report::new(&FOUR, 4, &rows, 0.15)
}

fn verdicts(report: &Report) -> Vec<(char, Verdict)> {
    report
        .claims
        .iter()
        .map(|c| (c.letter, c.verdict))
        .collect()
}

#[test]
fn claims_follow_from_the_rows() {
    let as_in_the_paper = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
    assert_eq!(
        verdicts(&as_in_the_paper),
        [('g', Verdict::Reproduced), ('h', Verdict::Reproduced)]
    );
    // No better than the others, and belief matching both safer and, on one channel, quieter.
    let otherwise = report([5, 5, 6, 6], ([0, 0, 1, 0], 8, 64));
    assert_eq!(
        verdicts(&otherwise),
        [('g', Verdict::Not), ('h', Verdict::Partly)]
    );
}

#[test]
fn numbers_are_per_person_and_minute() {
    let report = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
    let mirror = report.condition(Condition::Mirror).expect("was run");
    assert_eq!(mirror.rounds, 24);
    assert!((mirror.collisions.mean - 2.0 / 24.0).abs() < 1e-12);
    // Person p is told p + c times in case c, in rounds of 15 s: (6 p + 21) / 1.5 min.
    let expected = (1..=4).map(|p| f64::from(6 * p + 21) / 1.5).sum::<f64>() / 4.0;
    assert!((mirror.utterances_per_minute.mean - expected).abs() < 1e-9);
    assert!((mirror.highlighted_s_per_minute.mean - 0.15 * expected).abs() < 1e-9);
    let utterances = &report.tests[2];
    assert_eq!(
        utterances.pairs.len(),
        2,
        "silence is not compared in what it says"
    );
    assert_eq!(report.tests[0].pairs.len(), 3);
}

#[test]
fn section_and_plots_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let report = report([1, 0, 1, 0], ([0, 1, 1, 0], 80, 64));
    report.write(folder.path()).expect("written");
    for file in ["drive.json", "drive.svg", "drive.png"] {
        assert!(folder.path().join(file).exists(), "{file}");
    }
    let file = folder.path().join("RESULTS.md");
    let text = report.section(&file, folder.path(), "mirror evaluate drive", "A test.");
    for part in [
        "| (g) |",
        "| (h) |",
        "F(3, 9)",
        "mirror − silent",
        "(drive.svg)",
        "| mirror-kl | 24 |",
    ] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
}
