//! Standard errors that account for an agent that learned from everybody, beside those of the package lifejacket 2.0.0.
//!
//! `jitai export --after-study` of the same trials, and `python analysis.py`, gave the numbers; `make test-analysis` repeats it.

use std::fs;
use std::path::Path;

use jitai::estimate::Correction;
use jitai::train::after_study_covariance;
use jitai::{manifest, plan};

/// People of Oralytics are invented, enter in two groups, and sometimes do not report their outcome.
fn trial(agent: &str) -> String {
    format!(
        "format = 1\nname = \"pooled\"\nseeds = 1\nscenarios = [[\"time_of_day\", \"brushing\", \"app\"]]\n\
         [trial]\npeople = 16\ndays = 14\ndecisions_per_day = 2\nmissing_outcomes = 0.1\n\
         entry = {{ every_days = 7, people = 8 }}\nupdate = {{ every_days = 7, first_day = 7 }}\n\
         [environment]\nfamily = \"declared\"\nmodel = \"oralytics_v2\"\npeople = \"synthetic_v2.csv\"\ndays = 14\n\
         [evaluation]\non = \"trial\"\n\
         [[agent]]\nname = \"thompson\"\nalgorithm = \"linear_thompson\"\nprior_sd = 60\nnoise_sd = 60\n{agent}\n\
         [[estimate]]\nname = \"effect\"\noutcome = \"gross_reward\"\ncontrol = [\"average_brushing\"]\nmoderators = [\"app_before\"]\n\
         standard_errors = \"after_study\"\n"
    )
}

const LOGISTIC: &str =
    "action_centring = true\nallocation = \"logistic\"\nlogistic_slope = 0.1\npi_min = 0.1";

/// The standard errors of all coefficients, without the correction for small samples.
fn errors(text: &str) -> Vec<f64> {
    let folder = tempfile::tempdir().unwrap();
    let people = Path::new("experiments/oralytics/synthetic_v2.csv");
    fs::copy(people, folder.path().join("synthetic_v2.csv")).unwrap();
    fs::write(folder.path().join("t.toml"), text).unwrap();
    let manifest = manifest::load(&folder.path().join("t.toml")).unwrap();
    let planned = plan::jobs(&manifest).next().unwrap();
    let declaration = &manifest.estimates_of(&planned.agent)[0];
    let covariance =
        after_study_covariance(&planned.job, declaration, Correction::None, &|| false).unwrap();
    let size = covariance.len().isqrt();
    (0..size).map(|place| covariance[place * size + place].sqrt()).collect()
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-6, "{found}, expected {expected}");
    }
}

#[test]
fn standard_errors_of_thompson_sampling_are_those_of_lifejacket() {
    let expected = [
        9.062_049_362_690_408,
        0.215_239_260_680_641_98,
        40.011_628_864_908_936,
        55.314_521_732_072_72,
    ];
    assert_close(&errors(&trial("pi_min = 0.1")), &expected);
}

#[test]
fn standard_errors_of_the_centred_bandit_are_those_of_lifejacket() {
    let expected = [
        6.085_565_496_187_4,
        0.101_267_288_549_011_01,
        17.477_738_934_633_34,
        21.209_177_730_195_99,
    ];
    assert_close(&errors(&trial(LOGISTIC)), &expected);
}
