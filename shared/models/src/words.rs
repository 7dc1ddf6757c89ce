//! The gridworlds' words that ship with the project: a sentence encoder's embeddings, reduced by an autoencoder
//! (`tools/embed_utterances.py`).

use domains::Layout;
use domains::discrete::{Discrete, Domain, Scene, Words, WordsError, World};
use std::sync::Arc;
use thiserror::Error;

/// A table of words could not be used.
#[derive(Debug, Error)]
pub enum TableError {
    /// It is no safetensors file, or lacks the tensor.
    #[error("table of words: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// The tensor `latent` is not float32, sentences × width.
    #[error("table of words: tensor `latent` must be float32, sentences × width, found {0}")]
    Shape(String),
    /// Its numbers are no words.
    #[error(transparent)]
    Words(#[from] WordsError),
}

/// The words of a domain that ship with the project; none for driving, whose words are symbols.
///
/// # Errors
/// If the shipped table is damaged.
pub fn shipped(domain: Domain) -> Result<Words, TableError> {
    match domain {
        Domain::Driving => Ok(Words::none()),
        Domain::SearchRescue => from_bytes(include_bytes!(
            "../../pretrained/utterances-search-rescue.safetensors"
        )),
        Domain::BombDefusal => from_bytes(include_bytes!(
            "../../pretrained/utterances-bomb-defusal.safetensors"
        )),
    }
}

/// The layout of a scene, with the words that ship.
///
/// # Errors
/// If the shipped table is damaged.
pub fn layout_of(scene: &Scene) -> Result<Arc<Layout>, TableError> {
    let world = World::new(scene, &shipped(scene.domain())?)?;
    Ok(Arc::new(world.layout().clone()))
}

/// Reads the tensor `latent` (float32, sentences × width) of a safetensors file's bytes.
///
/// # Errors
/// If there is no such tensor, or a number is not finite.
pub fn from_bytes(bytes: &[u8]) -> Result<Words, TableError> {
    let file = safetensors::SafeTensors::deserialize(bytes)?;
    let tensor = file.tensor("latent")?;
    let (kind, shape) = (tensor.dtype(), tensor.shape());
    let (safetensors::Dtype::F32, [_, width]) = (kind, shape) else {
        return Err(TableError::Shape(format!("{kind:?} {shape:?}")));
    };
    let numbers: Vec<f32> = tensor
        .data()
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    Ok(Words::new(*width, &numbers)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::discrete::{Discrete, End, Mind, Scene, Setting, SimulatedPerson, World};

    /// What ships fits its domain, is in the order of its sentences, and people who are told understand it.
    #[test]
    fn shipped_words_are_understood() {
        for domain in Domain::ALL {
            let scene = Scene::of(domain, Setting::Transfer);
            let words = shipped(domain).unwrap();
            assert_eq!(words.len(), scene.sentences().len());
            let mut world = World::new(&scene, &words).unwrap();
            let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
            let layout = world.layout().clone();
            let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
            let mut successes = 0;
            for round in 0..18 {
                world.reset(1, round, round);
                person.reset(1, round);
                while world.end().is_running() {
                    world.observe(&mut visual, &mut verbal);
                    person.perceive(&visual, &verbal, layout.communicable);
                    world.step(person.act());
                }
                successes += u32::from(world.end() == End::Success);
            }
            // Drivers are noisy: one or two of eighteen may crash on what they know.
            let least = match domain {
                Domain::Driving => 16,
                Domain::SearchRescue | Domain::BombDefusal => 18,
            };
            assert!(successes >= least, "{domain:?}: {successes}");
        }
    }

    #[test]
    fn sentences_in_the_files_are_the_ones_spoken() {
        let files: [(Domain, &[u8]); 2] = [
            (
                Domain::SearchRescue,
                include_bytes!("../../pretrained/utterances-search-rescue.safetensors"),
            ),
            (
                Domain::BombDefusal,
                include_bytes!("../../pretrained/utterances-bomb-defusal.safetensors"),
            ),
        ];
        for (domain, bytes) in files {
            let (_, head) = safetensors::SafeTensors::read_metadata(bytes).unwrap();
            let metadata = head.metadata().as_ref().unwrap();
            let sentences: Vec<String> = serde_json::from_str(&metadata["sentences"]).unwrap();
            assert_eq!(sentences, Scene::of(domain, Setting::Original).sentences());
            assert!(metadata["command"].contains("--seed"));
        }
    }

    #[test]
    fn damaged_tables_are_refused() {
        let good = include_bytes!("../../pretrained/utterances-search-rescue.safetensors");
        assert!(from_bytes(&good[..good.len() - 4]).is_err());
        assert!(from_bytes(b"no table at all").is_err());
        let mut bad = good.to_vec();
        let last = bad.len() - 4;
        bad[last..].copy_from_slice(&f32::NAN.to_le_bytes());
        let message = from_bytes(&bad).unwrap_err().to_string();
        assert_eq!(message, "words: NaN in sentence 9");
    }
}
