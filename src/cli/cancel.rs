//! `jitai cancel`: ends what a cluster still holds of a submission.

use std::io::{self, Write};

use crate::cli::{Error, Exit, StoreArgument, submissions};
use crate::cluster::{Cluster, Submission};

/// End what the cluster still holds of a submission; what its tasks have completed is kept
///
/// Running tasks write checkpoints and hand in what they have completed. `jitai submit` submits the
/// jobs that are left again, and they go on from their checkpoints.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Submissions, by the names that `jitai status` shows [default: the open one, if there is one]
    #[arg(value_name = "SUBMISSION")]
    submissions: Vec<String>,
    /// All open submissions of the store
    #[arg(long, conflicts_with = "submissions")]
    all: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let engine = submissions::engine();
    let cluster = Cluster::of(&arguments.store.store, &*engine)?;
    let chosen: Vec<Submission> = if arguments.submissions.is_empty() {
        let look = cluster.look()?;
        let open = |(_, survey): &&(Submission, _)| submissions::is_open(survey);
        let open: Vec<Submission> =
            look.surveys.iter().filter(open).map(|(submission, _)| submission.clone()).collect();
        if open.len() > 1 && !arguments.all {
            let names: Vec<&str> = open.iter().map(Submission::name).collect();
            return Err(Error::Usage(format!(
                "{} submissions are open: {}; name those to cancel, or say --all",
                open.len(),
                names.join(", ")
            )));
        }
        open
    } else {
        let named = arguments.submissions.iter().map(|name| cluster.submissions().named(name));
        named.collect::<Result<_, _>>()?
    };
    if chosen.is_empty() {
        writeln!(io::stderr(), "nothing to cancel: no submission is open")?;
    }
    for submission in chosen {
        cluster.cancel(&submission)?;
        writeln!(io::stdout(), "cancelled {}", submission.name())?;
    }
    Ok(Exit::Done)
}
