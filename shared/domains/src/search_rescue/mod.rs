//! Search and rescue (paper, Experiments and Appendix): find the victim in a burning house and bring them back to the
//! entrance.
//!
//! The map has 9 × 9 cells, a pixel each, in 3 × 3 portions of 3 × 3 cells: the window of the paper's convolution (kernel 3,
//! stride 3) is a portion. Visual: the image (3 colours × 9 × 9), then row and column of the person within [−1, 1] and 1 once
//! the victim is found. Verbal: an utterance's vector for each of five subjects. Actions: up, down, left, right.

mod map;
mod perception;
mod person;
mod scene;
mod searcher;
mod world;

pub use map::{Cell, Cells, Obstacle, distances, neighbour, step_towards};
pub use person::{
    Person, SUBGOALS, Transitions, count_transitions, is_transition, subgoal_at, subgoal_cell,
};
pub use scene::{Reward, Scene, Smoke};
pub use searcher::Searcher;
pub use world::World;

use crate::discrete::Setting;
use crate::{ActionSpace, Image, Layout, Mask, QuadraticCosts};

/// The domain's name.
pub const NAME: &str = "search_rescue";

/// Rows and columns of the map.
pub const SIZE: usize = 9;
/// Cells of the map.
pub const CELLS: usize = SIZE * SIZE;
/// Portions of the map that can be hidden or shown.
pub const PORTIONS: usize = 9;
/// Numbers of the image.
pub const IMAGE: usize = 3 * CELLS;
/// Numbers of the visual modality.
pub const VISUAL: usize = IMAGE + 3;
/// Places where the victim may be.
pub const PLACES: usize = 3;
/// Corridors, of which one may be blocked.
pub const CORRIDORS: usize = 2;
/// Subjects of utterances: the places, then the corridors.
pub const UTTERANCES: usize = PLACES + CORRIDORS;

/// What can be said: of each subject, first that it is empty or free, then that the victim is there or that it is blocked.
pub const SENTENCES: [&str; 2 * UTTERANCES] = [
    "There is no victim in the top right.",
    "Victim in the top right.",
    "There is no victim in the middle right.",
    "Victim in the middle right.",
    "There is no victim in the bottom right.",
    "Victim in the bottom right.",
    "The top corridor is free.",
    "The top corridor is blocked.",
    "The bottom corridor is free.",
    "The bottom corridor is blocked.",
];

/// The portion that a cell lies in.
pub fn portion_of(cell: Cell) -> usize {
    cell.row() / 3 * 3 + cell.column() / 3
}

/// The cell in the middle of a portion.
pub fn centre_of(portion: usize) -> Cell {
    Cell::new(portion / 3 * 3 + 1, portion % 3 * 3 + 1)
}

/// Where the person is, of a visual modality, sensed or imagined.
pub fn position_in(visual: &[f32]) -> Cell {
    let index = |x: f32| ((x * 4.0 + 4.0).round()).clamp(0.0, (SIZE - 1) as f32) as usize;
    Cell::new(index(visual[IMAGE]), index(visual[IMAGE + 1]))
}

/// Which portions are seen, a bit each: those whose centre is within `radius` cells of the person.
pub fn visible(radius: f32, visual: &[f32]) -> u64 {
    let (row, column) = (visual[IMAGE] * 4.0 + 4.0, visual[IMAGE + 1] * 4.0 + 4.0);
    (0..PORTIONS).fold(0, |bits, portion| {
        let centre = centre_of(portion);
        let away = (row - centre.row() as f32).hypot(column - centre.column() as f32);
        bits | u64::from(away <= radius) << portion
    })
}

/// Utterances that people hear without an assistant, a bit each: in clear air, all.
pub(crate) fn heard(setting: Setting) -> u32 {
    match setting {
        Setting::Original => (1 << UTTERANCES) - 1,
        Setting::Transfer => 0,
    }
}

/// The layout of a scene whose utterances have `width` numbers each.
pub(crate) fn layout(scene: &Scene, width: usize) -> Layout {
    let mut visual_region: Vec<Option<u8>> = (0..IMAGE)
        .map(|i| Cell::from_index(i % CELLS))
        .map(|cell| Some(portion_of(cell) as u8))
        .collect();
    visual_region.extend([None; 3]);
    Layout {
        domain: NAME,
        number: 2,
        visual: VISUAL,
        verbal: UTTERANCES * width,
        actions: ActionSpace::Discrete(4),
        image: Some(Image {
            channels: 3,
            height: SIZE,
            width: SIZE,
            kernel: 3,
            stride: 3,
        }),
        visual_region,
        verbal_utterance: (0..UTTERANCES * width).map(|i| (i / width) as u8).collect(),
        told_regions: (Cell::PLACES.into_iter().chain(Cell::CORRIDORS))
            .map(|cell| 1 << portion_of(cell))
            .collect(),
        regions: PORTIONS,
        utterances: UTTERANCES,
        perception: &perception::CellsToPortions,
        sensed: Mask {
            visual: (1 << PORTIONS) - 1,
            verbal: (1 << UTTERANCES) - 1,
        },
        heard: heard(scene.setting),
        communicable: Mask {
            visual: 0x1ff,
            verbal: 0x1f,
        },
        costs: Some(QuadraticCosts {
            visual: scene.communication.visual_cost as f32,
            verbal: scene.communication.verbal_cost as f32,
        }),
        action_names: &["up", "down", "left", "right"],
        region_names: &[
            "top left",
            "top",
            "top right",
            "left",
            "middle",
            "right",
            "bottom left",
            "bottom",
            "bottom right",
        ],
        utterance_names: &[
            "top right place",
            "middle right place",
            "bottom right place",
            "top corridor",
            "bottom corridor",
        ],
        terms: &["found", "rescued", "obstacle", "time"],
        success: "the victim is rescued",
        accident: "ran into an obstacle",
    }
}
