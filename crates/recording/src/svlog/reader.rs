//! A log as pieces of bytes, once it is clear that it is one.

use std::io::{ErrorKind, Read};

use echosplat_firmware_protocol::{Decoder, Event};

use super::SvlogError;

const PIECE_BYTES: usize = 64 << 10;
/// Damage at the start may be this long before a file counts as something else.
const SEARCHED_BYTES: usize = 1 << 20;

/// How a log ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tail {
    /// With the last byte of a frame.
    Whole,
    /// With bytes that are in no frame: a cut one, or noise.
    Cut {
        /// How many.
        byte_count: usize,
    },
}

/// Reads a log in pieces of at most 64 KiB.
pub struct SvlogReader<R> {
    source: R,
    piece: Vec<u8>,
    /// Read ahead to tell what the file is, not handed over yet.
    ahead: Vec<u8>,
    decoder: Box<Decoder>,
    frame_count: u64,
    source_ended: bool,
}

impl<R: Read> SvlogReader<R> {
    /// Starts reading, looking for an intact frame in the first bytes.
    ///
    /// # Errors
    /// If it is no log: says what it is instead.
    pub fn new(source: R) -> Result<Self, SvlogError> {
        let mut reader = Self {
            source,
            piece: Vec::new(),
            ahead: Vec::new(),
            decoder: Box::new(Decoder::new()),
            frame_count: 0,
            source_ended: false,
        };
        while reader.frame_count == 0 && !reader.source_ended {
            reader.read_piece()?;
            reader.ahead.extend_from_slice(&reader.piece);
            let searched = reader.ahead.len();
            if reader.frame_count == 0 && searched >= SEARCHED_BYTES {
                break;
            }
        }
        if reader.frame_count == 0 {
            return Err(what_it_is(&reader.ahead));
        }
        Ok(reader)
    }

    /// The next bytes of the log, `None` at its end.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn next_piece(&mut self) -> Result<Option<&[u8]>, SvlogError> {
        if !self.ahead.is_empty() {
            let rest = self.ahead.split_off(PIECE_BYTES.min(self.ahead.len()));
            self.piece = std::mem::replace(&mut self.ahead, rest);
            return Ok(Some(&self.piece));
        }
        self.read_piece()?;
        Ok((!self.piece.is_empty()).then_some(&self.piece))
    }

    /// How the log ended, once [`SvlogReader::next_piece`] has returned `None`.
    #[must_use]
    pub fn tail(&self) -> Option<Tail> {
        (self.source_ended && self.ahead.is_empty()).then(|| {
            match self.decoder.pending_byte_count() {
                0 => Tail::Whole,
                byte_count => Tail::Cut { byte_count },
            }
        })
    }

    /// Intact frames in what was read from the file so far.
    #[must_use]
    pub fn frame_count(&self) -> u64 {
        self.frame_count
    }

    /// Fills `piece` as far as the source goes.
    fn read_piece(&mut self) -> Result<(), SvlogError> {
        self.piece.resize(PIECE_BYTES, 0);
        let length = loop {
            match self.source.read(&mut self.piece) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                result => break result?,
            }
        };
        self.piece.truncate(length);
        self.source_ended = length == 0;
        let frame_count = &mut self.frame_count;
        self.decoder.feed(&self.piece, &mut |event| {
            *frame_count += u64::from(matches!(event, Event::Frame(_)));
        });
        Ok(())
    }
}

/// Of bytes without a frame.
fn what_it_is(bytes: &[u8]) -> SvlogError {
    let start = &bytes[..bytes.len().min(40)];
    let is_text = |byte: &u8| byte.is_ascii_graphic() || b" \t\r\n".contains(byte);
    if start.is_empty() {
        return SvlogError::Empty;
    }
    if start.starts_with(&mcap::MAGIC[..start.len().min(5)]) {
        return SvlogError::Mcap;
    }
    let text = String::from_utf8_lossy(start);
    if text.chars().count() > 3 && start.iter().all(is_text) {
        let found = text.replace(['\n', '\r', '\t'], " ");
        return SvlogError::Text { found };
    }
    let hex: Vec<String> = start.iter().take(12).map(|b| format!("{b:02x}")).collect();
    SvlogError::NoFrame {
        searched_byte_count: bytes.len(),
        found: hex.join(" "),
    }
}
