//! Draws a gridworld's picture for Foxglove's 3D panel: a box for every wall, a letter for everything else that stands
//! in a cell.

use crate::ros::{Colour, Marker, MarkerShape, MarkerStamp};
use messages::{Display, Picture};
use runtime::text_of;

const WALL: Colour = [0.35, 0.35, 0.35, 1.0];
const FLOOR: Colour = [0.8, 0.8, 0.8, 0.25];
const LETTER: Colour = [0.15, 0.45, 0.95, 1.0];
const WORDS: Colour = [0.2, 0.2, 0.2, 1.0];
const SAID: Colour = [1.0, 0.65, 0.0, 1.0];

/// A cell is a metre; the drawing's upper left cell lies at the origin, and rows go down the negative y axis. Below
/// stands what the letters mean, above what is said.
pub fn draw(picture: &Picture, display: &Display, stamp: MarkerStamp) -> Vec<Marker> {
    let mut markers = vec![Marker::new(stamp, "", 0, MarkerShape::DeleteAll)];
    let drawing = text_of(&picture.text);
    let (cells, legend) = match drawing.trim_end().rsplit_once('\n') {
        Some((cells, legend)) => (cells, legend),
        None => ("", drawing.as_str()),
    };
    let mut id = 0;
    for (row, line) in cells.lines().enumerate() {
        for (column, letter) in line
            .chars()
            .enumerate()
            .filter(|(_, letter)| *letter != ' ')
        {
            id += 1;
            let shape = match letter {
                '#' | '.' => MarkerShape::Cube,
                _ => MarkerShape::Text,
            };
            let mut marker = Marker::new(stamp, "cell", id, shape);
            marker.pose.position = [column as f64, -(row as f64), 0.0];
            (marker.scale, marker.colour) = match letter {
                '#' => ([1.0, 1.0, 0.5], WALL),
                '.' => ([0.9, 0.9, 0.02], FLOOR),
                _ => ([1.0, 1.0, 0.9], LETTER),
            };
            if !matches!(letter, '#' | '.') {
                marker.text = letter.to_string();
            }
            markers.push(marker);
        }
    }
    let mut write = |namespace, row: f64, words: &str, colour| {
        let mut marker = Marker::new(stamp, namespace, 0, MarkerShape::Text);
        marker.pose.position = [
            cells.lines().map(str::len).max().unwrap_or(0) as f64 / 2.0,
            row,
            0.0,
        ];
        marker.scale = [0.5, 0.5, 0.5];
        marker.text = words.to_owned();
        marker.colour = colour;
        markers.push(marker);
    };
    write(
        "legend",
        -(cells.lines().count() as f64 + 1.0),
        legend,
        WORDS,
    );
    let spoken = (display.utterance_count as usize).min(display.utterances.len());
    let said: Vec<_> = display.utterances[..spoken]
        .iter()
        .map(|said| text_of(&said.text))
        .collect();
    if !said.is_empty() {
        write("said", 2.0, &said.join("\n"), SAID);
    }
    markers
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Message;

    #[test]
    fn every_cell_is_drawn_where_it_stands() {
        let mut picture = Picture::ZERO;
        let words = b"#.#\nP V\nP person, V victim\n";
        picture.text[..words.len()].copy_from_slice(words);
        let mut display = Display::ZERO;
        display.utterance_count = 1;
        display.utterances[0].text[..4].copy_from_slice(b"Mind");
        let stamp = MarkerStamp {
            time_ns: 5,
            frame: "map",
        };
        let markers = draw(&picture, &display, stamp);
        let drawn: Vec<_> = markers
            .iter()
            .filter(|marker| marker.namespace == "cell")
            .map(|marker| (marker.pose.position, marker.text.as_str()))
            .collect();
        let at = |x: f64, y: f64| [x, y, 0.0];
        let first = [(at(0.0, 0.0), ""), (at(1.0, 0.0), ""), (at(2.0, 0.0), "")];
        assert_eq!(drawn[..3], first);
        assert_eq!(drawn[3..], [(at(0.0, -1.0), "P"), (at(2.0, -1.0), "V")]);
        let texts: Vec<_> = markers.iter().map(|marker| marker.text.as_str()).collect();
        assert!(texts.contains(&"P person, V victim") && texts.contains(&"Mind"));
    }
}
