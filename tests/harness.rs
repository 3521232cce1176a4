//! Programs as users run them: started, watched, signalled, and never left behind.

use std::io::Read;
use std::net::TcpStream;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;

/// How often a condition is looked at again.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// A running program; killed when dropped.
pub(crate) struct Program {
    child: Child,
    command: String,
    stdout: Pipe,
    stderr: Pipe,
}

/// What a program has written so far, read by a thread so that the program never waits for us.
struct Pipe {
    bytes: Arc<Mutex<Vec<u8>>>,
    reader: Option<JoinHandle<()>>,
}

impl Program {
    /// Our own program with these arguments.
    pub(crate) fn echosplat<A: AsRef<str>>(arguments: &[A]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_echosplat"));
        command.args(arguments.iter().map(AsRef::as_ref));
        command.current_dir(env!("CARGO_TARGET_TMPDIR"));
        Self::start(command)
    }

    /// Any program. It gets no input.
    pub(crate) fn start(mut command: Command) -> Self {
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        let stdout = Pipe::reading(child.stdout.take().expect("it is piped"));
        let stderr = Pipe::reading(child.stderr.take().expect("it is piped"));
        Self {
            child,
            command: format!("{command:?}"),
            stdout,
            stderr,
        }
    }

    /// Standard output so far.
    pub(crate) fn stdout(&self) -> String {
        self.stdout.text()
    }

    /// Standard error so far.
    pub(crate) fn stderr(&self) -> String {
        self.stderr.text()
    }

    /// The JSON object on the last line of standard output.
    pub(crate) fn json(&self) -> Value {
        let stdout = self.stdout();
        let line = stdout.lines().last().unwrap_or_default();
        serde_json::from_str(line)
            .unwrap_or_else(|error| panic!("no JSON at the end ({error})\n{}", self.account()))
    }

    /// The JSON object that is all of standard output, as `--json` promises.
    pub(crate) fn only_json(&self) -> Value {
        serde_json::from_str(&self.stdout())
            .unwrap_or_else(|error| panic!("not one JSON object ({error})\n{}", self.account()))
    }

    /// Waits until `look` finds what it looks for, and returns it. Fails when the bound has passed
    /// or the program has ended without it.
    pub(crate) fn wait_for<T>(
        &mut self,
        what: &str,
        bound: Duration,
        mut look: impl FnMut(&Self) -> Option<T>,
    ) -> T {
        let began = Instant::now();
        loop {
            let ended = self.child.try_wait().expect("it is our child").is_some();
            if ended {
                self.join_readers();
            }
            if let Some(found) = look(self) {
                return found;
            }
            assert!(!ended, "ended without {what}\n{}", self.account());
            assert!(
                began.elapsed() < bound,
                "no {what} within {bound:?}\n{}",
                self.account()
            );
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    /// Waits until the program has written this, to either output.
    pub(crate) fn wait_for_text(&mut self, text: &str, bound: Duration) {
        self.wait_for(text, bound, |program| {
            let written = program.stdout() + &program.stderr();
            written.contains(text).then_some(())
        });
    }

    /// Waits for the program's end.
    pub(crate) fn wait_exit(&mut self, bound: Duration) -> ExitStatus {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("it is our child") {
                self.join_readers();
                return status;
            }
            assert!(
                began.elapsed() < bound,
                "still running after {bound:?}\n{}",
                self.account()
            );
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    /// Waits for the program's end and fails if it ended with another code.
    pub(crate) fn wait_exit_code(&mut self, code: i32, bound: Duration) {
        let status = self.wait_exit(bound);
        assert_eq!(status.code(), Some(code), "{status}\n{}", self.account());
    }

    /// Asks the program to end, as systemd does.
    pub(crate) fn terminate(&self) {
        self.signal("TERM");
    }

    /// Asks the program to end, as Ctrl-C does.
    pub(crate) fn interrupt(&self) {
        self.signal("INT");
    }

    /// Ends the program as a power cut does.
    pub(crate) fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Keeps the program from running for so long, as Ctrl-Z does until it goes on.
    pub(crate) fn stop_for(&self, time: Duration) {
        self.signal("STOP");
        std::thread::sleep(time);
        self.signal("CONT");
    }

    fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args(["-s", name, &self.child.id().to_string()])
            .status();
        assert!(sent.is_ok_and(|status| status.success()), "kill -s {name}");
    }

    /// What a reader of a failure wants to know.
    pub(crate) fn account(&self) -> String {
        format!(
            "of {}\n--- standard output\n{}--- standard error\n{}---",
            self.command,
            self.stdout(),
            self.stderr()
        )
    }

    fn join_readers(&mut self) {
        self.stdout.join();
        self.stderr.join();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended already; either way it is gone afterwards.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Pipe {
    fn reading(mut source: impl Read + Send + 'static) -> Self {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&bytes);
        let reader = std::thread::spawn(move || {
            let mut block = [0; 4096];
            while let Ok(count @ 1..) = source.read(&mut block) {
                let mut bytes = sink.lock().unwrap_or_else(PoisonError::into_inner);
                bytes.extend_from_slice(&block[..count]);
            }
        });
        Self {
            bytes,
            reader: Some(reader),
        }
    }

    fn text(&self) -> String {
        let bytes = self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&bytes).into_owned()
    }

    fn join(&mut self) {
        if let Some(reader) = self.reader.take() {
            reader.join().expect("reading does not panic");
        }
    }
}

pub(crate) fn free_port() -> u16 {
    echosplat_bus::free_port().expect("loopback has free ports")
}

/// Arguments that let a service meet only those programs that know this port: tests run side by
/// side.
pub(crate) fn bus_at(port: u16) -> [String; 4] {
    let endpoint = |direction| format!("{direction}/endpoints=[\"tcp/127.0.0.1:{port}\"]");
    let flag = || "--zenoh".to_owned();
    [flag(), endpoint("listen"), flag(), endpoint("connect")]
}

/// Waits until something accepts connections at this port of the loopback interface.
pub(crate) fn wait_until_listening(program: &mut Program, port: u16) {
    program.wait_for("listener", Duration::from_secs(60), |_| {
        TcpStream::connect(("127.0.0.1", port)).ok()
    });
}
