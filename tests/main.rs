//! Whole-service tests: the program as users run it, against devices and clients written by
//! others or a second time. Needs `python3` for the latter.

mod harness;
mod python;

mod device;
mod map;
mod python_tools;
mod serial_line;
