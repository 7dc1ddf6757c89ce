//! What can be communicated at one moment, and what that costs: the planner's view of a domain's communication channels.

use crate::settings::{RaceSettings, Settings};
use domains::Layout;
use domains::discrete::Planning;
use domains::highway::modalities::{self, azimuths_shown};
use domains::highway::{SECTORS, Scene};
use models::Communicated;
use std::sync::Arc;

/// The items of a domain: `visual_items()` things that can be shown, `verbal_items()` that can be said.
pub trait Items {
    /// Visual items.
    fn visual_items(&self) -> usize;

    /// Verbal items.
    fn verbal_items(&self) -> usize;

    /// What the channels can carry at all: a display does not reach everywhere.
    fn possible(&self) -> Communicated;

    /// What of the items there is, where `visual` is what the robot believes to see: regions that hold something, and what there
    /// is something to say about. All that is possible by default.
    fn held(&self, visual: &[f32]) -> Communicated {
        let _ = visual;
        self.possible()
    }

    /// Utterances that can be spoken at one moment.
    fn spoken_at_once(&self) -> u32;

    /// Whether people hear words without an assistant, too: then what could be said matters even where nothing is.
    fn hears(&self) -> bool {
        false
    }

    /// C(ω) of one decision.
    fn cost(&self, settings: &Settings, communicated: Communicated) -> f32;

    /// Items in all.
    fn count(&self) -> usize {
        self.visual_items() + self.verbal_items()
    }
}

/// The highway's: six sectors to highlight, as far as the head-up display reaches, and six to speak about.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sectors;

impl Items for Sectors {
    fn visual_items(&self) -> usize {
        SECTORS
    }

    fn verbal_items(&self) -> usize {
        SECTORS
    }

    fn possible(&self) -> Communicated {
        let shown = (0..SECTORS).filter(|&sector| azimuths_shown(sector) > 0);
        Communicated::new(shown.fold(0, |bits, sector| bits | 1 << sector), 0x3f)
    }

    /// Sectors in which there is a car.
    fn held(&self, visual: &[f32]) -> Communicated {
        Communicated::new(
            modalities::highlightable(visual),
            modalities::occupied(visual),
        )
    }

    fn spoken_at_once(&self) -> u32 {
        1
    }

    fn cost(&self, settings: &Settings, communicated: Communicated) -> f32 {
        settings.cost(communicated)
    }
}

/// A gridworld's: what can be hidden can be shown, and what can be heard can be said.
impl Items for Arc<Layout> {
    fn visual_items(&self) -> usize {
        self.regions
    }

    fn verbal_items(&self) -> usize {
        self.utterances
    }

    fn possible(&self) -> Communicated {
        Communicated::items(self.communicable)
    }

    fn hears(&self) -> bool {
        self.heard != 0
    }

    /// All of them: a step of a gridworld is long.
    fn spoken_at_once(&self) -> u32 {
        self.utterances as u32
    }

    /// The domain's costs, quadratic in the number of items of each modality (paper, Table "Communication Modalities and
    /// Costs").
    fn cost(&self, _: &Settings, communicated: Communicated) -> f32 {
        Layout::cost(self, communicated.mask())
    }
}

/// A highway scene's planning settings as the planner takes them.
pub fn highway_settings_of(scene: &Scene) -> Settings {
    let (planning, communication) = (&scene.planning, &scene.communication);
    Settings {
        race: RaceSettings {
            steps: planning.race_steps as usize,
            first: planning.race_first as usize,
            futures: planning.race_futures as usize,
            certainty: planning.race_certainty as f32,
            budget: planning.budget as f32,
        },
        horizon: planning.horizon as usize,
        hold: planning.repeat as usize,
        samples: planning.samples as usize,
        futures: planning.futures as usize,
        iterations: planning.iterations as usize,
        elites: planning.elites as usize,
        smoothing: planning.smoothing as f32,
        first_probability: planning.first_probability as f32,
        warm_start: planning.warm_start as f32,
        discount: planning.discount as f32,
        reward_weight: planning.reward_weight as f32,
        visual_cost: communication.visual_cost as f32,
        verbal_cost: communication.verbal_cost as f32,
        visual_threshold: planning.visual_threshold as f32,
        verbal_threshold: planning.verbal_threshold as f32,
        ..Settings::default()
    }
}

/// A gridworld scene's planning settings as the planner takes them.
pub fn settings_of(planning: &Planning) -> Settings {
    Settings {
        race: RaceSettings {
            steps: planning.race_steps as usize,
            first: planning.race_first as usize,
            futures: planning.race_futures as usize,
            certainty: planning.race_certainty as f32,
            budget: planning.budget as f32,
        },
        horizon: planning.horizon as usize,
        hold: planning.repeat as usize,
        samples: planning.samples as usize,
        futures: planning.futures as usize,
        iterations: planning.iterations as usize,
        elites: planning.elites as usize,
        smoothing: planning.smoothing as f32,
        first_probability: planning.first_probability as f32,
        warm_start: planning.warm_start as f32,
        discount: planning.discount as f32,
        reward_weight: planning.reward_weight as f32,
        terminal_value: planning.terminal_value,
        visual_threshold: planning.visual_threshold as f32,
        verbal_threshold: planning.verbal_threshold as f32,
        ..Settings::default()
    }
}
