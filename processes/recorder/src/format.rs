//! How our MCAP files are written, and closed where the writer cannot do it any more.

use mcap::records::Metadata;
use mcap::{Compression, McapError, WriteOptions};
use std::io::{self, Cursor};

/// Chunks are buffered so that each is one write, and compressed on the caller's thread.
pub fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("mirror ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .chunk_size(None)
        .disable_seeking(true)
}

/// The records that close a file without an index: what an empty MCAP file with `metadata` has behind its head.
pub fn closing(metadata: &Metadata) -> Result<Vec<u8>, McapError> {
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

/// What the writer says, in the words of the system where the system refused.
pub fn reason(error: &McapError) -> String {
    let io = match error {
        McapError::Io(io) => io,
        other => return other.to_string(),
    };
    match io.kind() {
        io::ErrorKind::StorageFull => "no space left on device".to_owned(),
        io::ErrorKind::QuotaExceeded => "disk quota exceeded".to_owned(),
        io::ErrorKind::FileTooLarge => "the file may not grow any further".to_owned(),
        _ => io.to_string(),
    }
}
