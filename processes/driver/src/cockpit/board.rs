//! A gridworld as the cockpit's page is shown it: what the person can see of it, and what is pointed out.

use super::Table;
use super::page::ToPage;
use crate::GridworldSeat;
use anyhow::Result;
use domains::bomb_defusal::{GLYPHS, LIVE};
use domains::discrete::{Discrete, Mind, Scene as Place, SimulatedPerson, World};
use domains::{Layout, Mask};
use messages::{Display, Observation, Scene};
use serde_json::{Value, json};

/// A gridworld. How far one sees is the scene's and the stand-in's: a simulated person's eyes in place of one's own.
pub struct Board {
    layout: Layout,
    place: Place,
    eyes: SimulatedPerson,
    seed: u64,
    seen: Mask,
    highlighted: u64,
    visual: Vec<f32>,
    legal: u32,
}

impl Board {
    /// The seat's world.
    ///
    /// # Errors
    /// Names the person that there is not, or the file and the place in it.
    pub fn new(seat: &GridworldSeat, seed: u64) -> Result<Self> {
        let world = World::new(&seat.scene, &models::words::shipped(seat.scene.domain())?)?;
        let layout = world.layout().clone();
        Ok(Self {
            place: seat.scene.clone(),
            eyes: seat.simulated()?,
            seed,
            seen: Mask::NONE,
            highlighted: 0,
            visual: vec![0.0; layout.visual],
            legal: 0,
            layout,
        })
    }
}

/// What the person has to know: how the live terminal looks, and for each type of bomb the button for each place of it.
fn rules(place: &Place) -> Option<Value> {
    let Place::BombDefusal(scene) = place else {
        return None;
    };
    let pixels = GLYPHS[LIVE].iter().map(|pixel| u8::from(*pixel == b'#'));
    Some(json!({
        "live": pixels.collect::<Vec<u8>>(),
        "buttons": scene.rules.in_force(scene.setting),
    }))
}

impl Table for Board {
    type Sensed = Observation;

    fn measure(&self) -> [u32; 3] {
        let layout = &self.layout;
        [layout.number, layout.visual as u32, layout.verbal as u32]
    }

    fn scene(&self) -> Value {
        let layout = &self.layout;
        json!({
            "domain": layout.domain,
            "name": self.place.name(),
            "actions": layout.action_names,
            "regions": layout.region_names,
            "image": layout.image.map(|image| [image.channels, image.height, image.width]),
            "goal": layout.success,
            "accident": layout.accident,
            "rules": rules(&self.place),
        })
    }

    fn holds_input(&self) -> bool {
        false
    }

    fn reset(&mut self, episode: u32) {
        self.eyes.reset(self.seed, episode);
        (self.seen, self.highlighted) = (Mask::NONE, 0);
    }

    fn sense(&mut self, sensed: &Observation) {
        self.visual.copy_from_slice(sensed.visual());
        self.legal = sensed.legal;
        self.seen = self.eyes.look(&self.visual);
        self.highlighted = 0;
    }

    fn see(&mut self, display: &Display) {
        self.highlighted = display.highlighted.into();
    }

    fn shown(&self) -> Option<Value> {
        let seen = self.seen.visual | self.highlighted;
        let regions = self.layout.visual_region.iter();
        let visual: Vec<Option<f32>> = self
            .visual
            .iter()
            .zip(regions)
            .map(|(value, region)| {
                // What no region governs is always seen.
                let is_seen = region.is_none_or(|region| seen >> region & 1 == 1);
                is_seen.then_some((value * 1e3).round() / 1e3)
            })
            .collect();
        Some(json!({
            "visual": visual,
            "seen": seen,
            "highlighted": self.highlighted,
            "legal": self.legal,
        }))
    }

    fn motion(&mut self, _: &Scene, _: u64) -> Option<ToPage> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::discrete::{Acting, Scene};
    use messages::Message;

    #[test]
    fn what_the_smoke_hides_is_not_sent() {
        let scene = Scene::builtin("search-smoke").unwrap();
        let words = models::words::shipped(scene.domain()).unwrap();
        let mut world = World::new(&scene, &words).unwrap();
        world.reset(1, 0, 0);
        let person = Acting::Shipped(1);
        let mut board = Board::new(&GridworldSeat { scene, person }, 1).unwrap();
        board.reset(0);
        let mut sensed = Observation::ZERO;
        let (visual, verbal) = (board.layout.visual, board.layout.verbal);
        (sensed.visual_len, sensed.verbal_len) = (visual as u32, verbal as u32);
        world.observe(&mut sensed.visual[..visual], &mut sensed.verbal[..verbal]);
        board.sense(&sensed);
        let hidden = |board: &Board| {
            let shown = board.shown().unwrap();
            let numbers = shown["visual"].as_array().unwrap();
            numbers.iter().filter(|number| number.is_null()).count()
        };
        let before = hidden(&board);
        assert!(before >= 3 * 9, "{before}");
        let mut display = Display::ZERO;
        display.highlighted = (1 << 9) - 1;
        board.see(&display);
        assert_eq!(hidden(&board), 0, "what is shown is seen");
        board.sense(&sensed);
        assert_eq!(hidden(&board), before, "and no longer than it is shown");
    }
}
