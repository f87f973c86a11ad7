//! The posterior of an earlier job as the prior of another.

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::Deserialize;
use serde_json::{Value as Json, json};

use crate::agent::linear_thompson::features::{BanditFeatures, Design};
use crate::agent::linear_thompson::regression::Regression;
use crate::env::{Action, FeatureSpec, Interface, ObservationSpec};
use crate::key::{ContentForm, MOST_BYTES};

/// The form of a file with a posterior. A job knows it by the posterior alone.
pub static PRIOR: ContentForm = ContentForm {
    what: "a policy.json with a posterior, as `jitai export --policy` writes it",
    parse: |text| Ok(Arc::new(Prior::read(text)?)),
    canonical: Some(|text| Ok(Prior::read(text)?.text())),
    shipped: &[],
    help: Some("`jitai export --policy` writes it; `run:KEY` names a job of the store instead"),
    most_bytes: MOST_BYTES,
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
    /// After partial pooling: the standard deviations of people around the common coefficients, \[regressions, regressors\],
    /// and the posterior of the common coefficients.
    common: Option<Common>,
}

/// Standard deviations, \[regressions, regressors\], and regressions.
type Common = (Vec<Vec<f64>>, Vec<Regression>);

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
    person_sd: Option<Vec<Vec<f64>>>,
}

/// A square matrix per regression.
type Matrices = Vec<Vec<Vec<f64>>>;

/// Largest difference of two entries that mirror each other, relative to the largest entry.
const ASYMMETRY: f64 = 1e-9;

impl Posterior {
    /// The regressions, if they have this number and width; `shown` has the numbers of features and actions for messages.
    ///
    /// **Errors**: the numbers have another shape, or a matrix is not positive definite.
    fn regressions(
        &self,
        (count, width): (usize, usize),
        shown: (usize, usize),
    ) -> Result<Vec<Regression>, String> {
        let (matrices, name) = match (&self.precision, &self.covariance) {
            (Some(precision), None) => (precision, "precision"),
            (None, Some(covariance)) => (covariance, "covariance"),
            _ => return Err("`posterior`: expected either `precision` or `covariance`".to_owned()),
        };
        let is_square = |matrix: &Vec<Vec<f64>>| {
            matrix.len() == width && matrix.iter().all(|row| row.len() == width)
        };
        let is_of_shape = self.mean.len() == count
            && matrices.len() == count
            && self.mean.iter().all(|mean| mean.len() == width)
            && matrices.iter().all(is_square);
        if !is_of_shape {
            let (features, actions) = shown;
            return Err(format!(
                "`posterior`: expected `mean` of {count} x {width} numbers and `{name}` of {count} x {width} x \
                 {width}, for {features} features and {actions} actions"
            ));
        }
        let regression = |(index, (mean, matrix)): (usize, (&Vec<f64>, &Vec<Vec<f64>>))| {
            let numbers = matrix.iter().flatten().map(|x| x + 0.0);
            let matrix = DMatrix::from_iterator(width, width, numbers);
            let says = || {
                format!(
                    "`posterior.{name}`: matrix {} is not symmetric and positive definite",
                    index + 1
                )
            };
            let is_symmetric = (&matrix - matrix.transpose()).amax() <= ASYMMETRY * matrix.amax();
            let root = Cholesky::new(matrix.clone()).filter(|_| is_symmetric).ok_or_else(says)?;
            let precision = if name == "precision" { matrix } else { root.inverse() };
            let information = &precision * DVector::from_column_slice(mean);
            Ok(Regression { precision, information })
        };
        self.mean.iter().zip(matrices).enumerate().map(regression).collect()
    }

    /// After partial pooling, the regressions are those of a person without data, θ + u; those of θ have the variances
    /// of the deviations less.
    ///
    /// **Errors**: the deviations have another shape, or are not smaller than what is known without them.
    fn common(&self, regressions: &[Regression]) -> Result<Option<Common>, String> {
        let Some(sds) = &self.person_sd else { return Ok(None) };
        let is_of_shape = sds.len() == self.mean.len()
            && sds.iter().zip(&self.mean).all(|(sds, mean)| sds.len() == mean.len());
        if !is_of_shape {
            return Err("`posterior.person_sd`: expected a number for each of `mean`".to_owned());
        }
        let common = |(index, (regression, sds)): (usize, (&Regression, &Vec<f64>))| {
            let says = || {
                format!(
                    "`posterior.person_sd`: the covariance of regression {} has smaller variances",
                    index + 1
                )
            };
            let root = Cholesky::new(regression.precision.clone()).ok_or_else(says)?;
            let mut covariance = root.inverse();
            for (index, sd) in sds.iter().enumerate() {
                covariance[(index, index)] -= sd * sd;
            }
            let precision = Cholesky::new(covariance).ok_or_else(says)?.inverse();
            let information = &precision * root.solve(&regression.information);
            Ok(Regression { precision, information })
        };
        let all = regressions.iter().zip(sds).enumerate().map(common);
        Ok(Some((sds.clone(), all.collect::<Result<Vec<Regression>, String>>()?)))
    }
}

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
        let shown = (features.len() + posterior.one_hot, actions);
        let regressions = posterior.regressions(shape, shown)?;
        Ok(Prior {
            common: posterior.common(&regressions)?,
            features,
            one_hot: posterior.one_hot,
            actions,
            design,
            is_centred: posterior.action_centring,
            regressions,
            means: posterior.mean,
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
        let mut posterior = json!({
            "features": self.design.word(),
            "action_centring": self.is_centred,
            "one_hot": self.one_hot,
            "mean": means.collect::<Vec<_>>(),
            "precision": precisions.collect::<Vec<_>>(),
        });
        if let Some((sds, _)) = &self.common {
            posterior["person_sd"] = json!(sds);
        }
        json!({ "features": names, "actions": self.actions, "posterior": posterior }).to_string()
    }

    /// The posterior of what people have in common: after partial pooling without their deviations.
    pub fn common(&self) -> &[Regression] {
        self.common.as_ref().map_or(&self.regressions, |(_, common)| common)
    }

    /// The regressions of a person without data, one per action or a shared one.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::linear_thompson::posterior::{Decision, Posterior};
    use crate::agent::linear_thompson::{LinearThompson, LinearThompsonStudy};
    use crate::agent::{Shape, Sharing, StudyPlan};
    use crate::env::{Environment, Scenario, StepCount};
    use crate::key::Content;
    use crate::rng::{Purpose, Stream};

    /// Number of features of a state, the intercept among them.
    const WIDTH: usize = 3;

    /// The posterior as a file of an agent with the features C and H and four actions.
    fn file(parameters: &LinearThompson, posterior: &Posterior) -> Json {
        let weights = posterior.weights();
        let width = weights.doubles["mean"].shape[1];
        let rows = |name: &str| -> Vec<Vec<f64>> {
            weights.doubles[name].values.chunks_exact(width).map(<[f64]>::to_vec).collect()
        };
        let precision = rows("precision");
        json!({
            "features": [{ "name": "C" }, { "name": "H" }],
            "actions": ["nothing", "a", "b", "c"],
            "posterior": {
                "features": "linear",
                "action_centring": parameters.action_centring,
                "mean": rows("mean"),
                "precision": precision.chunks_exact(width).collect::<Vec<_>>(),
            },
        })
    }

    fn read(file: &Json) -> Result<Content, String> {
        Content::read(&PRIOR, &file.to_string()).map_err(|fault| fault.to_string())
    }

    fn decisions(count: usize, seed: u64) -> Vec<(Decision, f64)> {
        let mut stream = Stream::new(seed, Purpose::Exploration);
        let mut decision = || {
            let features = vec![1.0, stream.unit(), stream.unit()];
            let action = Action::from_index((4.0 * stream.unit()) as usize).unwrap();
            let reward = 100.0 * features[1] - 20.0 * action.index() as f64 + stream.unit();
            (Decision { features, probabilities: vec![0.4, 0.1, 0.3, 0.2], action }, reward)
        };
        (0..count).map(|_| decision()).collect()
    }

    /// The regressors of a decision, and the regression that they belong to.
    fn regressors(decision: &Decision, is_centred: bool) -> (usize, Vec<f64>) {
        let Decision { features, probabilities, action } = decision;
        if !is_centred {
            return (action.index(), features.clone());
        }
        let taken = |k: usize| if action.index() == k { 1.0 } else { 0.0 };
        let factors = [1.0]
            .into_iter()
            .chain((1..4).map(|k| probabilities[k]))
            .chain((1..4).map(|k| taken(k) - probabilities[k]));
        (0, factors.flat_map(|factor| features.iter().map(move |f| factor * f)).collect())
    }

    #[test]
    fn two_jobs_in_a_row_learn_what_conjugacy_says() {
        for action_centring in [false, true] {
            let first =
                LinearThompson { action_centring, noise_sd: 30.0, ..LinearThompson::default() };
            let shape = Shape::of_four(WIDTH);
            let mut posterior = Posterior::prior(&first, shape);
            let of_first = decisions(40, 1);
            of_first.iter().for_each(|(decision, reward)| _ = posterior.learn(decision, *reward));
            let prior_from = read(&file(&first, &posterior)).unwrap();
            let second = LinearThompson { prior_from, noise_sd: 12.0, ..first.clone() };
            let mut posterior = Posterior::prior(&second, shape);
            let of_second = decisions(25, 2);
            of_second.iter().for_each(|(decision, reward)| _ = posterior.learn(decision, *reward));
            // The prior of the first job, and the data of both.
            let (count, width) = Design::regressors(WIDTH, 4, action_centring);
            let mut precisions = vec![DMatrix::from_diagonal_element(width, width, 0.01); count];
            let mut informations = vec![DVector::zeros(width); count];
            for (of, noise) in [(&of_first, 30.0 * 30.0), (&of_second, 12.0 * 12.0)] {
                for (decision, reward) in of {
                    let (index, row) = regressors(decision, action_centring);
                    let row = DVector::from_vec(row);
                    precisions[index] += &row * row.transpose() / noise;
                    informations[index] += row * (*reward / noise);
                }
            }
            let pairs = precisions.into_iter().zip(informations);
            for (ours, (precision, information)) in posterior.regressions().iter().zip(pairs) {
                let scale = precision.amax();
                assert!((&ours.precision - precision).amax() < 1e-12 * scale);
                let scale = information.amax();
                assert!((&ours.information - information).amax() < 1e-10 * scale);
            }
            assert_eq!(posterior.regressions().len(), count);
        }
    }

    #[test]
    fn the_common_coefficients_of_partial_pooling_have_no_deviations() {
        let parameters = LinearThompson::default();
        let posterior = Posterior::prior(&parameters, Shape::of_four(WIDTH));
        let mut whole = file(&parameters, &posterior);
        // The prior has a standard deviation of 10.
        whole["posterior"]["person_sd"] = json!(vec![[6.0, 0.0, 8.0]; 4]);
        let content = read(&whole).unwrap();
        let text = content.text().unwrap();
        assert_eq!(Content::read(&PRIOR, text).unwrap().text(), Some(text));
        let prior: Arc<Prior> = content.parsed().unwrap();
        for (common, whole) in prior.common().iter().zip(prior.regressions()) {
            let covariance = common.precision.clone().try_inverse().unwrap();
            let expected = [100.0 - 36.0, 100.0, 100.0 - 64.0];
            for (variance, expected) in covariance.diagonal().iter().zip(expected) {
                assert!((variance - expected).abs() < 1e-9, "{covariance}");
            }
            assert_eq!(whole.precision[(0, 0)], posterior.regressions()[0].precision[(0, 0)]);
        }
        for (sds, expected) in [
            (json!(vec![[6.0, 0.0, 10.0]; 4]), "regression 1 has smaller variances"),
            (json!(vec![[6.0, 0.0]; 4]), "a number for each of `mean`"),
        ] {
            whole["posterior"]["person_sd"] = sds;
            let says = read(&whole).unwrap_err();
            assert!(says.contains(expected), "{says}");
        }
    }

    #[test]
    fn a_posterior_is_known_by_itself() {
        let parameters = LinearThompson::default();
        let mut posterior = Posterior::prior(&parameters, Shape::of_four(WIDTH));
        decisions(9, 1)
            .iter()
            .for_each(|(decision, reward)| _ = posterior.learn(decision, *reward));
        let whole = file(&parameters, &posterior);
        let content = read(&whole).unwrap();
        let mut bare = whole.clone();
        bare["features"] = json!(["C", "H"]);
        bare["actions"] = json!(4);
        bare["posterior"]["one_hot"] = json!(0);
        bare["job"] = json!("another");
        assert_eq!(read(&bare).unwrap().name(), content.name());
        // The text of a job is a file of the same posterior.
        let text = content.text().unwrap();
        assert_eq!(Content::read(&PRIOR, text).unwrap().text(), Some(text));
        let mut other = whole.clone();
        other["posterior"]["mean"][2][1] = json!(7.5);
        assert_ne!(read(&other).unwrap(), content);
        // A covariance stands for its inverse.
        let mut inverse = whole.clone();
        let covariances = posterior.regressions().iter().map(|one| {
            let covariance = one.precision.clone().try_inverse().unwrap();
            covariance.column_iter().map(|column| column.as_slice().to_vec()).collect::<Vec<_>>()
        });
        inverse["posterior"]["covariance"] = covariances.collect();
        assert!(read(&inverse).unwrap_err().contains("either `precision` or `covariance`"));
        inverse["posterior"].as_object_mut().unwrap().remove("precision");
        let inverse: Arc<Prior> = read(&inverse).unwrap().parsed().unwrap();
        for (one, other) in inverse.regressions().iter().zip(posterior.regressions()) {
            assert!((&one.precision - &other.precision).amax() < 1e-9 * other.precision.amax());
        }
    }

    #[test]
    fn what_is_no_posterior_is_refused_with_its_place() {
        let parameters = LinearThompson::default();
        let whole = file(&parameters, &Posterior::prior(&parameters, Shape::of_four(WIDTH)));
        let mut lopsided = whole["posterior"]["precision"].clone();
        lopsided[1][0][2] = json!(0.001);
        let mut negative = whole["posterior"]["precision"].clone();
        negative[3][1][1] = json!(-1.0);
        for (pointer, value, expected) in [
            ("/posterior", Json::Null, "`posterior`: invalid type: null"),
            (
                "/posterior/features",
                json!("cubes"),
                "expected \"linear\" or \"interactions\", found \"cubes\"",
            ),
            ("/posterior/features", json!("interactions"), "`mean` of 4 x 4 numbers"),
            ("/posterior/action_centring", json!(true), "`mean` of 1 x 21 numbers"),
            (
                "/posterior/mean",
                json!([[1.0]]),
                "`mean` of 4 x 3 numbers and `precision` of 4 x 3 x 3",
            ),
            ("/posterior/mean/0/0", json!("1"), "`posterior`: invalid type: string"),
            ("/posterior/precision", lopsided, "matrix 2 is not symmetric and positive definite"),
            ("/posterior/precision", negative, "matrix 4 is not symmetric and positive definite"),
            ("/actions", json!(["alone"]), "expected 2 to 256 actions, found 1"),
        ] {
            let mut file = whole.clone();
            *file.pointer_mut(pointer).unwrap() = value;
            let says = read(&file).unwrap_err();
            assert!(says.contains(expected), "{pointer}: {says}");
        }
        let network = json!({ "features": ["C"], "actions": 4, "network": {} });
        assert!(read(&network).unwrap_err().contains("it has no `posterior`"));
        assert!(Content::read(&PRIOR, "{").unwrap_err().to_string().contains("line 1"));
    }

    #[test]
    fn a_trial_begins_with_the_posterior_pooled_or_not() {
        let parameters = LinearThompson::default();
        let mut posterior = Posterior::prior(&parameters, Shape::of_four(WIDTH));
        decisions(30, 3)
            .iter()
            .for_each(|(decision, reward)| _ = posterior.learn(decision, *reward));
        let prior_from = read(&file(&parameters, &posterior)).unwrap();
        let parameters = LinearThompson { prior_from, ..parameters };
        let scenario: Scenario = "C-H".parse().unwrap();
        let environment: Environment = StepCount::paper(0.4).into();
        let people = environment.testing(&scenario, 1, 2);
        let expected: Vec<f64> = posterior.weights().doubles["mean"].values.clone();
        for sharing in [Sharing::Everybody, Sharing::Apart(vec![vec![0], vec![1]])] {
            let mut study = LinearThompsonStudy::new(
                &parameters,
                &people,
                StudyPlan { people: 2, decisions: 1, sharing, keeps_updates: false },
                1,
            );
            for person in 0..2 {
                for (ours, expected) in study.means(person).iter().zip(&expected) {
                    assert!((ours - expected).abs() < 1e-9 * expected.abs().max(1.0));
                }
            }
        }
    }
}
