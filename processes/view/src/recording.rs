//! A recording, shown as a run is: all of it at once, with what another model would have decided beside it.

use crate::decode::Decoder;
use crate::frame::Frames;
use crate::{ViewOptions, hello};
use anyhow::Result;
use recorder::topics::Recorded;
use serde_json::{Value, json};
use std::time::Duration;
use web::{Access, Incoming, LIVE_VIEW, Server};

/// Frames that a page is sent at a time; it asks for more.
const AT_A_TIME: usize = 100;
/// How often pages are listened to.
const LOOK: Duration = Duration::from_millis(20);

/// What another model decided at a step: episode, step, and the decision as the page takes it.
pub type Beside = ((u32, u32), Value);

/// Shows a recording's messages until this process is told to end. `opened` hears the link once it is served.
///
/// # Errors
/// When a model cannot be used, or nothing can be served.
pub fn show_recording(
    access: &Access,
    options: &ViewOptions,
    run_id: u64,
    messages: impl Iterator<Item = Recorded>,
    beside: Vec<Beside>,
    opened: impl FnOnce(&str),
) -> Result<()> {
    let decoder = Decoder::new(&options.stage, &options.model, options.implants.as_deref())?;
    let mut hello = hello(options, &decoder, run_id);
    let mut frames = Frames::new(decoder);
    messages.for_each(|message| frames.take(&message));
    for (position, decision) in beside {
        frames.add(position, "beside", decision);
    }
    let frames: Vec<String> = frames
        .finish()
        .iter()
        .map(|frame| frame.json(&Value::Null))
        .collect();
    hello["recorded"] = json!(frames.len());
    let server = Server::start(access, LIVE_VIEW)?;
    server.greet(&hello.to_string());
    opened(&access.link());
    while !runtime::stop_requested() {
        while let Some(incoming) = server.take() {
            let Incoming::Said(page, text) = incoming else {
                continue;
            };
            let asked: Option<Value> = serde_json::from_str(&text).ok();
            let from = asked.and_then(|asked| asked["from"].as_u64());
            let from = from.map_or(frames.len(), |from| from as usize);
            for frame in frames.iter().skip(from).take(AT_A_TIME) {
                server.tell_one(page, frame);
            }
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}
