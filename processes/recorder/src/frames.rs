//! The records of an MCAP file one after the other, and the way back to them where bytes were changed.
//!
//! Nothing is believed about lengths: a record never takes more memory than the file has bytes. Where what should be a
//! record is none, the next chunk is looked for: a chunk says its own length twice, so that hardly anything else looks
//! like one.

use mcap::records::op;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

/// The largest record that is read: a thousand times what the recorder writes.
pub const MOST_BYTES: usize = 256 << 20;
/// Kind and length before every record.
pub const PREFIX: usize = 9;
/// Bytes searched at a time for a chunk, and how many of them tell whether one begins.
const WINDOW: usize = 1 << 20;
const CHUNK_HEAD: usize = PREFIX + 40 + LONGEST_COMPRESSION;
/// Characters in the longest name of a compression.
const LONGEST_COMPRESSION: usize = 4;

/// What stands at a place of the file.
#[derive(Debug, PartialEq, Eq)]
pub enum Frame {
    /// A whole record of this kind; its bytes are [`Frames::bytes_mut`].
    Whole(u8),
    /// The beginning of a record of this kind, to the end of the file.
    Short(u8),
    /// No record.
    None(String),
    /// The end of the file, before its end mark.
    End,
}

/// A file's records.
pub struct Frames {
    file: BufReader<File>,
    length: u64,
    /// Where the record begins that was read last, and the next.
    start: u64,
    next: u64,
    bytes: Vec<u8>,
    /// Over all bytes so far; none once some were passed over.
    checksum: Option<crc32fast::Hasher>,
}

impl Frames {
    /// Begins behind the file's magic bytes; none if it has no such.
    ///
    /// # Errors
    /// The system's.
    pub fn open(file: File) -> io::Result<Option<Self>> {
        let length = file.metadata()?.len();
        let mut file = BufReader::new(file);
        let mut magic = [0; mcap::MAGIC.len()];
        if length < magic.len() as u64 {
            return Ok(None);
        }
        file.read_exact(&mut magic)?;
        if magic != mcap::MAGIC {
            return Ok(None);
        }
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&magic);
        let start = magic.len() as u64;
        Ok(Some(Self {
            file,
            length,
            start,
            next: start,
            bytes: Vec::new(),
            checksum: Some(checksum),
        }))
    }

    /// Where the record begins that was read last.
    pub fn start(&self) -> u64 {
        self.start
    }

    /// Where it ends.
    pub fn end(&self) -> u64 {
        self.next
    }

    /// The record that was read last, with its prefix. Whoever takes it puts it back before the next is read.
    pub fn bytes_mut(&mut self) -> &mut Vec<u8> {
        &mut self.bytes
    }

    /// Bytes of the file behind that record.
    pub fn left(&self) -> u64 {
        self.length - self.next
    }

    /// CRC-32 of the file up to the record that was read last; none if some bytes were passed over.
    pub fn checksum(&self) -> Option<u32> {
        self.checksum.clone().map(crc32fast::Hasher::finalize)
    }

    /// Reads the next record.
    ///
    /// # Errors
    /// The system's.
    pub fn read(&mut self) -> io::Result<Frame> {
        if let Some(checksum) = &mut self.checksum {
            checksum.update(&self.bytes);
        }
        self.bytes.clear();
        self.start = self.next;
        if self.left() == 0 {
            return Ok(Frame::End);
        }
        let (opcode, length) = match self.prefix()? {
            Some(prefix) => prefix,
            None => return Ok(Frame::Short(0)),
        };
        let there = length.min(self.left());
        if !(op::HEADER..=op::DATA_END).contains(&opcode) && opcode < 0x80 {
            return Ok(Frame::None(format!("no record (kind {opcode:#04x})")));
        }
        if there > MOST_BYTES as u64 {
            return Ok(Frame::None(format!("a record of {length} bytes")));
        }
        (&mut self.file).take(there).read_to_end(&mut self.bytes)?;
        self.next += there;
        Ok(match there == length {
            true => Frame::Whole(opcode),
            false => Frame::Short(opcode),
        })
    }

    /// Kind and length of the next record; none where the file ends in them.
    fn prefix(&mut self) -> io::Result<Option<(u8, u64)>> {
        if self.left() < PREFIX as u64 {
            return Ok(None);
        }
        let mut prefix = [0; PREFIX];
        self.file.read_exact(&mut prefix)?;
        self.bytes.extend_from_slice(&prefix);
        self.next += PREFIX as u64;
        let [opcode, length @ ..] = prefix;
        Ok(Some((opcode, u64::from_le_bytes(length))))
    }

    /// Goes on at another place.
    ///
    /// # Errors
    /// The system's.
    pub fn seek(&mut self, byte: u64) -> io::Result<()> {
        self.checksum = None;
        self.bytes.clear();
        self.next = self.file.seek(SeekFrom::Start(byte))?;
        Ok(())
    }

    /// Where the last whole chunks begin that follow the place at which reading stands: the last but one and the last,
    /// found without reading any.
    ///
    /// # Errors
    /// The system's.
    pub fn last_chunks(&mut self) -> io::Result<[Option<u64>; 2]> {
        let mut last = [None; 2];
        loop {
            let start = self.next;
            self.bytes.clear();
            let Some((opcode, length)) = self.prefix()? else {
                return Ok(last);
            };
            if length > self.left() {
                return Ok(last);
            }
            if opcode == op::CHUNK {
                last = [last[1], Some(start)];
            }
            self.seek(self.next + length)?;
        }
    }

    /// Where the summary behind the messages begins, as the file's last record says.
    ///
    /// # Errors
    /// The system's.
    pub fn summary(&mut self) -> io::Result<Option<u64>> {
        const FOOTER: usize = PREFIX + 20;
        let place = (self.length).saturating_sub((FOOTER + mcap::MAGIC.len()) as u64);
        let mut footer = [0; FOOTER];
        self.seek(place)?;
        self.file.read_exact(&mut footer)?;
        let mut start = [0; 8];
        start.copy_from_slice(&footer[PREFIX..][..8]);
        let start = u64::from_le_bytes(start);
        let is_footer = footer[0] == op::FOOTER && (1..place).contains(&start);
        Ok(is_footer.then_some(start))
    }

    /// Where the first chunk begins from this place on.
    ///
    /// # Errors
    /// The system's.
    pub fn find_chunk(&mut self, from: u64) -> io::Result<Option<u64>> {
        let mut window = Vec::new();
        let mut start = from;
        while start < self.length {
            self.file.seek(SeekFrom::Start(start))?;
            window.clear();
            (&mut self.file)
                .take((WINDOW + CHUNK_HEAD) as u64)
                .read_to_end(&mut window)?;
            let begins = |place: &usize| {
                let left = self.length - start - *place as u64;
                is_chunk(&window[*place..], left)
            };
            if let Some(place) = (0..window.len().min(WINDOW)).find(begins) {
                return Ok(Some(start + place as u64));
            }
            start += WINDOW as u64;
        }
        Ok(None)
    }
}

/// Whether a whole chunk begins here, with `left` bytes to the end of the file.
pub fn is_chunk(bytes: &[u8], left: u64) -> bool {
    let number = |place: usize, size: usize| {
        let bytes = bytes.get(place..place.checked_add(size)?)?;
        let mut number = [0; 8];
        number[..size].copy_from_slice(bytes);
        Some(u64::from_le_bytes(number))
    };
    let says = || {
        let length = number(1, 8)?;
        let name = number(PREFIX + 28, 4)?;
        let compressed = number(PREFIX + 32 + usize::try_from(name).ok()?, 8)?;
        let said = (name <= LONGEST_COMPRESSION as u64).then(|| compressed.checked_add(40 + name));
        Some(said?? == length && length <= left.saturating_sub(PREFIX as u64))
    };
    bytes.first() == Some(&op::CHUNK) && says().unwrap_or(false)
}
