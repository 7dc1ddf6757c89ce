//! The head of a recording: what the run was set up from, the files that travel with it, and every channel.

use crate::format::reason;
use crate::qos::Qos;
use crate::setup::{self, About, Setup};
use crate::topics::TOPICS;
use crate::visual::CHANNELS;
use mcap::records::Metadata;
use mcap::{Attachment, McapError, Writer};
use std::fs::File;
use std::io;
use std::path::PathBuf;

/// Why a recording could not be started.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be created; its folder is missing, or may not be written.
    #[error("recording {}: cannot be created: {source}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A model file that shall travel with the recording cannot be read.
    #[error("recording {}: cannot attach {source}", path.display())]
    Attach {
        /// The recording.
        path: PathBuf,
        /// What the system says, with the file's name.
        source: io::Error,
    },
    /// The file was created, but its head could not be written.
    #[error("recording {}: cannot write its head: {}", path.display(), reason(source))]
    Head {
        /// The file.
        path: PathBuf,
        /// What the writer says.
        source: McapError,
    },
}

/// Numbers of the topics' channels in a file, and of the derived ones.
pub type ChannelIds = ([u16; TOPICS.len()], [u16; CHANNELS.len()]);

/// Writes the head.
///
/// # Errors
/// What the writer meets.
pub fn write_head(
    writer: &mut Writer<File>,
    about: &About,
    attached: &[Attachment],
) -> Result<ChannelIds, McapError> {
    let mut metadata = about.entries();
    // Plain data; serialising fails only for a path that is not UTF-8, which cannot be recorded.
    let setup = serde_json::to_string(&about.setup)
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
    metadata.insert(setup::KEY.to_owned(), setup);
    writer.write_metadata(&Metadata {
        name: setup::METADATA.to_owned(),
        metadata,
    })?;
    for attachment in attached {
        writer.attach(attachment)?;
    }
    let (mut channels, mut derived) = ([0; TOPICS.len()], [0; CHANNELS.len()]);
    let stream = Qos::Stream.metadata();
    for (id, topic) in channels.iter_mut().zip(&TOPICS) {
        let name = topic.ros_type.replacen('/', "/msg/", 1);
        let schema = writer.add_schema(&name, "ros2msg", (topic.definition)().as_bytes())?;
        *id = writer.add_channel(schema, &format!("/{}", topic.name), "cdr", &stream)?;
    }
    for (id, (topic, schema, qos)) in derived.iter_mut().zip(&CHANNELS) {
        let schema = writer.add_schema(schema.name, "ros2msg", schema.definition.as_bytes())?;
        *id = writer.add_channel(schema, topic, "cdr", &qos.metadata())?;
    }
    writer.flush()?;
    Ok((channels, derived))
}

/// The files that a setup wants attached.
pub fn attachments(setup: &Setup) -> io::Result<Vec<Attachment<'static>>> {
    let attached = setup.files.iter().filter(|(_, file)| file.attached);
    let read = |(name, file): (&String, &setup::ModelFile)| {
        let data = std::fs::read(&file.path).map_err(|error| {
            io::Error::new(error.kind(), format!("{}: {error}", file.path.display()))
        })?;
        Ok(Attachment {
            log_time: 0,
            create_time: 0,
            name: name.clone(),
            media_type: "application/octet-stream".to_owned(),
            data: data.into(),
        })
    };
    attached.map(read).collect()
}
