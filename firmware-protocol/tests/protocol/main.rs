//! What the wire format promises: vectors both ways, damaged streams, arbitrary bytes.

#![allow(
    clippy::unwrap_used,
    reason = "a failed expectation of the test fails the test"
)]

mod arbitrary;
mod damage;
mod damage_stream;
mod hammer;
mod lengths;
mod reference;
mod streams;
mod vectors;
