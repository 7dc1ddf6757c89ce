//! Everything that can be said in the cockpit was recorded: a sentence, or, in gridworld driving, its three parts.

use domains::discrete::symbols;
use domains::highway::UtteranceKind;
use domains::highway::speech::{SECTOR_NAMES, sentence};
use domains::{bomb_defusal, driving, search_rescue};
use std::collections::BTreeMap;

fn asset(path: &str) -> &'static [u8] {
    let found = web::COCKPIT.iter().find(|asset| asset.path == path);
    found.unwrap().bytes
}

fn recorded() -> BTreeMap<String, [usize; 2]> {
    serde_json::from_slice(asset("sentences.json")).unwrap()
}

#[test]
fn every_sentence_is_recorded() {
    let recorded = recorded();
    for sector in 0..SECTOR_NAMES.len() {
        for kind in [
            UtteranceKind::Nothing,
            UtteranceKind::Slow,
            UtteranceKind::Fast,
        ] {
            let words = sentence(sector, kind);
            assert!(recorded.contains_key(words), "{words}");
        }
    }
    let fixed = search_rescue::SENTENCES
        .iter()
        .chain(&bomb_defusal::SENTENCES);
    for words in fixed {
        assert!(recorded.contains_key(*words), "{words}");
    }
    for slot in 0..driving::CARS {
        for cells in -10..=10 {
            for speed in [-1.0, 0.0, 1.0] {
                let mut words = String::new();
                symbols(slot, cells as f32, speed, &mut words);
                // As `web/src/cockpit/sound.js` takes it apart.
                let (car, rest) = words.split_once(": ").unwrap();
                let (place, moves) = rest.split_once(", ").unwrap();
                for part in [format!("{car}:"), format!("{place},"), moves.to_owned()] {
                    assert!(recorded.contains_key(&part), "{part} of {words}");
                }
            }
        }
    }
}

#[test]
fn every_recording_is_whole() {
    let bytes = asset("sentences.bin");
    let mut end = 0;
    let mut places: Vec<[usize; 2]> = recorded().into_values().collect();
    places.sort_unstable();
    for [start, length] in places {
        assert_eq!(start, end);
        let clip = &bytes[start..start + length];
        assert!(clip.starts_with(b"OggS") && clip.windows(8).any(|at| at == b"OpusHead"));
        end = start + length;
    }
    assert_eq!(end, bytes.len());
}

/// Pages and sounds are small, as they are committed and compiled into the program.
#[test]
fn the_pages_are_small() {
    let mut files = BTreeMap::new();
    for asset in web::COCKPIT.iter().chain(web::LIVE_VIEW) {
        assert!(asset.bytes.len() > 100, "{} is empty", asset.path);
        files.insert(asset.bytes.as_ptr(), asset.bytes.len());
    }
    let together: usize = files.values().sum();
    assert!(together < 3 << 20, "{together} bytes");
}
