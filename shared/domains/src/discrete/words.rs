//! What sentences look like to models and people: a vector for each. The vectors come from outside (a sentence encoder's
//! embeddings, reduced); this crate only places them and recognises them.

use std::sync::Arc;

use thiserror::Error;

/// Vectors that do not fit a domain.
#[derive(Debug, Error, PartialEq)]
pub enum WordsError {
    /// Their number is no multiple of the width, the width is 0, or a value is not finite.
    #[error("words: {0}")]
    Shape(String),
    /// Another number of sentences than the domain says.
    #[error("words: {found} sentences, the domain says {wanted}")]
    Count {
        /// How many there are.
        found: usize,
        /// How many the domain says.
        wanted: usize,
    },
}

/// A vector for each sentence. Clones share the numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Words {
    width: usize,
    numbers: Arc<[f32]>,
}

impl Words {
    /// `numbers` is sentences × width.
    ///
    /// # Errors
    /// If the shape does not fit or a number is not finite.
    pub fn new(width: usize, numbers: &[f32]) -> Result<Self, WordsError> {
        if width == 0 || !numbers.len().is_multiple_of(width) {
            let reason = format!(
                "{} numbers are no whole sentences of {width}",
                numbers.len()
            );
            return Err(WordsError::Shape(reason));
        }
        if let Some(at) = numbers.iter().position(|x| !x.is_finite()) {
            let reason = format!("{} in sentence {}", numbers[at], at / width);
            return Err(WordsError::Shape(reason));
        }
        Ok(Self {
            width,
            numbers: numbers.into(),
        })
    }

    /// Sentence i is the unit vector i of `sentences` dimensions: words without an encoder, for tests and measurements.
    pub fn indicator(sentences: usize) -> Self {
        let width = sentences.max(1);
        let numbers = (0..sentences * width).map(|i| f32::from(u8::from(i / width == i % width)));
        Self {
            width,
            numbers: numbers.collect(),
        }
    }

    /// No sentences: for driving, whose words are symbols.
    pub fn none() -> Self {
        Self::indicator(0)
    }

    /// Numbers of a sentence.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Sentences.
    pub fn len(&self) -> usize {
        self.numbers.len() / self.width
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// A sentence's vector.
    ///
    /// # Panics
    /// If there is no such sentence.
    pub fn vector(&self, sentence: usize) -> &[f32] {
        &self.numbers[sentence * self.width..(sentence + 1) * self.width]
    }

    /// Which of some sentences is nearest to what was heard (or imagined), by Euclidean distance; the first of equals.
    pub fn nearest(&self, candidates: std::ops::Range<usize>, heard: &[f32]) -> usize {
        let distance = |sentence: usize| -> f32 {
            let pairs = self.vector(sentence).iter().zip(heard);
            pairs.map(|(a, b)| (a - b) * (a - b)).sum()
        };
        let first = candidates.start;
        candidates
            .fold((first, f32::INFINITY), |best, sentence| {
                let d = distance(sentence);
                if d < best.1 { (sentence, d) } else { best }
            })
            .0
    }

    pub(crate) fn expect(&self, wanted: usize) -> Result<(), WordsError> {
        let found = self.len();
        if found == wanted {
            return Ok(());
        }
        Err(WordsError::Count { found, wanted })
    }
}
