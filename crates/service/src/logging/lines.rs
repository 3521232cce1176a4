//! The log's way to standard error: a queue bounded in bytes, and one thread that alone waits for whoever
//! reads. Nobody who logs waits, so that a terminal that is held, a pager or a stuck `ssh` stops no part
//! of the service.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

use super::frame::Drawn;
use super::write::{PIECE_BYTES, write_all};

/// Bytes that wait: some eight thousand lines.
const MOST_BYTES: usize = 1 << 20;
/// Whoever has taken nothing for so long is not waited for.
pub(super) const STALLED: Duration = Duration::from_secs(1);
/// How often somebody who waits looks again.
const LOOK: Duration = Duration::from_millis(20);

/// Lines on their way, and what bars look like below them. Drop policy: a line that finds no room is left
/// out and counted, and so are all after it until those before are out and it was said how many are
/// missing there. Of bars only the newest look is kept.
pub(super) struct Lines {
    state: Mutex<State>,
    news: Condvar,
    moved: Condvar,
}

struct State {
    thread: Option<ThreadId>,
    waiting: VecDeque<Vec<u8>>,
    byte_count: usize,
    /// What the thread itself says of lines left out.
    own: Vec<u8>,
    /// Left out, and the log does not say so yet.
    untold_count: u64,
    dropped_count: u64,
    /// The newest write failed; the next is tried with the next line.
    is_failing: bool,
    /// When the write at hand began, or went on last.
    moved_at: Option<Instant>,
    frame: String,
    is_frame_hidden: bool,
    is_frame_news: bool,
}

/// What the thread does next.
enum Work {
    /// So many lines.
    Lines(Vec<u8>, u64),
    /// Says that so many are left out here.
    TellOf(u64),
    Frame,
}

impl Lines {
    pub(super) const fn new() -> Self {
        Self {
            state: Mutex::new(State {
                thread: None,
                waiting: VecDeque::new(),
                byte_count: 0,
                own: Vec::new(),
                untold_count: 0,
                dropped_count: 0,
                is_failing: false,
                moved_at: None,
                frame: String::new(),
                is_frame_hidden: false,
                is_frame_news: false,
            }),
            news: Condvar::new(),
            moved: Condvar::new(),
        }
    }

    /// Hands on one line, its end included. Never waits.
    pub(super) fn push(&'static self, line: Vec<u8>) {
        let mut state = self.running();
        if state.thread == Some(std::thread::current().id()) {
            state.own.extend_from_slice(&line);
            return;
        }
        let is_full = state.byte_count > 0 && state.byte_count + line.len() > MOST_BYTES;
        if is_full || (state.untold_count > 0 && !state.is_failing) {
            state.untold_count += 1;
            state.dropped_count += 1;
            return;
        }
        state.byte_count += line.len();
        state.waiting.push_back(line);
        drop(state);
        self.news.notify_all();
    }

    /// What bars look like now; none if it is empty.
    pub(super) fn draw(&'static self, frame: String) {
        let mut state = self.running();
        state.frame = frame;
        state.is_frame_news = true;
        drop(state);
        self.news.notify_all();
    }

    /// Takes bars off the screen, or lets them be there again.
    pub(super) fn hide_frame(&'static self, is_hidden: bool) {
        let mut state = self.lock();
        let changes = state.is_frame_hidden != is_hidden && !state.frame.is_empty();
        state.is_frame_hidden = is_hidden;
        state.is_frame_news |= changes;
        drop(state);
        self.news.notify_all();
    }

    /// Lines left out so far, or not taken by the system.
    pub(super) fn dropped_count(&self) -> u64 {
        self.lock().dropped_count
    }

    /// Waits until all is written, for `limit` at most, and not for whoever has stalled. Says whether all
    /// is.
    pub(super) fn flush(&self, limit: Duration) -> bool {
        let began = Instant::now();
        let mut state = self.lock();
        while !state.is_idle() {
            let has_stalled = state.moved_at.is_some_and(|at| at.elapsed() > STALLED);
            let is_own = state.thread == Some(std::thread::current().id());
            if has_stalled || is_own || began.elapsed() > limit {
                return false;
            }
            let waited = self.moved.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// The state, with a thread that attends to it where the system gives one.
    fn running(&'static self) -> MutexGuard<'static, State> {
        let mut state = self.lock();
        if state.thread.is_none() {
            state.thread = self.start(Box::new(io::stderr()));
        }
        state
    }

    fn start(&'static self, mut to: Box<dyn Write + Send>) -> Option<ThreadId> {
        let thread = std::thread::Builder::new().name("log".to_owned());
        let thread = thread.spawn(move || self.run(&mut *to)).ok()?;
        Some(thread.thread().id())
    }

    fn run(&self, to: &mut dyn Write) {
        let mut drawn = Drawn::default();
        loop {
            let (work, frame) = self.next();
            let (lines, count) = match work {
                Work::Lines(lines, count) => (lines, count),
                Work::TellOf(count) => (self.word_of(count), 0),
                Work::Frame => (Vec::new(), 0),
            };
            let mut bytes = drawn.erased();
            bytes.extend_from_slice(&lines);
            bytes.extend_from_slice(&drawn.draw(&frame));
            let written = write_all(to, &bytes, |_| {
                self.lock().moved_at = Some(Instant::now());
                self.moved.notify_all();
            });
            let mut state = self.lock();
            state.moved_at = None;
            state.is_failing = written.is_err();
            if written.is_err() {
                state.untold_count += count;
                state.dropped_count += count;
            }
            drop(state);
            self.moved.notify_all();
        }
    }

    /// Waits for something to do, and for what bars look like with it.
    fn next(&self) -> (Work, String) {
        let waited = self.news.wait_while(self.lock(), |state| state.is_idle());
        let mut state = waited.unwrap_or_else(PoisonError::into_inner);
        state.moved_at = Some(Instant::now());
        state.is_frame_news = false;
        let frame = match state.is_frame_hidden {
            true => String::new(),
            false => state.frame.clone(),
        };
        let work = if !state.waiting.is_empty() {
            let (lines, count) = state.take_lines();
            Work::Lines(lines, count)
        } else if state.untold_count > 0 && !state.is_failing {
            Work::TellOf(state.untold_count)
        } else {
            Work::Frame
        };
        (work, frame)
    }

    /// As the log says it, and counted as told.
    fn word_of(&self, count: u64) -> Vec<u8> {
        tracing::warn!(
            "{count} lines of the log are missing here: whoever reads standard error had stopped reading it"
        );
        let mut state = self.lock();
        state.untold_count -= count;
        std::mem::take(&mut state.own)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn is_idle(&self) -> bool {
        let has_word = self.untold_count > 0 && !self.is_failing;
        self.moved_at.is_none() && self.waiting.is_empty() && !has_word && !self.is_frame_news
    }

    /// As many as are written at once, at least one.
    fn take_lines(&mut self) -> (Vec<u8>, u64) {
        let (mut lines, mut count) = (Vec::new(), 0);
        while let Some(line) = self.waiting.front()
            && (count == 0 || lines.len() + line.len() <= PIECE_BYTES)
        {
            lines.extend_from_slice(line);
            count += 1;
            self.waiting.pop_front();
        }
        self.byte_count -= lines.len();
        (lines, count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

    /// Takes a piece each time that somebody reads.
    struct Slow(SyncSender<Vec<u8>>);

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let sent = self.0.send(bytes.to_vec());
            sent.map_err(|_| io::ErrorKind::BrokenPipe)?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn lines() -> (&'static Lines, Receiver<Vec<u8>>) {
        let lines: &'static Lines = Box::leak(Box::new(Lines::new()));
        let (sender, read) = sync_channel(0);
        lines.lock().thread = lines.start(Box::new(Slow(sender)));
        (lines, read)
    }

    #[test]
    fn lines_come_out_whole_and_in_order() {
        let (lines, read) = lines();
        let expected: Vec<String> = (0..1000).map(|i| format!("line {i}\n")).collect();
        for line in &expected {
            lines.push(line.clone().into_bytes());
        }
        let reader = std::thread::spawn(move || {
            let mut text = Vec::new();
            while text.len() < expected.concat().len() {
                let piece = read.recv().unwrap();
                assert!(piece.len() <= PIECE_BYTES && piece.ends_with(b"\n"));
                text.extend(piece);
            }
            assert!(text == expected.concat().into_bytes());
        });
        assert!(lines.flush(Duration::from_secs(20)));
        reader.join().unwrap();
        assert_eq!(lines.dropped_count(), 0);
    }

    #[test]
    fn whoever_does_not_read_holds_nobody_up_and_misses_lines_in_one_place() {
        let (lines, read) = lines();
        let line = |i: u32| format!("{i:09}\n").into_bytes();
        let most = u32::try_from(MOST_BYTES / 10).unwrap();
        (0..2 * most).for_each(|i| lines.push(line(i)));
        assert!(!lines.flush(Duration::ZERO));
        let dropped = lines.dropped_count();
        assert!(dropped > u64::from(most) / 2, "{dropped}");
        let mut text = Vec::new();
        while !lines.lock().is_idle() {
            if let Ok(piece) = read.recv_timeout(Duration::from_millis(50)) {
                text.extend(piece);
            }
        }
        let kept = u32::try_from(u64::from(2 * most) - dropped).unwrap();
        let expected: Vec<u8> = (0..kept).flat_map(line).collect();
        assert!(text.starts_with(&expected));
        lines.push(line(7));
        assert_eq!(lines.dropped_count(), dropped);
    }
}
