//! Conversion of panics in a job to text.

use std::cell::RefCell;
use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// The message of this thread's panic; `None` while panics are not captured.
    static SAID: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Installs the hook with which [`catch`] records where a panic happened. Other panics are shown as before.
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

/// Runs `work`; if it panics, returns the message and the location of the panic.
///
/// A panic leaves no shared state inconsistent, because a training owns all its state.
pub(super) fn catch<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    SAID.set(Some(String::new()));
    let result = panic::catch_unwind(AssertUnwindSafe(work));
    let said = SAID.take().unwrap_or_default();
    result.map_err(|_| said)
}
