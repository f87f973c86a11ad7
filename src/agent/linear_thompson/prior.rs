//! The posterior of an earlier job as the prior of another.

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::Deserialize;
use serde_json::{Value as Json, json};

use crate::agent::linear_thompson::features::{BanditFeatures, Design};
use crate::agent::linear_thompson::regression::Regression;
use crate::env::{Action, FeatureSpec, Interface, ObservationSpec};
use crate::key::ContentForm;

/// The form of a file with a posterior. A job knows it by the posterior alone.
pub static PRIOR: ContentForm = ContentForm {
    what: "a policy.json with a posterior, as `jitai export --policy` writes it",
    parse: |text| Ok(Arc::new(Prior::read(text)?)),
    canonical: Some(|text| Ok(Prior::read(text)?.text())),
};

/// The posterior of all regressions of an agent, and what they are regressions on.
#[derive(Debug, PartialEq)]
pub struct Prior {
    features: Vec<String>,
    one_hot: usize,
    actions: usize,
    design: BanditFeatures,
    is_centred: bool,
    /// Means, \[regressions, regressors\].
    means: Vec<Vec<f64>>,
    regressions: Vec<Regression>,
}

/// A file, of which other keys are not read.
#[derive(Deserialize)]
struct File {
    features: Vec<Named>,
    actions: Actions,
    posterior: Json,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Named {
    Name(String),
    Described { name: String },
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Actions {
    Number(usize),
    Names(Vec<Json>),
}

#[derive(Deserialize)]
struct Posterior {
    features: String,
    action_centring: bool,
    #[serde(default)]
    one_hot: usize,
    mean: Vec<Vec<f64>>,
    precision: Option<Matrices>,
    covariance: Option<Matrices>,
}

/// A square matrix per regression.
type Matrices = Vec<Vec<Vec<f64>>>;

/// Largest difference of two entries that mirror each other, relative to the largest entry.
const ASYMMETRY: f64 = 1e-9;

impl Prior {
    /// Reads a file.
    ///
    /// **Errors**: it is not JSON, lacks a key, or has no positive definite posterior of the right shape.
    fn read(text: &str) -> Result<Prior, String> {
        let json: Json = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if json.get("posterior").is_none() {
            return Err(
                "it has no `posterior`; expected the policy of a job of linear_thompson".to_owned()
            );
        }
        let file: File = serde_json::from_value(json).map_err(|error| error.to_string())?;
        let posterior: Posterior = serde_json::from_value(file.posterior)
            .map_err(|error| format!("`posterior`: {error}"))?;
        let design = BanditFeatures::named(&posterior.features).ok_or_else(|| {
            let words = BanditFeatures::WORDS.join("\" or \"");
            format!("`posterior.features`: expected \"{words}\", found {:?}", posterior.features)
        })?;
        let actions = match file.actions {
            Actions::Number(actions) => actions,
            Actions::Names(names) => names.len(),
        };
        if !Action::COUNTS.contains(&actions) {
            return Err(format!("`actions`: expected 2 to 256 actions, found {actions}"));
        }
        let mut features: Vec<String> = file
            .features
            .into_iter()
            .map(|(Named::Name(name) | Named::Described { name })| name)
            .collect();
        let letters = features.len().checked_sub(posterior.one_hot);
        features.truncate(letters.ok_or("`posterior.one_hot` exceeds the number of features")?);
        let width = Design::of(design, features.len(), posterior.one_hot).width();
        let shape = Design::regressors(width, actions, posterior.action_centring);
        let (matrices, name) = match (posterior.precision, posterior.covariance) {
            (Some(precision), None) => (precision, "precision"),
            (None, Some(covariance)) => (covariance, "covariance"),
            _ => return Err("`posterior`: expected either `precision` or `covariance`".to_owned()),
        };
        let is_of_shape = posterior.mean.len() == shape.0
            && matrices.len() == shape.0
            && posterior.mean.iter().all(|mean| mean.len() == shape.1)
            && matrices.iter().all(|matrix| {
                matrix.len() == shape.1 && matrix.iter().all(|row| row.len() == shape.1)
            });
        if !is_of_shape {
            let (count, width) = shape;
            return Err(format!(
                "`posterior`: expected `mean` of {count} x {width} numbers and `{name}` of {count} x {width} x \
                 {width}, for {} features and {actions} actions",
                features.len() + posterior.one_hot
            ));
        }
        let regressions =
            posterior.mean.iter().zip(&matrices).enumerate().map(|(place, (mean, matrix))| {
                let matrix = DMatrix::from_iterator(
                    shape.1,
                    shape.1,
                    matrix.iter().flatten().map(|x| x + 0.0),
                );
                let says = || {
                    format!(
                        "`posterior.{name}`: matrix {} is not symmetric and positive definite",
                        place + 1
                    )
                };
                let largest = matrix.amax();
                let is_symmetric = (&matrix - matrix.transpose()).amax() <= ASYMMETRY * largest;
                let root =
                    Cholesky::new(matrix.clone()).filter(|_| is_symmetric).ok_or_else(says)?;
                let precision = if name == "precision" { matrix } else { root.inverse() };
                let information = &precision * DVector::from_column_slice(mean);
                Ok(Regression { precision, information })
            });
        let regressions = regressions.collect::<Result<_, String>>()?;
        Ok(Prior {
            features,
            one_hot: posterior.one_hot,
            actions,
            design,
            is_centred: posterior.action_centring,
            means: posterior.mean,
            regressions,
        })
    }

    /// The file with nothing but the posterior.
    fn text(&self) -> String {
        let times = (0..self.one_hot).map(|time| format!("t{time}"));
        let names: Vec<String> = self.features.iter().cloned().chain(times).collect();
        let precisions = self.regressions.iter().map(|regression| {
            let precision = &regression.precision;
            precision.as_slice().chunks_exact(precision.nrows()).collect::<Vec<_>>()
        });
        let means =
            self.means.iter().map(|mean| mean.iter().map(|x| x + 0.0).collect::<Vec<f64>>());
        json!({
            "features": names,
            "actions": self.actions,
            "posterior": {
                "features": self.design.word(),
                "action_centring": self.is_centred,
                "one_hot": self.one_hot,
                "mean": means.collect::<Vec<_>>(),
                "precision": precisions.collect::<Vec<_>>(),
            },
        })
        .to_string()
    }

    /// The regressions, one per action or a shared one.
    pub fn regressions(&self) -> &[Regression] {
        &self.regressions
    }

    /// Whether the regressions are shared with action centring, and the features of states.
    pub fn design(&self) -> (BanditFeatures, bool) {
        (self.design, self.is_centred)
    }

    /// Whether an agent with these observations and actions has such regressions.
    pub fn suits(&self, Interface { observations, actions }: &Interface) -> bool {
        let ObservationSpec { features, one_hot } = observations;
        let names = features.iter().map(|FeatureSpec { name, .. }| name.as_str());
        names.eq(self.features.iter().map(String::as_str))
            && (*one_hot, *actions) == (self.one_hot, self.actions)
    }

    /// What the regressions are on, as in "the features C, H and 4 actions".
    pub fn subject(&self) -> String {
        subject(self.features.iter().map(String::as_str), self.one_hot, self.actions)
    }
}

/// What an agent sees and chooses among, in the words of [`Prior::subject`].
pub fn subject_of(Interface { observations, actions }: &Interface) -> String {
    let names = observations.features.iter().map(|feature| feature.name.as_str());
    subject(names, observations.one_hot, *actions)
}

fn subject<'n>(names: impl Iterator<Item = &'n str>, one_hot: usize, actions: usize) -> String {
    let mut names: Vec<String> = names.map(str::to_owned).collect();
    if one_hot > 0 {
        names.push(format!("a one-hot of {one_hot} times"));
    }
    format!("the features {} and {actions} actions", names.join(", "))
}
