//! `jitai cancel`: cancels the remaining tasks of a submission.

use std::io::{self, Write};

use crate::cli::{Error, Exit, StoreArgument, submissions};
use crate::cluster::{self, Cluster, Submission};
use crate::store::{require_one_name, resolve};

/// Cancel the remaining tasks of a submission; completed runs are kept
///
/// Running tasks write checkpoints and hand in their completed runs. The next `jitai submit` submits
/// the remaining jobs again, and they resume from their checkpoints.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Names of submissions, as `jitai status` shows them [default: the open submission]
    #[arg(value_name = "SUBMISSION")]
    submissions: Vec<String>,
    /// Cancel all open submissions of the store
    #[arg(long, conflicts_with = "submissions")]
    all: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    // The submissions lie beside one name of the store.
    require_one_name(&resolve(&arguments.store.store)?)?;
    let cluster = Cluster::of(&arguments.store.store, cluster::connect)?;
    let chosen: Vec<Submission> = if arguments.submissions.is_empty() {
        let look = cluster.look()?;
        let open = |(_, survey): &&(Submission, _)| submissions::is_open(survey);
        let open: Vec<Submission> =
            look.surveys.iter().filter(open).map(|(submission, _)| submission.clone()).collect();
        if open.len() > 1 && !arguments.all {
            let names: Vec<&str> = open.iter().map(Submission::name).collect();
            return Err(Error::Usage(format!(
                "{} submissions are open: {}; name the submissions to cancel, or use --all",
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
