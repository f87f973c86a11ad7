//! Merges that are killed, before and after each commit and at random moments, and then repeated, end
//! in the store of an undisturbed merge.
//!
//! `KILLS` is the number of kills at random moments, and `SEED` repeats the choice of moments, which
//! are only as exact as the machine. Prints a table. Run by `make test-kill`.

use std::env;
use std::fs;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jitai::kill_point::{KillPoint, VARIABLE};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{Effort, Folder, manifest};

/// Default number of kills at random moments.
const KILLS: u64 = 100;
/// The stores that are merged.
const SOURCES: [&str; 4] = ["1.sqlite", "2.sqlite", "3.sqlite", "4.sqlite"];

/// Four stores: three with one shard each of one manifest, and one with failing jobs.
fn sources() -> Folder {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "25", Effort::Trivial));
    let layers = ["64"; 24].join(", ");
    let failing = format!(
        "format = 1\nname = \"failing\"\nscenarios = [\"P-H-D\"]\nseeds = 3\n\
         environment.sigma = 0.6\nevaluation.test_episodes = 20\n\
         [[agent]]\nname = \"wild\"\nalgorithm = \"dueling_dqn\"\nepisodes = 50\n\
         layers = [{layers}]\nbatch = 8\nlearning_rate = 1.0\n"
    );
    folder.write("failing.toml", failing);
    for (number, store) in (1..).zip(&SOURCES[..3]) {
        let shard = format!("{number}/3");
        folder.jitai(["run", "sweep.toml", "--shard", &shard, "--store", store]).succeeded();
    }
    folder.jitai(["run", "failing.toml", "--store", SOURCES[3]]).ended(1);
    folder
}

/// A folder with copies of the sources, without a target.
fn copied(sources: &Folder) -> Folder {
    let folder = Folder::new();
    for store in SOURCES {
        fs::copy(sources.path(store), folder.path(store)).unwrap();
    }
    folder
}

fn merge(folder: &Folder) -> Command {
    let mut command = folder.command(["merge"].into_iter().chain(SOURCES));
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Everything that a merge can write: the public views, and the sessions.
fn rows(folder: &Folder) -> Vec<String> {
    let store = folder.store();
    let sql = "SELECT concat_ws('|', id, host, process_id, started_at, heartbeat_at, ended_at)
        FROM session ORDER BY id";
    let mut statement = store.prepare(sql).unwrap();
    let sessions = statement.query_map([], |row| row.get::<_, String>(0)).unwrap();
    let mut rows: Vec<String> = sessions.collect::<Result<_, _>>().unwrap();
    rows.extend(folder.everything());
    rows
}

/// Completes a merge and compares the store.
#[track_caller]
fn complete(folder: &Folder, undisturbed: &[String], what: &str) {
    folder.jitai(["merge"].into_iter().chain(SOURCES)).succeeded();
    let rows = rows(folder);
    let differing = rows.iter().zip(undisturbed).find(|(ours, theirs)| ours != theirs);
    assert!(rows == undisturbed, "killed {what}: {} rows, {differing:?}", rows.len());
    folder.jitai(["doctor"]).succeeded();
}

/// Kills a merge at each of its commits; returns the number of kills.
fn kill_at_every_commit(sources: &Folder, undisturbed: &[String], point: KillPoint) -> u64 {
    for passes in 1.. {
        let folder = copied(sources);
        let chosen = format!("{}:{passes}", point.name());
        let ended = merge(&folder).env(VARIABLE, &chosen).status().unwrap();
        if ended.success() {
            return passes - 1;
        }
        assert_eq!(ended.code(), None, "{chosen}: {ended}");
        complete(&folder, undisturbed, &format!("at {chosen}"));
    }
    unreachable!("a merge has an end")
}

/// Kills merges at random moments, each repeatedly until it is done; returns the number of kills.
fn kill_at_random(sources: &Folder, undisturbed: &[String], seed: u64, kills: u64) -> u64 {
    let begun = Instant::now();
    merge(&copied(sources)).status().unwrap();
    let took = begun.elapsed();
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut killed = 0;
    while killed < kills {
        let folder = copied(sources);
        for _ in 0..30 {
            let mut child = merge(&folder).spawn().unwrap();
            thread::sleep(took.mul_f64(f64::from(chance.next_u32()) / f64::from(u32::MAX)));
            if let Some(ended) = child.try_wait().unwrap() {
                assert!(ended.success(), "{ended}");
                break;
            }
            child.kill().unwrap();
            child.wait().unwrap();
            killed += 1;
        }
        complete(&folder, undisturbed, &format!("at random moments, SEED={seed}"));
    }
    killed
}

/// A whole number from an environment variable.
fn asked(name: &str) -> Option<u64> {
    let text = env::var(name).ok().filter(|text| !text.is_empty())?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is `{text}`; expected a whole number")))
}

#[test]
fn killed_merges_end_in_the_store_of_an_undisturbed_one() {
    let clock = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (seed, kills) = (asked("SEED").unwrap_or(clock), asked("KILLS").unwrap_or(KILLS));
    println!("SEED={seed} KILLS={kills}");
    let begun = Instant::now();
    let sources = sources();
    let target = copied(&sources);
    assert!(merge(&target).status().unwrap().success());
    let undisturbed = rows(&target);
    let random = kill_at_random(&sources, &undisturbed, seed, kills);
    println!("| killed | kills |\n| --- | --- |\n| at random moments | {random} |");
    for point in [KillPoint::BeforeCommit, KillPoint::AfterCommit] {
        let kills = kill_at_every_commit(&sources, &undisturbed, point);
        assert!(kills >= 20, "{}: {kills}", point.name());
        println!("| at every `{}` | {kills} |", point.name());
    }
    println!("{} s", Duration::as_secs(&begun.elapsed()));
}
