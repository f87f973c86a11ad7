//! A sweep from Rust: two decision rules at two noise levels, and the mean return of every arm.

use std::error::Error;
use std::sync::atomic::AtomicBool;

use jitai::experiment::{self, Event, Options, Selection, Store};
use jitai::results::{Parts, Reader, summarise_arms};

const MANIFEST: &str = r#"
format = 1
name = "rules"
question = "When does tailoring to the likelier context pay?"
scenarios = ["P-H-D"]
seeds = 3

[environment]
sigma = [0.4, 1.2]

[evaluation]
test_episodes = 200

[[agent]]
name = "never"
algorithm = "rule"
rule = "never"

[[agent]]
name = "tailored"
algorithm = "rule"
rule = "tailored"
"#;

pub fn main() -> Result<(), Box<dyn Error>> {
    let manifests = [experiment::parse("rules.toml", MANIFEST.as_bytes())?];
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("rules.sqlite");

    let mut store = Store::open(&path)?;
    // Set it from a signal handler or another thread: the sweep stops within two seconds.
    let stop = AtomicBool::new(false);
    let selection = Selection::new(&manifests, None)?;
    let mut ignore = |_: Event<'_>| {};
    let ended = experiment::run(&mut store, &selection, Options::default(), &stop, &mut ignore)?;
    println!("{} jobs run", ended.map_or(0, |ended| ended.end.ran()));

    let jobs = experiment::jobs(&manifests[0]);
    let data = Reader::open(&path)?.data_set(&manifests[0].name, jobs, Parts::default())?;
    for arm in summarise_arms(&data.jobs) {
        let (agent, sigma) = (&arm.name.agent, arm.headline.unwrap_or_default().1);
        println!("{agent} at sigma = {sigma}: {:.0} steps walked", arm.returns.mean()?);
    }
    Ok(())
}
