//! The memory that the control groups of this process permit, in versions 1 and 2.
//!
//! In: the process's groups and the mounted hierarchies, as `/proc` lists them. Out: the bytes of memory and
//! swap that the process can ever have. Containers and batch systems set such limits. An allocation
//! beyond the limit succeeds, but the kernel kills the process when it uses the memory.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The limit when first asked for; `None` if there is none, or if it is unknown.
pub(super) fn most_bytes() -> Option<u64> {
    static MOST: OnceLock<Option<u64>> = OnceLock::new();
    *MOST.get_or_init(|| limit(Path::new("/")))
}

/// The smallest limit of the groups that hold the process, on a system with this root folder.
fn limit(root: &Path) -> Option<u64> {
    let read = |path: &str| fs::read_to_string(root.join(path)).unwrap_or_default();
    let swap = swap_total(&read("proc/meminfo"));
    let groups = read("proc/self/cgroup");
    let mounts = read("proc/self/mountinfo");
    let limits = mounts.lines().filter_map(Mount::read).flat_map(|mount| {
        let (folder, group) =
            (root.join(mount.point.trim_start_matches('/')), mount.group(&groups));
        // A container may not see its own group; then the mounted folder is that group.
        let place = group.filter(|group| folder.join(group).is_dir()).unwrap_or_default();
        let ancestors: Vec<PathBuf> = place.ancestors().map(|part| folder.join(part)).collect();
        ancestors.into_iter().filter_map(move |group| mount.version.limit(&group, swap))
    });
    limits.min()
}

/// The swap of the machine, in bytes.
fn swap_total(meminfo: &str) -> u64 {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("SwapTotal:"));
    let kilobytes =
        line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
    kilobytes.unwrap_or(0).saturating_mul(1024)
}

/// A version of control groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Version {
    One,
    Two,
}

impl Version {
    /// The limit of one group.
    fn limit(self, group: &Path, swap: u64) -> Option<u64> {
        let number =
            |file: &str| fs::read_to_string(group.join(file)).ok()?.trim().parse::<u64>().ok();
        match self {
            Version::One => {
                let memory = number("memory.limit_in_bytes")?.saturating_add(swap);
                Some(number("memory.memsw.limit_in_bytes").map_or(memory, |both| both.min(memory)))
            }
            Version::Two => {
                let swap = number("memory.swap.max").map_or(swap, |most| most.min(swap));
                Some(number("memory.max")?.saturating_add(swap))
            }
        }
    }
}

/// A mounted hierarchy of groups that limits memory.
struct Mount<'a> {
    version: Version,
    /// The group that is mounted.
    root: &'a str,
    point: &'a str,
}

impl<'a> Mount<'a> {
    /// Reads a line of mountinfo, as proc(5) describes it.
    fn read(line: &'a str) -> Option<Mount<'a>> {
        let (mount, system) = line.split_once(" - ")?;
        let mut system = system.split(' ');
        let (kind, options) = (system.next()?, system.nth(1)?);
        let version = match kind {
            "cgroup2" => Version::Two,
            "cgroup" if options.split(',').any(|option| option == "memory") => Version::One,
            _ => return None,
        };
        let mut fields = mount.split(' ').skip(3);
        Some(Mount { version, root: fields.next()?, point: fields.next()? })
    }

    /// The process's group relative to the mounted group, from the lines of `/proc/self/cgroup`.
    fn group(&self, groups: &str) -> Option<PathBuf> {
        let group = groups.lines().find_map(|line| {
            let mut fields = line.splitn(3, ':').skip(1);
            let (controllers, group) = (fields.next()?, fields.next()?);
            let is_ours = match self.version {
                Version::One => controllers.split(',').any(|controller| controller == "memory"),
                Version::Two => controllers.is_empty(),
            };
            is_ours.then_some(group)
        })?;
        Path::new(group).strip_prefix(self.root).ok().map(Path::to_owned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A system whose files have these contents.
    fn limit_of(files: &[(&str, &str)]) -> Option<u64> {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        limit(root.path())
    }

    const VERSION_1: &str = "31 23 0:28 / /sys/fs/cgroup rw - tmpfs tmpfs rw,mode=755\n\
        34 31 0:31 / /sys/fs/cgroup/cpuset rw - cgroup cgroup rw,cpuset\n\
        35 31 0:32 / /sys/fs/cgroup/memory rw,relatime - cgroup cgroup rw,memory\n";
    const VERSION_2: &str =
        "29 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n";
    const UNLIMITED: &str = "9223372036854771712\n";

    #[test]
    fn the_smallest_limit_of_a_group_and_its_ancestors_counts_in_version_1() {
        let memory = "sys/fs/cgroup/memory";
        let limit = |of_parent: &str, of_group: &str| {
            limit_of(&[
                ("proc/self/mountinfo", VERSION_1),
                ("proc/self/cgroup", "9:cpuset:/\n7:memory:/batch/job_7\n0::/\n"),
                (&format!("{memory}/memory.limit_in_bytes"), UNLIMITED),
                (&format!("{memory}/batch/memory.limit_in_bytes"), of_parent),
                (&format!("{memory}/batch/job_7/memory.limit_in_bytes"), of_group),
            ])
        };
        assert_eq!(limit("5000\n", "3000\n"), Some(3000));
        assert_eq!(limit("2000\n", UNLIMITED), Some(2000));
        assert_eq!(limit(UNLIMITED, UNLIMITED), Some(9_223_372_036_854_771_712));
    }

    #[test]
    fn the_smallest_limit_of_a_group_and_its_ancestors_counts_in_version_2() {
        let limit = |of_parent: &str, of_group: &str, swap: &str| {
            limit_of(&[
                ("proc/self/mountinfo", VERSION_2),
                ("proc/self/cgroup", "0::/system.slice/run-7.scope\n"),
                ("proc/meminfo", "MemTotal: 9 kB\nSwapTotal:             2 kB\n"),
                ("sys/fs/cgroup/system.slice/memory.max", of_parent),
                ("sys/fs/cgroup/system.slice/run-7.scope/memory.max", of_group),
                ("sys/fs/cgroup/system.slice/run-7.scope/memory.swap.max", swap),
            ])
        };
        assert_eq!(limit("max\n", "3000\n", "0\n"), Some(3000));
        assert_eq!(limit("max\n", "3000\n", "max\n"), Some(3000 + 2048));
        assert_eq!(limit("500\n", "3000\n", "0\n"), Some(500 + 2048));
        assert_eq!(limit("max\n", "max\n", "max\n"), None);
    }

    #[test]
    fn a_container_reads_the_limit_of_the_folder_that_is_mounted_for_it() {
        // Without a namespace of control groups, the group is named as the host names it.
        let mounted =
            VERSION_1.replace(" / /sys/fs/cgroup/memory", " /docker/ab12 /sys/fs/cgroup/memory");
        for (mounts, group) in [(mounted.as_str(), "/docker/ab12"), (VERSION_1, "/docker/ab12")] {
            let limit = limit_of(&[
                ("proc/self/mountinfo", mounts),
                ("proc/self/cgroup", &format!("4:cpu,memory:{group}\n")),
                ("sys/fs/cgroup/memory/memory.limit_in_bytes", "7000\n"),
            ]);
            assert_eq!(limit, Some(7000));
        }
    }

    #[test]
    fn a_system_without_control_groups_has_no_limit() {
        assert_eq!(limit_of(&[]), None);
        assert_eq!(
            limit_of(&[("proc/self/mountinfo", "broken\n"), ("proc/self/cgroup", "?\n")]),
            None
        );
    }
}
