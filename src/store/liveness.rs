//! Whether a process that holds runs is still alive.
//!
//! In: the recorded description of a process, and the time since its last heartbeat. Out: [`Liveness`]. A
//! process on this machine is looked up in `/proc`. A stopped process (SIGSTOP) therefore counts as alive,
//! and a killed process is recognised as dead at once. If a process cannot be looked up, the time since its
//! last heartbeat decides. A wrong verdict costs time but never a result, because only the holder of a claim
//! can write.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process;
use std::time::Duration;

/// The time without a heartbeat after which a process on this machine counts as dead if it cannot
/// be looked up. It may be in another container, or the system has no `/proc`.
const NEAR_SILENCE: Duration = Duration::from_secs(30);
/// The time without a heartbeat after which a process on another machine counts as dead.
const FAR_SILENCE: Duration = Duration::from_secs(5 * 60);

/// A process, with enough detail to distinguish it from every later process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Process {
    /// The name of the process's host.
    pub(super) host: String,
    /// The identity of the kernel's boot; `None` if the system has none.
    pub(super) boot_id: Option<String>,
    /// The PID namespace of `id`; `None` if the system has none.
    pub(super) pid_namespace: Option<String>,
    /// Process id.
    pub(super) id: u32,
    /// Clock ticks from boot to the start of the process; `None` if unknown.
    pub(super) started: Option<i64>,
}

/// Whether a process is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Liveness {
    /// The process is running or stopped, or may be running as far as can be determined.
    Alive,
    /// The process has ended.
    Dead,
}

/// The process table of the system.
#[derive(Clone, Debug)]
pub(super) struct ProcessTable {
    root: PathBuf,
}

/// The entry of the process table for a process id.
enum Entry {
    Started(i64),
    Gone,
    Unknown,
}

impl ProcessTable {
    /// The table of this system; empty where there is no `/proc`.
    pub(super) fn of_this_system() -> Self {
        ProcessTable { root: PathBuf::from("/proc") }
    }

    /// The current process.
    pub(super) fn this_process(&self) -> Process {
        let id = process::id();
        Process {
            host: host_name(),
            boot_id: read_line(&self.root.join("sys/kernel/random/boot_id")),
            pid_namespace: fs::read_link(self.root.join("self/ns/pid"))
                .ok()
                .map(|name| name.to_string_lossy().into_owned()),
            id,
            started: match self.look_up(id) {
                Entry::Started(started) => Some(started),
                Entry::Gone | Entry::Unknown => None,
            },
        }
    }

    /// Whether `other`, whose last heartbeat was `silence` ago, is alive, as seen from the process `this`.
    pub(super) fn judge(&self, this: &Process, other: &Process, silence: Duration) -> Liveness {
        let silent = |limit| if silence > limit { Liveness::Dead } else { Liveness::Alive };
        match (&this.boot_id, &other.boot_id) {
            (Some(mine), Some(its)) if mine == its => {}
            // The machine has rebooted since then.
            (Some(_), Some(_)) if this.host == other.host => return Liveness::Dead,
            // This system does not identify boots.
            (None, _) | (_, None) if this.host == other.host => return silent(NEAR_SILENCE),
            _ => return silent(FAR_SILENCE),
        }
        if this.pid_namespace.is_none() || this.pid_namespace != other.pid_namespace {
            return silent(NEAR_SILENCE);
        }
        match (self.look_up(other.id), other.started) {
            (Entry::Gone, _) => Liveness::Dead,
            (Entry::Started(now), Some(then)) if now != then => Liveness::Dead,
            (Entry::Started(_), Some(_)) => Liveness::Alive,
            (Entry::Started(_), None) | (Entry::Unknown, _) => silent(NEAR_SILENCE),
        }
    }

    fn look_up(&self, id: u32) -> Entry {
        match fs::read_to_string(self.root.join(format!("{id}/stat"))) {
            Ok(stat) => parse_stat(&stat),
            // Some systems hide other users' processes, so absence proves nothing there.
            Err(error) if error.kind() == ErrorKind::NotFound => {
                if self.root.join("1/stat").exists() { Entry::Gone } else { Entry::Unknown }
            }
            // Linux returns this error if a process ends while its entry is being read.
            Err(error) if error.raw_os_error() == Some(ESRCH) => Entry::Gone,
            Err(_) => Entry::Unknown,
        }
    }
}

/// The name of this host; `unknown` if the system has none.
pub fn host_name() -> String {
    let named = |text: String| Some(text.trim().to_owned()).filter(|name| !name.is_empty());
    let of_kernel = || fs::read_to_string("/proc/sys/kernel/hostname").ok().and_then(named);
    let of_command = || {
        let output = process::Command::new("uname").arg("-n").output().ok()?;
        String::from_utf8(output.stdout).ok().and_then(named)
    };
    of_kernel().or_else(of_command).unwrap_or_else(|| "unknown".to_owned())
}

/// "No such process" on Linux.
const ESRCH: i32 = 3;

/// Reads the state and the start time: fields 3 and 22 of `/proc/<pid>/stat` (proc(5)).
fn parse_stat(stat: &str) -> Entry {
    // The second field is the program's name in parentheses. The name may contain parentheses itself.
    let Some((_, fields)) = stat.rsplit_once(')') else { return Entry::Unknown };
    let mut fields = fields.split_ascii_whitespace();
    match fields.next() {
        // A zombie has ended, but its parent has not yet collected its status.
        Some("Z" | "X" | "x") => return Entry::Gone,
        Some(_) => {}
        None => return Entry::Unknown,
    }
    match fields.nth(18).map(str::parse) {
        Some(Ok(started)) => Entry::Started(started),
        Some(Err(_)) | None => Entry::Unknown,
    }
}

fn read_line(path: &Path) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn here() -> Process {
        Process {
            host: "lab".into(),
            boot_id: Some("boot-1".into()),
            pid_namespace: Some("pid:[1]".into()),
            id: 40,
            started: Some(900),
        }
    }

    /// A process table with process 1 and process 40 in `state`, started at tick 900.
    fn table(state: char) -> (tempfile::TempDir, ProcessTable) {
        let folder = tempfile::tempdir().unwrap();
        for (id, started) in [(1, 3), (40, 900)] {
            let entry = folder.path().join(id.to_string());
            fs::create_dir(&entry).unwrap();
            let zeros = "0 ".repeat(18);
            fs::write(
                entry.join("stat"),
                format!("{id} (a) b (c)) {state} {zeros}{started} 0 0\n"),
            )
            .unwrap();
        }
        let root = folder.path().to_owned();
        (folder, ProcessTable { root })
    }

    #[test]
    fn a_process_in_the_table_is_alive_however_silent() {
        for state in ['R', 'S', 'T'] {
            let (_folder, table) = table(state);
            assert_eq!(table.judge(&here(), &here(), 1000 * FAR_SILENCE), Liveness::Alive);
        }
    }

    #[test]
    fn a_process_that_is_gone_or_a_zombie_is_dead_at_once() {
        let (_folder, running) = table('R');
        let gone = Process { id: 41, ..here() };
        assert_eq!(running.judge(&here(), &gone, Duration::ZERO), Liveness::Dead);
        let (_folder, zombies) = table('Z');
        assert_eq!(zombies.judge(&here(), &here(), Duration::ZERO), Liveness::Dead);
    }

    #[test]
    fn a_process_id_used_again_is_another_process() {
        let (_folder, table) = table('R');
        let earlier = Process { started: Some(899), ..here() };
        assert_eq!(table.judge(&here(), &earlier, Duration::ZERO), Liveness::Dead);
    }

    #[test]
    fn a_process_from_before_the_last_boot_is_dead() {
        let (_folder, table) = table('R');
        let earlier = Process { boot_id: Some("boot-0".into()), ..here() };
        assert_eq!(table.judge(&here(), &earlier, Duration::ZERO), Liveness::Dead);
    }

    #[test]
    fn silence_decides_where_a_process_cannot_be_looked_up() {
        let (_folder, full) = table('R');
        let empty = ProcessTable { root: full.root.join("1") };
        let elsewhere = Process { host: "far".into(), boot_id: Some("boot-2".into()), ..here() };
        let contained = Process { pid_namespace: Some("pid:[2]".into()), ..here() };
        let unknown_boot = Process { boot_id: None, ..here() };
        let unknown_boot_elsewhere = Process { host: "far".into(), ..unknown_boot.clone() };
        for (table, other, limit) in [
            (&full, &elsewhere, FAR_SILENCE),
            (&full, &unknown_boot, NEAR_SILENCE),
            (&full, &unknown_boot_elsewhere, FAR_SILENCE),
            (&full, &contained, NEAR_SILENCE),
            (&empty, &here(), NEAR_SILENCE),
        ] {
            assert_eq!(table.judge(&here(), other, limit - SECOND), Liveness::Alive, "{other:?}");
            assert_eq!(table.judge(&here(), other, limit + SECOND), Liveness::Dead, "{other:?}");
        }
    }

    #[test]
    fn without_boots_and_a_process_table_the_host_and_its_silence_decide() {
        let folder = tempfile::tempdir().unwrap();
        let table = ProcessTable { root: folder.path().to_owned() };
        let bare = |host: &str| Process {
            host: host.into(),
            boot_id: None,
            pid_namespace: None,
            id: 40,
            started: None,
        };
        let judge = |other: &str, silence| table.judge(&bare("mac"), &bare(other), silence);
        assert_eq!(judge("mac", NEAR_SILENCE - SECOND), Liveness::Alive);
        assert_eq!(judge("mac", NEAR_SILENCE + SECOND), Liveness::Dead);
        assert_eq!(judge("far", NEAR_SILENCE + SECOND), Liveness::Alive);
        assert_eq!(judge("far", FAR_SILENCE + SECOND), Liveness::Dead);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_is_alive_and_a_child_that_ended_is_dead() {
        let table = ProcessTable::of_this_system();
        let this = table.this_process();
        assert!(this.boot_id.is_some() && this.started.is_some(), "{this:?}");
        assert_eq!(table.judge(&this, &this, 2 * FAR_SILENCE), Liveness::Alive);

        let mut child = process::Command::new("true").spawn().unwrap();
        let ended = Process { id: child.id(), ..this.clone() };
        child.wait().unwrap();
        assert_eq!(table.judge(&this, &ended, Duration::ZERO), Liveness::Dead);
    }
}
