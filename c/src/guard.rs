use core::ffi::{c_char, c_int};
use std::cell::RefCell;
use std::ffi::CString;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::code::Code;
use crate::failure::Failure;

thread_local! {
    /// Text of the last error of this thread.
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Executes a C function: catches panics, and converts an error to its code and the text of the last error.
pub(crate) fn call<T: Into<Code>>(work: impl FnOnce() -> Result<T, Failure>) -> c_int {
    // State left inconsistent by a panic is behind a handle; the caller then closes it.
    let done = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let words = panic.downcast_ref::<String>().map(String::as_str);
        let words = words.or_else(|| panic.downcast_ref::<&str>().copied());
        let words = words.unwrap_or("no words");
        Err(Failure::new(
            Code::Panic,
            format!("the library has a fault: {words}. Close the handle and report this text"),
        ))
    });
    match done {
        Ok(done) => done.into() as c_int,
        Err(failure) => {
            set_last_error(&failure.text);
            failure.code as c_int
        }
    }
}

/// Sets the text of the last error.
pub(crate) fn set_last_error(text: &str) {
    // Texts of this library contain no zero; a text from outside would end there.
    let text = text.split('\0').next().unwrap_or_default();
    let text = CString::new(text).unwrap_or_default();
    // During the end of a thread the text is no longer available.
    let _ = LAST_ERROR.try_with(|last| {
        if let Ok(mut last) = last.try_borrow_mut() {
            *last = text;
        }
    });
}

/// The text of the last error. The pointer is valid until the next error of this thread.
pub(crate) fn last_error() -> *const c_char {
    let last = LAST_ERROR.try_with(|last| last.try_borrow().map(|text| text.as_ptr()));
    match last {
        Ok(Ok(text)) => text,
        _ => c"the thread ends".as_ptr(),
    }
}

#[cfg(test)]
fn last_text() -> String {
    LAST_ERROR.with(|last| last.borrow().to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_code_and_a_text() {
        assert_eq!(call(|| Ok(Code::Nothing)), 1);
        assert_eq!(last_text(), "", "no error yet");
        let number = 7;
        assert_eq!(
            call::<()>(|| panic!("seven is {number}")),
            Code::Panic as c_int
        );
        assert!(
            last_text().contains("seven is 7. Close the handle"),
            "{}",
            last_text()
        );
        assert_eq!(call::<()>(|| panic!("plain")), Code::Panic as c_int);
        assert!(last_text().contains("plain"), "{}", last_text());
        assert_eq!(
            call::<()>(|| std::panic::panic_any(5_u8)),
            Code::Panic as c_int
        );
        // A success keeps the text of the last error.
        assert_eq!(call(|| Ok(Code::Ok)), 0);
        assert!(last_text().contains("no words"), "{}", last_text());
    }

    #[test]
    fn a_text_ends_at_a_zero_and_belongs_to_its_thread() {
        assert_eq!(call::<()>(|| Err(Failure::argument("a\0b"))), -1);
        assert_eq!(last_text(), "a");
        let other = std::thread::spawn(last_text).join().expect("it reads");
        assert_eq!(other, "");
    }
}
