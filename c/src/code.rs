//! Return codes of the C interface.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
#[allow(missing_docs, reason = "cdcr.h says it")]
pub enum Code {
    Ok = 0,
    Nothing = 1,
    Argument = -1,
    Handle = -2,
    Layout = -3,
    NoDaemon = -4,
    Silent = -5,
    Access = -6,
    Full = -7,
    Link = -8,
    Refused = -9,
    Unconfirmed = -10,
    Panic = -11,
}

// Success without further information.
impl From<()> for Code {
    fn from((): ()) -> Self {
        Self::Ok
    }
}

/// Every code with its name in `cdcr.h`.
pub const CODES: [(&str, Code); 13] = [
    ("CDCR_OK", Code::Ok),
    ("CDCR_NOTHING", Code::Nothing),
    ("CDCR_ERROR_ARGUMENT", Code::Argument),
    ("CDCR_ERROR_HANDLE", Code::Handle),
    ("CDCR_ERROR_LAYOUT", Code::Layout),
    ("CDCR_ERROR_NO_DAEMON", Code::NoDaemon),
    ("CDCR_ERROR_SILENT", Code::Silent),
    ("CDCR_ERROR_ACCESS", Code::Access),
    ("CDCR_ERROR_FULL", Code::Full),
    ("CDCR_ERROR_LINK", Code::Link),
    ("CDCR_ERROR_REFUSED", Code::Refused),
    ("CDCR_ERROR_UNCONFIRMED", Code::Unconfirmed),
    ("CDCR_ERROR_PANIC", Code::Panic),
];
