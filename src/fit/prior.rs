//! The prior of a bandit from a pilot: least squares by person, then means and standard deviations over people.

use std::fmt::Write;

use crate::analyse::mean_and_sd;
use crate::env::declared::Pilot;
use crate::fit::solve::Orthogonal;

/// The least standard deviation that an agent's key takes.
const LEAST_SD: f64 = 1e-6;

/// The keys of an agent `linear_thompson`, with the reward regressed on an intercept and the features, and on their products
/// with the action.
pub(super) fn prior(pilot: &Pilot) -> String {
    let (actions, features) = pilot.actions_and_features();
    let mut text = String::from(
        "# The prior of an agent of the algorithm linear_thompson, from a pilot: the reward by least squares for each\n\
         # person, then mean and standard deviation over people. `jitai fit` wrote it.\n",
    );
    let _ = writeln!(text, "# Coefficients: 1, {}.", features.join(", "));
    if actions > 2 {
        text += "# None: a model with more than two actions has no common effect.\n";
        return text;
    }
    let observed = pilot.observed();
    let rewards = &observed[features.len()];
    let known = |decision: &usize| {
        pilot.used[*decision]
            && observed[..=features.len()].iter().all(|values| !values[*decision].is_nan())
            && !pilot.actions[0][*decision].is_nan()
            // An agent learns only where it could choose.
            && pilot.actions[2][*decision] != 0.0
    };
    let width = features.len() + 1;
    let varies = |people: &mut dyn Iterator<Item = usize>| {
        let mut actions = people.map(|decision| pilot.actions[0][decision]);
        let first = actions.next();
        actions.any(|action| Some(action) != first)
    };
    let has_effect = varies(&mut (0..rewards.len()).filter(known));
    let size = if has_effect { 2 * width } else { width };
    let mut estimates: Vec<Vec<f64>> = Vec::new();
    let (mut squares, mut degrees) = (0.0, 0.0);
    for person in &pilot.people {
        let rows: Vec<usize> = person.decisions.clone().filter(known).collect();
        let regressor = |index: usize| {
            let feature = |decision: &usize| match index % width {
                0 => 1.0,
                feature => observed[feature - 1][*decision],
            };
            let factor =
                |decision: &usize| if index < width { 1.0 } else { pilot.actions[0][*decision] };
            rows.iter().map(|decision| feature(decision) * factor(decision)).collect::<Vec<f64>>()
        };
        let columns: Vec<Vec<f64>> = (0..size).map(regressor).collect();
        let outcome: Vec<f64> = rows.iter().map(|decision| rewards[*decision]).collect();
        let orthogonal = Orthogonal::new(columns.clone());
        if orthogonal.kept.len() < size || rows.len() <= size {
            continue;
        }
        let found = orthogonal.nearest(&outcome);
        for (row, outcome) in outcome.iter().enumerate() {
            let fitted: f64 =
                columns.iter().zip(&found).map(|(column, value)| column[row] * value).sum();
            squares += (outcome - fitted) * (outcome - fitted);
        }
        degrees += (rows.len() - size) as f64;
        estimates.push(found);
    }
    let (used, all) = (estimates.len(), pilot.people.len());
    let _ = writeln!(text, "# {used} of {all} people have rows that determine all of them.");
    if used < 2 || degrees == 0.0 {
        text += "# Too few for a mean and a standard deviation over people.\n";
        return text;
    }
    let over_people = |index: usize| {
        let own: Vec<f64> = estimates.iter().map(|one| one[index]).collect();
        let (mean, sd) = mean_and_sd(&own);
        (mean, sd.unwrap_or(0.0).max(LEAST_SD))
    };
    let list = |numbers: Vec<f64>| {
        let shown: Vec<String> = numbers.iter().map(|number| format!("{number:?}")).collect();
        format!("[{}]", shown.join(", "))
    };
    let _ = writeln!(
        text,
        "action_centring = true\nnoise_sd = {:?}",
        (squares / degrees).sqrt().max(LEAST_SD)
    );
    let parts: &[(&str, usize)] =
        if has_effect { &[("baseline", 0), ("effect", width)] } else { &[("baseline", 0)] };
    for (name, first) in parts {
        let numbers: Vec<(f64, f64)> = (*first..first + width).map(over_people).collect();
        let _ =
            writeln!(text, "{name}_means = {}", list(numbers.iter().map(|one| one.0).collect()));
        let _ = writeln!(text, "{name}_sds = {}", list(numbers.iter().map(|one| one.1).collect()));
    }
    if !has_effect {
        text += "# The action does not vary, so that the pilot says nothing about effect_means and effect_sds.\n";
    }
    text
}
