//! The canonical form of a job, from which its identity is derived.

use std::borrow::Cow;
use std::fmt;

use data_encoding::HEXLOWER;
use serde_json::Value as Json;
use sha2::{Digest, Sha256};

use crate::agent::Agent;
use crate::env::{Environment, Family};
use crate::key::{Keyed, canonical_object};

/// Versions of the code that a job's results depend on. A change that affects results raises one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Versions {
    /// Version of the simulation and the random streams.
    pub environment: u32,
    /// Version of the agent's algorithm.
    pub algorithm: u32,
}

impl Versions {
    /// All earlier versions.
    pub fn earlier(self) -> impl Iterator<Item = Versions> {
        (1..=self.environment)
            .flat_map(move |environment| {
                (1..=self.algorithm).map(move |algorithm| Versions { environment, algorithm })
            })
            .filter(move |versions| *versions != self)
    }

    /// The key of a job with this canonical text under these versions.
    pub fn key_of(self, canonical: &str) -> JobKey {
        let Versions { environment, algorithm } = self;
        JobKey(hash(&[&format!("jitai job e{environment} a{algorithm}\n"), canonical]))
    }
}

/// The canonical text of a job without its seed, which is the same for jobs that differ only in their seeds.
pub fn without_seed(canonical: &str) -> Cow<'_, str> {
    let Some((before, seed)) = canonical.rsplit_once(",\"seed\":") else { return canonical.into() };
    // A trial follows the seed.
    match seed.split_once(',') {
        Some((_, after)) => format!("{before},{after}").into(),
        None => before.into(),
    }
}

/// The seed in the canonical text of a job.
pub fn seed_of(canonical: &str) -> Option<u64> {
    let (_, seed) = canonical.rsplit_once(",\"seed\":")?;
    seed.split([',', '}']).next()?.parse().ok()
}

/// The canonical text of a job, from which its identity is derived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanonicalForm {
    text: String,
    versions: Versions,
}

impl CanonicalForm {
    /// The form with this text, of a job that would run with these versions.
    pub(super) fn new(text: String, versions: Versions) -> CanonicalForm {
        CanonicalForm { text, versions }
    }

    /// The job as one line of JSON: all parameters written out, keys in alphabetical order, and numbers in
    /// the shortest form that reads back as the same number.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The versions of the code that the job would run with.
    pub fn versions(&self) -> Versions {
        self.versions
    }

    /// The identity of the job: a hash of the text and the versions.
    pub fn key(&self) -> JobKey {
        self.key_under(self.versions)
    }

    /// The key of the same content under other versions of the code.
    pub fn key_under(&self, versions: Versions) -> JobKey {
        versions.key_of(&self.text)
    }
}

/// The canonical text of a part of a job.
pub fn text<T: Keyed>(part: &T) -> String {
    Json::Object(canonical_object(T::KEYS, &part.to_values())).to_string()
}

/// The canonical text of an environment, without its participants. Jobs stored before families were introduced
/// omit the family.
pub fn environment_text(environment: &Environment) -> String {
    let family = environment.family();
    let mut object = canonical_object(family.keys, &environment.values());
    if family != Family::first() {
        object.insert("family".to_owned(), family.name.into());
    }
    Json::Object(object).to_string()
}

/// The canonical text of how an environment's participants differ.
pub fn people_text(environment: &Environment) -> String {
    Json::Object(canonical_object(environment.family().people, &environment.people_values()))
        .to_string()
}

/// The canonical text of an agent.
pub fn agent_text(agent: &Agent) -> String {
    let mut object = canonical_object(agent.algorithm().keys(), agent.values());
    object.insert("algorithm".to_owned(), agent.algorithm().name().into());
    Json::Object(object).to_string()
}

/// The first half of the hash of these texts in sequence.
fn hash(texts: &[&str]) -> [u8; 16] {
    let mut hasher = Sha256::new();
    texts.iter().for_each(|text| hasher.update(text));
    let digest = hasher.finalize();
    let mut key = [0; 16];
    key.copy_from_slice(&digest[..16]);
    key
}

/// Identity of a job: the first 128 bits of a SHA-256, written as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct JobKey(pub [u8; 16]);

fn write_hex(bytes: &[u8], f: &mut fmt::Formatter<'_>) -> fmt::Result {
    fmt::Display::fmt(&HEXLOWER.encode_display(bytes), f)
}

impl fmt::Display for JobKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_hex(&self.0, f)
    }
}

impl fmt::Debug for JobKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_hex(&self.0, f)
    }
}
