//! The picture. All of it is ASCII, as the rest of Takt: it may be seen over a serial line.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Style, Stylize};
use ratatui::symbols::bar::Set;
use ratatui::text::Line;
use ratatui::widgets::{Paragraph, Row, Sparkline, Table};
use takt_protocol::{PartitionStatus, State, Status};

use super::values_page;
use super::view::{Page, View};
use crate::{channels, programs, text};

const BARS: Set<'static> = Set {
    empty: " ",
    one_eighth: ".",
    one_quarter: ".",
    three_eighths: ":",
    half: "-",
    five_eighths: "=",
    three_quarters: "+",
    seven_eighths: "*",
    full: "#",
};
/// Rows of the latencies of one partition, its title included.
const LATENCY_ROWS: u16 = 3;

/// Draws the whole screen. What finds no room is left out from below.
pub fn screen(frame: &mut Frame<'_>, view: &View) {
    let Some(status) = &view.status else { return };
    match view.page {
        Page::Overview => overview(frame, status, view),
        Page::Values => {
            let rows = [Constraint::Length(2), Constraint::Min(0)];
            let [head, rest] = Layout::vertical(rows).areas(frame.area());
            draw_head(frame, head, status, view);
            values_page::draw(frame, rest, status, view);
        }
    }
}

fn overview(frame: &mut Frame<'_>, status: &Status, view: &View) {
    let measured = || status.partitions.iter().filter(|p| p.releases.is_some());
    let rows = |count: usize| u16::try_from(count).unwrap_or(u16::MAX);
    let tasks = status.partitions.iter().flat_map(programs::rows).count();
    let forced: Vec<String> = status.partitions.iter().flat_map(programs::forced).collect();
    let head_rows = Constraint::Length(rows(forced.len()).saturating_add(2));
    let [head, rest] = Layout::vertical([head_rows, Constraint::Min(0)]).areas(frame.area());
    let versions = view.versions.values().map(Vec::len).sum::<usize>();
    let [table, windows, versions_area, tasks_area, channels, latencies, events] =
        Layout::vertical([
            Constraint::Length(rows(status.partitions.len()).saturating_add(2)),
            Constraint::Length(rows(status.partitions.len()).saturating_add(2)),
            Constraint::Length(match versions {
                0 => 0,
                count => rows(count).saturating_add(2),
            }),
            Constraint::Length(match tasks {
                0 => 0,
                count => rows(count).saturating_add(2),
            }),
            Constraint::Length(match status.channels.len() {
                0 => 0,
                count => rows(count).saturating_add(2),
            }),
            Constraint::Length(rows(measured().count()).saturating_mul(LATENCY_ROWS)),
            Constraint::Min(0),
        ])
        .areas(rest);
    draw_head(frame, head, status, view);
    // At the top: a plant with forced values is not in its normal state.
    let forced = forced.into_iter().map(|line| Line::from(line).bold().yellow());
    let below = Rect { y: head.y.saturating_add(2), height: head.height.saturating_sub(2), ..head };
    frame.render_widget(Paragraph::new(forced.collect::<Vec<_>>()), below.intersection(head));
    draw_table(frame, table, status);
    draw_windows(frame, windows, status);
    draw_versions(frame, versions_area, view);
    draw_tasks(frame, tasks_area, status);
    draw_channels(frame, channels, status);
    for (partition, i) in measured().zip(0u16..) {
        let y = latencies.y.saturating_add(i.saturating_mul(LATENCY_ROWS));
        let area = Rect { y, height: LATENCY_ROWS, ..latencies };
        draw_latency(frame, area.intersection(latencies), partition, view);
    }
    draw_events(frame, events, view);
}

fn draw_head(frame: &mut Frame<'_>, area: Rect, status: &Status, view: &View) {
    let keys = match view.page {
        Page::Overview => "Tab: values   q: leave",
        Page::Values => "Tab: overview   Up, Down, PageUp, PageDown, Home, End: move   q: leave",
    };
    let line = match &view.problem {
        None => Line::from(text::summary(status)).bold(),
        Some(problem) => Line::from(format!("old: {}", text::plain(problem))).bold().red(),
    };
    frame.render_widget(Paragraph::new(vec![line, Line::from(keys)]), area);
}

fn draw_table(frame: &mut Frame<'_>, area: Rect, status: &Status) {
    let style = |partition: &PartitionStatus| {
        let bad = partition
            .releases
            .as_ref()
            .is_some_and(|r| [r.lost, r.unrecorded, r.late, r.overruns].iter().any(|n| *n > 0));
        match partition.state {
            State::Running if bad => Style::new().yellow(),
            State::Running => Style::new(),
            _ => Style::new().red(),
        }
    };
    let rows = status.partitions.iter().map(|p| (text::row(p), style(p)));
    draw_rows(frame, area, text::COLUMNS, rows.collect());
}

fn draw_versions(frame: &mut Frame<'_>, area: Rect, view: &View) {
    let style = |phase: &str| match phase {
        "none" | "held" => Style::new(),
        _ => Style::new().yellow(),
    };
    let rows = view.versions.iter().flat_map(|(partition, versions)| {
        versions.iter().map(|v| (programs::version_row(partition, v), style(&v.phase)))
    });
    draw_rows(frame, area, programs::VERSION_COLUMNS, rows.collect());
}

fn draw_tasks(frame: &mut Frame<'_>, area: Rect, status: &Status) {
    let rows = status.partitions.iter().flat_map(programs::rows).map(|row| (row, Style::new()));
    draw_rows(frame, area, programs::COLUMNS, rows.collect());
}

fn draw_channels(frame: &mut Frame<'_>, area: Rect, status: &Status) {
    let style = |channel| match channels::is_bad(channel) {
        true => Style::new().yellow(),
        false => Style::new(),
    };
    let rows = status.channels.iter().map(|c| (channels::row(c), style(c)));
    draw_rows(frame, area, channels::COLUMNS, rows.collect());
}

/// Rows below their titles, each column as wide as it has to be.
fn draw_rows<const N: usize>(
    frame: &mut Frame<'_>,
    area: Rect,
    titles: [&'static str; N],
    rows: Vec<([String; N], Style)>,
) {
    let widths = titles.iter().enumerate().map(|(column, title)| {
        let widest = rows.iter().map(|(row, _)| row[column].len()).max().unwrap_or(0);
        Constraint::Length(u16::try_from(widest.max(title.len())).unwrap_or(u16::MAX))
    });
    let widths: Vec<Constraint> = widths.collect();
    let rows = rows.into_iter().map(|(row, style)| Row::new(row).style(style));
    let header = Row::new(titles).style(Style::new().underlined());
    frame.render_widget(Table::new(rows, widths).header(header).column_spacing(2), area);
}

fn draw_windows(frame: &mut Frame<'_>, area: Rect, status: &Status) {
    let margin = status.partitions.iter().map(|p| p.name.len()).max().unwrap_or(0);
    let left_out = match status.schedule.windows_left_out {
        0 => String::new(),
        more => format!("; {more} windows are not shown"),
    };
    let width = usize::from(area.width).saturating_sub(margin + 2);
    let title = format!("windows of one frame (# window, - background{left_out})");
    let mut lines = vec![Line::from(title).underlined()];
    lines.extend(status.partitions.iter().map(|partition| {
        let name = text::plain(&partition.name);
        Line::from(format!("{name:margin$}  {}", timeline(status, partition, width)))
    }));
    frame.render_widget(Paragraph::new(lines), area);
}

/// One row: a window shows in every column that it touches; the background has the columns that no
/// window of its CPU touches.
fn timeline(status: &Status, partition: &PartitionStatus, width: usize) -> String {
    let cpu_of = |name: &str| status.partitions.iter().find(|p| p.name == name).map(|p| p.cpu);
    let frame = u128::from(status.major_frame_ns.max(1));
    let spans: Vec<(usize, usize)> = status
        .schedule
        .windows
        .iter()
        .filter(|window| match partition.background {
            false => window.partition == partition.name,
            true => cpu_of(&window.partition) == Some(partition.cpu),
        })
        .map(|window| {
            let column = |ns: u128| usize::try_from(ns * width as u128 / frame).unwrap_or(width);
            let (start, length) = (u128::from(window.offset_ns), u128::from(window.duration_ns));
            // The last nanosecond of the window is in its last column.
            (column(start), column((start + length).saturating_sub(1)))
        })
        .collect();
    let cell = |x: usize| {
        let touched = spans.iter().any(|(first, last)| (*first..=*last).contains(&x));
        match (touched, partition.background) {
            (true, false) => '#',
            (false, true) => '-',
            _ => ' ',
        }
    };
    (0..width).map(cell).collect()
}

fn draw_latency(frame: &mut Frame<'_>, area: Rect, partition: &PartitionStatus, view: &View) {
    let samples = view.latencies.get(&partition.name);
    let latest = samples.and_then(|s| *s.back()?).map_or("-".to_owned(), |mean| mean.to_string());
    let since_start = text::latency(partition).unwrap_or_default();
    let title = format!("{since_start}; latest mean {latest} ns");
    let [head, bars] = Layout::vertical([Constraint::Length(1), Constraint::Min(0)]).areas(area);
    frame.render_widget(Paragraph::new(Line::from(title).underlined()), head);
    // The newest is at the right edge.
    let all = samples.into_iter().flatten().copied();
    let skipped = samples.map_or(0, |s| s.len().saturating_sub(usize::from(bars.width)));
    let shown = Sparkline::default().data(all.skip(skipped)).bar_set(BARS);
    frame.render_widget(shown, bars);
}

fn draw_events(frame: &mut Frame<'_>, area: Rect, view: &View) {
    let room = usize::from(area.height).saturating_sub(1);
    let skipped = view.events.len().saturating_sub(room);
    let mut lines = vec![Line::from("latest events").underlined()];
    lines.extend(view.events.iter().skip(skipped).map(|event| Line::from(text::event(event))));
    frame.render_widget(Paragraph::new(lines), area);
}
