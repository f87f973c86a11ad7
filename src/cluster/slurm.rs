//! Slurm: the script of an array, and the four calls by `sbatch`, `squeue`, `scancel` and `scontrol`.
//!
//! Accounting (`sacct`) is not used, because many clusters do not have it. A task that `squeue` does
//! not show is neither waiting nor running; its files in the submission's folder show how it ended.

use std::path::Path;
use std::time::Duration;

use super::engine::{Alive, Engine, EngineError, Limits, Phase, ask};
use super::script::{Order, RUN_AGAIN, quoted};

/// Time limit of a query; a busy controller answers late.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);
/// Time limit of a submission.
const ACCEPT_WITHIN: Duration = Duration::from_secs(120);

/// Seconds between the warning signal and the time limit of a task.
const WARNING_SECONDS: u32 = 60;

/// Maximum number of array names per call, because the length of a command line is limited.
const NAMES_AT_ONCE: usize = 500;

/// Slurm, called through its programs.
pub(super) struct Slurm;

impl Engine for Slurm {
    fn submit(&self, script: &Path) -> Result<String, EngineError> {
        let script = script.to_string_lossy();
        let answer = ask("sbatch", &["--parsable", &script], ACCEPT_WITHIN)?;
        // The answer is `id` or `id;cluster`.
        let id = answer.trim().lines().last().unwrap_or_default();
        match id.split(';').next() {
            Some(id) if id.parse::<u64>().is_ok() => Ok(id.to_owned()),
            _ => Err(EngineError::Refused { program: "sbatch", words: not_understood(&answer) }),
        }
    }

    fn alive(&self, names: &[&str]) -> Result<Vec<Alive>, EngineError> {
        let mut alive = Vec::new();
        for names in names.chunks(NAMES_AT_ONCE) {
            let wanted = format!("--name={}", names.join(","));
            let arguments = ["--noheader", "--array", &wanted, "--format=%j|%F|%K|%T"];
            for line in ask("squeue", &arguments, ANSWER_WITHIN)?.lines() {
                alive.push(task(line).ok_or_else(|| EngineError::Refused {
                    program: "squeue",
                    words: not_understood(line),
                })?);
            }
        }
        Ok(alive)
    }

    fn cancel(&self, array: &str) -> Result<(), EngineError> {
        ask("scancel", &[array], ANSWER_WITHIN).map(drop)
    }

    fn limits(&self) -> Result<Limits, EngineError> {
        let answer = ask("scontrol", &["show", "config"], ANSWER_WITHIN).map_err(unconfigured)?;
        let most_tasks = answer.lines().find_map(|line| {
            let (name, value) = line.split_once('=')?;
            (name.trim() == "MaxArraySize").then(|| value.trim().parse::<u32>().ok()).flatten()
        });
        match most_tasks {
            Some(most_tasks @ 1..) => Ok(Limits { most_tasks }),
            Some(0) => Err(EngineError::Refused {
                program: "scontrol",
                words: "MaxArraySize is 0, so this cluster has no job arrays".to_owned(),
            }),
            None => {
                Err(EngineError::Refused { program: "scontrol", words: not_understood(&answer) })
            }
        }
    }
}

/// Adds the remedy: this call comes first, and it fails on machines that belong to no cluster.
fn unconfigured(error: EngineError) -> EngineError {
    match error {
        EngineError::Refused { program, words } => EngineError::Refused {
            program,
            words: format!(
                "{words}\nsubmit on a machine where `scontrol show config` works, such as the cluster's \
                 login node"
            ),
        },
        other => other,
    }
}

fn not_understood(answer: &str) -> String {
    let first: String = answer.trim().chars().take(200).collect();
    format!("unexpected answer {first:?}")
}

/// Parses a line of squeue: name, array, index and state.
fn task(line: &str) -> Option<Alive> {
    let mut fields = line.rsplitn(4, '|');
    let (state, chunk, array) = (fields.next()?, fields.next()?, fields.next()?);
    let phase = match state.trim() {
        "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "REQUEUE_FED" | "SPECIAL_EXIT"
        | "RESV_DEL_HOLD" => Phase::Waiting,
        _ => Phase::Running,
    };
    Some(Alive {
        name: fields.next()?.trim().to_owned(),
        array: array.trim().to_owned(),
        chunk: chunk.trim().parse().ok()?,
        phase,
    })
}

/// The script of an array.
///
/// The shell stays between Slurm and the task. It passes the signal on, and requests another attempt if
/// the signal of the time limit stopped the task. If Slurm itself ends the task, because the task was
/// cancelled or preempted, the job is no longer in the state RUNNING, and Slurm alone decides whether
/// it runs again.
pub(super) fn script(order: &Order<'_>) -> String {
    let Order { name, chunks, folder, program, profile } = order;
    let mut options = vec![
        format!("--job-name={name}"),
        format!(
            "--array=0-{}{}",
            chunks - 1,
            match profile.max_running {
                Some(most) => format!("%{most}"),
                None => String::new(),
            }
        ),
        format!("--chdir={}", folder.display()),
        // Relative to that folder, because its own path may contain a %, which Slurm would expand here.
        "--output=logs/%a.log".to_owned(),
        "--open-mode=append".to_owned(),
        "--requeue".to_owned(),
        format!("--cpus-per-task={}", profile.cpus_per_task),
    ];
    if !profile.options.iter().any(|(name, _)| name == "signal") {
        options.push(format!("--signal=B:TERM@{WARNING_SECONDS}"));
    }
    let named = [
        ("partition", &profile.partition),
        ("account", &profile.account),
        ("time", &profile.time_limit),
        ("mem", &profile.memory),
    ];
    options.extend(
        named.into_iter().filter_map(|(name, value)| Some(format!("--{name}={}", value.as_ref()?))),
    );
    options.extend(profile.options.iter().map(|(name, value)| match value {
        Some(value) => format!("--{name}={value}"),
        None => format!("--{name}"),
    }));
    let mut text = "#!/bin/bash\n".to_owned();
    for option in options {
        text.push_str(&format!("#SBATCH {}\n", sbatch_word(&option)));
    }
    for line in &profile.setup {
        text.push_str(line);
        text.push('\n');
    }
    let (program, folder) =
        (quoted(&program.display().to_string()), quoted(&folder.display().to_string()));
    text.push_str(&format!(
        r#"
{program} task {folder} --chunk "$SLURM_ARRAY_TASK_ID" \
    --attempt "$SLURM_JOB_ID.${{SLURM_RESTART_COUNT:-0}}" --scratch "{scratch}" &
task=$!
trap 'stopped=yes; kill -TERM "$task" 2>/dev/null' TERM
code=127
while :; do
    # A signal ends the waiting, not the task.
    stopped=no
    wait "$task"
    ended=$?
    [ "$ended" -eq 127 ] || code=$ended
    [ "$stopped" = yes ] || break
done
if [ "$code" -eq {RUN_AGAIN} ] &&
    [ "$(squeue --noheader --jobs="$SLURM_JOB_ID" --format=%T)" = RUNNING ]; then
    scontrol requeue "$SLURM_JOB_ID"
elif [ "$code" -gt 128 ]; then
    echo "error: the task was killed by signal $((code - 128)); signal 9 may mean too little memory"
fi
exit "$code"
"#,
        scratch = profile.scratch,
    ));
    text
}

/// An option quoted for an `#SBATCH` line, in which blanks separate words.
fn sbatch_word(option: &str) -> String {
    if option.chars().any(|c| c.is_whitespace() || "'\"\\#".contains(c)) {
        format!("\"{}\"", option.replace('\\', "\\\\").replace('"', "\\\""))
    } else {
        option.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::engine::EngineKind;
    use crate::cluster::profile::Profile;

    fn script_of(profile: &Profile) -> String {
        super::script(&Order {
            name: "jitai-20260131-120000-1a2b3c",
            chunks: 42,
            folder: Path::new("/shared/my lab/jitai.sqlite.submissions/one"),
            program: Path::new("/home/o'neil/jitai"),
            profile,
        })
    }

    #[test]
    fn a_line_of_squeue_is_a_task_whatever_the_name_holds() {
        let task = |line| task(line).map(|task| (task.name, task.array, task.chunk, task.phase));
        let name = |name: &str, array: &str| (name.to_owned(), array.to_owned());
        let (n, a) = name("jitai-1", "17");
        assert_eq!(task("jitai-1|17|3|RUNNING"), Some((n, a, 3, Phase::Running)));
        let (n, a) = name("a|b", "17");
        assert_eq!(task("a|b|17|3|PENDING"), Some((n, a, 3, Phase::Waiting)));
        let (n, a) = name("jitai-1", "17");
        assert_eq!(task("jitai-1|17|0|COMPLETING"), Some((n, a, 0, Phase::Running)));
        for line in ["", "slurm_load_jobs error", "jitai-1|17|N/A|RUNNING"] {
            assert_eq!(task(line), None, "{line}");
        }
    }

    #[test]
    fn a_script_has_the_options_of_the_profile_and_quotes_its_paths() {
        let profile = Profile {
            partition: Some("short".to_owned()),
            time_limit: Some("2:00:00".to_owned()),
            memory: Some("4G".to_owned()),
            cpus_per_task: 4,
            max_running: Some(20),
            setup: vec!["module load gcc".to_owned()],
            options: vec![
                ("exclusive".to_owned(), None),
                ("comment".to_owned(), Some("a \"b\"".to_owned())),
            ],
            ..Profile::of(EngineKind::Slurm)
        };
        let script = script_of(&profile);
        for line in [
            "#SBATCH --job-name=jitai-20260131-120000-1a2b3c",
            "#SBATCH --array=0-41%20",
            "#SBATCH \"--chdir=/shared/my lab/jitai.sqlite.submissions/one\"",
            "#SBATCH --output=logs/%a.log",
            "#SBATCH --requeue",
            "#SBATCH --cpus-per-task=4",
            "#SBATCH --signal=B:TERM@60",
            "#SBATCH --partition=short",
            "#SBATCH --time=2:00:00",
            "#SBATCH --mem=4G",
            "#SBATCH --exclusive",
            "#SBATCH \"--comment=a \\\"b\\\"\"",
            "module load gcc",
        ] {
            assert!(script.lines().any(|of_script| of_script == line), "{line}\n{script}");
        }
        assert!(script.contains("'/home/o'\\''neil/jitai' task '/shared/my lab/"), "{script}");
        let options = script.lines().filter(|line| line.starts_with("#SBATCH")).count();
        let first = script.lines().nth(options + 1);
        assert_eq!(first, Some("module load gcc"), "options come before any command");
    }

    #[test]
    fn the_signal_of_a_profile_replaces_the_usual_one() {
        let signal = ("signal".to_owned(), Some("B:TERM@300".to_owned()));
        let profile = Profile { options: vec![signal], ..Profile::of(EngineKind::Slurm) };
        let script = script_of(&profile);
        assert!(script.contains("#SBATCH --signal=B:TERM@300\n"), "{script}");
        assert!(!script.contains("@60"), "{script}");
    }
}
