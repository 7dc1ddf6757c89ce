//! Reads recordings back, whole or broken: what a killed recorder, a full disk or a bad copy left is read as far as it
//! is sound, and what is not is reported with its place.
//!
//! Records are taken one by one from the file; a chunk's checksum is checked before anything in it counts. A chunk that
//! is damaged is passed over. Of a last chunk that is cut, what can still be decompressed counts.

use crate::body::Body;
use crate::drive_time::{self, Anchor};
pub use crate::found::{Damage, Ending, Found, ReadError};
use crate::frames::{Frame, Frames, MOST_BYTES, PREFIX, is_chunk};
use crate::schema::{Schema, body_of};
use crate::setup::{self, Setup};
use crate::topics::{Recorded, TOPICS};
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes handed to the decompressor at a time.
const PIECE: usize = 64 << 10;

/// Reads a file from start to end and hands every message of our topics to `visit`, in the file's order.
///
/// # Errors
/// [`ReadError`] with the file's name and the place in it. A file that breaks off or is damaged is no error: see
/// [`Found::ending`] and [`Found::damage`].
pub fn read(path: &Path, visit: impl FnMut(&Recorded)) -> Result<Found, ReadError> {
    let mut reader = RecordingReader::open(path, visit)?;
    reader.read_until(|_| false)?;
    Ok(reader.found)
}

/// The identity of the run that a file records, if it is a recording whose head is whole.
pub fn run_of(path: &Path) -> Option<u64> {
    let mut reader = RecordingReader::open(path, |_: &Recorded| {}).ok()?;
    reader.read_until(|found| found.run_id.is_some()).ok()?;
    reader.found.run_id
}

/// How far a file's recording has come in its drive, if it is one with a step in it. Only its beginning and its end are
/// read.
pub fn end_of(path: &Path) -> Option<Anchor> {
    let mut reader = RecordingReader::open(path, |_: &Recorded| {}).ok()?;
    let has_channels = |found: &Found| found.channels.contains(&true);
    reader.read_until(has_channels).ok()?;
    // The last may have a decision only, and nothing of the world.
    let last = reader.frames.last_chunks().ok()?;
    let start = last.into_iter().flatten().next()?;
    reader.frames.seek(start).ok()?;
    reader.read_until(|_| false).ok()?;
    reader.last
}

struct RecordingReader<'a, V> {
    path: &'a Path,
    frames: Frames,
    /// Where the record at hand begins.
    byte: u64,
    schemas: BTreeMap<u16, Schema>,
    /// For every channel of ours, its place in [`TOPICS`] and the bodies of its messages.
    channels: BTreeMap<u16, (usize, Body)>,
    /// A message's memory.
    memory: Vec<u8>,
    found: Found,
    /// The world's last message.
    last: Option<Anchor>,
    visit: V,
}

/// Whether reading goes on.
#[derive(PartialEq, Eq)]
enum Next {
    Record,
    End,
}

impl<'a, V: FnMut(&Recorded)> RecordingReader<'a, V> {
    fn open(path: &'a Path, visit: V) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io {
            path: path.to_owned(),
            source,
        };
        let frames = File::open(path).and_then(Frames::open).map_err(io)?;
        let frames = frames.ok_or_else(|| ReadError::NotMcap {
            path: path.to_owned(),
        })?;
        Ok(Self {
            path,
            byte: frames.start(),
            frames,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            memory: Vec::new(),
            found: Found::default(),
            last: None,
            visit,
        })
    }

    fn read_until(&mut self, enough: impl Fn(&Found) -> bool) -> Result<(), ReadError> {
        // Up to here, chunks need not be looked for again.
        let mut searched = self.frames.end();
        loop {
            let frame = self.frames.read().map_err(|source| self.io(source))?;
            self.byte = self.frames.start();
            let bytes = core::mem::take(self.frames.bytes_mut());
            let next = match frame {
                Frame::Whole(op::CHUNK) => {
                    let trouble = match is_chunk(&bytes, bytes.len() as u64) {
                        true => self.chunk(&bytes, true)?,
                        false => Some("a chunk that says two lengths".to_owned()),
                    };
                    searched = match &trouble {
                        None => self.frames.end(),
                        Some(_) => self.byte + 1,
                    };
                    if let Some(why) = trouble {
                        self.damaged(why);
                        self.channels_of_summary()?;
                        self.go_on_behind(&bytes, &mut searched)?;
                    }
                    Next::Record
                }
                Frame::Whole(opcode) => self.record(opcode, &bytes[PREFIX..])?,
                Frame::Short(_) | Frame::None(_) | Frame::End => {
                    self.pass_over(&frame, &bytes, &mut searched)?
                }
            };
            *self.frames.bytes_mut() = bytes;
            if next == Next::End || enough(&self.found) {
                return Ok(());
            }
        }
    }

    /// Where no record follows: goes on with the next chunk, if there is one, and else ends.
    fn pass_over(
        &mut self,
        frame: &Frame,
        bytes: &[u8],
        searched: &mut u64,
    ) -> Result<Next, ReadError> {
        let why = match frame {
            Frame::None(why) => why.clone(),
            Frame::End => "the file ends without an end mark".to_owned(),
            _ => "the file ends in a record".to_owned(),
        };
        let found = self.frames.find_chunk(*searched);
        let found = found.map_err(|source| self.io(source))?;
        let Some(chunk) = found else {
            if *frame == Frame::Short(op::CHUNK) {
                self.chunk(bytes, false)?;
            }
            self.found.ending = Ending::Cut {
                byte: self.byte,
                why,
            };
            return Ok(Next::End);
        };
        self.damaged(match frame {
            Frame::None(why) => why.clone(),
            _ => "a record that is longer than the file".to_owned(),
        });
        *searched = chunk + 1;
        self.frames.seek(chunk).map_err(|source| self.io(source))?;
        Ok(Next::Record)
    }

    /// Behind a damaged chunk: at its end, unless its length is what is damaged.
    fn go_on_behind(&mut self, chunk: &[u8], searched: &mut u64) -> Result<(), ReadError> {
        if is_chunk(chunk, chunk.len() as u64) {
            return Ok(());
        }
        let end = self.frames.end();
        let next = self.frames.find_chunk(*searched);
        let next = next.map_err(|source| self.io(source))?;
        let next = next.unwrap_or(end);
        *searched = next.max(*searched);
        self.frames.seek(next).map_err(|source| self.io(source))
    }

    fn damaged(&mut self, why: String) {
        let byte = self.byte;
        self.found.damage.push(Damage { byte, why });
    }

    /// Channels are declared in the first chunk, and again at the file's end: if the first is damaged, from there.
    fn channels_of_summary(&mut self) -> Result<(), ReadError> {
        if !self.channels.is_empty() {
            return Ok(());
        }
        let (byte, back) = (self.byte, self.frames.end());
        let summary = self.frames.summary().map_err(|source| self.io(source))?;
        if let Some(start) = summary {
            self.frames.seek(start).map_err(|source| self.io(source))?;
            while let Frame::Whole(opcode) = self.frames.read().map_err(|source| self.io(source))? {
                self.byte = self.frames.start();
                let bytes = core::mem::take(self.frames.bytes_mut());
                if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                    self.record(opcode, &bytes[PREFIX..])?;
                }
            }
        }
        self.byte = byte;
        self.frames.seek(back).map_err(|source| self.io(source))
    }

    /// Takes the records of a chunk; why it is not sound, if it is not. Of a whole chunk the checksum is checked first.
    fn chunk(&mut self, bytes: &[u8], whole: bool) -> Result<Option<String>, ReadError> {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(whole)
            .with_record_length_limit(MOST_BYTES);
        let mut reader = LinearReader::new_with_options(options);
        let mut rest = bytes;
        loop {
            match reader.next_event() {
                None => return Ok(None),
                Some(Err(error)) => return Ok(Some(format!("a damaged chunk: {error}"))),
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let piece = wanted.clamp(1, PIECE).min(rest.len());
                    if piece == 0 {
                        reader.notify_read(0);
                        continue;
                    }
                    reader.insert(piece)[..piece].copy_from_slice(&rest[..piece]);
                    reader.notify_read(piece);
                    rest = &rest[piece..];
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    self.record(opcode, data)?;
                }
            }
        }
    }

    fn record(&mut self, opcode: u8, body: &[u8]) -> Result<Next, ReadError> {
        if opcode == op::ATTACHMENT && !has_room_for_checksum(body) {
            self.damaged("a damaged record: an attachment without a checksum".to_owned());
            return Ok(Next::Record);
        }
        let record = match mcap::parse_record(opcode, body) {
            Ok(record) => record,
            Err(error) => {
                self.damaged(format!("a damaged record: {error}"));
                return Ok(Next::Record);
            }
        };
        match record {
            Record::Schema { header, data } => {
                self.schemas
                    .insert(header.id, (header.name, data.into_owned()));
            }
            Record::Channel(channel) => {
                let topic = channel.topic.strip_prefix('/').unwrap_or(&channel.topic);
                if let Some(index) = TOPICS.iter().position(|known| known.name == topic) {
                    let schema = self.schemas.get(&channel.schema_id);
                    let body = body_of(&TOPICS[index], schema, &channel.message_encoding)
                        .map_err(|difference| self.version(index, difference))?;
                    self.channels.insert(channel.id, (index, body));
                    self.found.channels[index] = true;
                }
            }
            Record::Message { header, data } => {
                if let Some((topic, body)) = self.channels.get(&header.channel_id) {
                    let topic = *topic;
                    body.read(&data, &mut self.memory)
                        .map_err(|difference| self.version(topic, difference))?;
                    // As many bytes as a message has: that is what the body was made for.
                    if let Some(message) = Recorded::from_bytes(topic, &self.memory) {
                        self.message(&message, header.log_time);
                    }
                }
            }
            Record::Metadata(metadata) if metadata.name == setup::METADATA => {
                self.head(metadata.metadata)?;
            }
            Record::Metadata(metadata) if metadata.name == crate::recording::METADATA => {
                self.found.closing = Some(metadata.metadata);
            }
            Record::Attachment { header, data, .. } => {
                self.found
                    .attachments
                    .insert(header.name, data.into_owned());
            }
            Record::DataEnd(end) => {
                let checksum = self.frames.checksum().filter(|_| end.data_section_crc != 0);
                if checksum.is_some_and(|checksum| checksum != end.data_section_crc)
                    && self.found.damage.is_empty()
                {
                    self.damaged(
                        "bytes between the chunks before it are not as written".to_owned(),
                    );
                }
            }
            Record::Footer(_) => {
                if self.frames.left() < mcap::MAGIC.len() as u64 {
                    self.found.ending = Ending::Cut {
                        byte: self.byte,
                        why: "the file ends without an end mark".to_owned(),
                    };
                }
                return Ok(Next::End);
            }
            _ => {}
        }
        Ok(Next::Record)
    }

    fn message(&mut self, message: &Recorded, time_ns: u64) {
        let (topic, header) = (message.topic(), message.header());
        self.found.messages[topic] += 1;
        if drive_time::is_world(TOPICS[topic].name) {
            self.last = Some(Anchor {
                episode: header.episode,
                step: header.step,
                time_ns,
            });
        }
        (self.visit)(message);
    }

    fn head(&mut self, mut entries: BTreeMap<String, String>) -> Result<(), ReadError> {
        let bad = |reason: String| ReadError::Setup {
            path: self.path.to_owned(),
            byte: self.byte,
            reason,
        };
        if let Some(text) = entries.remove(setup::KEY) {
            let setup: Setup =
                serde_json::from_str(&text).map_err(|error| bad(error.to_string()))?;
            if setup.schema > setup::SCHEMA {
                let (theirs, ours) = (setup.schema, setup::SCHEMA);
                return Err(bad(format!(
                    "is of version {theirs}, this program knows {ours}"
                )));
            }
            self.found.setup = (setup.schema > 0).then_some(setup);
        }
        if let Some(run_id) = entries.get(setup::RUN_ID) {
            let run_id = run_id
                .parse()
                .map_err(|_| bad(format!("run_id {run_id:?} is no number")))?;
            self.found.run_id = Some(run_id);
        }
        self.found.about = entries;
        Ok(())
    }

    fn version(&self, topic: usize, difference: String) -> ReadError {
        ReadError::Version {
            path: self.path.to_owned(),
            byte: self.byte,
            topic: TOPICS[topic].name,
            difference,
        }
    }

    fn io(&self, source: io::Error) -> ReadError {
        ReadError::Io {
            path: self.path.to_owned(),
            source,
        }
    }
}

/// Whether an attachment's record is long enough for all that it must have; `mcap` takes that for granted.
fn has_room_for_checksum(body: &[u8]) -> bool {
    let text = |place: usize| {
        let length = body.get(place..place.checked_add(4)?)?;
        let length = u32::from_le_bytes(length.try_into().ok()?) as usize;
        place.checked_add(4)?.checked_add(length)
    };
    // Two times; name and media type; the data's length; the checksum.
    let end = text(16)
        .and_then(text)
        .and_then(|end| end.checked_add(8 + 4));
    end.is_some_and(|end| end <= body.len())
}
