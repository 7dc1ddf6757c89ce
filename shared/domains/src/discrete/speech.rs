//! What an utterance says in words, read from the numbers that stand for it in the verbal modality: for displays and people.

use std::fmt::Write;

use super::{Domain, Words};
use crate::driving::RANGE_CELLS;
use crate::{bomb_defusal, driving, search_rescue};

/// Appends the sentence that is said of utterance `utterance`; `verbal` is the whole modality, as sensed, `words` are the world's.
/// Nothing is appended if there is no such utterance, or the numbers are not as many as the domain has.
pub fn sentence(domain: Domain, words: &Words, utterance: usize, verbal: &[f32], out: &mut String) {
    let spoken = |candidates: std::ops::Range<usize>, sentences: &[&str], out: &mut String| {
        let width = words.width();
        let heard = verbal.get(utterance * width..(utterance + 1) * width);
        if let (Some(heard), true) = (heard, candidates.end <= words.len()) {
            out.push_str(sentences[words.nearest(candidates, heard)]);
        }
    };
    match domain {
        Domain::Driving => {
            if let Some([position, speed]) = verbal.get(2 * utterance..2 * utterance + 2) {
                symbols(utterance, position * RANGE_CELLS, *speed, out);
            }
        }
        Domain::SearchRescue if utterance < search_rescue::UTTERANCES => {
            let both = 2 * utterance..2 * utterance + 2;
            spoken(both, &search_rescue::SENTENCES, out);
        }
        Domain::BombDefusal if utterance == 0 => {
            spoken(0..bomb_defusal::TYPES, &bomb_defusal::SENTENCES, out);
        }
        Domain::SearchRescue | Domain::BombDefusal => {}
    }
}

/// Appends driving's symbols for a car in words: its slot, `cells` ahead (negative: behind), and the cells that it gains a step.
pub fn symbols(slot: usize, cells: f32, speed: f32, out: &mut String) {
    let Some(name) = driving::NAMES.get(slot) else {
        return;
    };
    let place = match cells.round() {
        0.0 => "alongside".to_owned(),
        ahead if ahead > 0.0 => format!("{ahead} ahead"),
        behind => format!("{} behind", -behind),
    };
    let moves = match speed {
        ..-0.5 => "falls back",
        0.5.. => "gains",
        _ => "keeps its distance",
    };
    // Writing to a string cannot fail.
    let _ = write!(out, "Car {name}: {place}, {moves}.");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discrete::{Discrete, Scene, Setting, World};

    /// Everything that can be said of a world at its start, in the order of its utterances.
    fn said(domain: Domain, scenario: u32) -> Vec<String> {
        let scene = Scene::of(domain, Setting::Original);
        let words = Words::indicator(scene.sentences().len());
        let mut world = World::new(&scene, &words).unwrap();
        world.reset(1, scenario, scenario);
        let layout = world.layout().clone();
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        world.observe(&mut visual, &mut verbal);
        let text = |utterance| {
            let mut out = String::new();
            sentence(domain, &words, utterance, &verbal, &mut out);
            out
        };
        (0..=layout.utterances).map(text).collect()
    }

    #[test]
    fn what_is_said_is_what_the_world_says() {
        let types: Vec<_> = (0..2).map(|s| said(Domain::BombDefusal, s)).collect();
        for (kind, said) in types.iter().enumerate() {
            assert_eq!(*said, [bomb_defusal::SENTENCES[kind], ""]);
        }
        for scenario in 0..9 {
            let said = said(Domain::SearchRescue, scenario);
            let victims = said.iter().filter(|text| text.starts_with("Victim in"));
            assert_eq!(victims.count(), 1, "{said:?}");
            assert_eq!(said[5], "");
        }
        let said = said(Domain::Driving, 0);
        assert!(said[0].starts_with("Car front left: "), "{said:?}");
        assert!(
            said[0].contains(" ahead, ") && said[3].contains(" behind, "),
            "{said:?}"
        );
    }

    #[test]
    fn every_sentence_fits_a_message() {
        let mut symbol = String::new();
        symbols(3, -10.0, 0.0, &mut symbol);
        assert_eq!(symbol, "Car rear right: 10 behind, keeps its distance.");
        let sentences = search_rescue::SENTENCES
            .iter()
            .chain(&bomb_defusal::SENTENCES);
        for text in sentences.copied().chain([symbol.as_str()]) {
            assert!(text.len() < 64, "{text}");
        }
    }
}
