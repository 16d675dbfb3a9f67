//! What can be wrong with a volume message.

/// Why a message was not taken. The receiver's state is as it was.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VolumeError {
    /// It ends before its header or its body does.
    #[error("{got} bytes are too few: {wanted} are needed")]
    TooShort {
        /// Bytes that there are.
        got: usize,
        /// Bytes that must be there.
        wanted: usize,
    },
    /// It does not begin with `WLKV`.
    #[error("a volume message begins with `WLKV`")]
    Magic,
    /// Its version is another one.
    #[error("version {0} is unknown; this build reads 1")]
    Version(u16),
    /// A header's field makes no sense.
    #[error("{field}: {why}")]
    Header {
        /// The field, as PROTOCOL.md names it.
        field: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// It is larger than the receiver takes.
    #[error("{what} of {got} is above the limit of {most}")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// How large it is.
        got: u64,
        /// The receiver's limit.
        most: u64,
    },
    /// The body does not unpack to what the header says.
    #[error("the body cannot be unpacked: {0}")]
    Compression(String),
    /// The unpacked body is not what the header announces.
    #[error("the body is wrong: {0}")]
    Body(String),
}

impl VolumeError {
    pub(crate) fn header(field: &'static str, why: impl std::fmt::Display) -> Self {
        Self::Header {
            field,
            why: why.to_string(),
        }
    }
}
