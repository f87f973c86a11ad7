//! The store: its rules, claims, answers and refusals.

mod claims;
mod conditions;
mod experiments;
mod opening;
mod queries;
mod rules;
mod sample;
mod views;
