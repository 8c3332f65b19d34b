//! The ends of channels on the host: where each leads.
//!
//! Takt takes part in a channel for the sake of tools and tests that run beside it. They know no
//! channels, but sockets and files; so an end on the host has one more key than others, which says
//! by which of the two it is reached.

use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use toml::Spanned;

use super::channels::{Channel, Owner};
use super::diagnostic::Diagnostic;
use super::images::SOCKET_PATH_MAX;
use super::images::{self, Image};
use super::raw::{self, Keys};

/// Where an end on the host leads. Paths are absolute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostPort {
    /// A socket that Takt makes and listens on. The path has at most 107 bytes.
    Socket(PathBuf),
    /// A file: appended to by a destination; of a source, a readable file when this was loaded.
    File(PathBuf),
}

impl HostPort {
    /// The path of either.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            HostPort::Socket(path) | HostPort::File(path) => path,
        }
    }
}

/// Checks the keys of a channel that are about its end on the host.
pub fn check(
    channel: &Channel,
    raw: &raw::Channel,
    folder: &Path,
) -> Result<Option<HostPort>, Diagnostic> {
    let end = channel.ends(raw).find(|(end, _)| end.owner == Owner::Host);
    let (text, end) = match (&raw.host_socket, &raw.host_file, end) {
        (None, None, None) => return Ok(None),
        (None, None, Some((_, end))) => {
            let found = "the channel does not say where its end on the host leads";
            let allowed = "`host_socket = \"levels.sock\"` or `host_file = \"levels.records\"`";
            return Err(Diagnostic::new(end.span(), found, allowed));
        }
        (Some(socket), Some(file), _) => {
            let found = "the end on the host is given a socket and a file";
            return Err(Diagnostic::new(file.span(), found, "`host_socket` or `host_file`")
                .and(socket.span(), "the socket"));
        }
        (Some(text), None, end) | (None, Some(text), end) => (text, end),
    };
    if end.is_none() {
        let key = if raw.host_file.is_some() { "host_file" } else { "host_socket" };
        let found = format!("`{key}` for a channel without an end on the host");
        let allowed = "only with \"host:PORT\" as the source or as a destination";
        return Err(Diagnostic::new(text.span(), found, allowed));
    }
    let path = images::resolve(folder, text)?.path;
    if raw.host_file.is_some() {
        return Ok(Some(HostPort::File(path)));
    }
    let length = path.as_os_str().as_bytes().len();
    if length > SOCKET_PATH_MAX {
        let found = format!("from the root the path of the socket has {length} bytes");
        let allowed = format!("at most {SOCKET_PATH_MAX}, which is the kernel's limit");
        return Err(Diagnostic::new(text.span(), found, allowed));
    }
    Ok(Some(HostPort::Socket(path)))
}

/// Checks that the files of sources can be read.
pub fn check_files(
    tables: &[Spanned<Keys<raw::Channel>>],
    channels: &[Channel],
) -> Result<(), Diagnostic> {
    for (table, channel) in tables.iter().zip(channels) {
        if let (Some(path), Some(key)) = (channel.source_file(), key(&table.get_ref().0)) {
            images::check(&Image { span: key.span(), path: path.to_owned() })?;
        }
    }
    Ok(())
}

/// The key that says where the end leads.
pub fn key(raw: &raw::Channel) -> Option<&Spanned<String>> {
    raw.host_socket.as_ref().or(raw.host_file.as_ref())
}

impl Channel {
    /// The file that Takt sends from, if that is what this channel's source does.
    #[must_use]
    pub fn source_file(&self) -> Option<&Path> {
        match &self.host {
            Some(HostPort::File(path)) if self.source.owner == Owner::Host => Some(path),
            _ => None,
        }
    }

    /// The file that Takt appends to, if that is what a destination of this channel does.
    #[must_use]
    pub fn destination_file(&self) -> Option<&Path> {
        match &self.host {
            Some(HostPort::File(path)) if self.source.owner != Owner::Host => Some(path),
            _ => None,
        }
    }
}
