//! Rounds from a table of one's own become demonstrations: `examples/python/rounds.py` writes what [`Rounds::load`] reads.

use domains::discrete::{Discrete, Domain, Scene, Setting, SimulatedPerson, World};
use std::fmt::Write as _;
use std::process::Command;
use training::discrete::Rounds;

/// Rounds of a domain, written as a table, turned into a file by Python, and read again.
#[test]
fn a_table_of_rounds_becomes_demonstrations() {
    let python = std::env::var("MIRROR_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if Command::new(&python).arg("--version").output().is_err() {
        eprintln!("skipped: there is no {python}");
        return;
    }
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/python/rounds.py"
    );
    let folder = tempfile::tempdir().unwrap();
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Transfer);
        let words = models::words::shipped(domain).unwrap();
        let mut world = World::new(&scene, &words).unwrap();
        let layout = world.layout().clone();
        let mut person = SimulatedPerson::builtin(&scene, 2, &words).unwrap();
        let rounds = Rounds::record(&mut world, &mut person, 3, 0, 4);
        let table = folder.path().join("rounds.csv");
        std::fs::write(&table, table_of(&rounds, layout.visual, layout.verbal)).unwrap();
        let file = folder.path().join("rounds.safetensors");
        let run = |table: &std::path::Path| {
            let mut command = Command::new(&python);
            command.arg(script).args([domain.name(), "transfer"]);
            command.arg(table).arg(&file);
            command.output().unwrap()
        };
        let output = run(&table);
        assert!(output.status.success(), "{output:?}");
        let read = Rounds::load(&file, &layout).unwrap();
        assert_eq!(read.rounds, rounds.rounds, "{domain:?}");
        assert!(read.source.starts_with("rounds.py"));

        // What is no number is named by its line.
        let mut text = std::fs::read_to_string(&table).unwrap();
        text = text.replacen("\n0,", "\n0,left,", 1);
        std::fs::write(&table, text).unwrap();
        let output = run(&table);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && said.contains("line 2"),
            "{said}"
        );
        // A column that is missing, and a table that is.
        let gap = std::fs::read_to_string(&table)
            .unwrap()
            .replacen(",v1,", ",x1,", 1);
        std::fs::write(&table, gap).unwrap();
        let missing = folder.path().join("missing.csv");
        for (table, word) in [(&table, "line 1"), (&missing, "missing.csv")] {
            let output = run(table);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(!output.status.success() && said.contains(word), "{said}");
            assert!(!said.contains("Traceback"), "{said}");
        }
    }
}

fn table_of(rounds: &Rounds, visual: usize, verbal: usize) -> String {
    let mut text = "round,action,reward,perceived".to_owned();
    (0..visual).for_each(|i| write!(text, ",v{i}").unwrap());
    (0..verbal).for_each(|i| write!(text, ",w{i}").unwrap());
    text.push('\n');
    for (number, round) in rounds.rounds.iter().enumerate() {
        for t in 0..round.len() {
            let perceived =
                u64::from(round.perceived[t].visual) | u64::from(round.perceived[t].verbal) << 32;
            let (action, reward) = (round.action[t], round.reward[t]);
            write!(text, "{number},{action},{reward},{perceived}").unwrap();
            let seen = &round.visual[t * visual..(t + 1) * visual];
            let said = &round.verbal[t * verbal..(t + 1) * verbal];
            seen.iter()
                .chain(said)
                .for_each(|x| write!(text, ",{x}").unwrap());
            text.push('\n');
        }
    }
    text
}
