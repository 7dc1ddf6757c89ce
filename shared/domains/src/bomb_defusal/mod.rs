//! Bomb defusal (paper, Experiments and Appendix): three stages, a button for each, and rules that the person knows
//! better than the robot.
//!
//! Six terminals lie side by side in two rows, drawn as glyphs; one of them is live. Rules map (bomb type, live terminal) to the
//! right button. A right press leads to the next stage, a wrong one leaves the stage; after either all terminals change.
//! Visual: the image (1 × 11 × 17: terminals of 5 × 5 pixels, a pixel apart), then the stage as three numbers, one of them 1,
//! and the time left over the time allowed. Verbal: the vector of what is said of the bomb's type. Actions: press button 0, 1, 2, or
//! wait.

mod defuser;
mod glyph;
mod perception;
mod person;
mod scene;
mod world;

pub use defuser::Defuser;
pub use glyph::{GLYPHS, LIVE, read_terminal};
pub use person::Person;
pub use scene::{Reward, Rules, Scene, Table};
pub use world::World;

use crate::{ActionSpace, Image, Layout, Mask, QuadraticCosts};

/// The domain's name.
pub const NAME: &str = "bomb_defusal";

/// Terminals.
pub const TERMINALS: usize = 6;
/// Buttons.
pub const BUTTONS: usize = 3;
/// Stages.
pub const STAGES: usize = 3;
/// Types of bombs.
pub const TYPES: usize = 2;
/// Action: press nothing.
pub const WAIT: usize = BUTTONS;
/// Rows and columns of a terminal's picture.
pub const TERMINAL_SIZE: usize = 5;
/// Rows of the image: two terminals and a pixel between.
pub const HEIGHT: usize = 2 * TERMINAL_SIZE + 1;
/// Columns of the image: three terminals and a pixel between each.
pub const WIDTH: usize = 3 * TERMINAL_SIZE + 2;
/// Numbers of the image.
pub const IMAGE: usize = HEIGHT * WIDTH;
/// Numbers of the visual modality.
pub const VISUAL: usize = IMAGE + STAGES + 1;

/// What can be said: the type of the bomb.
pub const SENTENCES: [&str; TYPES] = ["Type A bomb.", "Type B bomb."];

/// Index, within the image, of a terminal's upper left pixel.
pub(crate) const fn corner_of(terminal: usize) -> usize {
    let (row, column) = (terminal / 3, terminal % 3);
    row * (TERMINAL_SIZE + 1) * WIDTH + column * (TERMINAL_SIZE + 1)
}

/// The stage of a visual modality, sensed or imagined.
pub fn stage_in(visual: &[f32]) -> usize {
    let stage = |s: &usize| visual[IMAGE + s];
    (0..STAGES)
        .max_by(|a, b| stage(a).total_cmp(&stage(b)))
        .unwrap_or(0)
}

/// The layout of a scene whose utterance has `width` numbers.
pub(crate) fn layout(scene: &Scene, width: usize) -> Layout {
    let mut visual_region = vec![None; VISUAL];
    for terminal in 0..TERMINALS {
        for pixel in 0..TERMINAL_SIZE * TERMINAL_SIZE {
            let (row, column) = (pixel / TERMINAL_SIZE, pixel % TERMINAL_SIZE);
            visual_region[corner_of(terminal) + row * WIDTH + column] = Some(terminal as u8);
        }
    }
    Layout {
        domain: NAME,
        number: 3,
        visual: VISUAL,
        verbal: width,
        actions: ActionSpace::Discrete(BUTTONS + 1),
        image: Some(Image {
            channels: 1,
            height: HEIGHT,
            width: WIDTH,
            // As in search and rescue, a window is as large as what there is to be recognised: a terminal.
            kernel: TERMINAL_SIZE,
            stride: 2,
        }),
        visual_region,
        verbal_utterance: vec![0; width],
        told_regions: vec![0],
        regions: TERMINALS,
        utterances: 1,
        perception: &perception::ChanceOfNoticing,
        sensed: Mask {
            visual: (1 << TERMINALS) - 1,
            verbal: (1 << 1) - 1,
        },
        heard: 0,
        communicable: Mask {
            visual: 0x3f,
            verbal: 1,
        },
        costs: Some(QuadraticCosts {
            visual: scene.communication.visual_cost as f32,
            verbal: scene.communication.verbal_cost as f32,
        }),
        action_names: &["button 1", "button 2", "button 3", "wait"],
        region_names: &[
            "terminal 1",
            "terminal 2",
            "terminal 3",
            "terminal 4",
            "terminal 5",
            "terminal 6",
        ],
        utterance_names: &["type of the bomb"],
        terms: &["right", "wrong", "time"],
        success: "the bomb is defused",
        accident: "ran into an obstacle",
    }
}
