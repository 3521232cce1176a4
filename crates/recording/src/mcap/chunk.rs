//! Chunks: what their head says, and the records in them, decompressed.
//!
//! A chunk says twice how long it is: in its record's length and in that of its content. So a head
//! whose lengths agree is taken for one whatever it holds, and one that holds less than it says
//! shows by its checksum.

use std::io::{Cursor, Read};

use lz4_flex::frame::FrameDecoder as Lz4Decoder;
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

/// Longest chunk taken, as it is stored and decompressed; other programs write 0.8 to 4 MB.
pub(super) const MAX_CHUNK_BYTES: usize = 128 << 20;
/// Head of a chunk's body with the longest name of a compression.
pub(super) const CHUNK_HEAD_BYTES: usize = FIXED_BYTES + MAX_NAME_BYTES;
/// Two times, length and checksum of the records, length of the name, length of the content.
pub(super) const FIXED_BYTES: usize = 8 + 8 + 8 + 4 + 4 + 8;
const MAX_NAME_BYTES: usize = 16;
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
const LZ4_MAGIC: [u8; 4] = [0x04, 0x22, 0x4d, 0x18];
/// A last, empty block of zstd, and a checksum that nobody asks for.
const ZSTD_END: [u8; 7] = [1, 0, 0, 0, 0, 0, 0];

/// What a chunk says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChunkHead {
    /// Of the records in it.
    record_byte_count: u64,
    /// CRC-32 of them; 0 for none.
    checksum: u32,
    compression: String,
    /// Where in the body the content begins.
    content_at: usize,
}

/// The records of a chunk.
pub(super) struct Content {
    pub(super) bytes: Vec<u8>,
    /// They are those that were written, to the last byte.
    pub(super) is_sound: bool,
    /// How many more there should be.
    pub(super) missing_byte_count: u64,
}

impl ChunkHead {
    /// Of a body with this beginning and length; `None` if its lengths do not agree.
    pub(super) fn read(start: &[u8], length: u64) -> Option<Self> {
        let u32_at = |at: usize| Some(u32::from_le_bytes(*start.get(at..)?.first_chunk()?));
        let u64_at = |at: usize| Some(u64::from_le_bytes(*start.get(at..)?.first_chunk()?));
        let name_bytes = u32_at(28)? as usize;
        if name_bytes > MAX_NAME_BYTES {
            return None;
        }
        let name = start.get(32..32 + name_bytes)?;
        let content_at = FIXED_BYTES + name_bytes;
        let content_bytes = u64_at(content_at - 8)?;
        (content_bytes.checked_add(content_at as u64)? == length).then(|| Self {
            record_byte_count: u64_at(16).unwrap_or(0),
            checksum: u32_at(24).unwrap_or(0),
            compression: String::from_utf8_lossy(name).into_owned(),
            content_at,
        })
    }

    /// Whether a record with this beginning is the head of a chunk that has not ended: it says no
    /// length, and its records follow one by one.
    pub(super) fn is_open(record: &[u8]) -> bool {
        let all_set = |at: usize| record.get(at..at + 8) == Some(&[0xff; 8]);
        let no_name = record.get(37..41) == Some(&[0; 4]);
        // Length of the record, of the records in it and of the content, as the `mcap` library writes
        // them before it knows them.
        all_set(1) && all_set(25) && no_name && all_set(41)
    }

    /// Whether its records stand there as they were written.
    pub(super) fn is_plain(&self) -> bool {
        self.compression.is_empty()
    }

    /// How long a body with this beginning says that it is.
    pub(super) fn length_said(start: &[u8]) -> Option<u64> {
        let name_bytes = u32::from_le_bytes(*start.get(28..)?.first_chunk()?) as usize;
        let content_at = FIXED_BYTES + name_bytes.min(MAX_NAME_BYTES);
        let said = start.get(content_at - 8..)?.first_chunk()?;
        u64::from_le_bytes(*said).checked_add(content_at as u64)
    }

    /// Whether a body begins with a head and goes on with what that says.
    pub(super) fn is_of(body: &[u8]) -> bool {
        let head = Self::read(body, body.len() as u64);
        head.is_some_and(|head| head.content(body).is_sound)
    }

    /// The records in this body, which may be cut or damaged: then those before that. No more is
    /// decompressed than the head says.
    pub(super) fn content(&self, body: &[u8]) -> Content {
        let stored = body.get(self.content_at..).unwrap_or_default();
        let said = usize::try_from(self.record_byte_count).unwrap_or(usize::MAX);
        let most = said.min(MAX_CHUNK_BYTES);
        let bytes = match self.compression.as_str() {
            // What stands there counts, also where its length in the head is damaged.
            "" => stored[..stored.len().min(MAX_CHUNK_BYTES)].to_vec(),
            // What a damaged name says, the content says too.
            "zstd" => zstd(stored, most),
            "lz4" => lz4(stored, most),
            _ if stored.starts_with(&ZSTD_MAGIC) => zstd(stored, most),
            _ if stored.starts_with(&LZ4_MAGIC) => lz4(stored, most),
            _ => Vec::new(),
        };
        let is_whole = bytes.len() as u64 == self.record_byte_count;
        let is_right = self.checksum == 0 || crc32fast::hash(&bytes) == self.checksum;
        Content {
            is_sound: is_whole && is_right,
            missing_byte_count: self.record_byte_count.saturating_sub(bytes.len() as u64),
            bytes,
        }
    }
}

fn lz4(stored: &[u8], most: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut decoder = Lz4Decoder::new(Cursor::new(stored));
    loop {
        let before = bytes.len();
        let left = (most - before) as u64;
        // What came before the damage is kept.
        let read = decoder.by_ref().take(left).read_to_end(&mut bytes);
        // Another frame may follow.
        if read.is_err() || bytes.len() == before {
            return bytes;
        }
    }
}

fn zstd(stored: &[u8], most: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = stored;
    while !rest.is_empty() && bytes.len() < most {
        match zstd_frame(rest, most, &mut bytes) {
            Some(used) => rest = &rest[used..],
            None => break,
        }
    }
    bytes.truncate(most);
    bytes
}

/// Appends what a frame holds, and says how long the frame is; `None` if it is cut or damaged, or
/// holds more than `most` bytes.
fn zstd_frame(stored: &[u8], most: usize, bytes: &mut Vec<u8>) -> Option<usize> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(MAX_CHUNK_BYTES as u64);
    let mut rest = stored;
    decoder.reset(&mut rest).ok()?;
    let begin = bytes.len();
    while !decoder.is_finished() {
        let sound = stored.len() - rest.len();
        let block = decoder.decode_blocks(&mut rest, BlockDecodingStrategy::UptoBlocks(1));
        if block.is_err() {
            // The decoder keeps what later blocks may point back to until the frame has ended: so
            // the blocks that are sound are made a frame of their own.
            let shorter = [&stored[..sound], &ZSTD_END].concat();
            if shorter.len() < stored.len() + ZSTD_END.len() {
                bytes.truncate(begin);
                zstd_frame(&shorter, most, bytes);
            }
            return None;
        }
        decoder.collect_to_writer(&mut *bytes).ok()?;
        if bytes.len() > most {
            return None;
        }
    }
    decoder.collect_to_writer(&mut *bytes).ok()?;
    Some(stored.len() - rest.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A frame of one block that is stored as it is, and one that repeats a byte.
    fn zstd_frame_of(text: &[u8], repeated: u8, count: u32) -> Vec<u8> {
        let block = |kind: u32, size: u32, is_last: u32| (size << 3) | (kind << 1) | is_last;
        let head = |block: u32| block.to_le_bytes()[..3].to_vec();
        let mut frame = ZSTD_MAGIC.to_vec();
        // No length of the content, a window of 1 MiB.
        frame.extend([0x00, 10 << 3]);
        frame.extend(head(block(0, text.len() as u32, 0)));
        frame.extend(text);
        frame.extend(head(block(1, count, 1)));
        frame.push(repeated);
        frame
    }

    fn head(compression: &str, records: &[u8]) -> ChunkHead {
        ChunkHead {
            record_byte_count: records.len() as u64,
            checksum: crc32fast::hash(records),
            compression: compression.to_owned(),
            content_at: 0,
        }
    }

    #[test]
    fn a_cut_frame_gives_what_stood_before_the_cut() {
        let frame = zstd_frame_of(b"some records", b'x', 1000);
        let whole = [&b"some records"[..], &[b'x'; 1000]].concat();
        let content = head("zstd", &whole).content(&frame);
        assert!(content.is_sound && content.bytes == whole);
        let cut = head("zstd", &whole).content(&frame[..frame.len() - 1]);
        assert_eq!(
            (cut.bytes.as_slice(), cut.is_sound),
            (&b"some records"[..], false)
        );
        assert_eq!(cut.missing_byte_count, 1000);
    }

    #[test]
    fn no_more_comes_out_than_the_head_says() {
        let frame = zstd_frame_of(b"", 0, 100_000);
        let content = head("zstd", &[0; 10]).content(&frame);
        assert_eq!(content.bytes, [0; 10]);
        let stored = head("", b"abc").content(b"abcdef");
        assert!(!stored.is_sound && stored.bytes == b"abcdef");
    }

    #[test]
    fn a_head_whose_lengths_disagree_is_none() {
        let mut body = vec![0; 28];
        body.extend(4_u32.to_le_bytes());
        body.extend(b"zstd");
        body.extend(7_u64.to_le_bytes());
        let length = body.len() as u64 + 7;
        assert!(ChunkHead::read(&body, length).is_some());
        assert!(ChunkHead::read(&body, length + 1).is_none());
        for end in 0..body.len() {
            assert!(ChunkHead::read(&body[..end], length).is_none());
        }
    }

    proptest! {
        #[test]
        fn no_bytes_upset_it(
            junk in proptest::collection::vec(any::<u8>(), 0..300), at in 0_usize..40,
        ) {
            for (name, magic) in [("zstd", ZSTD_MAGIC), ("lz4", LZ4_MAGIC)] {
                let bytes = [&magic[..], &junk].concat();
                prop_assert!(head(name, &[0; 64]).content(&bytes).bytes.len() <= 64);
            }
            let mut frame = zstd_frame_of(b"some records", b'x', 100);
            let at = at % frame.len();
            frame[at] ^= 1 + junk.first().unwrap_or(&0) / 2;
            prop_assert!(head("zstd", &[0; 112]).content(&frame).bytes.len() <= 112);
        }
    }
}
