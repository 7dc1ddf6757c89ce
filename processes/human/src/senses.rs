//! How what is sensed, shown and said in a domain becomes what models take.

use domains::Layout;
use domains::highway::modalities;
use messages::{Display, LidarFrame, Message, Observation, SECTORS, Sensed, UtteranceContent};
use models::utterances::{Said, UtteranceTable};
use models::{Communicated, Observations, Shape};
use std::sync::Arc;

/// A domain's senses.
pub trait Senses {
    /// What there is to sense.
    type Sensed: Sensed;

    /// Sizes of the modalities, and how many numbers an action has.
    fn shape(&self) -> Shape;

    /// What [`Sensed::measure`] must be.
    fn measure(&self) -> [u32; 3];

    /// Whether people hear words without an assistant, too.
    fn hears(&self) -> bool {
        false
    }

    /// Writes the observation into column 0; gives what of it was shown and said.
    fn take_in(
        &self,
        sensed: &Self::Sensed,
        display: &Display,
        out: &mut Observations,
    ) -> Communicated;
}

/// The highway's: the words that were really spoken stand in the verbal modality.
impl Senses for UtteranceTable {
    type Sensed = LidarFrame;

    fn shape(&self) -> Shape {
        Shape::of(&modalities::layout())
    }

    fn measure(&self) -> [u32; 3] {
        LidarFrame::ZERO.measure()
    }

    fn take_in(
        &self,
        frame: &LidarFrame,
        display: &Display,
        out: &mut Observations,
    ) -> Communicated {
        modalities::write_visual(&frame.range, &frame.ego, out.visual.column_mut(0));
        let spoken = (display.utterance_count as usize).min(display.utterances.len());
        let verbal = out.verbal.column_mut(0);
        verbal.fill(0.0);
        let mut heard = 0;
        for utterance in &display.utterances[..spoken] {
            let sector = utterance.item as usize;
            let said = match utterance.content() {
                Ok(UtteranceContent::Nothing) => Said::Nothing,
                Ok(UtteranceContent::Slow) => Said::Slow,
                Ok(UtteranceContent::Fast) => Said::Fast,
                _ => continue, // words that the models have never heard
            };
            if sector < SECTORS {
                self.encode(sector, said, utterance.range_m, verbal);
                heard |= 1 << sector;
            }
        }
        Communicated::new(display.highlighted, heard)
    }
}

/// A gridworld's: what is said of an observation stands in it.
pub struct GridSenses {
    /// What the numbers mean.
    pub layout: Arc<Layout>,
}

impl Senses for GridSenses {
    type Sensed = Observation;

    fn shape(&self) -> Shape {
        Shape::of(&self.layout)
    }

    fn measure(&self) -> [u32; 3] {
        let Layout {
            number,
            visual,
            verbal,
            ..
        } = *self.layout;
        [number, visual as u32, verbal as u32]
    }

    fn hears(&self) -> bool {
        self.layout.heard != 0
    }

    fn take_in(
        &self,
        sensed: &Observation,
        display: &Display,
        out: &mut Observations,
    ) -> Communicated {
        out.visual.column_mut(0).copy_from_slice(sensed.visual());
        out.verbal.column_mut(0).copy_from_slice(sensed.verbal());
        let (possible, said) = (self.layout.everything(), display.said());
        Communicated::new(
            display.highlighted & possible.visual as u32,
            said & possible.verbal,
        )
    }
}
