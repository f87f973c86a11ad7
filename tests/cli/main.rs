//! The program as its users meet it: every test drives the real binary in a folder of its own.

mod checkpoints;
mod crashes;
mod damage;
mod disk;
mod events;
mod exits;
mod failures;
mod memory;
mod merging;
mod names;
mod old_stores;
mod optimum;
mod pipes;
mod planning;
mod reading;
mod reporting;
mod same_bits;
mod sharing;
mod signals;
mod simulating;
mod support;
mod sweeps;
