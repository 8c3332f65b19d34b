//! The page of watched values. Those of a partition are from one cycle, which its title names.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Stylize;
use ratatui::text::Line;
use ratatui::widgets::Paragraph;
use takt_points::Point;
use takt_protocol::{ForcedStatus, PartitionStatus, State, Status};

use super::view::{View, Watched};
use crate::text::{self, plain};

/// What the page says if no value is named.
const NONE_NAMED: [&str; 2] = [
    "no values are watched: name them when takt top is started",
    "takt top plant.toml --watch tank.level --watch 'tank.row*'",
];
/// Titles of the columns, and of the last one if its values are old.
const COLUMNS: [&str; 3] = ["value", "type", "now"];
const LAST: &str = "last";
/// How much longer than a major frame, in which each PLC of the schedule runs, the next line may take.
const LATE_NS: u64 = 2_000_000_000;

/// Draws the page, from the line on that the user has scrolled to.
pub fn draw(frame: &mut Frame<'_>, area: Rect, status: &Status, view: &View) {
    let mut lines: Vec<Line<'_>> = Vec::new();
    if let Some(problem) = &view.values_problem {
        lines.push(Line::from(format!("old: {}", plain(problem))).bold().red());
    }
    if view.watched.is_empty() {
        lines.extend(NONE_NAMED.map(Line::from));
    }
    let room = usize::from(area.height).saturating_sub(lines.len());
    let all: Vec<Line<'_>> = view.watched.iter().flat_map(|w| table(w, status)).collect();
    // The last line stays on the screen.
    let skipped = view.scrolled.min(all.len().saturating_sub(room));
    lines.extend(all.into_iter().skip(skipped).take(room));
    frame.render_widget(Paragraph::new(lines), area);
}

/// Lines of all values, and so the furthest that one can scroll.
pub fn lines(watched: &[Watched]) -> usize {
    // A title, the columns' titles and an empty line each.
    watched.iter().map(|watched| watched.points.len() + 3).sum()
}

fn table(watched: &Watched, status: &Status) -> Vec<Line<'static>> {
    let partition = status.partitions.iter().find(|p| p.name == watched.partition);
    let forced = partition.map_or(&[][..], |partition| &partition.forced);
    let old = partition.and_then(|partition| old(watched, partition, status));
    let columns = if old.is_some() { [COLUMNS[0], COLUMNS[1], LAST] } else { COLUMNS };
    let rows: Vec<[String; 3]> = watched
        .points
        .iter()
        .enumerate()
        .map(|(index, point)| {
            let texts = watched.latest.as_ref().map(|(_, texts)| texts);
            let now = texts.and_then(|texts| texts.get(index)).map_or("-", String::as_str);
            [plain(&point.name), plain(&point.type_name), plain(now)]
        })
        .collect();
    let widest = |column: usize| {
        rows.iter().map(|row| row[column].len()).chain([columns[column].len()]).max().unwrap_or(0)
    };
    let widths = [widest(0), widest(1), widest(2)];
    let line = |row: [&str; 3]| {
        let [name, ty, now] = row;
        format!("{name:0$}  {ty:1$}  {now:2$}", widths[0], widths[1], widths[2])
    };
    let title = title(watched, old.as_deref());
    let mut lines = vec![
        if old.is_some() { Line::from(title).bold().red() } else { Line::from(title).bold() },
        Line::from(line(columns).trim_end().to_owned()).underlined(),
    ];
    lines.extend(watched.points.iter().zip(&rows).map(|(point, row)| {
        let text = line([&row[0], &row[1], &row[2]]);
        match forced.iter().any(|forced| is_forced(point, forced)) {
            true => Line::from(format!("{text}  FORCED")).bold().yellow(),
            false => Line::from(text.trim_end().to_owned()),
        }
    }));
    lines.push(Line::default());
    lines
}

/// Why the latest values are not those of now; `None` if they are, or if there are none.
fn old(watched: &Watched, partition: &PartitionStatus, status: &Status) -> Option<String> {
    let (values, _) = watched.latest.as_ref()?;
    if partition.state != State::Running {
        return Some(format!("the partition is {}", text::state(partition.state)));
    }
    let age = status.uptime_ns.saturating_sub(values.release_ns);
    let late = age > status.major_frame_ns.saturating_add(LATE_NS);
    late.then(|| format!("no values for {:.1} s", age as f64 / 1e9))
}

fn title(watched: &Watched, old: Option<&str>) -> String {
    let name = plain(&watched.partition);
    let Some((values, _)) = &watched.latest else {
        return format!("{name}: no line has come yet");
    };
    let old = old.map_or(String::new(), |why| format!("OLD, {why}; "));
    let release = values.release_ns as f64 / 1e9;
    let mut text = format!("{name}: {old}cycle {}, {release:.3} s", values.cycle);
    if values.missed > 0 {
        text += &format!("; {} missed before", values.missed);
    }
    if values.unsettled != 0 {
        text += "; in the middle of something";
    }
    text
}

/// Whether bytes of the point are forced; of a bit, this bit.
fn is_forced(point: &Point, forced: &ForcedStatus) -> bool {
    let [program, area, offset, bytes, bit] = forced.point;
    let range = point.range;
    let end = |offset: u32, bytes: u32| u64::from(offset) + u64::from(bytes);
    let overlap = u64::from(range.offset) < end(offset, bytes)
        && u64::from(offset) < end(range.offset, range.bytes.into());
    // Of several bits in a byte only this one.
    let same_bit = point.bit.is_none_or(|own| bit > 7 || bit == u32::from(own));
    (program, area) == (range.program.into(), range.area as u32) && overlap && same_bit
}
