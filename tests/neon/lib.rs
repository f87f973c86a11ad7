//! The two modules of the library that depend on instruction sets and bits, with their tests.

// The callers of some items are in the rest of the library.
#![allow(dead_code, unused_imports)]

#[path = "../../src/kernel/mod.rs"]
pub mod kernel;
#[path = "../../src/rng.rs"]
pub mod rng;
