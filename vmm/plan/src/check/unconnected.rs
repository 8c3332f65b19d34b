//! Warns of points that are connected to nothing, and of connections without a point.
//!
//! Neither is refused: a program may be tried before its plant is there, and an image need not name all of its bytes.
//! Both are more often a table that was forgotten, or one with a wrong address.

use takt_program::{Area, Variable};

use super::line;
use crate::{Connection, points};

/// Most names in one warning.
const NAMES_MAX: usize = 8;

/// Writes a line for each kind of what is not connected, if there is any. `points` are all inputs and outputs of the
/// program with this place, `all` the connections of its partition.
pub fn warn(out: &mut String, all: &[Connection], program: usize, points: &[Variable<'_>]) {
    let own = || all.iter().filter(|c| usize::from(c.mapping.program) == program);
    let unconnected = |area: Area| -> Vec<String> {
        let lonely = points.iter().filter(|v| {
            let connected = own().any(|c| c.meets(v)) || all.iter().any(|c| c.reads(program, v));
            v.area == area && !connected
        });
        lonely.map(name).collect()
    };
    let pointless = own().filter(|c| !points.iter().any(|v| c.meets(v)));
    let pointless: Vec<String> = pointless.map(|c| c.point.clone()).collect();
    let warnings = [
        (unconnected(Area::Input), "inputs that no [[partition.io]] connects, and that read as 0"),
        (unconnected(Area::Output), "outputs that no [[partition.io]] connects to anything"),
        (pointless, "addresses with a [[partition.io]] at which the program declares no point"),
    ];
    for (names, what) in warnings {
        if names.is_empty() {
            continue;
        }
        let more = match names.len().saturating_sub(NAMES_MAX) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let shown = names.get(..NAMES_MAX).unwrap_or(&names).join(", ");
        line(out, &format!("    warning: {what}: {shown}{more}"));
    }
}

fn name(point: &Variable<'_>) -> String {
    if point.name.is_empty() { points::address(point) } else { point.name.to_owned() }
}
