//! Writer of MCAP files with compressed chunks (<https://mcap.dev/spec>).
//!
//! The writer of the `mcap` crate compresses only with C libraries, and takes no other compressor. This one writes
//! the same records, and compresses chunks as LZ4 frames in Rust.

use std::{
    collections::BTreeMap,
    io::{self, Cursor, Write},
};

use binrw::BinWrite;
use lz4_flex::frame::FrameEncoder;
use mcap::{
    MAGIC,
    records::{
        Channel, ChunkHeader, ChunkIndex, DataEnd, Header, MessageHeader, MessageIndex, MessageIndexEntry, Metadata,
        MetadataIndex, SchemaHeader, Statistics, SummaryOffset, op,
    },
};

use crate::container::LZ4;

/// Size at which a chunk is closed, bytes: 256 KiB are about 0.4 s of four motors at 1 kHz. The demo's log compresses
/// 4 % worse in chunks of 64 KiB, and 0.5 % better in chunks of 1 MiB.
const CHUNK_BYTES: usize = 256 * 1024;
/// Duration at which a chunk is closed, ns: the most that is lost when the recording program is killed. Without a
/// limit the demo's log compresses 2 % better.
const CHUNK_NS: u64 = 1_000_000_000;

/// Appends a record with the content `body`, then `tail`.
fn push(bytes: &mut Vec<u8>, opcode: u8, body: &impl for<'a> BinWrite<Args<'a> = ()>, tail: &[u8]) -> io::Result<()> {
    bytes.push(opcode);
    let length_at = bytes.len();
    // Placeholder of the length, which is known only after the body is encoded.
    bytes.extend([0; 8]);
    let mut cursor = Cursor::new(&mut *bytes);
    cursor.set_position((length_at + 8) as u64);
    body.write_le(&mut cursor).map_err(io::Error::other)?;
    bytes.extend(tail);
    let length = (bytes.len() - length_at - 8) as u64;
    bytes[length_at..length_at + 8].copy_from_slice(&length.to_le_bytes());
    Ok(())
}

/// Chunk that is being filled with records.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    /// Log times of its earliest and latest message, ns; `None` before the first.
    times: Option<(u64, u64)>,
    /// Time and offset of each message in the chunk, by channel.
    indexes: BTreeMap<u16, Vec<MessageIndexEntry>>,
}

/// Topic of an MCAP file with its schema.
#[derive(Clone, Copy, Debug)]
pub struct McapTopic<'a> {
    /// Name of the topic, which begins with a slash.
    pub name: &'a str,
    /// Name of the schema; topics with the same schema name share the schema of the first.
    pub schema: &'a str,
    /// Encoding of the schema as MCAP's registry names it: `jsonschema`, `ros2msg`.
    pub schema_encoding: &'a str,
    /// Text of the schema.
    pub schema_text: &'a str,
    /// Encoding of the messages: `json`, `cdr`.
    pub encoding: &'a str,
    /// Keys and values for readers of the file's profile.
    pub metadata: &'a [(&'a str, &'a str)],
}

/// Writer of an MCAP file with LZ4 chunks of at most a second each.
///
/// It writes from the beginning to the end without going back, so `out` need not be seekable.
pub struct McapWriter<W: Write> {
    /// Destination; `None` once it is returned.
    out: Option<W>,
    /// Number of bytes written.
    position: u64,
    /// Checksum of the bytes written.
    crc: crc32fast::Hasher,
    /// Kind of the first write error: nothing is written after it.
    failed: Option<io::ErrorKind>,
    schema_ids: BTreeMap<String, u16>,
    /// Schema records, which the summary repeats.
    schemas: Vec<u8>,
    channels: Vec<u8>,
    chunk: Chunk,
    chunk_indexes: Vec<ChunkIndex>,
    metadata_indexes: Vec<MetadataIndex>,
    statistics: Statistics,
}

impl<W: Write> McapWriter<W> {
    /// Starts a file with at most one metadata record.
    ///
    /// `profile` is MCAP's name of the file's conventions (empty for none), `library` the name of the writing library.
    ///
    /// # Errors
    /// Errors of `out`, and of encoding the records.
    pub fn new(out: W, profile: &str, library: &str, metadata: Option<Metadata>) -> io::Result<Self> {
        let mut writer = Self {
            out: Some(out),
            position: 0,
            crc: crc32fast::Hasher::new(),
            failed: None,
            schema_ids: BTreeMap::new(),
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk: Chunk::default(),
            chunk_indexes: Vec::new(),
            metadata_indexes: Vec::new(),
            statistics: Statistics::default(),
        };
        let mut bytes = MAGIC.to_vec();
        push(&mut bytes, op::HEADER, &Header { profile: profile.to_owned(), library: library.to_owned() }, &[])?;
        if let Some(metadata) = metadata {
            let offset = bytes.len() as u64;
            push(&mut bytes, op::METADATA, &metadata, &[])?;
            let length = bytes.len() as u64 - offset;
            writer.metadata_indexes.push(MetadataIndex { offset, length, name: metadata.name });
            writer.statistics.metadata_count = 1;
        }
        writer.emit(&bytes)?;
        writer.flush()?;
        Ok(writer)
    }

    /// Declares a topic and returns its number.
    ///
    /// # Errors
    /// More than 65536 topics, which are numbered from 0, or more than 65535 schemas, from 1.
    pub fn topic(&mut self, topic: &McapTopic<'_>) -> io::Result<u16> {
        let full = |most: u32, what: &str| io::Error::other(format!("a log holds at most {most} {what}"));
        let schema_id = match self.schema_ids.get(topic.schema) {
            Some(id) => *id,
            None => {
                // Schema number 0 means "no schema" in MCAP.
                let id = u16::try_from(self.schema_ids.len() + 1).map_err(|_| full(65_535, "schemas"))?;
                let (name, encoding) = (topic.schema.to_owned(), topic.schema_encoding.to_owned());
                let text = topic.schema_text.as_bytes();
                let data = [&(text.len() as u32).to_le_bytes(), text].concat();
                let begin = self.schemas.len();
                push(&mut self.schemas, op::SCHEMA, &SchemaHeader { id, name, encoding }, &data)?;
                // A reader needs the schema before the first topic that refers to it.
                self.chunk.records.extend(&self.schemas[begin..]);
                self.schema_ids.insert(topic.schema.to_owned(), id);
                self.statistics.schema_count += 1;
                id
            }
        };
        let id = u16::try_from(self.statistics.channel_count).map_err(|_| full(65_536, "topics"))?;
        let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        let metadata = topic.metadata.iter().map(owned).collect();
        let (topic, message_encoding) = (topic.name.to_owned(), topic.encoding.to_owned());
        let channel = Channel { id, schema_id, topic, message_encoding, metadata };
        let begin = self.channels.len();
        push(&mut self.channels, op::CHANNEL, &channel, &[])?;
        // A reader needs the topic before its first message.
        self.chunk.records.extend(&self.channels[begin..]);
        self.statistics.channel_count += 1;
        Ok(id)
    }

    /// Writes a message of a topic that [`topic`](Self::topic) has declared.
    ///
    /// # Errors
    /// Errors of the writer; after the first one nothing more is written.
    pub fn message(&mut self, header: &MessageHeader, data: &[u8]) -> io::Result<()> {
        let time = header.log_time;
        if self.chunk.times.is_some_and(|(first, _)| time.saturating_sub(first) >= CHUNK_NS) {
            self.end_chunk()?;
        }
        let chunk = &mut self.chunk;
        let offset = chunk.records.len() as u64;
        push(&mut chunk.records, op::MESSAGE, header, data)?;
        chunk.indexes.entry(header.channel_id).or_default().push(MessageIndexEntry { log_time: time, offset });
        let (first, last) = chunk.times.unwrap_or((time, time));
        chunk.times = Some((first.min(time), last.max(time)));
        let of_all = &mut self.statistics;
        let whole_file = (of_all.message_start_time.min(time), of_all.message_end_time.max(time));
        // Before the first message the statistics hold zeros, which are no times.
        let none_before = of_all.message_count == 0;
        (of_all.message_start_time, of_all.message_end_time) = if none_before { (time, time) } else { whole_file };
        of_all.message_count += 1;
        *of_all.channel_message_counts.entry(header.channel_id).or_default() += 1;
        if chunk.records.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    /// Compresses and writes the chunk with its indexes.
    fn end_chunk(&mut self) -> io::Result<()> {
        let Chunk { records, times, indexes } = std::mem::take(&mut self.chunk);
        if records.is_empty() {
            return Ok(());
        }
        // The chunk is compressed in memory, because its header contains the compressed size.
        let mut encoder = FrameEncoder::new(Vec::with_capacity(records.len() / 4));
        encoder.write_all(&records)?;
        let compressed = encoder.finish().map_err(io::Error::other)?;
        let (message_start_time, message_end_time) = times.unwrap_or_default();
        let header = ChunkHeader {
            message_start_time,
            message_end_time,
            uncompressed_size: records.len() as u64,
            uncompressed_crc: crc32fast::hash(&records),
            compression: LZ4.to_owned(),
            compressed_size: compressed.len() as u64,
        };
        let chunk_start_offset = self.position;
        let mut bytes = Vec::with_capacity(compressed.len() + 1024);
        push(&mut bytes, op::CHUNK, &header, &compressed)?;
        let chunk_length = bytes.len() as u64;
        let mut message_index_offsets = BTreeMap::new();
        for (channel_id, mut records) in indexes {
            // The specification requires the entries of an index in order of time.
            records.sort_by_key(|entry| entry.log_time);
            message_index_offsets.insert(channel_id, chunk_start_offset + bytes.len() as u64);
            push(&mut bytes, op::MESSAGE_INDEX, &MessageIndex { channel_id, records }, &[])?;
        }
        self.chunk_indexes.push(ChunkIndex {
            message_start_time,
            message_end_time,
            chunk_start_offset,
            chunk_length,
            message_index_offsets,
            message_index_length: bytes.len() as u64 - chunk_length,
            compression: header.compression,
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        });
        self.statistics.chunk_count += 1;
        self.emit(&bytes)?;
        self.flush()
    }

    /// Writes the last chunk and the summary, and returns the writer.
    ///
    /// # Errors
    /// Errors of the writer, also an earlier one.
    pub fn finish(mut self) -> io::Result<W> {
        self.end()?;
        self.out.take().ok_or_else(|| io::ErrorKind::BrokenPipe.into())
    }

    /// Writes the last chunk, the end of the data, and the summary.
    fn end(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        let mut bytes = Vec::new();
        push(&mut bytes, op::DATA_END, &DataEnd { data_section_crc: self.crc.clone().finalize() }, &[])?;
        self.emit(&bytes)?;

        let begin = self.position;
        let mut summary = Vec::new();
        let mut groups = Vec::new();
        let mut group = |summary: &Vec<u8>, group_opcode, from: usize| {
            if summary.len() > from {
                let (group_start, group_length) = (begin + from as u64, (summary.len() - from) as u64);
                groups.push(SummaryOffset { group_opcode, group_start, group_length });
            }
            summary.len()
        };
        summary.extend(&self.schemas);
        let at = group(&summary, op::SCHEMA, 0);
        summary.extend(&self.channels);
        let at = group(&summary, op::CHANNEL, at);
        push(&mut summary, op::STATISTICS, &self.statistics, &[])?;
        let at = group(&summary, op::STATISTICS, at);
        for index in &self.chunk_indexes {
            push(&mut summary, op::CHUNK_INDEX, index, &[])?;
        }
        let at = group(&summary, op::CHUNK_INDEX, at);
        for index in &self.metadata_indexes {
            push(&mut summary, op::METADATA_INDEX, index, &[])?;
        }
        let at = group(&summary, op::METADATA_INDEX, at);
        for offset in &groups {
            push(&mut summary, op::SUMMARY_OFFSET, offset, &[])?;
        }
        // The footer's checksum covers the summary and the footer up to itself, so the record is assembled by hand.
        summary.push(op::FOOTER);
        summary.extend(20_u64.to_le_bytes());
        summary.extend(begin.to_le_bytes());
        summary.extend((begin + at as u64).to_le_bytes());
        summary.extend(crc32fast::hash(&summary).to_le_bytes());
        summary.extend(MAGIC);
        self.emit(&summary)?;
        self.flush()
    }

    fn emit(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.attempt(|out| out.write_all(bytes))?;
        self.position += bytes.len() as u64;
        self.crc.update(bytes);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.attempt(W::flush)
    }

    /// Runs a write unless an earlier one failed: further bytes would not be where the indexes say.
    fn attempt(&mut self, write: impl FnOnce(&mut W) -> io::Result<()>) -> io::Result<()> {
        if let Some(kind) = self.failed {
            return Err(kind.into());
        }
        // `None` means that `finish` has returned the writer already.
        let Some(out) = &mut self.out else { return Err(io::ErrorKind::BrokenPipe.into()) };
        write(out).inspect_err(|error| self.failed = Some(error.kind()))
    }
}

/// Finishes a recording that is dropped, as far as possible.
impl<W: Write> Drop for McapWriter<W> {
    fn drop(&mut self) {
        if self.out.is_some() {
            // A drop cannot report an error; the file then lacks its summary, and readers scan its chunks.
            let _ = self.end();
        }
    }
}
