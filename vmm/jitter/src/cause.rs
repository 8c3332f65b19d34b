//! Causes in words.

use crate::figures::Part;

/// What took time, the greatest part first; `docs/timing.md` tells what each cause means.
pub fn words(parts: &[Part]) -> String {
    let mut parts: Vec<&Part> = parts.iter().collect();
    parts.sort_by_key(|part| std::cmp::Reverse(part.explains_ns));
    let words: Vec<String> = parts.into_iter().map(of).collect();
    if words.is_empty() { "nothing to explain".into() } else { words.join("; ") }
}

fn of(part: &Part) -> String {
    let us = part.explains_ns as f64 / 1e3;
    let name = match part.cause.as_str() {
        "late_wake_up" => "late wake-up",
        "host_delay" => "host delay",
        "vm_exits" => "VM exits",
        "host_interrupt" => "host interrupt",
        "guest_computation" => "guest computation",
        other => other,
    };
    match part.exits {
        None => format!("{name} {us:.1} us"),
        Some(exits) => format!("{name} {us:.1} us ({exits})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(cause: &str, explains_ns: u64, exits: Option<u64>) -> Part {
        Part { cause: cause.into(), explains_ns, exits }
    }

    #[test]
    fn the_greatest_part_comes_first() {
        let parts = [part("host_delay", 300, None), part("vm_exits", 4_500, Some(2))];
        assert_eq!(words(&parts), "VM exits 4.5 us (2); host delay 0.3 us");
        assert_eq!(words(&[]), "nothing to explain");
        assert_eq!(words(&[part("new_cause", 1_000, None)]), "new_cause 1.0 us");
    }
}
