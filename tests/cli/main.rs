//! Tests of the program as users run it: every test runs the real binary in its own folder.

mod checkpoints;
mod crashes;
mod damage;
mod disk;
mod events;
mod exits;
mod external;
mod failures;
mod forgetting;
mod links;
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
mod searching;
mod sharing;
mod signals;
mod simulating;
mod support;
mod sweeps;
