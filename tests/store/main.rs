//! The store: its rules, its claims, what it answers, and what it refuses.

mod claims;
mod conditions;
mod experiments;
mod opening;
mod queries;
mod rules;
mod sample;
mod views;
