//! The words of an environment in tables and captions.

use crate::job::MetricName;
use crate::job::metric::DISENGAGEMENT_RATE;
use crate::manifest::Manifest;
use crate::plan;

/// The words of an environment.
#[derive(Clone, Copy, Debug)]
pub struct Words {
    /// The unit of returns.
    pub return_unit: &'static str,
    /// The metric that is the share of terminated episodes.
    pub terminated: MetricName,
    /// Whether the family has an optimum.
    pub has_optimum: bool,
}

impl Words {
    /// The words of a manifest's environment, which may have described itself in a completed run.
    pub fn of(manifest: &Manifest, description: Option<&str>) -> Words {
        let job = plan::jobs(manifest).next().map(|planned| planned.job);
        let described = description.and_then(|text| job.as_ref()?.environment.described(text));
        let of_job = job.as_ref().map(|job| job.termination_metric());
        Words {
            return_unit: described.map_or(manifest.return_unit(), |one| one.return_unit()),
            terminated: of_job.unwrap_or_default(),
            has_optimum: manifest.family().has_optimum,
        }
    }

    /// The heading of a column of shares of terminated episodes.
    pub fn terminated_heading(&self) -> &'static str {
        match self.terminated == DISENGAGEMENT_RATE {
            true => "Disengaged, %",
            false => "Terminated, %",
        }
    }
}
