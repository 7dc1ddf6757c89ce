//! Belief matching (`kl`, the paper's MIRROR-KL): no plan and no reward; at every step what is communicated brings the
//! person's belief as near to the robot's as it can be brought (paper §V, "Compared Methods"; DESIGN §6).
//!
//! ```text
//! argmin over ω of  KL[q(z^H_{k+1} | z^H_k, ǎ_k, x̊(ω)) ‖ q(z^R_{k+1} | z^R_k, ǎ_k, x̂)],   x̂ = d(E[z^R_{k+1} | z^R_k, ǎ_k])
//! ```
//!
//! The display can show three sectors and one sentence is spoken at a time: 8 × 7 versions, all of which are tried, in one
//! question to the human model. At a tie the one that says less is taken.

use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{BITS, Decision, From, Settings, mix};
use models::imagined::Moment;
use models::observation::{AZIMUTHS, Encoded, SECTORS, azimuths_shown};
use models::self_model::{Decoder, Dynamics};
use models::{Communicated, Filter, Observations, SelfModel};
use nn::Tensor;

/// The belief-matching planner.
pub struct Matcher {
    settings: Settings,
    /// What could be communicated, least first.
    versions: Vec<Communicated>,
    /// So many of them, the first, say nothing aloud.
    unspoken: usize,
    z: Tensor,
    action: Tensor,
    actions: Tensor,
    still: Vec<f32>,
    dynamics: Dynamics,
    decoder: Decoder,
    imagined: Observations,
    copies: Observations,
    encoded: Encoded,
    filter: Filter,
    divergence: Vec<f32>,
}

impl Matcher {
    /// A planner for this self-model. Of `settings` only the costs matter, which are reported and not weighed.
    pub fn new(settings: Settings, model: &SelfModel) -> Self {
        let sizes = model.sizes;
        let shape = sizes.shape;
        let displayable: u32 = (0..SECTORS)
            .filter(|&sector| azimuths_shown(sector) > 0)
            .fold(0, |bits, sector| bits | 1 << sector);
        let mut shows: Vec<u32> = (0..1 << SECTORS)
            .filter(|bits| bits & !displayable == 0)
            .collect();
        shows.sort_by_key(|bits| (bits.count_ones(), *bits));
        let mut versions: Vec<Communicated> = shows
            .iter()
            .map(|&visual| Communicated::new(visual, 0))
            .collect();
        let unspoken = versions.len();
        for &visual in &shows {
            versions.extend((0..SECTORS).map(|sector| Communicated::new(visual, 1 << sector)));
        }
        Self {
            settings,
            unspoken,
            z: Tensor::new(sizes.latent, 1),
            action: Tensor::new(shape.action, 1),
            actions: Tensor::new(shape.action, versions.len()),
            still: vec![0.0; sizes.latent],
            dynamics: Dynamics::new(sizes.latent),
            decoder: Decoder::default(),
            imagined: Observations::new(&shape, 1),
            copies: Observations::new(&shape, versions.len()),
            encoded: Encoded::new(shape, 1),
            filter: Filter::new(sizes.latent, 1),
            divergence: vec![0.0; versions.len()],
            versions,
        }
    }

    /// Decides what to communicate at step k + 1. The result depends on the arguments alone.
    ///
    /// # Errors
    /// What the people answer; [`PeopleError::Incomparable`] if their beliefs are of another kind than the robot's.
    pub fn plan(
        &mut self,
        model: &SelfModel,
        from: From,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        match from.known_action {
            Some(action) => self.action.column_mut(0).copy_from_slice(&action),
            None => {
                let place = [from.seed, u64::from(from.episode), u64::from(from.step)];
                people.start(0, 1, mix(&place), None)?;
                people.answer(0, &mut self.action)?;
            }
        }
        // What the robot expects to sense, and to believe once it has.
        self.z.copy_from(from.mean);
        self.dynamics
            .step(model, &mut self.z, &self.action, &self.still);
        self.decoder
            .observations(model, &self.z, &mut self.imagined);
        let (visual, verbal) = (
            self.imagined.visual.column(0),
            self.imagined.verbal.column(0),
        );
        self.encoded
            .set(0, visual, verbal, &[1.0; AZIMUTHS], &[0.0; SECTORS]);
        self.filter.mean.copy_from(from.mean);
        self.filter.fresh = false;
        self.filter.update(model, &self.action, &self.encoded);

        let spoken = from.speech_ready_steps == 0;
        let count = if spoken {
            self.versions.len()
        } else {
            self.unspoken
        };
        self.copies.resize(count);
        self.actions.resize_to(self.action.rows(), count);
        for j in 0..count {
            self.copies.visual.column_mut(j).copy_from_slice(visual);
            self.copies.verbal.column_mut(j).copy_from_slice(verbal);
            self.actions
                .column_mut(j)
                .copy_from_slice(self.action.column(0));
        }
        let moment = Moment {
            action: &self.actions,
            observations: &self.copies,
            communicated: &self.versions[..count],
            robot_mean: self.filter.mean.column(0),
            robot_deviation: self.filter.deviation.column(0),
        };
        let divergence = &mut self.divergence[..count];
        people.compare(moment, divergence)?;
        // The first of equals: versions stand in the order of how much they say.
        let mut best = 0;
        for (i, value) in divergence.iter().enumerate() {
            if *value < divergence[best] {
                best = i;
            }
        }
        let communicated = self.versions[best];
        let bit = |b: usize| match b {
            b if b < SECTORS => communicated.visual(b),
            b => communicated.verbal(b - SECTORS),
        };
        let probability: [f32; BITS] = core::array::from_fn(|b| f32::from(u8::from(bit(b))));
        Ok(Decision {
            communicated,
            probability,
            value: -divergence[best],
            value_silent: -divergence[0],
            cost: self.settings.cost(communicated),
        })
    }
}
