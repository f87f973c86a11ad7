//! What an installed program does for its user: it checks the machine, and describes itself to shells and `man`.

use std::fs;
use std::process::Command;

use jitai::kernel::Isa;

use crate::support::Folder;

#[test]
fn a_self_test_finds_the_bits_of_the_developers_on_every_instruction_set() {
    let folder = Folder::new();
    let tested = folder.jitai(["self-test"]).succeeded();
    let tested = tested.prints("works on this machine; checked in");
    for isa in Isa::available() {
        assert!(tested.stdout.contains(isa.name()), "{}", tested.stdout);
    }
    assert_eq!(tested.stdout.lines().filter(|line| line.starts_with("ok ")).count(), 3);
    assert_eq!(fs::read_dir(folder.path(".")).unwrap().count(), 0, "nothing remains in the folder");
}

#[test]
fn a_folder_that_cannot_hold_a_store_fails_the_self_test() {
    let folder = Folder::new();
    let tested = ["self-test", "--format", "json", "--store", "absent/jitai.sqlite"];
    let tested = folder.jitai(tested).ended(3);
    let answer: serde_json::Value = serde_json::from_str(&tested.stdout).unwrap();
    assert_eq!(answer["passed"], false);
    let checks: Vec<bool> =
        answer["checks"].as_array().unwrap().iter().map(|one| one["passed"] == true).collect();
    assert_eq!(checks, [true, true, false]);
    let fault = answer["checks"][2]["fault"].as_str().unwrap();
    assert!(fault.contains("there is no folder"), "{fault}");
}

#[test]
fn completions_of_every_shell_know_commands_and_options() {
    let folder = Folder::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = folder.jitai(["completions", shell]).succeeded().stdout;
        assert!(script.contains("salvage") && script.contains("self-test"), "{shell}: {script}");
    }
    folder.jitai(["completions", "tcsh"]).ended(2).says("bash");
}

/// What the completions of bash offer for the last of these words.
fn offered(folder: &Folder, words: &[&str]) -> Vec<String> {
    let script = folder.jitai(["completions", "bash"]).succeeded().stdout;
    let call = "COMP_WORDS=(\"$@\"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
        _jitai jitai \"${*: -1}\" \"${COMP_WORDS[$(($# - 2))]}\"
        for one in \"${COMPREPLY[@]}\"; do printf '%s\\n' \"$one\"; done";
    let mut bash = Command::new("bash");
    bash.args(["--norc", "-c", &format!("{script}\n{call}"), "bash", "jitai"]).args(words);
    let answer = bash.current_dir(folder.path(".")).output().unwrap();
    String::from_utf8(answer.stdout).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn completions_of_bash_offer_files_as_they_are_and_nothing_hidden() {
    let folder = Folder::new();
    for file in ["my store.sqlite", "a.toml", "b c.toml", "notes.txt"] {
        fs::write(folder.path(file), "").unwrap();
    }
    assert_eq!(offered(&folder, &["status", "--store", "my"]), ["my store.sqlite"]);
    assert_eq!(offered(&folder, &["submit", "--cluster", "b"]), ["b c.toml"]);
    for verb in ["run", "check", "optimum"] {
        let mut files = offered(&folder, &[verb, ""]);
        files.sort();
        assert_eq!(files, ["a.toml", "b c.toml"], "{verb}");
    }
    assert_eq!(offered(&folder, &["merge", "my"]), ["my store.sqlite"]);
    assert_eq!(offered(&folder, &["run", "--retry"]), ["--retry-failed"]);
    assert!(offered(&folder, &["run", "--workers", "my"]).iter().all(|word| word == "my"));
    assert_eq!(offered(&folder, &["che"]), ["check"]);
    assert_eq!(offered(&folder, &["ta"]), [""; 0]);
    assert_eq!(offered(&folder, &["self-test", "--p"]), [""; 0]);
}

#[test]
fn every_command_of_the_help_has_a_manual_page() {
    let folder = Folder::new();
    folder.jitai(["manual", "--out", "man"]).succeeded().says("manual pages in man");
    let help = folder.jitai(["--help"]).succeeded().stdout;
    let commands = help.split_once("Commands:").unwrap().1.split_once("Options:").unwrap().0;
    let verbs = commands.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    let mut expected: Vec<String> = verbs
        .filter(|verb| !verb.is_empty() && *verb != "help")
        .map(|verb| format!("jitai-{verb}.1"))
        .chain(["jitai.1".to_owned()])
        .collect();
    let pages = fs::read_dir(folder.path("man")).unwrap();
    let mut pages: Vec<String> =
        pages.map(|page| page.unwrap().file_name().into_string().unwrap()).collect();
    pages.sort();
    expected.sort();
    assert_eq!(pages, expected);
    assert!(folder.read("man/jitai-doctor.1").contains("salvage"));
    assert!(folder.jitai(["manual"]).succeeded().stdout.contains(".TH jitai 1"));
}
