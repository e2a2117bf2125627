//! Records of an MCAP file in any state of damage (<https://mcap.dev/spec>).
//!
//! The readers of the `mcap` crate trust the lengths inside a chunk and can panic on a damaged one. These functions
//! trust none: they never read beyond the bytes, and a file that is cut anywhere yields the records before the cut.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;
use mcap::{
    McapError,
    read::ChunkReader,
    records::{ChunkHeader, op},
};

/// Name of LZ4 frame compression in a chunk's header.
pub(crate) const LZ4: &str = "lz4";

/// One record: its opcode, and the part of its content that is in the file.
#[derive(Clone, Copy)]
pub(crate) struct RawRecord<'a> {
    pub(crate) opcode: u8,
    pub(crate) body: &'a [u8],
    /// Offset of the record's first byte in the file, or in its chunk.
    pub(crate) offset: usize,
    /// True if the content would go on beyond the end of the bytes.
    pub(crate) cut: bool,
}

/// Iterator over consecutive records. At most one record is [`RawRecord::cut`], the last.
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
        // Opcode (1 byte) and length (8 bytes, little endian) precede the content.
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

/// Content of a chunk, or why it cannot be read.
pub(crate) enum Chunk<'a> {
    /// Records of the chunk; of a chunk that is cut, those before the cut.
    Records(Vec<RawRecord<'a>>),
    /// The chunk has this compression, which the crate does not read.
    Compressed(String),
    /// The checksum or the structure is wrong, so the numbers in the chunk cannot be trusted.
    Damaged,
}

/// Opens a chunk record; `decompressed` receives the content of a compressed one.
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
            // One byte more than declared shows that the content is too long, and bounds the memory that a damaged
            // chunk takes.
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
    // The checksum covers the whole chunk, so it cannot be verified when part is missing.
    if record.cut {
        return Chunk::Records(Records::new(data, 0).filter(|record| !record.cut).collect());
    }
    let records: Vec<_> = Records::new(data, 0).collect();
    // `ChunkReader` panics on other records, and no others belong into a chunk.
    let sound = |record: &RawRecord| !record.cut && matches!(record.opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
    // The declared size is checked before `ChunkReader` relies on it.
    let whole = data.len() as u64 == header.uncompressed_size;
    let checked = || ChunkReader::new(header.clone(), data)?.try_for_each(|record| record.map(|_| ()));
    match (whole && records.iter().all(sound)).then(checked) {
        Some(Ok::<(), McapError>(())) => Chunk::Records(records),
        Some(Err(_)) | None => Chunk::Damaged,
    }
}

/// Reader of fields from the front of the bytes; each method returns `None` if too few bytes are left.
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
