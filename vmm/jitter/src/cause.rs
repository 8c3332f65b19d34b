//! Causes in words.

use takt_figures::cause::{Cause, Explanation, Part};

/// What took time, the greatest part first; `docs/timing.md` tells what each cause means.
pub fn words(explanation: &Explanation) -> String {
    let mut parts: Vec<&Part> = explanation.parts().collect();
    parts.sort_by_key(|part| std::cmp::Reverse(part.explains_ns));
    let words: Vec<String> = parts.into_iter().map(of).collect();
    if words.is_empty() { "nothing to explain".into() } else { words.join("; ") }
}

fn of(part: &Part) -> String {
    let us = part.explains_ns as f64 / 1e3;
    match part.cause {
        Cause::LateWakeUp { .. } => format!("late wake-up {us:.1} us"),
        Cause::HostDelay => format!("host delay {us:.1} us"),
        Cause::VmExits { exits } => format!("VM exits {us:.1} us ({exits})"),
        Cause::HostInterrupt { exits } => format!("host interrupt {us:.1} us ({exits})"),
        Cause::GuestComputation => format!("guest computation {us:.1} us"),
        Cause::Unknown => format!("unknown {us:.1} us"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::time::Nanos;

    #[test]
    fn the_greatest_part_comes_first() {
        let parts = [(Cause::HostDelay, Nanos(300)), (Cause::VmExits { exits: 2 }, Nanos(4_500))];
        let words_of = |parts| words(&Explanation::new(parts));
        assert_eq!(words_of(&parts), "VM exits 4.5 us (2); host delay 0.3 us");
        assert_eq!(words_of(&[]), "nothing to explain");
    }
}
