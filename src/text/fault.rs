//! What is wrong with a manifest, and how it is shown to its author.
//!
//! In: faults in the order of their detection. Out: all of them, by position, each with file, line, column,
//! the line itself with carets, and a hint. It does not depend on the meaning of keys.

use std::fmt;

use serde::ser::{Serialize, SerializeSeq, Serializer};

use crate::text::source::{Position, Source, Span, visible};

/// One thing that is wrong.
#[derive(Clone, Debug)]
pub struct Fault {
    span: Option<Span>,
    message: String,
    help: Option<String>,
}

impl Fault {
    pub(crate) fn at(span: Span, message: impl Into<String>) -> Fault {
        Fault { span: Some(span), message: message.into(), help: None }
    }

    /// A fault of the manifest as a whole.
    pub(crate) fn whole(message: impl Into<String>) -> Fault {
        Fault { span: None, message: message.into(), help: None }
    }

    /// The fault at this position.
    pub(crate) fn at_span(self, span: Span) -> Fault {
        Fault { span: Some(span), ..self }
    }

    pub(crate) fn help(self, help: impl Into<String>) -> Fault {
        Fault { help: Some(help.into()), ..self }
    }

    /// Suggests the nearest of `words`, if one is near enough.
    pub(crate) fn nearest<'w>(
        self,
        found: &str,
        words: impl IntoIterator<Item = &'w str> + Clone,
    ) -> Fault {
        match nearest(found, words) {
            Some(word) => self.help(format!("did you mean `{word}`?")),
            None => self,
        }
    }

    /// Suggests the nearest of the keys of `owner`, or else lists all of them.
    pub(crate) fn one_of(self, owner: &str, keys: &[&str], found: &str) -> Fault {
        let all = self.help(format!("{owner} keys are {}", keys.join(", ")));
        all.nearest(found, keys.iter().copied())
    }

    /// The fault, with the valid range or values.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The remedy, if known.
    pub fn hint(&self) -> Option<&str> {
        self.help.as_deref()
    }
}

/// The word nearest to `found`: its edit distance is at most a third of the length of `found`, or `found`
/// is one of its parts.
pub fn nearest<'w>(
    found: &str,
    words: impl IntoIterator<Item = &'w str> + Clone,
) -> Option<&'w str> {
    // A near word takes precedence over a word with `found` as a part.
    near(found, words.clone()).or_else(|| with_part(found, words))
}

/// Maximum number of letters of a word that is compared with others.
const LONGEST: usize = 60;

/// The word nearest to `found`, whose edit distance is at most a third of the length of `found`.
pub(crate) fn near<'w>(found: &str, words: impl IntoIterator<Item = &'w str>) -> Option<&'w str> {
    let lower = found.to_lowercase();
    let letters = lower.chars().count();
    if letters > LONGEST {
        return None;
    }
    let farthest = (letters / 3).max(1);
    let mut near = None;
    for word in words {
        let text = word.to_lowercase();
        // The difference in length is a cheap lower bound of the edit distance.
        if text.chars().count().abs_diff(letters) <= farthest {
            let distance = strsim::damerau_levenshtein(&lower, &text);
            if distance <= near.map_or(farthest, |(nearest, _)| nearest - 1) {
                near = Some((distance, word));
                if distance == 0 {
                    break;
                }
            }
        }
    }
    near.map(|(_, word)| word)
}

/// The first word that has `found` as a part.
fn with_part<'w>(found: &str, words: impl IntoIterator<Item = &'w str>) -> Option<&'w str> {
    const SHORTEST: usize = 3;
    let lower = found.to_lowercase();
    let is_part =
        |word: &&str| word.to_lowercase().split(['_', '-', '.']).any(|part| part == lower);
    let comparable = (SHORTEST..=LONGEST).contains(&lower.chars().count());
    words.into_iter().filter(|_| comparable).find(is_part)
}

/// The nearest value: the nearest number, or a text that is similar enough.
pub fn nearest_value<'v>(wanted: &str, values: &'v [String]) -> Option<&'v str> {
    let Ok(number) = wanted.parse::<f64>() else {
        return nearest(wanted, values.iter().map(String::as_str));
    };
    let distance =
        |value: &&String| value.parse::<f64>().map_or(f64::INFINITY, |x| (x - number).abs());
    let near = values.iter().min_by(|one, other| distance(one).total_cmp(&distance(other)))?;
    distance(&near).is_finite().then_some(near)
}

/// Collects faults while a manifest is read.
#[derive(Debug, Default)]
pub struct FaultList {
    list: Vec<Fault>,
    dropped: usize,
    /// The faults of files that the text names.
    files: Vec<Faults>,
}

impl FaultList {
    /// Maximum number of faults kept: a hostile file could have millions.
    const MOST: usize = 1000;

    pub fn add(&mut self, fault: Fault) {
        if self.list.len() < Self::MOST {
            self.list.push(fault);
        } else {
            self.dropped += 1;
        }
    }

    /// Counts faults that are not shown.
    pub(crate) fn leave_out(&mut self, count: usize) {
        self.dropped += count;
    }

    pub fn len(&self) -> usize {
        self.list.len() + self.dropped
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The faults that were kept.
    pub fn iter(&self) -> impl Iterator<Item = &Fault> {
        self.list.iter()
    }

    /// The messages of the faults that were kept.
    pub fn messages(&self) -> impl Iterator<Item = &str> {
        self.list.iter().map(Fault::message)
    }

    /// Keeps the faults that do not begin on a line of one of `others`.
    pub(crate) fn retain_off_lines_of(&mut self, others: &FaultList, source: &Source) {
        let line = |fault: &Fault| fault.span.map(|span| source.position(span.start).line);
        let taken: std::collections::HashSet<_> = others.list.iter().map(line).collect();
        self.list.retain(|fault| !taken.contains(&line(fault)));
    }

    /// Keeps the faults of a file that the text names, if its own text is known. Returns what a fault of the text says
    /// of it.
    pub(crate) fn add_of_file(
        &mut self,
        name: Option<&str>,
        text: Option<&str>,
        found: FaultList,
    ) -> String {
        let (count, name) = (found.len(), name.unwrap_or("its text"));
        let noun = if count == 1 { "fault" } else { "faults" };
        let says = format!("`{name}` has {count} {noun}");
        let faults = found.of(name, Source::new(text.unwrap_or_default()));
        if self.files.iter().all(|known| known.to_string() != faults.to_string()) {
            self.files.push(faults);
        }
        says
    }

    /// Puts each of `explanations` in the place of the faults on its line, if there are any.
    pub(crate) fn explain(&mut self, explanations: FaultList, source: &Source) {
        let line = |fault: &Fault| fault.span.map(|span| source.position(span.start).line);
        let faulty: std::collections::HashSet<_> = self.list.iter().map(line).collect();
        let mut known = explanations;
        known.list.retain(|fault| faulty.contains(&line(fault)));
        self.retain_off_lines_of(&known, source);
        self.append(known);
    }

    /// Keeps the faults that begin before `offset`.
    pub(crate) fn retain_before(&mut self, offset: usize) {
        self.list.retain(|fault| fault.span.is_none_or(|span| span.start < offset));
    }

    pub(crate) fn append(&mut self, mut other: FaultList) {
        other.list.drain(..).for_each(|fault| self.add(fault));
        self.dropped += other.dropped;
        self.files.append(&mut other.files);
    }

    /// The faults of the file called `file`, by position; faults of the whole file come first.
    pub(crate) fn of(mut self, file: &str, source: Source) -> Faults {
        self.list.sort_by_key(|fault| fault.span.map(|span| span.start));
        let file = visible(file.chars());
        Faults { file, source, list: self.list, dropped: self.dropped, files: self.files.into() }
    }
}

/// Every fault of a manifest, by position; never empty.
///
/// `Display` writes the whole report in plain text, without a newline at the end. Serialised, it is a list
/// of objects with `file`, `line`, `column`, `message` and `help`.
#[derive(Clone)]
pub struct Faults {
    file: String,
    source: Source,
    list: Vec<Fault>,
    dropped: usize,
    /// The faults of files that the text names.
    files: Box<[Faults]>,
}

impl Faults {
    /// A single fault of the file as a whole.
    pub(crate) fn of_file(file: &str, fault: Fault) -> Faults {
        Faults::of_text(file, "", fault)
    }

    /// A single fault of a text.
    pub(crate) fn of_text(file: &str, text: &str, fault: Fault) -> Faults {
        let mut faults = FaultList::default();
        faults.add(fault);
        faults.of(file, Source::new(text))
    }

    /// The faults, by position.
    pub fn list(&self) -> &[Fault] {
        &self.list
    }

    /// The faults together with those of `other`, which concern the same file.
    pub(crate) fn and(mut self, other: Faults) -> Vec<Faults> {
        if self.file != other.file || self.source.text() != other.source.text() {
            return vec![self, other];
        }
        self.list.extend(other.list);
        self.files = self.files.into_iter().chain(other.files).collect();
        self.list.sort_by_key(|fault| fault.span.map(|span| span.start));
        vec![self]
    }

    /// The text with the faults.
    pub(crate) fn text(&self) -> &str {
        self.source.text()
    }

    /// The faults in the text that this one was made from. `origin` gives a fault's span there, or what was changed there
    /// in the place of a position.
    pub(crate) fn in_original(
        mut self,
        text: &str,
        origin: impl Fn(Span) -> (Span, Option<String>),
    ) -> Faults {
        for fault in &mut self.list {
            let Some(span) = fault.span else { continue };
            match origin(span) {
                (span, None) => fault.span = Some(span),
                (_, Some(change)) => {
                    fault.span = None;
                    fault.message = format!("{change}: {}", fault.message);
                }
            }
        }
        self.list.sort_by_key(|fault| fault.span.map(|span| span.start));
        Faults { source: Source::new(text), ..self }
    }

    /// The faults of a text that was made from the options of a command: without positions, and with the options' words.
    pub(crate) fn of_options(mut self, reword: impl Fn(&str) -> String) -> Faults {
        self.list.iter_mut().for_each(|fault| fault.span = None);
        let of_files = self.files.iter_mut().flat_map(|file| &mut file.list);
        for fault in self.list.iter_mut().chain(of_files) {
            fault.message = reword(&fault.message);
            fault.help = fault.help.as_deref().map(&reword);
        }
        self
    }

    /// The position of a fault of this list; `None` for a fault of the file as a whole.
    pub fn position(&self, fault: &Fault) -> Option<Position> {
        fault.span.map(|span| self.source.position(span.start))
    }

    fn write(&self, fault: &Fault, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let message = visible(fault.message.chars());
        let help = fault.help.as_ref().map(|help| visible(help.chars()));
        let Some(span) = fault.span else {
            writeln!(f, "{}: {message}", self.file)?;
            return help.map_or(Ok(()), |help| writeln!(f, "     = {help}"));
        };
        let Position { line, column } = self.source.position(span.start);
        writeln!(f, "{}:{line}:{column}: {message}", self.file)?;
        let excerpt = self.source.excerpt(span);
        let margin = line.to_string().len().max(4);
        writeln!(f, "{line:>margin$} | {}", excerpt.text)?;
        let (indent, carets) = (" ".repeat(excerpt.indent), "^".repeat(excerpt.carets));
        writeln!(f, "{:margin$} | {indent}{carets}", "")?;
        help.map_or(Ok(()), |help| writeln!(f, "{:margin$} = {help}", ""))
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.list.iter().try_for_each(|fault| self.write(fault, f))?;
        self.files.iter().try_for_each(|file| writeln!(f, "{file}"))?;
        let total = self.list.len() + self.dropped;
        let noun = if total == 1 { "fault" } else { "faults" };
        write!(f, "{total} {noun} in {}", self.file)?;
        if self.dropped > 0 {
            write!(f, ", {} of them shown", self.list.len())?;
        }
        Ok(())
    }
}

impl fmt::Debug for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for Faults {}

impl Serialize for Faults {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(serde::Serialize)]
        struct Entry<'f> {
            file: &'f str,
            line: Option<usize>,
            column: Option<usize>,
            message: &'f str,
            help: Option<&'f str>,
        }
        let all = || std::iter::once(self).chain(&self.files);
        let count = all().map(|faults| faults.list.len()).sum();
        let mut entries = serializer.serialize_seq(Some(count))?;
        for faults in all() {
            for fault in &faults.list {
                let position = faults.position(fault);
                entries.serialize_element(&Entry {
                    file: &faults.file,
                    line: position.map(|position| position.line),
                    column: position.map(|position| position.column),
                    message: fault.message(),
                    help: fault.hint(),
                })?;
            }
        }
        entries.end()
    }
}

/// A text of the author's, shortened for messages.
pub(crate) fn shortened(text: &str) -> String {
    let short: String = text.chars().take(60).collect();
    if short.len() < text.len() { format!("{short}…") } else { short }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_shows_its_line_with_carets_and_a_hint() {
        let text = "format = 1\n[environment]\nsiggma = 0.4\n";
        let start = text.find("siggma").unwrap();
        let mut faults = FaultList::default();
        let fault = Fault::at(Span { start, end: start + 6 }, "unknown key `siggma`");
        faults.add(fault.nearest("siggma", ["rho_1", "sigma"]));
        let report = faults.of("a.toml", Source::new(text)).to_string();
        let expected = "a.toml:3:1: unknown key `siggma`\n   3 | siggma = 0.4\n     | ^^^^^^\n     \
                        = did you mean `sigma`?\n1 fault in a.toml";
        assert_eq!(report, expected);
    }

    #[test]
    fn words_far_from_every_valid_one_get_no_hint() {
        assert_eq!(nearest("sgima", ["sigma"]), Some("sigma"));
        assert_eq!(nearest("Sigma", ["sigma"]), Some("sigma"));
        assert_eq!(nearest("temperature", ["sigma", "gamma"]), None);
        assert_eq!(nearest(&"x".repeat(100_000), ["sigma"]), None);
    }

    #[test]
    fn a_part_of_a_word_points_to_it_unless_another_is_nearer() {
        assert_eq!(nearest("dqn", ["reinforce", "dueling_dqn"]), Some("dueling_dqn"));
        assert_eq!(nearest("DQN", ["dueling_dqn", "dqm"]), Some("dqm"));
        assert_eq!(nearest("d", ["epsilon_d", "delta_d"]), None);
    }

    #[test]
    fn a_flood_of_faults_is_counted_but_not_kept() {
        let mut faults = FaultList::default();
        for _ in 0..5000 {
            faults.add(Fault::whole("again"));
        }
        let report = faults.of("a.toml", Source::new("")).to_string();
        assert!(report.ends_with("5000 faults in a.toml, 1000 of them shown"));
    }
}
