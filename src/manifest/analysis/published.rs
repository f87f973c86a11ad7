//! Published numbers, read from a CSV file beside the manifest, for comparison in the report.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};
use toml::de::DeTable;

use crate::env::Family;
use crate::job::metric::MEAN_RETURN;
use crate::job::{CONSTANT, MetricName, Scalar};
use crate::key::{Kind, Parameter, free_key};
use crate::manifest::analysis::axis::ERROR_AXIS;
use crate::manifest::parameter::named;
use crate::manifest::section::Section;
use crate::manifest::{Manifest, nearest};
use crate::text::{Fault, Faults, Span};

/// Maximum size of a file of published numbers in bytes.
const MOST_BYTES: u64 = 10_000_000;

/// Columns besides those of parameters.
const COLUMNS: [&str; 15] = [
    "subject",
    "competitor",
    "agent",
    "scenario",
    "metric",
    "estimate",
    "term",
    "value",
    "sd",
    "se",
    "p",
    "n",
    "reading_error",
    "margin",
    "source",
];

/// The numbers of publications, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Published {
    /// One row for each number.
    pub rows: Vec<PublishedRow>,
    /// One for each published estimate.
    pub estimates: Vec<PublishedEstimate>,
}

/// A published estimate of an effect.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublishedEstimate {
    /// The name of the estimate in the manifest.
    pub estimate: String,
    /// The term of its effect.
    pub term: String,
    /// The number.
    pub value: f64,
    /// Its standard error.
    pub standard_error: Option<f64>,
    /// The two-sided p value of the hypothesis that it is 0.
    pub p: Option<f64>,
    /// Half the unit of its last digit, by which the number was rounded.
    pub rounding: f64,
}

/// A published number: a mean, or a difference of two means.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublishedRow {
    /// The kind of number, as tables name it.
    pub subject: String,
    /// Another algorithm than ours that has the number; empty if ours should have it, too.
    pub competitor: String,
    /// The agent, or `first - second` for a difference of two agents; empty for a rate of errors.
    pub agent: String,
    /// The scenario, or `first - second` for a difference of two scenarios; empty for a rate of errors.
    pub scenario: String,
    /// The values of parameters.
    pub parameters: Vec<(Parameter, Scalar)>,
    /// The metric; `None` for the rate at which the most likely context is wrong.
    pub metric: Option<MetricName>,
    /// The number.
    pub value: f64,
    /// The standard deviation over seeds of a mean.
    pub sd: Option<f64>,
    /// The two-sided p value of an unpaired t test of a difference.
    pub p: Option<f64>,
    /// The number of seeds of a mean, or of each side of a difference; of a rate, the number of samples.
    pub n: f64,
    /// Half-width of the error of reading the number off a figure; 0 for a printed number.
    pub reading_error: f64,
    /// The largest difference that counts as equivalent.
    pub margin: Option<f64>,
}

impl PublishedRow {
    /// Both sides of a difference, each an agent with a scenario; `None` for a mean.
    pub fn sides(&self) -> Option<[(&str, &str); 2]> {
        let (agent, scenario) = (self.agent.as_str(), self.scenario.as_str());
        match (agent.split_once(" - "), scenario.split_once(" - ")) {
            (Some((one, other)), None) => Some([(one, scenario), (other, scenario)]),
            (None, Some((one, other))) => Some([(agent, one), (agent, other)]),
            _ => None,
        }
    }

    /// The value of a parameter, if it is a number.
    pub fn value_of(&self, parameter: Parameter) -> Option<f64> {
        self.parameters.iter().find(|(known, _)| *known == parameter)?.1.number()
    }
}

impl Published {
    /// The dotted names of the parameters that rows state.
    pub fn stated(&self) -> Vec<String> {
        let names = self.rows.iter().flat_map(|row| &row.parameters);
        let names: BTreeSet<String> = names.map(|(parameter, _)| parameter.to_string()).collect();
        names.into_iter().collect()
    }

    /// Reads the file that a manifest names; `None` if it names no file.
    ///
    /// # Errors
    /// Faults of the file or of its name, with positions.
    pub fn of(manifest: &Manifest) -> Result<Option<Published>, Faults> {
        let Some(name) = &manifest.published else { return Ok(None) };
        Published::named(name, &manifest.path, &manifest.source).map(Some)
    }

    /// The faults of a manifest at `path`, together with the faults of the file of published numbers that
    /// it names.
    pub fn faults_with(faults: Faults, path: &Path) -> Vec<Faults> {
        let (root, _) = DeTable::parse_recoverable(faults.text());
        let name = root.get_ref().get("published").and_then(|node| node.get_ref().as_str());
        let label = path.display().to_string();
        let read = name.map(|name| Published::named(name, &label, faults.text()));
        match read {
            Some(Err(others)) => faults.and(others),
            Some(Ok(_)) | None => vec![faults],
        }
    }

    /// Reads the file called `name` in the folder of the manifest at `manifest`, whose text is `source`.
    fn named(name: &str, manifest: &str, source: &str) -> Result<Published, Faults> {
        let folder = Path::new(manifest).parent().unwrap_or(Path::new(""));
        let path = folder.join(name);
        let refused = |says: String, help: &str| {
            let message = format!("`published`: `{}` {says}", path.display());
            let fault = match span_of_name(source) {
                Some(span) => Fault::at(span, message),
                None => Fault::whole(message),
            };
            Faults::of_text(manifest, source, fault.help(help))
        };
        let unreadable = |reason: String| {
            let help = "the path is relative to the folder of the manifest";
            refused(format!("cannot be read: {reason}"), help)
        };
        let file = fs::metadata(&path).map_err(|error| unreadable(error.to_string()))?;
        if !file.is_file() {
            return Err(unreadable("it is not a regular file".to_owned()));
        }
        if file.len() > MOST_BYTES {
            return Err(unreadable(format!("it is larger than {MOST_BYTES} bytes")));
        }
        if path.extension().is_some_and(|extension| extension == "toml") {
            let says = "is a TOML file; published numbers are rows of a CSV file".to_owned();
            return Err(refused(
                says,
                "docs/report.md lists the columns; write one row per number",
            ));
        }
        let text = fs::read_to_string(&path).map_err(|error| unreadable(error.to_string()))?;
        Published::parse(&path, &text)
    }

    /// Reads the text of the file called `path`.
    ///
    /// # Errors
    /// The first fault of the text, with its line.
    pub fn parse(path: &Path, text: &str) -> Result<Published, Faults> {
        let fault = |(at, says): (usize, String)| {
            let message = format!("published numbers cannot be read: {says}");
            let span = Span { start: at, end: at };
            Faults::of_text(&path.display().to_string(), text, Fault::at(span, message))
        };
        read(text).map_err(fault)
    }
}

/// The rows of a text.
///
/// **Errors**: the first fault, with its place in the text.
fn read(text: &str) -> Result<Published, (usize, String)> {
    let mut reader =
        ReaderBuilder::new().comment(Some(b'#')).trim(Trim::All).from_reader(text.as_bytes());
    let broken = |error: csv::Error| {
        let at = error.position().map_or(0, |position| position.byte() as usize);
        (at, error.to_string())
    };
    let header = reader.headers().map_err(broken)?.clone();
    let at = header.position().map_or(0, |position| position.byte() as usize);
    let mut parameters = Vec::new();
    for (index, name) in header.iter().enumerate() {
        // A file can be of any family.
        let of_families = Family::all().iter().find_map(|family| named(family, name));
        let parameter = of_families.filter(|one| !matches!(one, Parameter::Job(_)));
        match parameter {
            _ if COLUMNS.contains(&name) => {}
            Some(parameter) => parameters.push((index, parameter)),
            None => {
                let meant = nearest(name, COLUMNS);
                let help =
                    meant.map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"));
                let says = format!("`{name}` is neither a column nor a parameter{help}");
                return Err((at, says));
            }
        }
    }
    if !header.iter().any(|name| name == "value") {
        return Err((at, "missing column `value`".to_owned()));
    }
    let mut published = Published::default();
    let of_estimate = header.iter().position(|name| name == "estimate");
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let at = record.position().map_or(0, |position| position.byte() as usize);
        let name = of_estimate.and_then(|index| record.get(index)).unwrap_or_default();
        if name.is_empty() {
            published.rows.push(row(&header, &parameters, &record).map_err(|says| (at, says))?);
        } else {
            let estimate = estimate(name, &header, &record).map_err(|says| (at, says))?;
            published.estimates.push(estimate);
        }
    }
    Ok(published)
}

/// The estimate of a record.
///
/// **Errors**: a description of the first fault.
fn estimate(
    name: &str,
    header: &StringRecord,
    record: &StringRecord,
) -> Result<PublishedEstimate, String> {
    let cell = |name: &str| {
        let index = header.iter().position(|known| known == name)?;
        record.get(index).filter(|text| !text.is_empty())
    };
    let number = |name: &str| {
        let number = |text: &str| text.parse().ok().filter(|number: &f64| number.is_finite());
        let fault = |text| format!("`{name}`: expected a number, found {text:?}");
        cell(name).map(|text| number(text).ok_or_else(|| fault(text))).transpose()
    };
    let written = cell("value").unwrap_or_default();
    let decimals = written.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    Ok(PublishedEstimate {
        estimate: name.to_owned(),
        term: cell("term").unwrap_or(CONSTANT).to_owned(),
        value: number("value")?.ok_or("missing `value`")?,
        standard_error: number("se")?,
        p: number("p")?,
        rounding: 0.5 * 0.1_f64.powi(decimals as i32),
    })
}

/// The row of a record.
///
/// **Errors**: a description of the first fault.
fn row(
    header: &StringRecord,
    parameters: &[(usize, Parameter)],
    record: &StringRecord,
) -> Result<PublishedRow, String> {
    let cell = |name: &str| {
        let index = header.iter().position(|known| known == name)?;
        record.get(index).filter(|text| !text.is_empty())
    };
    let number = |name: &str, text: &str| {
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| format!("`{name}`: expected a number, found {text:?}"))
    };
    let optional = |name: &str, is_valid: fn(f64) -> bool, expected: &str| match cell(name) {
        None => Ok(None),
        Some(text) => match number(name, text)? {
            number if is_valid(number) => Ok(Some(number)),
            _ => Err(format!("`{name}`: expected {expected}, found {text}")),
        },
    };
    let value = cell("value").ok_or("missing `value`")?;
    let metric = match cell("metric") {
        Some(ERROR_AXIS) => None,
        None => Some(MetricName::default()),
        Some(name) => {
            Some(MetricName::named(name).ok_or_else(|| format!("there is no metric {name:?}"))?)
        }
    };
    let given = parameters.iter().filter_map(|(index, parameter)| {
        let text = record.get(*index).filter(|text| !text.is_empty())?;
        Some(scalar(*parameter, text).map(|value| (*parameter, value)))
    });
    let n = optional("n", |n| n >= 1.0 && n.fract() == 0.0, "a whole number above 0")?;
    let mut row = PublishedRow {
        subject: cell("subject").unwrap_or_default().to_owned(),
        competitor: cell("competitor").unwrap_or_default().to_owned(),
        agent: cell("agent").unwrap_or_default().to_owned(),
        scenario: cell("scenario").unwrap_or_default().to_owned(),
        parameters: given.collect::<Result<_, _>>()?,
        metric,
        value: number("value", value)?,
        sd: optional("sd", |sd| sd >= 0.0, "a number from 0")?,
        p: optional("p", |p| (0.0..=1.0).contains(&p), "a number from 0 to 1")?,
        n: n.ok_or("missing `n`, the number of seeds of a mean, or of each side of a difference")?,
        reading_error: optional("reading_error", |error| error >= 0.0, "a number from 0")?
            .unwrap_or(0.0),
        margin: optional("margin", |margin| margin > 0.0, "a number above 0")?,
    };
    if let Some(fault) = fault_of_sides(&row) {
        return Err(fault.to_owned());
    }
    if row.subject.is_empty() {
        row.subject = usual_subject(&row);
    }
    Ok(row)
}

/// Why a row is neither of a mean nor of a difference.
fn fault_of_sides(row: &PublishedRow) -> Option<&'static str> {
    let is_difference = row.sides().is_some();
    if row.p.is_some() && !is_difference {
        return Some("`p` is of a difference: name two agents or two scenarios, `first - second`");
    }
    if row.sd.is_some() && is_difference {
        return Some("`sd` is of a mean; how uncertain a difference is, `p` says");
    }
    let has_sides = [&row.agent, &row.scenario].iter().any(|sides| sides.contains(" - "));
    (!is_difference && has_sides).then_some(
        "a difference is between two agents or between two scenarios: write ` - ` once, in one of the columns \
         `agent` and `scenario`",
    )
}

/// The subject of a row that names none.
fn usual_subject(row: &PublishedRow) -> String {
    let kind = match (row.metric, row.sides().is_some(), row.p) {
        (None, ..) => "error rate",
        (_, true, Some(_)) => "effect",
        (_, true, None) => "difference",
        (_, false, _) => "mean",
    };
    match row.metric.filter(|metric| *metric != MEAN_RETURN) {
        Some(metric) => format!("{} {kind}", metric.text().replace('_', " ")),
        None => kind.to_owned(),
    }
}

/// The value of a parameter: a number, or a word or flag that a key of this name takes.
///
/// **Errors**: a description of what was expected.
fn scalar(parameter: Parameter, text: &str) -> Result<Scalar, String> {
    if let Some(number) = text.parse().ok().filter(|number: &f64| number.is_finite()) {
        return Ok(Scalar::Real(number));
    }
    let keys = Section::all().into_iter().filter_map(|section| section.find(parameter.key()));
    let keys = keys.map(|(_, key)| key).chain(free_key(parameter.key()));
    let kinds: Vec<Kind> = keys.map(|key| key.kind).collect();
    let json = text.parse().map_or_else(|_| text.into(), serde_json::Value::Bool);
    let known = kinds.iter().find_map(|kind| match kind {
        Kind::Flag | Kind::Choice(_) | Kind::Scalar | Kind::AnyOf(_) => kind.value(&json),
        _ => None,
    });
    known.map(|value| Scalar::from(&value)).ok_or_else(|| {
        let expected = match kinds.first() {
            Some(kind @ (Kind::Flag | Kind::Choice(_) | Kind::AnyOf(_))) => kind.expectation(),
            _ => "a number".to_owned(),
        };
        format!("`{parameter}`: expected {expected}, found {text:?}")
    })
}

/// The position of the key for published numbers in a manifest's text.
fn span_of_name(text: &str) -> Option<Span> {
    let (root, _) = DeTable::parse_recoverable(text);
    Some(root.get_ref().get("published")?.span().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_numbers_are_read_and_counted() {
        let text = include_str!("../../../experiments/paper/published.csv");
        let published = Published::parse(Path::new("published.csv"), text).unwrap();
        let count =
            |subject: &str| published.rows.iter().filter(|row| row.subject == subject).count();
        assert_eq!(
            ["effect", "curve point", "heat-map tile", "error rate"].map(count),
            [20, 48, 32, 6]
        );
        let first = &published.rows[0];
        assert_eq!(first.sides(), Some([("dqn", "P-H-D"), ("dqn", "L-H-D")]));
        assert_eq!(first.value_of(Parameter::Environment("sigma")), Some(0.4));
        assert_eq!((first.value, first.p, first.n), (483.02, Some(0.0193), 3.0));
    }

    #[test]
    fn estimates_are_known_by_their_names_and_terms() {
        let text = "estimate,term,value,se,p\neffect,,0.13,0.07,0.06\nby day,day,-0.018,,\n";
        let published = Published::parse(Path::new("p.csv"), text).unwrap();
        let [effect, day] = &published.estimates[..] else { panic!("{published:?}") };
        assert_eq!((effect.term.as_str(), effect.standard_error), (CONSTANT, Some(0.07)));
        assert_eq!((day.value, day.p), (-0.018, None));
        assert!((day.rounding - 0.0005).abs() < 1e-12);
        assert!(published.rows.is_empty());
        let faulty = Published::parse(Path::new("p.csv"), "estimate,value\neffect,much\n");
        assert!(faulty.unwrap_err().to_string().contains("p.csv:2:1: published numbers"));
    }

    #[test]
    fn rows_state_words_and_flags_as_well_as_numbers() {
        let text =
            "value,n,time_one_hot,step_noise,pooling\n1,3,true,gamma,none\n2,3,false,,full\n";
        let published = Published::parse(Path::new("p.csv"), text).unwrap();
        let stated = |row: usize| -> Vec<String> {
            let values = published.rows[row].parameters.iter();
            values.map(|(name, value)| format!("{name}={value}")).collect()
        };
        assert_eq!(
            stated(0),
            ["environment.time_one_hot=1", "environment.step_noise=gamma", "trial.pooling=none"]
        );
        assert_eq!(stated(1), ["environment.time_one_hot=0", "trial.pooling=full"]);
        let stated = published.stated();
        assert_eq!(stated[0], "environment.step_noise", "{stated:?}");
    }

    #[test]
    fn numbers_of_other_metrics_than_the_mean_return_are_subjects_of_their_own() {
        let text = "agent,metric,value,n\na,mean_return,9,3\na,disengagement_rate,0.1,3\n";
        let published = Published::parse(Path::new("p.csv"), text).unwrap();
        let subjects = published.rows.iter().map(|row| row.subject.as_str());
        assert!(subjects.eq(["mean", "disengagement rate mean"]));
    }

    #[test]
    fn a_file_of_the_earlier_form_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("p.toml"), "format = 1\n").unwrap();
        let manifest = folder.path().join("m.toml").display().to_string();
        let faults = Published::named("p.toml", &manifest, "published = \"p.toml\"").unwrap_err();
        assert!(
            faults.to_string().contains("published numbers are rows of a CSV file"),
            "{faults}"
        );
    }

    #[test]
    fn faults_of_the_file_say_where_they_are() {
        for (text, expected) in [
            ("agent,value,n\na,1\n", "p.csv:2:1: "),
            (
                "agent,valeu,n\na,1,3\n",
                "`valeu` is neither a column nor a parameter; did you mean `value`?",
            ),
            ("agent,n\na,1\n", "missing column `value`"),
            (
                "# text\nvalue,n\n1,3\nx,3\n",
                "p.csv:4:1: published numbers cannot be read: `value`: expected a number, found \"x\"",
            ),
            ("value\n1\n", "missing `n`"),
            ("value,n,p\n1,3,0.5\n", "`p` is of a difference"),
            ("agent,value,n,sd\na - b,1,3,2\n", "`sd` is of a mean"),
            ("agent,scenario,value,n\na - b,P - L,1,3\n", "write ` - ` once"),
            ("value,n,metric\n1,3,speed\n", "there is no metric \"speed\""),
            ("value,n,margin\n1,3,0\n", "`margin`: expected a number above 0, found 0"),
            ("value,n,time_one_hot\n1,3,yes\n", "expected true or false, found \"yes\""),
            ("value,n,step_noise\n1,3,tiny\n", "expected \"none\" or \"gamma\", found \"tiny\""),
            ("value,n,sigma\n1,3,low\n", "expected a number, found \"low\""),
        ] {
            let faults = Published::parse(Path::new("p.csv"), text).unwrap_err().to_string();
            assert!(faults.contains(expected), "{text}: {faults}");
        }
    }
}
