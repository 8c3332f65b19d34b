//! Where the console of each Linux is.
//!
//! There is one terminal and one keyboard, so one Linux at most has them. The others are reached through the
//! control socket, and so is that one.

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
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

fn two_terminals(first: Span, second: Span) -> Diagnostic {
    let found = "a second Linux has the terminal for its console";
    let allowed = "the terminal for one Linux, and `console = \"control\"` for each other";
    Diagnostic::new(second, found, allowed).and(first, "the other one")
}
