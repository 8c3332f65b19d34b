//! Where the console of each Linux is.
//!
//! There is one terminal and one keyboard, so one Linux at most has them. The others are reached through the
//! control socket, and so is that one.

use toml::Spanned;

use super::channels::Channel;
use super::diagnostic::{Diagnostic, Span, quote};
use super::host_ports::HostPort;
use super::partition::Checked;

/// Where the console of a Linux is shown, and where from it is typed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Console {
    /// Takt's own terminal, and the control socket.
    Terminal,
    /// The control socket alone.
    Control,
}

/// Reads the key; without it a Linux has the terminal.
pub fn check(console: Option<&Spanned<String>>) -> Result<Console, Diagnostic> {
    let Some(console) = console else { return Ok(Console::Terminal) };
    match console.get_ref().as_str() {
        "terminal" => Ok(Console::Terminal),
        "control" => Ok(Console::Control),
        other => {
            let found = format!("there is no console {}", quote(other));
            Err(Diagnostic::new(console.span(), found, "\"terminal\" or \"control\""))
        }
    }
}

/// The rules of all consoles; `socket` says whether there is a control socket.
pub fn check_all(partitions: &[Checked], socket: bool) -> Result<(), Diagnostic> {
    let place = |checked: &Checked| checked.console.clone().unwrap_or(checked.header.clone());
    let of = |console| partitions.iter().filter(move |p| p.partition.console == Some(console));
    let mut terminals = of(Console::Terminal);
    if let (Some(first), Some(second)) = (terminals.next(), terminals.next()) {
        return Err(two_terminals(place(first), place(second)));
    }
    match of(Console::Control).next() {
        Some(hidden) if !socket => {
            let found = "the console is at the control socket, and there is none";
            let allowed = "`console = \"terminal\"`, or the key `control` in [system]";
            Err(Diagnostic::new(place(hidden), found, allowed))
        }
        _ => Ok(()),
    }
}

/// Nothing else is written to a file that keeps a console, and nothing else of the partition file is read from it.
pub fn check_logs(partitions: &[Checked], channels: &[Channel]) -> Result<(), Diagnostic> {
    for (number, log) in
        partitions.iter().enumerate().filter_map(|(n, p)| Some((n, p.console_log.as_ref()?)))
    {
        let allowed = "a file of its own for each console that is kept";
        let error = |found: String| Diagnostic::new(log.span.clone(), found, allowed);
        let path = log.path.as_path();
        let logs = partitions.iter().take(number).filter_map(|p| p.console_log.as_ref());
        if let Some(other) = logs.into_iter().find(|other| other.path == path) {
            let found = "the console of another partition is kept there too".to_owned();
            return Err(error(found).and(other.span.clone(), "the other one"));
        }
        let ends = channels.iter().filter_map(|channel| channel.host.as_ref());
        let images = partitions.iter().flat_map(|p| &p.images).map(|image| image.path.as_path());
        let disks = partitions.iter().flat_map(|p| &p.disks).map(|disk| disk.disk.path.as_path());
        if ends.map(HostPort::path).chain(images).chain(disks).any(|other| other == path) {
            return Err(error(format!("{} is a file of something else here", path.display())));
        }
    }
    Ok(())
}

fn two_terminals(first: Span, second: Span) -> Diagnostic {
    let found = "a second Linux has the terminal for its console";
    let allowed = "the terminal for one Linux, and `console = \"control\"` for each other";
    Diagnostic::new(second, found, allowed).and(first, "the other one")
}
