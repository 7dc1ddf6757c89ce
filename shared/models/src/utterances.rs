//! The table that turns an utterance into the numbers that models hear: a sentence encoder's embedding, reduced by an
//! autoencoder to 19 dimensions (paper, appendix, "Search and Rescue").

use domains::highway::modalities::PER_SECTOR;
use domains::highway::{LIDAR_RANGE_M as RANGE_M, SECTORS};
use thiserror::Error;

/// What an utterance says of its sector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Said {
    /// No car there.
    Nothing = 0,
    /// A car slower than 32 km/h.
    Slow = 1,
    /// A car of 32 km/h or more.
    Fast = 2,
}

/// Reading the table failed.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file is no safetensors file.
    #[error("utterance table: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// A tensor is not what it should be.
    #[error("utterance table: tensor `latent` must be float32 [18, 19], found {0}")]
    Shape(String),
}

/// Embeddings of the 18 utterances: sector × {nothing, slow, fast}.
#[derive(Clone, Debug)]
pub struct UtteranceTable {
    latent: Vec<[f32; PER_SECTOR - 1]>,
}

impl UtteranceTable {
    /// The table that ships with the project.
    pub fn shipped() -> Result<Self, TableError> {
        Self::from_bytes(include_bytes!("../../pretrained/utterances.safetensors"))
    }

    /// Reads the tensor `latent` (`float32 [18, 19]`) of a safetensors file's bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TableError> {
        let file = safetensors::SafeTensors::deserialize(bytes)?;
        let tensor = file.tensor("latent")?;
        let wanted = [SECTORS * 3, PER_SECTOR - 1];
        if tensor.dtype() != safetensors::Dtype::F32 || tensor.shape() != wanted {
            return Err(TableError::Shape(format!(
                "{:?} {:?}",
                tensor.dtype(),
                tensor.shape()
            )));
        }
        let numbers: Vec<f32> = tensor
            .data()
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        if let Some(bad) = numbers.iter().find(|x| !x.is_finite()) {
            return Err(TableError::Shape(format!("a value of {bad}")));
        }
        let latent = numbers
            .chunks_exact(PER_SECTOR - 1)
            .map(|row| core::array::from_fn(|i| row[i]))
            .collect();
        Ok(Self { latent })
    }

    /// Writes what `said` of `sector` sounds like into that sector's 20 numbers of a verbal column.
    pub fn encode(&self, sector: usize, said: Said, range_m: f32, verbal: &mut [f32]) {
        let out = &mut verbal[sector * PER_SECTOR..(sector + 1) * PER_SECTOR];
        out[..PER_SECTOR - 1].copy_from_slice(&self.latent[sector * 3 + said as usize]);
        out[PER_SECTOR - 1] = (range_m / RANGE_M).clamp(0.0, 1.0);
    }

    /// The utterance whose embedding lies nearest to what is heard (or imagined) of a sector, with the range in metres.
    pub fn decode(&self, sector: usize, verbal: &[f32]) -> (Said, f32) {
        let heard = &verbal[sector * PER_SECTOR..(sector + 1) * PER_SECTOR];
        let distance = |kind: usize| -> f32 {
            self.latent[sector * 3 + kind]
                .iter()
                .zip(heard)
                .map(|(a, b)| (a - b) * (a - b))
                .sum()
        };
        let kinds = [Said::Nothing, Said::Slow, Said::Fast];
        let mut best = 0;
        for kind in 1..3 {
            if distance(kind) < distance(best) {
                best = kind;
            }
        }
        (kinds[best], heard[PER_SECTOR - 1] * RANGE_M)
    }
}
