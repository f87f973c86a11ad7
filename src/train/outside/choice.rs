//! Actions and probabilities as programs write them.

use crate::agent::certain;
use crate::env::{Action, Simulated, VectorEnvironment};

/// Whether a message can be sent in each of these lanes; `None` if messages are available in all of them.
pub(super) fn available(simulation: &Simulated, lanes: &[usize]) -> Option<Vec<bool>> {
    let available: Vec<bool> = lanes.iter().map(|lane| simulation.can_send(*lane)).collect();
    available.contains(&false).then_some(available)
}

/// The action with this number, among the first `count`.
///
/// **Errors**: a description, if no action has this number.
pub(super) fn action(number: Option<i64>, count: usize, lane: usize) -> Result<Action, String> {
    let index = number.and_then(|number| usize::try_from(number).ok());
    index.filter(|index| *index < count).and_then(Action::from_index).ok_or_else(|| {
        let (last, found) =
            (count - 1, number.map_or_else(|| "null".to_owned(), |number| number.to_string()));
        format!("expected an action from 0 to {last} for lane {lane}, found {found}")
    })
}

/// Writes the probabilities of all actions, given the probability of the chosen one: the others are known only if
/// it is 1, and NaN otherwise.
pub(super) fn of_one(chosen: Action, probability: f64, probabilities: &mut [f64]) {
    if probability == 1.0 {
        return certain(chosen, probabilities);
    }
    probabilities.fill(f64::NAN);
    probabilities[chosen.index()] = probability;
}

/// Checks the probability of an action that was taken.
///
/// **Errors**: a description, if the value cannot be such a probability.
pub(super) fn probability(of: f64, lane: usize) -> Result<f64, String> {
    if of > 0.0 && of <= 1.0 {
        return Ok(of);
    }
    Err(format!("expected a probability above 0 and at most 1 for lane {lane}, found {of}"))
}
