//! What can be communicated at one moment, and what that costs: the planner's view of a domain's communication channels.

use crate::planner::Settings;
use models::Communicated;
use models::observation::{SECTORS, azimuths_shown};

/// The items of a domain: `visual_items()` things that can be shown, `verbal_items()` that can be said.
pub trait Items {
    /// Visual items.
    fn visual_items(&self) -> usize;

    /// Verbal items.
    fn verbal_items(&self) -> usize;

    /// What the channels can carry at all: a display does not reach everywhere.
    fn possible(&self) -> Communicated;

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

    fn spoken_at_once(&self) -> u32 {
        1
    }

    fn cost(&self, settings: &Settings, communicated: Communicated) -> f32 {
        settings.cost(communicated)
    }
}
