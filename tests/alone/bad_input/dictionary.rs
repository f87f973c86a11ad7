//! Words that a mutation may insert, from dictionaries in the format of fuzzers.

use std::fs;
use std::path::Path;

/// The words of a dictionary: one per line, in quotes, with `\xNN` for other bytes.
pub fn words(path: &Path) -> Vec<Vec<u8>> {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| line.starts_with('"'));
    lines.map(|line| word(line.trim_matches('"'))).collect()
}

fn word(quoted: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = quoted.as_bytes();
    while let Some((first, behind)) = rest.split_first() {
        rest = behind;
        match (first, rest) {
            (b'\\', [b'x', high, low, behind @ ..]) => {
                let digit = |byte: &u8| (*byte as char).to_digit(16).unwrap() as u8;
                bytes.push(16 * digit(high) + digit(low));
                rest = behind;
            }
            (b'\\', [escaped, behind @ ..]) => {
                bytes.push(*escaped);
                rest = behind;
            }
            _ => bytes.push(*first),
        }
    }
    bytes
}

#[test]
fn words_are_read_with_their_escapes() {
    assert_eq!(word(r#"a\x00\xff\"\\"#), b"a\x00\xff\"\\");
}
