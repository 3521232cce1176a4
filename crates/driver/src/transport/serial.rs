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
    if let Some(what) = what_else_than_a_line(path) {
        return Err(io::Error::other(format!(
            "{name} is {what}, not a serial line"
        )));
    }
    let mut port = serialport::new(name.as_ref(), baudrate)
        .timeout(timeout)
        .open()
        .map_err(|error| in_words(path, error))?;
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

/// What is at `path`, if it will never be a serial line; `None` for a device, and for nothing,
/// which may yet be plugged in.
pub(crate) fn what_else_than_a_line(path: &Path) -> Option<&'static str> {
    let kind = std::fs::metadata(path).ok()?.file_type();
    if kind.is_file() {
        return Some("a file");
    }
    if kind.is_dir() {
        return Some("a directory");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return Some("a fifo");
        }
        if kind.is_socket() {
            return Some("a socket");
        }
        if kind.is_block_device() {
            return Some("a disk");
        }
    }
    None
}

/// What the system says of a line that does not open, and what to do about it.
pub(crate) fn in_words(path: &Path, error: serialport::Error) -> io::Error {
    use serialport::ErrorKind::{Io, NoDevice};
    let (name, text) = (path.display(), error.to_string());
    let words = match error.kind() {
        Io(io::ErrorKind::PermissionDenied) => format!(
            "no permission to open {name}: add yourself to the group that owns it, as in \
             `sudo usermod -aG dialout $USER`, and log in again"
        ),
        Io(io::ErrorKind::NotFound) => {
            format!("there is no {name}: is the adapter plugged in?")
        }
        // What the library says of a line that another program holds.
        NoDevice => format!(
            "{name} is in use by another program, or was just unplugged: close the other one \
             (ModemManager opens adapters by itself)"
        ),
        _ => format!("{name} cannot be opened as a serial line: {text}"),
    };
    let kind = match error.kind() {
        NoDevice => io::ErrorKind::ResourceBusy,
        _ => io::Error::from(error).kind(),
    };
    io::Error::new(kind, words)
}

impl Transport for Serial {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<Received> {
        received(self.0.read(buffer))
    }

    fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.write_all(frame)
    }
}
