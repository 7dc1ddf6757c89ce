//! Pictures of terminals: five dead ones and the live one, and how a picture is read.

use super::{TERMINAL_SIZE, WIDTH, corner_of};

/// Pixels of a terminal.
const PIXELS: usize = TERMINAL_SIZE * TERMINAL_SIZE;
/// Brightness of a terminal where nothing is drawn. Not 0: that is what is hidden.
const PLATE: f32 = 0.3;
/// Brightness of what is drawn.
const DRAWN: f32 = 1.0;
/// Which of [`GLYPHS`] is the live terminal.
pub const LIVE: usize = 0;

/// What terminals show, row after row; the first is live.
pub const GLYPHS: [&[u8; PIXELS]; 6] = [
    b"..#...###.##.##.###...#..",
    b"#####.....#####.....#####",
    b"#.#.##.#.##.#.##.#.##.#.#",
    b"#...#.#.#...#...#.#.#...#",
    b"######...##...##...######",
    b"....#...##..###.#########",
];

/// Draws a glyph into a terminal of an image.
pub(super) fn draw(image: &mut [f32], terminal: usize, glyph: usize) {
    for (pixel, mark) in GLYPHS[glyph].iter().enumerate() {
        let (row, column) = (pixel / TERMINAL_SIZE, pixel % TERMINAL_SIZE);
        let value = if *mark == b'#' { DRAWN } else { PLATE };
        image[corner_of(terminal) + row * WIDTH + column] = value;
    }
}

/// Which glyph a terminal of an image, sensed or imagined, looks most like.
pub fn read_terminal(image: &[f32], terminal: usize) -> usize {
    let distance = |glyph: usize| -> f32 {
        let pixels = GLYPHS[glyph].iter().enumerate();
        pixels
            .map(|(pixel, mark)| {
                let (row, column) = (pixel / TERMINAL_SIZE, pixel % TERMINAL_SIZE);
                let value = if *mark == b'#' { DRAWN } else { PLATE };
                let seen = image[corner_of(terminal) + row * WIDTH + column];
                (seen - value) * (seen - value)
            })
            .sum()
    };
    (0..GLYPHS.len())
        .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
        .unwrap_or(LIVE)
}
