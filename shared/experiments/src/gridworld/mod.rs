//! The paper's studies in the three gridworlds: how well models fit people (`fit`), how well they serve an assistant
//! (`communicate`), and what their perceptual implants found (`implants`).
//!
//! [`subject`] has the people and their rounds, [`units`] runs a study in pieces that can be done in any order, on any core, and
//! after any interruption, [`score`] measures likelihoods. Each study has a file of its own and one for its report.

pub mod communicate;
pub mod communicate_report;
pub mod drawing;
pub mod fit;
pub mod implants;
pub mod score;
pub mod subject;
pub mod units;

use domains::discrete::Domain;
use models::SelfModel;
use training::cloning::CloningSettings;
use training::implants::ImplantSettings;
use training::sqil::SqilSettings;

/// What a domain is called in headings.
pub const fn title(domain: Domain) -> &'static str {
    match domain {
        Domain::Driving => "gridworld driving",
        Domain::SearchRescue => "search and rescue",
        Domain::BombDefusal => "bomb defusal",
    }
}

/// What every study has to know.
#[derive(Clone, Copy, Debug)]
pub struct Common {
    /// The domain.
    pub domain: Domain,
    /// Persons 1 to this number.
    pub people: u32,
    /// Repetitions with other rounds and other first weights.
    pub seeds: u64,
    /// The first seed.
    pub seed: u64,
    /// Most phases of soft-Q imitation, for the quick form.
    pub sqil_phases: Option<usize>,
}

impl Common {
    /// The seeds.
    pub fn all_seeds(&self) -> std::ops::Range<u64> {
        self.seed..self.seed + self.seeds
    }

    /// Everybody, once for each seed: (seed, person).
    pub fn everybody(&self) -> impl Iterator<Item = (u64, u32)> + use<> {
        let people = self.people;
        self.all_seeds()
            .flat_map(move |seed| (1..=people).map(move |person| (seed, person)))
    }

    /// What every study's rows depend on beside their keys, with what this one's do: nobody continues a study with other
    /// settings of learning.
    pub(crate) fn about(&self, model: &SelfModel, own: serde_json::Value) -> serde_json::Value {
        let domain = self.domain.name();
        serde_json::json!({
            "self_model": model.digest(),
            "rounds": [subject::LEARNING, subject::VALIDATION, subject::TEST],
            "implants": ImplantSettings::of(domain),
            "bc": CloningSettings::of(domain),
            "sqil": SqilSettings::of(domain),
            "sqil_phases": self.sqil_phases,
            "study": own,
        })
    }

    /// Whether a row of this person and seed is part of the study: a table may hold more.
    pub(crate) fn has(&self, person: f64, seed: f64) -> bool {
        let seeds = self.all_seeds();
        (1.0..=f64::from(self.people)).contains(&person)
            && (seeds.start as f64..seeds.end as f64).contains(&seed)
    }

    /// The study's name in files and markers.
    pub fn name(&self, study: &str) -> String {
        format!("{study}-{}", self.domain.name())
    }
}
