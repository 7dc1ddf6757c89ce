//! What becomes of a decision to communicate: which cars get a box, which one sentence is spoken, and when the next may
//! start. The renderer process and experiments without processes share it.

use super::speech::{SECTOR_AZIMUTHS, displayable, utterances};
use super::{Observation, SECTORS, Shown};

/// Remembers when something was last said.
#[derive(Clone, Debug)]
pub struct Presenter {
    interval_steps: u32,
    ready_step: u32,
}

impl Presenter {
    /// Nothing said yet. Utterances start at least `interval_s` apart.
    pub fn new(interval_s: f64, step_s: f64) -> Self {
        Self {
            // Rounding of the quotient must not add a step to an interval of a whole number of steps.
            interval_steps: (interval_s / step_s - 1e-3).ceil().max(1.0) as u32,
            ready_step: 0,
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.ready_step = 0;
    }

    /// Steps until the next utterance may start, seen from `step`.
    pub fn ready_in(&self, step: u32) -> u32 {
        self.ready_step.saturating_sub(step)
    }

    /// What is shown and said at `step`: boxes around the cars that the LIDAR sees in the sectors of `visual` and within
    /// the display's reach, and no highlight where it sees none; of the sectors of `verbal`, one sentence about the likeliest, if it is time to speak.
    pub fn present(
        &mut self,
        step: u32,
        visual: u32,
        verbal: u32,
        verbal_probability: &[f32; SECTORS],
        observation: &Observation,
    ) -> Shown {
        let mut shown = Shown::default();
        let mut count = 0;
        for (sector, &(first, last)) in SECTOR_AZIMUTHS.iter().enumerate() {
            if visual >> sector & 1 == 0 {
                continue;
            }
            for azimuth in (first..=last).filter(|&azimuth| displayable(azimuth)) {
                let object = observation.object[azimuth];
                let boxes = &mut shown.highlighted_objects;
                shown.highlighted |= u32::from(object >= 0) << sector;
                if object >= 0 && count < boxes.len() && !boxes[..count].contains(&object) {
                    boxes[count] = object;
                    count += 1;
                }
            }
        }
        if step >= self.ready_step
            && let Some(sector) = most_wanted(verbal, verbal_probability)
        {
            shown.utterances[sector] = Some(utterances(observation)[sector]);
            self.ready_step = step + self.interval_steps;
        }
        shown
    }
}

/// Of the sectors to speak about, the one whose probability is highest; of equals, the first.
pub fn most_wanted(verbal: u32, probability: &[f32]) -> Option<usize> {
    (0..SECTORS)
        .filter(|sector| verbal >> sector & 1 == 1)
        .reduce(|best, sector| {
            if probability[sector] > probability[best] {
                sector
            } else {
                best
            }
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_highlight_needs_a_car() {
        let mut observation = Observation::default();
        observation.object.fill(-1);
        observation.object[4] = 7; // left front
        observation.object[12] = 9; // left rear, behind the display's edge
        let mut presenter = Presenter::new(3.5, 0.15);
        let shown = presenter.present(0, 0b11_1111, 0, &[0.0; SECTORS], &observation);
        assert_eq!(shown.highlighted, 0b00_0010);
        assert_eq!(shown.highlighted_objects[..2], [7, -1]);
    }
}
