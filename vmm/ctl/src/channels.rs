//! Channels as rows of a table.

use takt_protocol::{ChannelStatus, Contents};

use crate::text::plain;

/// Titles of that table.
pub const COLUMNS: [&str; 7] = ["channel", "from", "to", "fill", "newest", "written", "lost"];

/// A row of it.
pub fn row(channel: &ChannelStatus) -> [String; 7] {
    let contents = channel.contents.as_ref();
    [
        plain(&channel.name),
        plain(&channel.source),
        plain(&channel.destinations.join(", ")),
        contents.map_or("?".to_owned(), |contents| fill(channel, contents)),
        contents.and_then(|contents| contents.age_ns).map_or("-".to_owned(), age),
        contents.map_or("?".to_owned(), |contents| contents.written.to_string()),
        lost(channel),
    ]
}

/// Of a queue how much of it is used, of a sampling channel whether its message can be used.
fn fill(channel: &ChannelStatus, contents: &Contents) -> String {
    match (contents.waiting, channel.depth, contents.valid) {
        (Some(waiting), Some(depth), _) => format!("{waiting}/{depth}"),
        _ if contents.age_ns.is_none() => "-".to_owned(),
        (_, _, Some(true)) => "valid".to_owned(),
        _ => "old".to_owned(),
    }
}

fn lost(channel: &ChannelStatus) -> String {
    let overwritten = channel.contents.and_then(|contents| contents.overwritten).unwrap_or(0);
    match channel.lost {
        Some(lost) => lost.saturating_add(overwritten).to_string(),
        // What its destination has noticed, that alone knows.
        None if overwritten > 0 => format!(">={overwritten}"),
        None => "-".to_owned(),
    }
}

fn age(ns: u64) -> String {
    match ns {
        0..1_000_000 => format!("{:.1} us", ns as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} ms", ns as f64 / 1e6),
        _ => format!("{:.1} s", ns as f64 / 1e9),
    }
}

/// Why nothing can be told of a channel, in one line.
pub fn problem(channel: &ChannelStatus) -> Option<String> {
    let problem = channel.problem.as_ref()?;
    Some(plain(&format!("channel {}: {problem}", channel.name)))
}

/// True if somebody should have a look at it.
pub fn is_bad(channel: &ChannelStatus) -> bool {
    let lost = channel.lost.unwrap_or(0) > 0;
    lost || channel.contents.is_none_or(|contents| {
        contents.overwritten.is_some_and(|n| n > 0)
            || (contents.valid == Some(false) && contents.written > 0)
    })
}
