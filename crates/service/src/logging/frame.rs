//! Bars and live figures below the log: how the library that makes them is kept from the terminal, and
//! how what they look like is put there and taken away.

use std::io;
use std::sync::{Mutex, PoisonError};

use console::{Term, measure_text_width};
use indicatif::TermLike;

use super::LINES;

/// Takes what would be drawn. Where the cursor goes is of no interest: each drawing is all that there is
/// to be seen.
#[derive(Debug, Default)]
pub(super) struct Canvas(Mutex<String>);

impl Canvas {
    fn add(&self, text: &str) {
        let mut drawn = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        drawn.push_str(text);
    }
}

impl TermLike for Canvas {
    fn width(&self) -> u16 {
        Term::stderr().size().1
    }

    fn height(&self) -> u16 {
        Term::stderr().size().0
    }

    fn move_cursor_up(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.add(text);
        self.add("\n");
        Ok(())
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        self.add(text);
        Ok(())
    }

    fn clear_line(&self) -> io::Result<()> {
        Ok(())
    }

    fn flush(&self) -> io::Result<()> {
        let drawn = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        LINES.draw(drawn.trim_end().to_owned());
        Ok(())
    }
}

/// What stands on the screen.
#[derive(Debug, Default)]
pub(super) struct Drawn {
    rows: usize,
}

impl Drawn {
    /// What takes it off the screen.
    pub(super) fn erased(&mut self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for row in 0..std::mem::take(&mut self.rows) {
            let to_row: &[u8] = if row == 0 { b"\r" } else { b"\x1b[1A" };
            bytes.extend_from_slice(to_row);
            bytes.extend_from_slice(b"\x1b[2K");
        }
        bytes
    }

    /// What puts `frame` there; the cursor stays in its last row.
    pub(super) fn draw(&mut self, frame: &str) -> Vec<u8> {
        if !frame.is_empty() {
            let width = usize::from(Term::stderr().size().1).max(1);
            let rows = |line: &str| measure_text_width(line).div_ceil(width).max(1);
            self.rows = frame.lines().map(rows).sum();
        }
        frame.as_bytes().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_drawn_is_erased_row_by_row() {
        let mut drawn = Drawn::default();
        assert!(drawn.erased().is_empty() && drawn.draw("").is_empty());
        drawn.draw("a\nb");
        assert_eq!(drawn.erased(), b"\r\x1b[2K\x1b[1A\x1b[2K");
        assert!(drawn.erased().is_empty());
    }
}
