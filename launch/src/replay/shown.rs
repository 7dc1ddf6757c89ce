//! `mirror replay --view`: the recording as a page shows it, with what is decided now beside what was decided then.

use super::resolve::Resolved;
use crate::cli::ReplayArguments;
use crate::screen::Screen;
use anyhow::{Context, Result};
use recorder::parts::{parts_of, read_parts};
use replay::{Drive, Row};
use serde_json::json;
use view::Beside;
use web::Access;

/// What is decided now, at the steps that it is for.
pub fn beside(rows: &[Row]) -> Vec<Beside> {
    let decided = |row: &Row| {
        let now = &row.now;
        let decision = json!({
            "visual": now.visual,
            "verbal": now.verbal,
            "value": now.value,
            "value_silent": now.value_silent,
            "cost": now.cost,
            "reason": now.reason,
        });
        ((row.episode, row.step.saturating_add(1)), decision)
    };
    rows.iter().map(decided).collect()
}

/// Shows the recording until Ctrl-C.
///
/// # Errors
/// When it cannot be read again, or nothing can be served.
pub fn show(
    arguments: &ReplayArguments,
    drive: &Drive,
    resolved: &Resolved,
    beside: Vec<Beside>,
    screen: &Screen,
) -> Result<()> {
    let options = resolved.view_options(&arguments.recording)?;
    let run_id = drive.found.run_id.unwrap_or_default();
    let listen = arguments
        .listen
        .map_or_else(Access::loopback, |listen| listen.0);
    let access = Access::new(listen).context("serving the page")?;
    let mut messages = Vec::new();
    let mut parts = parts_of(&arguments.recording, run_id);
    if parts.is_empty() {
        parts.push(arguments.recording.clone());
    }
    read_parts(&parts, |message| {
        messages.push(*message);
    })?;
    view::show_recording(
        &access,
        &options,
        run_id,
        messages.into_iter(),
        beside,
        |link| screen.line(&format!("watch at {link} (Ctrl-C ends it)")),
    )
}
