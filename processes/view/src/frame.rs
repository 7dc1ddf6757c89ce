//! A frame: what the messages of a step say together.

use crate::decode::Decoder;
use messages::{
    BEAMS, CommAction, Display, DriverAction, Header, HumanBelief, LidarFrame, ObjectKind,
    ObjectPose, Observation, Outcome, RobotBelief, Scene,
};
use recorder::topics::Recorded;
use runtime::text_of;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Reach of the LIDAR in metres.
const REACH_M: f32 = 40.0;

/// What was said at a step, as far as it was heard of.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Episode and step.
    position: (u32, u32),
    fields: Map<String, Value>,
    /// Processes that spoke: name, nanoseconds of computing, and nanoseconds since the step was sensed.
    times: Vec<(&'static str, u64, u64)>,
}

impl Frame {
    /// Episode and step.
    pub fn position(&self) -> (u32, u32) {
        self.position
    }

    /// As the page takes it; with what the processes say of themselves.
    pub fn json(&self, reports: &Value) -> String {
        let mut fields = self.fields.clone();
        fields.insert("t".to_owned(), json!("frame"));
        fields.insert("e".to_owned(), json!(self.position.0));
        fields.insert("k".to_owned(), json!(self.position.1));
        let times = self
            .times
            .iter()
            .map(|(name, compute_ns, since_ns)| json!([name, compute_ns / 1000, since_ns / 1000]));
        fields.insert("times".to_owned(), times.collect());
        if !reports.is_null() {
            fields.insert("reports".to_owned(), reports.clone());
        }
        Value::Object(fields).to_string()
    }

    fn set(&mut self, name: &str, value: Value) {
        self.fields.insert(name.to_owned(), value);
    }

    fn time(&mut self, name: &'static str, header: &Header) {
        let since_ns = header.sent_ns.saturating_sub(header.cause_ns);
        self.times.retain(|(known, ..)| *known != name);
        self.times.push((name, header.compute_ns, since_ns));
    }
}

/// Makes frames of messages, which come topic by topic. In lockstep the world is a step ahead of human model and planner,
/// so that a frame is filled until the world has gone on twice and all that waited has been taken in.
pub struct Frames {
    decoder: Decoder,
    filling: BTreeMap<(u32, u32), Frame>,
    /// The newest step that the world has begun.
    newest: Option<(u32, u32)>,
    /// The one before.
    before: Option<(u32, u32)>,
    /// Up to here, frames have been handed out: what comes later about them is in the recording.
    settled: Option<(u32, u32)>,
}

impl Frames {
    /// No message yet.
    pub fn new(decoder: Decoder) -> Self {
        Self {
            decoder,
            filling: BTreeMap::new(),
            newest: None,
            before: None,
            settled: None,
        }
    }

    /// The newest step, as far as it was heard of.
    pub fn current(&self) -> Option<&Frame> {
        self.filling.get(&self.newest?)
    }

    /// The step before, which is complete or soon will be.
    pub fn before(&self) -> Option<&Frame> {
        self.filling.get(&self.before?)
    }

    /// Adds something to the frame of a step, if it is there.
    pub fn add(&mut self, position: (u32, u32), name: &str, value: Value) {
        if let Some(frame) = self.filling.get_mut(&position) {
            frame.set(name, value);
        }
    }

    /// Takes in a message.
    pub fn take(&mut self, message: &Recorded) {
        let header = message.header();
        let position = (header.episode, header.step);
        match message {
            Recorded::Control(_) | Recorded::Report(_) => return,
            Recorded::Outcome(_)
            | Recorded::Scene(_)
            | Recorded::Picture(_)
            | Recorded::LidarFrame(_)
            | Recorded::Observation(_)
                if self.newest < Some(position) =>
            {
                self.before = self.newest.replace(position);
            }
            _ => {}
        }
        // Decisions come a step early, and nobody sends anything that is farther ahead.
        let is_near = self
            .newest
            .is_some_and(|(episode, step)| position <= (episode, step.saturating_add(1)));
        if self.settled >= Some(position) || !is_near {
            return;
        }
        let frame = self.filling.entry(position).or_insert_with(|| Frame {
            position,
            ..Frame::default()
        });
        write(frame, message, &mut self.decoder);
    }

    /// The frames of steps that are over, once all that waited has been taken in.
    pub fn settle(&mut self) -> Vec<Frame> {
        let Some(before) = self.before else {
            return Vec::new();
        };
        let rest = self.filling.split_off(&before);
        let settled: Vec<Frame> = std::mem::replace(&mut self.filling, rest)
            .into_values()
            .collect();
        self.settled = self.settled.max(settled.last().map(Frame::position));
        settled
    }

    /// All frames, at the end of a recording.
    pub fn finish(mut self) -> Vec<Frame> {
        std::mem::take(&mut self.filling).into_values().collect()
    }
}

fn write(frame: &mut Frame, message: &Recorded, decoder: &mut Decoder) {
    match message {
        Recorded::Scene(scene) => frame.set("scene", of_scene(scene)),
        Recorded::Picture(picture) => frame.set("picture", json!(text_of(&picture.text))),
        Recorded::LidarFrame(lidar) => {
            frame.time("world", &lidar.header);
            frame.set("at", json!(lidar.header.cause_ns as f64 * 1e-6));
            frame.set("lidar", of_lidar(lidar));
        }
        Recorded::Observation(sensed) => {
            frame.time("world", &sensed.header);
            frame.set("at", json!(sensed.header.cause_ns as f64 * 1e-6));
            frame.set("sensed", of_observation(sensed));
        }
        Recorded::Outcome(outcome) => frame.set("outcome", of_outcome(outcome)),
        Recorded::RobotBelief(belief) => {
            frame.time("belief", &belief.header);
            frame.set("robot", of_robot(belief));
        }
        Recorded::HumanBelief(belief) => {
            frame.time("human", &belief.header);
            frame.set("human", of_human(belief, decoder));
        }
        Recorded::CommAction(decision) => {
            frame.time("planner", &decision.header);
            frame.set("decision", of_decision(decision));
        }
        Recorded::Display(display) => {
            frame.time("renderer", &display.header);
            frame.set("display", of_display(display));
        }
        Recorded::DriverAction(action) => {
            frame.time("driver", &action.header);
            frame.set("action", of_action(action));
        }
        Recorded::Cockpit(cockpit) => frame.set(
            "cockpit",
            json!({
                "presence": cockpit.presence,
                "input_age_ms": cockpit.input_age_ns as f64 * 1e-6,
                "round_trip_ms": cockpit.round_trip_ns as f64 * 1e-6,
                "pages": cockpit.pages,
            }),
        ),
        Recorded::Control(_) | Recorded::Report(_) => {}
    }
}

fn pose(pose: &ObjectPose) -> Value {
    json!([
        pose.id,
        round(pose.x_m, 3),
        round(pose.y_m, 3),
        round(pose.heading_rad.into(), 4),
        round(pose.speed_mps.into(), 2),
        round(pose.length_m.into(), 2),
        round(pose.width_m.into(), 2),
        u32::from(pose.kind == ObjectKind::Other.wire()),
    ])
}

fn of_scene(scene: &Scene) -> Value {
    let cars = scene.objects.iter().take(scene.count as usize);
    json!({ "ego": pose(&scene.ego), "cars": cars.map(pose).collect::<Vec<_>>() })
}

fn of_lidar(lidar: &LidarFrame) -> Value {
    json!({
        "range": ranges(&lidar.range),
        "object": lidar.object.as_slice(),
        "speed": numbers(&lidar.speed_mps, 1),
        "ego": numbers(&lidar.ego, 3),
    })
}

fn of_observation(sensed: &Observation) -> Value {
    json!({ "visual": numbers(sensed.visual(), 3), "legal": sensed.legal })
}

fn of_outcome(outcome: &Outcome) -> Value {
    json!({
        "reward": round(outcome.reward.into(), 3),
        "collided": outcome.collided,
        "end": outcome.end,
        "other": outcome.other,
    })
}

/// A decoded visual modality: on the highway ranges in metres and the ego's values.
fn believed(visual: &[f32]) -> Value {
    match visual.get(..BEAMS).filter(|_| visual.len() == BEAMS + 5) {
        Some(range) => json!({ "range": ranges(range), "ego": numbers(&visual[BEAMS..], 3) }),
        None => json!({ "visual": numbers(visual, 3) }),
    }
}

fn of_robot(belief: &RobotBelief) -> Value {
    let used = belief.visual.len().min(belief.visual_len as usize);
    let latent = belief.deviation.len().min(belief.latent as usize);
    let mut out = believed(&belief.visual[..used]);
    out["surprise"] = json!(round(belief.surprise.into(), 4));
    out["deviation"] = json!(mean(&belief.deviation[..latent]));
    out
}

fn of_human(belief: &HumanBelief, decoder: &mut Decoder) -> Value {
    let mut out = match decoder.decode(belief) {
        Some(visual) => believed(visual),
        None => json!({}),
    };
    let latent = belief.deviation.len().min(belief.latent as usize);
    out["deviation"] = json!(mean(&belief.deviation[..latent]));
    out["kind"] = json!(text_of(&belief.kind));
    out["action"] = numbers(&belief.action_mean, 3);
    out["action_deviation"] = numbers(&belief.action_deviation, 3);
    out["probability"] = numbers(&belief.probability, 3);
    out["log_likelihood"] = json!(round(belief.log_likelihood.into(), 3));
    out
}

fn of_decision(decision: &CommAction) -> Value {
    let mut told = json!({
        "visual": decision.visual,
        "verbal": decision.verbal,
        "visual_probability": numbers(&decision.visual_probability, 3),
        "verbal_probability": numbers(&decision.verbal_probability, 3),
        "value": round(decision.value.into(), 3),
        "value_silent": round(decision.value_silent.into(), 3),
        "cost": round(decision.cost.into(), 3),
        "reason": decision.reason,
        "samples": decision.samples,
        "iterations": decision.iterations,
    });
    // Only the race compares now with later.
    if decision.gain_now != 0.0 || decision.gain_later != 0.0 {
        told["gain_now"] = round(decision.gain_now.into(), 3).into();
        told["gain_later"] = round(decision.gain_later.into(), 3).into();
        told["futures"] = decision.futures.into();
    }
    told
}

fn of_display(display: &Display) -> Value {
    let said = display.utterances.iter();
    let said = said.take(display.utterance_count as usize).map(|said| {
        json!({ "text": text_of(&said.text), "item": said.item, "notice": said.is_notice() })
    });
    let boxes = display.objects.iter().take(display.object_count as usize);
    json!({
        "said": said.collect::<Vec<_>>(),
        "highlighted": display.highlighted,
        "boxes": boxes.filter(|id| **id >= 0).collect::<Vec<_>>(),
        "speech_ready_s": round(display.speech_ready_s.into(), 2),
    })
}

fn of_action(action: &DriverAction) -> Value {
    match action.discrete() {
        Some(choice) => json!({ "choice": choice }),
        None => json!({
            "throttle": round(action.throttle.into(), 3),
            "steer": round(action.steer.into(), 3),
        }),
    }
}

/// Metres; null where nothing is in reach.
fn ranges(normalised: &[f32]) -> Value {
    let metres = normalised.iter().map(|range| match *range < 0.999 {
        true => json!(round(f64::from(*range * REACH_M), 1)),
        false => Value::Null,
    });
    metres.collect()
}

fn numbers(values: &[f32], digits: i32) -> Value {
    let rounded = values
        .iter()
        .map(|value| json!(round((*value).into(), digits)));
    rounded.collect()
}

fn mean(values: &[f32]) -> f64 {
    let sum: f64 = values.iter().copied().map(f64::from).sum();
    round(sum / values.len().max(1) as f64, 4)
}

fn round(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::{Road, Stage};
    use messages::Message;

    fn frames() -> Frames {
        let model = models::shipped::path(models::shipped::HIGHWAY);
        Frames::new(Decoder::new(&Stage::Highway(Road::default()), &model, None).unwrap())
    }

    fn at<M: Message>(episode: u32, step: u32) -> M {
        let mut message = M::ZERO;
        if let Some(header) = message.header_mut() {
            (header.episode, header.step) = (episode, step);
        }
        message
    }

    fn keys(frame: &Frame) -> Vec<&str> {
        frame.fields.keys().map(String::as_str).collect()
    }

    #[test]
    fn a_frame_is_filled_topic_by_topic_until_the_world_is_two_steps_on() {
        let mut frames = frames();
        assert!(frames.current().is_none());
        frames.take(&(&at::<Scene>(0, 0)).into());
        frames.take(&(&at::<Scene>(0, 1)).into());
        frames.take(&(&at::<LidarFrame>(0, 0)).into());
        assert!(frames.settle().is_empty(), "the human model is still busy");
        frames.take(&(&at::<LidarFrame>(0, 1)).into());
        frames.take(&(&at::<HumanBelief>(0, 0)).into());
        assert_eq!(frames.before().map(Frame::position), Some((0, 0)));
        // Decided for the step after the newest.
        frames.take(&(&at::<CommAction>(0, 2)).into());
        frames.take(&(&at::<Scene>(0, 2)).into());
        let settled = frames.settle();
        let places: Vec<_> = settled.iter().map(Frame::position).collect();
        assert_eq!(places, [(0, 0)]);
        assert_eq!(keys(&settled[0]), ["at", "human", "lidar", "scene"]);
        frames.take(&(&at::<Display>(0, 0)).into());
        assert!(frames.settle().is_empty(), "that step is over");
        let current = frames.current().map(keys);
        assert_eq!(current, Some(vec!["decision", "scene"]));
        frames.take(&(&at::<Scene>(1, 0)).into());
        assert_eq!(frames.settle().len(), 1);
        assert_eq!(frames.finish().len(), 2);
    }

    #[test]
    fn a_frame_says_which_step_it_is_and_who_computed_how_long() {
        let mut frames = frames();
        let mut lidar = at::<LidarFrame>(2, 7);
        lidar.range = [1.0; BEAMS];
        lidar.range[0] = 0.25;
        (lidar.header.cause_ns, lidar.header.sent_ns) = (1_000_000, 3_000_000);
        lidar.header.compute_ns = 500_000;
        frames.take(&(&lidar).into());
        let text = frames.current().unwrap().json(&Value::Null);
        let frame: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(frame["t"], "frame");
        assert_eq!((&frame["e"], &frame["k"]), (&json!(2), &json!(7)));
        assert_eq!(frame["times"], json!([["world", 500, 2000]]));
        assert_eq!(frame["lidar"]["range"][0], 10.0);
        assert_eq!(frame["lidar"]["range"][1], Value::Null);
    }

    #[test]
    fn what_another_program_sends_ahead_fills_no_memory() {
        let mut frames = frames();
        frames.take(&(&at::<Scene>(0, 0)).into());
        for step in 0..1000 {
            frames.take(&(&at::<CommAction>(0, step)).into());
            frames.take(&(&at::<Display>(9, step)).into());
        }
        assert_eq!(frames.filling.len(), 2);
    }
}
