//! Jobs that can run.

use std::ops::Deref;

use super::Job;
use crate::key::{SectionName, Value};

/// A job that can run: the texts of all files that it names are known. A job that is read from a store knows their digests
/// alone.
#[derive(Clone, Copy, Debug)]
pub struct RunnableJob<'j>(&'j Job);

/// Why a job cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the job knows only the digest of its file `{}.{key}`, as jobs of a store do; take the job from its manifest",
    .section.word()
)]
pub struct UnknownFile {
    section: SectionName,
    key: &'static str,
}

impl Job {
    /// The job as one that can run.
    ///
    /// **Errors**: the text of a file is unknown.
    pub fn runnable(&self) -> Result<RunnableJob<'_>, UnknownFile> {
        for (section, keys, values) in self.sections() {
            for (key, value) in keys.iter().zip(&values) {
                let is_unknown = |value: &Value| match value {
                    Value::Content(content) => !content.is_none() && content.text().is_none(),
                    _ => false,
                };
                if is_unknown(value) {
                    return Err(UnknownFile { section, key: key.name });
                }
            }
        }
        Ok(RunnableJob(self))
    }
}

impl<'j> RunnableJob<'j> {
    /// The job.
    pub fn job(self) -> &'j Job {
        self.0
    }
}

impl Deref for RunnableJob<'_> {
    type Target = Job;

    fn deref(&self) -> &Job {
        self.0
    }
}
