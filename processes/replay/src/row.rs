//! What a replay finds out about a step, for the report: one row per step, kept as JSON lines.

use messages::{CommAction, DecisionReason, UnknownNumber, VERBAL_ITEMS, VISUAL_ITEMS};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::Path;

/// Numbers that are no numbers have no word in JSON: they are written as null.
mod number {
    use super::{VERBAL_ITEMS, VISUAL_ITEMS};
    use serde::{Deserialize, Deserializer};

    pub fn one<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
        Ok(Option::deserialize(from)?.unwrap_or(f32::NAN))
    }

    pub fn visual<'de, D: Deserializer<'de>>(from: D) -> Result<[f32; VISUAL_ITEMS], D::Error> {
        let numbers = <[Option<f32>; VISUAL_ITEMS]>::deserialize(from)?;
        Ok(numbers.map(|number| number.unwrap_or(f32::NAN)))
    }

    pub fn verbal<'de, D: Deserializer<'de>>(from: D) -> Result<[f32; VERBAL_ITEMS], D::Error> {
        let numbers = <[Option<f32>; VERBAL_ITEMS]>::deserialize(from)?;
        Ok(numbers.map(|number| number.unwrap_or(f32::NAN)))
    }
}

/// A decision, without what the report has no use for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReplayedDecision {
    /// A bit per visual item to show.
    pub visual: u32,
    /// A bit per verbal item to say.
    pub verbal: u32,
    /// Probability of each visual item.
    #[serde(deserialize_with = "number::visual")]
    pub visual_probability: [f32; VISUAL_ITEMS],
    /// Probability of each verbal item.
    #[serde(deserialize_with = "number::verbal")]
    pub verbal_probability: [f32; VERBAL_ITEMS],
    /// Predicted value of the plan.
    #[serde(deserialize_with = "number::one")]
    pub value: f32,
    /// Predicted value of saying nothing.
    #[serde(deserialize_with = "number::one")]
    pub value_silent: f32,
    /// Cost of what is communicated.
    #[serde(deserialize_with = "number::one")]
    pub cost: f32,
    /// As in [`CommAction::reason`].
    pub reason: u32,
}

impl From<&CommAction> for ReplayedDecision {
    fn from(decision: &CommAction) -> Self {
        Self {
            visual: decision.visual,
            verbal: decision.verbal,
            visual_probability: decision.visual_probability,
            verbal_probability: decision.verbal_probability,
            value: decision.value,
            value_silent: decision.value_silent,
            cost: decision.cost,
            reason: decision.reason,
        }
    }
}

impl ReplayedDecision {
    /// How it came about.
    ///
    /// # Errors
    /// [`UnknownNumber`].
    pub fn reason(&self) -> Result<DecisionReason, UnknownNumber> {
        DecisionReason::from_wire(self.reason)
    }

    /// Whether the same would be communicated.
    pub fn says_the_same(&self, other: &Self) -> bool {
        (self.visual, self.verbal) == (other.visual, other.verbal)
    }
}

/// A replayed step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The episode.
    pub episode: u32,
    /// Step k, at which the decision for k + 1 was made.
    pub step: u32,
    /// Why the step cannot be compared bit by bit: something before it in its episode is missing in the recording.
    pub after_gap: bool,
    /// Whether the robot's belief has the same bytes as then; none where there was none then.
    pub robot_same: Option<bool>,
    /// The same of the human model's belief and prediction.
    pub human_same: Option<bool>,
    /// The same of the decision.
    pub decision_same: Option<bool>,
    /// What was decided then.
    pub then: Option<ReplayedDecision>,
    /// What is decided now.
    pub now: ReplayedDecision,
    /// Log-likelihood of the action that the person really took at this step, as the human model said then.
    pub log_likelihood_then: Option<f32>,
    /// The same now.
    pub log_likelihood_now: Option<f32>,
}

/// Writes rows, one a line.
///
/// # Errors
/// The system's, with the file's name.
pub fn save(path: &Path, rows: &[Row]) -> io::Result<()> {
    let write = || {
        let mut file = BufWriter::new(File::create(path)?);
        for row in rows {
            serde_json::to_writer(&mut file, row)?;
            file.write_all(b"\n")?;
        }
        file.flush()
    };
    write().map_err(|error| named(path, 0, error))
}

/// Reads what [`save`] wrote.
///
/// # Errors
/// The system's or the format's, with the file's name and the line.
pub fn load(path: &Path) -> io::Result<Vec<Row>> {
    let file = File::open(path).map_err(|error| named(path, 0, error))?;
    let mut rows = Vec::new();
    for (index, line) in BufReader::new(file).lines().enumerate() {
        let row = line.and_then(|line| serde_json::from_str(&line).map_err(io::Error::other));
        rows.push(row.map_err(|error| named(path, index + 1, error))?);
    }
    Ok(rows)
}

fn named(path: &Path, line: usize, error: io::Error) -> io::Error {
    let place = match line {
        0 => path.display().to_string(),
        line => format!("{}:{line}", path.display()),
    };
    io::Error::new(error.kind(), format!("{place}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_survive_their_file() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("rows.jsonl");
        let row = Row {
            step: 3,
            decision_same: Some(true),
            log_likelihood_now: Some(-1.5),
            ..Row::default()
        };
        let rows = vec![Row::default(), row];
        save(&path, &rows)?;
        assert_eq!(load(&path)?, rows);
        let mut strange = Row::default();
        strange.now.value = f32::NAN;
        strange.now.visual_probability[2] = f32::INFINITY;
        save(&path, &[strange])?;
        let read = load(&path)?;
        assert!(read[0].now.value.is_nan() && read[0].now.visual_probability[2].is_nan());
        std::fs::write(&path, "{\"episode\": 0")?;
        let error = load(&path).expect_err("broken").to_string();
        assert!(error.contains("rows.jsonl:1"), "{error}");
        Ok(())
    }
}
