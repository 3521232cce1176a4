//! A program that is ended with the test.

use std::io::Read;
use std::process::{Child, Command, Stdio};

pub(crate) struct Program {
    child: Child,
    command: String,
}

impl Program {
    pub(crate) fn start(mut command: Command) -> Self {
        let piped = command.stdout(Stdio::piped()).stderr(Stdio::inherit());
        let child = piped.spawn().expect("python3 starts");
        let command = format!("{command:?}");
        Self { child, command }
    }

    pub(crate) fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("it is our child").is_some()
    }

    pub(crate) fn account(&self) -> &str {
        &self.command
    }

    /// Its standard output, once it has succeeded. What it writes fits a pipe.
    pub(crate) fn finish(&mut self) -> String {
        let mut text = String::new();
        let stdout = self.child.stdout.as_mut();
        let read = stdout.map(|stdout| stdout.read_to_string(&mut text));
        read.transpose().expect("its output is text");
        let status = self.child.wait().expect("it is our child");
        assert!(status.success(), "{}: {status}", self.command);
        text
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Gone already, as a rule.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
