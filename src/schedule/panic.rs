//! Panics inside a job, turned into text.

use std::cell::RefCell;
use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// What the panic of this thread said; `None` where panics are not captured.
    static SAID: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Makes [`catch`] hear where a panic happened. Panics outside [`catch`] are shown as before.
pub(super) fn capture() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let captured = SAID
                .with_borrow_mut(|said| said.as_mut().map(|text| *text = describe(info)).is_some());
            if !captured {
                before(info);
            }
        }));
    });
}

fn describe(info: &PanicHookInfo<'_>) -> String {
    let message = info.payload_as_str().unwrap_or("a panic without a message");
    match info.location() {
        Some(place) => format!("{message} ({}:{})", place.file(), place.line()),
        None => message.to_owned(),
    }
}

/// Runs `work`; if it panics, returns what the panic said and where it was.
///
/// The work shares nothing that a panic could leave half changed: a training owns all its state.
pub(super) fn catch<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    SAID.set(Some(String::new()));
    let result = panic::catch_unwind(AssertUnwindSafe(work));
    let said = SAID.take().unwrap_or_default();
    result.map_err(|_| said)
}
