//! Published numbers, read from a file beside the manifest, for comparison in the report.

use std::fs;
use std::path::Path;

use serde::Deserialize;
use toml::de::DeTable;

use super::Manifest;
use super::fault::{Fault, Faults};
use super::source::Span;

/// Maximum size of a file of published numbers in bytes.
const MOST_BYTES: u64 = 10_000_000;

/// The numbers of a publication. The lists of one table have equal lengths.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// The largest differences that count as equivalent.
    #[serde(default)]
    pub equivalence: Equivalence,
    /// Rates of context inference error.
    pub sigma_to_error: Option<PublishedErrors>,
    /// Differences of means with their p values.
    #[serde(default, rename = "t_test")]
    pub t_tests: Vec<PublishedTest>,
    /// Mean returns along sigma.
    #[serde(default, rename = "curve")]
    pub curves: Vec<PublishedCurve>,
    /// Differences of means over two parameters.
    #[serde(default, rename = "heat_map")]
    pub heat_maps: Vec<PublishedHeatMap>,
}

/// Margins of equivalence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Equivalence {
    /// Of returns and their differences, in steps walked.
    pub steps: Option<f64>,
    /// Of error rates, as a share.
    pub rate: Option<f64>,
}

/// Rates of context inference error by sigma.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedErrors {
    /// Feature noise.
    pub sigma: Vec<f64>,
    /// Rates as printed: counted in one draw of 1000.
    pub reported: Vec<f64>,
    /// Rates by the formula.
    pub exact: Vec<f64>,
}

/// Differences along sigma, with the p values of unpaired t tests.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedTest {
    /// `first - second`: two scenarios or two agents.
    pub contrast: String,
    /// The agent, where the sides are scenarios.
    pub agent: Option<String>,
    /// The scenario, where the sides are agents.
    pub scenario: Option<String>,
    /// Feature noise.
    pub sigma: Vec<f64>,
    /// Differences, in steps walked.
    pub effect: Vec<f64>,
    /// Two-sided p values, rounded to five decimals.
    pub p_value: Vec<f64>,
}

/// A published line of a figure.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedCurve {
    /// The agent.
    pub agent: String,
    /// The scenario.
    pub scenario: String,
    /// Feature noise.
    pub sigma: Vec<f64>,
    /// Mean returns, in steps walked.
    #[serde(rename = "return")]
    pub mean_return: Vec<f64>,
}

/// Differences over two parameters of disengagement.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedHeatMap {
    /// The agent.
    pub agent: String,
    /// `first - second`: two scenarios.
    pub contrast: String,
    /// `delta_d` of each row.
    pub delta_d: Vec<f64>,
    /// `epsilon_d` of each column.
    pub epsilon_d: Vec<f64>,
    /// Differences, in steps walked, one list per row.
    pub effect: Vec<Vec<f64>>,
}

impl Published {
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
        let unreadable = |reason: String| {
            let message = format!("`published`: `{}` cannot be read: {reason}", path.display());
            let fault = match span_of_name(source) {
                Some(span) => Fault::at(span, message),
                None => Fault::whole(message),
            };
            let fault = fault.help("the path is relative to the folder of the manifest");
            Faults::of_text(manifest, source, fault)
        };
        let file = fs::metadata(&path).map_err(|error| unreadable(error.to_string()))?;
        if !file.is_file() {
            return Err(unreadable("it is not a regular file".to_owned()));
        }
        if file.len() > MOST_BYTES {
            return Err(unreadable(format!("it is larger than {MOST_BYTES} bytes")));
        }
        let text = fs::read_to_string(&path).map_err(|error| unreadable(error.to_string()))?;
        Published::parse(&path, &text)
    }

    /// Reads the text of the file called `path`.
    ///
    /// # Errors
    /// Faults of the text, with positions.
    pub fn parse(path: &Path, text: &str) -> Result<Published, Faults> {
        let label = path.display().to_string();
        let fault = |message: String| Faults::of_file(&label, Fault::whole(message));
        let published: Published = toml::from_str(text).map_err(|error| {
            let message = format!("published numbers cannot be read: {}", error.message());
            match error.span() {
                Some(span) => Faults::of_text(&label, text, Fault::at(span.into(), message)),
                None => fault(message),
            }
        })?;
        let Equivalence { steps, rate } = published.equivalence;
        if [steps, rate].iter().flatten().any(|margin| !(*margin > 0.0 && margin.is_finite())) {
            return Err(fault("a margin of [equivalence] is not above 0".to_owned()));
        }
        match published.uneven() {
            None => Ok(published),
            Some(table) => Err(fault(format!("the lists of a [{table}] differ in length"))),
        }
    }

    /// The name of a table whose lists differ in length.
    fn uneven(&self) -> Option<&'static str> {
        let errors = self.sigma_to_error.iter();
        if errors
            .clone()
            .any(|e| e.sigma.len() != e.reported.len() || e.sigma.len() != e.exact.len())
        {
            return Some("sigma_to_error");
        }
        let even =
            |t: &PublishedTest| t.sigma.len() == t.effect.len() && t.sigma.len() == t.p_value.len();
        if !self.t_tests.iter().all(even) {
            return Some("[t_test]");
        }
        if self.curves.iter().any(|curve| curve.sigma.len() != curve.mean_return.len()) {
            return Some("[curve]");
        }
        let uneven = |map: &PublishedHeatMap| {
            let ragged = map.effect.iter().any(|row| row.len() != map.epsilon_d.len());
            map.effect.len() != map.delta_d.len() || ragged
        };
        self.heat_maps.iter().any(uneven).then_some("[heat_map]")
    }
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
        let text = include_str!("../../experiments/paper/published.toml");
        let published = Published::parse(Path::new("published.toml"), text).unwrap();
        let effects: usize = published.t_tests.iter().map(|test| test.effect.len()).sum();
        let points: usize = published.curves.iter().map(|curve| curve.sigma.len()).sum();
        let tiles = published.heat_maps.iter().flat_map(|map| &map.effect).flatten().count();
        assert_eq!((effects, points, tiles), (20, 48, 32));
    }

    #[test]
    fn lists_of_unequal_length_are_refused() {
        let text = "[[curve]]\nagent = \"a\"\nscenario = \"C\"\nsigma = [0.1, 0.2]\nreturn = [1.0]";
        let faults = Published::parse(Path::new("p.toml"), text).unwrap_err();
        assert!(faults.to_string().contains("the lists of a [[curve]] differ in length"));
    }
}
