//! Valid profiles, and faulty profiles with their messages.

use std::fs;

use super::engines::EngineKind;
use super::order::Tasks;
use super::profile::{Profile, keys, schema};
use crate::key::Value;

fn faults(text: &str) -> String {
    Profile::parse("cluster.toml", text).unwrap_err().to_string()
}

#[test]
fn a_profile_has_its_keys_and_passes_other_options_on_in_their_order() {
    let text = "engine = \"slurm\"\npartition = \"short\"\naccount = \"lab\"\n\
                time_limit = \"2:00:00\"\ncpus_per_task = 4\nmemory = \"4G\"\n\
                max_running = 200\nchunk_minutes = 30\nscratch = \"/local/$USER\"\n\
                setup = [\"module load gcc\"]\nqos = \"normal\"\nexclusive = true\n\
                contiguous = false\nnice = 100\n";
    let profile = Profile::parse("cluster.toml", text).unwrap();
    let settings = ["short", "lab", "2:00:00", "4G"];
    let expected = Profile {
        tasks: Tasks {
            cpus_per_task: 4,
            max_running: 200,
            chunk_minutes: 30.0,
            scratch: "/local/$USER".to_owned(),
            setup: vec!["module load gcc".to_owned()],
            ..Profile::default().tasks
        },
        settings: settings.map(|text| Value::Text(text.to_owned())).to_vec(),
        options: profile.options.clone(),
        ..Profile::of(EngineKind::Slurm)
    };
    assert_eq!(profile, expected);
    let mut options = profile.options;
    options.sort();
    let text = |text: &str| Some(text.to_owned());
    let expected = [("exclusive", None), ("nice", text("100")), ("qos", text("normal"))];
    assert_eq!(options, expected.map(|(name, value)| (name.to_owned(), value)));
}

#[test]
fn every_fault_is_shown_at_once_with_its_place() {
    let shown = faults("engine = \"slum\"\ntime_limit = \"soon\"\ncpus_per_task = 0\n");
    for part in [
        "cluster.toml:1:10: `engine`: expected \"slurm\"",
        "cluster.toml:2:14: `time_limit`: expected minutes, or a text such as",
        "cluster.toml:3:17: `cpus_per_task`: expected a whole number from 1 to 1024",
        "3 faults in cluster.toml",
    ] {
        assert!(shown.contains(part), "{part:?} is not in {shown}");
    }
}

#[test]
fn faulty_profiles_say_what_to_do() {
    let cases = [
        ("", "`engine` is missing"),
        ("partition = \"a\"", "write engine = \"slurm\""),
        ("engine = \"slurm\"\npartiton = \"a\"", "did you mean `partition`?"),
        ("engine = \"slurm\"\nchunk_minute = 1", "did you mean `chunk_minutes`?"),
        ("engine = \"slurm\"\nchunk-minutes = 1", "did you mean `chunk_minutes`?"),
        ("engine = \"slurm\"\narray = \"1-2\"", "`array` is set by jitai"),
        ("engine = \"slurm\"\ntime = 5", "write `time_limit`"),
        ("engine = \"slurm\"\nmem = \"1G\"", "write `memory`"),
        ("engine = \"slurm\"\nmemory = \"lots\"", "`memory`: expected"),
        ("engine = \"slurm\"\nsignal = \"USR1@5\"", "the signal on which tasks checkpoint"),
        ("engine = \"slurm\"\nscratch = \"$(rm -r /)\"", "`scratch`: expected"),
        ("engine = \"slurm\"\nscratch = \"here\"", "`scratch`: expected"),
        ("engine = \"slurm\"\nhand_in_minutes = 11", "to 10"),
        ("engine = \"slurm\"\nfolder = \"here\"", "an absolute path"),
        ("engine = \"slurm\"\nsetup = \"module load gcc\"", "a list of lines of shell"),
        ("engine = \"slurm\"\nqos = 1.5", "`qos`: expected"),
        ("engine = \"slurm\"\nengine = \"slurm\"", "is set twice"),
        ("engine = \"slurm", "not valid TOML"),
    ];
    for (text, expected) in cases {
        let shown = faults(text);
        assert!(shown.contains(expected), "{text:?}: {expected:?} is not in {shown}");
    }
}

#[test]
fn the_schema_names_every_key() {
    let schema = schema();
    for key in keys(EngineKind::Slurm.declaration()) {
        assert_eq!(schema["properties"][key.name]["description"], key.doc());
    }
    assert_eq!(schema["properties"]["array"], false);
    let renew = "run: jitai schema --cluster > docs/cluster.schema.json";
    let written = fs::read_to_string("docs/cluster.schema.json").expect(renew);
    assert_eq!(written, format!("{schema:#}\n"), "{renew}");
}
