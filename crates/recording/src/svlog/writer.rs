//! Frames to a log.

use std::io::Write;

use echosplat_firmware_protocol::{Frame, Message};

use super::{HeaderError, SessionHeader, SvlogError};

/// Host and broadcast, as session packets are addressed.
const SESSION_SRC: u8 = 0;
const SESSION_DST: u8 = 255;

/// Writes a log frame by frame.
pub struct SvlogWriter<W: Write> {
    writer: W,
}

impl<W: Write> SvlogWriter<W> {
    /// Starts a log with its session packet.
    ///
    /// # Errors
    /// As [`SvlogWriter::write_session`].
    pub fn new(writer: W, session: &SessionHeader) -> Result<Self, SvlogError> {
        let mut log = Self { writer };
        log.write_session(session)?;
        Ok(log)
    }

    /// Starts another session in the same file.
    ///
    /// # Errors
    /// Of the writer, or if the packet does not fit a frame.
    pub fn write_session(&mut self, session: &SessionHeader) -> Result<(), SvlogError> {
        let json = session.to_json();
        let message = Message::Json(json.as_str().into());
        let mut frame = vec![0; message.encoded_byte_count()];
        let length = message
            .encode(SESSION_SRC, SESSION_DST, &mut frame)
            .map_err(HeaderError::Encode)?;
        Ok(self.writer.write_all(&frame[..length])?)
    }

    /// Writes one frame as it is.
    ///
    /// # Errors
    /// Of the writer, or if the bytes are not exactly one intact frame.
    pub fn write_frame(&mut self, bytes: &[u8]) -> Result<(), SvlogError> {
        Frame::from_bytes(bytes).map_err(SvlogError::NotAFrame)?;
        Ok(self.writer.write_all(bytes)?)
    }

    /// Flushes and gives the writer back.
    ///
    /// # Errors
    /// Of the writer.
    pub fn finish(mut self) -> Result<W, SvlogError> {
        self.writer.flush()?;
        Ok(self.writer)
    }
}
