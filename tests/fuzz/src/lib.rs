//! What reads input of strangers, each as a function from bytes, for a fuzzer to drive.
//!
//! A target panics where its subject broke a promise; a subject that panics, hangs or asks for
//! memory without bound is found by the fuzzer. `scripts/fuzz` runs them with libFuzzer, guided by
//! coverage. What it once found interesting is kept in `corpus/`, one archive a target, and the tests here go
//! through that without any fuzzer. To add an input: `tar -rf tests/fuzz/corpus/TARGET.tar FILE`.

mod targets;

/// One subject.
#[derive(Clone, Copy)]
pub struct Target {
    /// As on the command line, and as its archive in `corpus/` is called.
    pub name: &'static str,
    /// Gives the bytes to it.
    pub run: fn(&[u8]),
}

/// All of them.
pub const TARGETS: &[Target] = &[
    Target { name: "partition_file", run: targets::partition_file::run },
    Target { name: "plc_image", run: targets::images::plc },
    Target { name: "program_image", run: targets::program_image::run },
    Target { name: "linux_image", run: targets::images::linux },
    Target { name: "plc_exits", run: targets::plc_exits::run },
    Target { name: "linux_ports", run: targets::linux_ports::run },
    Target { name: "disk", run: targets::disk::run },
    Target { name: "channel_peer", run: targets::channel_peer::run },
    Target { name: "control_line", run: targets::control_line::run },
    Target { name: "retained_values", run: targets::retained_values::run },
    Target { name: "structured_text", run: targets::structured_text::run },
];

/// The target of this name.
#[must_use]
pub fn target(name: &str) -> Option<Target> {
    TARGETS.iter().copied().find(|target| target.name == name)
}
