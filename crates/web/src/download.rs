//! Downloads: written by a thread that may wait, sent as the browser takes them, in bounded pieces.

use std::io::{self, Read, Write};
use std::time::Duration;

use axum::body::{Body, Bytes};
use futures_util::stream;
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::time::timeout;

/// Bytes of a piece.
const PIECE_BYTES: usize = 64 << 10;
/// Pieces on their way.
const PIECES: usize = 4;
/// Whoever takes none for so long has gone.
const STALL_LIMIT: Duration = Duration::from_secs(60);

type Piece = io::Result<Bytes>;

/// A body of what `write` writes; `kept` is let go at its end.
pub(crate) fn body<K: Send + 'static>(
    kept: K,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()> + Send + 'static,
) -> Body {
    let (sender, receiver) = mpsc::channel::<Piece>(PIECES);
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || {
        let _kept = kept;
        let mut pieces = Pieces {
            sender,
            runtime,
            piece: Vec::with_capacity(PIECE_BYTES),
        };
        let written = write(&mut pieces).and_then(|()| pieces.flush());
        if let Err(error) = written {
            // So that the browser sees a download that failed, not one that is short.
            let _ = pieces.send(Err(error));
        }
    });
    Body::from_stream(stream::unfold(receiver, |mut receiver| async move {
        Some((receiver.recv().await?, receiver))
    }))
}

/// Writes all that `file` has.
pub(crate) fn copy(mut file: impl Read, to: &mut dyn Write) -> io::Result<()> {
    io::copy(&mut file, to).map(drop)
}

struct Pieces {
    sender: mpsc::Sender<Piece>,
    runtime: Handle,
    piece: Vec<u8>,
}

impl Pieces {
    fn send(&self, piece: Piece) -> io::Result<()> {
        let sent = self
            .runtime
            .block_on(async { timeout(STALL_LIMIT, self.sender.send(piece)).await });
        match sent {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }
}

impl Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(PIECE_BYTES - self.piece.len());
        self.piece.extend_from_slice(&bytes[..taken]);
        if self.piece.len() == PIECE_BYTES {
            self.flush()?;
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.piece.is_empty() {
            return Ok(());
        }
        let piece = std::mem::replace(&mut self.piece, Vec::with_capacity(PIECE_BYTES));
        self.send(Ok(piece.into()))
    }
}
