//! The files of a fit: people, residuals, a prior, and everything as JSON.

use std::fmt::Write;

use serde_json::{Value as Json, json};

use crate::env::declared::{EffectSource, FitMethod, FittedDraw, Pilot, PilotPerson};
use crate::fit::estimate::{Fit, FitNote, GroupFit, coefficients, parameters, residual_sd};
use crate::fit::{likelihood, prior};
use crate::report::ReportFile;

/// The files, in the order in which they are written.
pub fn files(pilot: &Pilot, fit: &Fit) -> Vec<ReportFile> {
    let mut all = vec![
        ("people.csv", people(pilot, fit)),
        ("residuals.csv", residuals(pilot, fit)),
        ("prior.toml", prior::prior(pilot).into_bytes()),
        ("fit.json", format!("{:#}\n", summary(pilot, fit)).into_bytes()),
    ];
    if !pilot.counts.is_empty() {
        all.push(("tables.toml", tables(pilot).into_bytes()));
    }
    all.into_iter().map(|(name, bytes)| ReportFile { name: name.to_owned(), bytes }).collect()
}

/// The rows of a CSV file.
pub(super) fn csv_of(rows: impl IntoIterator<Item = Vec<String>>) -> Vec<u8> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        // Memory takes every row.
        let _ = writer.write_record(&row);
    }
    writer.into_inner().unwrap_or_default()
}

/// A number, or nothing for a missing one.
fn field(number: f64) -> String {
    if number.is_nan() { String::new() } else { format!("{number}") }
}

/// One row per person with all coefficients, in the columns of the model.
pub(super) fn people(pilot: &Pilot, fit: &Fit) -> Vec<u8> {
    let header =
        ["person".to_owned()].into_iter().chain(pilot.columns.iter().map(|one| one.0.clone()));
    let mut rows = vec![header.collect::<Vec<String>>()];
    let complete = pilot.people.iter().enumerate().filter(|(index, _)| fit.is_complete[*index]);
    for (index, person) in complete {
        let number = |(name, known): &(String, Option<Vec<f64>>)| {
            let own =
                pilot.coefficients.iter().position(|one| one.name == *name && !one.is_parameter);
            let imputed = pilot.imputed.iter().position(|one| one.name == *name);
            field(match (known, own, imputed) {
                (Some(known), ..) => known[index],
                (_, Some(own), _) => fit.values[index][own],
                (_, _, Some(imputed)) => fit.imputed[index][imputed],
                _ => f64::NAN,
            })
        };
        rows.push(
            [person.name.clone()].into_iter().chain(pilot.columns.iter().map(number)).collect(),
        );
    }
    csv_of(rows)
}

/// The rows of the model's [replay] and the residuals of every draw, by person: a row for every decision of whole days, so that
/// a replay keeps the decision of the day. What is missing of a replayed column comes from the same decision of another day.
fn residuals(pilot: &Pilot, fit: &Fit) -> Vec<u8> {
    let contexts = contexts(pilot);
    let names = contexts.iter().map(|(name, _)| (*name).to_owned());
    let header = ["person".to_owned()].into_iter().chain(names);
    let mut rows = vec![header.chain(pilot.draws.iter().map(residual_of)).collect::<Vec<String>>()];
    for (index, person) in complete(pilot, fit) {
        let Replay { columns, .. } = Replay::of(pilot, fit, index, &contexts);
        for decision in 0..columns.first().map_or(0, Vec::len) {
            let numbers = columns.iter().map(|column| field(column[decision]));
            rows.push([person.name.clone()].into_iter().chain(numbers).collect());
        }
    }
    csv_of(rows)
}

/// The number of rows of the residuals with something from another day.
pub(super) fn filled_rows(pilot: &Pilot, fit: &Fit) -> usize {
    let contexts = contexts(pilot);
    let filled = complete(pilot, fit)
        .map(|(index, _)| Replay::of(pilot, fit, index, &contexts).is_filled)
        .map(|is_filled| is_filled.into_iter().filter(|is| *is).count());
    filled.sum()
}

/// The people with all coefficients, by their index.
fn complete<'a>(
    pilot: &'a Pilot,
    fit: &'a Fit,
) -> impl Iterator<Item = (usize, &'a PilotPerson)> + 'a {
    pilot.people.iter().enumerate().filter(|(index, _)| fit.is_complete[*index])
}

/// The column of a draw's residuals.
fn residual_of(draw: &FittedDraw) -> String {
    format!("residual_{}", draw.name)
}

/// The replayed columns besides residuals of draws.
fn contexts(pilot: &Pilot) -> Vec<(&str, Vec<f64>)> {
    let is_own = |name: &str| pilot.draws.iter().any(|draw| residual_of(draw) == name);
    pilot.replayed().into_iter().filter(|(name, _)| !is_own(name)).collect()
}

/// What a replay has of a person.
struct Replay {
    /// \[contexts and draws, decisions of whole days\].
    columns: Vec<Vec<f64>>,
    /// \[decisions\]: whether something is from another day.
    is_filled: Vec<bool>,
}

impl Replay {
    fn of(pilot: &Pilot, fit: &Fit, index: usize, contexts: &[(&str, Vec<f64>)]) -> Replay {
        let own = pilot.people[index].decisions.clone();
        let whole = own.len().next_multiple_of(pilot.decisions_per_day());
        let empty = || vec![f64::NAN; whole];
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for (_, values) in contexts {
            let mut column = empty();
            // Of rows that `where` leaves out, nothing is known.
            let known = own.clone().filter(|decision| pilot.used[*decision]);
            known.for_each(|decision| column[decision - own.start] = values[decision]);
            columns.push(column);
        }
        for draw in &pilot.draws {
            let mut column = empty();
            for row in draw.people[index].clone() {
                let decision = draw.decisions[row] as usize - own.start;
                column[decision] = residual(draw, row, &fit.values[index]);
            }
            columns.push(column);
        }
        let replayed = pilot.replayed();
        let is_replayed =
            |draw: &FittedDraw| replayed.iter().any(|(name, _)| *name == residual_of(draw));
        let needed = contexts.iter().map(|_| true).chain(pilot.draws.iter().map(is_replayed));
        let mut is_filled = vec![false; whole];
        for (column, _) in columns.iter_mut().zip(needed).filter(|(_, is_needed)| *is_needed) {
            fill(column, pilot.decisions_per_day(), &mut is_filled);
        }
        Replay { columns, is_filled }
    }
}

/// Fills what is missing from the same decision of the nearest day, the earlier one of two, or else from the nearest decision.
fn fill(column: &mut [f64], per_day: usize, is_filled: &mut [bool]) {
    let known = column.to_vec();
    let near = |index: usize, step: usize| {
        let before = |far: usize| index.checked_sub(far * step).map(|at| known[at]);
        let after = |far: usize| known.get(index + far * step).copied();
        let mut all = (1..=known.len() / step + 1).flat_map(|far| [before(far), after(far)]);
        all.find_map(|value| value.filter(|value| !value.is_nan()))
    };
    for index in 0..known.len() {
        if known[index].is_nan()
            && let Some(value) = near(index, per_day).or_else(|| near(index, 1))
        {
            (column[index], is_filled[index]) = (value, true);
        }
    }
}

/// The value minus its mean; of a lognormal draw, of logarithms.
fn residual(draw: &FittedDraw, row: usize, values: &[f64]) -> f64 {
    draw.outcome[row] - likelihood::mean(draw.law, &parameters(draw, row, values))
}

/// The counted tables, as a model writes them.
fn tables(pilot: &Pilot) -> String {
    let mut text = String::from(
        "# Counts from a pilot, in the place of the model's [tables]. `jitai fit` wrote them.\n[tables]\n",
    );
    for table in &pilot.counts {
        let given = table.counts.first().map_or(0, |(key, _)| key.len().saturating_sub(1));
        let names: Vec<String> = (1..=given).map(|number| format!("given_{number}")).collect();
        let header: String = names.iter().map(|name| format!("{name},")).collect();
        let _ = write!(text, "{} = \"\"\"\n{header}value,probability\n", table.name);
        for (key, count) in &table.counts {
            let numbers: String = key.iter().map(|number| format!("{number},")).collect();
            let _ = writeln!(text, "{numbers}{count}");
        }
        text += "\"\"\"\n";
    }
    text
}

fn summary(pilot: &Pilot, fit: &Fit) -> Json {
    let draws: Vec<Json> = pilot.draws.iter().zip(&fit.groups).map(|(draw, groups)| {
        json!({
            "draw": draw.name,
            "distribution": format!("{:?}", draw.law),
            "method": method(draw.method),
            "rows": draw.decisions.len(),
            "rows_without_value": draw.without[0].0,
            "rows_without_features": draw.without[1].0,
            "residual_sd": residual_sd(groups),
            "fits": groups.iter().map(|group| group_as_json(pilot, group)).collect::<Vec<Json>>(),
        })
    }).collect();
    let left_out: Vec<&str> = pilot
        .people
        .iter()
        .zip(&fit.is_complete)
        .filter(|(_, complete)| !**complete)
        .map(|(person, _)| person.name.as_str())
        .collect();
    let effects = |imputed: bool| -> Vec<&str> {
        match imputed {
            true => pilot.imputed.iter().map(|one| one.name.as_str()).collect(),
            false => pilot
                .coefficients
                .iter()
                .filter(|one| one.is_effect)
                .map(|one| one.name.as_str())
                .collect(),
        }
    };
    json!({
        "format": 1,
        "title": pilot.title().0,
        "people": pilot.people.len(),
        "people_left_out": left_out,
        "notes": pilot.notes,
        "pooled": pilot.pooled,
        "effects_fitted": effects(false),
        "effects_imputed": effects(true),
        "effects_by": effect(pilot.effect),
        "parameters": fit.parameters.iter().map(|(name, value)| (name.clone(), json!(value))).collect::<serde_json::Map<String, Json>>(),
        "standardised": pilot.scales.iter().map(|(name, mean, sd)| json!({ "variable": name, "mean": mean, "sd": sd })).collect::<Vec<Json>>(),
        "draws": draws,
    })
}

fn group_as_json(pilot: &Pilot, group: &GroupFit) -> Json {
    let size = group.free.len();
    let estimates =
        group.free.iter().zip(&group.values).enumerate().map(|(slot, (index, value))| {
            let variance = group.covariance.get(slot * size + slot).copied();
            json!({
                "coefficient": pilot.coefficients[*index].name,
                "estimate": value,
                "standard_error": variance.map(f64::sqrt),
            })
        });
    json!({
        "person": group.person.map(|person| pilot.people[person].name.as_str()),
        "rows": group.rows,
        "objective": Some(group.objective).filter(|one| !one.is_nan()),
        "gradient_norm": Some(group.gradient_norm).filter(|one| !one.is_nan()),
        "estimates": estimates.collect::<Vec<Json>>(),
        "notes": group.notes.iter().map(|note| words(pilot, note)).collect::<Vec<String>>(),
    })
}

pub(super) fn method(method: FitMethod) -> String {
    match method {
        FitMethod::LeastSquares => "least squares".to_owned(),
        FitMethod::Ridge(penalty) => format!("ridge, penalty {penalty}"),
        FitMethod::Map(sd) => format!("map, prior sd {sd}"),
        FitMethod::Counts => "counts".to_owned(),
    }
}

pub(super) fn effect(effect: EffectSource) -> String {
    match effect {
        EffectSource::Fitted => "fit".to_owned(),
        EffectSource::Standardised(share) => {
            format!("imputed: {share} residual standard deviations")
        }
        EffectSource::ShareOfWeights(share) => {
            format!("imputed: {share} of the mean size of the other weights")
        }
    }
}

/// What the data do not say, in words.
pub(super) fn words(pilot: &Pilot, note: &FitNote) -> String {
    let name = |index: &usize| &pilot.coefficients[*index].name;
    match note {
        FitNote::FewRows => "not more rows than coefficients: not estimated".to_owned(),
        FitNote::Constant(value) => format!("every value is {value}"),
        FitNote::Separated => {
            "separation: features tell the values apart, and an estimate runs off to infinity"
                .to_owned()
        }
        FitNote::NotIdentified(index) => format!("`{}` is not identified", name(index)),
        FitNote::Rare(index) => {
            format!("`{}` is left out: a value of its variable is rare", name(index))
        }
        FitNote::OtherOptima(count) => format!("{count} starts ended in another optimum"),
        FitNote::Unbounded(count) => format!("{count} starts ran off to a density without bound"),
        FitNote::NotConverged => "not converged: the gradient stays above 1e-6".to_owned(),
    }
}

/// The notes of all groups, each with the number of groups that have it.
pub fn notes(pilot: &Pilot, fit: &Fit) -> Vec<(String, String, Vec<String>)> {
    let mut all: Vec<(String, String, Vec<String>)> = Vec::new();
    for (draw, groups) in pilot.draws.iter().zip(&fit.groups) {
        for group in groups {
            let who = group.person.map_or("everybody", |person| pilot.people[person].name.as_str());
            let mut said: Vec<String> = group
                .notes
                .iter()
                .map(|note| match note {
                    FitNote::Constant(_) => "all values are equal".to_owned(),
                    FitNote::OtherOptima(_) => "starts ended in different optima".to_owned(),
                    FitNote::Unbounded(_) => "starts ran off to a density without bound".to_owned(),
                    note => words(pilot, note),
                })
                .collect();
            if group.rows < coefficients(draw).len() && !group.notes.contains(&FitNote::FewRows) {
                said.push("fewer rows than coefficients: the prior determines some".to_owned());
            }
            for says in said {
                match all.iter_mut().find(|(name, known, _)| *name == draw.name && *known == says) {
                    Some((.., people)) => people.push(who.to_owned()),
                    None => all.push((draw.name.clone(), says, vec![who.to_owned()])),
                }
            }
        }
    }
    all
}
