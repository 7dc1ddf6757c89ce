//! Rounds from a table of one's own become demonstrations: `examples/python/rounds.py` writes what [`Rounds::load`] reads.

use domains::discrete::{Discrete, Domain, Scene, Setting, SimulatedPerson, World};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use training::rounds::{Round, Rounds};

/// Any Python; says so where there is none.
fn python(test: &str) -> Option<PathBuf> {
    let found = testing::python(
        Path::new(env!("CARGO_TARGET_TMPDIR")),
        "python-plain",
        &[],
        "",
    );
    if found.is_none() {
        testing::skipped(test, "there is no Python");
    }
    found
}

/// Rounds of a domain, written as a table, turned into a file by Python, and read again.
#[test]
fn a_table_of_rounds_becomes_demonstrations() {
    let Some(python) = python("a_table_of_rounds_becomes_demonstrations") else {
        return;
    };
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

/// A table of two rounds of three steps, as a text whose lines tests change.
const TABLE: &str = "round,action,reward,perceived,v0,v1,v2,v3,v4,w0,w1,w2,w3,w4,w5,w6,w7
a,0,0.5,0,1,1,1,1,1,0,0,0,0,0,0,0,0
a,1,-1e-3,3,1,1,1,1,1,0,0,0,0,0,0,0,0
a,1,+.5,8589934592,1,1,1,1,1,0,0,0,0,0,0,0,0
b,1,0.,0,1,1,1,1,1,0,0,0,0,0,0,0,0
b,0,2,,1,1,1,1,1,0,0,0,0,0,0,0,0
b,1.0,0,0,1,1,1,1,1,0,0,0,0,0,0,0,0
";

/// Tables as spreadsheet programs and editors write them: what is unambiguous is read, the rest refused with file and line.
#[test]
fn tables_are_read_where_they_are_unambiguous() {
    let Some(python) = python("tables_are_read_where_they_are_unambiguous") else {
        return;
    };
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/python/rounds.py"
    );
    let folder = tempfile::tempdir().unwrap();
    let (table, file) = (
        folder.path().join("rounds.csv"),
        folder.path().join("rounds.safetensors"),
    );
    let run = |bytes: &[u8]| {
        std::fs::write(&table, bytes).unwrap();
        let mut command = Command::new(&python);
        command
            .arg(script)
            .args(["driving", "transfer"])
            .arg(&table)
            .arg(&file);
        command.output().unwrap()
    };
    let scene = Scene::of(Domain::Driving, Setting::Transfer);
    let words = models::words::shipped(Domain::Driving).unwrap();
    let layout = World::new(&scene, &words).unwrap().layout().clone();
    let mut plain = None;
    let utf16 =
        |bytes: fn(u16) -> [u8; 2]| -> Vec<u8> { TABLE.encode_utf16().flat_map(bytes).collect() };
    let quoted: Vec<String> = TABLE
        .lines()
        .map(|line| {
            line.split(',')
                .map(|cell| format!("\"{cell}\""))
                .collect::<Vec<_>>()
                .join(",")
        })
        .collect();
    for (what, bytes) in [
        ("plain", TABLE.as_bytes().to_vec()),
        (
            "byte-order mark",
            [&b"\xef\xbb\xbf"[..], TABLE.as_bytes()].concat(),
        ),
        (
            "UTF-16",
            [vec![0xff, 0xfe], utf16(u16::to_le_bytes)].concat(),
        ),
        (
            "UTF-16, big end first",
            [vec![0xfe, 0xff], utf16(u16::to_be_bytes)].concat(),
        ),
        ("UTF-16 without a mark", utf16(u16::to_le_bytes)),
        (
            "UTF-16 without a mark, big end first",
            utf16(u16::to_be_bytes),
        ),
        ("spaces", TABLE.replace(',', " ,  ").into_bytes()),
        ("line ends", TABLE.replace('\n', "\r\n").into_bytes()),
        ("old line ends", TABLE.replace('\n', "\r").into_bytes()),
        (
            "empty lines",
            format!("\n{}\n\n  \n,,,\n", TABLE.replace("\nb,1,", "\n\nb,1,")).into_bytes(),
        ),
        ("empty cells", TABLE.replace('\n', ",,\n").into_bytes()),
        ("quotation marks", quoted.join("\n").into_bytes()),
        ("no last line end", TABLE.trim_end().as_bytes().to_vec()),
        ("another column", TABLE.replace("\n", ",x\n").into_bytes()),
    ] {
        let output = run(&bytes);
        assert!(output.status.success(), "{what}: {output:?}");
        let read = Rounds::load(&file, &layout).unwrap().rounds;
        assert_eq!(
            read.iter().map(Round::len).collect::<Vec<_>>(),
            [3, 3],
            "{what}"
        );
        assert_eq!(read, *plain.get_or_insert(read.clone()), "{what}");
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.contains("2 rounds, 6 steps"), "{what}: {said}");
    }
    let steps = |numbers: [u32; 6]| {
        let mut lines = TABLE.lines();
        let mut text = format!("{},step\n", lines.next().unwrap());
        lines
            .zip(numbers)
            .for_each(|(line, step)| writeln!(text, "{line},{step}").unwrap());
        text
    };
    assert!(run(steps([4, 5, 6, 0, 1, 2]).as_bytes()).status.success());
    std::fs::remove_file(&file).unwrap();
    let swap = |from: &str, to: &str| {
        assert!(TABLE.contains(from), "{from}");
        TABLE.replacen(from, to, 1)
    };
    for (text, line, words) in [
        (
            TABLE.replace(',', ";"),
            1,
            &[
                "columns found: 'round;action",
                "missing: round, action, reward, v0, w0",
                "comma",
            ][..],
        ),
        (
            TABLE.replace(',', "\t"),
            1,
            &["missing: round, action, reward, v0, w0", "comma"],
        ),
        (swap("reward", "prize"), 1, &["'prize'", "missing: reward"]),
        (swap(",v1,", ",x1,"), 1, &["'x1'", "missing: v1"]),
        (swap(",v1,", ",v0,"), 1, &["column 'v0' stands twice"]),
        (
            swap("perceived", "reward"),
            1,
            &["column 'reward' stands twice"],
        ),
        (swap("-1e-3", "1e39"), 3, &["reward is '1e39'", "32-bit"]),
        (swap("-1e-3", "nan"), 3, &["reward is 'nan'"]),
        (swap("-1e-3", "inf"), 3, &["reward is 'inf'"]),
        (swap("-1e-3", "1_0"), 3, &["reward is '1_0'"]),
        (swap("-1e-3", "\"0,5\""), 3, &["reward is '0,5'", "a point"]),
        (
            swap("-1e-3", "0,5"),
            3,
            &["18 cells", "17 columns", "comma within a number"],
        ),
        (swap("-1e-3", ""), 3, &["reward is ''"]),
        (swap("8589934592,1", "0,1e39"), 4, &["v0 is '1e39'"]),
        (
            swap("8589934592", "18446744073709551616"),
            4,
            &["perceived is '18446744073709551616'"],
        ),
        (swap("8589934592", "-1"), 4, &["perceived is '-1'"]),
        (swap("b,1,", "b,256,"), 5, &["action is '256'"]),
        (swap("b,1,", "b,left,"), 5, &["action is 'left'"]),
        (swap("b,1,", "b,1.5,"), 5, &["action is '1.5'"]),
        (swap("b,1,", ",1,"), 5, &["round is empty"]),
        (swap("b,1,0.,0,1,1", "b,1"), 5, &["13 cells", "17 columns"]),
        (swap("b,1,", "\"b,1,"), 7, &["unexpected end of data"]),
        (
            swap("\nb,1.0", "\na,1.0"),
            7,
            &["round 'a' began at line 2", "one after the other"],
        ),
        (steps([0, 1, 2, 0, 2, 3]), 6, &["step 2 follows step 0"]),
        (steps([0, 0, 1, 0, 1, 2]), 3, &["step 0 follows step 0"]),
        (swap("a,0", "\u{e9}\u{0}a,x"), 2, &["action is 'x'"]),
    ] {
        let output = run(text.as_bytes());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}: {said}");
        assert!(
            said.contains(&format!("rounds.csv: line {line}: ")),
            "line {line}: {said}"
        );
        assert!(
            words.iter().all(|word| said.contains(word)),
            "{words:?}: {said}"
        );
        assert!(!said.contains("Traceback") && !file.exists(), "{said}");
    }
    for (bytes, words) in [
        (&b"round,action\n\xff\n"[..], "line 2: byte 13 is not UTF-8"),
        (&b"\xff\xfer"[..], "line 1: byte 2 is not UTF-16"),
        (&b""[..], "no step"),
        (&TABLE.as_bytes()[..TABLE.find('\n').unwrap()], "no step"),
    ] {
        let said = String::from_utf8_lossy(&run(bytes).stderr).into_owned();
        assert!(
            said.contains("rounds.csv: ") && said.contains(words) && !said.contains("Traceback"),
            "{said}"
        );
    }
}

fn table_of(rounds: &Rounds, visual: usize, verbal: usize) -> String {
    let mut text = "round,action,reward,perceived".to_owned();
    (0..visual).for_each(|i| write!(text, ",v{i}").unwrap());
    (0..verbal).for_each(|i| write!(text, ",w{i}").unwrap());
    text.push('\n');
    for (number, round) in rounds.rounds.iter().enumerate() {
        for t in 0..round.len() {
            let perceived = round.perceived[t].visual | u64::from(round.perceived[t].verbal) << 32;
            let (action, reward) = (round.choice(t), round.reward[t]);
            write!(text, "{number},{action},{reward},{perceived}").unwrap();
            let seen = round.visual(t).iter();
            seen.chain(round.verbal(t))
                .for_each(|x| write!(text, ",{x}").unwrap());
            text.push('\n');
        }
    }
    text
}

/// Who is told what they saw in place of seeing it perceives nothing new, misses nothing, and does the same.
#[test]
fn told_in_place_of_seen() {
    use rand::SeedableRng;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    for domain in Domain::ALL {
        let scene = Scene::of(domain, Setting::Original);
        let words = models::words::shipped(domain).unwrap();
        let mut world = World::new(&scene, &words).unwrap();
        let layout = world.layout().clone();
        let mut person = SimulatedPerson::builtin(&scene, 2, &words).unwrap();
        let rounds = Rounds::record(&mut world, &mut person, 3, 0, 12);
        let mut changed = 0;
        for round in &rounds.rounds {
            let Some(told) = round.told_what_was_seen(&layout, &mut rng) else {
                continue;
            };
            assert_eq!((&told.action, &told.visual), (&round.action, &round.visual));
            for (before, after) in round.perceived.iter().zip(&told.perceived) {
                let (lost, new) = (before.visual & !after.visual, after.verbal & !before.verbal);
                assert_eq!(after.visual & !before.visual, 0);
                // Some hear of it anyway.
                let of = |said: u32| {
                    let items = (0..layout.utterances).filter(move |u| said >> u & 1 == 1);
                    items.fold(0, |all, u| all | layout.told_regions[u])
                };
                assert_eq!(lost & !of(after.verbal), 0, "{domain:?}");
                assert_eq!(lost & of(new), before.visual & of(new), "{domain:?}");
                changed += u32::from(lost != 0);
            }
        }
        // What the bomb is cannot be seen.
        assert_eq!(changed > 20, domain != Domain::BombDefusal, "{domain:?}");
    }
}
