//! Text without characters that change the display of the text around them.

/// The text with [`hidden`] characters escaped, so that names cannot move the cursor or reverse the line.
pub fn printable(text: &str) -> String {
    let escape = |c: char| match hidden(c) {
        Some(_) => c.escape_default().collect(),
        None => vec![c],
    };
    text.chars().flat_map(escape).collect()
}

/// The kind of characters that turn the text around them.
pub const DIRECTION: &str = "a text-direction mark";

/// The kind of a character that is invisible or changes the display of the text around it; `None` for all
/// other characters.
pub fn hidden(character: char) -> Option<&'static str> {
    match character {
        c if c.is_control() => Some("a control character"),
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
            Some(DIRECTION)
        }
        '\u{2028}' | '\u{2029}' => Some("a line separator"),
        '\u{ad}' | '\u{34f}' | '\u{180b}'..='\u{180e}' | '\u{200b}'..='\u{200d}' => {
            Some("a zero-width character")
        }
        '\u{2060}'..='\u{2065}' | '\u{206a}'..='\u{206f}' | '\u{feff}' => {
            Some("a zero-width character")
        }
        '\u{fff0}'..='\u{fffb}' | '\u{e0000}'..='\u{e0fff}' => Some("a zero-width character"),
        '\u{115f}' | '\u{1160}' | '\u{3164}' | '\u{ffa0}' => Some("an invisible filler"),
        _ => None,
    }
}

/// A text in quotes. TOML and JSON escape alike, except DEL, which only TOML requires to be escaped.
pub fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string().replace('\u{7f}', "\\u007f")
}
