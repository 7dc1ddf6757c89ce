//! Whether a channel of a recording carries messages that this version knows, and how their bodies are read.

use crate::body::Body;
use crate::topics::RecordedTopic;

/// A schema's name and its text.
pub type Schema = (String, Vec<u8>);

/// The bodies of a channel's messages: as this version records them, or as versions before it did.
///
/// # Errors
/// What differs from the messages that this version knows.
pub fn body_of(
    known: &RecordedTopic,
    schema: Option<&Schema>,
    encoding: &str,
) -> Result<Body, String> {
    if encoding != "cdr" {
        return Err(format!("encoded as {encoding:?}, not \"cdr\""));
    }
    let Some((name, definition)) = schema else {
        return Err("without a schema".to_owned());
    };
    let expected = known.ros_type.replacen('/', "/msg/", 1);
    if *name != expected {
        return Err(format!("{name}, expected {expected}"));
    }
    let (theirs, ours) = (String::from_utf8_lossy(definition), (known.definition)());
    if theirs == ours {
        return Ok(Body::of((known.fields)()));
    }
    if theirs == (known.memory_definition)() {
        return Ok(Body::of_memory((known.fields)()));
    }
    let line = |text: &str, number: usize| {
        text.lines()
            .nth(number)
            .map_or("nothing".to_owned(), |line| format!("{line:?}"))
    };
    let number = (0..)
        .find(|number| line(&theirs, *number) != line(&ours, *number))
        .unwrap_or(0);
    Err(format!(
        "line {} of {name} is {}, this program's {}",
        number + 1,
        line(&theirs, number),
        line(&ours, number)
    ))
}
