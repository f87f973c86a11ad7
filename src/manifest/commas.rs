//! Decimal commas, as in `0,4`: TOML ends a value at a comma, or reads a list of two.

use crate::key::Kind;
use crate::manifest::section::Section;
use crate::text::{Fault, FaultList, Span};

/// What a decimal comma is reported as.
const DECIMAL_COMMA: &str = "a decimal comma; numbers have a decimal point";

/// The values of a text whose author probably wrote decimal commas, by position, each with the value in TOML. Lists such
/// as `[0,4, 0,6]` are valid TOML: they are faults only if something is wrong with the values.
pub(super) fn decimal_commas(text: &str) -> FaultList {
    let mut found = FaultList::default();
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let written = line.split('#').next().unwrap_or_default();
        if let Some((key, value)) = written.split_once('=')
            && let Some(fault) = decimal_comma(key, value.trim())
        {
            let from = start + written.len() - value.trim_start().len();
            let span = Span { start: from, end: from + value.trim().len() };
            found.add(fault.at_span(span));
        }
        start += line.len();
    }
    found
}

/// The fault of a value with decimal commas that belongs to a key.
pub(super) fn decimal_comma(key: &str, value: &str) -> Option<Fault> {
    let key = key.trim();
    let value = value.strip_suffix(',').unwrap_or(value).trim_end();
    let put = with_points(value).filter(|_| !takes_whole_numbers(key))?;
    let fault = Fault::whole(format!("`{key}`: {DECIMAL_COMMA}"));
    if value.starts_with('{') {
        let is_toml = |value: &str| toml::from_str::<toml::Table>(&format!("x = {value}")).is_ok();
        let is_meant = !is_toml(value) && is_toml(&put);
        return is_meant.then(|| fault.help(format!("write {key} = {put}")));
    }
    let is_number = |item: &str| item.trim().is_empty() || item.trim().parse::<f64>().is_ok();
    if let Some(items) = put.strip_prefix('[') {
        // One comma between digits separates two values, as in `[0,5]`.
        let items = items.strip_suffix(']').filter(|_| value.matches(',').count() > 1)?;
        let are_numbers = items.split(',').all(is_number);
        return are_numbers.then(|| fault.help(format!("write {key} = {put}")));
    }
    let help = match value.split_once(',') {
        _ if !put.split(',').all(is_number) => return None,
        _ if put.contains(',') => format!("write {key} = [{put}]"),
        // As in 1,000 for a thousand.
        Some((whole, "000")) => format!("write {key} = {whole}000, or {key} = {put}"),
        _ => format!("write {key} = {put}"),
    };
    Some(fault.help(help))
}

/// The value with points for commas between digits, unless all of several commas are between digits.
fn with_points(value: &str) -> Option<String> {
    let characters: Vec<char> = value.chars().collect();
    let is_digit =
        |at: Option<usize>| at.and_then(|at| characters.get(at)).is_some_and(char::is_ascii_digit);
    let is_decimal =
        |at: usize| characters[at] == ',' && is_digit(at.checked_sub(1)) && is_digit(Some(at + 1));
    let decimal = (0..characters.len()).filter(|at| is_decimal(*at)).count();
    let all = characters.iter().filter(|c| **c == ',').count();
    let point = |(at, c): (usize, &char)| if is_decimal(at) { '.' } else { *c };
    let is_probable = decimal > 0 && (decimal < all || all == 1);
    is_probable.then(|| characters.iter().enumerate().map(point).collect())
}

/// Whether the key takes whole numbers or lists of them.
fn takes_whole_numbers(key: &str) -> bool {
    let is_whole =
        |kind| matches!(kind, Kind::Integer { .. } | Kind::Widths { .. } | Kind::Counts { .. });
    let name = key.rsplit('.').next().unwrap_or(key).trim();
    let has_whole_key =
        |section: Section| section.find(name).is_some_and(|(_, key)| is_whole(key.kind));
    ["seed", "seeds", "reporting_seeds"].contains(&key)
        || Section::all().into_iter().any(has_whole_key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimal_commas_get_their_values_in_toml() {
        for (key, value, expected) in [
            ("sigma", "0,4", Some("write sigma = 0.4")),
            ("sigma", "0,1,", Some("write sigma = 0.1")),
            ("sigma", "0,4, 0,8", Some("write sigma = [0.4, 0.8]")),
            ("sigma", "[0,4, 0,6]", Some("write sigma = [0.4, 0.6]")),
            ("sigma", "[0,5]", None),
            ("sigma", "0.4", None),
            ("message_cost", "1,000", Some("write message_cost = 1000, or message_cost = 1.000")),
            ("seeds", "1,5", None),
            ("environment", "{ sigma = 0,4 }", Some("write environment = { sigma = 0.4 }")),
            ("environment", "{ sigma = [0,5] }", None),
        ] {
            let found = decimal_comma(key, value);
            assert_eq!(found.as_ref().and_then(Fault::hint), expected, "{key} = {value}");
        }
    }
}
