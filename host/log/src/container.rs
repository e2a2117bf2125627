//! The records of an MCAP file, whatever state it is in (<https://mcap.dev/spec>).
//!
//! The readers of the `mcap` crate trust the lengths inside a chunk and can panic on a damaged one. This walk trusts
//! nothing: it never reads beyond what is there, and a file cut anywhere gives the records before the cut.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;
use mcap::{
    McapError,
    read::ChunkReader,
    records::{ChunkHeader, op},
};

/// Name of the compression whose chunks are LZ4 frames.
pub(crate) const LZ4: &str = "lz4";

/// One record: its opcode, and what is there of its content.
#[derive(Clone, Copy)]
pub(crate) struct RawRecord<'a> {
    pub(crate) opcode: u8,
    pub(crate) body: &'a [u8],
    /// Byte of the file, or of the chunk, at which the record starts.
    pub(crate) offset: usize,
    /// The content goes on after the end.
    pub(crate) cut: bool,
}

/// Walks records that follow each other; ends with at most one record that is [`RawRecord::cut`].
pub(crate) struct Records<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Records<'a> {
    pub(crate) fn new(bytes: &'a [u8], offset: usize) -> Self {
        Self { bytes, offset }
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = RawRecord<'a>;

    fn next(&mut self) -> Option<RawRecord<'a>> {
        let rest = self.bytes.get(self.offset..).filter(|rest| !rest.is_empty())?;
        let offset = self.offset;
        let mut fields = Fields { rest };
        let (opcode, length) = (fields.u8(), fields.u64());
        let available = fields.rest;
        let (Some(opcode), Some(length)) = (opcode, length) else {
            self.offset = self.bytes.len();
            return Some(RawRecord { opcode: opcode.unwrap_or_default(), body: &[], offset, cut: true });
        };
        let body = usize::try_from(length).ok().and_then(|length| available.get(..length));
        self.offset = body.map_or(self.bytes.len(), |body| self.bytes.len() - available.len() + body.len());
        Some(RawRecord { opcode, body: body.unwrap_or(available), offset, cut: body.is_none() })
    }
}

/// What became of a chunk.
pub(crate) enum Chunk<'a> {
    /// Its records; of a chunk that is cut, those before the cut.
    Records(Vec<RawRecord<'a>>),
    /// It is compressed in a way that this program does not read.
    Compressed(String),
    /// Its checksum or its structure is wrong: the numbers in it cannot be trusted.
    Damaged,
}

/// Opens a chunk record; `decompressed` gets its content where that is compressed.
pub(crate) fn chunk<'a>(record: &RawRecord<'a>, decompressed: &'a mut Vec<u8>) -> Chunk<'a> {
    let mut fields = Fields { rest: record.body };
    let Some(mut header) = fields.chunk_header() else {
        return if record.cut { Chunk::Records(Vec::new()) } else { Chunk::Damaged };
    };
    let length = usize::try_from(header.compressed_size).unwrap_or(usize::MAX);
    let data = match fields.rest.get(..length) {
        Some(data) => data,
        None if record.cut => fields.rest,
        None => return Chunk::Damaged,
    };
    let data = match header.compression.as_str() {
        "" => data,
        LZ4 => {
            // One byte more than there should be is enough to see that it is too much.
            let most = header.uncompressed_size.saturating_add(1);
            let read = FrameDecoder::new(data).take(most).read_to_end(decompressed);
            if read.is_err() && !record.cut {
                return Chunk::Damaged;
            }
            (header.compression, header.compressed_size) = (String::new(), header.uncompressed_size);
            decompressed
        }
        _ => return Chunk::Compressed(header.compression),
    };
    if record.cut {
        return Chunk::Records(Records::new(data, 0).filter(|record| !record.cut).collect());
    }
    let records: Vec<_> = Records::new(data, 0).collect();
    // Only on these does `ChunkReader` not panic, and no others belong into a chunk.
    let sound = |record: &RawRecord| !record.cut && matches!(record.opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
    let whole = data.len() as u64 == header.uncompressed_size;
    let checked = || ChunkReader::new(header.clone(), data)?.try_for_each(|record| record.map(|_| ()));
    match (whole && records.iter().all(sound)).then(checked) {
        Some(Ok::<(), McapError>(())) => Chunk::Records(records),
        Some(Err(_)) | None => Chunk::Damaged,
    }
}

/// Takes fields off the front; `None` where too few bytes are left.
struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (array, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*array)
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = usize::try_from(self.u32()?).ok()?;
        let (text, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        std::str::from_utf8(text).ok()
    }

    fn chunk_header(&mut self) -> Option<ChunkHeader> {
        Some(ChunkHeader {
            message_start_time: self.u64()?,
            message_end_time: self.u64()?,
            uncompressed_size: self.u64()?,
            uncompressed_crc: self.u32()?,
            compression: self.text()?.to_owned(),
            compressed_size: self.u64()?,
        })
    }
}
