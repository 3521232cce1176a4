//! TCP, as a real `OmniScan` 450 FS offers it on port 51200.

use std::io;
use std::net::Shutdown;
use std::time::Duration;

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use super::{closed, no_address, resolve, within};
use crate::intake::Intake;

#[derive(Debug)]
pub(crate) struct Tcp {
    stream: TcpStream,
    intake: Intake,
    write_limit: Duration,
    /// Shuts the connection down if whoever reads it hangs and is abandoned.
    _closer: AbortOnDropHandle<()>,
}

/// Tries every address the name has.
pub(super) async fn open(
    address: &str,
    limit: Duration,
    abandoned: CancellationToken,
) -> io::Result<Tcp> {
    let mut last = no_address();
    for address in resolve(address).await? {
        match within(limit, TcpStream::connect(address)).await {
            Ok(stream) => return Tcp::new(stream, limit, abandoned),
            Err(error) => last = error,
        }
    }
    Err(last)
}

impl Tcp {
    fn new(
        stream: TcpStream,
        write_limit: Duration,
        abandoned: CancellationToken,
    ) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        let stream = stream.into_std()?;
        let same = stream.try_clone()?;
        let closer = tokio::spawn(async move {
            abandoned.cancelled().await;
            // It may have ended by itself.
            let _ = same.shutdown(Shutdown::Both);
        });
        Ok(Self {
            stream: TcpStream::from_std(stream)?,
            intake: Intake::default(),
            write_limit,
            _closer: AbortOnDropHandle::new(closer),
        })
    }

    pub(super) async fn read(&mut self) -> io::Result<Bytes> {
        match self.stream.read(self.intake.room()).await? {
            0 => Err(closed()),
            byte_count => Ok(self.intake.take(byte_count)),
        }
    }

    pub(super) async fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        within(self.write_limit, self.stream.write_all(frame)).await
    }
}
