//! An MCAP file being written: channels, chunks, the closing metadata, and what happens when the disk fills.
//!
//! Times are the drive's ([`DriveTime`]), and messages stand in its order ([`Order`]); when a message was really sent
//! is in its header. Text is recorded as strings ([`Body`]).
//!
//! Chunks are compressed in memory and written whole. After each one the file's length is remembered; when a write
//! fails, the file is cut back to the last place where it was sound and closed there with a record that says what is
//! missing. What could not be kept is counted by topic, and the run goes on.

use crate::body::Body;
use crate::cdr::Cdr;
use crate::drive_time::{Anchor, DriveTime};
use crate::format::{closing, options, reason};
pub use crate::head::RecordingError;
use crate::head::{attachments, write_head};
use crate::order::Order;
use crate::outcome::metadata;
pub use crate::outcome::{Lost, METADATA, Written};
use crate::ros::write_clock;
pub use crate::setup::About;
use crate::topics::{PerTopic, Recorded, TOPICS};
use crate::visual::{CHANNELS, Channel, RoadLine, Visuals};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, Writer};
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Uncompressed bytes after which a chunk is closed …
const CHUNK_BYTES: usize = 256 << 10;
/// … and the time after which it is, if that comes first: the most that a killed recorder loses.
const CHUNK_NS: u64 = 1_000_000_000;
/// Messages after which is looked for some that need not be held any longer, and the time after which it is.
const LOOK_MESSAGES: usize = 32;
const LOOK_NS: u64 = 100_000_000;
/// Messages that may wait for the drive to begin; a set whose world says nothing is recorded nevertheless.
const MOST_EARLY: usize = 1024;

/// Episode and step.
type At = (u32, u32);

/// A length at which the file is sound, and what it then holds.
#[derive(Clone, Copy, Debug)]
struct Sound {
    length: u64,
    written: PerTopic,
    /// The step of its last message.
    last: Option<At>,
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
    bodies: Vec<Body>,
    time: DriveTime,
    /// What came before the drive began.
    early: Vec<Recorded>,
    order: Order,
    /// Messages since the last look at the order, and when the newest before it was sent.
    unlooked: usize,
    looked_ns: u64,
    visuals: Visuals,
    /// The road's lines, until the first message gives them a time.
    road: Option<Vec<RoadLine>>,
    /// The newest time on `/clock`.
    clock_ns: u64,
    cdr: Cdr,
    chunk_bytes: usize,
    /// When the first message in the chunk was sent.
    chunk_start_ns: u64,
    /// Slept after every chunk.
    stall: Duration,
    taken: PerTopic,
    written: PerTopic,
    /// The step of the last message written.
    last: Option<At>,
    sound: Vec<Sound>,
    /// Why writing has stopped.
    why: Option<String>,
    /// The same, with the file and its end.
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
        let mut writer = options().create(file).map_err(head)?;
        let (channels, derived) = write_head(&mut writer, about, &attached).map_err(head)?;
        let mut recording = Self {
            path: path.into(),
            about: about.clone(),
            writer: Some(writer),
            file: handle,
            channels,
            derived,
            derived_count: [0; CHANNELS.len()],
            bodies: TOPICS
                .iter()
                .map(|topic| Body::of((topic.fields)()))
                .collect(),
            time: DriveTime::new(about.step_ns),
            early: Vec::new(),
            order: Order::default(),
            unlooked: 0,
            looked_ns: 0,
            visuals: Visuals::default(),
            road: Some(road.to_vec()),
            clock_ns: 0,
            cdr: Cdr::default(),
            chunk_bytes: 0,
            chunk_start_ns: 0,
            stall: Duration::ZERO,
            taken: [0; TOPICS.len()],
            written: [0; TOPICS.len()],
            last: None,
            sound: Vec::new(),
            why: None,
            error: None,
            interrupted: None,
        };
        recording
            .mark_sound()
            .map_err(McapError::from)
            .map_err(head)?;
        Ok(recording)
    }

    /// Counts time on from a step of an earlier part.
    pub fn go_on_from(&mut self, anchor: Anchor) {
        self.time.go_on_from(anchor);
    }

    /// Makes the disk seem slow: after every chunk, the writer sleeps. For tests of what a slow disk does.
    pub fn stall(&mut self, per_chunk: Duration) {
        self.stall = per_chunk;
    }

    fn mark_sound(&mut self) -> io::Result<()> {
        self.sound.push(Sound {
            length: self.file.stream_position()?,
            written: self.written,
            last: self.last,
        });
        Ok(())
    }

    /// Takes a message, and writes it and all that is derived from it once its turn comes. A failure is kept for
    /// [`Self::finish`]; from then on messages are only counted.
    pub fn write(&mut self, message: &Recorded) {
        self.taken[message.topic()] += 1;
        if self.writer.is_some()
            && let Err(error) = self.try_take(message)
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

    fn try_take(&mut self, message: &Recorded) -> Result<(), McapError> {
        let sent_ns = message.header().sent_ns;
        match self.time.of(message) {
            Some(time_ns) => {
                self.take_early(time_ns);
                self.order.push(time_ns, message);
            }
            None if self.early.len() < MOST_EARLY => self.early.push(*message),
            None => {
                self.time.begin(sent_ns);
                return self.try_take(message);
            }
        }
        self.unlooked += 1;
        let unlooked_ns = sent_ns.saturating_sub(self.looked_ns);
        if self.unlooked >= LOOK_MESSAGES || unlooked_ns >= LOOK_NS {
            (self.unlooked, self.looked_ns) = (0, sent_ns);
            self.release(false)?;
        }
        let age_ns = sent_ns.saturating_sub(self.chunk_start_ns);
        if self.chunk_bytes > 0 && age_ns >= CHUNK_NS {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// What came before the drive stands at its beginning.
    fn take_early(&mut self, begin_ns: u64) {
        for message in self.early.drain(..) {
            self.order.push(begin_ns, &message);
        }
    }

    /// Writes what need not be held any longer, or all that there is.
    fn release(&mut self, all: bool) -> Result<(), McapError> {
        let mut order = core::mem::take(&mut self.order);
        let write = |time_ns, message: &Recorded| self.put(time_ns, message);
        let result = match all {
            true => order.release_all(write),
            false => order.release(write),
        };
        self.order = order;
        result
    }

    fn put(&mut self, time_ns: u64, message: &Recorded) -> Result<(), McapError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let (topic, header) = (message.topic(), message.header());
        let record = |channel_id, sequence| MessageHeader {
            channel_id,
            sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        if self.chunk_bytes == 0 {
            self.chunk_start_ns = header.sent_ns;
        }
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
        if time_ns > self.clock_ns {
            self.clock_ns = time_ns;
            write_clock(time_ns, &mut self.cdr);
            emit(Channel::Clock as usize, self.cdr.bytes());
        }
        if let Some(road) = self.road.take() {
            Visuals::road(&road, time_ns, &mut self.cdr);
            emit(Channel::Road as usize, self.cdr.bytes());
        }
        self.visuals.derive(message, time_ns, &mut emit);
        result?;
        self.bodies[topic].write(message.bytes(), &mut self.cdr);
        writer.write_to_known_channel(
            &record(self.channels[topic], header.sequence as u32),
            self.cdr.bytes(),
        )?;
        self.chunk_bytes += self.cdr.bytes().len();
        self.written[topic] += 1;
        if TOPICS[topic].is_repeatable() {
            // A late decision of an earlier step may stand behind the frame of a later one.
            self.last = self.last.max(Some((header.episode, header.step)));
        }
        if self.chunk_bytes >= CHUNK_BYTES {
            self.close_chunk()?;
        }
        Ok(())
    }

    fn close_chunk(&mut self) -> Result<(), McapError> {
        if let Some(writer) = &mut self.writer {
            writer.flush()?;
            self.chunk_bytes = 0;
            self.mark_sound()?;
            if !self.stall.is_zero() {
                std::thread::sleep(self.stall);
            }
        }
        Ok(())
    }

    fn fail(&mut self, error: &McapError) {
        self.why = Some(reason(error));
        self.error = self.describe(self.sound.last());
        if let Some(writer) = self.writer.take() {
            drop(writer.into_inner());
        }
    }

    /// Why writing has stopped, and after what.
    fn describe(&self, sound: Option<&Sound>) -> Option<String> {
        let why = self.why.as_ref()?;
        let end = match sound.and_then(|sound| sound.last) {
            Some((episode, step)) => format!("it ends after episode {episode} step {step}"),
            None => "it holds no step".to_owned(),
        };
        Some(format!("recording {}: {why}; {end}", self.path.display()))
    }

    /// Closes the file: metadata, index, end mark. `lost` holds what was lost before it reached this recording.
    pub fn finish(mut self, lost: &Lost) -> Written {
        if self.writer.is_some()
            && let Err(error) = self.write_rest()
        {
            self.fail(&error);
        }
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

    fn write_rest(&mut self) -> Result<(), McapError> {
        if let Some(first) = self.early.first() {
            let sent_ns = first.header().sent_ns;
            self.time.begin(sent_ns);
            let begin_ns = self.time.of(first).unwrap_or_default();
            self.take_early(begin_ns);
        }
        self.release(true)
    }

    /// Cuts the file back to where it is sound and can still be closed.
    fn close_early(&mut self, outcome: &mut Written) {
        while let Some(sound) = self.sound.pop() {
            outcome.error = self.describe(Some(&sound));
            outcome.written = sound.written;
            outcome.lost.disk =
                core::array::from_fn(|topic| self.taken[topic] - sound.written[topic]);
            if self
                .close_at(sound.length, &metadata(&self.about, outcome))
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
