//! Tests that other tests would disturb, or that would disturb them: they measure the memory of this process,
//! count the processes that the kernel kills, or register algorithms, which then exist for the whole process.

mod bad_input;
mod examples;
mod identity;
#[cfg(target_os = "linux")]
mod memory_limit;
#[cfg(target_os = "linux")]
#[path = "../cli/support.rs"]
#[allow(dead_code, reason = "the tests of the command line use the rest")]
mod support;
