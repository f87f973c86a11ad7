//! The names of keys as papers write them: symbols and quantities.

use crate::env::{SYMBOLS, Symbol};
use crate::job::{short_beside, short_name};

/// The discount of learners, which papers write as a symbol.
const DISCOUNT: Symbol = Symbol { key: "gamma", symbol: "γ", quantity: Some("discount") };

/// The keys that papers write as symbols. Symbols that begin with another symbol come first.
fn symbols() -> impl Iterator<Item = Symbol> {
    SYMBOLS.iter().copied().chain([DISCOUNT])
}

/// A dotted name with its last part as a symbol, if it has one.
pub fn key(dotted: &str) -> String {
    let (section, key) = match dotted.rsplit_once('.') {
        Some((section, key)) => (Some(section), key),
        None => (None, dotted),
    };
    let symbol = symbols().find(|symbol| symbol.key == key);
    match (section, symbol) {
        (_, None) => dotted.to_owned(),
        (None, Some(Symbol { symbol, .. })) => symbol.to_owned(),
        (Some(section), Some(Symbol { symbol, .. })) => format!("{section}.{symbol}"),
    }
}

/// The last part of a dotted name, as a symbol if it has one.
pub fn short(dotted: &str) -> String {
    short_name(&key(dotted)).to_owned()
}

/// The last parts of dotted names that stand beside each other, as symbols; dotted where last parts are equal.
pub fn beside<const N: usize>(dotted: [&str; N]) -> [String; N] {
    dotted.map(|name| key(short_beside(name, dotted)))
}

/// The name of a parameter's quantity, as axes have it.
pub fn quantity(dotted: &str) -> String {
    let short = short(dotted);
    match symbols().find(|one| one.symbol == short).and_then(|one| one.quantity) {
        Some(quantity) => format!("{quantity} {short}"),
        None => short.replace('_', " "),
    }
}
