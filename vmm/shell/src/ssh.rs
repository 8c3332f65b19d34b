//! How ssh and scp are started: with a way to the guest, and a name for it.
//!
//! The way is the option `ProxyCommand`, which ssh has a shell execute after it has put in what stands for a `%` and a
//! letter. Only the path of this program is not of a known form, so that is quoted for both.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use takt_plan::Cid;

use crate::ShellError;
use crate::paths::Place;

/// Where sshd listens.
const PORT: u32 = 22;

/// A Linux that can be reached.
#[derive(Debug, PartialEq, Eq)]
pub struct Guest {
    pub partition: String,
    /// The name of the file's system.
    pub system: String,
    pub cid: Cid,
}

impl Guest {
    /// Becomes a shell in the guest, or a command. Returns only if that fails.
    pub fn shell(&self, user: Option<&str>, words: &[OsString]) -> ShellError {
        let host = self.at(user);
        let words = [OsString::from("--"), host].into_iter().chain(words.iter().cloned());
        self.become_client("ssh", words)
    }

    /// Becomes scp. Each of the paths is one of this machine, or one in the guest. Returns only if that fails.
    pub fn copy(&self, user: Option<&str>, paths: &[Place]) -> ShellError {
        let word = |path: &Place| match path {
            Place::Here(path) => path.clone(),
            Place::There(path) => {
                let mut word = self.at(user);
                word.push(":");
                word.push(path);
                word
            }
        };
        // Folders too, as it does no harm to files.
        let options = ["-r", "--"].map(OsString::from);
        self.become_client("scp", options.into_iter().chain(paths.iter().map(word)))
    }

    fn become_client(
        &self,
        program: &'static str,
        words: impl Iterator<Item = OsString>,
    ) -> ShellError {
        let own = match std::env::current_exe() {
            Ok(own) => own,
            Err(error) => return ShellError::Own(error),
        };
        let options = self.options(&own.with_file_name("takt-shell"));
        let source = Command::new(program).args(options).args(words).exec();
        ShellError::Client { program, source }
    }

    /// What ssh calls it: in its files of keys, and in those of settings.
    fn name(&self) -> String {
        format!("{}.{}.takt", self.partition, self.system)
    }

    fn at(&self, user: Option<&str>) -> OsString {
        match user {
            Some(user) => format!("{user}@{}", self.name()).into(),
            None => self.name().into(),
        }
    }

    fn options(&self, connector: &Path) -> Vec<OsString> {
        let mut way = OsString::from("ProxyCommand=");
        way.push(quoted(connector.as_os_str()));
        way.push(format!(" connect {} {PORT}", self.cid.0));
        let alias = format!("HostKeyAlias={}", self.name());
        // A guest that has restarted knows nothing of a connection, and says so when it is asked.
        let rest = ["StrictHostKeyChecking=accept-new", "ServerAliveInterval=10"];
        let options = [way, alias.into()].into_iter().chain(rest.map(OsString::from));
        options.flat_map(|option| [OsString::from("-o"), option]).collect()
    }
}

/// One word for a shell, in a text in which `%` is written twice.
fn quoted(path: &OsStr) -> OsString {
    let mut word = vec![b'\''];
    for byte in path.as_bytes() {
        match byte {
            b'\'' => word.extend_from_slice(br"'\''"),
            b'%' => word.extend_from_slice(b"%%"),
            other => word.push(*other),
        }
    }
    word.push(b'\'');
    OsString::from_vec(word)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guest() -> Guest {
        Guest { partition: "hmi".into(), system: "press-7".into(), cid: Cid(3) }
    }

    #[test]
    fn ssh_is_told_the_way_the_name_and_to_take_a_new_key() {
        let options = guest().options(Path::new("/opt/takt/takt-shell"));
        assert_eq!(
            options,
            [
                "-o",
                "ProxyCommand='/opt/takt/takt-shell' connect 3 22",
                "-o",
                "HostKeyAlias=hmi.press-7.takt",
                "-o",
                "StrictHostKeyChecking=accept-new",
                "-o",
                "ServerAliveInterval=10",
            ]
        );
        assert_eq!(guest().at(None), "hmi.press-7.takt");
        assert_eq!(guest().at(Some("root")), "root@hmi.press-7.takt");
    }

    /// As ssh does it: `%%` becomes `%`, and then a shell executes it.
    #[test]
    fn a_path_stays_one_word_whatever_is_in_it() {
        let bytes = b"/a b/c'd/$(e)/`f`/\"g\"/h\\i/%h/%%/*/\xff;j".to_vec();
        let path = OsString::from_vec(bytes.clone());
        let expanded = expand(quoted(&path).as_bytes());
        let command = [b"printf %s ".as_slice(), &expanded].concat();
        let output = Command::new("sh").arg("-c").arg(OsString::from_vec(command)).output();
        assert_eq!(output.unwrap().stdout, bytes);
    }

    fn expand(text: &[u8]) -> Vec<u8> {
        let mut rest = text.iter();
        let mut expanded = Vec::new();
        while let Some(byte) = rest.next() {
            if *byte == b'%' {
                assert_eq!(rest.next(), Some(&b'%'), "ssh knows no such letter");
            }
            expanded.push(*byte);
        }
        expanded
    }
}
