//! Serial lines and pseudo-terminals, 8 data bits, no parity, one stop bit, no flow control.

use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Duration;

use serialport::SerialPort;

use super::{READ_WAIT, Received, Transport, received};

pub(super) struct Serial(Box<dyn SerialPort>);

/// `find_baudrate` wakes a unit that detects the rate: break, 1 ms, the letter U, as the vendor's
/// client does it. Only when nothing was heard: it is noise to a unit that listens already.
pub(super) fn open(
    path: &Path,
    baudrate: u32,
    timeout: Duration,
    find_baudrate: bool,
) -> io::Result<Serial> {
    let name = path.to_string_lossy();
    let mut port = serialport::new(name.as_ref(), baudrate)
        .timeout(timeout)
        .open()
        .map_err(io::Error::from)?;
    if find_baudrate {
        // Pseudo-terminals and some adapters know no break: then there is no rate to find.
        let _ = port.set_break();
        std::thread::sleep(Duration::from_millis(1));
        let _ = port.clear_break();
        let _ = port.write(b"U");
    }
    port.set_timeout(READ_WAIT)?;
    Ok(Serial(port))
}

impl Transport for Serial {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<Received> {
        received(self.0.read(buffer))
    }

    fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.write_all(frame)
    }
}
