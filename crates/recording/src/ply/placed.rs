//! A georeference put into a map that is on disk, of which no other bit changes.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

use echosplat_georeference::Georeference;
use echosplat_input::open_file;

use super::{MOST_HEADER_BYTES, ambiguous_path, notes};
use crate::replace::Replacement;

/// A header with some lines of other programs; what is longer is no map's.
const LONGEST_HEADER_BYTES: u64 = 16 * MOST_HEADER_BYTES;

/// Puts the georeference into the headers of the map at `path` and of its ambiguous part, to `out` and beside it, which
/// may be the same. One that was there is replaced; all other bytes stay.
///
/// # Errors
/// Of the file system, and if a file has no header of a PLY; an earlier `out` is then as it was.
pub fn georeference_map(path: &Path, out: &Path, placed: &Georeference) -> io::Result<()> {
    let beside = match open_file(&ambiguous_path(path)) {
        Ok(file) => Some(rewritten(file, &ambiguous_path(out), placed)?),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    let main = rewritten(open_file(path)?, out, placed)?;
    beside.map_or(Ok(()), Replacement::put_in_place)?;
    main.put_in_place()
}

fn rewritten(file: impl Read, out: &Path, placed: &Georeference) -> io::Result<Replacement> {
    let mut reader = BufReader::new(file);
    let header = header_with(&mut reader, placed)?;
    Replacement::write(out, |writer| {
        writer.write_all(&header)?;
        io::copy(&mut reader, writer).map(drop)
    })
}

/// The header's bytes to its end, the georeference behind all other comments.
fn header_with(reader: &mut impl BufRead, placed: &Georeference) -> io::Result<Vec<u8>> {
    let mut header = Vec::new();
    let mut limited = reader.take(LONGEST_HEADER_BYTES);
    let own = format!("comment {}", notes::GEOREFERENCE);
    let mut is_told = false;
    loop {
        let mut line = Vec::new();
        limited.read_until(b'\n', &mut line)?;
        if !line.ends_with(b"\n") {
            let wrong = "its header has no end";
            return Err(io::Error::new(io::ErrorKind::InvalidData, wrong));
        }
        let end = if line.ends_with(b"\r\n") {
            "\r\n"
        } else {
            "\n"
        };
        let text = String::from_utf8_lossy(&line);
        let is_old = text.strip_prefix(own.as_str());
        if is_old.is_some_and(|rest| rest.starts_with(char::is_whitespace)) {
            continue;
        }
        if text.starts_with("element ") && !is_told {
            is_told = true;
            write!(header, "comment {}{end}", notes::georeference(placed))?;
        }
        header.extend_from_slice(&line);
        if text.trim_end() == "end_header" {
            return Ok(header);
        }
    }
}
