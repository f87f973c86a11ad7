//! Subscripts in texts: a Greek letter with `_` and letters or digits after it, such as `δ_d`.

/// The size of subscripts, relative to the other letters.
pub(super) const SIZE: f64 = 0.74;

/// The drop of subscripts below the baseline, relative to the size of the other letters.
pub(super) const DROP: f64 = 0.17;

/// Consecutive letters of a text at the same level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Run<'t> {
    pub text: &'t str,
    pub level: Level,
}

/// The level of letters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Base,
    Subscript,
}

impl Level {
    /// The size of the letters and their drop below the baseline, in a text of this size.
    pub(super) fn size_and_drop(self, size: f64) -> (f64, f64) {
        match self {
            Level::Base => (size, 0.0),
            Level::Subscript => (size * SIZE, size * DROP),
        }
    }
}

/// The runs of a text, without the `_` between a letter and its subscript.
pub(crate) fn runs(text: &str) -> Vec<Run<'_>> {
    let mut runs = Vec::new();
    let (mut rest, mut from) = (text, 0);
    while let Some(at) = rest[from..].find('_').map(|at| from + at) {
        let is_symbol = rest[..at].chars().next_back().is_some_and(is_greek);
        let below = &rest[at + 1..];
        let length = below.find(|c: char| !c.is_alphanumeric()).unwrap_or(below.len());
        if !is_symbol || length == 0 {
            from = at + 1;
            continue;
        }
        runs.push(Run { text: &rest[..at], level: Level::Base });
        runs.push(Run { text: &below[..length], level: Level::Subscript });
        (rest, from) = (&below[length..], 0);
    }
    if !rest.is_empty() {
        runs.push(Run { text: rest, level: Level::Base });
    }
    runs
}

fn is_greek(letter: char) -> bool {
    ('α'..='ω').contains(&letter)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_greek_letter_has_a_subscript_and_a_word_keeps_its_underscore() {
        let split = |text| {
            let runs = runs(text).into_iter();
            runs.map(|run| (run.text, run.level == Level::Subscript)).collect::<Vec<_>>()
        };
        assert_eq!(
            split("dqn δ_d=0.1 ε_h"),
            [("dqn δ", false), ("d", true), ("=0.1 ε", false), ("h", true)]
        );
        assert_eq!(split("learning_rate=1 ρ_ 1"), [("learning_rate=1 ρ_ 1", false)]);
        assert_eq!(split("ρ_1"), [("ρ", false), ("1", true)]);
        assert!(split("").is_empty());
    }
}
