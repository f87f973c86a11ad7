//! Slurm: the script of an array, and the four calls by `sbatch`, `squeue`, `scancel` and `scontrol`.
//!
//! Accounting (`sacct`) is not used, because many clusters do not have it. A task that `squeue` does
//! not show is neither waiting nor running; its files in the submission's folder show how it ended.

use std::path::Path;
use std::time::Duration;

use serde_json::{Value as Json, json};

use super::engine::{
    Alive, Declaration, Engine, EngineError, KeyForm, Limits, Programs, TaskPhase, text_or_number,
};
use super::order::{Order, RUN_AGAIN, quoted};
use crate::key::{Keyed, Kind, Value};
use crate::keys;

/// Time limit of a query; a busy controller answers late.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);
/// Time limit of a submission.
const ACCEPT_WITHIN: Duration = Duration::from_secs(120);

/// Seconds between the warning signal and the time limit of a task.
const WARNING_SECONDS: u32 = 60;

/// Maximum number of array names per call, because the length of a command line is limited.
const NAMES_AT_ONCE: usize = 500;

keys! {
    /// The keys of a profile that only Slurm has; an empty text stands for an absent key.
    struct Settings {
        /// partition of the tasks; the cluster's default if absent
        partition: String = String::new(), in Kind::Text { most: Kind::LONGEST_TEXT };
        /// account that is charged; the user's default if absent
        account: String = String::new(), in Kind::Text { most: Kind::LONGEST_TEXT };
        /// maximum time of a task, in minutes or in Slurm's format (`2:00:00`, `1-12`); a task
        /// that reaches it is checkpointed and queued again
        time_limit: String = String::new(), in Kind::Text { most: Kind::LONGEST_TEXT };
        /// memory of a task, in MB or with the suffix K, M, G or T
        memory: String = String::new(), in Kind::Text { most: Kind::LONGEST_TEXT };
    }
}

/// Slurm as an engine.
pub(super) const SLURM: Declaration = Declaration {
    keys: Settings::KEYS,
    forms: &[
        word("partition"),
        word("account"),
        KeyForm {
            key: "time_limit",
            expected: "minutes, or a text such as \"2:00:00\" or \"1-12\"",
            read: |value| text_or_number(value).filter(|time| is_time(time)).map(Value::Text),
            schema: || number_or("^([0-9]{1,6}-)?[0-9]{1,6}(:[0-9]{1,6}){0,2}$"),
        },
        KeyForm {
            key: "memory",
            expected: "MB, or a text such as \"4G\"",
            read: |value| text_or_number(value).filter(|size| is_memory(size)).map(Value::Text),
            schema: || number_or("^[0-9]+[KMGT]?$"),
        },
    ],
    program: "sbatch",
    reserved: &[
        ("array", "`max_running` limits how many tasks run at the same time"),
        ("chdir", ""),
        ("cpus-per-task", "write `cpus_per_task`"),
        ("error", "logs are in the folder of the submission"),
        ("input", ""),
        ("job-name", "jitai finds its submissions by job name"),
        ("mem", "write `memory`"),
        ("no-requeue", "a preempted task resumes from its checkpoints"),
        ("open-mode", ""),
        ("output", "logs are in the folder of the submission"),
        ("parsable", ""),
        ("requeue", ""),
        ("test-only", "`jitai submit --dry-run` submits nothing"),
        ("time", "write `time_limit`"),
        ("wait", "write `jitai submit --wait`"),
        ("wrap", ""),
    ],
    expected: |option, value| {
        let warns = option != "signal" || value.is_some_and(|v| v.starts_with("B:TERM@"));
        (!warns).then_some("\"B:TERM@SECONDS\", the signal on which tasks checkpoint")
    },
    // The default of Slurm.
    usual: Limits { most_tasks: 1001 },
    script,
    connect: || Box::new(Slurm),
};

/// The form of a key that is a word.
const fn word(key: &'static str) -> KeyForm {
    KeyForm {
        key,
        expected: "a word without blanks",
        read: |value| {
            let is_in_word = |c: char| c.is_ascii_graphic() && !"'\"\\`$#".contains(c);
            let word =
                value.as_str().filter(|word| !word.is_empty() && word.chars().all(is_in_word));
            word.map(|word| Value::Text(word.to_owned()))
        },
        schema: || json!({ "type": "string", "pattern": "^[!-~]+$" }),
    }
}

/// The schema of a positive whole number, or of a text with this pattern.
fn number_or(pattern: &str) -> Json {
    json!({ "anyOf": [
        { "type": "integer", "minimum": 1 },
        { "type": "string", "pattern": pattern },
    ]})
}

/// Whether sbatch reads the text as a time: `minutes`, `minutes:seconds`, `hours:minutes:seconds`,
/// `days-hours` and so on.
fn is_time(text: &str) -> bool {
    let (days, clock) = match text.split_once('-') {
        Some((days, clock)) => (Some(days), clock),
        None => (None, text),
    };
    let is_number =
        |part: &str| (1..=6).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<&str> = clock.split(':').collect();
    days.is_none_or(is_number)
        && parts.len() <= 3
        && parts.iter().all(|part| is_number(part))
        && text.bytes().any(|b| (b'1'..=b'9').contains(&b))
}

fn is_memory(text: &str) -> bool {
    let digits = text.strip_suffix(['K', 'M', 'G', 'T']).unwrap_or(text);
    digits.parse::<u64>().is_ok_and(|number| number > 0)
}

/// The programs of Slurm.
const PROGRAMS: Programs = Programs { engine: "Slurm", is_unset };

/// Slurm, called through its programs.
struct Slurm;

impl Engine for Slurm {
    fn submit(&self, script: &Path) -> Result<String, EngineError> {
        let script = script.to_string_lossy();
        let answer = PROGRAMS.ask("sbatch", &["--parsable", &script], ACCEPT_WITHIN)?;
        // The answer is `id` or `id;cluster`.
        let id = answer.trim().lines().last().unwrap_or_default();
        match id.split(';').next() {
            Some(id) if id.parse::<u64>().is_ok() => Ok(id.to_owned()),
            _ => Err(not_understood("sbatch", &answer)),
        }
    }

    fn alive(&self, names: &[&str]) -> Result<Vec<Alive>, EngineError> {
        let mut alive = Vec::new();
        for names in names.chunks(NAMES_AT_ONCE) {
            let wanted = format!("--name={}", names.join(","));
            let arguments = ["--noheader", "--array", &wanted, "--format=%j|%F|%K|%T"];
            for line in PROGRAMS.ask("squeue", &arguments, ANSWER_WITHIN)?.lines() {
                alive.extend(tasks(line).ok_or_else(|| not_understood("squeue", line))?);
            }
        }
        Ok(alive)
    }

    fn cancel(&self, array: &str) -> Result<(), EngineError> {
        PROGRAMS.ask("scancel", &[array], ANSWER_WITHIN).map(drop)
    }

    fn limits(&self) -> Result<Limits, EngineError> {
        let answer = PROGRAMS.ask("scontrol", &["show", "config"], ANSWER_WITHIN);
        let answer = answer.map_err(unconfigured)?;
        match most_tasks(&answer) {
            Some(most_tasks @ 1..) => Ok(Limits { most_tasks }),
            Some(0) => Err(EngineError::Refused {
                program: "scontrol",
                words: "this cluster has no job arrays: MaxArraySize or max_array_tasks is 0"
                    .to_owned(),
            }),
            None => Err(not_understood("scontrol", &answer)),
        }
    }
}

/// Whether a variable in a user's environment would change what jitai asks: it filters or formats an answer,
/// or it overrides an option of the script that jitai relies on.
fn is_unset(variable: &str) -> bool {
    let overriding = ["ARRAY_INX", "JOB_NAME", "NO_REQUEUE", "OPEN_MODE", "SIGNAL", "WAIT"];
    match variable.split_once('_') {
        Some(("SQUEUE" | "SCANCEL" | "SCONTROL", _)) => true,
        Some(("SBATCH", option)) => overriding.contains(&option),
        _ => false,
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

fn not_understood(program: &'static str, answer: &str) -> EngineError {
    let first: String = answer.trim().chars().take(200).collect();
    EngineError::Refused { program, words: format!("unexpected answer {first:?}") }
}

/// The largest array that the configuration permits: `MaxArraySize`, or `max_array_tasks` among the
/// parameters of the scheduler, if that is smaller.
fn most_tasks(configuration: &str) -> Option<u32> {
    let value_of = |wanted: &str| {
        let lines = configuration.lines().filter_map(|line| line.split_once('='));
        lines.filter(|(name, _)| name.trim() == wanted).map(|(_, value)| value.trim()).next()
    };
    let size = value_of("MaxArraySize")?.parse().ok()?;
    let parameters = value_of("SchedulerParameters").unwrap_or_default().split(',');
    let tasks = parameters.filter_map(|one| one.trim().strip_prefix("max_array_tasks="));
    Some(tasks.filter_map(|tasks| tasks.parse().ok()).fold(size, u32::min))
}

/// Parses a line of squeue: name, array, indices and state. Waiting tasks of an array may share one line.
fn tasks(line: &str) -> Option<Vec<Alive>> {
    let mut fields = line.rsplitn(4, '|');
    let (state, chunks, array) = (fields.next()?, fields.next()?, fields.next()?);
    let phase = match state.trim() {
        "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "REQUEUE_FED" | "SPECIAL_EXIT"
        | "RESV_DEL_HOLD" => TaskPhase::Waiting,
        _ => TaskPhase::Running,
    };
    let (name, array) = (fields.next()?.trim().to_owned(), array.trim().to_owned());
    let alive = |chunk| Alive { name: name.clone(), array: array.clone(), chunk, phase };
    Some(indices(chunks)?.into_iter().map(alive).collect())
}

/// The indices of an expression such as `3`, `0-5%2`, `[1,4-6]` or `0-20:5`. `None` if it is something
/// else, such as a list that squeue has cut short.
fn indices(expression: &str) -> Option<Vec<u32>> {
    let expression = expression.trim().trim_start_matches('[').trim_end_matches(']');
    let list = expression.split_once('%').map_or(expression, |(list, _)| list);
    let mut all = Vec::new();
    for part in list.split(',') {
        let (range, step) = part.split_once(':').unwrap_or((part, "1"));
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (u32, u32) = (first.parse().ok()?, last.parse().ok()?);
        let step = step.parse().ok().filter(|step| *step > 0)?;
        all.extend((first..=last).step_by(step));
    }
    Some(all)
}

/// The script of an array.
///
/// The shell stays between Slurm and the task. It passes the signal on, and requests another attempt if
/// the signal of the time limit stopped the task. If Slurm itself ends the task, because the task was
/// cancelled or preempted, the job is no longer in the state RUNNING, and Slurm alone decides whether
/// it runs again.
///
/// A task is always named by its array and its index. The job id of one task of every array is the id of
/// the array, which Slurm takes for all of its tasks. Variables of squeue and scontrol in the user's
/// environment, which would hide tasks or change the answer, are unset.
fn script(order: &Order<'_>) -> String {
    let Order { folder, program, tasks, .. } = order;
    let mut text = "#!/bin/bash\n".to_owned();
    for option in options(order) {
        text.push_str(&format!("#SBATCH {}\n", sbatch_word(&option)));
    }
    for line in &tasks.setup {
        text.push_str(line);
        text.push('\n');
    }
    let (program, folder) =
        (quoted(&program.display().to_string()), quoted(&folder.display().to_string()));
    text.push_str(&format!(
        r#"
self="${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
unset "${{!SQUEUE_@}}" "${{!SCONTROL_@}}"
{program} task {folder} --chunk "$SLURM_ARRAY_TASK_ID" \
    --attempt "$self.${{SLURM_RESTART_COUNT:-0}}" --scratch "{scratch}" &
task=$!
trap 'stopped=yes; kill -TERM "$task" 2>/dev/null' TERM HUP INT USR1 USR2 XCPU
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
    [ "$(squeue --noheader --jobs="$self" --format=%T)" = RUNNING ]; then
    scontrol requeue "$self"
elif [ "$code" -gt 128 ]; then
    echo "error: the task was killed by signal $((code - 128)); signal 9 may mean too little memory"
fi
exit "$code"
"#,
        scratch = tasks.scratch,
    ));
    text
}

/// The options of sbatch for an order.
fn options(order: &Order<'_>) -> Vec<String> {
    let Order { name, chunks, folder, tasks, settings, options: passed, .. } = order;
    let settings = Settings::from_values(settings).expect("the values of Slurm's keys");
    let mut options = vec![
        format!("--job-name={name}"),
        format!(
            "--array=0-{}{}",
            chunks - 1,
            match tasks.max_running {
                0 => String::new(),
                most => format!("%{most}"),
            }
        ),
        format!("--chdir={}", folder.display()),
        // Relative to that folder, because its own path may contain a %, which Slurm would expand here.
        "--output=logs/%a.log".to_owned(),
        "--open-mode=append".to_owned(),
        "--requeue".to_owned(),
        format!("--cpus-per-task={}", tasks.cpus_per_task),
    ];
    if !passed.iter().any(|(name, _)| name == "signal") {
        options.push(format!("--signal=B:TERM@{WARNING_SECONDS}"));
    }
    let named = [
        ("partition", settings.partition),
        ("account", settings.account),
        ("time", settings.time_limit),
        ("mem", settings.memory),
    ];
    let named = named.into_iter().filter(|(_, value)| !value.is_empty());
    options.extend(named.map(|(name, value)| format!("--{name}={value}")));
    options.extend(passed.iter().map(|(name, value)| match value {
        Some(value) => format!("--{name}={value}"),
        None => format!("--{name}"),
    }));
    options
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
    use crate::cluster::profile::Profile;

    fn script_of(keys: &str) -> String {
        let profile = Profile::parse("p", &format!("engine = \"slurm\"\n{keys}")).unwrap();
        profile.script(
            "jitai-20260131-120000-1a2b3c",
            42,
            Path::new("/shared/my lab/jitai.sqlite.submissions/one"),
            Path::new("/home/o'neil/jitai"),
        )
    }

    #[test]
    fn a_line_of_squeue_is_a_task_whatever_the_name_holds() {
        let only = |tasks: Vec<Alive>| tasks.into_iter().next();
        let task = |line| {
            let task = tasks(line).and_then(only);
            task.map(|task| (task.name, task.array, task.chunk, task.phase))
        };
        let name = |name: &str, array: &str| (name.to_owned(), array.to_owned());
        let (n, a) = name("jitai-1", "17");
        assert_eq!(task("jitai-1|17|3|RUNNING"), Some((n, a, 3, TaskPhase::Running)));
        let (n, a) = name("a|b", "17");
        assert_eq!(task("a|b|17|3|PENDING"), Some((n, a, 3, TaskPhase::Waiting)));
        let (n, a) = name("jitai-1", "17");
        assert_eq!(task("jitai-1|17|0|COMPLETING"), Some((n, a, 0, TaskPhase::Running)));
        for line in ["", "slurm_load_jobs error", "jitai-1|17|N/A|RUNNING"] {
            assert_eq!(task(line), None, "{line}");
        }
    }

    #[test]
    fn waiting_tasks_on_one_line_are_all_tasks_unless_the_line_is_cut() {
        let chunks = |expression: &str| {
            let tasks = tasks(&format!("jitai-1|17|{expression}|PENDING"))?;
            Some(tasks.iter().map(|task| task.chunk).collect::<Vec<_>>())
        };
        for (expression, expected) in [
            ("3", vec![3]),
            ("[0-5%2]", vec![0, 1, 2, 3, 4, 5]),
            ("0,2-3,7%1", vec![0, 2, 3, 7]),
            ("0-20:10", vec![0, 10, 20]),
        ] {
            assert_eq!(chunks(expression), Some(expected), "{expression}");
        }
        for expression in ["0-5,...", "[0-5,...%2]", "0-4:0", "", "a-b"] {
            assert_eq!(chunks(expression), None, "{expression}");
        }
    }

    #[test]
    fn times_and_memory_are_those_that_slurm_reads() {
        for time in ["1", "90", "10:00", "2:00:00", "1-12", "1-12:30", "1-12:30:00"] {
            assert!(is_time(time), "{time}");
        }
        for time in ["", "0", "1-", "-1", "1:2:3:4", "1h", "1-2-3", "00:00"] {
            assert!(!is_time(time), "{time}");
        }
        assert!(["500", "4G", "1T"].into_iter().all(is_memory));
        assert!(!["", "0", "G", "4g", "4GB", "-1"].into_iter().any(is_memory));
    }

    #[test]
    fn variables_that_would_change_an_answer_are_unset() {
        for variable in ["SQUEUE_STATES", "SQUEUE_FORMAT", "SCANCEL_STATE", "SBATCH_ARRAY_INX"] {
            assert!(is_unset(variable), "{variable}");
        }
        for variable in ["SLURM_CONF", "SLURM_CLUSTERS", "SBATCH_ACCOUNT", "PATH"] {
            assert!(!is_unset(variable), "{variable}");
        }
    }

    #[test]
    fn the_smaller_limit_of_arrays_counts() {
        let sizes = "MaxArraySize            = 1001\nMaxJobCount = 7\n";
        assert_eq!(most_tasks(sizes), Some(1001));
        let scheduler = "SchedulerParameters     = bf_interval=5,max_array_tasks=300,defer\n";
        assert_eq!(most_tasks(&format!("{scheduler}{sizes}")), Some(300));
        assert_eq!(most_tasks(&format!("SchedulerParameters = (null)\n{sizes}")), Some(1001));
        assert_eq!(most_tasks("MaxJobCount = 7\n"), None);
    }

    /// Runs the script of an array as the task `array`_`index`, whose job id is `job`, beside a queue in which
    /// every task of array 17 runs. The program of the task exits with `code`. Returns the calls of
    /// scontrol.
    fn calls_of_a_task(job: u32, index: u32, code: u8) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let write = |name: &str, body: &str| {
            std::fs::write(path(name), format!("#!/bin/bash\n{body}\n")).unwrap();
            let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
            std::fs::set_permissions(path(name), mode).unwrap();
        };
        write("program", &format!("exit {code}"));
        // As squeue does: the id of an array stands for all of its tasks.
        write(
            "squeue",
            "[ -z \"$SQUEUE_STATES\" ] || exit 1\n\
             case \" $* \" in *' --jobs=17 '*) printf 'RUNNING\\nRUNNING\\nRUNNING\\n' ;;\n\
             *' --jobs=17_'[0-2]' '*) echo RUNNING ;; *) exit 1 ;; esac",
        );
        write("scontrol", &format!("echo \"$@\" >>'{}'", path("calls").display()));
        let text = Profile::default().script("a", 3, folder.path(), &path("program"));
        write("script", &text);
        let programs = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
        let mut script = std::process::Command::new(path("script"));
        script
            .env("PATH", programs)
            .env("SQUEUE_STATES", "PENDING")
            .env("SLURM_JOB_ID", job.to_string());
        script.env("SLURM_ARRAY_JOB_ID", "17").env("SLURM_ARRAY_TASK_ID", index.to_string());
        assert_eq!(script.output().unwrap().status.code(), Some(i32::from(code)));
        std::fs::read_to_string(path("calls")).unwrap_or_default()
    }

    #[test]
    fn a_stopped_task_requeues_itself_alone_even_if_its_job_has_the_id_of_the_array() {
        for (job, index) in [(18, 0), (19, 1), (17, 2)] {
            assert_eq!(calls_of_a_task(job, index, RUN_AGAIN), format!("requeue 17_{index}\n"));
            assert_eq!(calls_of_a_task(job, index, 0), "");
        }
    }

    #[test]
    fn a_script_has_the_options_of_the_profile_and_quotes_its_paths() {
        let script = script_of(
            "partition = \"short\"\ntime_limit = \"2:00:00\"\nmemory = \"4G\"\ncpus_per_task = 4\n\
             max_running = 20\nsetup = [\"module load gcc\"]\nexclusive = true\n\
             comment = 'a \"b\"'",
        );
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
        let script = script_of("signal = \"B:TERM@300\"");
        assert!(script.contains("#SBATCH --signal=B:TERM@300\n"), "{script}");
        assert!(!script.contains("@60"), "{script}");
    }
}
