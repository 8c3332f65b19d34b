//! What the host's kernel writes to its consoles.

use crate::checks::kernel::is_realtime;
use crate::finding::Finding;
use crate::host::Host;

/// Messages of levels below this are shown: those of a kernel that is in grave trouble (`KERN_EMERG` to `KERN_CRIT`,
/// include/linux/kern_levels.h).
const GRAVE: u64 = 3;

/// Whether a CPU that has something to log writes it to a console itself, with interrupts off meanwhile: a
/// character takes 87 us on a serial line at 115,200 baud.
///
/// PREEMPT_RT has threads for that (`force_legacy_kthread` in kernel/printk/internal.h). What composing the line takes is left.
pub fn messages(host: &Host) -> Finding {
    const CHECK: &str = "console";
    const LEVEL: &str = "proc/sys/kernel/printk";
    let first = |text: String| text.split_whitespace().next()?.parse::<u64>().ok();
    let level = host.text(LEVEL).and_then(first);
    let consoles = host.text("proc/consoles").map(|text| enabled(&text).join(", "));
    let (Some(level), Some(consoles)) = (level, consoles) else {
        return Finding::unseen(
            CHECK,
            format!("/{LEVEL} and /proc/consoles tell nothing"),
            "messages of the kernel may be written to a console with interrupts off",
            "see that the kernel shows only grave messages: dmesg --console-level 2",
        );
    };
    if consoles.is_empty() {
        return Finding::good(CHECK, "the kernel writes its messages to no console");
    }
    if is_realtime(host) {
        return Finding::good(CHECK, format!("threads of the kernel write to {consoles}"));
    }
    if level <= GRAVE {
        return Finding::good(
            CHECK,
            format!("the kernel writes only grave messages to {consoles}"),
        );
    }
    Finding::warning(
        CHECK,
        format!("the kernel writes messages of levels below {level} to {consoles}"),
        "the CPU that has a message writes it with interrupts off: 87 us for each character of a serial line",
        "dmesg --console-level 2 # and loglevel=3 on the kernel's command line",
    )
}

/// Names of the consoles that are enabled (`show_console_dev` in fs/proc/consoles.c: name, what it can, flags in
/// parentheses; the name ends with a number). What is written to ttynull goes nowhere.
fn enabled(consoles: &str) -> Vec<&str> {
    let lines = consoles.lines().filter_map(|line| line.split_once(' '));
    let nowhere = |name: &str| name.trim_end_matches(|c: char| c.is_ascii_digit()) == "ttynull";
    let writing = lines.filter(|(name, rest)| rest.contains("(E") && !nowhere(name));
    writing.map(|(name, _)| name).collect()
}
