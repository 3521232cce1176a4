//! Files of other programs that are told by their first bytes, and what makes one that is read of them.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

/// As [`named`], of a file that was not read from yet, and is read from its beginning after this.
#[must_use]
pub fn of_file(mut file: &File, path: &Path) -> Option<String> {
    let mut start = Vec::new();
    let read = file.take(16).read_to_end(&mut start);
    let rewound = file.rewind();
    read.and(rewound).ok()?;
    named(&start, path)
}

/// What a file is that is neither log, recording, trajectory nor map, and the command that makes an
/// MCAP file of it; `None` if its first bytes say nothing.
#[must_use]
pub fn named(start: &[u8], path: &Path) -> Option<String> {
    let file = path.display();
    let out = path.with_extension("");
    // `a.mcap.zstd` is an `a.mcap`.
    let unpacked = out.display();
    let converted = match path.with_extension("mcap") {
        // It would be written over while it is read.
        same if same == path => path.with_extension("converted.mcap"),
        converted => converted,
    };
    let converted = converted.display();
    Some(match start {
        [b'S', b'Q', b'L', b'i', b't', b'e', b' ', ..] => format!(
            "a SQLite database, as ROS 2 keeps bags in (.db3); `mcap convert {file} {converted}`, where \
             ROS 2 is sourced, makes an MCAP file of it"
        ),
        [b'#', b'R', b'O', b'S', b'B', b'A', b'G', ..] => format!(
            "a bag of ROS 1 (.bag); `mcap convert {file} {converted}` makes an MCAP file of it"
        ),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => format!(
            "compressed as a whole by zstd; `zstd -d {file} -o {unpacked}` makes the file that was"
        ),
        [0x04, 0x22, 0x4d, 0x18, ..] => format!(
            "compressed as a whole by lz4; `lz4 -d {file} {unpacked}` makes the file that was"
        ),
        [0x1f, 0x8b, ..] => format!(
            "compressed as a whole by gzip; `gzip -dc {file} > {unpacked}` makes the file that was"
        ),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_named_with_what_helps() {
        let said = |start: &[u8], path: &str| named(start, Path::new(path)).unwrap_or_default();
        let bag = said(b"SQLite format 3\0", "a/b.db3");
        assert!(bag.contains("`mcap convert a/b.db3 a/b.mcap`"), "{bag}");
        let misnamed = said(b"SQLite format 3\0", "b.mcap");
        assert!(
            misnamed.contains("`mcap convert b.mcap b.converted.mcap`"),
            "{misnamed}"
        );
        let bag = said(b"#ROSBAG V2.0\n", "b.bag");
        assert!(bag.contains("`mcap convert b.bag b.mcap`"), "{bag}");
        let packed = said(b"\x28\xb5\x2f\xfd....", "c.mcap.zstd");
        assert!(
            packed.contains("`zstd -d c.mcap.zstd -o c.mcap`"),
            "{packed}"
        );
        assert_eq!(named(b"# a trajectory", Path::new("a.tum")), None);
    }
}
