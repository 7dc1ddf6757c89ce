//! Writes what a person at the terminal should notice of a drive on the highway, one line per event.

use crate::content::RendererOptions;
use crate::lines::{CYAN, EventLines, RED, YELLOW, text_of};
use crate::render::Tell;
use domains::highway::LIDAR_RANGE_M;
use domains::highway::speech::{SECTOR_AZIMUTHS, SECTOR_NAMES};
use messages::{
    AZIMUTHS, Display, HEIGHT_BANDS, LidarFrame, Outcome, SECTORS, Utterance, UtteranceContent,
};
use std::io::{self, Write};

/// Seconds for which a sector must have been dark before its next highlight is an event again.
const DARK_S: f32 = 1.5;

/// The lines, written to `out`; its errors are left to `out`, because a closed terminal must not stop a run.
pub struct Events<W> {
    lines: EventLines<W>,
    dark_steps: u32,
    /// Step at which each sector was last highlighted in this episode.
    lit: [Option<u32>; SECTORS],
}

impl<W: Write> Events<W> {
    /// Writes to `out`, with colours if it is a terminal.
    pub fn new(out: W, colours: bool, options: &RendererOptions) -> Self {
        Self {
            lines: EventLines::new(out, colours, options.step_s),
            dark_steps: (DARK_S / options.step_s).ceil() as u32,
            lit: [None; SECTORS],
        }
    }

    fn enter(&mut self, episode: u32) -> io::Result<()> {
        if self.lines.enter(episode)? {
            self.lit = [None; SECTORS];
        }
        Ok(())
    }

    fn say(&mut self, step: u32, utterance: &Utterance) -> io::Result<()> {
        let text = text_of(utterance);
        let sector = SECTOR_NAMES.get(utterance.item as usize).unwrap_or(&"?");
        let (range_m, speed_mps) = (utterance.range_m, utterance.speed_mps);
        match utterance.content() {
            Ok(UtteranceContent::Notice) => self.lines.notice(step, utterance),
            Ok(UtteranceContent::Nothing) => {
                self.lines
                    .line(step, CYAN, "SAY", format_args!("“{text}”  {sector}"))
            }
            _ => self.lines.line(
                step,
                CYAN,
                "SAY",
                format_args!("“{text}”  {sector} {range_m:.0} m {speed_mps:.1} m/s"),
            ),
        }
    }

    fn show(&mut self, step: u32, sectors: u32, frame: &LidarFrame) -> io::Result<()> {
        let mut what = String::new();
        for sector in (0..SECTORS).filter(|sector| sectors >> sector & 1 == 1) {
            let comma = if what.is_empty() { "" } else { ", " };
            what += comma;
            what += SECTOR_NAMES[sector];
            match nearest_in(frame, sector) {
                Some((range_m, speed_mps)) => {
                    what += &format!(" {range_m:.0} m {speed_mps:.1} m/s")
                }
                None => what += " (no car)",
            }
        }
        self.lines
            .line(step, YELLOW, "SHOW", format_args!("{what}"))
    }
}

impl<W: Write> Tell for Events<W> {
    type Sensed = LidarFrame;

    fn display(&mut self, display: &Display, frame: &LidarFrame) -> io::Result<()> {
        let (episode, step) = (frame.header.episode, frame.header.step);
        self.enter(episode)?;
        let spoken = (display.utterance_count as usize).min(display.utterances.len());
        for utterance in &display.utterances[..spoken] {
            self.say(step, utterance)?;
        }
        let mut news = 0;
        for sector in (0..SECTORS).filter(|sector| display.highlighted >> sector & 1 == 1) {
            let dark =
                self.lit[sector].is_none_or(|lit| step.saturating_sub(lit) > self.dark_steps);
            news |= u32::from(dark) << sector;
            self.lit[sector] = Some(step);
        }
        if news != 0 {
            self.show(step, news, frame)
        } else {
            Ok(())
        }
    }

    fn outcome(&mut self, outcome: &Outcome) -> io::Result<()> {
        self.enter(outcome.header.episode)?;
        let step = outcome.header.step;
        if outcome.collided != 0 {
            match outcome.other {
                -2 => self
                    .lines
                    .line(step, RED, "CRASH", format_args!("left the road"))?,
                car => self
                    .lines
                    .line(step, RED, "CRASH", format_args!("hit car {car}"))?,
            }
        }
        self.lines.end(outcome, "goal reached")
    }
}

/// Range in metres and speed of the nearest car in `sector`, if there is one in range.
fn nearest_in(frame: &LidarFrame, sector: usize) -> Option<(f32, f32)> {
    let (first, last) = SECTOR_AZIMUTHS[sector];
    let range = |azimuth: usize| {
        let bands = (0..HEIGHT_BANDS).map(|band| frame.range[band * AZIMUTHS + azimuth]);
        bands.fold(1.0, f32::min)
    };
    let seen = (first..=last).filter(|azimuth| range(*azimuth) < 1.0);
    let nearest = seen.min_by(|a, b| range(*a).total_cmp(&range(*b)))?;
    Some((range(nearest) * LIDAR_RANGE_M, frame.speed_mps[nearest]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::Renderer;
    use crate::render::Render;
    use messages::{CommAction, Message};

    fn frame(step: u32) -> LidarFrame {
        let mut frame = LidarFrame::ZERO;
        frame.header.step = step;
        frame.range = [1.0; messages::BEAMS];
        frame.object = [-1; messages::AZIMUTHS];
        for azimuth in [0, 18] {
            frame.range[azimuth] = 23.0 / 40.0;
            frame.object[azimuth] = azimuth as i32;
            frame.speed_mps[azimuth] = 18.2;
        }
        frame
    }

    fn lines(write: impl FnOnce(&mut Events<&mut Vec<u8>>)) -> Vec<String> {
        let mut out = Vec::new();
        write(&mut Events::new(
            &mut out,
            false,
            &RendererOptions::default(),
        ));
        String::from_utf8_lossy(&out)
            .lines()
            .map(str::to_owned)
            .collect()
    }

    #[test]
    fn a_highlight_that_stays_is_one_line_and_so_is_an_utterance() {
        let mut renderer = Renderer::new(&RendererOptions::default());
        let mut decision = CommAction::ZERO;
        decision.visual = 1;
        decision.verbal = 1 << 3;
        let lines = lines(|events| {
            for step in 80..100 {
                let mut display = Display::ZERO;
                decision.header.step = step;
                renderer.render(&frame(step), Some(&decision), &mut display);
                let _ = events.display(&display, &frame(step));
            }
        });
        assert_eq!(lines.len(), 3, "{lines:#?}");
        assert_eq!(lines[0], "   0.00 s  START  episode 0");
        assert!(
            lines[1].starts_with("  12.00 s  SAY    “Fast car "),
            "{}",
            lines[1]
        );
        assert!(lines[1].ends_with("”  rear 23 m 18.2 m/s"), "{}", lines[1]);
        assert_eq!(lines[2], "  12.00 s  SHOW   front 23 m 18.2 m/s");
    }

    #[test]
    fn a_highlight_after_a_dark_while_is_news_again() {
        let mut display = Display::ZERO;
        display.highlighted = 1;
        let lines = lines(|events| {
            for step in [1, 3, 5, 40] {
                let _ = events.display(&display, &frame(step));
            }
        });
        let shown: Vec<_> = lines.iter().filter(|line| line.contains("SHOW")).collect();
        assert_eq!(shown.len(), 2, "{lines:#?}");
    }

    #[test]
    fn collisions_and_ends_are_told() {
        let mut outcome = Outcome::ZERO;
        outcome.header.step = 20;
        (outcome.collided, outcome.other) = (1, 4);
        outcome.end = messages::EpisodeEnd::Collision.wire();
        let lines = lines(|events| drop(events.outcome(&outcome)));
        assert_eq!(
            lines[1..],
            [
                "   3.00 s  CRASH  hit car 4",
                "   3.00 s  END    episode 0: ended by a collision"
            ]
        );
    }
}
