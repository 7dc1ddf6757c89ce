//! What the cockpit's page and the process say to each other, as JSON.

use messages::{EpisodeEnd, Presence};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

/// What the page says. Numbers of states and sentences are those that it was sent.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "t", rename_all = "lowercase", deny_unknown_fields)]
pub enum FromPage {
    /// The person is ready for this episode, or for going on with it.
    Ready {
        /// Episode.
        episode: u32,
    },
    /// The person has turned to something else.
    Away,
    /// What the person does; said whenever that changes, and ten times a second.
    Input {
        /// Throttle (positive) or brake (negative).
        throttle: f32,
        /// Steer, left positive.
        steer: f32,
        /// The newest state that was drawn.
        drawn: u64,
        /// How long ago it arrived, in milliseconds.
        held_ms: f64,
    },
    /// A gridworld's action.
    Choice {
        /// Which.
        choice: u32,
        /// The step that it is meant for.
        episode: u32,
        /// See `episode`.
        step: u32,
    },
    /// A sentence began to be heard so long after it arrived.
    Heard {
        /// Which.
        id: u64,
        /// In milliseconds.
        after_ms: f64,
    },
    /// A sentence could not be played.
    Unheard {
        /// Which.
        id: u64,
    },
    /// The display of this step was drawn for the first time so long after it arrived.
    Seen {
        /// Which.
        step: u32,
        /// In milliseconds.
        after_ms: f64,
    },
    /// Are you there?
    Ping {
        /// The page's clock.
        at: f64,
    },
}

/// What the page is told.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "t", rename_all = "lowercase")]
pub enum ToPage {
    /// The first word.
    Hello {
        /// The set's name.
        instance: String,
        /// The run.
        run: String,
        /// Episodes of the run.
        episodes: u32,
        /// When a round is void.
        void_after_s: f64,
        /// What the domain has.
        scene: Value,
    },
    /// This episode waits for the person.
    Round {
        /// Episode.
        episode: u32,
    },
    /// Where everybody is.
    Motion {
        /// Number of this state.
        n: u64,
        /// Episode.
        e: u32,
        /// Step.
        k: u32,
        /// The run's clock, in milliseconds.
        at: f64,
        /// The ego car: x, y, heading, speed.
        ego: [f64; 4],
        /// The others.
        cars: Vec<CarOnPage>,
    },
    /// A gridworld's step.
    Step {
        /// Episode.
        episode: u32,
        /// Step.
        step: u32,
        /// What the person sees of it.
        shown: Value,
    },
    /// What is highlighted.
    Display {
        /// Step.
        step: u32,
        /// Cars with a box around them.
        boxes: Vec<i32>,
        /// A bit per item.
        items: u32,
    },
    /// A sentence begins.
    Say {
        /// Its number.
        id: u64,
        /// Its words.
        text: String,
        /// What it is about.
        item: u32,
    },
    /// Whether somebody is at the wheel.
    Presence {
        /// Whether.
        #[serde(serialize_with = "presence_name")]
        presence: Presence,
    },
    /// An episode ended.
    End {
        /// Which.
        episode: u32,
        /// How.
        end: &'static str,
    },
    /// Another page has taken the wheel.
    Replaced,
    /// The run is over.
    Over,
    /// I am.
    Pong {
        /// As asked.
        at: f64,
    },
}

/// Identity, x, y, heading, speed, length, width, and whether it is tall.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CarOnPage(
    pub i32,
    pub f64,
    pub f64,
    pub f64,
    pub f64,
    pub f32,
    pub f32,
    pub bool,
);

impl ToPage {
    /// As it is sent.
    pub fn text(&self) -> String {
        // Plain numbers and text: there is nothing that JSON could not hold.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// What an end is called.
pub fn name_of(end: EpisodeEnd) -> &'static str {
    match end {
        EpisodeEnd::Running => "running",
        EpisodeEnd::Goal => "goal",
        EpisodeEnd::Collision => "collision",
        EpisodeEnd::OutOfTime => "time",
        EpisodeEnd::Voided => "voided",
    }
}

fn presence_name<S: Serializer>(presence: &Presence, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(match presence {
        Presence::Absent => "absent",
        Presence::Present => "present",
        Presence::GivenUp => "void",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_page_says_is_understood_or_nothing() {
        let read = |text: &str| serde_json::from_str::<FromPage>(text).ok();
        assert_eq!(
            read(r#"{"t":"input","throttle":1,"steer":-0.5,"drawn":7,"held_ms":3.5}"#),
            Some(FromPage::Input {
                throttle: 1.0,
                steer: -0.5,
                drawn: 7,
                held_ms: 3.5
            })
        );
        assert_eq!(read(r#"{"t":"away"}"#), Some(FromPage::Away));
        for text in [
            "",
            "{}",
            "[]",
            r#"{"t":"input"}"#,
            r#"{"t":"ready","episode":-1}"#,
            r#"{"t":"ready","episode":1,"more":1}"#,
            r#"{"t":"input","throttle":"1","steer":0,"drawn":0,"held_ms":0}"#,
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }

    #[test]
    fn what_a_page_is_told_has_a_name() {
        let text = ToPage::Presence {
            presence: Presence::GivenUp,
        };
        assert_eq!(text.text(), r#"{"t":"presence","presence":"void"}"#);
        assert_eq!(ToPage::Over.text(), r#"{"t":"over"}"#);
    }
}
