//! The command lines of `takt-shell` and `takt-copy`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::Parser;

const AFTER_SHELL: &str = "\
ssh uses `takt-shell connect CID PORT` as its ProxyCommand: it connects its standard input and output to a port of the \
guest's vsock.

Exit status: ssh's own, which is the command's or 255; 2 wrong usage or partition file; 3 ssh cannot be started. Of \
`connect`: 0 both ends have closed; 1 the connection broke off; 3 no sockets to guests here, or none that answers.";

const AFTER_COPY: &str = "\
Exit status: scp's own, 0 if all was copied; 2 wrong usage or partition file; 3 scp cannot be started.";

/// Logs into a Linux partition that has the key `vsock`, by ssh and without a network. All of your own settings of ssh
/// count; the host has the name PARTITION.SYSTEM.takt there.
#[derive(Parser)]
#[command(name = "takt-shell", version, after_help = AFTER_SHELL)]
pub struct Shell {
    /// The partition file that Takt runs.
    pub file: PathBuf,
    /// The partition's name; may be left out if only one has the key `vsock`.
    pub partition: Option<String>,
    /// Who to log in as, if it is not the user that ssh would choose.
    #[arg(long, value_parser = user)]
    pub user: Option<String>,
    /// What to execute there in the place of a shell.
    #[arg(last = true)]
    pub command: Vec<OsString>,
}

/// Copies files and folders to or from a Linux partition that has the key `vsock`, by scp and without a network.
#[derive(Parser)]
#[command(name = "takt-copy", version, after_help = AFTER_COPY)]
pub struct Copy {
    /// The partition file that Takt runs.
    pub file: PathBuf,
    /// What to copy, and where to: paths of this machine, and PARTITION:PATH for those in the guest.
    #[arg(required = true, num_args = 2.., value_names = ["SOURCE", "TARGET"])]
    pub paths: Vec<OsString>,
    /// Who to log in as, if it is not the user that ssh would choose.
    #[arg(long, value_parser = user)]
    pub user: Option<String>,
}

/// What stands before the `@` of a host.
fn user(name: &str) -> Result<String, String> {
    let letter = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if !name.is_empty() && !name.starts_with('-') && name.chars().all(letter) {
        return Ok(name.to_owned());
    }
    Err("a user's name is of a-z, A-Z, 0-9, \"_\", \"-\" and \".\", and begins with no \"-\""
        .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_stands_behind_two_hyphens() {
        let cli = Shell::try_parse_from(["x", "a.toml", "hmi", "--", "ls", "-l"]).unwrap();
        assert_eq!(cli.partition.as_deref(), Some("hmi"));
        assert_eq!(cli.command, ["ls", "-l"]);
        let cli = Shell::try_parse_from(["x", "a.toml", "--user", "root", "--", "id"]).unwrap();
        assert_eq!((cli.partition, cli.user.as_deref()), (None, Some("root")));
        assert!(Shell::try_parse_from(["x"]).is_err());
        assert!(Shell::try_parse_from(["x", "a.toml", "hmi", "ls"]).is_err());
    }

    #[test]
    fn a_user_is_a_word() {
        for good in ["root", "j.doe", "user-1", "_apt"] {
            assert!(user(good).is_ok(), "{good}");
        }
        for bad in ["", "-oProxyCommand=x", "a b", "a@b", "a:b", "$(x)", "a\n"] {
            assert!(user(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_copy_has_a_source_and_a_target() {
        let cli = Copy::try_parse_from(["x", "a.toml", "a", "b", "hmi:/tmp"]).unwrap();
        assert_eq!(cli.paths, ["a", "b", "hmi:/tmp"]);
        for few in [&["x", "a.toml"][..], &["x", "a.toml", "hmi:/a"][..]] {
            assert!(Copy::try_parse_from(few).is_err(), "{few:?}");
        }
    }
}
