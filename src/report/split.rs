//! Prediction of how figures of a manifest will be split into panels, before any job has run.

use std::collections::HashSet;

use super::figure::MOST_ARMS;
use super::kinds::drawn;
use crate::analyse::declared::{Finding, carry_out};
use crate::job::Condition;
use crate::job::{PlannedJob, without_seed};
use crate::key::Parameter;
use crate::manifest::Manifest;
use crate::plan::{self};
use crate::record::{JobRecord, JobStatus, SharedSettings};

/// Maximum number of jobs of one seed for which splits are predicted. Larger figures are
/// unreadable.
const MOST_JOBS: usize = 5000;

/// The figures that have too many arms for one panel and are split, as sentences without their full stop.
pub fn splits(manifest: &Manifest) -> Vec<String> {
    let undivided = manifest.analyses.iter().filter(|analysis| analysis.figure.panel.is_none());
    let analyses: Vec<_> = undivided.collect();
    if analyses.is_empty() {
        return Vec::new();
    }
    // An arm can lack the first seed only if an exclusion names seeds.
    let names_seeds = |one: &Condition| one.parameter == Parameter::SEED;
    let may_lack = manifest.exclusions.iter().any(|one| one.conditions.iter().any(names_seeds));
    let (seed, mut seen) = (manifest.seeds().next(), HashSet::new());
    let of_one_seed = plan::jobs(manifest).filter(|planned| match may_lack {
        true => {
            seen.insert((planned.agent.to_string(), without_seed(planned.form.text()).into_owned()))
        }
        false => Some(planned.job.seed) == seed,
    });
    let of_one_seed: Vec<_> = of_one_seed.take(MOST_JOBS + 1).collect();
    if of_one_seed.len() > MOST_JOBS {
        return Vec::new();
    }
    let mut shared = SharedSettings::default();
    let mut record = |planned: &PlannedJob| {
        JobRecord::sharing(&mut shared, planned, planned.form.key(), JobStatus::Pending)
    };
    let jobs: Vec<JobRecord> = of_one_seed.iter().map(&mut record).collect();
    let concerned = |conditions: Vec<Condition>| -> Vec<&JobRecord> {
        jobs.iter().filter(|job| conditions.iter().all(|one| one.is_met_by(job))).collect()
    };
    let with_jobs: Vec<_> = analyses
        .iter()
        .map(|analysis| (*analysis, concerned(analysis.of_jobs().collect())))
        .collect();
    let sentence = |finding: &Finding| {
        let kind = drawn(&finding.content);
        let (arms, split) = (kind.arms().len(), kind.split()?);
        let is_split = split.panels.len() > 1 && !split.added.is_empty();
        is_split.then(|| {
            format!(
                "the figure of `{}` has {arms} arms, more than {MOST_ARMS} in a panel: it is split into {} \
                 panels by {}; `panel` chooses another key",
                finding.name,
                split.panels.len(),
                split.added.join(" and ")
            )
        })
    };
    carry_out(&with_jobs, None, manifest.return_unit()).iter().filter_map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;

    #[test]
    fn arms_without_the_first_seed_count() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 3\n\
            environment.sigma = [0.4, 0.6]\n\
            [[agent]]\nname = \"a\"\nalgorithm = \"rule\"\nrule = \"threshold\"\n\
            threshold = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0]\n\
            [[agent]]\nname = \"b\"\nalgorithm = \"rule\"\nrule = \"never\"\n\
            [[analysis]]\nname = \"c\"\nkind = \"curve\"\nx = \"sigma\"\n";
        let exclusion = "[[exclude]]\nagent.name = \"b\"\nseed = 1\n";
        for text in [text.to_owned(), format!("{text}{exclusion}")] {
            let [sentence] = &splits(&parse("t", text.as_bytes()).unwrap())[..] else { panic!() };
            let begins = "the figure of `c` has 7 arms, more than 6 in a panel: it is split into 2";
            assert!(sentence.starts_with(begins), "{sentence}");
        }
    }
}
