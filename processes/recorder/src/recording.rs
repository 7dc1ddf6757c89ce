//! An MCAP file being written: channels, chunks, the closing metadata, and what happens when the disk fills.
//!
//! Chunks are compressed in memory and written whole. After each one the file's length is remembered; when a write
//! fails, the file is cut back to the last place where it was sound and closed there with a record that says what is
//! missing. What could not be kept is counted by topic, and the run goes on.

use crate::cdr::Cdr;
use crate::setup::{self, Setup};
use crate::topics::{PerTopic, Recorded, TOPICS};
use crate::visual::{CHANNELS, Channel, RoadLine, Visuals};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Uncompressed bytes after which a chunk is closed …
const CHUNK_BYTES: usize = 256 << 10;
/// … and the time after which it is, if that comes first: the most that a killed recorder loses.
const CHUNK_NS: u64 = 1_000_000_000;
/// Name of the metadata record that closes a recording.
pub const METADATA: &str = "mirror";

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
    #[error("recording {}: cannot write its head: {source}", path.display())]
    Head {
        /// The file.
        path: PathBuf,
        /// What the writer says.
        source: McapError,
    },
}

/// What a recording is of; part of the metadata at its head and at its end.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct About {
    /// Scene name or file.
    pub scene: String,
    /// Kind of human model.
    pub human: String,
    /// Kind of planner.
    pub planner: String,
    /// Seed of the run.
    pub seed: u64,
    /// Identity of the run, as in every message's header.
    pub run_id: u64,
    /// Version of MIRROR.
    pub version: String,
    /// What a replay needs; at the head only.
    pub setup: Setup,
}

impl About {
    fn entries(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("scene".to_owned(), self.scene.clone()),
            ("human".to_owned(), self.human.clone()),
            ("planner".to_owned(), self.planner.clone()),
            ("seed".to_owned(), self.seed.to_string()),
            (setup::RUN_ID.to_owned(), self.run_id.to_string()),
            ("version".to_owned(), self.version.clone()),
        ])
    }
}

/// Messages that never reached the recording, by topic.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lost {
    /// Gaps in the sequence numbers at the recorder's ports.
    pub ports: PerTopic,
    /// Dropped because the writer fell behind.
    pub queue: PerTopic,
    /// Dropped because the file could not take them.
    pub disk: PerTopic,
    /// Sent between the last chunk of a recorder that was killed and the start of the one that took its place.
    pub restart: PerTopic,
}

impl Lost {
    /// All losses of each topic.
    pub fn by_topic(&self) -> PerTopic {
        core::array::from_fn(|topic| {
            self.ports[topic] + self.queue[topic] + self.disk[topic] + self.restart[topic]
        })
    }

    /// All losses.
    pub fn total(&self) -> u64 {
        self.by_topic().iter().sum()
    }
}

/// What became of a recording.
#[derive(Clone, Debug, Default)]
pub struct Written {
    /// Messages in the file, by topic.
    pub written: PerTopic,
    /// Messages that are not.
    pub lost: Lost,
    /// Why writing ended early, if it did.
    pub error: Option<String>,
}

impl Written {
    /// Whether the file has every message that was sent.
    pub fn is_complete(&self) -> bool {
        self.error.is_none() && self.lost.total() == 0
    }
}

/// An open recording.
pub struct Recording {
    path: PathBuf,
    about: About,
    /// `None` after a write has failed.
    writer: Option<Writer<File>>,
    /// Shares its position with the writer's file.
    file: File,
    channels: [u16; TOPICS.len()],
    derived: [u16; CHANNELS.len()],
    derived_count: [u32; CHANNELS.len()],
    visuals: Visuals,
    /// The road's lines, until the first message gives them a time.
    road: Option<Vec<RoadLine>>,
    cdr: Cdr,
    chunk_bytes: usize,
    /// When the chunk's first message was sent.
    chunk_start_ns: u64,
    /// Slept after every chunk.
    stall: Duration,
    taken: PerTopic,
    /// Lengths at which the file is sound, and how much of each topic it then holds.
    sound: Vec<(u64, PerTopic)>,
    error: Option<String>,
    interrupted: Option<String>,
}

impl Recording {
    /// Creates the file and writes its head: every channel and the road.
    ///
    /// # Errors
    /// [`RecordingError`] names the file.
    pub fn create(path: &Path, about: &About, road: &[RoadLine]) -> Result<Self, RecordingError> {
        let attached = attachments(&about.setup).map_err(|source| RecordingError::Attach {
            path: path.into(),
            source,
        })?;
        let open = || {
            let file = File::create(path)?;
            Ok((file.try_clone()?, file))
        };
        let (file, handle) = open().map_err(|source| RecordingError::Create {
            path: path.into(),
            source,
        })?;
        let head = |source| RecordingError::Head {
            path: path.into(),
            source,
        };
        let mut recording = Self {
            path: path.into(),
            about: about.clone(),
            writer: Some(options().create(file).map_err(head)?),
            file: handle,
            channels: [0; TOPICS.len()],
            derived: [0; CHANNELS.len()],
            derived_count: [0; CHANNELS.len()],
            visuals: Visuals::default(),
            road: Some(road.to_vec()),
            cdr: Cdr::default(),
            chunk_bytes: 0,
            chunk_start_ns: 0,
            stall: Duration::ZERO,
            taken: [0; TOPICS.len()],
            sound: Vec::new(),
            error: None,
            interrupted: None,
        };
        recording.write_head(&attached).map_err(head)?;
        Ok(recording)
    }

    /// Makes the disk seem slow: after every chunk, the writer sleeps. For tests of what a slow disk does.
    pub fn stall(&mut self, per_chunk: Duration) {
        self.stall = per_chunk;
    }

    fn write_head(&mut self, attached: &[Attachment]) -> Result<(), McapError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let mut metadata = self.about.entries();
        // Plain data; serialising fails only for a path that is not UTF-8, which cannot be recorded.
        let setup = serde_json::to_string(&self.about.setup)
            .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
        metadata.insert(setup::KEY.to_owned(), setup);
        writer.write_metadata(&Metadata {
            name: setup::METADATA.to_owned(),
            metadata,
        })?;
        for attachment in attached {
            writer.attach(attachment)?;
        }
        let none = BTreeMap::new();
        for (id, topic) in self.channels.iter_mut().zip(&TOPICS) {
            let name = topic.ros_type.replacen('/', "/msg/", 1);
            let schema = writer.add_schema(&name, "ros2msg", (topic.definition)().as_bytes())?;
            *id = writer.add_channel(schema, &format!("/{}", topic.name), "cdr", &none)?;
        }
        for (id, (topic, schema)) in self.derived.iter_mut().zip(&CHANNELS) {
            let schema = writer.add_schema(schema.name, "ros2msg", schema.definition.as_bytes())?;
            *id = writer.add_channel(schema, topic, "cdr", &none)?;
        }
        writer.flush()?;
        self.mark_sound()?;
        Ok(())
    }

    fn mark_sound(&mut self) -> io::Result<()> {
        self.sound.push((self.file.stream_position()?, self.taken));
        Ok(())
    }

    /// Writes a message and all that is derived from it. A failure is kept for [`Self::finish`]; from then on
    /// messages are only counted.
    pub fn write(&mut self, message: &Recorded) {
        self.taken[message.topic()] += 1;
        if self.writer.is_some()
            && let Err(error) = self.try_write(message)
        {
            self.fail(&error);
        }
    }

    /// Why writing has stopped, if it has.
    pub fn error(&self) -> Option<&str> {
        self.error.as_deref()
    }

    /// Says that messages may be missing for another reason than those counted, so that the file is marked incomplete.
    pub fn interrupt(&mut self, why: &str) {
        self.interrupted = Some(why.to_owned());
    }

    fn try_write(&mut self, message: &Recorded) -> Result<(), McapError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let header = message.header();
        let record = |channel_id, sequence| MessageHeader {
            channel_id,
            sequence,
            log_time: header.sent_ns,
            publish_time: header.cause_ns,
        };
        if self.chunk_bytes == 0 {
            self.chunk_start_ns = header.sent_ns;
        }
        self.cdr.copy(message.bytes());
        writer.write_to_known_channel(
            &record(self.channels[message.topic()], header.sequence as u32),
            self.cdr.bytes(),
        )?;
        self.chunk_bytes += self.cdr.bytes().len();
        let mut result = Ok(());
        let mut emit = |channel: usize, body: &[u8]| {
            if result.is_ok() {
                let sequence = self.derived_count[channel];
                result =
                    writer.write_to_known_channel(&record(self.derived[channel], sequence), body);
                self.derived_count[channel] += 1;
                self.chunk_bytes += body.len();
            }
        };
        if let Some(road) = self.road.take() {
            Visuals::road(&road, header.sent_ns, &mut self.cdr);
            emit(Channel::Road as usize, self.cdr.bytes());
        }
        self.visuals.derive(message, &mut emit);
        result?;
        let age_ns = header.sent_ns.saturating_sub(self.chunk_start_ns);
        if self.chunk_bytes >= CHUNK_BYTES || age_ns >= CHUNK_NS {
            writer.flush()?;
            self.chunk_bytes = 0;
            self.mark_sound()?;
            if !self.stall.is_zero() {
                std::thread::sleep(self.stall);
            }
        }
        Ok(())
    }

    fn fail(&mut self, error: &dyn core::fmt::Display) {
        self.error = Some(format!("recording {}: {error}", self.path.display()));
        if let Some(writer) = self.writer.take() {
            drop(writer.into_inner());
        }
    }

    /// Closes the file: metadata, index, end mark. `lost` holds what was lost before it reached this recording.
    pub fn finish(mut self, lost: &Lost) -> Written {
        let mut outcome = Written {
            written: self.taken,
            lost: *lost,
            error: self.interrupted.take(),
        };
        if let Some(mut writer) = self.writer.take() {
            let metadata = metadata(&self.about, &outcome);
            let closed = writer
                .write_metadata(&metadata)
                .and_then(|()| writer.finish());
            let file = writer.into_inner();
            let closed = closed.and_then(|_| Ok(file.sync_all()?));
            if let Err(error) = closed {
                self.fail(&error);
            }
        }
        if self.error.is_some() {
            self.close_early(&mut outcome);
        }
        outcome
    }

    /// Cuts the file back to where it is sound and can still be closed.
    fn close_early(&mut self, outcome: &mut Written) {
        outcome.error.clone_from(&self.error);
        while let Some((length, written)) = self.sound.pop() {
            outcome.written = written;
            outcome.lost.disk = core::array::from_fn(|topic| self.taken[topic] - written[topic]);
            if self
                .close_at(length, &metadata(&self.about, outcome))
                .is_ok()
            {
                return;
            }
        }
    }

    fn close_at(&mut self, length: u64, metadata: &Metadata) -> anyhow::Result<()> {
        self.file.set_len(length)?;
        self.file.seek(SeekFrom::Start(length))?;
        self.file.write_all(&closing(metadata)?)?;
        self.file.sync_all()?;
        Ok(())
    }
}

/// The files that a setup wants attached.
fn attachments(setup: &Setup) -> io::Result<Vec<Attachment<'static>>> {
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

/// Chunks are buffered so that each is one write, and compressed on the caller's thread.
fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("mirror ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .chunk_size(None)
        .disable_seeking(true)
}

/// The records that close a file without an index: what an empty MCAP file with `metadata` has behind its head.
fn closing(metadata: &Metadata) -> Result<Vec<u8>, McapError> {
    let bare = || {
        options()
            .use_chunks(false)
            .emit_summary_records(false)
            .emit_summary_offsets(false)
            .calculate_data_section_crc(false)
            .calculate_summary_section_crc(false)
    };
    let mut writer = bare().create(Cursor::new(Vec::new()))?;
    writer.flush()?;
    let head = writer.into_inner().into_inner().len();
    let mut writer = bare().create(Cursor::new(Vec::new()))?;
    writer.write_metadata(metadata)?;
    writer.finish()?;
    Ok(writer.into_inner().into_inner().split_off(head))
}

fn metadata(about: &About, outcome: &Written) -> Metadata {
    let mut entries = about.entries();
    entries.insert("complete".to_owned(), outcome.is_complete().to_string());
    let lost = outcome.lost.by_topic();
    for (index, topic) in TOPICS.iter().enumerate() {
        entries.insert(
            format!("written {}", topic.name),
            outcome.written[index].to_string(),
        );
        entries.insert(format!("lost {}", topic.name), lost[index].to_string());
    }
    if let Some(error) = &outcome.error {
        entries.insert("error".to_owned(), error.clone());
    }
    Metadata {
        name: METADATA.to_owned(),
        metadata: entries,
    }
}
