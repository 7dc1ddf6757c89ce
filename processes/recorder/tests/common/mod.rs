//! Messages of every type whose every value is known, made from the layout that the type itself declares.
#![allow(dead_code)] // each test uses its share

use messages::{
    Cockpit, CommAction, Control, Display, DriverAction, Field, HumanBelief, LidarFrame, Message,
    Observation, Outcome, Picture, Report, RobotBelief, Scene,
};
use recorder::recording::About;
use recorder::text::string_of;
use recorder::topics::Recorded;
use serde_json::{Map, Value, json};

/// Length of a step in test recordings.
pub const STEP_NS: u64 = 150_000_000;

/// The run that test recordings claim to be of.
pub fn about() -> About {
    About {
        scene: "fog".to_owned(),
        human: "mirror".to_owned(),
        planner: "ce".to_owned(),
        seed: 7,
        run_id: 42,
        version: "0.1.0".to_owned(),
        step_ns: STEP_NS,
        ..About::default()
    }
}

/// One message of every recorded type, of step `step`, in the order in which a step sends them.
pub fn step_messages(step: u32) -> Vec<Recorded> {
    vec![
        (&known::<LidarFrame>(step, 0)).into(),
        (&known::<Observation>(step, 10)).into(),
        (&known::<Picture>(step, 11)).into(),
        (&known::<Scene>(step, 1)).into(),
        (&known::<Outcome>(step, 2)).into(),
        (&known::<RobotBelief>(step, 3)).into(),
        (&known::<HumanBelief>(step, 4)).into(),
        (&known::<CommAction>(step, 5)).into(),
        (&known::<Display>(step, 6)).into(),
        (&known::<DriverAction>(step, 7)).into(),
        (&known::<Cockpit>(step, 12)).into(),
        (&known::<Control>(step, 8)).into(),
        (&known::<Report>(step, 9)).into(),
    ]
}

/// A message in which every element differs from its neighbours, with a plausible header.
pub fn known<M: Message>(step: u32, salt: u64) -> M {
    let mut bytes = vec![0; size_of::<M>()];
    let mut next = 1 + 1000 * u64::from(step) + 77 * salt;
    fill(M::fields(), &mut bytes, &mut next);
    // SAFETY: messages are plain numbers without padding, for which all bytes are valid.
    let mut message: M = unsafe { core::ptr::read_unaligned(bytes.as_ptr().cast()) };
    if let Some(header) = message.header_mut() {
        header.run_id = 42;
        header.sequence = u64::from(step);
        header.sent_ns = 5_000_000_000 + u64::from(step) * STEP_NS + salt * 1000;
        header.cause_ns = 5_000_000_000 + u64::from(step) * STEP_NS;
        header.episode = 0;
        header.step = step;
    }
    message
}

fn elements(field: &Field) -> (usize, usize) {
    let count = field.count.unwrap_or(1);
    (count, field.size / count)
}

fn fill(fields: &[Field], bytes: &mut [u8], next: &mut u64) {
    for field in fields {
        let (count, size) = elements(field);
        if field.is_text {
            *next += 1;
            let text = format!("{next} größer");
            let place = &mut bytes[field.offset..][..field.size];
            place[..text.len()].copy_from_slice(text.as_bytes());
            continue;
        }
        for index in 0..count {
            let place = &mut bytes[field.offset + index * size..][..size];
            *next += 1;
            match (field.nested, field.element) {
                (Some(inner), _) => fill(inner(), place, next),
                (None, "float32") => {
                    place.copy_from_slice(&(*next as f32 * 0.37 - 9.0).to_le_bytes())
                }
                (None, "float64") => {
                    place.copy_from_slice(&(*next as f64 * 0.37 - 9.0).to_le_bytes())
                }
                (None, "uint8") => place[0] = *next as u8,
                (None, _) => place.copy_from_slice(&next.to_le_bytes()[..size]),
            }
        }
    }
}

/// Every value of a message by its dotted name, arrays of numbers as lists.
pub fn values(message: &Recorded) -> Value {
    let fields = match message {
        Recorded::LidarFrame(_) => LidarFrame::fields(),
        Recorded::Observation(_) => Observation::fields(),
        Recorded::Picture(_) => Picture::fields(),
        Recorded::Scene(_) => Scene::fields(),
        Recorded::Outcome(_) => Outcome::fields(),
        Recorded::RobotBelief(_) => RobotBelief::fields(),
        Recorded::HumanBelief(_) => HumanBelief::fields(),
        Recorded::CommAction(_) => CommAction::fields(),
        Recorded::Display(_) => Display::fields(),
        Recorded::DriverAction(_) => DriverAction::fields(),
        Recorded::Cockpit(_) => Cockpit::fields(),
        Recorded::Control(_) => Control::fields(),
        Recorded::Report(_) => Report::fields(),
    };
    let mut out = Map::new();
    read(fields, message.bytes(), "", &mut out);
    Value::Object(out)
}

fn read(fields: &[Field], bytes: &[u8], prefix: &str, out: &mut Map<String, Value>) {
    for field in fields {
        let (count, size) = elements(field);
        let name = format!("{prefix}{}", field.name);
        let place = |index: usize| &bytes[field.offset + index * size..][..size];
        match (field.nested, field.count) {
            _ if field.is_text => {
                let text = string_of(&bytes[field.offset..][..field.size]);
                out.insert(name, json!(text));
            }
            (Some(inner), None) => read(inner(), place(0), &format!("{name}."), out),
            (Some(inner), Some(_)) => {
                for index in 0..count {
                    read(inner(), place(index), &format!("{name}.{index}."), out);
                }
            }
            (None, None) => drop(out.insert(name, number(field.element, place(0)))),
            (None, Some(_)) => {
                let list = (0..count).map(|index| number(field.element, place(index)));
                out.insert(name, list.collect());
            }
        }
    }
}

fn number(element: &str, bytes: &[u8]) -> Value {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    let word = u64::from_le_bytes(word);
    match element {
        "float32" => json!(f64::from(f32::from_bits(word as u32))),
        "float64" => json!(f64::from_bits(word)),
        "int32" => json!(word as u32 as i32),
        _ => json!(word),
    }
}
