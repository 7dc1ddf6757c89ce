//! Reads recordings back, whole or broken: what a killed recorder, a full disk or a bad copy left is read up to the
//! place where it ends or is damaged, and that place is reported.
//!
//! Records are taken one by one from the file; a chunk's checksum is checked before anything in it counts. Of a last
//! chunk that is cut, what can still be decompressed counts. Nothing is believed about lengths: a record never takes more
//! memory than the file has bytes.

use crate::cdr::ENCAPSULATION;
use crate::setup::{self, Setup};
use crate::topics::{PerTopic, Recorded, TOPICS};
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

/// The largest record or unpacked chunk that is read: a thousand times what the recorder writes.
const MOST_BYTES: usize = 256 << 20;
/// Kind and length before every record.
const PREFIX: u64 = 9;
/// Bytes handed to the decompressor at a time.
const PIECE: usize = 64 << 10;

/// Why a recording cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It does not begin as MCAP files do.
    #[error("{}: byte 0: not an MCAP recording", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// A topic carries another version of its message.
    #[error("{}: byte {byte}: /{topic} carries another version of its message: {difference}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Where the record that says so begins.
        byte: u64,
        /// The topic.
        topic: &'static str,
        /// What differs.
        difference: String,
    },
    /// What the run was set up from cannot be understood.
    #[error("{}: byte {byte}: metadata \"{}\": {reason}", path.display(), setup::METADATA)]
    Setup {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
}

/// How a file ends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// As it should.
    #[default]
    Closed,
    /// Before its end mark: the recorder was killed, or the file was cut.
    Cut {
        /// Where the record begins that is not whole, or where the file ends.
        byte: u64,
        /// What is there.
        why: String,
    },
}

impl core::fmt::Display for Ending {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Closed => write!(f, "closed"),
            Self::Cut { byte, why } => write!(f, "cut short at byte {byte}: {why}"),
        }
    }
}

/// What was found in a file besides its messages.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Identity of the run, from the file's head.
    pub run_id: Option<u64>,
    /// What the run was set up from; recordings of earlier versions do not say.
    pub setup: Option<Setup>,
    /// The head's other entries: scene, human, planner, seed, version.
    pub about: BTreeMap<String, String>,
    /// Files that travel with the recording, by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// The closing metadata: what was written and lost. Absent from a file that was not closed.
    pub closing: Option<BTreeMap<String, String>>,
    /// Which topics the file has a channel for, in the order of [`TOPICS`].
    pub channels: [bool; TOPICS.len()],
    /// Messages read, by topic.
    pub messages: PerTopic,
    /// How the file ends.
    pub ending: Ending,
}

impl Found {
    /// Messages lost before they reached the file, as its closing metadata counts them; none where it has no such.
    pub fn counted_lost(&self) -> Option<u64> {
        let closing = self.closing.as_ref()?;
        let lost = closing.iter().filter(|(key, _)| key.starts_with("lost "));
        Some(
            lost.filter_map(|(_, value)| value.parse::<u64>().ok())
                .sum(),
        )
    }
}

/// Reads a file from start to end and hands every message of our topics to `visit`, in the file's order.
///
/// # Errors
/// [`ReadError`] with the file's name and the place in it. A file that breaks off is no error: see [`Found::ending`].
pub fn read(path: &Path, visit: impl FnMut(&Recorded)) -> Result<Found, ReadError> {
    let io = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let mut reader = Reader {
        path,
        length,
        byte: 0,
        schemas: BTreeMap::new(),
        channels: BTreeMap::new(),
        found: Found::default(),
        visit,
    };
    reader.read(BufReader::new(file))?;
    Ok(reader.found)
}

/// The identity of the run that a file records, if it is a recording whose head is whole.
pub fn run_of(path: &Path) -> Option<u64> {
    let file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    let mut reader = Reader {
        path,
        length,
        byte: 0,
        schemas: BTreeMap::new(),
        channels: BTreeMap::new(),
        found: Found::default(),
        visit: |_: &Recorded| {},
    };
    reader
        .read_until(BufReader::new(file), |found| found.run_id.is_some())
        .ok()?;
    reader.found.run_id
}

struct Reader<'a, V> {
    path: &'a Path,
    length: u64,
    /// Where the record at hand begins.
    byte: u64,
    schemas: BTreeMap<u16, (String, Vec<u8>)>,
    /// For every channel of ours, its place in [`TOPICS`].
    channels: BTreeMap<u16, usize>,
    found: Found,
    visit: V,
}

/// Whether reading goes on.
#[derive(PartialEq, Eq)]
enum Next {
    Record,
    End,
}

impl<V: FnMut(&Recorded)> Reader<'_, V> {
    fn read(&mut self, file: impl Read) -> Result<(), ReadError> {
        self.read_until(file, |_| false)
    }

    fn read_until(
        &mut self,
        mut file: impl Read,
        enough: impl Fn(&Found) -> bool,
    ) -> Result<(), ReadError> {
        let mut magic = [0; mcap::MAGIC.len()];
        let io = |source| ReadError::Io {
            path: self.path.to_owned(),
            source,
        };
        if self.length < magic.len() as u64 {
            return Err(self.not_mcap());
        }
        file.read_exact(&mut magic).map_err(io)?;
        if magic != mcap::MAGIC {
            return Err(self.not_mcap());
        }
        self.byte = magic.len() as u64;
        let mut body = Vec::new();
        loop {
            let left = self.length - self.byte;
            if left < PREFIX {
                self.cut(if left == 0 {
                    "the file ends without an end mark"
                } else {
                    "the file ends in a record"
                });
                return Ok(());
            }
            let mut prefix = [0; PREFIX as usize];
            file.read_exact(&mut prefix)
                .map_err(|source| self.io(source))?;
            let opcode = prefix[0];
            let mut length = [0; 8];
            length.copy_from_slice(&prefix[1..]);
            let length = u64::from_le_bytes(length);
            let there = length.min(left - PREFIX);
            if there > MOST_BYTES as u64 {
                self.cut(&format!("a record of {length} bytes"));
                return Ok(());
            }
            body.clear();
            body.extend_from_slice(&prefix);
            (&mut file)
                .take(there)
                .read_to_end(&mut body)
                .map_err(|source| self.io(source))?;
            let is_whole = body.len() as u64 == PREFIX + length;
            if !is_whole {
                if opcode == op::CHUNK {
                    self.chunk(&body, false)?;
                }
                self.cut("the file ends in a record");
                return Ok(());
            }
            if opcode == op::CHUNK {
                if let Some(why) = self.chunk(&body, true)? {
                    self.cut(&why);
                    return Ok(());
                }
            } else if self.record(opcode, &body[PREFIX as usize..])? == Next::End {
                return Ok(());
            }
            if enough(&self.found) {
                return Ok(());
            }
            self.byte += PREFIX + length;
        }
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
        let record = match mcap::parse_record(opcode, body) {
            Ok(record) => record,
            Err(error) => {
                self.cut(&format!("a damaged record: {error}"));
                return Ok(Next::End);
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
                    self.check_version(index, channel.schema_id, &channel.message_encoding)?;
                    self.channels.insert(channel.id, index);
                    self.found.channels[index] = true;
                }
            }
            Record::Message { header, data } => {
                if let Some(&topic) = self.channels.get(&header.channel_id) {
                    let message = data
                        .strip_prefix(ENCAPSULATION.as_slice())
                        .and_then(|body| Recorded::from_bytes(topic, body));
                    let Some(message) = message else {
                        let (found, wanted) =
                            (data.len(), ENCAPSULATION.len() + TOPICS[topic].size);
                        return Err(self.version(topic, format!(
                            "a message of {found} bytes, expected {wanted} with little-endian CDR's mark before them"
                        )));
                    };
                    self.found.messages[topic] += 1;
                    (self.visit)(&message);
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
            Record::Footer(_) => {
                let record = self.byte + PREFIX + body.len() as u64;
                let left = self.length.saturating_sub(record);
                if left < mcap::MAGIC.len() as u64 {
                    self.cut("the file ends without an end mark");
                }
                return Ok(Next::End);
            }
            _ => {}
        }
        Ok(Next::Record)
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

    fn check_version(&self, topic: usize, schema: u16, encoding: &str) -> Result<(), ReadError> {
        let known = &TOPICS[topic];
        if encoding != "cdr" {
            return Err(self.version(topic, format!("encoded as {encoding:?}, not \"cdr\"")));
        }
        let Some((name, definition)) = self.schemas.get(&schema) else {
            return Err(self.version(topic, "without a schema".to_owned()));
        };
        let expected = known.ros_type.replacen('/', "/msg/", 1);
        if *name != expected {
            return Err(self.version(topic, format!("{name}, expected {expected}")));
        }
        let (theirs, ours) = (String::from_utf8_lossy(definition), (known.definition)());
        if theirs == ours {
            return Ok(());
        }
        let line = |text: &str, number: usize| {
            text.lines()
                .nth(number)
                .map_or("nothing".to_owned(), |line| format!("{line:?}"))
        };
        let number = (0..)
            .find(|number| line(&theirs, *number) != line(&ours, *number))
            .unwrap_or(0);
        Err(self.version(
            topic,
            format!(
                "line {} of {name} is {}, this program's {}",
                number + 1,
                line(&theirs, number),
                line(&ours, number)
            ),
        ))
    }

    fn version(&self, topic: usize, difference: String) -> ReadError {
        ReadError::Version {
            path: self.path.to_owned(),
            byte: self.byte,
            topic: TOPICS[topic].name,
            difference,
        }
    }

    fn not_mcap(&self) -> ReadError {
        ReadError::NotMcap {
            path: self.path.to_owned(),
        }
    }

    fn io(&self, source: io::Error) -> ReadError {
        ReadError::Io {
            path: self.path.to_owned(),
            source,
        }
    }

    fn cut(&mut self, why: &str) {
        self.found.ending = Ending::Cut {
            byte: self.byte,
            why: why.to_owned(),
        };
    }
}
