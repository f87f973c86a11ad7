//! The two modules of the library that compute with instruction sets and bits, and their tests.

// What the rest of the library calls.
#![allow(dead_code, unused_imports)]

#[path = "../../src/kernel/mod.rs"]
pub mod kernel;
#[path = "../../src/rng.rs"]
pub mod rng;
