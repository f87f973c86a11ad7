//! Repairs slips of notation, so that the rest of a manifest is read as its author meant it.
//!
//! In: the text of a manifest. Out: a text that the TOML parser can read further, a fault for each repaired
//! slip, and the changes, through which positions in the new text are traced back. A manifest with a slip is
//! faulty in any case; a repair only finds its other faults. It does not know the meaning of keys, except
//! which of them take whole numbers.

use std::collections::HashMap;

use toml::de::DeTable;

use crate::key::Kind;
use crate::manifest::read::{TABLES, TOP_KEYS};
use crate::manifest::section::Section;
use crate::manifest::text::document::{Broken, broken};
use crate::manifest::text::edits::Edits;
use crate::manifest::text::fault::{Fault, FaultList, nearest};
use crate::manifest::text::source::{Source, Span};
use crate::manifest::text::written::share;

/// A text with its slips repaired.
pub(super) struct Repaired {
    pub text: String,
    pub edits: Edits,
    /// The slips whose values are now read as their author meant them.
    pub slips: FaultList,
    /// The slips whose values are erased; faults on their lines follow from them.
    pub erased: FaultList,
}

/// A date, which no key accepts, in place of a value that cannot be read.
const ERASED: &str = "0001-01-01";

/// Maximum number of slips that are repaired: a hostile file could have millions.
const MOST: usize = 1000;

/// A slip: a stretch of the text, and what to put in its place.
#[derive(Clone, Debug)]
struct Slip {
    span: Span,
    put: String,
    /// `None` if the fault is reported elsewhere.
    fault: Option<Fault>,
    /// The fault of the parser, for a value that can be erased.
    unrepaired: Option<Fault>,
    /// The line on which the parser found the slip; 0 for a header.
    found_on: usize,
}

impl Slip {
    /// The slip with its value erased.
    fn erased(self) -> Slip {
        Slip { put: ERASED.to_owned(), fault: self.unrepaired.clone(), ..self }
    }
}

/// The text with its slips repaired; `None` if it has none.
pub(super) fn repaired(text: &str) -> Option<Repaired> {
    // A slip can hide others, such as a list that is not closed.
    const ROUNDS: usize = 10;
    let mut whole: Option<Repaired> = None;
    for _ in 0..ROUNDS {
        let Some(next) = repaired_once(whole.as_ref().map_or(text, |whole| &whole.text)) else {
            break;
        };
        whole = Some(match whole {
            Some(earlier) => earlier.then(next),
            None => next,
        });
    }
    whole
}

impl Repaired {
    /// The repairs of this text and of its repaired text.
    fn then(mut self, mut next: Repaired) -> Repaired {
        next.slips.trace(&self.edits);
        next.erased.trace(&self.edits);
        self.slips.append(next.slips);
        self.erased.append(next.erased);
        self.edits.append(next.edits);
        Repaired { text: next.text, ..self }
    }
}

fn repaired_once(text: &str) -> Option<Repaired> {
    let (root, errors) = DeTable::parse_recoverable(text);
    let faults = broken(text, &errors);
    let mut slips = headers(text, root.get_ref(), &faults);
    slips.extend(values(text, &faults));
    slips.sort_by_key(|slip| slip.span);
    // The parser can find several faults in one value; the first one says enough.
    let mut end = 0;
    slips.retain(|slip| {
        let is_apart = end <= slip.span.start;
        end = if is_apart { slip.span.end } else { end };
        is_apart
    });
    if slips.is_empty() {
        return None;
    }
    // A value that is still unreadable after its repair is erased.
    let source = Source::new(text);
    let line = |slip: &Slip| source.position(slip.span.start).line;
    let left = unread(&apply(text, &slips).0);
    for slip in &mut slips {
        if slip.unrepaired.is_some() && left.iter().any(|unread| unread.line == line(slip)) {
            *slip = slip.clone().erased();
        }
    }
    let left = unread(&apply(text, &slips).0);
    slips.retain(|slip| match (&slip.unrepaired, slip.found_on) {
        (Some(_), _) => left.iter().all(|unread| unread.line != line(slip)),
        // A bracket is in its place if what follows is no part of the list.
        (None, found_on) => {
            left.iter().all(|unread| unread.line != found_on || !unread.breaks_structure)
        }
    });
    if slips.is_empty() {
        return None;
    }
    let (text, edits) = apply(text, &slips);
    let mut repaired =
        Repaired { text, edits, slips: FaultList::default(), erased: FaultList::default() };
    for slip in slips {
        let list = match slip.put.trim() == ERASED {
            true => &mut repaired.erased,
            false => &mut repaired.slips,
        };
        slip.fault.into_iter().for_each(|fault| list.add(fault));
    }
    Some(repaired)
}

fn apply(text: &str, slips: &[Slip]) -> (String, Edits) {
    Edits::replace(text, slips.iter().map(|slip| (slip.span, slip.put.as_str())))
}

/// A line that the parser cannot read.
struct Unread {
    line: usize,
    breaks_structure: bool,
}

fn unread(text: &str) -> Vec<Unread> {
    let (_, errors) = DeTable::parse_recoverable(text);
    let source = Source::new(text);
    let faults = broken(text, &errors).into_iter().filter(|fault| !fault.is_repeat);
    let unread = faults.map(|fault| Unread {
        line: source.position(fault.span.start).line,
        breaks_structure: fault.breaks_structure,
    });
    unread.collect()
}

/// The lines of a text, each with the offset at which it starts.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.split_inclusive('\n').scan(0, |end, line| {
        let start = *end;
        *end += line.len();
        Some((start, line))
    })
}

/// The name in a header of single brackets, `[name]`, and its offset in the line.
fn header(line: &str) -> Option<(&str, usize)> {
    let uncommented = line.split('#').next().unwrap_or_default().trim();
    let name = uncommented.strip_prefix('[')?.strip_suffix(']')?.trim();
    let is_name = |c: char| c.is_alphanumeric() || "_-".contains(c);
    let named = !name.is_empty() && name.chars().all(is_name);
    named.then(|| (name, line.find('[').unwrap_or_default()))
}

/// The table of double brackets that a name of a top-level table means.
fn table_of(name: &str) -> Option<&'static str> {
    let known = TOP_KEYS.into_iter().find(|key| *key == name);
    known.or_else(|| nearest(name, TOP_KEYS)).filter(|meant| TABLES.contains(meant))
}

/// Tables opened by single brackets instead of double ones; one fault for all tables of a name.
fn headers(text: &str, root: &DeTable, faults: &[Broken]) -> Vec<Slip> {
    let is_repeated = |name: &str, start: usize, line: &str| {
        let within = |fault: &&Broken| (start..start + line.len()).contains(&fault.span.start);
        faults.iter().filter(within).any(|fault| fault.is_repeat && fault.written == name)
    };
    let headers = lines(text).filter_map(|(start, line)| {
        let (name, offset) = header(line)?;
        Some((start, line, name, offset, table_of(name)?))
    });
    let headers: Vec<_> = headers.take(MOST).collect();
    let is_single = |name: &str| {
        root.get(name).is_some_and(|node| node.get_ref().is_table())
            || headers
                .iter()
                .any(|(start, line, found, ..)| *found == name && is_repeated(name, *start, line))
    };
    let mut single: HashMap<&str, bool> = HashMap::new();
    for (_, _, name, ..) in &headers {
        single.entry(name).or_insert_with(|| is_single(name));
    }
    let mut slips: Vec<Slip> = Vec::new();
    let mut seen: HashMap<&str, (usize, usize)> = HashMap::new();
    for (start, line, name, offset, _) in headers.iter().filter(|(_, _, name, ..)| single[name]) {
        let start = start + offset;
        let end = start + line[*offset..].find(']').map_or(0, |end| end + 1);
        let (_, count) = seen.entry(name).or_insert((slips.len(), 0));
        *count += 1;
        let put = format!("[[{name}]]");
        slips.push(Slip {
            span: Span { start, end },
            put,
            fault: None,
            unrepaired: None,
            found_on: 0,
        });
    }
    for (name, (first, count)) in seen {
        // A misspelt name is reported with the brackets that it needs.
        if !TABLES.contains(&name) {
            continue;
        }
        let message =
            format!("`{name}`: expected tables, each opened by [[{name}]], found [{name}]");
        let help = match count {
            1 => format!("write [[{name}]]"),
            count => format!("write [[{name}]] at the beginning of all {count} tables"),
        };
        slips[first].fault = Some(Fault::at(slips[first].span, message).help(help));
    }
    slips
}

/// Values in a notation that is not TOML, up to the first one that breaks the structure of the text.
fn values(text: &str, faults: &[Broken]) -> Vec<Slip> {
    let starts: Vec<usize> = lines(text).map(|(start, _)| start).collect();
    let mut slips: Vec<Slip> = Vec::new();
    for broken in faults.iter().filter(|fault| !fault.is_repeat) {
        let place = starts.partition_point(|start| *start <= broken.span.start).saturating_sub(1);
        let start = starts.get(place).copied().unwrap_or_default();
        let end = starts.get(place + 1).copied().unwrap_or(text.len());
        let unclosed = broken.breaks_structure.then(|| unclosed(text, &starts, place)).flatten();
        let slip = unclosed.or_else(|| value_slip(&text[start..end], start, place, broken));
        match slip {
            Some(slip) if slips.len() < MOST => slips.push(slip),
            Some(_) => break,
            None if broken.breaks_structure => break,
            None => {}
        }
    }
    slips
}

/// The slip on a line with a key and a value.
fn value_slip(line: &str, start: usize, place: usize, broken: &Broken) -> Option<Slip> {
    let found_on = place + 1;
    let written = &line[..comment(line)];
    let equals = outside(written).find(|(_, c)| *c == '=').map(|(at, _)| at);
    let from = equals.map_or(0, |at| at + 1);
    let value = written[from..].trim();
    let from = from + (written[from..].len() - written[from..].trim_start().len());
    let span = Span { start: start + from, end: start + from + value.len() };
    let key = equals.map(|at| written[..at].trim()).filter(|key| !key.is_empty());
    let unrepaired = Some(broken.fault.clone());
    if let Some((put, fault)) = meant(key, value, span, broken) {
        return Some(Slip { span, put, fault, unrepaired, found_on });
    }
    // Without its key, or in a list of several lines, a value cannot be erased.
    key.filter(|_| !broken.breaks_structure)?;
    let put = ERASED.to_owned();
    // A missing value needs a space behind the equals sign.
    let put = if value.is_empty() { format!(" {put}") } else { put };
    let fault = unrepaired.clone();
    Some(Slip { span, put, fault, unrepaired, found_on })
}

/// A list that is not closed on its line, although the line at `place` begins something else.
fn unclosed(text: &str, starts: &[usize], place: usize) -> Option<Slip> {
    let line = |at: usize| &text[starts[at]..starts.get(at + 1).copied().unwrap_or(text.len())];
    let opened = (0..place).rev().find(|at| !line(*at)[..comment(line(*at))].trim().is_empty())?;
    let written = line(opened)[..comment(line(opened))].trim_end();
    let equals = outside(written).find(|(_, c)| *c == '=').map(|(at, _)| at)?;
    let (key, value) = (written[..equals].trim(), written[equals + 1..].trim());
    let count = |bracket| outside(value).filter(|(_, c)| *c == bracket).count();
    let missing = count('[').checked_sub(count(']')).filter(|missing| *missing > 0)?;
    let put = "]".repeat(missing);
    let end = starts[opened] + written.len();
    let message = format!("`{key}`: the list is not closed");
    let span = Span { start: end - value.len(), end };
    let fault = Fault::at(span, message).help(format!("write {key} = {value}{put}"));
    let span = Span { start: end, end };
    Some(Slip { span, put, fault: Some(fault), unrepaired: None, found_on: place + 1 })
}

/// The value in TOML that a slip means, and the fault, unless the value itself is one.
fn meant(
    key: Option<&str>,
    value: &str,
    span: Span,
    broken: &Broken,
) -> Option<(String, Option<Fault>)> {
    let named = key.map_or(String::new(), |key| format!("`{key}`: "));
    let write = |put: &str| match key {
        Some(key) => format!("write {key} = {put}"),
        None => format!("write {put}"),
    };
    let fault = |says: &str, put: String| {
        let fault = Fault::at(span, format!("{named}{says}")).help(write(&put));
        Some((put, Some(fault)))
    };
    if let Some(straight) = straight_quotes(value) {
        let put = key.and_then(|_| list(&straight)).unwrap_or(straight);
        return fault("curly quotes; TOML has straight quotes", put);
    }
    let key = key?;
    if value.starts_with('{') {
        let put = decimal_points(value).filter(|_| broken.breaks_structure)?;
        return fault(DECIMAL_COMMA, put);
    }
    if let Some(inner) = value.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
        return fault("parentheses; lists have square brackets", format!("[{}]", quoted(inner)));
    }
    if let Some(items) = value.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
        let items: Vec<Vec<&str>> =
            items.split(',').map(|item| item.split_whitespace().collect()).collect();
        if items.iter().any(|item| is_grouped(item)) {
            let whole: Vec<String> = items.iter().map(|item| item.concat()).collect();
            return fault("spaces within a number", format!("[{}]", whole.join(", ")));
        }
        let is_number = |word: &&str| word.parse::<f64>().is_ok();
        if let [item] = &items[..]
            && item.len() > 1
            && item.iter().all(is_number)
        {
            let list = format!("[{}]", item.join(", "));
            return fault("the values of a list have commas between them", list);
        }
        let words = |word: &str| items.iter().any(|item| item[..] == [word]);
        if ["True", "TRUE", "False", "FALSE"].into_iter().any(words) {
            let lower: Vec<String> =
                items.iter().map(|item| item.concat().to_lowercase()).collect();
            let list = format!("[{}]", lower.join(", "));
            return fault("true and false have lower-case letters", list);
        }
    }
    if value.starts_with('[') && outside(value).any(|(_, c)| c == ';') {
        let put = decimal_points(&value.replace(';', ", ;")).unwrap_or(value.to_owned());
        let put = put.replace(", ;", ",").replace(';', ",");
        return fault("semicolons; the values of a list have commas between them", put);
    }
    let commas = commas(value);
    if let ([last], Some(rest)) = (&commas[..], value.strip_suffix(','))
        && *last == rest.len()
        && !rest.trim().is_empty()
    {
        return fault("a comma after the value", rest.trim_end().to_owned());
    }
    if !commas.is_empty() && !broken.breaks_structure {
        let thousands: Vec<&str> = value.split(',').collect();
        if takes_whole_numbers(key) && is_grouped(&thousands) {
            return fault("commas within a number", thousands.concat());
        }
        return match decimal_points(value).filter(|_| !takes_whole_numbers(key)) {
            Some(put) if put.parse::<f64>().is_ok() => fault(DECIMAL_COMMA, put),
            Some(put) if list(&put).is_some() => {
                fault("decimal commas in a list without brackets", list(&put)?)
            }
            _ => fault("a list without brackets", list(value)?),
        };
    }
    if let Some(percent) = value.strip_suffix('%').and_then(|number| number.trim().parse().ok()) {
        return fault("a percentage; shares are written as fractions", share(percent));
    }
    if let Some(put) = with_all_digits(value) {
        return fault("a number needs a digit on both sides of its point", put);
    }
    let numbers: Vec<&str> = value.split_whitespace().collect();
    if is_grouped(&numbers) {
        return fault("spaces within a number", numbers.concat());
    }
    if numbers.len() > 1 && numbers.iter().all(|number| number.parse::<f64>().is_ok()) {
        return fault("a list without brackets and commas", format!("[{}]", numbers.join(", ")));
    }
    if takes(key, |kind| kind == Kind::Flag) {
        match value {
            "yes" | "on" => return fault("a flag is true or false", "true".to_owned()),
            "no" | "off" => return fault("a flag is true or false", "false".to_owned()),
            _ => {}
        }
    }
    if let word @ ("True" | "TRUE" | "False" | "FALSE") = value {
        let word = word.to_lowercase();
        // A key of another kind takes neither.
        let is_of_another = takes(key, |kind| kind != Kind::Flag);
        return match is_of_another {
            true => Some((word, None)),
            false => fault("true and false have lower-case letters", word),
        };
    }
    let is_word = |c: char| c.is_alphanumeric() || "_-.".contains(c);
    let starts = value.starts_with(char::is_alphabetic) && value.chars().all(is_word);
    starts.then(|| (format!("\"{value}\""), Some(broken.fault.clone())))
}

/// Whether these are the parts of one number with spaces between its thousands.
fn is_grouped(parts: &[&str]) -> bool {
    let [first, rest @ ..] = parts else { return false };
    let are_digits = |part: &&str| part.bytes().all(|byte| byte.is_ascii_digit());
    let is_begun = (1..=3).contains(&first.len()) && !first.starts_with('0');
    let is_group = |part: &&str| part.len() == 3 && are_digits(part);
    !rest.is_empty() && is_begun && are_digits(first) && rest.iter().all(is_group)
}

/// Lists that TOML can read, but whose author probably wrote decimal commas, as in `[0,4, 0,6]`: some commas
/// stand between digits, and some before a space. One fault for each; they are slips only if something is
/// wrong with the values.
pub(super) fn decimal_lists(text: &str) -> FaultList {
    let mut found = FaultList::default();
    for (start, line) in lines(text) {
        let written = &line[..comment(line)];
        let Some((key, value)) = written.split_once('=') else { continue };
        let (key, from) = (key.trim(), written.len() - value.trim_start().len());
        let value = value.trim();
        // One comma between digits separates two values, as in `[0,5]`.
        let is_list = value.starts_with('[') && value.matches(',').count() > 1;
        let put = decimal_points(value).filter(|_| is_list);
        let Some(put) = put.filter(|_| !takes_whole_numbers(key)) else { continue };
        let items = put.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let is_number = |item: &str| item.trim().is_empty() || item.trim().parse::<f64>().is_ok();
        if !items.is_some_and(|items| items.split(',').all(is_number)) {
            continue;
        }
        let span = Span { start: start + from, end: start + from + value.len() };
        let fault = Fault::at(span, format!("`{key}`: {DECIMAL_COMMA}"));
        found.add(fault.help(format!("write {key} = {put}")));
    }
    found
}

/// The slip in a value that an option gives to a key; `None` if it is TOML or a text.
pub(super) fn slip(key: &str, value: &str) -> Option<Fault> {
    if value.starts_with(char::is_alphabetic) {
        return None;
    }
    let text = format!("{key} = {value}\n");
    let slips = repaired(&text)?.slips;
    let first = slips.iter().next()?;
    let fault = Fault::whole(first.message());
    Some(first.hint().map_or(fault.clone(), |hint| fault.help(hint)))
}

const DECIMAL_COMMA: &str = "a decimal comma; numbers have a decimal point";

/// The characters outside of straight quotes, with their offsets.
fn outside(text: &str) -> impl Iterator<Item = (usize, char)> {
    let mut quote = None;
    text.char_indices().filter(move |(_, c)| match quote {
        Some(open) => {
            if *c == open {
                quote = None;
            }
            false
        }
        None => {
            if matches!(c, '"' | '\'') {
                quote = Some(*c);
            }
            true
        }
    })
}

/// The offset of a line's comment, or of its end.
fn comment(line: &str) -> usize {
    outside(line).find(|(_, c)| *c == '#').map_or(line.trim_end().len(), |(at, _)| at)
}

/// The offsets of commas outside of quotes and brackets.
fn commas(value: &str) -> Vec<usize> {
    let mut depth = 0_usize;
    let outer = outside(value).filter(|(_, c)| {
        match c {
            '[' | '{' => depth += 1,
            ']' | '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        *c == ',' && depth == 0
    });
    outer.map(|(at, _)| at).collect()
}

/// A list of the values that commas separate; `None` without a comma.
fn list(value: &str) -> Option<String> {
    (!commas(value).is_empty()).then(|| format!("[{}]", quoted(value)))
}

/// Values separated by commas, with quotes around words.
fn quoted(value: &str) -> String {
    let (mut items, mut start) = (Vec::new(), 0);
    for end in commas(value).into_iter().chain([value.len()]) {
        items.push(value[start..end].trim());
        start = end + 1;
    }
    let quote = |item: &str| match item {
        "true" | "false" | "inf" | "nan" => item.to_owned(),
        _ if item.starts_with(char::is_alphabetic) => format!("\"{item}\""),
        _ => item.to_owned(),
    };
    let items = items.into_iter().filter(|item| !item.is_empty());
    items.map(quote).collect::<Vec<_>>().join(", ")
}

/// The value with straight quotes; `None` if it has no curly quotes outside of straight ones.
fn straight_quotes(value: &str) -> Option<String> {
    // A single curly quote within double ones is an apostrophe.
    let is_double = |c: char| "“”„‟«»".contains(c);
    let doubles = value.contains(is_double);
    let is_curly = |c: char| is_double(c) || (!doubles && "‘’‚‛".contains(c));
    // A straight quote that is not closed is closed by a curly one, or is an apostrophe.
    let is_open = outside(&format!("{value}#")).last().is_none_or(|(_, c)| c != '#');
    let all: Vec<(usize, char)> =
        if is_open { value.char_indices().collect() } else { outside(value).collect() };
    let curly = all.into_iter().filter(|(_, c)| is_curly(*c));
    let seen: Vec<usize> = curly.map(|(at, _)| at).collect();
    let straight = |(at, c)| if seen.binary_search(&at).is_ok() { '"' } else { c };
    (!seen.is_empty()).then(|| value.char_indices().map(straight).collect())
}

/// The value with points for commas between digits, unless all of several commas are between digits.
fn decimal_points(value: &str) -> Option<String> {
    let bytes = value.as_bytes();
    let is_digit =
        |at: Option<usize>| at.and_then(|at| bytes.get(at)).is_some_and(u8::is_ascii_digit);
    let all = bytes.iter().filter(|byte| **byte == b',').count();
    let within = |at: usize| is_digit(at.checked_sub(1)) && is_digit(Some(at + 1));
    let decimal: Vec<usize> =
        value.match_indices(',').map(|(at, _)| at).filter(|at| within(*at)).collect();
    let is_decimal = !decimal.is_empty() && (decimal.len() < all || all == 1);
    let point = |(at, c)| if decimal.binary_search(&at).is_ok() { '.' } else { c };
    is_decimal.then(|| value.char_indices().map(point).collect())
}

/// The number with the digit that it lacks before or behind its point.
fn with_all_digits(value: &str) -> Option<String> {
    let whole = match value.strip_prefix('.') {
        Some(rest) => format!("0.{rest}"),
        None => format!("{}.0", value.strip_suffix('.')?),
    };
    whole.parse::<f64>().is_ok().then_some(whole)
}

/// Whether the key takes whole numbers or lists of them.
fn takes_whole_numbers(key: &str) -> bool {
    let is_whole =
        |kind| matches!(kind, Kind::Integer { .. } | Kind::Widths { .. } | Kind::Counts { .. });
    ["seed", "seeds", "reporting_seeds"].contains(&key) || takes(key, is_whole)
}

/// Whether a key of this name takes values of such a kind.
fn takes(key: &str, is_such: impl Fn(Kind) -> bool) -> bool {
    let name = key.rsplit('.').next().unwrap_or(key).trim();
    let of = |section: Section| section.find(name).is_some_and(|(_, key)| is_such(key.kind));
    Section::all().into_iter().any(of)
}
