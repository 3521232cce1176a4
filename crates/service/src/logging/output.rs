//! What a command says on standard output: handed to a thread that writes it, and asked for at the end,
//! since what cannot be written in full is an error.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::anyhow;

use super::write::write_all;
use crate::files;

/// Most bytes that wait: more than all commands together say.
const MOST_BYTES: usize = 64 << 20;
/// How often somebody who waits looks again.
const LOOK: Duration = Duration::from_millis(20);

/// Standard output. Drop policy: none; what finds no room is an error at the end.
pub(super) struct Output {
    state: Mutex<State>,
    news: Condvar,
    moved: Condvar,
}

struct State {
    has_thread: bool,
    waiting: VecDeque<Vec<u8>>,
    byte_count: usize,
    written_count: u64,
    /// When the write at hand began, or went on last.
    moved_at: Option<Instant>,
    /// Nobody reads it any more, by their own choice.
    is_closed: bool,
    fault: Option<String>,
}

impl Output {
    pub(super) const fn new() -> Self {
        Self {
            state: Mutex::new(State {
                has_thread: false,
                waiting: VecDeque::new(),
                byte_count: 0,
                written_count: 0,
                moved_at: None,
                is_closed: false,
                fault: None,
            }),
            news: Condvar::new(),
            moved: Condvar::new(),
        }
    }

    pub(super) fn push(&'static self, text: Vec<u8>) {
        let mut state = self.lock();
        if !state.has_thread {
            let thread = std::thread::Builder::new().name("output".to_owned());
            match thread.spawn(move || self.run()) {
                Ok(_) => state.has_thread = true,
                Err(error) => state.fail(error.to_string()),
            }
        }
        if state.byte_count + text.len() > MOST_BYTES {
            state.fail("nobody reads it".to_owned());
        }
        if state.fault.is_none() && !state.is_closed {
            state.byte_count += text.len();
            state.waiting.push_back(text);
        }
        drop(state);
        self.news.notify_all();
    }

    /// Waits until all is written or cannot be, no longer than `limit` says of what has not moved for so
    /// long. Says whether nothing waits.
    pub(super) fn wait(&self, limit: impl Fn(Duration) -> bool) -> bool {
        let mut state = self.lock();
        while !state.is_idle() {
            let still = state.moved_at.map_or(Duration::ZERO, |at| at.elapsed());
            if limit(still) {
                return false;
            }
            let waited = self.moved.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// After the last [`Output::push`]: waits as [`Output::wait`] does.
    ///
    /// # Errors
    /// Says why what was handed over was not written in full. A pipe that its reader has closed is none.
    pub(super) fn finish(&self, limit: impl Fn(Duration) -> bool) -> anyhow::Result<()> {
        let is_all = self.wait(limit);
        let state = self.lock();
        let written = state.written_count;
        if let Some(fault) = &state.fault {
            return Err(anyhow!(
                "cannot write to standard output: {fault}; {written} bytes of it are written"
            ));
        }
        if !is_all {
            return Err(anyhow!(
                "cannot write to standard output: nobody reads it; {written} bytes of it are written, {} are not",
                state.byte_count
            ));
        }
        let has_written = written > 0 && !state.is_closed;
        drop(state);
        match has_written.then(sync).unwrap_or(Ok(())) {
            Ok(()) => Ok(()),
            Err(error) => Err(anyhow!(
                "what was written to standard output may be lost: {}",
                files::in_words(&error)
            )),
        }
    }

    fn run(&self) {
        let mut to = match handle() {
            Ok(to) => to,
            Err(error) => return self.lock().fail(error.to_string()),
        };
        loop {
            let text = self.next();
            let written = write_all(&mut to, &text, |count| {
                let mut state = self.lock();
                state.moved_at = Some(Instant::now());
                state.byte_count = state.byte_count.saturating_sub(count);
                state.written_count += count as u64;
                drop(state);
                self.moved.notify_all();
            });
            let mut state = self.lock();
            state.moved_at = None;
            match written {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                    state.is_closed = true;
                    state.let_go();
                }
                Err(error) => state.fail(files::in_words(&error)),
            }
            drop(state);
            self.moved.notify_all();
        }
    }

    fn next(&self) -> Vec<u8> {
        let idle = |state: &mut State| state.waiting.is_empty();
        let waited = self.news.wait_while(self.lock(), idle);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner);
        state.moved_at = Some(Instant::now());
        state.waiting.pop_front().unwrap_or_default()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn is_idle(&self) -> bool {
        self.moved_at.is_none() && self.waiting.is_empty()
    }

    fn fail(&mut self, why: String) {
        self.fault.get_or_insert(why);
        self.let_go();
    }

    fn let_go(&mut self) {
        self.waiting.clear();
        self.byte_count = 0;
    }
}

/// Past the buffer of the standard library, which would be written by whoever comes next.
fn handle() -> io::Result<File> {
    let handle = io::stdout().as_fd().try_clone_to_owned();
    handle.map(File::from)
}

/// Some file systems say only now that there is no room.
fn sync() -> io::Result<()> {
    let file = handle()?;
    if !file.metadata()?.is_file() {
        return Ok(());
    }
    match file.sync_data() {
        Err(error)
            if !matches!(
                error.kind(),
                ErrorKind::InvalidInput | ErrorKind::Unsupported
            ) =>
        {
            Err(error)
        }
        _ => Ok(()),
    }
}
