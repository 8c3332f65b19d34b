//! What can go wrong, and which exit status tells of it.

use std::io;
use std::path::PathBuf;

use takt_plan::FileError;
use takt_protocol::Refusal;
use thiserror::Error;

/// Exit status of Takt's refusal.
pub const REFUSED: u8 = 1;
/// Exit status of wrong usage.
pub const USAGE: u8 = 2;
/// Exit status if no Takt answers.
pub const NO_TAKT: u8 = 3;

/// Why a command was not carried out.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The partition file is wrong.
    #[error(transparent)]
    File(#[from] FileError),
    /// The partition file asks for no control socket.
    #[error(
        "{} has no `control` in [system], so its Takt has no control socket; \
         if it was started with --control PATH, give that PATH instead",
        .0.display()
    )]
    NoControl(PathBuf),
    /// The arguments do not fit the partition file, or what runs.
    #[error("{0}")]
    Usage(String),
    /// The image cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// No Takt listens there.
    #[error("no Takt at {}: {source}; {}", socket.display(), remedy(source))]
    NoTakt {
        /// The socket.
        socket: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// The connection has ended, or nothing came in time.
    #[error("Takt does not answer: {0}")]
    Lost(io::Error),
    /// The answer is none of this version.
    #[error("what answers there is no Takt of this version: {0}")]
    NotUnderstood(String),
    /// Takt refuses.
    #[error("refused: {}", crate::plain(&.0.text))]
    Refused(Refusal),
    /// The answer could not be printed.
    #[error("cannot print: {0}")]
    Output(io::Error),
    /// The terminal cannot show a screen.
    #[error("cannot use the terminal: {0}")]
    Terminal(io::Error),
}

impl From<Refusal> for ClientError {
    fn from(refusal: Refusal) -> ClientError {
        ClientError::Refused(refusal)
    }
}

impl ClientError {
    /// Exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            ClientError::File(_) | ClientError::NoControl(_) | ClientError::Image { .. } => USAGE,
            ClientError::Usage(_) | ClientError::Output(_) | ClientError::Terminal(_) => USAGE,
            ClientError::NoTakt { .. } | ClientError::Lost(_) | ClientError::NotUnderstood(_) => {
                NO_TAKT
            }
            ClientError::Refused(_) => REFUSED,
        }
    }
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "is it running, and does its file have the key `control`?",
        io::ErrorKind::ConnectionRefused => "it has ended without removing its socket",
        io::ErrorKind::PermissionDenied => {
            "the socket belongs to the user who started Takt, and to the group `viewers` of its file"
        }
        _ => "is it Takt's control socket?",
    }
}
