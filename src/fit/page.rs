//! The page of a fit: what the data do not say, then the model against its data.

use crate::env::declared::{EffectSource, Pilot};
use crate::fit::check::{Check, CheckedNumber, outside};
use crate::fit::estimate::Fit;
use crate::fit::output::{self, notes};
use crate::report::{
    DataTable, PlainFigure, PlainLine, PlainPage, PlainPoint, PlainSection, TableEntry, signed,
};

/// Errors from which a number is marked.
const MARKED: f64 = 2.0;

/// Whether a model may be called fitted.
pub enum Standing {
    /// All effects that vary are identified, or imputed and named, and the recursion is stable.
    Fitted,
    /// Why it may not.
    NotFitted(Vec<String>),
}

impl Standing {
    /// The standing of a fit.
    pub fn of(pilot: &Pilot, fit: &Fit, check: &Check) -> Standing {
        let mut why = Vec::new();
        for (index, count) in fit.unidentified_effects(pilot) {
            let name = &pilot.coefficients[index].name;
            why.push(format!(
                "the effect `{name}` is not identified for {count} of {}",
                fit_count(fit)
            ));
        }
        if let Some(failure) = &check.failure {
            why.push(format!("simulated pilots fail: {failure}"));
        }
        match &check.long_run {
            Err(says) => why.push(format!("a simulation of the days of the model fails: {says}")),
            Ok(run) if check.explodes() => why.push(format!(
                "the recursion explodes: outcomes reach {} in {} decisions, and {} in the pilot",
                rounded(run.largest),
                run.decisions,
                rounded(check.largest)
            )),
            Ok(_) => {}
        }
        if why.is_empty() { Standing::Fitted } else { Standing::NotFitted(why) }
    }
}

/// The number of fits of one draw.
fn fit_count(fit: &Fit) -> String {
    let count = fit.groups.first().map_or(0, Vec::len);
    if count == 1 { "1 fit".to_owned() } else { format!("{count} fits") }
}

/// A number with four significant digits.
fn rounded(value: f64) -> String {
    if !value.is_finite() {
        return "no number".to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = 3 - value.abs().max(1e-9).log10().floor() as i32;
    signed(&format!("{value:.*}", digits.clamp(0, 9) as usize))
}

fn number(value: f64) -> TableEntry {
    match value.is_finite() {
        true => TableEntry::Number { value, shown: rounded(value) },
        false => TableEntry::Missing("none".to_owned()),
    }
}

/// The page.
pub(super) fn page(pilot: &Pilot, fit: &Fit, check: &Check, environment: &str) -> PlainPage {
    let (title, unit) = pilot.title();
    let standing = Standing::of(pilot, fit, check);
    let complete = fit.is_complete.iter().filter(|complete| **complete).count();
    let (word, warnings) = match &standing {
        Standing::Fitted => ("Fitted", Vec::new()),
        Standing::NotFitted(why) => ("Not fitted", why.clone()),
    };
    let all = check.numbers.iter().chain(&check.weeks).chain(&check.slots);
    let marked: Vec<&str> = all.filter(|one| is_marked(one)).map(|one| one.name.as_str()).collect();
    let marks = match marked.is_empty() {
        true => String::new(),
        false => format!(" More than two errors away from its data: {}.", marked.join(", ")),
    };
    let lead = format!(
        "{word}: {complete} of {} people have all coefficients{}.{marks}",
        pilot.people.len(),
        imputed_words(pilot)
    );
    let sections = vec![
        unsaid(pilot, fit, warnings),
        against(pilot, check, unit),
        effect(pilot, check, unit),
        held_out(pilot, check),
        stability(pilot, check, unit),
        coefficients(pilot, fit),
        PlainSection {
            heading: "Run these people".to_owned(),
            words: vec!["The section of a manifest that simulates them:".to_owned()],
            listing: Some(environment.to_owned()),
            ..PlainSection::default()
        },
    ];
    let kicker = "jitai fit".to_owned();
    PlainPage { kicker, title: title.to_owned(), lead, sections }
}

/// A table whose caption names imputed effects.
fn titled(caption: &str, pilot: &Pilot, columns: &[(&'static str, &'static str)]) -> DataTable {
    DataTable::new(format!("{caption}{}", imputed_words(pilot)), columns)
}

/// Whether the pilot is more than two errors away; a number that no simulated pilot varies has no error.
fn is_marked(one: &CheckedNumber) -> bool {
    one.off().is_finite() && one.off().abs() > MARKED
}

/// Words on imputed effects, for whatever rests on them.
fn imputed_words(pilot: &Pilot) -> String {
    let names: Vec<&str> = pilot.imputed.iter().map(|one| one.name.as_str()).collect();
    match pilot.effect {
        EffectSource::Fitted => String::new(),
        _ => format!("; imputed, not estimated: {}", names.join(", ")),
    }
}

fn unsaid(pilot: &Pilot, fit: &Fit, warnings: Vec<String>) -> PlainSection {
    let columns = [
        ("draw", "Draw"),
        ("says", "The data do not say"),
        ("count", "Fits"),
        ("people", "People"),
    ];
    let mut table = DataTable::new("What the data do not say", &columns);
    for (draw, says, people) in notes(pilot, fit) {
        let few: Vec<&str> = people.iter().take(8).map(String::as_str).collect();
        let more = if people.len() > few.len() { ", …" } else { "" };
        table.rows.push(vec![
            TableEntry::text(draw),
            TableEntry::text(says),
            TableEntry::number(people.len() as f64, 0),
            TableEntry::name(people.join(" "), format!("{}{more}", few.join(", "))),
        ]);
    }
    let mut words = pilot.notes.clone();
    words.extend(pilot.draws.iter().map(|draw| draw.counts() + "."));
    let norms = fit.groups.iter().flatten().filter(|group| group.is_usable());
    let largest = norms.map(|group| group.gradient_norm).fold(0.0, f64::max);
    words.push(format!("The largest norm of a gradient is {largest:.1e}; 1e-6 is allowed."));
    if table.rows.is_empty() {
        words.push(
            "Every coefficient of every person is identified by the person's rows.".to_owned(),
        );
    }
    let tables =
        if table.rows.is_empty() { Vec::new() } else { vec![("unsaid".to_owned(), table)] };
    let heading = "What the data do not say".to_owned();
    PlainSection { heading, warnings, words, tables, ..PlainSection::default() }
}

fn against(pilot: &Pilot, check: &Check, unit: &str) -> PlainSection {
    let columns = [
        ("number", "Number"),
        ("pilot", "Pilot"),
        ("simulated", "Simulated"),
        ("error", "Error"),
        ("off", "Errors away"),
        ("mark", ""),
    ];
    let mut table = titled("The model against its data", pilot, &columns);
    for one in check
        .numbers
        .iter()
        .chain(&check.weeks)
        .chain(check.slots.iter().filter(|_| check.slots.len() > 1))
    {
        let mark = if is_marked(one) { "beyond 2" } else { "" };
        table.rows.push(vec![
            TableEntry::text(one.name.clone()),
            number(one.pilot),
            number(one.mean),
            number(one.sd),
            number(one.off()),
            TableEntry::text(mark),
        ]);
    }
    let ((means, all), (variances, known)) = (outside(&check.people), outside(&check.variances));
    let words = vec![
        format!(
            "{} pilots of these people at the recorded decisions, under the pilot's own probabilities{}. The error of a number is \
             its standard deviation over these pilots.",
            check.simulations,
            imputed_words(pilot)
        ),
        format!(
            "{means} of {all} people have a mean outcome outside of their own 95 % interval, and {variances} of {known} a variance \
             without zeros; {:.1} of {all} are expected.",
            0.05 * all as f64
        ),
    ];
    let point = |x: i32, y: f64, interval| PlainPoint { x: f64::from(x), y, interval };
    let figure = |stem: &str, caption: String, x: &str, all: &[&CheckedNumber]| PlainFigure {
        stem: stem.to_owned(),
        caption: format!("{caption}{}", imputed_words(pilot)),
        axes: [x.to_owned(), unit.to_owned()],
        lines: vec![
            PlainLine {
                label: "simulated".to_owned(),
                points: (1..)
                    .zip(all)
                    .map(|(x, one)| point(x, one.mean, Some(one.interval)))
                    .collect(),
                is_observed: false,
            },
            PlainLine {
                label: "pilot".to_owned(),
                points: (1..).zip(all).map(|(x, one)| point(x, one.pilot, None)).collect(),
                is_observed: true,
            },
        ],
    };
    let mut people: Vec<&CheckedNumber> = check.people.iter().collect();
    people.sort_by(|one, other| one.pilot.total_cmp(&other.pilot));
    let weeks: Vec<&CheckedNumber> = check.weeks.iter().collect();
    let figures = vec![
        figure(
            "weeks",
            "Mean outcome by week: the pilot, and 95 % of simulated pilots".to_owned(),
            "week",
            &weeks,
        ),
        figure(
            "people",
            "Mean outcome by person, in order: the pilot, and 95 % of simulated pilots".to_owned(),
            "person",
            &people,
        ),
    ];
    PlainSection {
        heading: "The model against its data".to_owned(),
        warnings: check.failure.iter().cloned().collect(),
        words,
        figures,
        tables: vec![("against".to_owned(), table)],
        listing: None,
    }
}

fn effect(pilot: &Pilot, check: &Check, unit: &str) -> PlainSection {
    let mut section =
        PlainSection { heading: "The effect of an action".to_owned(), ..PlainSection::default() };
    let Some((effect, error)) = &check.effect else {
        let why = match check.has_randomised {
            true => {
                "The pilot has too few people for the effect of an action and its standard error"
            }
            false => "The pilot has no randomised actions, so that it says nothing about an effect",
        };
        section.words.push(format!("{why}{}.", imputed_words(pilot)));
        return section;
    };
    let columns = [("of", "Of"), ("effect", "Effect"), ("error", "Standard error")];
    let mut table = titled("Weighted and centred least squares", pilot, &columns);
    table.rows.push(vec![TableEntry::text("the pilot"), number(effect.pilot), number(*error)]);
    table.rows.push(vec![
        TableEntry::text("simulated pilots"),
        number(effect.mean),
        number(effect.sd),
    ]);
    section.words.push(format!(
        "The mean effect of an action on the outcome in {unit}, controlled for the features that agents observe, with \
         standard errors of Mancl and DeRouen; of simulated pilots, mean and standard deviation{}.",
        imputed_words(pilot)
    ));
    if is_marked(effect) {
        section.warnings.push(format!("The pilot's effect is {:.1} errors away.", effect.off()));
    }
    section.tables.push(("effect".to_owned(), table));
    section
}

fn held_out(pilot: &Pilot, check: &Check) -> PlainSection {
    let columns =
        [("draw", "Draw"), ("rows", "Rows"), ("model", "Model"), ("mean", "Person's mean")];
    let mut table = titled("Root mean square error on held-out days", pilot, &columns);
    let mut section =
        PlainSection { heading: "Held-out days".to_owned(), ..PlainSection::default() };
    for one in &check.held_out {
        let [model, mean] = one.errors;
        table.rows.push(vec![
            TableEntry::text(one.draw.clone()),
            TableEntry::number(one.rows as f64, 0),
            number(model),
            number(mean),
        ]);
        if model > mean {
            section.warnings.push(format!(
                "{}: each person's mean predicts held-out days better than the model.",
                one.draw
            ));
        }
    }
    section.words.push(
        "Every fifth day is left out, the rest is fitted, and the left-out rows are predicted from their own features. Errors \
         of lognormal draws are those of logarithms."
            .to_owned(),
    );
    match check.held_out.is_empty() {
        true => section.words.push("There are too few rows to leave days out.".to_owned()),
        false => section.tables.push(("held_out".to_owned(), table)),
    }
    section
}

fn stability(pilot: &Pilot, check: &Check, unit: &str) -> PlainSection {
    let mut section = PlainSection {
        heading: "Stability of the recursion".to_owned(),
        ..PlainSection::default()
    };
    match &check.long_run {
        Err(says) => section.warnings.push(says.clone()),
        Ok(run) => {
            let quarters = run.quarters.map(rounded).join(", ");
            section.words.push(format!(
                "Everybody for the days of the model, {} decisions: the mean outcome in {unit} is {quarters} in the quarters of \
                 this time. The largest outcome is {}; that of the pilot is {}{}.",
                run.decisions,
                rounded(run.largest),
                rounded(check.largest),
                imputed_words(pilot)
            ));
            if check.explodes() {
                section.warnings.push("The recursion explodes.".to_owned());
            }
        }
    }
    section
}

fn coefficients(pilot: &Pilot, fit: &Fit) -> PlainSection {
    let columns = [
        ("coefficient", "Coefficient"),
        ("source", "Source"),
        ("people", "People"),
        ("mean", "Mean"),
        ("sd", "SD over people"),
        ("error", "Typical standard error"),
    ];
    let mut table = DataTable::new("Coefficients over people", &columns);
    for (index, one) in pilot.coefficients.iter().enumerate() {
        let own = fit.values.iter().zip(&fit.is_complete).filter(|(_, complete)| **complete);
        let own: Vec<f64> = own.map(|(values, _)| values[index]).collect();
        let (mean, sd) = crate::analyse::mean_and_sd(&own);
        let mut errors: Vec<f64> =
            fit.groups.iter().flatten().filter_map(|group| group.error_of(index)).collect();
        errors.sort_by(f64::total_cmp);
        let typical = crate::analyse::quantile(&errors, 0.5).unwrap_or(f64::NAN);
        table.rows.push(vec![
            TableEntry::text(one.name.clone()),
            TableEntry::text(if one.is_effect { "fitted effect" } else { "fitted" }),
            TableEntry::number(own.len() as f64, 0),
            number(mean),
            number(sd.unwrap_or(f64::NAN)),
            number(typical),
        ]);
    }
    for (index, one) in pilot.imputed.iter().enumerate() {
        let value = fit.imputed.first().map_or(f64::NAN, |own| own[index]);
        table.rows.push(vec![
            TableEntry::text(one.name.clone()),
            TableEntry::text(output::effect(pilot.effect)),
            TableEntry::number(pilot.people.len() as f64, 0),
            number(value),
            number(0.0),
            number(f64::NAN),
        ]);
    }
    PlainSection {
        heading: "Coefficients".to_owned(),
        words: vec![format!(
            "`people.csv` has them by person, and `fit.json` with standard errors{}.",
            imputed_words(pilot)
        )],
        tables: vec![("coefficients".to_owned(), table)],
        ..PlainSection::default()
    }
}
